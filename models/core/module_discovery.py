"""Discovery of the modules of a package, and of the imports of a source, on which caches depend.

Caches need to know which source a result depends on, and read import statements for it. A call of `discover_modules`
with the name of a package counts as an import of every module below that package: `models.core.module_discovery`
recognises it in the source.
"""

from __future__ import annotations

import ast
import pkgutil
import re
from collections.abc import Iterator
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


# Number of leading dots, the module, the names imported from it.
Import = tuple[int, str, tuple[str, ...]]

IMPORT_STATEMENT = re.compile(
    rb"^[ \t]*(from[ \t]+[.\w]+[ \t]+import[ \t]*(?:\([^()]*\)|(?:[^\n\\(]|\\\n)+)|import[ \t]+(?:[^\n\\]|\\\n)+)",
    re.MULTILINE,
)
IMPORT_WORD = re.compile(rb"\bimport\b")
DISCOVERY_CALL = re.compile(rb'\bdiscover_modules\(\s*"([\w.]+)"\s*\)')
# Fields of syntax nodes that hold statements.
STATEMENT_FIELDS = ("body", "orelse", "finalbody", "handlers", "cases")


def find_imports(source: bytes) -> tuple[Import, ...]:
    """Find all imports of a Python source, imports inside functions included.

    Import statements on lines of their own are cut out and parsed, which takes a thirtieth of the time of parsing the
    whole source. Where the word `import` also occurs elsewhere, in a comment or after a colon, all of it is parsed.

    Args:
        source: The source code.

    Returns:
        The imports, in no particular order.

    Raises:
        SyntaxError: The whole source had to be parsed and is not valid.
    """
    statements = IMPORT_STATEMENT.findall(source)
    if len(IMPORT_WORD.findall(source)) == len(statements):
        try:
            return tuple(_iterate_imports(ast.parse(b"\n".join(statements))))
        except SyntaxError:  # a statement was cut wrongly, e.g. at a bracket within a comment
            pass
    return tuple(_iterate_imports(ast.parse(source)))


def find_discovered_packages(source: bytes) -> tuple[str, ...]:
    """Find the packages of which a source imports every module by `models.core.module_discovery.discover_modules`.

    Args:
        source: The source code.

    Returns:
        Names of the packages, as they stand in the calls.
    """
    return tuple(package.decode() for package in DISCOVERY_CALL.findall(source))


def _iterate_imports(tree: ast.AST) -> Iterator[Import]:
    """Yield the imports below a syntax node."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from ((0, alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.level, node.module or "", tuple(alias.name for alias in node.names)
        for body in STATEMENT_FIELDS:
            waiting.extend(getattr(node, body, ()))


def load_module(package: str, name: str) -> ModuleType:
    """Import one module of a package by its name, where all would be slow; no cached result may depend on it."""
    return import_module(f"{package}.{name}")
