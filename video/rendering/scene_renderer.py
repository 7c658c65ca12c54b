"""Renderer of synthetic images: a table with moving balls as a camera would record them, with exact truth.

    view = build_view(table, camera, appearance, balls, exposure=1 / 60)
    image = render_image(view, motion, t, np.random.default_rng(0))

`motion` returns the ball poses at any time. The exposure is an average in linear light over evenly spaced moments; with
a rolling shutter every row has its own middle. Lens blur, photon and read noise, and the sRGB curve follow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, reduce
from itertools import combinations

import cv2
import numpy as np

from models.core.scene import Camera, Table
from models.core.srgb import encode_srgb
from models.core.typing import Float32Array, FloatArray, ImageArray
from video.rendering.ball_shading import SHADOW_REACH_RADII, Illumination, RenderedBall, render_ball, shadow_factor
from video.rendering.pinhole_camera import Lens, make_lens, project_points
from video.rendering.player_props import Rod, draw_rods
from video.rendering.scene_appearance import BallAppearance, SceneAppearance
from video.rendering.table_rendering import EmptyTable, build_illumination, render_empty_table

# px, largest motion of the fastest ball between two moments of an exposure.
STEP_PX = 0.6
# Largest number of moments of an exposure.
MAX_MOMENTS = 40


@dataclass(frozen=True, slots=True)
class BallPoses:
    """Poses of N balls at one time, and the rods (cue, hand) that a player holds into the image."""

    xyz: FloatArray
    """(N, 3) m, centres; a ball at rest has z = radius; NaN for a ball that is not there."""
    rotation: FloatArray
    """(N, 3, 3) from the ball's frame to the table's axes."""
    rods: tuple[Rod, ...] = ()
    """Cue and hand, drawn over the balls."""


Motion = Callable[[float], BallPoses]


@dataclass(frozen=True, slots=True)
class SceneView:
    """A table, its balls and the camera that films them, with everything that is constant between images."""

    table: Table
    camera: Camera
    lens: Lens
    appearance: SceneAppearance
    balls: tuple[BallAppearance, ...]
    exposure: float
    """s."""
    readout: float
    """s from the first row to the last; lower rows are exposed later where > 0."""
    illumination: Illumination
    empty: EmptyTable
    overlay: ImageArray | None
    """(H, W, 4) sRGB and opacity, such as a scoreboard, blended over the finished image."""


def build_view(
    table: Table, camera: Camera, appearance: SceneAppearance, balls: tuple[BallAppearance, ...],
    exposure: float = 0.0, readout: float = 0.0, k1: float = 0.0, overlay: ImageArray | None = None, samples: int = 3,
) -> SceneView:  # fmt: skip
    """Build a view; the empty table is rendered once and reused.

    Args:
        appearance: colours, lamps, optics and noise.
        balls: N ball appearances.
        exposure: s.
        readout: s from the first row to the last.
        k1: radial distortion, see `Lens`.
        overlay: (H, W, 4) sRGB and opacity over the finished image.
        samples: rays per pixel and axis, which smooth the table's edges.

    Returns:
        The view.
    """
    lens, illumination = make_lens(camera, k1), build_illumination(table, appearance)
    empty = render_empty_table(table, camera, lens, appearance, illumination, samples)
    return SceneView(table, camera, lens, appearance, balls, exposure, readout, illumination, empty, overlay)


def render_image(view: SceneView, motion: Motion, t: float, rng: np.random.Generator) -> ImageArray:
    """Render an image as a camera would record it.

    Args:
        view: the scene.
        motion: poses of the balls at any time.
        t: s, middle of the exposure of the middle row.
        rng: source of the sensor noise.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    return apply_sensor_model(view, render_exposure(view, motion, t), rng)


def row_delay(view: SceneView, row: FloatArray | float) -> FloatArray:
    """Return the delay (s) of the middle of a row's exposure relative to that of the image."""
    return np.asarray(view.readout * (np.asarray(row) / (view.camera.height_px - 1) - 0.5))


def project_ball_centres(view: SceneView, motion: Motion, t: float) -> FloatArray:
    """Project ball centres at mid-exposure of the rows that contain them.

    Args:
        view: the scene.
        motion: poses of the balls at any time.
        t: s, middle of the exposure of the middle row.

    Returns:
        (N, 2) px; NaN for a ball that is not there.
    """
    px = project_points(view.camera, view.lens, motion(t).xyz)
    for _ in range(3 if view.readout else 0):
        for ball, row in enumerate(px[:, 1]):
            if np.isfinite(row):
                px[ball] = project_points(view.camera, view.lens, motion(t + float(row_delay(view, row))).xyz[ball])
    return px


def render_exposure(view: SceneView, motion: Motion, t: float) -> Float32Array:
    """Render the linear light (H, W, 3) that the sensor collects during the exposure around t."""
    # without readout all balls share the same moments: evaluate each once
    motion = lru_cache(maxsize=4 * MAX_MOMENTS)(motion)
    offsets = exposure_offsets(view, motion, t)
    centres = project_ball_centres(view, motion, t)
    delay = row_delay(view, np.nan_to_num(centres[:, 1], nan=0.0))
    poses = [[_ball_pose(motion(t + dt + d), i) for dt in offsets] for i, d in enumerate(delay)]
    velocity = [
        (_ball_pose(motion(t + d + 1e-4), i)[0] - _ball_pose(motion(t + d - 1e-4), i)[0]) / 2e-4
        for i, d in enumerate(delay)
    ]
    visible = [
        i for i in range(len(view.balls)) if np.isfinite(poses[i][0][0]).all() and np.isfinite(poses[i][-1][0]).all()
    ]
    moving = [i for i in visible if len(offsets) > 1 and np.linalg.norm(poses[i][0][0] - poses[i][-1][0]) > 1e-6]
    order = sorted(visible, key=lambda i: -float(np.linalg.norm(poses[i][0][0] - view.camera.position)))
    image = view.empty.image.copy()
    static = {i: _render_static_sprite(view, i, poses[i][0], centres[i]) for i in visible if i not in moving}
    for i in static:
        _cast_ball_shadow(image, view, poses[i][0][0], _ball_window(view, [poses[i][0][0]], SHADOW_REACH_RADII))
    background = image.copy() if moving else image
    for i in order:
        if i in static:
            _composite_sprite(image, static[i][1], static[i][0], (0, 0))
    for group, window in _group_overlapping_balls(view, {i: [p[0] for p in poses[i]] for i in moving}):
        image[window] = _average_exposure(view, background[window], window, group, order, poses, velocity, static)
    _draw_player(image, view, motion, t, offsets)
    return image


def exposure_offsets(view: SceneView, motion: Motion, t: float) -> FloatArray:
    """Return times (M,) relative to the middle of the exposure; a single one where nothing moves."""
    half = view.exposure / 2
    start, end = motion(t - half - abs(view.readout) / 2), motion(t + half + abs(view.readout) / 2)
    displacement = np.abs(
        project_points(view.camera, view.lens, end.xyz) - project_points(view.camera, view.lens, start.xyz)
    )
    longest = float(np.nanmax(displacement, initial=0.0))
    if longest < 1e-3 or half == 0:
        return np.zeros(1)
    count = int(np.clip(np.ceil(longest / STEP_PX), 3, MAX_MOMENTS))
    return (np.arange(count) + 0.5) / count * view.exposure - half


def _ball_pose(poses: BallPoses, ball: int) -> tuple[FloatArray, FloatArray]:
    return poses.xyz[ball], poses.rotation[ball]


Window = tuple[slice, slice]


def _ball_window(view: SceneView, positions: list[FloatArray], reach: float) -> Window:
    """Return the rows and columns that contain a ball at all `positions` (3,) with `reach` radii around it."""
    r = view.table.ball_radius
    box = np.array(
        [[dx, dy, dz] for dx in (-1, 1) for dy in (-1, 1) for dz in (-1.0 / max(reach, 1), 1 / max(reach, 1))]
    )
    corners = np.concatenate([position + reach * r * box for position in positions])
    px = project_points(view.camera, view.lens, corners)
    low, high = np.floor(px.min(axis=0)).astype(int) - 1, np.ceil(px.max(axis=0)).astype(int) + 2
    x0, y0 = np.clip(low, 0, [view.camera.width_px, view.camera.height_px])
    x1, y1 = np.clip(high, [x0, y0], [view.camera.width_px, view.camera.height_px])
    return slice(int(y0), int(y1)), slice(int(x0), int(x1))


def _group_overlapping_balls(view: SceneView, positions: dict[int, list[FloatArray]]) -> list[tuple[list[int], Window]]:
    """Group moving balls whose windows overlap; return each group with its window."""
    groups: list[tuple[list[int], Window]] = []
    for ball, positions_of_ball in positions.items():
        members, window = [ball], _ball_window(view, positions_of_ball, SHADOW_REACH_RADII)
        for other in [g for g in groups if _windows_overlap(g[1], window)]:
            groups.remove(other)
            members, window = members + other[0], _window_union(window, other[1])
        groups.append((members, window))
    windows = [window for _, window in groups]
    if any(_windows_overlap(*pair) for pair in combinations(windows, 2)):
        return [(sorted(positions), reduce(_window_union, windows))]
    return groups


def _windows_overlap(a: Window, b: Window) -> bool:
    return all(p.start < q.stop and q.start < p.stop for p, q in zip(a, b, strict=True))


def _window_union(a: Window, b: Window) -> Window:
    rows, columns = (slice(min(p.start, q.start), max(p.stop, q.stop)) for p, q in zip(a, b, strict=True))
    return rows, columns


def _render_sprite(
    view: SceneView, ball: int, pose: tuple[FloatArray, FloatArray], velocity: FloatArray, row: float, window: Window
) -> RenderedBall:
    """Render a ball in a window; each row is exposed at its own time."""
    centre = pose[0]
    if view.readout and np.any(velocity):
        rows = np.arange(window[0].start, window[0].stop, dtype=np.float64)
        delay = row_delay(view, rows) - row_delay(view, row)
        centre = centre + delay[:, None, None] * velocity
    rays = view.empty.rays[window]
    distance = float(np.linalg.norm(pose[0] - view.camera.position))
    return render_ball(
        view.balls[ball], view.illumination, rays, view.camera.position, view.empty.depth[window], centre,
        view.table.ball_radius, pose[1], distance * _pixel_angle(rays), view.appearance.gloss,
    )  # fmt: skip


def _pixel_angle(rays: Float32Array) -> float:
    """Return the mean side of a pixel, rad."""
    if min(rays.shape[:2]) < 2:
        return 1e-3
    across, down = rays[0, -1] - rays[0, 0], rays[-1, 0] - rays[0, 0]
    area = np.linalg.norm(np.cross(across, down)) / ((rays.shape[0] - 1) * (rays.shape[1] - 1))
    return float(np.sqrt(area))


def _render_static_sprite(
    view: SceneView, ball: int, pose: tuple[FloatArray, FloatArray], centre: FloatArray
) -> tuple[RenderedBall, Window]:
    window = _ball_window(view, [pose[0]], 1.1)
    return _render_sprite(view, ball, pose, np.zeros(3), float(centre[1]), window), window


def _cast_ball_shadow(
    patch: Float32Array, view: SceneView, position: FloatArray, window: Window, origin: tuple[int, int] = (0, 0)
) -> None:
    """Apply a ball's shadow to a patch of the image that starts at `origin`."""
    inside = _shift_window(window, origin)
    factor = shadow_factor(
        view.illumination, view.empty.light_share[window], view.empty.point[window], position, view.table.ball_radius
    )
    patch[inside] *= factor[..., None]


def _composite_sprite(patch: Float32Array, window: Window, sprite: RenderedBall, origin: tuple[int, int]) -> None:
    """Blend a rendered ball over a patch that starts at `origin`, within its bounds."""
    rows, columns = _shift_window(window, origin)
    top, left = max(-rows.start, 0), max(-columns.start, 0)
    part = patch[max(rows.start, 0) : max(rows.stop, 0), max(columns.start, 0) : max(columns.stop, 0)]
    alpha = sprite.alpha[top : top + part.shape[0], left : left + part.shape[1], None]
    part += (sprite.colour[top : top + part.shape[0], left : left + part.shape[1]] - part) * alpha


def _shift_window(window: Window, origin: tuple[int, int]) -> Window:
    rows, columns = (slice(s.start - o, s.stop - o) for s, o in zip(window, origin, strict=True))
    return rows, columns


def _average_exposure(
    view: SceneView, background: Float32Array, window: Window, group: list[int], order: list[int],
    poses: list[list[tuple[FloatArray, FloatArray]]], velocity: list[FloatArray],
    static: dict[int, tuple[RenderedBall, Window]],
) -> Float32Array:  # fmt: skip
    """Average the light of a window (h, w, 3) over the moments of the exposure; `background` has no balls yet."""
    origin, count = (window[0].start, window[1].start), len(poses[group[0]])
    total = np.zeros_like(background)
    for moment in range(count):
        patch = background.copy()
        for i in group:
            position = poses[i][moment][0]
            _cast_ball_shadow(patch, view, position, _ball_window(view, [position], SHADOW_REACH_RADII), origin)
        for i in order:
            if i in static and _windows_overlap(static[i][1], window):
                _composite_sprite(patch, static[i][1], static[i][0], origin)
            elif i in group:
                pose = poses[i][moment]
                row = float(project_points(view.camera, view.lens, pose[0])[1])
                ball_window = _ball_window(view, [pose[0]], 1.2)
                _composite_sprite(
                    patch, ball_window, _render_sprite(view, i, pose, velocity[i], row, ball_window), origin
                )
        total += patch
    return (total / count).astype(np.float32)


def _draw_player(image: Float32Array, view: SceneView, motion: Motion, t: float, offsets: FloatArray) -> None:
    """Draw cue and hand over the image, averaged over the moments of the exposure where they move."""
    ends = [motion(t + float(dt)).rods for dt in (offsets[0], offsets[-1])]
    if not ends[0] or not ends[1]:
        return
    ends_px = [project_points(view.camera, view.lens, rods[-1].b) for rods in ends]
    count = int(np.clip(np.ceil(np.linalg.norm(ends_px[1] - ends_px[0]) / 2), 1, 8))
    clean, total = image.copy(), np.zeros_like(image)
    for dt in np.linspace(offsets[0], offsets[-1], count) if count > 1 else (0.0,):
        image[:] = clean
        draw_rods(image, view.camera, view.lens, view.illumination, motion(t + float(dt)).rods)
        total += image
    image[:] = total / count


def apply_sensor_model(view: SceneView, light: Float32Array, rng: np.random.Generator) -> ImageArray:
    """Apply vignetting, lens blur, noise, the sRGB curve and the overlay.

    Args:
        view: the scene.
        light: (H, W, 3) linear light.
        rng: source of the sensor noise.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    appearance = view.appearance
    exposed = light * (appearance.brightness * _vignette_factor(view))[..., None]
    if appearance.blur_px:
        exposed = cv2.GaussianBlur(exposed, (0, 0), appearance.blur_px)
    if appearance.noise:
        # sRGB has slope 1.12 at the middle grey 0.2: photon noise is scaled to `noise` levels there
        sigma = appearance.noise / 255 / 1.12 * np.sqrt(0.08 + 0.92 * np.maximum(exposed, 0) / 0.2)
        exposed = exposed + sigma * rng.standard_normal(exposed.shape, dtype=np.float32)
    image = _SRGB_CURVE[(np.clip(exposed, 0, 1) * (len(_SRGB_CURVE) - 1) + 0.5).astype(np.int32)]
    if view.overlay is None:
        return image
    alpha = view.overlay[..., 3:].astype(np.float32) / 255
    return (image + (view.overlay[..., :3] - image.astype(np.float32)) * alpha + 0.5).astype(np.uint8)


def _vignette_factor(view: SceneView) -> Float32Array:
    """Return the share (H, W) of the light that the lens transmits."""
    height, width = view.camera.height_px, view.camera.width_px
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    share: Float32Array = (1 - view.appearance.vignette * (x**2 + y**2) / 2).astype(np.float32)
    return share


_SRGB_CURVE = (encode_srgb(np.linspace(0, 1, 4096)) * 255 + 0.5).astype(np.uint8)
