"""Hashes the code behind a stage: its module, all project modules that it imports, and the versions of the libraries.

It works in a checkout and in an installed wheel, where modules of other projects lie beside the packages of this one.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from models.core.module_discovery import Import, find_discovered_packages, find_imports

# Folder of the project's packages: the checkout, or site-packages.
ROOT = Path(__file__).resolve().parents[2]
# The project's packages. Nothing else below `ROOT` is hashed.
PACKAGES = ("trueroll", "pipeline", "detectors", "diagnosis", "video", "models")
# Distributions whose version is part of the cache key: they can change a result.
LIBRARIES = ("torch", "opencv-python-headless", "onnxruntime", "numpy", "av", "scipy", "numba", "scikit-image")


@lru_cache(maxsize=1)
def library_versions() -> dict[str, str]:
    """Read the versions of the libraries that can change a result.

    Returns:
        Versions by the name of the distribution.
    """
    return {name: version(name) for name in LIBRARIES}


@dataclass(frozen=True, slots=True)
class _ModuleSource:
    """The source of a module, its imports, and the packages that it discovers."""

    imports: tuple[Import, ...]
    discovered_packages: tuple[str, ...]
    source: bytes


@dataclass(frozen=True, slots=True)
class SourceSnapshot:
    """The project's code at one time. Each file and folder is read once, however many stages depend on it."""

    modules: dict[Path, _ModuleSource] = field(default_factory=dict)
    hashes: dict[Path, str] = field(default_factory=dict)
    data_files: dict[Path, set[Path]] = field(default_factory=dict)
    hashes_by_module: dict[tuple[str, Path], dict[str, str]] = field(default_factory=dict)
    """Results of `hash_sources` by module and root."""

    def read_module(self, path: Path) -> _ModuleSource:
        """Read a module and its imports."""
        if path not in self.modules:
            source = path.read_bytes()
            self.modules[path] = _ModuleSource(_find_imports_cached(source), find_discovered_packages(source), source)
            self.hashes[path] = hashlib.sha256(source).hexdigest()
        return self.modules[path]

    def hash_file(self, path: Path) -> str:
        """Return the SHA-256 of a file."""
        if path not in self.hashes:
            self.hashes[path] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self.hashes[path]

    def list_data_files(self, package: Path) -> set[Path]:
        """List the files of a package that are not Python."""
        if package not in self.data_files:
            self.data_files[package] = _list_package_data(package)
        return self.data_files[package]


def hash_sources(module: str, root: Path = ROOT, snapshot: SourceSnapshot | None = None) -> dict[str, str]:
    """Hash every project file that a module depends on.

    Imports are followed by reading the source, so that an edit counts any number of imports away. Files that are not
    Python (fonts, weights, templates) count for the modules of their package that name them or their folder in a
    string. `discover_modules("PACKAGE")` counts all modules below a package, so that a new effect is a change.

    Args:
        module: Dotted name of the module.
        root: Folder of the project's packages.
        snapshot: The project's code as read before. Calls that share a snapshot read every file once; None reads all
            files now.

    Returns:
        SHA-256 by path below `root`.
    """
    snapshot = SourceSnapshot() if snapshot is None else snapshot
    if (module, root) not in snapshot.hashes_by_module:
        files = sorted(_find_source_files(module, root, snapshot))
        snapshot.hashes_by_module[module, root] = {
            str(path.relative_to(root)): snapshot.hash_file(path) for path in files
        }
    return snapshot.hashes_by_module[module, root]


def _find_source_files(module: str, root: Path, snapshot: SourceSnapshot) -> set[Path]:
    """Collect the files behind a module: sources by their imports, and data files by their names."""
    files: set[Path] = set()
    waiting = [module]
    visited: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in visited or name.split(".", 1)[0] not in PACKAGES:
            continue
        visited.add(name)
        base = root.joinpath(*name.split("."))
        path = next((one for one in (base.with_suffix(".py"), base / "__init__.py") if one.is_file()), None)
        if path is None:
            continue
        text = snapshot.read_module(path)
        files.add(path)
        files.update(_find_named_data(path, text.source, snapshot))
        for package in text.discovered_packages:
            paths = (one.relative_to(root) for one in root.joinpath(*package.split(".")).rglob("*.py"))
            waiting.extend(".".join(one.with_suffix("").parts).removesuffix(".__init__") for one in paths)
        waiting.extend(_list_possible_modules(text.imports, name))
    return files


# Cached by content, so that an edit within one tick of the clock counts too.
_find_imports_cached = lru_cache(maxsize=2048)(find_imports)


@lru_cache(maxsize=2048)
def _join_strings(source: bytes) -> str:
    """Join all strings of a module except docstrings, which may mention files but open none."""
    nodes = list(ast.walk(ast.parse(source)))
    bare_strings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = (node for node in nodes if isinstance(node, ast.Constant) and id(node) not in bare_strings)
    return " ".join(node.value for node in strings if isinstance(node.value, str))


def _list_possible_modules(imports: Iterable[Import], name: str) -> Iterator[str]:
    """List names that may be modules from the imports of module `name`, with the packages above them."""
    for level, module, names in imports:
        package = name.split(".")[:-level] if level else []
        base = ".".join([*package, *([module] if module else [])])
        for target in (base, *(f"{base}.{taken}" for taken in names)):
            parts = target.split(".")
            yield from (".".join(parts[: k + 1]) for k in range(len(parts)))


def _find_named_data(module: Path, source: bytes, snapshot: SourceSnapshot) -> set[Path]:
    """Find the data files beside a module that one of its strings names, by themselves or by their folder.

    A source is parsed only if such a name occurs in it.
    """
    parts = {path: path.relative_to(module.parent).parts for path in snapshot.list_data_files(module.parent)}
    if not any(part.encode() in source for part in {part for own in parts.values() for part in own}):
        return set()
    words = _join_strings(source)
    return {path for path, own in parts.items() if any(part in words for part in own)}


def _list_package_data(package: Path) -> set[Path]:
    """List the files of a package that are not Python, also in folders that are no packages themselves."""
    data: set[Path] = set()
    for path in package.iterdir():
        if path.is_dir() and path.name != "__pycache__" and not (path / "__init__.py").exists():
            data.update(below for below in path.rglob("*") if below.is_file() and below.suffix not in (".py", ".pyc"))
        elif path.is_file() and path.suffix not in (".py", ".pyc"):
            data.add(path)
    return data
