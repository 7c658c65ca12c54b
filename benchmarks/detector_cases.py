"""Pictures with known balls: drawn halls that training never shows, and the real footage with marks."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.options import DetectOptions
from detectors.still_images import balls_in_still
from models.core.scene import Scene
from video.calibration.table_finder import find_scene, scene_in_picture
from video.io.clip import open_clip, read_frames
from video.io.options import CalibrateOptions
from video.rendering.pinhole_camera import look_at
from video.rendering.random_hall import HELD_OUT_ELEVATION, Hall, random_hall
from video.rendering.scene_renderer import make_view
from video.rendering.training_images import filmed

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
LEAST_VISIBLE = 0.5
"""Share of a drawn ball that must be seen for it to be asked for."""
LOW_ELEVATION, HIGH_ELEVATION = (18.0, 25.0), (75.0, 88.0)
"""Cameras of low broadcasts, where balls hide each other, and from above; degrees over the horizon."""
PICTURES_PER_HALL = 3
"""Drawn pictures of one table, which the detectors learn the empty table from as well."""
LEARNT_FROM = 9
"""Pictures of a clip that the detectors learn the empty table from."""
CAROM_EVERY = 12
MARK_OFFSET = 0.5
"""The marks of the stills count from the corner of the first pixel."""


@dataclass(frozen=True)
class Case:
    """A picture with its balls; NaN in `streak` and 0 in `tolerance` mean: as usual."""

    scene: Scene
    learnt: list[tuple[int, NDArray[np.uint8]]]
    rgb: NDArray[np.uint8]
    frame: int
    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    streak: NDArray[np.float64]
    asked: NDArray[np.bool_]
    """balls that must be found; the others may be."""
    complete: bool = True
    """whether everything else that is found is wrong."""


def drawn_cases(count: int, seed: int = 4242, elevation: tuple[float, float] = HELD_OUT_ELEVATION) -> Iterator[Case]:
    """Whole tables in held-out halls, 854 to 1920 px wide, `count` pictures from cameras between two elevations."""
    rng = np.random.default_rng(seed)
    for number in range(0, count, PICTURES_PER_HALL):
        width = (854, 1280, 1920)[number // PICTURES_PER_HALL % 3]
        hall = whole_table(rng, random_hall(rng, 160, held_out=True), width, width * 9 // 16, elevation)
        view = make_view(hall.table, hall.camera, hall.look, hall.balls, exposure=1.0, samples=1)
        lab = cv2.cvtColor(np.array([[hall.look.cloth]], np.float32), cv2.COLOR_RGB2LAB)[0, 0].astype(np.float64)
        scene = Scene(hall.table, hall.camera, lab, ())
        shots = [filmed(rng, hall, view) for _ in range(PICTURES_PER_HALL)]
        learnt = [(k, shot.rgb) for k, shot in enumerate(shots)]
        for shot in shots:
            on = shot.visible >= LEAST_VISIBLE
            yield Case(scene, learnt, shot.rgb, 0, shot.centre, shot.radius, shot.streak, on)


def whole_table(rng: np.random.Generator, hall: Hall, width: int, height: int, between: tuple[float, float]) -> Hall:
    """The hall seen by a camera that shows all of the table, from between two elevations, degrees."""
    table = hall.table
    middle = np.array([table.length / 2, table.width / 2, 0.0])
    elevation = np.radians(rng.uniform(*between))
    side = float(rng.choice([-1.0, 1.0])) * np.pi / 2 + rng.uniform(-0.3, 0.3)
    away = np.array([np.cos(side) * np.cos(elevation), np.sin(side) * np.cos(elevation), np.sin(elevation)])
    distance = rng.uniform(1.6, 3.0) * table.length
    focal = 1.0
    for _ in range(2):  # the second time as large as it fits
        camera = look_at(table, middle + distance * away, middle, focal * width, width, height)
        reach = np.abs(camera.corners_px - ((width - 1) / 2, (height - 1) / 2)) / (width / 2, height / 2)
        focal *= 0.9 / float(reach.max())
    return replace(hall, camera=look_at(table, middle + distance * away, middle, focal * width, width, height))


def still_cases() -> Iterator[Case]:
    """The labelled stills."""
    folder = DATA / "images"
    for entry in json.loads((folder / "labels.json").read_text())["images"]:
        rgb = cv2.cvtColor(cv2.imread(str(folder / entry["image"])), cv2.COLOR_BGR2RGB)
        scene = scene_in_picture(rgb, CalibrateOptions(), entry["image"])
        centre = np.array([[ball["x_px"], ball["y_px"]] for ball in entry["balls"]]) - MARK_OFFSET
        yield Case(scene, [(0, rgb)], rgb, 0, centre, *_sharp(len(centre), 15.0))


KIND_OF_LABEL = {"WHITE": "cue"}
"""Kinds of the labelled colours of the stills, where not the colour's own name."""


def named_in_stills(reach_px: float = 8.0) -> Iterator[tuple[str, str]]:
    """Labelled and found kind of every ball of the stills that has a colour and is found, as `trueroll detect` does."""
    folder = DATA / "images"
    for entry in json.loads((folder / "labels.json").read_text())["images"]:
        rgb = cv2.cvtColor(cv2.imread(str(folder / entry["image"])), cv2.COLOR_BGR2RGB)
        found = balls_in_still(rgb, entry["image"], DetectOptions(), CalibrateOptions())
        for ball in entry["balls"]:
            gap = np.linalg.norm(found.centre + MARK_OFFSET - [ball["x_px"], ball["y_px"]], axis=1)
            if ball.get("colour") and gap.min() < reach_px:
                yield KIND_OF_LABEL.get(ball["colour"], ball["colour"].lower()), found.kind[int(np.argmin(gap))]


def _sharp(count: int, radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    return np.full(count, radius), np.zeros((count, 2)), np.ones(count, dtype=bool)


def pool_cases() -> Iterator[Case]:
    """First and last picture of the broadcast clips."""
    for path in sorted((DATA / "billiards").glob("pool8_*.mp4")):
        truth = json.loads(path.with_suffix(".gt.json").read_text())["boxes"]
        clip = open_clip(path)
        scene = find_scene(clip, CalibrateOptions())
        learnt = list(read_frames(clip, indices=_spread(clip.distinct, LEARNT_FROM)))
        ends = (("first", int(clip.distinct[0])), ("last", int(clip.distinct[-1])))
        for name, frame in ends:
            [(_, rgb)] = list(read_frames(clip, indices=[frame]))
            boxes = np.array(truth[name], dtype=float)
            centre = boxes[:, :2] + (boxes[:, 2:4] - 1) / 2
            yield Case(
                scene,
                learnt,
                rgb,
                frame,
                centre,
                boxes[:, 2:4].max(axis=1) / 2,
                np.zeros_like(centre),
                np.ones(len(boxes), bool),
            )


def carom_cases() -> Iterator[Case]:
    """Every so many pictures of the three-cushion clips."""
    for path in sorted((DATA / "billiards").glob("carom_*.mp4")):
        truth = json.loads(path.with_suffix(".gt.json").read_text())["tracks"]
        clip = open_clip(path)
        scene = find_scene(clip, CalibrateOptions())
        learnt = list(read_frames(clip, indices=_spread(clip.distinct, LEARNT_FROM)))
        marks: dict[int, list[list[float]]] = {}
        for rows in truth.values():
            for row in rows:
                if row is not None and None not in row:
                    marks.setdefault(int(row[0]), []).append(row[1:3])
        full = {frame: np.array(places) for frame, places in marks.items() if len(places) == 3}
        frames = [frame for frame in sorted(full) if frame in set(clip.distinct.tolist())][::CAROM_EVERY]
        for frame, rgb in read_frames(clip, indices=frames):
            yield Case(scene, learnt, rgb, frame, full[frame], *_sharp(3, 6.5))


def _spread(frames: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    return frames[np.unique(np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int))]
