"""A renderer of scenes: pictures of a table with balls in motion, as a camera would have filmed them, with exact truth.

    view = make_view(table, camera, look, balls, exposure=1 / 60)
    picture = render_picture(view, motion, t, np.random.default_rng(0))

`motion` says where the balls are at any time. The exposure is an average in linear light over moments spread evenly
through it; every row has its own middle where the sensor reads out row by row. Then come the lens' blur, noise of
photons and of reading, and the sRGB curve.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.scene import Camera, Table
from models.core.typing import Float32Array, FloatArray, ImageArray
from video.rendering.ball_shading import SHADOW_REACH, Light, Sprite, ball_sprite, shadow
from video.rendering.pinhole_camera import Lens, lens_of, project
from video.rendering.player_props import Rod, draw_rods
from video.rendering.scene_appearance import BallLook, Look
from video.rendering.table_rendering import EmptyTable, make_empty_table, make_light

STEP_PX = 0.6
"""px that the fastest ball moves between two moments of an exposure."""
MOST_MOMENTS = 40


@dataclass(frozen=True, slots=True)
class Poses:
    """N balls at one time, and what a player holds into the picture."""

    xyz: FloatArray
    """(N, 3) m, centres; a ball at rest has z = radius; NaN is not there."""
    rotation: FloatArray
    """(N, 3, 3) from the ball's frame to the table's axes."""
    rods: tuple[Rod, ...] = ()
    """cue and hand, drawn over the balls."""


Motion = Callable[[float], Poses]


@dataclass(frozen=True, slots=True)
class View:
    """A table, its balls and the camera that films them, with all that stays the same between pictures."""

    table: Table
    camera: Camera
    lens: Lens
    look: Look
    balls: tuple[BallLook, ...]
    exposure: float
    """s."""
    readout: float
    """s from the first row to the last; lower rows are later where > 0."""
    light: Light
    empty: EmptyTable
    overlay: ImageArray | None
    """(H, W, 4) sRGB and opacity, such as a scoreboard, laid over the finished picture."""


def make_view(
    table: Table, camera: Camera, look: Look, balls: tuple[BallLook, ...], exposure: float = 0.0, readout: float = 0.0,
    k1: float = 0.0, overlay: ImageArray | None = None, samples: int = 3,
) -> View:  # fmt: skip
    """Render the empty table once and keep it.

    `k1` is the lens error of `renderer_camera.Lens`; `samples` per pixel and axis smooth the table's edges.
    """
    lens, light = lens_of(camera, k1), make_light(table, look)
    empty = make_empty_table(table, camera, lens, look, light, samples)
    return View(table, camera, lens, look, balls, exposure, readout, light, empty, overlay)


def render_picture(view: View, motion: Motion, t: float, rng: np.random.Generator) -> ImageArray:
    """The picture (H, W, 3) RGB whose middle row's exposure is centred on t, s."""
    return develop(view, expose(view, motion, t), rng)


def row_delay(view: View, row: FloatArray | float) -> FloatArray:
    """s by which the middle of a row's exposure comes after that of the picture."""
    return np.asarray(view.readout * (np.asarray(row) / (view.camera.height_px - 1) - 0.5))


def seen_centres(view: View, motion: Motion, t: float) -> FloatArray:
    """Where the balls' centres (N, 2) px are seen at mid-exposure of the rows that they are in."""
    px = project(view.camera, view.lens, motion(t).xyz)
    for _ in range(3 if view.readout else 0):
        for ball, row in enumerate(px[:, 1]):
            if np.isfinite(row):
                px[ball] = project(view.camera, view.lens, motion(t + float(row_delay(view, row))).xyz[ball])
    return px


def expose(view: View, motion: Motion, t: float) -> Float32Array:
    """Linear light (H, W, 3) gathered by the sensor during the exposure around t."""
    # without readout all balls share their moments: ask for each once
    motion = lru_cache(maxsize=4 * MOST_MOMENTS)(motion)
    offsets = moments(view, motion, t)
    centres = seen_centres(view, motion, t)
    delay = row_delay(view, np.nan_to_num(centres[:, 1], nan=0.0))
    poses = [[_pose(motion(t + dt + d), i) for dt in offsets] for i, d in enumerate(delay)]
    speed = [
        (_pose(motion(t + d + 1e-4), i)[0] - _pose(motion(t + d - 1e-4), i)[0]) / 2e-4 for i, d in enumerate(delay)
    ]
    shown = [
        i for i in range(len(view.balls)) if np.isfinite(poses[i][0][0]).all() and np.isfinite(poses[i][-1][0]).all()
    ]
    moving = [i for i in shown if len(offsets) > 1 and np.linalg.norm(poses[i][0][0] - poses[i][-1][0]) > 1e-6]
    order = sorted(shown, key=lambda i: -float(np.linalg.norm(poses[i][0][0] - view.camera.eye)))
    picture = view.empty.picture.copy()
    still = {i: _still(view, i, poses[i][0], centres[i]) for i in shown if i not in moving}
    for i in still:
        _dim(picture, view, poses[i][0][0], _window(view, [poses[i][0][0]], SHADOW_REACH))
    ground = picture.copy() if moving else picture
    for i in order:
        if i in still:
            _lay(picture, still[i][1], still[i][0], (0, 0))
    for group, window in _groups(view, {i: [p[0] for p in poses[i]] for i in moving}):
        picture[window] = _average(view, ground[window], window, group, order, poses, speed, still)
    _draw_player(picture, view, motion, t, offsets)
    return picture


def moments(view: View, motion: Motion, t: float) -> FloatArray:
    """Times (M,) relative to the middle of the exposure; one where nothing moves."""
    half = view.exposure / 2
    start, end = motion(t - half - abs(view.readout) / 2), motion(t + half + abs(view.readout) / 2)
    way = np.abs(project(view.camera, view.lens, end.xyz) - project(view.camera, view.lens, start.xyz))
    longest = float(np.nanmax(way, initial=0.0))
    if longest < 1e-3 or half == 0:
        return np.zeros(1)
    count = int(np.clip(np.ceil(longest / STEP_PX), 3, MOST_MOMENTS))
    return (np.arange(count) + 0.5) / count * view.exposure - half


def _pose(poses: Poses, ball: int) -> tuple[FloatArray, FloatArray]:
    return poses.xyz[ball], poses.rotation[ball]


Window = tuple[slice, slice]


def _window(view: View, places: list[FloatArray], reach: float) -> Window:
    """Rows and columns that hold a ball at all `places` (3,) with `reach` radii around it."""
    r = view.table.ball_radius
    box = np.array(
        [[dx, dy, dz] for dx in (-1, 1) for dy in (-1, 1) for dz in (-1.0 / max(reach, 1), 1 / max(reach, 1))]
    )
    corners = np.concatenate([place + reach * r * box for place in places])
    px = project(view.camera, view.lens, corners)
    low, high = np.floor(px.min(axis=0)).astype(int) - 1, np.ceil(px.max(axis=0)).astype(int) + 2
    x0, y0 = np.clip(low, 0, [view.camera.width_px, view.camera.height_px])
    x1, y1 = np.clip(high, [x0, y0], [view.camera.width_px, view.camera.height_px])
    return slice(int(y0), int(y1)), slice(int(x0), int(x1))


def _groups(view: View, places: dict[int, list[FloatArray]]) -> list[tuple[list[int], Window]]:
    """Moving balls joined where their windows overlap, with the window of each group."""
    groups: list[tuple[list[int], Window]] = []
    for ball, way in places.items():
        members, window = [ball], _window(view, way, SHADOW_REACH)
        for other in [g for g in groups if _overlap(g[1], window)]:
            groups.remove(other)
            members, window = members + other[0], _union(window, other[1])
        groups.append((members, window))
    return groups if not _clash(groups) else [(sorted(places), _all(groups))]


def _clash(groups: list[tuple[list[int], Window]]) -> bool:
    return any(_overlap(a[1], b[1]) for i, a in enumerate(groups) for b in groups[:i])


def _all(groups: list[tuple[list[int], Window]]) -> Window:
    window = groups[0][1]
    for _, other in groups[1:]:
        window = _union(window, other)
    return window


def _overlap(a: Window, b: Window) -> bool:
    return all(p.start < q.stop and q.start < p.stop for p, q in zip(a, b, strict=True))


def _union(a: Window, b: Window) -> Window:
    rows, columns = (slice(min(p.start, q.start), max(p.stop, q.stop)) for p, q in zip(a, b, strict=True))
    return rows, columns


def _sprite(
    view: View, ball: int, pose: tuple[FloatArray, FloatArray], velocity: FloatArray, row: float, window: Window
) -> Sprite:
    """Ball in a window, every row at its own time."""
    centre = pose[0]
    if view.readout and np.any(velocity):
        rows = np.arange(window[0].start, window[0].stop, dtype=np.float64)
        late = row_delay(view, rows) - row_delay(view, row)
        centre = centre + late[:, None, None] * velocity
    rays = view.empty.rays[window]
    distance = float(np.linalg.norm(pose[0] - view.camera.eye))
    return ball_sprite(
        view.balls[ball], view.light, rays, view.camera.eye, view.empty.depth[window], centre,
        view.table.ball_radius, pose[1], distance * _pixel_angle(rays), view.look.gloss,
    )  # fmt: skip


def _pixel_angle(rays: Float32Array) -> float:
    """Mean side of a pixel, rad."""
    if min(rays.shape[:2]) < 2:
        return 1e-3
    across, down = rays[0, -1] - rays[0, 0], rays[-1, 0] - rays[0, 0]
    area = np.linalg.norm(np.cross(across, down)) / ((rays.shape[0] - 1) * (rays.shape[1] - 1))
    return float(np.sqrt(area))


def _still(view: View, ball: int, pose: tuple[FloatArray, FloatArray], centre: FloatArray) -> tuple[Sprite, Window]:
    window = _window(view, [pose[0]], 1.1)
    return _sprite(view, ball, pose, np.zeros(3), float(centre[1]), window), window


def _dim(patch: Float32Array, view: View, place: FloatArray, window: Window, origin: tuple[int, int] = (0, 0)) -> None:
    """Throw a ball's shadow into a patch of the picture that starts at `origin`."""
    inside = _shift(window, origin)
    factor = shadow(view.light, view.empty.share[window], view.empty.point[window], place, view.table.ball_radius)
    patch[inside] *= factor[..., None]


def _lay(patch: Float32Array, window: Window, sprite: Sprite, origin: tuple[int, int]) -> None:
    """Lay a sprite over a patch that starts at `origin`, as far as it reaches."""
    rows, columns = _shift(window, origin)
    top, left = max(-rows.start, 0), max(-columns.start, 0)
    part = patch[max(rows.start, 0) : max(rows.stop, 0), max(columns.start, 0) : max(columns.stop, 0)]
    alpha = sprite.alpha[top : top + part.shape[0], left : left + part.shape[1], None]
    part += (sprite.colour[top : top + part.shape[0], left : left + part.shape[1]] - part) * alpha


def _shift(window: Window, origin: tuple[int, int]) -> Window:
    rows, columns = (slice(s.start - o, s.stop - o) for s, o in zip(window, origin, strict=True))
    return rows, columns


def _average(
    view: View, ground: Float32Array, window: Window, group: list[int], order: list[int],
    poses: list[list[tuple[FloatArray, FloatArray]]], speed: list[FloatArray], still: dict[int, tuple[Sprite, Window]],
) -> Float32Array:  # fmt: skip
    """Mean light of a window (h, w, 3) over the moments of the exposure; `ground` has no balls yet."""
    origin, count = (window[0].start, window[1].start), len(poses[group[0]])
    total = np.zeros_like(ground)
    for moment in range(count):
        patch = ground.copy()
        for i in group:
            place = poses[i][moment][0]
            _dim(patch, view, place, _window(view, [place], SHADOW_REACH), origin)
        for i in order:
            if i in still and _overlap(still[i][1], window):
                _lay(patch, still[i][1], still[i][0], origin)
            elif i in group:
                pose = poses[i][moment]
                row = float(project(view.camera, view.lens, pose[0])[1])
                near = _window(view, [pose[0]], 1.2)
                _lay(patch, near, _sprite(view, i, pose, speed[i], row, near), origin)
        total += patch
    return (total / count).astype(np.float32)


def _draw_player(picture: Float32Array, view: View, motion: Motion, t: float, offsets: FloatArray) -> None:
    """Cue and hand over the picture, blurred by the moments of the exposure where they move."""
    ends = [motion(t + float(dt)).rods for dt in (offsets[0], offsets[-1])]
    if not ends[0] or not ends[1]:
        return
    tips = [project(view.camera, view.lens, rods[-1].b) for rods in ends]
    count = int(np.clip(np.ceil(np.linalg.norm(tips[1] - tips[0]) / 2), 1, 8))
    clean, total = picture.copy(), np.zeros_like(picture)
    for dt in np.linspace(offsets[0], offsets[-1], count) if count > 1 else (0.0,):
        picture[:] = clean
        draw_rods(picture, view.camera, view.lens, view.light, motion(t + float(dt)).rods)
        total += picture
    picture[:] = total / count


def develop(view: View, light: Float32Array, rng: np.random.Generator) -> ImageArray:
    """Linear light (H, W, 3) to the picture of a noisy sensor, with the overlay."""
    look = view.look
    exposed = light * (look.brightness * _falloff(view))[..., None]
    if look.blur_px:
        exposed = cv2.GaussianBlur(exposed, (0, 0), look.blur_px)
    if look.noise:
        # sRGB has slope 1.12 at the middle grey 0.2: photon noise is scaled to `noise` levels there
        sigma = look.noise / 255 / 1.12 * np.sqrt(0.08 + 0.92 * np.maximum(exposed, 0) / 0.2)
        exposed = exposed + sigma * rng.standard_normal(exposed.shape, dtype=np.float32)
    picture = _SRGB[(np.clip(exposed, 0, 1) * (len(_SRGB) - 1) + 0.5).astype(np.int32)]
    if view.overlay is None:
        return picture
    alpha = view.overlay[..., 3:].astype(np.float32) / 255
    return (picture + (view.overlay[..., :3] - picture.astype(np.float32)) * alpha + 0.5).astype(np.uint8)


def _falloff(view: View) -> Float32Array:
    """(H, W) share of the light that the lens lets through."""
    height, width = view.camera.height_px, view.camera.width_px
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    share: Float32Array = (1 - view.look.vignette * (x**2 + y**2) / 2).astype(np.float32)
    return share


def _srgb_curve(levels: int = 4096) -> ImageArray:
    x = np.linspace(0, 1, levels)
    y = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return (y * 255 + 0.5).astype(np.uint8)


_SRGB = _srgb_curve()
