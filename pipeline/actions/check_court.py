"""Check how a clip of a court is filmed: whether its lines are found, and how well a landing would be located."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from models.core.answer import Answer
from models.core.court_camera import CourtScene
from models.core.progress import ignore_progress
from models.core.typing import FloatArray, ImageArray
from pipeline.reporting.text.filming_sentences import LEVEL_SIGNS, VERDICT_WORDS, format_bounds
from pipeline.settings import DoorOptions
from pipeline.stages.read_stage import open_frame_memory
from video.drawing.masks import SHIFT, to_fixed_point
from video.drawing.palette import FLASH
from video.filming_check.measure_filming import Limit
from video.io.clip import Clip, open_clip, read_frames

# px, standard deviation of the place of a small object in a frame.
NOISE_PX = 0.7
# Points of a drawn line, which the lens may bend.
LINE_POINTS = 25
# Last good value and last one that is not bad. Lines: half the width of a distant painted line, and all of it. Place: a
# landing should be located to 5 cm, and at 15 cm most calls near a line are undecided. Size: an outline needs pixels on
# either side of its middle. Rate: at 20 frames per second a ball of 30 m/s moves 1.5 m from frame to frame.
LIMITS = {
    "lines": Limit(1.0, 3.0), "place": Limit(5.0, 15.0), "size": Limit(4.0, 2.0), "rate": Limit(45.0, 20.0),
}  # fmt: skip
WORDS = {
    "lines": ("painted lines off by", "px", "Film with less zoom, or a lens that bends straight lines less."),
    "place": ("error of a landing at the far end", "cm", "Film from higher up or nearer, at the full resolution."),
    "size": ("diameter of the {} at the far end", "px", "Go nearer, or use the full resolution."),
    "rate": ("distinct frames", "per s", "Choose 60 fps or more in the camera."),
}
VERDICTS = {"good": "go", "doubt": "doubts", "unknown": "doubts", "bad": "no-go"}


@dataclass(frozen=True, slots=True)
class CourtCheck:
    """How a clip of a court is filmed."""

    answer: Answer
    image: ImageArray
    """(H, W, 3) the first frame with the lines where the camera puts them."""


def check_court(path: Path, options: DoorOptions) -> CourtCheck:
    """Check how a clip of a court is filmed, in its longest view.

    Args:
        path: A video, or a folder of numbered images.
        options: Options of reading and of the court.

    Returns:
        Verdict and measurements.

    Raises:
        ClipError: The clip cannot be read, or shows no known court.
        OptionError: An option is not meaningful.
    """
    from video.calibration.court_finder import locate_court  # slow to import

    with open_frame_memory() as memory:
        clip = open_clip(path, fps=options.read.rate, aspect=options.read.aspect, memory=memory)
        if len(clip.views) > 1:
            clip = clip.extract_subclip(*max(clip.views.tolist(), key=lambda view: view[1] - view[0]))
        scene = locate_court(clip, options.court.sport, options.court.corners, ignore_progress)
        ((_, image),) = read_frames(clip, indices=clip.frames[:1])
    values = measure_court(clip, scene)
    levels = {code: LIMITS[code].grade(value) for code, value in values.items()}
    worst = max(levels.values(), key=lambda level: ("good", "unknown", "doubt", "bad").index(level))
    name, sport = scene.sport.object.name, scene.sport
    rows = [
        (LEVEL_SIGNS[levels[code]], words.format(name), f"{values[code]:.1f} {unit}", format_bounds(LIMITS[code]))
        for code, (words, unit, _) in WORDS.items()
    ]
    advice = [WORDS[code][2] for code, level in levels.items() if level in ("doubt", "bad")]
    verdict = VERDICTS[worst]
    court = (
        f"{sport.name}: a court of {sport.length:g} x {sport.width:g} m, seen from {scene.camera.centre[2]:.1f} m up."
    )
    document = {
        "verdict": verdict, "sentences": [VERDICT_WORDS[verdict], court, *advice], "sport": sport.name,
        "camera": scene.camera.centre, "refusal": "",
        "faults": [code for code, level in levels.items() if level in ("doubt", "bad")],
        "measurements": [
            {"code": code, "value": value, "unit": WORDS[code][1], "level": levels[code], "good": LIMITS[code].good,
             "bad": LIMITS[code].bad}
            for code, value in values.items()
        ],
    }  # fmt: skip
    answer = Answer(
        "How is this court filmed?", (VERDICT_WORDS[verdict], court), verdict,
        rows=(("", "", "measured", "good"), *rows), notes=tuple(f"- {one}" for one in advice), document=document,
    )  # fmt: skip
    return CourtCheck(answer, draw_court_lines(image, scene, int(clip.frames[0])))


def measure_court(clip: Clip, scene: CourtScene) -> dict[str, float]:
    """Measure a view of a court, by the codes of `LIMITS`."""
    sport, camera = scene.sport, scene.camera
    corners = np.column_stack([sport.corners, np.zeros(4)])
    far = corners[np.argmax(np.linalg.norm(corners - camera.centre, axis=1))] * [1, 0, 1] + [0, sport.width / 2, 0]
    distance = float(np.linalg.norm(far - camera.centre))
    size = 2 * sport.object.radius * math.exp(float(camera.parameters[6])) / distance
    return {
        "lines": scene.line_error,
        "place": 100 * estimate_place_error(scene, far),
        "size": size,
        "rate": float((~clip.is_duplicate).mean()) / float(np.median(np.diff(clip.t))),
    }


def estimate_place_error(scene: CourtScene, place: FloatArray) -> float:
    """Estimate the standard deviation, m, of a place (3,) on the surface along its least certain direction.

    It is made of the noise of a place in the image and of the covariance of the camera.
    """
    camera = scene.camera
    px = camera.to_pixels(place)
    by_px = np.stack([(camera.to_court(px + step) - camera.to_court(px - step))[:2] / 2 for step in np.eye(2)], axis=1)
    steps = np.sqrt(np.maximum(np.diag(camera.covariance), 1e-18)) / 10
    moved = [
        [camera.replace_parameters(camera.parameters + sign * step * axis).to_court(px)[:2] for sign in (1, -1)]
        for step, axis in zip(steps, np.eye(len(steps)), strict=True)
    ]
    by_camera = np.stack([(one - two) / (2 * step) for (one, two), step in zip(moved, steps, strict=True)], axis=1)
    covariance = NOISE_PX**2 * by_px @ by_px.T + by_camera @ camera.covariance @ by_camera.T
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def draw_court_lines(image: ImageArray, scene: CourtScene, frame: int) -> ImageArray:
    """Draw the painted lines onto a frame (H, W, 3) where the camera puts them."""
    drawn = image.copy()
    for line in scene.sport.lines:
        share = np.linspace(0, 1, LINE_POINTS)[:, None]
        along = (1 - share) * np.array([*line.start, 0.0]) + share * np.array([*line.end, 0.0])
        points = scene.camera.to_pixels(along, frame)
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) > 1:
            cv2.polylines(drawn, [to_fixed_point(points)], False, FLASH, 1, cv2.LINE_AA, SHIFT)
    return drawn
