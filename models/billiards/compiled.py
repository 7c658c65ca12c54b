"""How the physics of billiards is compiled: once for real numbers, once for complex ones, and kept on disk.

A law is written once. With float64 it gives the outcome; with complex128 and a step of 1e-30 along the imaginary axis
it gives its derivative, exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X). So it branches on
real parts and has no abs, min or max of what can be complex.

Compiled code is shared by processes. Numba keys it by the file of a function alone, and would run yesterday's version
of what that function calls in other files; here it is keyed by all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile


def _sources(folder: Traversable) -> Iterator[tuple[str, bytes]]:
    """Name and text of every file that compiled code is made of."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _sources(entry)
        elif entry.name.endswith(".py"):
            text = entry.read_bytes()
            if b"@compiled" in text or entry.name == "parameters.py":
                yield entry.name, text


def _stamp() -> str:
    digest = sha256()
    for name, text in _sources(files("models.billiards")):
        digest.update(f"{name}\0{len(text)}\0".encode() + text)
    return digest.hexdigest()


_STAMP = _stamp()


def compiled(function: Callable[..., Any]) -> Any:
    """Decorator. Division by zero gives inf as in numpy, other threads run meanwhile, and sums keep their order."""
    try:
        fast = numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:  # no folder to write to: compiled again by every process
        return numba.njit(error_model="numpy", nogil=True)(function)
    cache = fast._cache
    cache._cache_file = IndexDataCacheFile(cache.cache_path, cache._impl.filename_base, _STAMP)
    return fast
