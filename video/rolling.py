"""Balls as they roll: what is painted on a ball, put where the ball has turned it.

A ball turns as a whole, and the motion says by how much: what rolls has turned by its way over its radius. What it does
not say, side spin above all, is told by the two sightings themselves: the rotation is moved a little until the one,
turned, looks most like the other. Dots, stripes and numbers turn; light and reflections stay where they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.scene import Camera
from models.trajectory import Trajectory
from video.ball_paint import Paint, flat_of, in_sight, without_common

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

STEPS = 48
"""Into which a gap is divided to add up what a ball turns: a contact is at most half of one off."""
ROUNDS, NUDGE = 6, 0.02
"""Of Gauss and Newton; and rad by which a rotation is moved to see what changes."""
PRIOR, CORRELATED = 0.05, 10.0
"""rad by which the motion may be wrong about a turn, by side spin and slip; and pixels that are wrong together."""
LEAST_OVERLAP = 0.15
"""Share of the disc that must be seen in both sightings to compare them."""
LEAST_GAIN = 0.4
"""Share of the difference between two sightings that may be left for a rotation to be believed."""
LEAST_RADIUS, LEAST_TURN = 9.0, 0.4
"""px below which a ball shows too little paint, and rad up to which optical flow on the ball follows it better."""
MOST_MARKED = 0.4
"""Share of the disc that marks may cover: of a striped ball nobody can tell which colour is its own."""
CHANGED = 0.1
"""Share of the power of the marks on both sightings by which these differ, at the least: what stays is light."""
UNLIKE = 0.7
"""Share of the power of the marks on both sightings by which those that have nothing in common differ, at the least."""
LEAST_KNOWN = 0.1
"""Weight of the sightings that show a place from which on what they show there is taken wholly."""
RIM_BLUR = (5, 5)
"""px over which paint is averaged at the rim, where little of a sighting stands for much of the ball."""
EDGE = 2.0
"""px over which lens and coding mix a ball with what is behind."""


@dataclass(frozen=True, slots=True)
class Turned:
    """What is painted on a ball in a sighting, to be shown turned."""

    paint: Paint
    rotation: Floats
    """(3, 3) from the view of the picture to be made to that of the sighting: x right, y down, z to the camera."""


@dataclass(frozen=True, slots=True)
class Roll:
    """How a ball turns between two sightings, and what is painted on it in both."""

    t: Floats
    """(STEPS + 1,) s."""
    turned: Floats
    """(STEPS + 1, 3, 3) from the first sighting on, on the table's axes."""
    views: Floats
    """(2, 3, 3) the table's axes to the views of the two sightings."""
    paints: tuple[Paint, Paint]

    def at(self, t: float) -> tuple[Turned, Turned]:
        """Both sightings as they are to be turned for time t."""
        place = float(np.clip((t - self.t[0]) / (self.t[-1] - self.t[0]), 0, 1))
        row = min(int(place * STEPS), STEPS - 1)
        step = vector_of(self.turned[row + 1] @ self.turned[row].T)
        now = matrix_of(step * (place * STEPS - row)) @ self.turned[row]
        back = (_orthonormal(self.views[0] * (1 - place) + self.views[1] * place) @ now).T
        first, second = self.paints
        return Turned(first, self.views[0] @ back), Turned(second, self.views[1] @ self.turned[-1] @ back)


def matrix_of(vector: ArrayLike) -> Floats:
    """Rotation (3, 3) by a vector (3,) rad."""
    return np.asarray(cv2.Rodrigues(np.asarray(vector, dtype=np.float64))[0], dtype=np.float64)


def vector_of(matrix: Floats) -> Floats:
    """The rotation vector (3,) rad of a matrix (3, 3)."""
    return np.asarray(cv2.Rodrigues(np.asarray(matrix, dtype=np.float64))[0][:, 0], dtype=np.float64)


def _orthonormal(matrix: Floats) -> Floats:
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ v, dtype=np.float64)


def view_at(camera: Camera, xyz: Floats) -> Floats:
    """(3, 3) the table's axes to the view of a ball at (3,) m: right and down in the picture, and to the camera."""
    seen = camera.matrix[:, :3] @ xyz + camera.matrix[:, 3]
    px = seen[:2] / seen[2]
    jacobian = (camera.matrix[:2, :3] - px[:, None] * camera.matrix[2, :3]) / seen[2]
    u, _, v = np.linalg.svd(jacobian)
    ahead = camera.eye - xyz
    return np.vstack([u @ v[:2], ahead / np.linalg.norm(ahead)])


def turns_of(trajectory: Trajectory, radius: float, ball: int, start: float, end: float) -> tuple[Floats, Floats]:
    """Times (STEPS + 1,) s, and how a ball of `radius` m has turned since the first: (STEPS + 1, 3, 3), table's axes.

    Where its spin is not known it is taken to roll.
    """
    t = np.linspace(start, end, STEPS + 1)
    state = trajectory.at((t[1:] + t[:-1]) / 2)
    v, w = state.v[:, ball], state.w[:, ball]
    rolls = np.column_stack([-v[:, 1], v[:, 0], np.zeros(len(v))]) / radius
    w = np.nan_to_num(np.where(np.isfinite(w), w, rolls))
    elapsed = np.diff(t if trajectory.clock is None else trajectory.clock.taken_at(t))
    turned = [np.eye(3)]
    for vector in w * elapsed[:, None]:
        turned.append(matrix_of(vector) @ turned[-1])
    return t, np.stack(turned)


def roll_between(paints: tuple[Paint, Paint], t: Floats, turned: Floats, views: Floats) -> Roll | None:
    """How a ball has turned between two sightings; None where that is little, or does not explain what changed on it.

    `turned` (STEPS + 1, 3, 3) is what the motion says for times t, `views` (2, 3, 3) the table's axes to both views.
    """
    said = views[0] @ turned[-1].T @ views[1].T
    if paints[0].radius < LEAST_RADIUS or np.linalg.norm(vector_of(said)) < LEAST_TURN:
        return None
    if max(paint.share for paint in paints) > MOST_MARKED:
        return None
    still = _cost(*_difference(*paints, np.eye(3)))
    if not still > CHANGED * _power(paints):
        return None
    cost, rotation = _sought(*paints, said)
    if np.isinf(cost):
        # nothing is seen in both: what is in one place on both is light, and what turned away is unlike what came
        paints = without_common(*paints)
        still = _cost(*_difference(*paints, np.eye(3)))
        if not still > UNLIKE * _power(paints):
            return None
    elif not cost < LEAST_GAIN * still:
        return None
    # what the motion did not know came about as the rest did: in proportion
    left = vector_of(views[1].T @ rotation.T @ views[0] @ turned[-1].T)
    # the trace of a small rotation's matrix tells its angle
    cosines = (np.einsum("sij,sij->s", turned[1:], turned[:-1]) - 1) / 2
    angles = np.concatenate([[0.0], np.cumsum(np.arccos(np.clip(cosines, -1, 1)))])
    shares = angles / angles[-1] if angles[-1] > 1e-3 else np.linspace(0, 1, len(t))
    mended = np.stack([matrix_of(left * share) @ now for share, now in zip(shares, turned, strict=True)])
    return Roll(t, mended, views, paints)


def _power(paints: tuple[Paint, Paint]) -> float:
    """Mean square of the marks on both sightings."""
    return sum(float((paint.marks[paint.disc[0]] ** 2).mean()) for paint in paints)


def _difference(first: Paint, second: Paint, rotation: Floats) -> tuple[Singles, Singles]:
    """(n, 3) how the first sighting's paint, turned, differs from the second's; and (n,) how far that is told.

    `rotation` (3, 3) takes the second's view to the first's.
    """
    disc, normal = second.disc
    n = normal[disc] @ rotation.T.astype(np.float32)
    x, y = n[:, 0][:, None], n[:, 1][:, None]
    made, seen = first.at(x, y)[:, 0], first.seen_at(x, y)[:, 0]
    return made - second.marks[disc], in_sight(n[:, 2], first.radius) * seen * second.seen[disc]


def _cost(difference: Singles, sure: Singles) -> float:
    """Mean squared difference; infinite where too little is seen in both sightings."""
    total = float(sure.sum())
    if total < LEAST_OVERLAP * len(sure):
        return np.inf
    return float((difference**2).mean(axis=1) @ sure) / total


def _sought(first: Paint, second: Paint, start: Floats) -> tuple[float, Floats]:
    """The least cost and the rotation (3, 3) near `start` by which the first looks most like the second."""
    best, away = start, np.zeros(3)
    difference, sure = _difference(first, second, best)
    cost = _cost(difference, sure)
    for _ in range(ROUNDS if np.isfinite(cost) else 0):
        moved = [_difference(first, second, matrix_of(NUDGE * axis) @ best)[0] for axis in np.eye(3)]
        root = np.sqrt(sure)[:, None]
        jacobian = np.stack([((m - difference) / NUDGE * root).ravel() for m in moved], axis=-1).astype(np.float64)
        left, prior = (difference * root).ravel().astype(np.float64), 3 * CORRELATED * cost / PRIOR**2
        normal = jacobian.T @ jacobian + (prior + 1e-6) * np.eye(3)
        step = -np.linalg.solve(normal, jacobian.T @ left + prior * away)
        tried = matrix_of(step) @ best
        there, known = _difference(first, second, tried)
        new = _cost(there, known)
        if not new < cost:
            break
        best, difference, sure, away, cost, before = tried, there, known, away + step, new, cost
        if new > 0.99 * before:
            break
    return cost, best


def rolled(cover: Singles, x: Singles, y: Singles, sides: Sequence[tuple[Turned, float]]) -> Singles:
    """A cover (h, w, 4) mixed from sightings with what is painted on the ball where it has rolled to.

    `x`, `y` (h, w) are places in radii from the centre. Each sighting comes with its weight, 1 in all.
    """
    radius = sides[0][0].paint.radius
    rho, flat = np.maximum(np.hypot(x, y), 1e-6), flat_of(radius)
    inward = np.minimum(flat / rho, 1).astype(np.float32)
    x, y = x * inward, y * inward
    normal = np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1)
    here, there, known = (np.zeros((*rho.shape, k), dtype=np.float32) for k in (3, 3, 1))
    for side, weight in sides:
        n = normal @ side.rotation.T.astype(np.float32)
        sure = in_sight(n[..., 2], radius)[..., None] * np.float32(weight)
        here += side.paint.at(x, y) * np.float32(weight)
        there += side.paint.at(np.ascontiguousarray(n[..., 0]), np.ascontiguousarray(n[..., 1])) * sure
        known += sure
    change = (there / np.maximum(known, 1e-3) - here) * np.minimum(known / LEAST_KNOWN, 1)
    change = np.where((rho > flat)[..., None], cv2.blur(change, RIM_BLUR), change)
    change *= np.clip((1 - rho) * radius / EDGE + 0.5, 0, 1)[..., None]
    made = cover.copy()
    made[..., :3] = np.clip(made[..., :3] + change, np.minimum(made[..., :3], 0), 255)
    return made
