"""Discovery of the modules of a package, so that a registry holds no list of its entries.

Caches need to know which source a result depends on, and read import statements for it. A call of `discover_modules`
with the name of a package counts as an import of every module below that package: `models.core.source_imports`
recognises it in the source.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module
from types import ModuleType


def discover_modules(package: str) -> tuple[ModuleType, ...]:
    """Import every module below a package.

    Args:
        package: Full dotted name, written as a string literal in the call, because caches search the source
            for it.

    Returns:
        All modules and subpackages, at any depth, sorted by name.
    """
    names = sorted(entry.name for entry in pkgutil.walk_packages(import_module(package).__path__, f"{package}."))
    return tuple(import_module(name) for name in names)
