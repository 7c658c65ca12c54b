"""How numbers are worked through in compiled loops: laws of motion once for real, once for complex numbers; pixels.

A law is written once. With float64 it gives the outcome; with complex128 and a step of 1e-30 along the imaginary axis
it gives its derivative, exact to rounding (Squire and Trapp 1998, doi:10.1137/S003614459631241X). So it branches on
real parts and has no abs, min or max of what can be complex.

Compiled code is kept on disk and shared by processes. Numba keys it by the file of a function alone, and would run
yesterday's version of what that function calls in other files; here it is keyed by all that its module imports.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.resources import files
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile

from models.core.source_imports import imports_of

STEP = 1e-30
"""Of the complex step."""
ROOMS = ("models.", "video.")
"""Whose code is kept."""


@cache
def _text(module: str) -> bytes | None:
    """Source of a module of these rooms, None if there is no such file."""
    room, *folders, name = module.split(".")
    path = files(room).joinpath(*folders, f"{name}.py")
    return path.read_bytes() if path.is_file() else None


@cache
def _imports(module: str) -> frozenset[str]:
    """Modules of these rooms that one of them imports."""
    found = set()
    for _, package, names in imports_of(_text(module) or b""):
        if package.startswith(ROOMS):
            found.update([package, *(f"{package}.{name}" for name in names)])
    return frozenset(name for name in found if _text(name) is not None)


@cache
def _stamp(module: str) -> str:
    """Digest of the sources of a module and of all in these rooms that it imports, directly or not."""
    seen, left = {module}, [module]
    while left:
        fresh = _imports(left.pop()) - seen
        seen |= fresh
        left += fresh
    digest = sha256()
    for name in sorted(seen):
        text = _text(name) or b""
        digest.update(f"{name} {len(text)} ".encode() + text)
    return digest.hexdigest()


def compiled(function: Callable[..., Any]) -> Any:
    """Decorator. Division by zero gives inf as in numpy, other threads run meanwhile, and sums keep their order."""
    fresh = numba.njit(error_model="numpy", nogil=True)(function)
    if not function.__module__.startswith(ROOMS):
        return fresh
    try:
        fast = numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:  # no folder to write to: compiled again by every process
        return fresh
    kept = fast._cache
    kept._cache_file = IndexDataCacheFile(kept.cache_path, kept._impl.filename_base, _stamp(function.__module__))
    return fast
