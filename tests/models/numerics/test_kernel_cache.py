"""Compiled code that is cached on disk is never that of an older source."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).resolve().parents[3]

CALLEE = """
from models.numerics.jit import compile_kernel

@compile_kernel
def inner(x):
    return x + {number}
"""
CALLER = """
from models.billiards.callee import inner
from models.numerics.jit import compile_kernel

@compile_kernel
def outer(x):
    return 10 * inner(x)
"""
CALL = """
from models.billiards.caller import outer
print(outer(1), sum(outer.stats.cache_hits.values()))
"""
COPIED = ("core/source_imports.py", "numerics/jit.py")


def call_in_new_process(folder: Path) -> list[int]:
    """Return the value of `outer(1)` in a new process, and its number of cache hits."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "cache")}
    run = subprocess.run(
        [sys.executable, "-P", "-c", CALL], env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return [int(word) for word in run.stdout.split()]


def test_a_change_in_another_file_that_is_called_compiles_again(tmp_path: Path) -> None:
    models = tmp_path / "models"
    package = models / "billiards"
    for folder in (models, models / "core", models / "numerics", package):
        folder.mkdir()
        (folder / "__init__.py").write_text("")
    for name in COPIED:
        (models / name).write_text((ROOT / "models" / name).read_text())
    (package / "caller.py").write_text(dedent(CALLER))
    (package / "callee.py").write_text(dedent(CALLEE.format(number=1)))
    assert call_in_new_process(tmp_path) == [20, 0]
    assert call_in_new_process(tmp_path) == [20, 1]
    (package / "bystander.py").write_text(dedent(CALLEE.format(number=7)))
    assert call_in_new_process(tmp_path) == [20, 1]
    (package / "callee.py").write_text(dedent(CALLEE.format(number=2)))
    assert call_in_new_process(tmp_path) == [30, 0]
