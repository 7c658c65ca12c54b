"""Images with known balls: rendered scenes of kinds that training never uses, and the real footage with marks."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.detect_options import DetectOptions
from detectors.still_images import detect_in_still
from models.core.scene import Scene
from video.calibration.table_finder import calibrate_clip, calibrate_image
from video.io.clip import open_clip, read_frames
from video.io.video_options import CalibrateOptions
from video.rendering.pinhole_camera import look_at
from video.rendering.random_scene import HOLD_OUT_ELEVATION, RandomScene, generate_scene
from video.rendering.scene_renderer import build_view
from video.rendering.training_images import render_training_image

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
# Visible share of a rendered ball from which on it must be found.
LEAST_VISIBLE = 0.5
# Elevations of low broadcast cameras, where balls occlude each other, and of overhead cameras, degrees.
LOW_ELEVATION, HIGH_ELEVATION = (18.0, 25.0), (75.0, 88.0)
# Rendered images of one table; the detectors estimate the empty table from them too.
IMAGES_PER_SCENE = 3
# Frames of a clip from which the detectors estimate the empty table.
BACKGROUND_FRAMES = 9
# Stride of the scored carom frames.
CAROM_EVERY = 12
# The marks of the stills are measured from the corner of the first pixel, px.
MARK_OFFSET = 0.5


@dataclass(frozen=True)
class DetectorCase:
    """An image with its balls."""

    scene: Scene
    background_frames: list[tuple[int, NDArray[np.uint8]]]
    rgb: NDArray[np.uint8]
    frame: int
    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    streak: NDArray[np.float64]
    required: NDArray[np.bool_]
    """Balls that must be found; the others may be found."""
    complete: bool = True
    """Whether every other detection is a false positive."""


def render_cases(
    count: int, seed: int = 4242, elevation: tuple[float, float] = HOLD_OUT_ELEVATION
) -> Iterator[DetectorCase]:
    """Render `count` images of whole tables in hold-out scenes, 854 to 1920 px wide, between two camera elevations."""
    rng = np.random.default_rng(seed)
    for number in range(0, count, IMAGES_PER_SCENE):
        width = (854, 1280, 1920)[number // IMAGES_PER_SCENE % 3]
        random_scene = place_camera(rng, generate_scene(rng, 160, hold_out=True), width, width * 9 // 16, elevation)
        view = build_view(
            random_scene.table,
            random_scene.camera,
            random_scene.appearance,
            random_scene.balls,
            exposure=1.0,
            samples=1,
        )
        lab = cv2.cvtColor(np.array([[random_scene.appearance.cloth]], np.float32), cv2.COLOR_RGB2LAB)[0, 0].astype(
            np.float64
        )
        scene = Scene(random_scene.table, random_scene.camera, lab, ())
        shots = [render_training_image(rng, random_scene, view) for _ in range(IMAGES_PER_SCENE)]
        background_frames = [(k, shot.rgb) for k, shot in enumerate(shots)]
        for shot in shots:
            is_visible = shot.visible >= LEAST_VISIBLE
            yield DetectorCase(scene, background_frames, shot.rgb, 0, shot.centre, shot.radius, shot.streak, is_visible)


def place_camera(
    rng: np.random.Generator, random_scene: RandomScene, width: int, height: int, between: tuple[float, float]
) -> RandomScene:
    """Place a camera that shows the whole table, at an elevation between two values, degrees."""
    table = random_scene.table
    middle = np.array([table.length / 2, table.width / 2, 0.0])
    elevation = np.radians(rng.uniform(*between))
    side = float(rng.choice([-1.0, 1.0])) * np.pi / 2 + rng.uniform(-0.3, 0.3)
    away = np.array([np.cos(side) * np.cos(elevation), np.sin(side) * np.cos(elevation), np.sin(elevation)])
    distance = rng.uniform(1.6, 3.0) * table.length
    focal = 1.0
    for _ in range(2):  # the second pass makes the table as large as it fits
        camera = look_at(table, middle + distance * away, middle, focal * width, width, height)
        reach = np.abs(camera.corners_px - ((width - 1) / 2, (height - 1) / 2)) / (width / 2, height / 2)
        focal *= 0.9 / float(reach.max())
    return replace(random_scene, camera=look_at(table, middle + distance * away, middle, focal * width, width, height))


def read_still_cases() -> Iterator[DetectorCase]:
    """Read the labelled stills."""
    folder = DATA / "images"
    for entry in json.loads((folder / "labels.json").read_text())["images"]:
        rgb = cv2.cvtColor(cv2.imread(str(folder / entry["image"])), cv2.COLOR_BGR2RGB)
        scene = calibrate_image(rgb, CalibrateOptions(), entry["image"])
        centre = np.array([[ball["x_px"], ball["y_px"]] for ball in entry["balls"]]) - MARK_OFFSET
        yield DetectorCase(scene, [(0, rgb)], rgb, 0, centre, *_resting_marks(len(centre), 15.0))


# Ball class of a labelled colour, where it is not the name of the colour.
CLASS_OF_LABEL = {"WHITE": "cue"}


def match_still_classes(reach_px: float = 8.0) -> Iterator[tuple[str, str]]:
    """Return labelled and detected class of every coloured ball of the stills that `trueroll detect` finds."""
    folder = DATA / "images"
    for entry in json.loads((folder / "labels.json").read_text())["images"]:
        rgb = cv2.cvtColor(cv2.imread(str(folder / entry["image"])), cv2.COLOR_BGR2RGB)
        detections = detect_in_still(rgb, entry["image"], DetectOptions(), CalibrateOptions())
        for ball in entry["balls"]:
            gap = np.linalg.norm(detections.centre + MARK_OFFSET - [ball["x_px"], ball["y_px"]], axis=1)
            if ball.get("colour") and gap.min() < reach_px:
                yield CLASS_OF_LABEL.get(ball["colour"], ball["colour"].lower()), detections.kind[int(np.argmin(gap))]


def _resting_marks(count: int, radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    return np.full(count, radius), np.zeros((count, 2)), np.ones(count, dtype=bool)


def read_pool_cases() -> Iterator[DetectorCase]:
    """Read the first and the last frame of the broadcast clips."""
    for path in sorted((DATA / "billiards").glob("pool8_*.mp4")):
        truth = json.loads(path.with_suffix(".gt.json").read_text())["boxes"]
        clip = open_clip(path)
        scene = calibrate_clip(clip, CalibrateOptions())
        background_frames = list(read_frames(clip, indices=_select_evenly(clip.distinct_frames, BACKGROUND_FRAMES)))
        ends = (("first", int(clip.distinct_frames[0])), ("last", int(clip.distinct_frames[-1])))
        for name, frame in ends:
            [(_, rgb)] = list(read_frames(clip, indices=[frame]))
            boxes = np.array(truth[name], dtype=float)
            centre = boxes[:, :2] + (boxes[:, 2:4] - 1) / 2
            yield DetectorCase(
                scene,
                background_frames,
                rgb,
                frame,
                centre,
                boxes[:, 2:4].max(axis=1) / 2,
                np.zeros_like(centre),
                np.ones(len(boxes), bool),
            )


def read_carom_cases() -> Iterator[DetectorCase]:
    """Read every `CAROM_EVERY`-th marked frame of the three-cushion clips."""
    for path in sorted((DATA / "billiards").glob("carom_*.mp4")):
        truth = json.loads(path.with_suffix(".gt.json").read_text())["tracks"]
        clip = open_clip(path)
        scene = calibrate_clip(clip, CalibrateOptions())
        background_frames = list(read_frames(clip, indices=_select_evenly(clip.distinct_frames, BACKGROUND_FRAMES)))
        marks: dict[int, list[list[float]]] = {}
        for rows in truth.values():
            for row in rows:
                if row is not None and None not in row:
                    marks.setdefault(int(row[0]), []).append(row[1:3])
        full = {frame: np.array(places) for frame, places in marks.items() if len(places) == 3}
        frames = [frame for frame in sorted(full) if frame in set(clip.distinct_frames.tolist())][::CAROM_EVERY]
        for frame, rgb in read_frames(clip, indices=frames):
            yield DetectorCase(scene, background_frames, rgb, frame, full[frame], *_resting_marks(3, 6.5))


def _select_evenly(frames: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    return frames[np.unique(np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int))]
