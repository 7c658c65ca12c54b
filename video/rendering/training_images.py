"""Training images for ball detectors, with exact truth: `generate_training_images(rng, count)`.

The renderer supplies geometry, light and exposures as integrals. This module adds clutter, the image processing of
cheap cameras, and compression.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, Float32Array, FloatArray
from video.rendering.random_scene import BallArrangement, RandomScene, arrange_balls, generate_scene
from video.rendering.scene_clutter import paint_backdrop, paint_caption, paint_halos, paint_players
from video.rendering.scene_renderer import (
    SceneView,
    apply_sensor_model,
    build_view,
    project_ball_centres,
    render_exposure,
)
from video.rendering.table_rendering import distance_outside_table

# px, side of a training image.
SIZE_PX = 160
# Visible class of a ball in a single image; its colour determines the rest.
APPEARANCE_CLASSES = ("white", "black", "coloured", "striped")
# Images rendered per scene, because the empty table costs more than the balls on it.
IMAGES_PER_SCENE = 6
# Share of scenes rendered at twice the size and scaled down, as the detector does with large balls.
MAGNIFIED_SHARE = 0.2
# Share of images in which a projector draws rings around balls.
HALO_SHARE = 0.08
# Relative change of a pixel's light above which an object in front hides the ball.
MIN_OCCLUSION_CHANGE = 0.25
# Sample points on a disc for its visible share.
DISC_SAMPLES = 61


@dataclass(frozen=True, slots=True)
class TrainingImage:
    """An image and the truth of its N balls."""

    rgb: ByteArray
    """(S, S, 3)"""
    centre: FloatArray
    """(N, 2) px at mid-exposure."""
    radius: FloatArray
    """(N,) px."""
    streak: FloatArray
    """(N, 2) px, displacement during the exposure."""
    appearance_class: NDArray[np.int64]
    """(N,) index into `APPEARANCE_CLASSES`."""
    visible: FloatArray
    """(N,) share of the disc at mid-exposure that is not hidden."""


def generate_training_images(rng: np.random.Generator, count: int, hold_out: bool = False) -> Iterator[TrainingImage]:
    """Generate training images with exact truth.

    Args:
        rng: source of randomness.
        count: number of images.
        hold_out: generate the hold-out set, with scenes of a kind that training excludes.

    Yields:
        The images.
    """
    count_so_far = 0
    while count_so_far < count:
        magnify = 2 if rng.random() < MAGNIFIED_SHARE else 1
        scene = generate_scene(rng, SIZE_PX, magnify, hold_out)
        view = build_view(scene.table, scene.camera, scene.appearance, scene.balls, exposure=1.0, samples=1)
        for _ in range(min(IMAGES_PER_SCENE, count - count_so_far)):
            yield render_training_image(rng, scene, view, magnify)
            count_so_far += 1


def render_training_image(
    rng: np.random.Generator, scene: RandomScene, view: SceneView, magnify: int = 1
) -> TrainingImage:
    """Render one image of a scene with random balls and clutter.

    Args:
        rng: source of randomness.
        view: its view with the empty table, `magnify` times larger than the result.
        magnify: factor by which the image is finally scaled down.

    Returns:
        The image and its truth.
    """
    arrangement = arrange_balls(rng, scene, magnify)
    view = replace(
        view,
        balls=tuple(scene.balls[i] for i in arrangement.look_index),
        empty=replace(view.empty, image=_render_backdrop(rng, scene, view, arrangement)),
    )
    light = render_exposure(view, arrangement.poses_at, 0.0)
    before = light.copy()
    paint_players(rng, light, scene, view.illumination)
    hidden = np.abs(light - before).max(axis=2) > MIN_OCCLUSION_CHANGE * (before.max(axis=2) + 0.01)
    rgb = _apply_camera(rng, view, light)
    centre, radius, streak = _project_balls(view, arrangement)
    visible = _measure_visible_share(view, arrangement, centre, radius, hidden)
    if magnify > 1:
        small = (rgb.shape[1] // magnify, rgb.shape[0] // magnify)
        rgb = np.asarray(cv2.resize(rgb, small, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        centre, radius, streak = (centre + 0.5) / magnify - 0.5, radius / magnify, streak / magnify
    return TrainingImage(rgb, centre, radius, streak, _classify_appearances(view), visible)


def _render_backdrop(
    rng: np.random.Generator, scene: RandomScene, view: SceneView, arrangement: BallArrangement
) -> Float32Array:
    """Return the empty table with clutter on the cloth and beside the table."""
    image = view.empty.image.copy()
    height, width = image.shape[:2]
    outside = distance_outside_table(scene.table, view.empty.point.reshape(-1, 3).astype(np.float64)).reshape(
        height, width
    )
    paint_backdrop(rng, image, scene, outside.astype(np.float32))
    if rng.random() < HALO_SHARE:
        paint_halos(rng, image, scene, arrangement.position[rng.random(len(arrangement.position)) < 0.6])
    return image


def _project_balls(view: SceneView, arrangement: BallArrangement) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return centres (N, 2), radii (N,) and streaks (N, 2) in px."""
    motion = arrangement.poses_at
    streak = project_ball_centres(view, motion, 0.5) - project_ball_centres(view, motion, -0.5)
    radius = view.camera.radius_px(arrangement.position, view.table.ball_radius)
    return project_ball_centres(view, motion, 0.0), np.asarray(radius, dtype=np.float64), streak


def _measure_visible_share(
    view: SceneView, arrangement: BallArrangement, centre: FloatArray, radius: FloatArray, hidden: NDArray[np.bool_]
) -> FloatArray:
    """Return the share (N,) of each disc inside the image that neither nearer balls nor players hide."""
    angles = np.arange(DISC_SAMPLES) * np.pi * (3 - np.sqrt(5.0))
    disc = np.sqrt((np.arange(DISC_SAMPLES) + 0.5) / DISC_SAMPLES)[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    points = centre[:, None] + radius[:, None, None] * disc  # (N, D, 2)
    height, width = hidden.shape
    x, y = np.rint(points[..., 0]).astype(int), np.rint(points[..., 1]).astype(int)
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    is_free = inside & ~hidden[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    xyz = np.column_stack([arrangement.position, np.full(len(centre), arrangement.radius)])
    depth = np.linalg.norm(xyz - view.camera.position, axis=1)
    covered = np.linalg.norm(points[:, :, None] - centre[None, None], axis=-1) < radius
    covered &= (depth[None] < depth[:, None])[:, None]
    return np.asarray((is_free & ~covered.any(axis=2)).mean(axis=1), dtype=np.float64)


def _classify_appearances(view: SceneView) -> NDArray[np.int64]:
    """Return the appearance class (N,) of each ball."""
    class_of_kind = {"cue": "white", "white": "white", "eight": "black", "black": "black", "stripe": "striped"}
    return np.array(
        [APPEARANCE_CLASSES.index(class_of_kind.get(ball.kind, "coloured")) for ball in view.balls], dtype=np.int64
    )


def _apply_camera(rng: np.random.Generator, view: SceneView, light: Float32Array) -> ByteArray:
    """Convert linear light to an image as a file stores it: white balance, sensor, processing, captions, coding."""
    gain = np.exp(rng.normal(0, 0.12, 3)).astype(np.float32)
    image = apply_sensor_model(view, np.asarray(light * gain, dtype=np.float32), rng)
    image = _post_process_image(rng, image)
    if rng.random() < 0.08:
        paint_caption(rng, image)
    return _compress_image(rng, image)


def _post_process_image(rng: np.random.Generator, image: ByteArray) -> ByteArray:
    """Change contrast, saturation and sharpness, as cameras and editors do."""
    levels = (np.arange(256) / 255.0) ** rng.uniform(0.7, 1.4)
    tone = np.clip(255 * (levels * rng.uniform(0.8, 1.1) + rng.uniform(-0.03, 0.08)), 0, 255).astype(np.uint8)
    image = np.asarray(cv2.LUT(image, tone), dtype=np.uint8)
    if rng.random() < 0.5:
        grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        share = rng.uniform(0.4, 1.6)
        image = np.asarray(cv2.addWeighted(image, share, grey, 1 - share, 0), dtype=np.uint8)
    if rng.random() < 0.3:
        amount = rng.uniform(0.2, 1.2)
        soft = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.8, 1.6))
        image = np.asarray(cv2.addWeighted(image, 1 + amount, soft, -amount, 0), dtype=np.uint8)
    elif rng.random() < 0.2:
        size = image.shape[1::-1]
        small = cv2.resize(image, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
        image = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
    return image


def _compress_image(rng: np.random.Generator, image: ByteArray) -> ByteArray:
    """Apply JPEG compression up to twice at different block offsets, which also represents video coding."""
    for _ in range(int(rng.choice([0, 1, 1, 1, 2]))):
        quality = int(np.clip(rng.normal(70, 22), 15, 97))
        shift = int(rng.integers(0, 8))
        padded = cv2.copyMakeBorder(image, shift, 0, shift, 0, cv2.BORDER_REFLECT)
        is_encoded, data = cv2.imencode(".jpg", padded, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if not is_encoded:
            raise RuntimeError("cv2 could not encode a JPEG image in memory")
        decoded = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
        image = np.ascontiguousarray(decoded[shift:, shift:])
    return image
