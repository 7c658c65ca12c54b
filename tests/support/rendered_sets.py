"""Rendered sets of pool balls with known numbers: films in which each ball turns, with the true tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from skimage.color import rgb2lab

from detectors.measurement.ball_paint import BallPaint, describe_balls, measure_paint, select_clear_frames
from models.core.ball_look import BallLook
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import ByteArray
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import Lamp, SceneAppearance, pool_ball
from video.rendering.scene_renderer import BallPoses, build_view, render_image

TABLE = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.170, True)
MIDDLE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
COLOURS = ("yellow", "blue", "red", "purple", "orange", "green", "maroon")
"""Colours of the numbers 1 to 7 as the renderer paints them."""
FRAMES = 6


@dataclass(frozen=True)
class RenderedSet:
    """A film of balls at rest that turn on the spot."""

    frames: tuple[tuple[int, ByteArray], ...]
    tracks: Tracks
    scene: Scene
    numbers: tuple[int, ...]

    def measure(self) -> BallPaint:
        """Measure the paint of the balls."""
        rows = select_clear_frames(self.tracks, TABLE.ball_radius)
        return measure_paint(self.frames, self.tracks, rows, self.scene)

    def describe(self) -> tuple[BallLook, ...]:
        """Describe the balls."""
        return describe_balls(self.measure(), self.tracks, "pool")


def render_set(
    numbers: Sequence[int],
    seed: int,
    cloth: tuple[float, float, float] = (0.13, 0.47, 0.68),
    light: tuple[float, float, float] = (1.0, 1.0, 1.0),
    brightness: float = 1.2,
) -> RenderedSet:
    """Render a film.

    Args:
        numbers: Numbers of the N balls; 0 is the cue ball.
        seed: Source of places, turns and noise.
        cloth: sRGB of the cloth, 0 to 1.
        light: Factors of red, green and blue in linear light.
        brightness: As in `SceneAppearance`.

    Returns:
        Images and true tracks, with the classes of the balls.
    """
    rng = np.random.default_rng(seed)
    count, radius = len(numbers), TABLE.ball_radius
    eye = MIDDLE + np.array([0.02, 0.02, 3.68])
    camera = look_at(TABLE, eye, MIDDLE, 0.8 * 1280 / TABLE.length * eye[2], 1280, 720, up=(0.0, -1.0, 0.0))
    lamps = tuple(Lamp((TABLE.length * (k + 0.5) / 3, TABLE.width / 2, 1.3), 0.16) for k in range(3))
    appearance = SceneAppearance(cloth=cloth, brightness=brightness, lamps=lamps, seed=seed)
    balls = tuple(pool_ball(number) for number in numbers)
    view = build_view(TABLE, camera, appearance, balls, samples=1)
    cells = rng.permutation(18)[:count]
    xy = np.column_stack([0.25 + 0.4 * (cells % 6), 0.2 + 0.42 * (cells // 6)]) + rng.uniform(-0.06, 0.06, (count, 2))
    xyz = np.column_stack([xy, np.full(count, radius)])
    gains = np.asarray(light)
    images = []
    for frame in range(FRAMES):
        poses = BallPoses(xyz, Rotation.random(count, rng).as_matrix())
        image = render_image(view, lambda _, poses=poses: poses, 0.0, rng)  # type: ignore[misc]
        levels = 255 * np.clip((image / 255.0) ** 2.2 * gains, 0, 1) ** (1 / 2.2)
        images.append((frame, np.rint(levels).astype(np.uint8)))
    cloth_lab = np.median(rgb2lab(images[0][1])[200:520, 300:1000].reshape(-1, 3), axis=0)
    scene = Scene(TABLE, camera, cloth_lab, ())
    px = camera.to_pixels(xy, radius)
    size = np.linalg.norm(camera.to_pixels(xy + np.array([radius, 0.0]), radius) - px, axis=1)
    ids = tuple(
        f"{ball.kind}-{k + 1}" if number % 8 else ball.kind
        for k, (number, ball) in enumerate(zip(numbers, balls, strict=True))
    )
    shape = (FRAMES, count)
    tracks = Tracks(
        np.arange(FRAMES), np.arange(FRAMES) / 30, ids, tuple(ball.kind for ball in balls),
        np.broadcast_to(xy, (*shape, 2)), np.broadcast_to(px, (*shape, 2)), np.full(shape, 1e-3), np.full(shape, 1e-3),
        np.zeros((*shape, 2)), np.broadcast_to(size, shape), np.zeros((count, 3)),
    )  # fmt: skip
    return RenderedSet(tuple(images), tracks, scene, tuple(numbers))


def name_as_person(number: int) -> set[str]:
    """Return the words by which a person may call a ball."""
    if number in (0, 8):
        return {"cue ball" if number == 0 else "black 8"}
    colour = COLOURS[(number - 1) % 8]
    words = {colour, "brown"} if colour == "maroon" else {colour}
    return {f"{word} {number}" for word in words} | ({f"{word} stripe" for word in words} if number > 8 else words)
