"""Rules of imports that `.importlinter` cannot express, read from the source."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name
from support.code_structure import find_cycles, import_graph, package_graph, read_modules

ROOT = Path(__file__).resolve().parent.parent

PACKAGES = ("trueroll", "pipeline", "detectors", "diagnosis", "video", "models")
APART = ("worlds", "tests", "benchmarks", "sample_videos")
"""No package of the program imports these, and the simulators in worlds/ import no package of the program."""
PIXELS_AND_FILES = ("cv2", "av", "PIL", "pathlib", "os", "io", "shutil", "tempfile")
DYNAMIC = ("importlib.import_module", "import_module", "__import__", "exec", "eval")
DISCOVERY = Path("models/core/module_discovery.py")
"""The one module that imports dynamically; caches read calls of its function like import statements."""


@cache
def sources() -> dict[Path, ast.Module]:
    """Parse every module of the program and of worlds/."""
    paths = sorted(path for package in (*PACKAGES, "worlds") for path in (ROOT / package).rglob("*.py"))
    assert paths
    return {path.relative_to(ROOT): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def imports(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield (module, name) of every import, imports inside functions included; the name is empty for `import x`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (("." * node.level + (node.module or ""), alias.name) for alias in node.names)


def all_imports() -> Iterator[tuple[Path, str, str]]:
    for path, tree in sources().items():
        yield from ((path, module, name) for module, name in imports(tree))


def top(module: str) -> str:
    return module.split(".")[0]


def test_worlds_and_the_program_do_not_import_each_other() -> None:
    from_worlds = [f"{p} imports {m}" for p, m, _ in all_imports() if p.parts[0] == "worlds" and top(m) in PACKAGES]
    from_program = [f"{p} imports {m}" for p, m, _ in all_imports() if p.parts[0] != "worlds" and top(m) in APART]
    assert not from_worlds + from_program


def test_every_package_that_is_installed_is_imported() -> None:
    required = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    names = {re.split(r"[\[<>=]", one)[0] for one in required}
    imported = {top(module) for path, module, _ in all_imports() if path.parts[0] in PACKAGES}
    packages = packages_distributions()
    provided = {canonicalize_name(name) for module in imported for name in packages.get(module, [])}
    assert names <= provided, f"nothing imports {names - provided}"


def test_imports_are_absolute() -> None:
    assert not [f"{p} imports {m}" for p, m, _ in all_imports() if m.startswith(".")]


def test_no_import_cycle_joins_modules_or_packages() -> None:
    """Imports inside functions count: they hide a cycle, they do not remove it."""
    modules = read_modules(ROOT)
    assert not find_cycles(import_graph(modules))
    assert not find_cycles(package_graph(modules))


@pytest.mark.parametrize(
    ("command", "limit"),
    [
        ("cache_command", 1_000),
        ("check_command", 10_000),  # finds tables and courts
        ("simulate_command", 10_000),
        ("predict_command", 23_000),  # of shots and of rallies, corrected ones included
    ],
)
def test_a_command_loads_what_it_needs(command: str, limit: int) -> None:
    """Lines of code, imports inside functions counted: a helper in the wrong room brings the whole program along."""
    modules = read_modules(ROOT)
    graph, lines = import_graph(modules), {module.name: module.code_lines for module in modules}
    start = f"pipeline.cli.commands.{command}"
    reached, waiting = {start}, [start]
    while waiting:
        new = graph[waiting.pop()] - reached
        reached |= new
        waiting.extend(new)
    assert sum(lines[name] for name in reached) <= limit


def test_private_names_stay_in_their_module() -> None:
    ours = [(p, f"{m}.{name}") for p, m, name in all_imports() if top(m) in PACKAGES]
    private = [f"{p} imports {m}" for p, m in ours if any(part[:1] == "_" != part[1:2] for part in m.split("."))]
    assert not private


def test_models_import_neither_image_nor_file_libraries() -> None:
    assert not [
        f"{p} imports {m}" for p, m, _ in all_imports() if p.parts[0] == "models" and top(m) in PIXELS_AND_FILES
    ]


def test_nothing_is_imported_dynamically() -> None:
    """The cache reads import statements to know which code stands behind a stage; it must not miss one."""
    calls = [
        f"{path}:{node.lineno} calls {ast.unparse(node.func)}"
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if path != DISCOVERY and isinstance(node, ast.Call) and ast.unparse(node.func) in DYNAMIC
    ]
    assert not calls


def test_a_discovered_package_is_a_literal_in_the_source() -> None:
    calls = [
        f"{path}:{node.lineno} calls {ast.unparse(node)}"
        for path, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).endswith("discover_modules")
        and not (len(node.args) == 1 and isinstance(node.args[0], ast.Constant))
    ]
    assert not calls


def test_nothing_is_pickled() -> None:
    assert not [f"{p} imports {m}" for p, m, _ in all_imports() if top(m) in ("pickle", "joblib", "dill", "shelve")]
