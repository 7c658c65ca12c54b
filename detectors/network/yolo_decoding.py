"""Boxes from the YOLO family: which version it is shows in the shape of the output.

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

from detectors.network.peak_decoding import LOOKS, Centres, no_centres
from models.core.typing import ByteArray, Float32Array, FloatArray

Layout = Literal["rows with objectness", "columns of classes", "rows of classes", "suppressed"]

STRIDES = (8, 16, 32)
GREY = 114
"""Level of the border around a picture that does not fill the input."""
LEAST_SCORE = 0.1
MOST_OVERLAP = 0.5
"""Intersection over union of two boxes above which the weaker one goes; touching balls overlap by far less."""
COCO_CLASSES, COCO_BALL = 80, 32
STREAKED = 1.35
"""Long over short side of a box from which its ball is blurred by motion."""
SIGMA_SHARE, SIGMA_PX = 0.05, 0.5
"""Error of a box' middle: share of its size, and px of the input."""
_LOOK_OF_WORD = (
    ("stripe", "striped"), ("cue", "white"), ("white", "white"), ("eight", "black"), ("black", "black"), ("8", "black"),
    ("solid", "coloured"), ("red", "coloured"), ("yellow", "coloured"), ("green", "coloured"), ("brown", "coloured"),
    ("blue", "coloured"), ("pink", "coloured"),
)  # fmt: skip
"""Words in the name of a class that say how its balls look; the first that fits."""


@dataclass(frozen=True, slots=True)
class Classes:
    """What the C classes of a network are."""

    balls: tuple[int, ...]
    """Those that are balls; none where nobody says which classes there are: then all are."""
    looks: FloatArray
    """(C, 4) probabilities of `centres.LOOKS`; NaN where the name does not tell."""


@dataclass(frozen=True, slots=True)
class Letterbox:
    """How a picture was fitted into the input: px of the input = scale * (px + 0.5) + margin - 0.5."""

    scale: float
    margin: tuple[float, float]
    """px left and above."""


def layout_of(shape: tuple[int, ...], side: tuple[int, int]) -> Layout | None:
    """Which layout an output of this shape has, for an input of `side` (H, W) px; None for none of them."""
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


def class_count(shape: tuple[int, ...], layout: Layout) -> int:
    """Number of classes of an output; 0 where the shape does not tell."""
    return {
        "rows with objectness": shape[2] - 5,
        "columns of classes": shape[1] - 4,
        "rows of classes": shape[2] - 4,
        "suppressed": 0,
    }[layout]


def classes_of(names: dict[int, str], count: int) -> Classes:
    """Which classes are balls: by their names, COCO's sports ball, else all of them."""
    count = max(count, max(names, default=-1) + 1)
    if not names and count == COCO_CLASSES:
        return Classes((COCO_BALL,), np.full((count, len(LOOKS)), np.nan))
    words = {number: name.lower() for number, name in names.items()}
    balls = tuple(n for n, word in words.items() if "ball" in word)
    if not balls:
        balls = tuple(n for n, word in words.items() if any(key in word for key, _ in _LOOK_OF_WORD))
    looks = np.full((count, len(LOOKS)), np.nan)
    for number in balls:
        look = next((look for key, look in _LOOK_OF_WORD if key in words[number]), None)
        if look is not None:
            looks[number] = [float(look == other) for other in LOOKS]
    return Classes(balls or tuple(range(count)), looks)


def letterboxed(rgb: ByteArray, side: tuple[int, int]) -> tuple[Float32Array, Letterbox]:
    """A picture (h, w, 3) as input (1, 3, H, W) in [0, 1], as large as it fits, grey around it."""
    h, w = rgb.shape[:2]
    scale = min(side[0] / h, side[1] / w)
    inner = (max(round(h * scale), 1), max(round(w * scale), 1))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    small = cv2.resize(rgb, inner[::-1], interpolation=way)
    top, left = (side[0] - inner[0]) // 2, (side[1] - inner[1]) // 2
    full = np.full((*side, 3), GREY, np.uint8)
    full[top : top + inner[0], left : left + inner[1]] = small
    fitted = Letterbox(inner[1] / w, (float(left), float(top)))
    return np.ascontiguousarray(full.transpose(2, 0, 1)[None].astype(np.float32) / np.float32(255)), fitted


def read_boxes(output: Float32Array, layout: Layout, classes: Classes, fitted: Letterbox) -> Centres:
    """Balls in an output, px of the picture before letterboxing."""
    boxes, score, kind = _boxes(np.asarray(output[0], dtype=np.float64), layout)
    good = score > LEAST_SCORE
    if classes.balls:
        good &= np.isin(kind, classes.balls)
    if not good.any():
        return no_centres()
    boxes, score, kind = boxes[good], score[good], kind[good]
    kept = _unsuppressed(boxes, score)
    looks = classes.looks[kind[kept]] if classes.balls else np.full((len(kept), len(LOOKS)), np.nan)
    return _centres(boxes[kept], np.clip(score[kept], 0, 1), looks, fitted)


def _boxes(output: FloatArray, layout: Layout) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """x0, y0, x1, y1 (n, 4), scores (n,), classes (n,) of an output without its first axis."""
    if layout == "suppressed":
        return output[:, :4], output[:, 4], output[:, 5].astype(np.int64)
    rows = output.T if layout == "columns of classes" else output
    given = rows[:, 4:]
    if layout == "rows with objectness":
        given = rows[:, 4:5] * rows[:, 5:]
    half = rows[:, 2:4] / 2
    kind = np.argmax(given, axis=1)
    corners = np.concatenate([rows[:, :2] - half, rows[:, :2] + half], axis=1)
    return corners, given[np.arange(len(given)), kind], kind.astype(np.int64)


def _unsuppressed(boxes: FloatArray, score: FloatArray) -> list[int]:
    """Rows of boxes (n, 4), best first, that no better one overlaps."""
    kept: list[int] = []
    for row in np.argsort(-score, kind="stable").tolist():
        if not kept or overlap(boxes[row], boxes[kept]).max() < MOST_OVERLAP:
            kept.append(row)
    return kept


def overlap(box: FloatArray, others: FloatArray) -> FloatArray:
    """Intersection over union (n,) of a box (4,) with others (n, 4)."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    shared = np.clip(high - low, 0, None).prod(axis=1)
    areas = (others[:, 2:] - others[:, :2]).prod(axis=1) + (box[2:] - box[:2]).prod()
    return np.asarray(shared / np.maximum(areas - shared, 1e-9))


def _centres(boxes: FloatArray, score: FloatArray, look: FloatArray, fitted: Letterbox) -> Centres:
    # Edges of boxes count from the corner of the first pixel; centres of pixels are at whole numbers here.
    corners = (boxes - np.tile(fitted.margin, 2)) / fitted.scale - 0.5
    size = corners[:, 2:] - corners[:, :2]
    short, long = size.min(axis=1), size.max(axis=1)
    blurred = long > STREAKED * short
    radius = np.where(blurred, short, size.mean(axis=1)) / 2
    streak = np.where(blurred[:, None], size - 2 * radius[:, None], 0.0)
    sigma = np.hypot(SIGMA_SHARE * size.mean(axis=1), SIGMA_PX / fitted.scale)
    return Centres((corners[:, :2] + corners[:, 2:]) / 2, radius, streak, score, sigma, sigma, look)
