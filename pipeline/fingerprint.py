"""What code stands behind a stage: its module, all of the project that it imports, and the libraries' versions."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIBRARIES = ("torch", "opencv-python-headless", "onnxruntime", "numpy", "av")


@lru_cache(maxsize=1)
def library_versions() -> dict[str, str]:
    """Versions of the libraries that can change a result."""
    return {name: version(name) for name in LIBRARIES}


def source_hashes(module: str, root: Path = ROOT) -> dict[str, str]:
    """SHA-256 of every project file behind `module`, by path below `root`.

    Follows imports by reading the source, so that an edit of a helper any number of imports away counts. Files that
    are not Python (fonts, weights, templates) count for the modules of their package that name them or their folder
    in a string. Importing a package called `effects` counts all its modules: a new effect is a change.
    """
    return {str(path.relative_to(root)): _file_hash(path) for path in sorted(_files_behind(module, root))}


def _files_behind(module: str, root: Path) -> set[Path]:
    found: set[Path] = set()
    waiting = [module]
    seen: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        path = _module_file(name, root)
        if path is None:
            continue
        found.add(path)
        found.update(_named_data(path))
        if path.name == "__init__.py" and path.parent.name == "effects":
            waiting.extend(f"{name}.{sibling.stem}" for sibling in path.parent.glob("*.py") if sibling != path)
        waiting.extend(_imported(path, name))
    return found


def _module_file(name: str, root: Path) -> Path | None:
    base = root.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


def _imported(path: Path, name: str) -> Iterator[str]:
    """Names that may be modules: of every import statement, with the packages above them."""
    for node in ast.walk(_parsed(path.read_bytes())):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = name.split(".")[: -node.level] if node.level else []
            module = ".".join([*package, *([node.module] if node.module else [])])
            targets = [module, *(f"{module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for target in targets:
            parts = target.split(".")
            yield from (".".join(parts[: k + 1]) for k in range(len(parts)))


@lru_cache(maxsize=512)
def _parsed(source: bytes) -> ast.Module:
    """By content: an edit within the same tick of the clock counts too."""
    return ast.parse(source)


def _named_data(module: Path) -> set[Path]:
    """Files beside a module that are not Python and that it names, or the folder they are in."""
    data = _package_data(module.parent)
    if not data:
        return set()
    strings = [n.value for n in ast.walk(_parsed(module.read_bytes())) if isinstance(n, ast.Constant)]
    words = " ".join(value for value in strings if isinstance(value, str))
    return {path for path in data if any(part in words for part in path.relative_to(module.parent).parts)}


def _package_data(package: Path) -> set[Path]:
    """Files of a package that are not Python, also in its folders that are no packages themselves."""
    data: set[Path] = set()
    for path in package.iterdir():
        if path.is_dir() and path.name != "__pycache__" and not (path / "__init__.py").exists():
            data.update(below for below in path.rglob("*") if below.is_file() and below.suffix not in (".py", ".pyc"))
        elif path.is_file() and path.suffix not in (".py", ".pyc"):
            data.add(path)
    return data


def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
