"""Ball networks in ONNX files: the project's own network, or one of the YOLO family that a user supplies.

Own networks are recognised by their metadata (`detectors/training/onnx_export.py`); others are recognised by the shapes
of their input and output. Other files are refused in one sentence.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.network.peak_decoding import (
    APPEARANCES,
    CHANNELS,
    COARSE_STRIDE,
    NO_CANDIDATES,
    CandidateDetections,
    concatenate_candidates,
    decode_maps,
    select_non_echoes,
)
from models.core.errors import ModelError
from models.core.typing import ByteArray, Float32Array, FloatArray
from video.io.onnx_session import onnxruntime, open_session

SCHEMA = "trueroll.balls/1"
SHIPPED_BALL_MODEL = Path(__file__).parent / "weights" / "balls.onnx"
# Side of the input, px, of a YOLO export that leaves its size open.
DEFAULT_SIDE_PX = 640
# Largest side of a network's input, px; a larger one is an exporter's mistake, or meant to exhaust the memory.
MAX_SIDE_PX = 8192
EXPECTATION = "an ONNX ball detector is trueroll's own or a YOLO export (v5 to v11, with one input of images)"
# Least diameter of a ball in the input of a YOLO network; images in which it would be smaller are split into tiles.
MIN_DIAMETER_PX = 14.0
# Overlap of neighbouring tiles, ball diameters.
TILE_OVERLAP_DIAMETERS = 2.5
# Most tiles of one image.
MAX_TILES = 12


class BallModel(Protocol):
    """A network that finds candidate detections in an image of any size."""

    def find_candidates(self, rgb: ByteArray, radius: float) -> CandidateDetections:
        """Find balls in an image (h, w, 3) in which they have about this radius, px."""
        ...


@dataclass(frozen=True, slots=True)
class CentreModel:
    """The project's own network."""

    session: onnxruntime.InferenceSession

    def compute_maps(self, rgb: ByteArray) -> Float32Array:
        """Compute the maps (12, h / 4, w / 4), rounded up, of an image (h, w, 3)."""
        h, w = rgb.shape[:2]
        padded = np.pad(rgb, ((0, -h % COARSE_STRIDE), (0, -w % COARSE_STRIDE), (0, 0)), mode="edge")
        return np.asarray(self.session.run(None, {"picture": padded[None]})[0][0], dtype=np.float32)

    def find_candidates(self, rgb: ByteArray, radius: float) -> CandidateDetections:
        """Find balls in an image (h, w, 3), preferably with radii of 4 to 12 px."""
        return decode_maps(self.compute_maps(rgb))


@dataclass(frozen=True, slots=True)
class BoxModel:
    """A YOLO network."""

    session: onnxruntime.InferenceSession
    side: tuple[int, int]
    """(H, W) px of its input."""
    layout: Layout
    classes: YoloClasses

    def find_candidates(self, rgb: ByteArray, radius: float) -> CandidateDetections:
        """Find balls in an image (h, w, 3), tile by tile if they would be too small in the input."""
        parts = []
        for x, y, part in split_into_tiles(rgb, radius, self.side):
            network_input, letterbox = letterbox_image(part, self.side)
            output = np.asarray(
                self.session.run(None, {self.session.get_inputs()[0].name: _cast_input(network_input, self.session)})[0]
            )
            parts.append(decode_boxes(output, self.layout, self.classes, letterbox).scale(1.0, (float(x), float(y))))
        candidates = concatenate_candidates(parts)
        candidates = candidates.take(np.argsort(-candidates.score, kind="stable"))
        return candidates.take(select_non_echoes(candidates))


def split_into_tiles(rgb: ByteArray, radius: float, side: tuple[int, int]) -> list[tuple[int, int, ByteArray]]:
    """Split an image into tiles (x and y of the first pixel, image) in which balls of a radius are large enough."""
    h, w = rgb.shape[:2]
    scale = min(side[0] / h, side[1] / w)
    times = int(np.ceil(MIN_DIAMETER_PX / max(2 * radius * scale, 1e-6)))
    if times <= 1:
        return [(0, 0, rgb)]
    rows, columns = _tile_grid(h, w, times)
    margin = round(TILE_OVERLAP_DIAMETERS * radius)
    tiles = []
    for i in range(rows):
        for j in range(columns):
            y0, y1 = max(i * h // rows - margin, 0), min((i + 1) * h // rows + margin, h)
            x0, x1 = max(j * w // columns - margin, 0), min((j + 1) * w // columns + margin, w)
            tiles.append((x0, y0, rgb[y0:y1, x0:x1]))
    return tiles


def _tile_grid(h: int, w: int, times: int) -> tuple[int, int]:
    """Rows and columns of nearly square tiles whose longer side is 1 / times of the longer side of the image."""
    longest = max(h, w) / times
    rows, columns = max(1, int(np.ceil(h / longest))), max(1, int(np.ceil(w / longest)))
    while rows * columns > MAX_TILES:
        rows, columns = max(1, rows - (rows >= columns)), max(1, columns - (columns > rows))
    return rows, columns


def open_ball_model(path: Path) -> BallModel:
    """Open the ball network in an ONNX file.

    Args:
        path: The file.

    Returns:
        The network.

    Raises:
        ModelError: The file is missing, or holds no ball network.
    """
    if not path.is_file():
        raise ModelError(f"{path} is not there; {EXPECTATION}")
    return _open_cached(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _open_cached(path: Path, modified_ns: int) -> BallModel:
    session = open_session(path, EXPECTATION)
    metadata = dict(session.get_modelmeta().custom_metadata_map)
    if "trueroll.schema" in metadata:
        return _open_own_network(path, session, metadata)
    return _open_yolo_network(path, session, metadata)


def read_model_metadata(path: Path) -> dict[str, str]:
    """Read the metadata of an ONNX file.

    Args:
        path: The file.

    Returns:
        Values by name.
    """
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return dict(session.get_modelmeta().custom_metadata_map)


def _open_own_network(path: Path, session: onnxruntime.InferenceSession, metadata: dict[str, str]) -> CentreModel:
    if metadata["trueroll.schema"] != SCHEMA or metadata.get("trueroll.channels", "").split(",") != list(CHANNELS):
        raise ModelError(
            f"{path} follows {metadata['trueroll.schema']} and this version reads {SCHEMA}; train it again with "
            "trueroll train-detector"
        )
    return CentreModel(session)


def _open_yolo_network(path: Path, session: onnxruntime.InferenceSession, metadata: dict[str, str]) -> BoxModel:
    inputs = session.get_inputs()
    shape = inputs[0].shape if inputs else []
    if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or inputs[0].type not in _INPUT_TYPES:
        description = ", ".join(f"{each.name} {each.shape} {each.type}" for each in inputs) or "none"
        raise ModelError(f"{path} is another kind of network: {EXPECTATION}; its inputs are {description}")
    rows, columns = (n if isinstance(n, int) else DEFAULT_SIDE_PX for n in shape[2:])
    side = (rows, columns)
    if not all(0 < n <= MAX_SIDE_PX for n in side):
        raise ModelError(
            f"{path} requires images of {side[1]} x {side[0]} px; at most {MAX_SIDE_PX} px a side are possible"
        )
    blank = _cast_input(np.zeros((1, 3, *side), np.float32), session)
    try:
        output = tuple(np.asarray(session.run(None, {inputs[0].name: blank})[0]).shape)
    except Exception as error:  # as above: onnxruntime's exceptions have no common type
        raise ModelError(f"{path} does not run on an image of {side[1]} x {side[0]} px; {EXPECTATION}") from error
    layout = recognize_layout(output, side)
    if layout is None:
        raise ModelError(f"{path} is another kind of network: {EXPECTATION}; its output has the shape {output}")
    return BoxModel(
        session, side, layout, select_ball_classes(_parse_class_names(metadata), count_classes(output, layout))
    )


_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


def _cast_input(network_input: Float32Array, session: onnxruntime.InferenceSession) -> NDArray[Any]:
    return network_input.astype(_INPUT_TYPES[session.get_inputs()[0].type])


def _parse_class_names(metadata: dict[str, str]) -> dict[int, str]:
    """Parse the names of the classes, which exporters write as a literal; empty if there are none."""
    try:
        names = ast.literal_eval(metadata.get("names", "{}"))
    except (ValueError, SyntaxError, RecursionError, MemoryError):  # nested a thousand times, it may be hostile
        return {}
    if isinstance(names, list | tuple):
        names = dict(enumerate(names))
    if not isinstance(names, dict):
        return {}
    return {int(number): str(name) for number, name in names.items() if str(number).isdigit()}


Layout = Literal["rows with objectness", "columns of classes", "rows of classes", "suppressed"]

STRIDES = (8, 16, 32)
# Grey level of the border around an image that does not fill the input.
BORDER_LEVEL = 114
MIN_SCORE = 0.1
# Intersection over union of two boxes above which the weaker one is suppressed; touching balls overlap far less.
MAX_OVERLAP = 0.5
COCO_CLASSES, COCO_BALL = 80, 32
# Long over short side of a box from which its ball is a motion-blur streak.
MIN_STREAK_ASPECT = 1.35
# Standard deviation of the middle of a box: share of its size, and px of the input.
SIGMA_SHARE, SIGMA_PX = 0.05, 0.5
# Appearance by words in the name of a class; the first match counts.
_APPEARANCE_OF_WORD = (
    ("stripe", "striped"), ("cue", "white"), ("white", "white"), ("eight", "black"), ("black", "black"), ("8", "black"),
    ("solid", "coloured"), ("red", "coloured"), ("yellow", "coloured"), ("green", "coloured"), ("brown", "coloured"),
    ("blue", "coloured"), ("pink", "coloured"),
)  # fmt: skip


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
    """Count the classes of an output by its shape; 0 if the shape does not show their number."""
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
    sizes = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
    return [int(row) for row in cv2.dnn.NMSBoxes(sizes.tolist(), score.tolist(), MIN_SCORE, MAX_OVERLAP)]


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
