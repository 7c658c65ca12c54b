"""Who may import whom, read from the source: the floors of the house hold."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

FLOORS = {"models": 0, "video": 1, "detectors": 2, "diagnosis": 2, "pipeline": 3}
APART = ("worlds", "tests", "benchmarks", "sample_videos")
"""Imported by nobody outside themselves."""
PIXELS_AND_FILES = ("cv2", "av", "PIL", "pathlib", "os", "io", "shutil", "tempfile")
DYNAMIC = ("importlib.import_module", "import_module", "__import__", "exec", "eval")


@cache
def sources() -> dict[Path, ast.Module]:
    """Every module of the rooms and of the worlds, parsed."""
    paths = sorted(path for room in (*FLOORS, "worlds") for path in (ROOT / room).rglob("*.py"))
    assert paths
    return {path.relative_to(ROOT): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def imports(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """(module, name) of every import, also of those inside functions; the name is empty for `import x`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (("." * node.level + (node.module or ""), alias.name) for alias in node.names)


def all_imports() -> Iterator[tuple[Path, str, str]]:
    for path, tree in sources().items():
        yield from ((path, *found) for found in imports(tree))


def top(module: str) -> str:
    return module.split(".")[0]


def may_import(room: str, other: str) -> bool:
    """Whether a module of `room` may import one of the top-level package `other`."""
    if other == room or other not in {*FLOORS, *APART}:
        return True
    return other in FLOORS and room in FLOORS and FLOORS[other] < FLOORS[room]


def test_the_rule_refuses_neighbours_upper_floors_and_worlds() -> None:
    assert may_import("pipeline", "models")
    assert not may_import("detectors", "diagnosis")
    assert not may_import("models", "video")
    assert not may_import("worlds", "models")
    assert not may_import("models", "worlds")


def test_every_room_has_a_floor() -> None:
    rooms = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert rooms <= {*FLOORS, *APART}, "a new package needs a place in FLOORS"


def test_a_room_imports_from_floors_below_it_only() -> None:
    assert not [f"{p} imports {m}" for p, m, _ in all_imports() if not may_import(p.parts[0], top(m))]


def test_imports_say_from_which_room() -> None:
    assert not [f"{p} imports {m}" for p, m, _ in all_imports() if m.startswith(".")]


def test_private_names_stay_in_their_module() -> None:
    ours = [(p, f"{m}.{name}") for p, m, name in all_imports() if top(m) in FLOORS]
    private = [f"{p} imports {m}" for p, m in ours if any(part[:1] == "_" != part[1:2] for part in m.split("."))]
    assert not private


def test_models_know_no_pixels_and_no_files() -> None:
    assert not [
        f"{p} imports {m}" for p, m, _ in all_imports() if p.parts[0] == "models" and top(m) in PIXELS_AND_FILES
    ]


def test_nothing_is_imported_dynamically() -> None:
    """The cache reads import statements to know which code stands behind a stage; it must not miss one."""
    calls = [
        f"{path}:{node.lineno} calls {ast.unparse(node.func)}"
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in DYNAMIC
    ]
    assert not calls


def test_nothing_is_pickled() -> None:
    assert not [f"{p} imports {m}" for p, m, _ in all_imports() if top(m) in ("pickle", "joblib", "dill", "shelve")]
