"""Tracks as files of any program hold them, and the registry of formats: every `TrackFormat` of a module here."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError
from models.core.module_discovery import discover_modules
from models.core.typing import FloatArray
from pipeline.io.strict_json import read_json
from pipeline.io.text_table import Columns


class MalformedTracks(ValueError):
    """A file does not hold what its format demands; the message is half a sentence on the file."""


# px from the corner of the image, where formats of boxes count from, to the centre of its first pixel, where we do.
PIXEL_CORNER = 0.5


@dataclass(frozen=True, slots=True)
class PointTracks:
    """Rows of tracks of any program."""

    columns: Columns
    """(K,) by name: `frame` from 0, `id`; where known `t` (s), `shot`, `kind`, `score`, `x, y, z` or `theta1, theta2`
    in `unit`, and `x_px, y_px, width_px, height_px` in the image."""
    unit: str = ""
    """m, rad or empty: unit of the coordinates that are not in px."""
    fps: float | None = None
    px_per_m: float | None = None
    image: tuple[float, float] | None = None
    """Width and height of the image, px."""
    scene: Mapping[str, Any] = field(default_factory=dict)
    """Content of a scene.json: what else is known."""
    notes: tuple[str, ...] = ()
    """Sentences on what was assumed, without a full stop."""

    @property
    def ids(self) -> list[str]:
        """Names of the bodies, in the order of their first rows."""
        return list(dict.fromkeys(self.columns["id"].tolist()))

    def locate_px(self) -> FloatArray:
        """Return the positions (K, 2) in the image.

        Raises:
            OptionError: They are not known.
        """
        if "x_px" in self.columns:
            return np.stack([self.columns["x_px"], self.columns["y_px"]], axis=1)
        if self.unit in ("m", "") and "x" in self.columns and "y" in self.columns and self.px_per_m:
            return np.stack([self.columns["x"], self.columns["y"]], axis=1) * self.px_per_m
        raise OptionError("This format holds pixels, and the tracks have none; state the scale with --px-per-m")

    def locate_boxes(self) -> FloatArray:
        """Return the boxes (K, 4): left, top, width and height, px from the corner of the image.

        Raises:
            OptionError: The size of the bodies is not known.
        """
        if "width_px" in self.columns:
            size = np.stack([self.columns["width_px"], self.columns["height_px"]], axis=1)
        elif "radius_px" in self.columns:
            size = 2 * np.repeat(self.columns["radius_px"][:, None], 2, axis=1)
        else:
            raise OptionError("This format holds boxes, and the tracks have no sizes; state them with --size")
        return np.concatenate([self.locate_px() + PIXEL_CORNER - size / 2, size], axis=1)

    def locate_metres(self) -> FloatArray:
        """Return the positions (K, 2) in m.

        Raises:
            OptionError: They are not known.
        """
        if self.unit in ("m", "") and "x" in self.columns and "y" in self.columns:
            return np.stack([self.columns["x"], self.columns["y"]], axis=1)
        if "x_px" in self.columns and self.px_per_m:
            return self.locate_px() / self.px_per_m
        raise OptionError("This format holds metres, and the tracks have none; state the scale with --px-per-m")

    def list_times(self) -> FloatArray:
        """Return the times (K,), s.

        Raises:
            OptionError: They are not known.
        """
        if "t" in self.columns:
            return np.asarray(self.columns["t"], np.float64)
        if self.fps is None:
            raise OptionError("This format holds times, and the tracks have frames alone; state --fps")
        return np.asarray(self.columns["frame"] / self.fps)


# Program, version, source and options of an export, with what the format cannot hold itself.
Provenance = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class TrackFormat:
    """One format of tracks."""

    name: str
    title: str
    """As in a sentence: `COCO annotations`."""
    endings: tuple[str, ...]
    """Ends of file names in lower case; an empty one stands for a folder."""
    recognises: Callable[[Path, bytes], bool]
    """Whether a file, with its first bytes, has this format."""
    read: Callable[[Path], PointTracks]
    write: Callable[[PointTracks, Path, Provenance], None]
    holds_provenance: bool
    """Whether `write` puts it into the file; otherwise it is written beside it."""


def list_formats() -> dict[str, TrackFormat]:
    """List the formats by name."""
    values = (value for module in discover_modules("pipeline.io.formats") for value in vars(module).values())
    formats = {one.name: one for one in values if isinstance(one, TrackFormat)}
    return dict(sorted(formats.items()))


def boxes_to_columns(boxes: FloatArray) -> Columns:
    """Build the columns of boxes (K, 4): left, top, width and height, px from the corner of the image."""
    centre = boxes[:, :2] + boxes[:, 2:] / 2 - PIXEL_CORNER
    return {"x_px": centre[:, 0], "y_px": centre[:, 1], "width_px": boxes[:, 2], "height_px": boxes[:, 3]}


def number_unnamed(frame: NDArray[Any]) -> NDArray[np.str_]:
    """Name detections (K,) without identities by their number within their frame."""
    order = np.argsort(frame, kind="stable")
    _, first, count = np.unique(frame[order], return_index=True, return_counts=True)
    number = np.empty(len(frame), np.int64)
    number[order] = np.arange(len(frame)) - np.repeat(first, count)
    return np.array([f"detection-{k + 1}" for k in number.tolist()])


def read_document(path: Path) -> Any:
    """Read a JSON file; an error is one sentence."""
    return read_json(path, "A JSON file was expected")


def write_document(document: Any, path: Path) -> None:
    """Write a JSON file; numbers are finite."""
    path.write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
