"""A staged shot with known pixels: lit balls with soft shadows on a mottled cloth, filmed from above."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np

from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray, ImageArray
from video.io.clip import Clip, open_clip
from video.io.video_writer import VideoWriter

WIDTH, HEIGHT, SCALE, MARGIN = 320, 200, 140.0, 30.0
"""px, px, px/m, px from the border to the noses."""
RADIUS = 0.0575
"""m: 8 px."""
IDS = ("cue", "red")
COLOURS = np.array([[240.0, 238.0, 225.0], [200.0, 40.0, 40.0]])
TABLE = Table("toy", "carom", 1.8, 0.95, RADIUS, 0.2, False)
RATE = 30


def scene(motion: FloatArray | None = None) -> Scene:
    """An orthogonal view from far above."""
    matrix = np.array([[SCALE, 0, 0, MARGIN], [0, SCALE, 0, MARGIN], [0, 0, -1e-9, 1.0]])
    corners = TABLE.corners * SCALE + MARGIN
    camera = Camera(matrix, WIDTH, HEIGHT, corners, np.eye(8), "cloth", 100.0, 1.0, motion)
    return Scene(TABLE, camera, np.array([45.0, -30.0, 10.0]), ())


def place(t: float) -> FloatArray:
    """Balls (2, 2) m: the cue ball rolls to the right at 0.9 m/s from 0.1 s on, the red one rests."""
    return np.array([[0.3 + 0.9 * max(0.0, t - 0.1), 0.45], [1.4, 0.25]])


def trajectory(seconds: float) -> Trajectory:
    """The motion of `place`."""
    position = np.zeros((3, 4, 2))
    position[0, 0], position[1, 0], position[2, 0] = [0.3, 0.45], [0.3, 0.45], [1.4, 0.25]
    position[1, 1] = [0.9, 0.0]
    return Trajectory(
        IDS, np.array([0, 0, 1]), np.array([0.0, 0.1, 0.0]), np.array([0.1, seconds, seconds]), position,
        np.zeros((3, 2, 3)), ("rest", "roll", "rest"), np.tile(np.eye(4) * 1e-8, (3, 1, 1)),
    )  # fmt: skip


def cloth() -> ImageArray:
    """The empty table: a gradient with soft mottling and a line."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    mottle = np.kron(rng.normal(0, 3, (HEIGHT // 8, WIDTH // 8)), np.ones((8, 8)))
    ground = np.stack([40 + x / 16, 110 + y / 10, 80 + x / 20], axis=-1) + mottle[..., None]
    ground[:, 150:152] *= 0.6
    return np.asarray(np.clip(ground, 0, 255), dtype=np.uint8)


def film(t: float, shown: tuple[int, ...] = (0, 1), rng: np.random.Generator | None = None) -> ImageArray:
    """The frame at time t."""
    picture = cloth().astype(float)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    for ball in shown:
        centre, radius = place(t)[ball] * SCALE + MARGIN, RADIUS * SCALE
        distance = np.hypot(x - centre[0], y - centre[1])
        picture *= (1 - 0.35 * np.exp(-((np.maximum(distance - radius, 0) / (0.35 * radius)) ** 2)))[..., None]
        shade = 1 - 0.5 * np.clip(distance / radius, 0, 1) ** 2
        mask = np.clip(radius + 0.5 - distance, 0, 1)[..., None]
        picture = picture * (1 - mask) + COLOURS[ball] * shade[..., None] * mask
    if rng is not None:
        picture += rng.normal(0, 1.0, picture.shape)
    return np.asarray(np.clip(np.rint(picture), 0, 255), dtype=np.uint8)


def tracks(times: FloatArray) -> Tracks:
    """The tracks of a perfect tracker."""
    xy = np.array([place(float(t)) for t in times])
    shape = xy.shape[:2]
    small = np.full(shape, 1e-4)
    lab = np.array([[94.0, 0.0, 5.0], [43.0, 60.0, 40.0]])
    return Tracks(
        np.arange(len(times)), times, IDS, ("cue", "red"), xy, xy * SCALE + MARGIN, small, small, np.zeros_like(xy),
        np.full(shape, RADIUS * SCALE), lab,
    )  # fmt: skip


def fit(times: FloatArray) -> Fit:
    """The result of a perfect fit, with the strike as its event."""
    one = np.ones(1)
    events = Events(
        ("strike",), 0.1 * one, 4e-4 * one, 0.1 * RATE * one, ("cue",), ("",), place(0.1)[:1], one, np.nan * one,
        np.nan * one, 0.9 * one,
    )  # fmt: skip
    shape = (len(times), 2)
    moving = np.column_stack([times >= 0.1, np.zeros(len(times), bool)])
    trust = Trust("green", ("all is well",))
    return Fit(events, trajectory(times[-1]), (), 1e-4, 1.0, np.zeros((*shape, 2)), moving, np.ones(shape, bool), trust)


def clip_in(folder: Path, pictures: int = 31, rate: int = RATE) -> Clip:
    """The shot as a video file."""
    rng = np.random.default_rng(5)
    path = folder / "staged.mp4"
    with VideoWriter(path, WIDTH, HEIGHT, Fraction(rate), crf=12, threads=1) as writer:
        for k in range(pictures):
            writer.write(film(k / rate, rng=rng))
    return open_clip(path)
