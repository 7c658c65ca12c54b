"""Damage to the frames of a clip, which is then encoded again."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.stress_cases.detection_damage import NothingToDamage
from benchmarks.stress_cases.stress_chain import FittedShot
from models.core.typing import FloatArray
from video.io.clip import Clip, read_frames
from video.io.video_writer import VideoWriter

Image = NDArray[np.uint8]
FrameDamage = Callable[[int, Image], Image]

# Constant rate factors of x264: nearly lossless, and strong compression.
FINE_CRF, STRONG_CRF = 16, 39
TIME_BASE = Fraction(1, 90_000)
# Streak below which a ball counts as sharp, px.
LEAST_STREAK = 2.0
# Distances of a free place from all paths and cushions, in ball radii, and number of places to try.
FREE_RADII, CUSHION_RADII, PLACES = 5.0, 3.0, 400


def write_damaged_clip(name: str, clip: Clip, shot: FittedShot, folder: Path, rng: np.random.Generator) -> Path:
    """Write a damaged copy of a clip, with the same number of frames at the same times.

    Args:
        name: One of `VIDEO_DAMAGES`.
        shot: Its detections and tracks without damage.
        folder: Folder of the copy.
        rng: Chooses ball and place of a second ball.

    Returns:
        Path of the copy.
    """
    damage = VIDEO_DAMAGES[name](clip, shot, rng)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.mp4"
    if path.is_file():
        return path
    width, height = (clip.width // 2, clip.height // 2) if name == "half-size" else (clip.width, clip.height)
    crf = STRONG_CRF if name == "compression" else FINE_CRF
    with VideoWriter(path, width, height, clip.fps, crf=crf, time_base=TIME_BASE) as writer:
        for index, image in read_frames(clip, indices=np.arange(clip.frame_count)):
            writer.write(np.ascontiguousarray(damage(index, image)), float(clip.t[index]))
    return path


def halve_size(clip: Clip, shot: FittedShot, rng: np.random.Generator) -> FrameDamage:
    """Halve width and height, by the mean of four pixels."""

    def halve(index: int, image: Image) -> Image:
        height, width = image.shape[0] // 2, image.shape[1] // 2
        return np.asarray(cv2.resize(image[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA))

    return halve


def keep_frames(clip: Clip, shot: FittedShot, rng: np.random.Generator) -> FrameDamage:
    """Leave the frames as they are; the encoder does the damage."""
    return lambda index, image: image


def double_blur(clip: Clip, shot: FittedShot, rng: np.random.Generator) -> FrameDamage:
    """Blur every detected streak once more along itself by its own length, so that it is twice as long."""
    detections = shot.recording.detections
    length = np.linalg.norm(detections.streak, axis=1)
    blurred = {int(frame): np.flatnonzero((detections.frame == frame) & (length >= LEAST_STREAK))
               for frame in np.unique(detections.frame)}  # fmt: skip
    last = shot.recording.frame

    def blur(index: int, image: Image) -> Image:
        shown = int(last[np.searchsorted(last, index, side="right") - 1])  # duplicates show an earlier frame
        out = image.astype(np.float32)
        for row in blurred.get(shown, []):
            out = blur_streak(out, detections.centre[row], detections.streak[row], float(detections.radius[row]))
        return np.round(out).astype(np.uint8)

    return blur


def blur_streak(
    image: NDArray[np.float32], centre: FloatArray, streak: FloatArray, radius: float
) -> NDArray[np.float32]:
    """Blur an image (H, W, 3) along a streak (2,) px, within the capsule that the longer streak covers.

    Args:
        centre: (2,) px, middle of the streak.
        streak: (2,) px.
        radius: Radius of the ball, px.

    Returns:
        The blurred image.
    """
    size = 2 * int(np.ceil(np.linalg.norm(streak) / 2)) + 3
    kernel = np.zeros((size, size), np.float32)
    for step in np.linspace(-0.5, 0.5, 8 * size):
        x, y = np.floor(size / 2 + step * streak).astype(int)
        kernel[y, x] += 1 / (8 * size)
    mask = np.zeros(image.shape[:2], np.float32)
    ends = [tuple(int(v) for v in np.round(centre + sign * streak)) for sign in (-1, 1)]
    cv2.line(mask, ends[0], ends[1], 1.0, max(1, round(2.6 * radius)))
    mask = cv2.GaussianBlur(mask, (0, 0), 1.5)[..., None]
    return np.asarray(image * (1 - mask) + cv2.filter2D(image, -1, kernel) * mask, dtype=np.float32)


def add_second_ball(clip: Clip, shot: FittedShot, rng: np.random.Generator) -> FrameDamage:
    """Put a copy of a ball at rest onto a free place of the table, in every frame."""
    tracks, scene = shot.tracks, shot.recording.scene
    r, camera = scene.table.ball_radius, scene.camera
    sharp = tracks.is_observed & ~(np.linalg.norm(np.nan_to_num(tracks.streak), axis=2) > 0) & ~shot.fit.moving
    balls = [k for k, kind in enumerate(tracks.kinds) if sharp[:, k].any()]
    place = find_free_place(shot, rng)
    if not balls or place is None:
        raise NothingToDamage("no ball at rest, or no free place")
    ball = balls[int(rng.integers(len(balls)))]
    row = int(np.flatnonzero(sharp[:, ball])[0])
    source, frame = tracks.px[row, ball], int(tracks.frame[row])
    scale = float(camera.radius_px(place, r) / camera.radius_px(tracks.xy[row, ball], r))
    radius = float(tracks.radius_px[row, ball])
    image_of_ball = next(image for _, image in read_frames(clip, indices=[frame]))

    def paste(index: int, image: Image) -> Image:
        target = camera.to_pixels(place, r, index)
        return paste_ball(image, image_of_ball, source, target, scale, radius)

    return paste


def find_free_place(shot: FittedShot, rng: np.random.Generator) -> FloatArray | None:
    """Find a place (2,) m away from all detections, cushions and pockets; None if there is none."""
    recording, table = shot.recording, shot.recording.scene.table
    r = table.ball_radius
    detections = recording.detections
    seen = recording.scene.camera.to_table(detections.centre, r, detections.frame)
    margin = CUSHION_RADII * r
    for xy in rng.uniform([margin, margin], [table.length - margin, table.width - margin], (PLACES, 2)):
        near = [np.linalg.norm(places - xy, axis=1).min(initial=np.inf) for places in (seen, table.pocket_centres)]
        if min(near) > FREE_RADII * r:
            return np.asarray(xy)
    return None


def paste_ball(
    image: Image, source: Image, centre: FloatArray, target: FloatArray, scale: float, radius: float
) -> Image:
    """Copy a ball (radius px, at `centre` (2,) px of `source`) to `target` (2,) px of an image, `scale` times as large.

    Args:
        image: Image (H, W, 3).
        source: Image with the ball.
        centre: Place of the ball there.
        target: New place.
        scale: New radius over old one.
        radius: Old radius, px.

    Returns:
        The image with the copy, with a soft edge.
    """
    warp = np.array([[scale, 0, target[0] - scale * centre[0]], [0, scale, target[1] - scale * centre[1]]])
    moved = cv2.warpAffine(source, warp, image.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    away = np.hypot(x - target[0], y - target[1]) - 1.05 * scale * radius
    mask = np.clip(0.5 - away / 2, 0, 1)[..., None]
    return np.asarray(np.round(image * (1 - mask) + moved * mask), dtype=np.uint8)


# Damages by the name of the option.
VIDEO_DAMAGES: dict[str, Callable[[Clip, FittedShot, np.random.Generator], FrameDamage]] = {
    "half-size": halve_size,
    "compression": keep_frames,
    "blur": double_blur,
    "second-ball": add_second_ball,
}
