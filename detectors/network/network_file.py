"""An ONNX file that finds balls: the project's own network, or one of the YOLO family that a user brings.

Own networks say so in their metadata (`detectors/training/ball_export.py`); others are recognised by the shapes of their input and
output. What is neither is refused in one sentence.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from detectors.network.peak_decoding import CHANNELS, COARSE_STRIDE, Centres, chained, not_echoes, read_maps
from detectors.network.yolo_decoding import Classes, Layout, class_count, classes_of, layout_of, letterboxed, read_boxes
from models.core.errors import ModelError
from models.core.typing import ByteArray, Float32Array
from video.io.onnx_session import onnxruntime, opened

SCHEMA = "trueroll.balls/1"
SHIPPED = Path(__file__).parent / "weights" / "balls.onnx"
USUAL_SIDE = 640
"""px of the input of a YOLO export that leaves its size open."""
MOST_SIDE = 8192
"""px of the input of a network; a larger one that an exporter wrote is a mistake, or meant to take all memory."""
EXPECTED = "an ONNX ball detector is trueroll's own or a YOLO export (v5 to v11, with one input of pictures)"
LEAST_DIAMETER_PX = 14.0
"""Of a ball in a YOLO network's input; pictures that would show it smaller are cut into tiles."""
TILE_OVERLAP_DIAMETERS = 2.5
MOST_TILES = 12


class BallModel(Protocol):
    """A network that finds balls in a picture of any size."""

    def see(self, rgb: ByteArray, radius: float) -> Centres:
        """Balls in a picture (h, w, 3) in which they have about this radius, px."""
        ...


@dataclass(frozen=True, slots=True)
class CentreModel:
    """The project's own network."""

    session: onnxruntime.InferenceSession

    def maps(self, rgb: ByteArray) -> Float32Array:
        """Maps (12, h / 4, w / 4), rounded up, of a picture (h, w, 3)."""
        h, w = rgb.shape[:2]
        padded = np.pad(rgb, ((0, -h % COARSE_STRIDE), (0, -w % COARSE_STRIDE), (0, 0)), mode="edge")
        return np.asarray(self.session.run(None, {"picture": padded[None]})[0][0], dtype=np.float32)

    def see(self, rgb: ByteArray, radius: float) -> Centres:
        """Balls in a picture (h, w, 3), best with radii of 4 to 12 px."""
        return read_maps(self.maps(rgb))


@dataclass(frozen=True, slots=True)
class BoxModel:
    """A YOLO network."""

    session: onnxruntime.InferenceSession
    side: tuple[int, int]
    """(H, W) px of its input."""
    layout: Layout
    classes: Classes

    def see(self, rgb: ByteArray, radius: float) -> Centres:
        """Balls in a picture (h, w, 3), in tiles where they would be too small in the input."""
        parts = []
        for x, y, part in tiles(rgb, radius, self.side):
            given, fitted = letterboxed(part, self.side)
            output = np.asarray(
                self.session.run(None, {self.session.get_inputs()[0].name: _typed(given, self.session)})[0]
            )
            parts.append(read_boxes(output, self.layout, self.classes, fitted).scaled(1.0, (float(x), float(y))))
        found = chained(parts)
        found = found.take(np.argsort(-found.score, kind="stable"))
        return found.take(not_echoes(found))


def tiles(rgb: ByteArray, radius: float, side: tuple[int, int]) -> list[tuple[int, int, ByteArray]]:
    """Parts of a picture with the place of their first pixel; the whole where balls of a radius are large enough."""
    h, w = rgb.shape[:2]
    scale = min(side[0] / h, side[1] / w)
    times = int(np.ceil(LEAST_DIAMETER_PX / max(2 * radius * scale, 1e-6)))
    if times <= 1:
        return [(0, 0, rgb)]
    rows, columns = _split(h, w, times)
    margin = round(TILE_OVERLAP_DIAMETERS * radius)
    found = []
    for i in range(rows):
        for j in range(columns):
            y0, y1 = max(i * h // rows - margin, 0), min((i + 1) * h // rows + margin, h)
            x0, x1 = max(j * w // columns - margin, 0), min((j + 1) * w // columns + margin, w)
            found.append((x0, y0, rgb[y0:y1, x0:x1]))
    return found


def _split(h: int, w: int, times: int) -> tuple[int, int]:
    """Rows and columns of nearly square tiles whose longer side is 1 / times of the picture's."""
    longest = max(h, w) / times
    rows, columns = max(1, int(np.ceil(h / longest))), max(1, int(np.ceil(w / longest)))
    while rows * columns > MOST_TILES:
        rows, columns = max(1, rows - (rows >= columns)), max(1, columns - (columns > rows))
    return rows, columns


def open_model(path: Path) -> BallModel:
    """The detector in an ONNX file; ModelError, one sentence, where it is none."""
    if not path.is_file():
        raise ModelError(f"{path} is not there; {EXPECTED}")
    return _opened(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _opened(path: Path, changed: int) -> BallModel:
    session = opened(path, EXPECTED)
    facts = dict(session.get_modelmeta().custom_metadata_map)
    if "trueroll.schema" in facts:
        return _own(path, session, facts)
    return _yolo(path, session, facts)


def model_facts(path: Path) -> dict[str, str]:
    """The metadata of an ONNX file."""
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    return dict(session.get_modelmeta().custom_metadata_map)


def _own(path: Path, session: onnxruntime.InferenceSession, facts: dict[str, str]) -> CentreModel:
    if facts["trueroll.schema"] != SCHEMA or facts.get("trueroll.channels", "").split(",") != list(CHANNELS):
        raise ModelError(
            f"{path} follows {facts['trueroll.schema']} and this version reads {SCHEMA}; train it again with "
            "trueroll train-detector"
        )
    return CentreModel(session)


def _yolo(path: Path, session: onnxruntime.InferenceSession, facts: dict[str, str]) -> BoxModel:
    inputs = session.get_inputs()
    shape = inputs[0].shape if inputs else []
    if len(inputs) != 1 or len(shape) != 4 or shape[1] != 3 or inputs[0].type not in _TYPES:
        came = ", ".join(f"{each.name} {each.shape} {each.type}" for each in inputs) or "none"
        raise ModelError(f"{path} is another kind of network: {EXPECTED}; its inputs are {came}")
    rows, columns = (n if isinstance(n, int) else USUAL_SIDE for n in shape[2:])
    side = (rows, columns)
    if not all(0 < n <= MOST_SIDE for n in side):
        raise ModelError(f"{path} wants pictures of {side[1]} x {side[0]} px; {MOST_SIDE} px a side are the most")
    blank = _typed(np.zeros((1, 3, *side), np.float32), session)
    try:
        output = tuple(np.asarray(session.run(None, {inputs[0].name: blank})[0]).shape)
    except Exception as error:  # as above: onnxruntime's exceptions have no common type
        raise ModelError(f"{path} does not run on a picture of {side[1]} x {side[0]} px; {EXPECTED}") from error
    layout = layout_of(output, side)
    if layout is None:
        raise ModelError(f"{path} is another kind of network: {EXPECTED}; its output has the shape {output}")
    return BoxModel(session, side, layout, classes_of(_names(facts), class_count(output, layout)))


_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


def _typed(given: Float32Array, session: onnxruntime.InferenceSession) -> NDArray[Any]:
    return given.astype(_TYPES[session.get_inputs()[0].type])


def _names(facts: dict[str, str]) -> dict[int, str]:
    """Names of the classes, which exporters write as a literal; empty where there are none."""
    try:
        names = ast.literal_eval(facts.get("names", "{}"))
    except (ValueError, SyntaxError, RecursionError, MemoryError):  # nested a thousand times, it may be hostile
        return {}
    if isinstance(names, list | tuple):
        names = dict(enumerate(names))
    if not isinstance(names, dict):
        return {}
    return {int(number): str(name) for number, name in names.items() if str(number).isdigit()}
