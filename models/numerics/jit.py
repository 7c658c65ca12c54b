"""Compilation of numerical kernels with numba, and their cache on disk.

A law of motion is written once. Evaluated with float64 it gives the outcome; evaluated with complex128 and a step of
1e-30 along the imaginary axis it gives the derivative, exact to rounding (Squire and Trapp 1998,
doi:10.1137/S003614459631241X). Such a kernel branches on real parts only, and takes no abs, min or max of a value that
can be complex.

Compiled code is cached on disk and shared by processes. Numba's own cache key covers the file of a function only, so a
change in another file that the function calls would go unnoticed. Here the key covers every module that the module of
the function imports, directly or indirectly.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from hashlib import sha256
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import numba
from numba.core.caching import IndexDataCacheFile

from models.core.source_imports import find_discovered_packages, find_imports

COMPLEX_STEP = 1e-30
"""Length of the complex step, along the imaginary axis."""
CACHED_PACKAGES = ("models.", "video.")
"""Packages whose compiled functions are cached on disk."""


@cache
def _read_source(module: str) -> bytes | None:
    """Read the source of a module of `CACHED_PACKAGES`; None if there is no such file."""
    package, *folders, name = module.split(".")
    path = files(package).joinpath(*folders, f"{name}.py")
    return path.read_bytes() if path.is_file() else None


@cache
def _find_project_imports(module: str) -> frozenset[str]:
    """Find the modules of `CACHED_PACKAGES` that a module imports, by import statements or by discovery."""
    source, candidates = _read_source(module) or b"", set[str]()
    for _, package, names in find_imports(source):
        if package.startswith(CACHED_PACKAGES):
            candidates.update([package, *(f"{package}.{name}" for name in names)])
    for package in find_discovered_packages(source):
        root, *folders = package.split(".")
        candidates.update(_list_modules(files(root).joinpath(*folders), package))
    return frozenset(name for name in candidates if _read_source(name) is not None)


def _list_modules(folder: Traversable, package: str) -> Iterator[str]:
    """Yield the names of all modules in the folder of a package and in the folders below it."""
    for entry in folder.iterdir():
        if entry.is_dir():
            yield from _list_modules(entry, f"{package}.{entry.name}")
        elif entry.name.endswith(".py"):
            yield f"{package}.{entry.name.removesuffix('.py')}"


@cache
def _hash_source_tree(module: str) -> str:
    """Hash the sources of a module and of all modules of `CACHED_PACKAGES` that it imports, directly or indirectly."""
    modules, pending = {module}, [module]
    while pending:
        new = _find_project_imports(pending.pop()) - modules
        modules |= new
        pending += new
    digest = sha256()
    for name in sorted(modules):
        text = _read_source(name) or b""
        digest.update(f"{name} {len(text)} ".encode() + text)
    return digest.hexdigest()


def compile_kernel(function: Callable[..., Any]) -> Any:
    """Compile a numerical function with numba; use as a decorator.

    Division by zero gives inf as in numpy, other threads run during a call, and sums keep their order.

    Args:
        function: A function of numbers and arrays at module level.

    Returns:
        The compiled function. It is cached on disk if its module belongs to `CACHED_PACKAGES` and the cache folder is
        writable; otherwise every process compiles it again.
    """
    uncached = numba.njit(error_model="numpy", nogil=True)(function)
    if not function.__module__.startswith(CACHED_PACKAGES):
        return uncached
    try:
        cached = numba.njit(error_model="numpy", nogil=True, cache=True)(function)
    except RuntimeError:  # no writable cache folder: every process compiles again
        return uncached
    cache_entry = cached._cache
    cache_entry._cache_file = IndexDataCacheFile(
        cache_entry.cache_path, cache_entry._impl.filename_base, _hash_source_tree(function.__module__)
    )
    return cached


def compile_inline_closure(function: Callable[..., Any]) -> Any:
    """Compile a closure inline, as a part of every compiled function that calls it.

    Numba cannot recognise a closure over compiled functions in another process, so it is not cached on disk; the
    compiled functions that call it are.

    Args:
        function: A closure over compiled functions.

    Returns:
        The compiled closure.
    """
    return numba.njit(error_model="numpy", nogil=True, inline="always")(function)
