"""Values on disk: frozen dataclasses of arrays as one npz and one json, exactly and without pickle."""

from __future__ import annotations

import dataclasses
import json
import types
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

FORMAT = 1
V = TypeVar("V")


def save_value(value: object, folder: Path) -> None:
    """Write a frozen dataclass into `folder`: arrays to arrays.npz, everything else to value.json."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    tree = _encode(value, "", arrays)
    (folder / "value.json").write_text(json.dumps({"format": FORMAT, "value": tree}, indent=1), encoding="utf-8")
    with (folder / "arrays.npz").open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_value(kind: type[V], folder: Path) -> V:
    """Read back what `save_value` wrote; the annotations of `kind` say what to expect."""
    document = json.loads((folder / "value.json").read_text(encoding="utf-8"))
    if document["format"] != FORMAT:
        raise ValueError(f"values of format {FORMAT} are read; {folder} holds format {document['format']}")
    with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
        value: V = _decode(kind, document["value"], dict(arrays))
    return value


def _encode(value: Any, path: str, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError(f"{path} holds objects; only plain arrays are saved")
        arrays[path or "value"] = value
        return {"array": path or "value"}
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: _encode(getattr(value, name), f"{path}.{name}".lstrip("."), arrays) for name in names}
    if isinstance(value, tuple):
        return [_encode(part, f"{path}.{k}", arrays) for k, part in enumerate(value)]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Fraction | Path):
        return str(value)
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise TypeError(f"{path or 'value'} is a {type(value).__name__}, which cannot be saved")


@lru_cache(maxsize=256)
def _hints(kind: Any) -> dict[str, Any]:
    """By name, what the fields of a dataclass hold."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def _decode(kind: Any, data: Any, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    origin = get_origin(kind)
    if origin is np.ndarray or kind is np.ndarray:
        return arrays[data["array"]]
    if dataclasses.is_dataclass(kind):
        hints = _hints(kind).items()  # type: ignore[arg-type]
        return kind(**{name: _decode(hint, data[name], arrays) for name, hint in hints})  # type: ignore[operator]
    if origin in (Union, types.UnionType):
        choices = [choice for choice in get_args(kind) if choice is not type(None)]
        return None if data is None else _decode(choices[0], data, arrays)
    if origin is tuple:
        parts = get_args(kind)
        of = [parts[0]] * len(data) if parts[1:] == (Ellipsis,) else list(parts)
        return tuple(_decode(k, d, arrays) for k, d in zip(of, data, strict=True))
    if origin is Literal:
        return data
    return kind(data)
