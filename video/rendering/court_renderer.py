"""Renderer of rallies: frames as a camera beside a court records them, with the truth of every frame.

    renderer = CourtRenderer(rng, rally, camera, look, view, t)  # others: further objects, for training
    for k in range(len(t)):
        image, truth = renderer.render_frame(k)

Things that move are layers of premultiplied colour and opacity: shadows, players, the object as the integral over the
exposure (in linear light), the net and the table before them, and captions. Noise, sharpening and a loss of resolution
follow. `models.core.court_camera` projects; the camera may turn and zoom from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.court_camera import CourtCamera
from models.core.scene import apply_homography
from models.core.typing import ByteArray, Float32Array, FloatArray
from video.rendering.court_background import paint_court
from video.rendering.court_players import Capsule, draw_capsules, draw_head, make_figure, pose_player
from video.rendering.court_scene import Colour, CourtLook, Outfit, RallyPath, View, sample_outfit, sample_tint

# Subdivision of pixels in the picture of the object.
FINE = 4
# px between two moments of the exposure, and their largest number.
STEP_PX, MAX_MOMENTS = 0.4, 160
# Moments at which a moving player is drawn.
PLAYER_MOMENTS = 3
# m: from the middle of a shuttle to the ends of cork and feathers, and their radii.
CORK, SKIRT, CORK_RADIUS, SKIRT_RADIUS = 0.040, 0.042, 0.013, 0.032
SHIFT = 4


@dataclass(frozen=True, slots=True, eq=False)
class FrameTruth:
    """What a frame shows: N objects, that of the rally first."""

    px: FloatArray
    """(N, 2) px, the objects at mid-exposure."""
    streak: FloatArray
    """(N, 2) px, their displacements during the exposure."""
    radius_px: FloatArray
    """(N,)"""
    shown: FloatArray
    """(N,) share of an object's light that nothing hides and that lies inside the frame."""
    contrast: FloatArray
    """(N,) largest difference that an object makes to a pixel, of 255 levels, before noise and coding."""
    players: FloatArray
    """(N, 4) px, left, top, right and bottom."""


@dataclass(slots=True, eq=False)
class _Layer:
    """Premultiplied colour and opacity (h, w, 4), 0 to 255, at a place (x, y) of the frame."""

    rgba: Float32Array
    x: int
    y: int
    distance: float
    """m from the camera."""
    is_behind_net: bool = False
    is_behind_table: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Bystander:
    """A person beside the court who shifts about, or runs to and fro."""

    feet: FloatArray
    outfit: Outfit
    facing: float
    pace: float
    phase: float
    habit: float

    def pose(self, t: float) -> list[Capsule]:
        turn = (0.3 + 2 * self.pace) * t + 2 * np.pi * self.phase
        is_runner = self.habit < 0.15
        reach = np.array([np.sin(turn / 2), np.cos(turn / 3), 0.0]) * (1.5 if is_runner else 0.08)
        step = (4 * turn, 0.3) if is_runner else (0.0, 0.0)
        hand = self.feet + reach + [0.3 * np.sin(turn), 0.2, 1.0 + 0.2 * np.sin(1.7 * turn)]
        crouch = 0.05 if is_runner else 0.3 + 0.3 * self.habit
        return make_figure(None, self.feet + reach, self.outfit, 2 * np.pi * self.facing, step, hand, crouch)


class CourtRenderer:
    """Renders the frames of a rally.

    Args:
        camera: with the motion of all frames, where it moves.
        t: (T,) s, times of the rally at the middles of the exposures.
        others: rallies of which only the objects and their shadows are drawn.
    """

    def __init__(
        self, rng: np.random.Generator, rally: RallyPath, camera: CourtCamera, look: CourtLook, view: View,
        t: FloatArray, others: Sequence[RallyPath] = (),
    ) -> None:  # fmt: skip
        self._rng, self._rally, self._camera, self._look, self.t = rng, rally, camera, look, t
        self._paths = (rally, *others)
        grid = np.meshgrid(np.arange(camera.width_px, dtype=np.float64), np.arange(camera.height_px))
        self._flat = camera.undistort(np.stack(grid, axis=-1))
        self._canvas = paint_court(rng, rally.sport, camera, look, view, self._find_box())
        self._warped: tuple[ByteArray, list[_Layer]] | None = None
        shape = (camera.height_px + 32, camera.width_px + 32, 3)
        self._noise = _make_noise(rng, shape, look.noise)
        self._boards = _make_captions(rng, camera, look)
        self._fans = [
            (p, sample_tint(rng, (0.1, 0.9), (0, 0.9)), rng.uniform(0.2, 2.5), rng.uniform(0, 6))
            for p in self._canvas.crowd
        ]
        self._people = [_Bystander(p, sample_outfit(rng), *rng.uniform(0, 1, 4)) for p in self._canvas.people]
        self._folds = [_make_folds(rng) for _ in rally.feet]

    def render_frame(self, k: int) -> tuple[ByteArray, FrameTruth]:
        """Render frame k (H, W, 3), sRGB."""
        base, fixed = self._warp(k)
        image = base.copy()
        projection = self._camera.matrix_of(self._frame(k))
        for place, colour, pace, phase in self._fans:
            self._draw_fan(image, projection, place, colour, float(np.sin(pace * self.t[k] * 3 + phase)))
        for person in self._people:
            draw_capsules(image, projection, person.pose(float(self.t[k])))
        players = [self._draw_player(projection, i, k) for i in range(len(self._rally.feet))]
        for _, shadow in players:
            _blend(image, shadow)
        for path in self._paths:
            self._cast_object_shadow(image, path, k)
        objects = [self._draw_object(path, k) for path in self._paths]
        sprites = {id(sprite): row for row, (_, sprite) in enumerate(objects) if sprite is not None}
        drawn = [sprite for _, sprite in objects if sprite is not None]
        order = sorted([*(layer for layer, _ in players), *fixed, *drawn], key=_depth_key) + self._boards
        shown, contrast = np.zeros((2, len(objects)))
        for place, layer in enumerate(order):
            row = sprites.get(id(layer))
            if row is None:
                _blend(image, layer)
                continue
            contrast[row] = _blend_light(image, layer)
            light = layer.rgba[..., 3] * _inside(layer, image.shape)
            for nearer in order[place + 1 :]:
                _hide(light, layer, nearer)
            shown[row] = light.sum() / max(layer.rgba[..., 3].sum(), 1e-6)
        boxes = np.array([[p.x, p.y, p.x + p.rgba.shape[1], p.y + p.rgba.shape[0]] for p, _ in players], np.float64)
        px, streak, radius = (np.array(column) for column in zip(*(truth for truth, _ in objects), strict=True))
        return self._finish(image), FrameTruth(px, streak, radius, shown, contrast, boxes)

    def _find_box(self) -> FloatArray:
        """Return left, top, right and bottom of what all frames show, in undistorted pixels of the reference image."""
        edge = np.concatenate([self._flat[0], self._flat[-1], self._flat[:, 0], self._flat[:, -1]])
        if self._camera.motion is not None:
            edge = np.concatenate([apply_homography(np.linalg.inv(m), edge[::8]) for m in self._camera.motion])
        return np.concatenate([edge.min(0), edge.max(0)])

    def _warp(self, k: int) -> tuple[ByteArray, list[_Layer]]:
        """Warp the canvases to frame k: the background, and the layers of table and net."""
        if self._warped is not None and self._camera.motion is None:
            return self._warped
        inverse = np.eye(3) if self._camera.motion is None else np.linalg.inv(self._camera.motion[k])
        to_canvas = (self._canvas.from_reference @ inverse).astype(np.float64)
        maps = cv2.perspectiveTransform(self._flat.astype(np.float32), to_canvas)
        background = cv2.remap(self._canvas.background, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        sport, layers = self._rally.sport, []
        over, middle = sport.net.overhang, sport.length / 2
        table = [(x, y, z) for x in (0, sport.length) for y in (0, sport.width) for z in (0.0, sport.floor)]
        net = [(middle, y, z) for y in (-over, sport.width + over) for z in (0.0, sport.net.post_height)]
        for picture, corners, is_table in ((self._canvas.table, table, True), (self._canvas.net, net, False)):
            px = self._camera.to_pixels(np.array(corners), self._frame(k))
            low, high = self._bounds(np.where(np.isfinite(px), px, 1e5), 12.0, 0)
            part = maps[low[1] : high[1], low[0] : high[0]]
            if picture.size and part.size:
                rgba = cv2.remap(picture, part, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
                layers.append(_Layer(rgba.astype(np.float32), int(low[0]), int(low[1]), -1.0, not is_table, is_table))
        self._warped = (np.asarray(background, np.uint8), layers)
        return self._warped

    def _frame(self, k: int) -> int | None:
        """Return the index of a frame for `CourtCamera`; None where the camera does not move."""
        return None if self._camera.motion is None else k

    def _sides(self, points: FloatArray) -> tuple[bool, bool]:
        """Check whether places (n, 3) are behind the net, and behind or under the table, as the camera sees them."""
        sport, eye = self._rally.sport, self._camera.centre
        middle = sport.length / 2
        is_behind = bool((points[0, 0] - middle) * (eye[0] - middle) < 0)
        low = points[points[:, 2] < 0]
        if sport.floor == 0 or not len(low):
            return is_behind, False
        at = eye + (eye[2] / (eye[2] - low[:, 2:])) * (low - eye)
        on_table = (at[:, 0] > 0) & (at[:, 0] < sport.length) & (at[:, 1] > 0) & (at[:, 1] < sport.width)
        return is_behind, bool(on_table.any())

    def _draw_player(self, projection: FloatArray, player: int, k: int) -> tuple[_Layer, _Layer]:
        """Draw a player, and the shadow, as layers."""
        rally, look = self._rally, self._look
        outfit, half = look.outfits[player], look.exposure / 2
        gap = min((abs(s[0] - self.t[k]) for s in rally.strokes if s[1] == player), default=1.0)
        count = PLAYER_MOMENTS * 2 if gap < 0.12 and half > 1e-3 else (PLAYER_MOMENTS if half > 3e-3 else 1)
        moments = self.t[k] + half * np.linspace(-1, 1, 2 * count + 1)[1::2]
        poses = [pose_player(rally, player, outfit, float(t)) for t in moments]
        feet = np.array([*rally.feet_at(player, self.t[k])[:2], rally.sport.floor])
        ends = np.array(
            [end for body, head in poses for c in body for end in (c.a, c.b)]
            + [head.centre + s * head.axes[0] for _, head in poses for s in (-1, 1)]
        )
        bend = self._bend(k, feet + np.array([0, 0, 0.9]))
        # bodies are up to 0.2 m thick
        pad = (
            0.2
            * float(np.linalg.norm(projection[0, :3]))
            / max(float(projection[2, :3] @ feet + projection[2, 3]), 1.0)
        )
        low, high = self._bounds(_project(projection, ends) + bend, pad)
        size = (int(high[1] - low[1]), int(high[0] - low[0]))
        total = np.zeros((*size, 4), np.float32)
        for body, head in poses:
            window = np.zeros((*size, 4), np.uint8)
            draw_head(window, projection, head, low - bend)
            draw_capsules(window, projection, body, low - bend)
            total += window
        total = cv2.GaussianBlur(total / len(poses), (0, 0), max(look.blur, 0.4))
        total[..., :3] *= cv2.resize(self._folds[player], size[::-1], interpolation=cv2.INTER_LINEAR)[..., None]
        distance = float(np.linalg.norm(feet + np.array([0, 0, 1.0]) - self._camera.centre))
        behind = self._sides(np.array([[*feet[:2], rally.sport.floor + z] for z in (0.05, 0.4, 0.7)]))
        shadow = self._cast_shadow(projection, poses[len(poses) // 2][0], bend)
        return _Layer(total, int(low[0]), int(low[1]), distance, *behind), shadow

    def _cast_shadow(self, projection: FloatArray, body: list[Capsule], bend: FloatArray) -> _Layer:
        """Draw the shadow of a figure on the floor."""
        light, floor, black = self._look.light, self._rally.sport.floor, (0.0, 0.0, 0.0)
        drop = light / light[2]
        flat = [
            Capsule(c.a - (c.a[2] - floor) * drop, c.b - (c.b[2] - floor) * drop, c.radius_a, c.radius_b, black)
            for c in body
        ]
        ends = np.array([end for c in flat for end in (c.a, c.b)])
        low, high = self._bounds(_project(projection, ends) + bend, 12.0)
        window = np.zeros((int(high[1] - low[1]), int(high[0] - low[0]), 4), np.uint8)
        draw_capsules(window, projection, flat, low - bend)
        soft = 1.0 if self._look.shadow > 0.32 else 4.0
        rgba = cv2.GaussianBlur(window.astype(np.float32) * self._look.shadow, (0, 0), soft)
        return _Layer(rgba, int(low[0]), int(low[1]), 0.0)

    def _cast_object_shadow(self, image: ByteArray, rally: RallyPath, k: int) -> None:
        """Darken the surface below the object of a rally, in place."""
        sport, light = rally.sport, self._look.light
        place = rally.place_at(self.t[k : k + 1])[0][0]
        level = 0.0 if 0 <= place[0] <= sport.length and 0 <= place[1] <= sport.width else sport.floor
        height = place[2] - level
        # lamps of a finite size leave no shadow of a ball that is high
        share = self._look.shadow / (1 + (height / (3.0 if self._look.shadow > 0.32 else 0.5)) ** 2)
        if height < 0 or share < 0.02:
            return
        spot = place - height * light / light[2]
        frame = self._frame(k)
        rim = spot + sport.object.radius * np.array(
            [[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
        )
        rim[:, 2] = level
        px = self._camera.to_pixels(rim, frame)
        if not np.isfinite(px).all():
            return
        low, high = self._bounds(px, 6.0)
        if np.any(high <= low):
            return
        mask = np.zeros((high[1] - low[1], high[0] - low[0], 4), np.uint8)
        cv2.fillPoly(mask, [np.rint((px - low) * 2**SHIFT).astype(np.int32)], (0, 0, 0, 255), cv2.LINE_AA, SHIFT)
        _blend(
            image, _Layer(cv2.GaussianBlur(mask.astype(np.float32) * share, (0, 0), 1.0), int(low[0]), int(low[1]), 0.0)
        )

    def _draw_object(self, rally: RallyPath, k: int) -> tuple[tuple[FloatArray, FloatArray, float], _Layer | None]:
        """Draw the object of a rally over the exposure; also return its place (2,), streak (2,) and radius, px."""
        look, sport = self._look, rally.sport
        frame = self._frame(k)
        places, px, radius = locate_object(rally, self._camera, look, self.t[k], frame)
        truth = (px[1], px[2] - px[0], radius)
        middle = np.array([self._camera.width_px, self._camera.height_px]) / 2
        if not np.isfinite(px).all() or np.abs(px - middle).max() > 1.2 * self._camera.width_px:
            return truth, None
        travel = np.linalg.norm(px[1] - px[0]) + np.linalg.norm(px[2] - px[1])
        count = int(np.clip(np.ceil(travel / STEP_PX), 1, MAX_MOMENTS))
        moments = self.t[k] + look.exposure * ((np.arange(count) + 0.5) / count - 0.5)
        where, nose = rally.place_at(moments)
        path = self._camera.to_pixels(where, frame)
        pad = 2 * radius + 4
        low = np.floor(path.min(0) - pad).astype(int)
        size = np.ceil(path.max(0) + pad).astype(int) - low
        total = np.zeros((size[1] * FINE, size[0] * FINE), np.uint16 if count < 256 else np.int32)
        mask = np.zeros(total.shape, np.uint8)
        for i in range(count):
            mask[:] = 0
            self._draw_silhouette(mask, where[i], nose[i], path[i], low, radius, frame)
            total += mask
        light = total.astype(np.float32) / (255 * count)
        share = cv2.resize(light, (int(size[0]), int(size[1])), interpolation=cv2.INTER_AREA)
        share = cv2.GaussianBlur(share, (0, 0), max(look.blur, 0.4))
        if sport.name == "badminton":
            share *= look.opacity
        colour = 255 * np.array(look.object, np.float32) * np.float32(0.92)
        rgba = np.concatenate([share[..., None] * colour, 255 * share[..., None]], axis=-1)
        distance = float(np.linalg.norm(places[1] - self._camera.centre))
        return truth, _Layer(rgba.astype(np.float32), int(low[0]), int(low[1]), distance, *self._sides(places[1:2]))

    def _draw_silhouette(
        self, mask: ByteArray, place: FloatArray, nose: FloatArray, px: FloatArray, low: FloatArray, radius: float,
        frame: int | None,
    ) -> None:  # fmt: skip
        """Draw the outline of the object at one moment onto a fine mask, in place."""

        def fine(points: FloatArray) -> FloatArray:
            return np.asarray(((points - low + 0.5) * FINE - 0.5) * 2**SHIFT)

        if self._rally.sport.name != "badminton":
            centre = np.rint(fine(px)).astype(int)
            size = max(round((radius * FINE - 0.5) * 2**SHIFT), 1)
            cv2.circle(mask, centre.tolist(), size, 255, -1, cv2.LINE_AA, SHIFT)
            return
        nose = nose / max(float(np.linalg.norm(nose)), 1e-6)
        front, back = self._camera.to_pixels(np.stack([place + CORK * nose, place - SKIRT * nose]), frame)
        per_m = radius / self._rally.sport.object.radius
        axis = front - back
        length = float(np.linalg.norm(axis))
        length_share = np.clip(length / ((CORK + SKIRT) * per_m), 0, 1)
        along = axis / length if length > 1e-6 else np.array([1.0, 0.0])
        ring = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
        wide = (
            per_m
            * SKIRT_RADIUS
            * (ring[:, :1] * along * np.sqrt(1 - length_share**2) + ring[:, 1:] * np.array([-along[1], along[0]]))
        )
        # the open end is the largest part; shift it so that the middle of the silhouette is the place
        outline = np.concatenate([back + wide, front + per_m * CORK_RADIUS * ring]) + 0.12 * axis
        hull = cv2.convexHull(fine(outline).astype(np.float32))[:, 0]
        cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 255, cv2.LINE_AA, SHIFT)

    def _bend(self, k: int, place: FloatArray) -> FloatArray:
        """Return by how much (2,) px the lens moves what is seen at a place (3,); 0 behind the camera."""
        matrix = self._camera.matrix_of(self._frame(k))
        px = _project(matrix, place[None])
        return np.asarray(np.nan_to_num(self._camera.distort(px)[0] - px[0]))

    def _bounds(self, px: FloatArray, pad: float, margin: int = 40) -> tuple[FloatArray, FloatArray]:
        """Return the first pixel of a window that holds points (n, 2), and the one after its last."""
        size = np.array([self._camera.width_px, self._camera.height_px])
        good = px[np.isfinite(px).all(axis=1)]
        if not len(good):
            return np.zeros(2, np.int64), np.ones(2, np.int64)
        low = np.clip(np.floor(good.min(0) - pad), -margin, size).astype(np.int64)
        return low, np.clip(np.ceil(good.max(0) + pad), low + 1, np.maximum(size + margin, low + 1)).astype(np.int64)

    def _draw_fan(
        self, image: ByteArray, projection: FloatArray, place: FloatArray, colour: Colour, sway: float
    ) -> None:
        up = np.array([0.0, 0.0, 1.0])
        body = place + 0.1 * sway * np.array([0.3, 1.0, 0.2])
        arm = body + 0.1 * up + (0.35 + 0.15 * sway) * np.array([0.0, 0.4, 0.9])
        skin = (0.7, 0.55, 0.45)
        parts = [
            Capsule(place - 0.2 * up, body + 0.05 * up, 0.2, 0.18, colour),
            Capsule(body + 0.35 * up, body + 0.35 * up, 0.1, 0.1, skin),
        ]
        draw_capsules(image, projection, [*parts, Capsule(body + 0.1 * up, arm, 0.045, 0.04, skin)])

    def _finish(self, image: ByteArray) -> ByteArray:
        """Reduce the resolution, add noise, and sharpen."""
        look, (h, w) = self._look, image.shape[:2]
        if look.scale < 0.97:
            small = cv2.resize(image, None, fx=look.scale, fy=look.scale, interpolation=cv2.INTER_AREA)
            image = np.asarray(cv2.resize(small, (w, h), interpolation=cv2.INTER_LINEAR), np.uint8)
        y, x = self._rng.integers(0, 32, 2)
        more, less = (n[y : y + h, x : x + w] for n in self._noise)
        image = np.asarray(cv2.subtract(cv2.add(image, more), less), np.uint8)
        if look.sharpening > 0.05:
            soft = cv2.GaussianBlur(image, (0, 0), 1.2)
            image = np.asarray(cv2.addWeighted(image, 1 + look.sharpening, soft, -look.sharpening, 0), np.uint8)
        return image


_ANGLES = np.arange(12) * np.pi / 6


def locate_object(
    rally: RallyPath, camera: CourtCamera, look: CourtLook, t: float, frame: int | None
) -> tuple[FloatArray, FloatArray, float]:
    """Return places (3, 3), m, and pixels (3, 2) of the object during an exposure, and its radius, px.

    They are those at its begin, its middle and its end; `t` is its middle, s of the rally.
    """
    places, _ = rally.place_at(t + look.exposure * np.array([-0.5, 0.0, 0.5]))
    matrix = camera.matrix_of(frame)
    ahead = matrix[2, :3] / np.linalg.norm(matrix[2, :3])
    right = matrix[0, :3] - ahead * (ahead @ matrix[0, :3])
    px = camera.to_pixels(places, frame)
    beside = camera.to_pixels(places[1] + right / np.linalg.norm(right) * rally.sport.object.radius, frame)
    return places, px, float(np.linalg.norm(beside - px[1]))


def _project(projection: FloatArray, places: FloatArray) -> FloatArray:
    """Project places (n, 3) to undistorted pixels (n, 2); NaN behind the camera."""
    rays = places @ projection[:, :3].T + projection[:, 3]
    return np.asarray(rays[:, :2] / np.where(rays[:, 2:] > 0.2, rays[:, 2:], np.nan))


def _depth_key(layer: _Layer) -> tuple[int, float]:
    """Sort layers from back to front: what the table hides, the table, what the net hides, the net, the rest."""
    is_fixed = layer.distance < 0
    if layer.is_behind_table:
        return (1 if is_fixed else 0, -layer.distance)
    if layer.is_behind_net:
        return (3 if is_fixed else 2, -layer.distance)
    return 4, -layer.distance


def _overlap(layer: _Layer, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return the windows of a layer and of an image that coincide."""
    h, w = layer.rgba.shape[:2]
    y0, x0, y1, x1 = max(layer.y, 0), max(layer.x, 0), min(layer.y + h, shape[0]), min(layer.x + w, shape[1])
    y1, x1 = max(y1, y0), max(x1, x0)
    return (slice(y0 - layer.y, y1 - layer.y), slice(x0 - layer.x, x1 - layer.x)), (slice(y0, y1), slice(x0, x1))


def _blend(image: ByteArray, layer: _Layer) -> None:
    """Blend a layer over an image, in place."""
    own, there = _overlap(layer, image.shape)
    part = layer.rgba[own]
    if part.size:
        image[there] = np.rint(part[..., :3] + image[there] * (1 - part[..., 3:] / 255)).astype(np.uint8)


def _blend_light(image: ByteArray, layer: _Layer) -> float:
    """Blend a layer in linear light (a gamma of 2), in place; returns the largest change of a channel's level."""
    own, there = _overlap(layer, image.shape)
    part = layer.rgba[own]
    if not part.size:
        return 0.0
    share = part[..., 3:] / 255
    colour = layer.rgba[..., :3].sum((0, 1)) / max(float(layer.rgba[..., 3].sum()) / 255, 1e-6)
    before = image[there].astype(np.float32)
    after = np.sqrt(share * colour**2 + (1 - share) * before**2)
    image[there] = np.rint(np.clip(after, 0, 255)).astype(np.uint8)
    return float(np.abs(after - before).max())


def _hide(light: Float32Array, sprite: _Layer, layer: _Layer) -> None:
    """Reduce the light (h, w) of the object by the opacity of a layer before it, in place."""
    dx, dy = layer.x - sprite.x, layer.y - sprite.y
    h, w = layer.rgba.shape[:2]
    y0, x0, y1, x1 = max(dy, 0), max(dx, 0), min(dy + h, light.shape[0]), min(dx + w, light.shape[1])
    if y1 > y0 and x1 > x0:
        light[y0:y1, x0:x1] *= 1 - layer.rgba[y0 - dy : y1 - dy, x0 - dx : x1 - dx, 3] / 255


def _inside(sprite: _Layer, frame: tuple[int, ...]) -> Float32Array:
    """Return 1 for the pixels (h, w) of a layer that lie in a frame of a shape, else 0."""
    y, x = np.arange(sprite.rgba.shape[0]) + sprite.y, np.arange(sprite.rgba.shape[1]) + sprite.x
    return np.outer((y >= 0) & (y < frame[0]), (x >= 0) & (x < frame[1])).astype(np.float32)


def _make_noise(rng: np.random.Generator, shape: tuple[int, int, int], sigma: float) -> tuple[ByteArray, ByteArray]:
    """Make what noise adds to an image and what it takes away."""
    noise = cv2.GaussianBlur(rng.standard_normal(shape, np.float32), (0, 0), 0.6) * np.float32(2.1 * sigma)
    noise = np.rint(noise)
    return np.maximum(noise, 0).astype(np.uint8), np.maximum(-noise, 0).astype(np.uint8)


def _make_folds(rng: np.random.Generator) -> Float32Array:
    """Make the shading (h, w) of a body: folds of cloth, and light from above."""
    coarse, fine = (
        cv2.resize(rng.normal(0, s, (n * 2, n)).astype(np.float32), (64, 128), interpolation=cv2.INTER_CUBIC)
        for n, s in ((6, 0.08), (20, 0.06))
    )
    light = np.linspace(rng.uniform(1.0, 1.15), rng.uniform(0.75, 1.0), 128, dtype=np.float32)[:, None]
    side = np.linspace(rng.uniform(0.8, 1.0), rng.uniform(0.8, 1.0), 64, dtype=np.float32)[None]
    return np.asarray(np.clip((1 + coarse + fine) * light * side, 0.4, 1.0), np.float32)


def _make_captions(rng: np.random.Generator, camera: CourtCamera, look: CourtLook) -> list[_Layer]:
    """Make the scoreboard and the name of a channel."""
    if not look.has_board:
        return []
    layers, unit = [], camera.height_px / 720
    places = [(0.05, 0.85), (0.05, 0.05), (0.72, 0.05), (0.05, 0.05)]
    for x, y in [places[i] for i in rng.permutation(4)[: int(rng.integers(1, 3))]]:
        w, h = int(rng.uniform(150, 310) * unit), int(rng.uniform(34, 72) * unit)
        board = np.zeros((h, w, 4), np.uint8)
        alpha = int(255 * rng.choice([1.0, 1.0, rng.uniform(0.5, 1.0), 0.0]))
        ground = [int(255 * c) for c in sample_tint(rng, (0.0, 0.4), (0, 0.9))]
        board[:] = [*(g * alpha // 255 for g in ground), alpha]
        for row in range(2):
            name = "".join(rng.choice(list("ABCDEFGHIKLMNOPRSTUVWZ"), int(rng.integers(4, 11))))
            style = (cv2.FONT_HERSHEY_SIMPLEX, 0.011 * h, (235, 235, 235, 255), max(1, round(h / 36)), cv2.LINE_AA)
            for share, word in ((0.05, name), (0.85, str(rng.integers(22)))):
                cv2.putText(board, word, (int(share * w), int(h * (0.42 + 0.48 * row))), *style)
        layers.append(_Layer(board.astype(np.float32), int(x * camera.width_px), int(y * camera.height_px), 0.0))
    return layers
