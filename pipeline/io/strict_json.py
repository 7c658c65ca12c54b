"""Text of strict JSON, in which numbers that are not finite are null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def format_strict_json(document: Mapping[str, Any], indent: int | None = 1) -> str:
    """Format a tree of JSON values and numpy scalars; NaN and infinity become null; on one line without an indent."""
    return json.dumps(_replace_nonfinite(document), indent=indent, allow_nan=False)


def _replace_nonfinite(data: Any) -> Any:
    """Replace NaN and infinity by None, and numpy scalars by Python numbers."""
    if isinstance(data, Mapping):
        return {key: _replace_nonfinite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_replace_nonfinite(value) for value in data]
    if isinstance(data, float | np.floating):
        return float(data) if math.isfinite(data) else None
    return data.item() if isinstance(data, np.generic) else data
