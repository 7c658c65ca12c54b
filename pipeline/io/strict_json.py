"""Reading of JSON files, and strict JSON, in which numbers that are not finite are null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from models.core.errors import OptionError
from pipeline.engine.atomic_write import write_text


def read_json(path: Path, expected: str) -> Any:
    """Read a JSON file.

    Args:
        path: The file.
        expected: What should be there, the start of a sentence.

    Returns:
        Its content.

    Raises:
        OptionError: The file cannot be read, or is not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise OptionError(f"{expected}; {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        place = f"line {error.lineno}, column {error.colno}" if isinstance(error, json.JSONDecodeError) else "its text"
        raise OptionError(f"{path} is not whole JSON; correct {place}, or write it again") from error


# What pydantic calls a key that a form does not have: of a dataclass, and of a model or dictionary.
UNKNOWN_KEY_ERRORS = ("unexpected_keyword_argument", "extra_forbidden")


def format_first_error(error: ValidationError) -> str:
    """Format the first mistake of a file: its place and what is wrong."""
    mistake = error.errors(include_url=False)[0]
    place = ".".join(map(str, mistake["loc"])) or "the file"
    is_unknown = mistake["type"] in UNKNOWN_KEY_ERRORS
    words = "there is no such key" if is_unknown else mistake["msg"].removeprefix("Value error, ")
    return f"{place}: {words[:1].lower()}{words[1:]}"


def format_strict_json(document: Mapping[str, Any], indent: int | None = 1) -> str:
    """Format a tree of JSON values and numpy values; NaN and infinity become null; on one line without an indent."""
    return json.dumps(replace_nonfinite(document), indent=indent, allow_nan=False)


def write_json(document: Mapping[str, Any], target: Path) -> None:
    """Write a tree of JSON values and numpy values in one step; NaN and infinity become null."""
    write_text(target, format_strict_json(document) + "\n")


def replace_nonfinite(data: Any) -> Any:
    """Replace NaN and infinity by None, tuples and arrays by lists, and numpy scalars by Python numbers."""
    if isinstance(data, Mapping):
        return {key: replace_nonfinite(value) for key, value in data.items()}
    if isinstance(data, np.ndarray):
        data = data.tolist()
    if isinstance(data, list | tuple):
        return [replace_nonfinite(value) for value in data]
    if isinstance(data, float | np.floating):
        return float(data) if math.isfinite(data) else None
    return data.item() if isinstance(data, np.generic) else data
