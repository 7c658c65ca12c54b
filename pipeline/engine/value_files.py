"""Stores frozen dataclasses of arrays as one npz and one json file, exactly and without pickle."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import types
from collections.abc import Mapping
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

FORMAT = 2
AnyArray = np.ndarray[Any, Any]
V = TypeVar("V")


def save_value(value: object, folder: Path) -> None:
    """Write a frozen dataclass into a folder: arrays to arrays.npz, everything else to value.json.

    Args:
        value: A dataclass of arrays, numbers, strings, fractions, paths, None, tuples, mappings with texts as keys, and
            further dataclasses.
        folder: An existing folder.

    Raises:
        TypeError: A field holds a value of a type that cannot be saved.
    """
    arrays: dict[str, AnyArray] = {}
    tree = encode_value(value, "", arrays)
    (folder / "value.json").write_text(json.dumps({"format": FORMAT, "value": tree}, indent=1), encoding="utf-8")
    with (folder / "arrays.npz").open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def load_value(kind: type[V], folder: Path) -> V:
    """Read a value that `save_value` wrote.

    Args:
        kind: The dataclass; its annotations decide how fields are decoded.
        folder: The folder of the two files.

    Returns:
        A value equal to the saved one.

    Raises:
        ValueError: The files have another format.
    """
    document = json.loads((folder / "value.json").read_text(encoding="utf-8"))
    if document["format"] != FORMAT:
        raise ValueError(f"values of format {FORMAT} are read; {folder} holds format {document['format']}")
    with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
        value: V = decode_value(kind, document["value"], dict(arrays))
    return value


def hash_value(value: object) -> str:
    """Hash a value with everything that it holds.

    Args:
        value: A value that `save_value` can write.

    Returns:
        SHA-256 as hexadecimal digits.
    """
    arrays: dict[str, AnyArray] = {}
    digest = hashlib.sha256(json.dumps([FORMAT, encode_value(value, "", arrays)]).encode())
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def encode_value(value: Any, path: str, arrays: dict[str, AnyArray]) -> Any:
    """Convert a value to a JSON tree; its arrays are added to `arrays` under their paths.

    Raises:
        TypeError: A field holds a value of a type that cannot be saved.
    """
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError(f"{path} holds objects; only plain arrays are saved")
        arrays[path or "value"] = value
        return {"array": path or "value"}
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: encode_value(getattr(value, name), f"{path}.{name}".lstrip("."), arrays) for name in names}
    if isinstance(value, tuple):
        return [encode_value(part, f"{path}.{k}", arrays) for k, part in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {key: encode_value(part, f"{path}.{key}", arrays) for key, part in value.items()}
    if isinstance(value, np.generic):
        return encode_value(value.item(), path, arrays)
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # strict JSON has no NaN
    if isinstance(value, Fraction | Path):
        return str(value)
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise TypeError(f"{path or 'value'} is a {type(value).__name__}, which cannot be saved")


@lru_cache(maxsize=256)
def _field_types(kind: Any) -> dict[str, Any]:
    """Return the types of the fields of a dataclass by name."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}


def decode_value(kind: Any, data: Any, arrays: Mapping[str, AnyArray]) -> Any:
    """Convert a JSON tree back to a value of type `kind`."""
    origin = get_origin(kind)
    if origin is np.ndarray or kind is np.ndarray:
        return arrays[data["array"]]
    if dataclasses.is_dataclass(kind):
        hints = _field_types(kind).items()  # type: ignore[arg-type]
        return kind(**{name: decode_value(hint, data[name], arrays) for name, hint in hints if name in data})  # type: ignore[operator]
    if origin in (Union, types.UnionType):
        choices = [choice for choice in get_args(kind) if choice is not type(None)]
        return None if data is None else decode_value(choices[0], data, arrays)
    if origin is tuple:
        parts = get_args(kind)
        kinds = [parts[0]] * len(data) if parts[1:] == (Ellipsis,) else list(parts)
        return tuple(decode_value(k, d, arrays) for k, d in zip(kinds, data, strict=True))
    if origin is Mapping:
        return {key: decode_value(get_args(kind)[1], part, arrays) for key, part in data.items()}
    if origin is Literal:
        return data
    return kind(data)
