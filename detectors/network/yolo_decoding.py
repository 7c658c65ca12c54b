"""Decoding of the boxes of the YOLO family; the shape of the output identifies the version.

v5 and v7: (1, 3 A, 5 + C), rows of x, y, w, h, objectness, classes; v8, v9 and v11: (1, 4 + C, A), columns of x, y, w,
h, classes; v10 and other exports with suppression built in: (1, n, 6), rows of x0, y0, x1, y1, score, class. A is the
number of cells at strides 8, 16 and 32. Coordinates are px of the letterboxed input.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.network.peak_decoding import APPEARANCES, NO_CANDIDATES, CandidateDetections
from models.core.typing import ByteArray, Float32Array, FloatArray

Layout = Literal["rows with objectness", "columns of classes", "rows of classes", "suppressed"]

STRIDES = (8, 16, 32)
BORDER_LEVEL = 114
"""Grey level of the border around an image that does not fill the input."""
MIN_SCORE = 0.1
MAX_OVERLAP = 0.5
"""Intersection over union of two boxes above which the weaker one is suppressed; touching balls overlap far less."""
COCO_CLASSES, COCO_BALL = 80, 32
MIN_STREAK_ASPECT = 1.35
"""Long over short side of a box from which its ball is a motion-blur streak."""
SIGMA_SHARE, SIGMA_PX = 0.05, 0.5
"""Standard deviation of the middle of a box: share of its size, and px of the input."""
_APPEARANCE_OF_WORD = (
    ("stripe", "striped"), ("cue", "white"), ("white", "white"), ("eight", "black"), ("black", "black"), ("8", "black"),
    ("solid", "coloured"), ("red", "coloured"), ("yellow", "coloured"), ("green", "coloured"), ("brown", "coloured"),
    ("blue", "coloured"), ("pink", "coloured"),
)  # fmt: skip
"""Appearance by words in the name of a class; the first match counts."""


@dataclass(frozen=True, slots=True)
class YoloClasses:
    """The C classes of a network."""

    balls: tuple[int, ...]
    """Classes that are balls; all of them if they have no names."""
    appearances: FloatArray
    """(C, 4) probabilities of `APPEARANCES`; NaN if the name names none."""


@dataclass(frozen=True, slots=True)
class Letterbox:
    """Placement of an image in the input: px of the input = scale * (px + 0.5) + margin - 0.5."""

    scale: float
    margin: tuple[float, float]
    """px left and above."""


def recognize_layout(shape: tuple[int, ...], side: tuple[int, int]) -> Layout | None:
    """Recognize the layout of an output of this shape, for an input of `side` (H, W) px; None for none of them."""
    if len(shape) != 3 or shape[0] != 1:
        return None
    cells = sum((side[0] // s) * (side[1] // s) for s in STRIDES)
    if shape[1] == 3 * cells and shape[2] > 5:
        return "rows with objectness"
    if shape[2] == cells and shape[1] > 4:
        return "columns of classes"
    if shape[1] == cells and shape[2] > 4:
        return "rows of classes"
    return "suppressed" if shape[2] == 6 and shape[1] < cells else None


def count_classes(shape: tuple[int, ...], layout: Layout) -> int:
    """Count the classes of an output; 0 if the shape does not show it."""
    return {
        "rows with objectness": shape[2] - 5,
        "columns of classes": shape[1] - 4,
        "rows of classes": shape[2] - 4,
        "suppressed": 0,
    }[layout]


def select_ball_classes(names: dict[int, str], count: int) -> YoloClasses:
    """Select the classes that are balls: by their names, COCO's sports ball, else all of them."""
    count = max(count, max(names, default=-1) + 1)
    if not names and count == COCO_CLASSES:
        return YoloClasses((COCO_BALL,), np.full((count, len(APPEARANCES)), np.nan))
    words = {number: name.lower() for number, name in names.items()}
    balls = tuple(n for n, word in words.items() if "ball" in word)
    if not balls:
        balls = tuple(n for n, word in words.items() if any(key in word for key, _ in _APPEARANCE_OF_WORD))
    looks = np.full((count, len(APPEARANCES)), np.nan)
    for number in balls:
        look = next((look for key, look in _APPEARANCE_OF_WORD if key in words[number]), None)
        if look is not None:
            looks[number] = [float(look == other) for other in APPEARANCES]
    return YoloClasses(balls or tuple(range(count)), looks)


def letterbox_image(rgb: ByteArray, side: tuple[int, int]) -> tuple[Float32Array, Letterbox]:
    """Fit an image (h, w, 3) into the input (1, 3, H, W) in [0, 1], with a grey border."""
    h, w = rgb.shape[:2]
    scale = min(side[0] / h, side[1] / w)
    inner = (max(round(h * scale), 1), max(round(w * scale), 1))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    small = cv2.resize(rgb, inner[::-1], interpolation=way)
    top, left = (side[0] - inner[0]) // 2, (side[1] - inner[1]) // 2
    full = np.full((*side, 3), BORDER_LEVEL, np.uint8)
    full[top : top + inner[0], left : left + inner[1]] = small
    letterbox = Letterbox(inner[1] / w, (float(left), float(top)))
    return np.ascontiguousarray(full.transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255)), letterbox


def decode_boxes(
    output: Float32Array, layout: Layout, classes: YoloClasses, letterbox: Letterbox
) -> CandidateDetections:
    """Decode an output to candidates, px of the image before letterboxing."""
    boxes, score, kind = _read_boxes(np.asarray(output[0], dtype=np.float64), layout)
    good = score > MIN_SCORE
    if classes.balls:
        good &= np.isin(kind, classes.balls)
    if not good.any():
        return NO_CANDIDATES
    boxes, score, kind = boxes[good], score[good], kind[good]
    rows = _suppress_boxes(boxes, score)
    looks = classes.appearances[kind[rows]] if classes.balls else np.full((len(rows), len(APPEARANCES)), np.nan)
    return _boxes_to_candidates(boxes[rows], np.clip(score[rows], 0, 1), looks, letterbox)


def _read_boxes(output: FloatArray, layout: Layout) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Read x0, y0, x1, y1 (n, 4), scores (n,) and classes (n,) of an output without its first axis."""
    if layout == "suppressed":
        return output[:, :4], output[:, 4], output[:, 5].astype(np.int64)
    rows = output.T if layout == "columns of classes" else output
    class_scores = rows[:, 4:]
    if layout == "rows with objectness":
        class_scores = rows[:, 4:5] * rows[:, 5:]
    half = rows[:, 2:4] / 2
    kind = np.argmax(class_scores, axis=1)
    corners = np.concatenate([rows[:, :2] - half, rows[:, :2] + half], axis=1)
    return corners, class_scores[np.arange(len(class_scores)), kind], kind.astype(np.int64)


def _suppress_boxes(boxes: FloatArray, score: FloatArray) -> list[int]:
    """Non-maximum suppression: rows of the boxes (n, 4), best first, that no better one overlaps."""
    rows: list[int] = []
    for row in np.argsort(-score, kind="stable").tolist():
        if not rows or intersection_over_union(boxes[row], boxes[rows]).max() < MAX_OVERLAP:
            rows.append(row)
    return rows


def intersection_over_union(box: FloatArray, others: FloatArray) -> FloatArray:
    """Intersection over union (n,) of a box (4,) with others (n, 4)."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    shared = np.clip(high - low, 0, None).prod(axis=1)
    areas = (others[:, 2:] - others[:, :2]).prod(axis=1) + (box[2:] - box[:2]).prod()
    return np.asarray(shared / np.maximum(areas - shared, 1e-9))


def _boxes_to_candidates(
    boxes: FloatArray, score: FloatArray, appearance: FloatArray, letterbox: Letterbox
) -> CandidateDetections:
    # Edges of boxes are measured from the corner of the first pixel; pixel centres are at whole numbers here.
    corners = (boxes - np.tile(letterbox.margin, 2)) / letterbox.scale - 0.5
    size = corners[:, 2:] - corners[:, :2]
    short, long = size.min(axis=1), size.max(axis=1)
    blurred = long > MIN_STREAK_ASPECT * short
    radius = np.where(blurred, short, size.mean(axis=1)) / 2
    streak = np.where(blurred[:, None], size - 2 * radius[:, None], 0.0)
    sigma = np.hypot(SIGMA_SHARE * size.mean(axis=1), SIGMA_PX / letterbox.scale)
    return CandidateDetections((corners[:, :2] + corners[:, 2:]) / 2, radius, streak, score, sigma, sigma, appearance)
