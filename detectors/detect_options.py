"""Options of ball detection; fast to import, for the command line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from models.core.options import option


@dataclass(frozen=True, slots=True)
class DetectOptions:
    """Options of ball detection."""

    detector: Literal["auto", "hough", "onnx"] = option(
        "auto", help="Ball detector: hough needs no network, onnx runs one, auto chooses the better one for the view."
    )
    model: str | None = option(
        None, help="File of an ONNX ball detector for the onnx detector. Default: the network of trueroll."
    )
