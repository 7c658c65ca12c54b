"""What is on a ball goes round as the fitted spin turns it: dots, stripes and numbers, out of sight and into it.

A ball that rolls its own radius turns by 57 degrees; what is on it goes further between two pictures than optical flow
can follow, and half of it goes out of sight. How it turns is known from its motion. What does not turn is the light.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.trajectory import State
from models.core.typing import Float32Array, FloatArray
from video.flow.optical_flow import grid
from video.matting.ball_matting import Sprite, reach_around
from video.matting.ball_timeline import Sightings
from video.matting.compositing import Turned

STEPS = 16
"""Parts of the time between two pictures over which the spin is added up."""
LEAST_MOVED = 0.003
"""Share of a ball on which another paint must show for its turn to matter."""
RIM = (0.78, 0.95)
"""Radii between which what goes round passes into the edge, which does not: fringe and mask are its own."""
MOST_FLAT, LEAST_WEIGHT = 0.93, 0.03
"""Radii from the centre beyond which a sighting shows edge; and what a place out of sight counts."""
FACING = (0.25, 0.45)
"""Cosines between the way out of a ball and that to the camera from which a place is seen at all, and well."""
CHANGED_LEVELS = 30.0
"""Levels of 255 by which a place must look otherwise for something to have moved there: light changes by less."""
LEAST_GAIN, LEAST_KNOWN = 0.5, 0.15
"""Share of the squared change that may be left for a turn to be believed; and that must be at places which both
sightings show, for the question to be answered."""
UPRIGHT_RAD = tuple(sign * np.radians(angle) for angle in (8, 16, 24, 34, 46, 60) for sign in (1, -1))
"""Turns about the upright from one picture to the next that are tried: cues and cushions give them."""
EXPLAINED_WELL, UPRIGHT_WORTH = 0.2, 0.3
"""Share of the change that is left where no such turn is sought, and what a radian of it must explain more."""
PAINT_LEVELS = 50.0
"""Change, levels of 255, that is paint rather than light where the question cannot be answered."""
SMALLEST = np.ones((3, 3), dtype=np.uint8)
"""px around a place within which the same colour is as good: edges are a pixel off."""


@dataclass(frozen=True, slots=True)
class Spin:
    """How a ball goes round from one picture to the next, in axes right, down and towards the camera."""

    parts: FloatArray
    """(K + 1, 3, 3) rotations from the first picture on, after equal parts of the time."""
    radius: float
    """px"""
    moved: Float32Array
    """(g, g) how sure it is, 0 to 1, that a place shows another paint in the second sighting than in the first."""
    light: Float32Array
    """(g, g, 3) levels by which lamps make a place brighter than others, whatever paint is there."""
    darkest: Float32Array
    """(3,) levels of the darkest paint."""

    def until(self, share: float) -> FloatArray:
        """Rotation (3, 3) from the first picture to a share of the time, 0 to 1."""
        place = share * (len(self.parts) - 1)
        k = min(int(place), len(self.parts) - 2)
        step, _ = cv2.Rodrigues(self.parts[k + 1] @ self.parts[k].T)
        return np.asarray(_rotation((place - k) * step[:, 0]) @ self.parts[k], dtype=np.float64)

    def looked_up(self, share: float) -> tuple[Turned, Turned]:
        """Where what shows at a share of the time, 0 to 1, lies in the sighting before and in that after.

        Paint goes round only where some has moved, here or where it came from or goes to: gloss and shade stay.
        """
        outward, inner = _near_half(self.radius)
        now = self.until(share)
        there = [outward @ turn.T.astype(np.float32) for turn in (now.T, self.until(1.0) @ now.T)]
        bends = [_bend(outward, place, self.radius) for place in there]
        moved = self.moved
        for bend, place in zip(bends, there, strict=True):
            moved = np.maximum(moved, np.where(place[..., 2] > 0, _bent(self.moved, bend), 0))
        inner = np.asarray(inner * moved, dtype=np.float32)
        before, after = (
            Turned(
                bend,
                np.clip(place[..., 2], LEAST_WEIGHT, 1) ** 2,
                inner,
                self.light - _bent(self.light, bend),
                self.darkest,
            )
            for bend, place in zip(bends, there, strict=True)
        )
        return before, after


def spins_of(sightings: Sightings, row: int) -> State:
    """The state of all balls (STEPS, N) in the middles of equal parts of the time from a row's picture to the next."""
    first, last = sightings.t[row : row + 2]
    return sightings.state(first + (last - first) * (np.arange(STEPS) + 0.5) / STEPS)


def spin_between(
    sightings: Sightings, row: int, ball: int, state: State, sides: tuple[Sprite, Sprite], radius: float
) -> Spin | None:
    """How a ball goes round from the picture of a row to the next, by `spins_of` the row.

    None where its spin is not known, where nothing on it is seen to move, and where what is seen contradicts it.
    """
    axes = _axes(sightings, state.xy[:, ball].mean(axis=0), float(sightings.t[row]))
    spin = _fitted(state, ball, axes, float(sightings.t[row + 1] - sightings.t[row]))
    if spin is None:
        return None
    pair = _Pair.of(sides, radius)
    if pair.moved_share < LEAST_MOVED:
        return None
    parts = _summed(spin)
    account = pair.turned(parts[-1])
    if not np.isfinite(state.w[:, ball, 2]).all() and account.cost > EXPLAINED_WELL:
        # About the upright, which no way of a ball tells, it may turn as it likes: what it shows says how.
        least = account.cost
        for angle in UPRIGHT_RAD:
            other = _summed(spin + angle / len(spin) * axes[:, 2])
            tried = pair.turned(other[-1])
            if tried.cost + UPRIGHT_WORTH * abs(angle) < least:
                least, parts, account = tried.cost + UPRIGHT_WORTH * abs(angle), other, tried
    if not account.explained:
        return None
    paints = account.paints()
    return Spin(parts, radius, pair.moved, account.light(paints), paints[0])


def halves_apart(sides: tuple[Sprite, Sprite], radius: float, views: tuple[Turned, Turned]) -> float:
    """Mean squared difference, levels^2, of what two sightings make of a ball at one time between them."""
    outward, _ = _near_half(radius)
    made, weight = [], (outward[..., 2] > FACING[1]).astype(np.float32)
    for sprite, turned in zip(sides, views, strict=True):
        seen = _around(sprite, radius)
        there = _bent(seen, turned.bend)
        if turned.light is not None:
            there = turned.lit(there, turned.light)
        if turned.inner is not None:
            there = seen + (there - seen) * turned.inner[..., None]
        if turned.facing is not None:
            weight = np.minimum(weight, turned.facing)
        made.append(there)
    return float((weight * ((made[0] - made[1]) ** 2).mean(axis=2)).sum() / max(float(weight.sum()), 1e-6))


def _rotation(vector: FloatArray) -> FloatArray:
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0], dtype=np.float64)


@lru_cache(maxsize=64)
def _near_half(radius: float) -> tuple[Float32Array, Float32Array]:
    """Ways out of a ball (g, g, 3) at the pixels around its centre, and the share (g, g) of each that can go round."""
    half = reach_around(radius)
    y, x = (np.mgrid[-half : half + 1, -half : half + 1] / radius).astype(np.float32)
    square = x * x + y * y
    inner = np.clip((RIM[1] - np.sqrt(square)) / (RIM[1] - RIM[0]), 0, 1)
    return np.stack([x, y, np.sqrt(np.maximum(1 - square, 0))], axis=-1), inner.astype(np.float32)


def _bend(outward: Float32Array, there: Float32Array, radius: float) -> Float32Array:
    """(g, g, 2) px from where what lies at `there` (g, g, 3) on the ball is seen to its pixel; off the ball none.

    What is out of sight or on the edge is looked up at the nearest place that is not.
    """
    reach = np.maximum(np.hypot(there[..., 0], there[..., 1]), 1e-6)
    kept = np.where(there[..., 2] < 0, MOST_FLAT, np.minimum(reach, MOST_FLAT)) / reach
    on = np.hypot(outward[..., 0], outward[..., 1]) < 1
    way = (outward[..., :2] - there[..., :2] * kept[..., None]) * np.float32(radius)
    return np.asarray(np.where(on[..., None], way, 0), dtype=np.float32)


def _bent(patch: Float32Array, bend: Float32Array) -> Float32Array:
    """A patch (g, g, ...) looked up where a bend (g, g, 2) says."""
    side = bend.shape[0]
    return np.asarray(cv2.remap(patch, grid(side, side) - bend, None, cv2.INTER_LINEAR), dtype=np.float32)


def _fitted(state: State, ball: int, axes: FloatArray, seconds: float) -> FloatArray | None:
    """Rotation vectors (K, 3) in parts of the time from one picture to the next, in the picture's axes."""
    spin = state.w[:, ball].copy()
    spin[:, 2] = np.nan_to_num(spin[:, 2])
    if not np.isfinite(spin).all() or state.measured[:, ball].any():
        return None
    return np.asarray(np.linalg.det(axes) * spin @ axes.T * (seconds / len(spin)), dtype=np.float64)


def _summed(vectors: FloatArray) -> FloatArray:
    """Rotations (K + 1, 3, 3) after each of so many vectors (K, 3)."""
    parts = [np.eye(3)]
    for vector in vectors:
        parts.append(_rotation(vector) @ parts[-1])
    return np.stack(parts)


def _axes(sightings: Sightings, xy: FloatArray, t: float) -> FloatArray:
    """(3, 3) rows: the picture's right and down, and the way to the camera, where a ball is, in the table's axes."""
    camera, size = sightings.scene.camera, sightings.scene.table.ball_radius
    steps = 0.5 * size * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    shown = [sightings.shown(camera.to_pixels((xy + step[:2])[None], size + float(step[2])), t)[0] for step in steps]
    right, down = (np.array(shown[1:]) - shown[0]).T
    right = right / np.linalg.norm(right)
    down = down - (down @ right) * right
    down = down / np.linalg.norm(down)
    near = np.cross(right, down)
    return np.stack([right, down, near if near @ (camera.eye - np.array([*xy, size])) > 0 else -near])


@lru_cache(maxsize=64)
def _around(sprite: Sprite, radius: float) -> Float32Array:
    """(g, g, 3) levels of a sighting around the ball's centre.

    Shared, not to be written into: a sighting ends one gap and begins the next.
    """
    cover = sprite.around(sprite.cover, reach_around(radius))
    return np.asarray(cover[..., :3] / np.maximum(cover[..., 3:], 0.2), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two sightings of a ball, and what differs between them."""

    seen: tuple[Float32Array, Float32Array]
    """(g, g, 3)"""
    radius: float
    wide: tuple[tuple[Float32Array, Float32Array], tuple[Float32Array, Float32Array]]
    """The most and the least (g, g, 3) of either within a pixel: edges are a pixel off."""
    still: tuple[Float32Array, Float32Array]
    """(g, g) levels by which either shows something that the other does not show there."""
    moved: Float32Array
    """(g, g) how sure it is, 0 to 1, that another paint shows."""

    @classmethod
    def of(cls, sides: tuple[Sprite, Sprite], radius: float) -> _Pair:
        seen = _around(sides[0], radius), _around(sides[1], radius)
        wide = tuple((cv2.dilate(one, SMALLEST), cv2.erode(one, SMALLEST)) for one in seen)
        still = _beyond(seen[0], *wide[1]), _beyond(seen[1], *wide[0])
        changes = np.abs(still[0]).max(axis=2), np.abs(still[1]).max(axis=2)
        moved = 1 - np.exp(-((np.maximum(*changes) / CHANGED_LEVELS) ** 2))
        return cls(seen, radius, (wide[0], wide[1]), changes, moved.astype(np.float32))

    @property
    def moved_share(self) -> float:
        """Of what can go round."""
        inner = _near_half(self.radius)[1]
        return float((inner * self.moved).sum() / inner.sum())

    def turned(self, turn: FloatArray) -> _Account:
        """What a turn (3, 3) from the first sighting to the second leaves of their difference."""
        outward, inner = _near_half(self.radius)
        gains, known = [], []
        for own, other, there in zip(self.seen, self.wide[::-1], (turn, turn.T), strict=True):
            place = outward @ there.T.astype(np.float32)
            bend = _bend(outward, place, self.radius)
            gains.append(_beyond(own, _bent(other[0], bend), _bent(other[1], bend)))
            known.append(np.clip((place[..., 2] - FACING[0]) / (FACING[1] - FACING[0]), 0, 1))
        weight = inner * self.moved
        change = answered = left = 0.0
        for still, gain, share in zip(self.still, gains, known, strict=True):
            change += float((weight * still**2).sum())
            answered += float((weight * share * still**2).sum())
            left += float((weight * share * np.abs(gain).max(axis=2) ** 2).sum())
        return _Account(self.seen, inner, gains, known, float(weight.sum()), change, answered, left)


@dataclass(frozen=True, slots=True)
class _Account:
    """What a turn leaves of the difference between two sightings."""

    seen: tuple[Float32Array, Float32Array]
    """(g, g, 3)"""
    inner: Float32Array
    """(g, g) share that can go round."""
    gains: list[Float32Array]
    """Levels (g, g, 3) of both that are beyond what their paint shows in the other one, turned there."""
    known: list[Float32Array]
    """How well (g, g) that is seen there, 0 to 1."""
    area: float
    """px on which another paint shows."""
    change: float
    """levels^2 px by which it does."""
    answered: float
    """The part of it at places that both show."""
    left: float
    """What of that the turn leaves."""

    @property
    def cost(self) -> float:
        """Share of the change that is left, half of what nothing is known of included."""
        return (self.left + 0.5 * (self.change - self.answered)) / max(self.change, 1e-6)

    @property
    def explained(self) -> bool:
        """Whether little of the change is left."""
        if self.answered < LEAST_KNOWN * self.change:
            return self.change > PAINT_LEVELS**2 * 2 * self.area
        return self.left < LEAST_GAIN * self.answered

    def paints(self) -> tuple[Float32Array, Float32Array]:
        """(3,) levels of the darkest paint on the ball, and of the brightest."""
        on = self.inner > 0
        seen = np.concatenate([self.seen[0][on], self.seen[1][on]])
        darkest, brightest = (np.percentile(seen, share, axis=0).astype(np.float32) for share in (10, 90))
        return darkest, brightest

    def light(self, paints: tuple[Float32Array, Float32Array]) -> Float32Array:
        """(g, g, 3) levels by which lamps make a place brighter than others, whatever of the `paints` is there.

        What is brighter, in both sightings, than its paint is in the other one is so by a lamp.
        """
        light = _light(self.seen, self.gains, self.known, paints)
        return np.asarray(light * self.inner[..., None], dtype=np.float32)


def _beyond(own: Float32Array, most: Float32Array, least: Float32Array) -> Float32Array:
    """(g, g, 3) levels by which a sighting is above the most or, negative, below the least."""
    return np.asarray(np.maximum(own - most, 0) - np.maximum(least - own, 0), dtype=np.float32)


def _light(
    seen: tuple[Float32Array, Float32Array],
    gains: list[Float32Array],
    known: list[Float32Array],
    paints: tuple[Float32Array, Float32Array],
) -> Float32Array:
    """(g, g, 3) levels by which places are brighter in both sightings than their paint is elsewhere on the ball.

    Where only one sighting shows that paint elsewhere, it cannot be darker than the darkest on the ball.
    """
    darkest, brightest = paints
    room = np.maximum(np.minimum(*seen) - darkest, 0), np.maximum(brightest - np.maximum(*seen), 0)
    alone = [np.clip(gain, -room[1], room[0]) for gain in gains]
    agreed = np.where(gains[0] * gains[1] > 0, np.sign(gains[0]) * np.minimum(*np.abs(gains)), 0)
    first, second = (share[..., None] for share in known)
    light = first * second * agreed + first * (1 - second) * alone[0] + second * (1 - first) * alone[1]
    return np.asarray(light, dtype=np.float32)
