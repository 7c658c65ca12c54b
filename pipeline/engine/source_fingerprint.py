"""What code stands behind a stage: its module, all of the project that it imports, and the libraries' versions."""

from __future__ import annotations

import ast
import gc
import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

from models.core.source_imports import Import, imports_of

ROOT = Path(__file__).resolve().parents[2]
LEAVES = (ast.Name, ast.expr_context)
"""Of a syntax tree: what says nothing here and has nothing below it, more than half of all."""
LIBRARIES = ("torch", "opencv-python-headless", "onnxruntime", "numpy", "av")


@lru_cache(maxsize=1)
def library_versions() -> dict[str, str]:
    """Versions of the libraries that can change a result."""
    return {name: version(name) for name in LIBRARIES}


@dataclass(frozen=True, slots=True)
class _Text:
    """What a module says that matters here."""

    imports: tuple[Import, ...]
    source: bytes


@dataclass(frozen=True, slots=True)
class Look:
    """What was read of the project at one time, each file and folder once however many stages stand on it."""

    texts: dict[Path, _Text] = field(default_factory=dict)
    hashes: dict[Path, str] = field(default_factory=dict)
    data: dict[Path, set[Path]] = field(default_factory=dict)
    behind: dict[tuple[str, Path], dict[str, str]] = field(default_factory=dict)
    """By module and root: what `source_hashes` found."""

    def text(self, path: Path) -> _Text:
        """What a module says."""
        if path not in self.texts:
            source = path.read_bytes()
            self.texts[path] = _Text(_imports_of(source), source)
            self.hashes[path] = hashlib.sha256(source).hexdigest()
        return self.texts[path]

    def hash(self, path: Path) -> str:
        """SHA-256 of a file."""
        if path not in self.hashes:
            self.hashes[path] = hashlib.sha256(path.read_bytes()).hexdigest()
        return self.hashes[path]

    def data_of(self, package: Path) -> set[Path]:
        """Files of a package that are not Python."""
        if package not in self.data:
            self.data[package] = _package_data(package)
        return self.data[package]


def source_hashes(module: str, root: Path = ROOT, look: Look | None = None) -> dict[str, str]:
    """SHA-256 of every project file behind `module`, by path below `root`.

    Follows imports by reading the source, so that an edit of a helper any number of imports away counts. Files that
    are not Python (fonts, weights, templates) count for the modules of their package that name them or their folder
    in a string. Importing a package called `effects` counts all its modules: a new effect is a change. Calls that
    share a `look` read every file once, and see the project as it was then.
    """
    look = Look() if look is None else look
    if (module, root) not in look.behind:
        files = sorted(_files_behind(module, root, look))
        look.behind[module, root] = {str(path.relative_to(root)): look.hash(path) for path in files}
    return look.behind[module, root]


def _files_behind(module: str, root: Path, look: Look) -> set[Path]:
    found: set[Path] = set()
    waiting = [module]
    seen: set[str] = set()
    ours = {path.stem for path in root.iterdir()}
    while waiting:
        name = waiting.pop()
        if name in seen or name.split(".", 1)[0] not in ours:
            continue
        seen.add(name)
        path = _module_file(name, root)
        if path is None:
            continue
        text = look.text(path)
        found.add(path)
        found.update(_named_data(path, text.source, look))
        if path.name == "__init__.py" and path.parent.name == "effects":
            modules = (below.relative_to(path.parent).with_suffix("") for below in path.parent.rglob("*.py"))
            waiting.extend(".".join([name, *module.parts]) for module in modules)
        waiting.extend(_resolved(text.imports, name))
    return found


def _module_file(name: str, root: Path) -> Path | None:
    base = root.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


_imports_of = lru_cache(maxsize=2048)(imports_of)
"""By content: an edit within the same tick of the clock counts too."""


@lru_cache(maxsize=2048)
def _words(source: bytes) -> str:
    """All strings of a module but docstrings, which speak of files and open none."""
    with _nothing_collected():
        nodes = list(_nodes(ast.parse(source)))
    said = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    strings = (node for node in nodes if isinstance(node, ast.Constant) and id(node) not in said)
    return " ".join(node.value for node in strings if isinstance(node.value, str))


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes of a syntax tree but `LEAVES`."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for field_name in node._fields:
            value = getattr(node, field_name, None)
            below = value if isinstance(value, list) else (value,)
            waiting.extend(one for one in below if isinstance(one, ast.AST) and not isinstance(one, LEAVES))


@contextmanager
def _nothing_collected() -> Iterator[None]:
    """Syntax trees are many objects without cycles; looking for garbage among them takes as long as making them."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _resolved(imports: Iterable[Import], name: str) -> Iterator[str]:
    """Names that may be modules, of the imports of module `name`, with the packages above them."""
    for level, module, names in imports:
        package = name.split(".")[:-level] if level else []
        base = ".".join([*package, *([module] if module else [])])
        for target in (base, *(f"{base}.{taken}" for taken in names)):
            parts = target.split(".")
            yield from (".".join(parts[: k + 1]) for k in range(len(parts)))


def _named_data(module: Path, source: bytes, look: Look) -> set[Path]:
    """Files beside a module that are not Python and that it names, or the folder they are in.

    Only a source in which such a name stands at all is parsed for its strings.
    """
    parts = {path: path.relative_to(module.parent).parts for path in look.data_of(module.parent)}
    if not any(part.encode() in source for part in {part for own in parts.values() for part in own}):
        return set()
    words = _words(source)
    return {path for path, own in parts.items() if any(part in words for part in own)}


def _package_data(package: Path) -> set[Path]:
    """Files of a package that are not Python, also in its folders that are no packages themselves."""
    data: set[Path] = set()
    for path in package.iterdir():
        if path.is_dir() and path.name != "__pycache__" and not (path / "__init__.py").exists():
            data.update(below for below in path.rglob("*") if below.is_file() and below.suffix not in (".py", ".pyc"))
        elif path.is_file() and path.suffix not in (".py", ".pyc"):
            data.add(path)
    return data
