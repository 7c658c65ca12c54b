"""Every module of benchmarks/ can be imported, names its own command, and is listed in the index."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.support.figures import find_pages, read_record

ROOT = Path(__file__).resolve().parent.parent
OPTIONAL_PACKAGES = {"matplotlib", "mujoco", "onnx", "pooltool", "pymunk"}
"""Packages of extras; a benchmark that needs a missing one is skipped."""
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benchmarks").rglob("*.py")
    if path.name != "__init__.py"
)
SCRIPTS = [name for name in MODULES if "__main__" in (ROOT / f"{name.replace('.', '/')}.py").read_text()]
IMPORT_ALL = """
import importlib, json, sys, traceback
failures = {}
for name in json.load(sys.stdin):
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        failures[name] = {"missing": error.name, "text": str(error)}
    except BaseException:
        failures[name] = {"missing": None, "text": traceback.format_exc(limit=-1)}
print(json.dumps(failures))
"""


@pytest.fixture(scope="module")
def import_failures() -> dict[str, dict[str, str | None]]:
    """Import all benchmarks in one process of their own, because some limit the threads of their process."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], input=json.dumps(MODULES), capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    failures: dict[str, dict[str, str | None]] = json.loads(done.stdout.splitlines()[-1])
    return failures


@pytest.mark.parametrize("module", MODULES)
def test_a_benchmark_can_be_imported(module: str, import_failures: dict[str, dict[str, str | None]]) -> None:
    failure = import_failures.get(module)
    if failure and (failure["missing"] or "").split(".")[0] in OPTIONAL_PACKAGES:
        pytest.skip(f"{module} needs {failure['missing']}")
    assert failure is None, failure["text"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_benchmark_script_names_its_command_and_is_in_the_index(script: str) -> None:
    docstring = ast.get_docstring(ast.parse((ROOT / f"{script.replace('.', '/')}.py").read_text())) or ""
    assert f"    python -m {script}" in docstring
    assert f"`{script.removeprefix('benchmarks.')}`" in (ROOT / "benchmarks" / "README.md").read_text()


@pytest.mark.parametrize("script", sorted(find_pages(ROOT)))
def test_a_script_behind_a_table_measures_it_again_and_the_table_is_filled(script: str) -> None:
    source = (ROOT / "benchmarks" / f"{script.replace('.', '/')}.py").read_text()
    assert re.search(rf'run_quick\(\s*"{re.escape(script)}"', source)
    assert all(np.isfinite([figure.value, figure.noise]).all() for figure in read_record(script, ROOT).values())
    assert read_record(script, ROOT)


def test_base_names_of_benchmarks_are_unique() -> None:
    names = [module.rpartition(".")[2] for module in MODULES]
    assert len(names) == len(set(names))
