"""Compiled code that is kept on disk is never that of another source."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

ROOT = Path(__file__).resolve().parents[2]

CALLEE = """
from models.numerics.jit import compiled

@compiled
def inner(x):
    return x + {number}
"""
CALLER = """
from models.billiards.callee import inner
from models.numerics.jit import compiled

@compiled
def outer(x):
    return 10 * inner(x)
"""
ASK = """
from models.billiards.caller import outer
print(outer(1), sum(outer.stats.cache_hits.values()))
"""


def ask(folder: Path) -> list[int]:
    """What `outer(1)` gives in a new process, and whether it was found compiled."""
    environment = {**os.environ, "PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder / "kept")}
    run = subprocess.run(
        [sys.executable, "-P", "-c", ASK], env=environment, cwd=folder, capture_output=True, text=True, check=True
    )
    return [int(word) for word in run.stdout.split()]


def test_a_change_in_another_file_that_is_called_compiles_again(tmp_path: Path) -> None:
    package = tmp_path / "models" / "billiards"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").write_text("")
    for name in ("compiled.py", "imports.py"):
        (package.parent / name).write_text((ROOT / "models" / name).read_text())
    (package / "caller.py").write_text(dedent(CALLER))
    (package / "callee.py").write_text(dedent(CALLEE.format(number=1)))
    assert ask(tmp_path) == [20, 0]
    assert ask(tmp_path) == [20, 1]
    (package / "bystander.py").write_text(dedent(CALLEE.format(number=7)))
    assert ask(tmp_path) == [20, 1]
    (package / "callee.py").write_text(dedent(CALLEE.format(number=2)))
    assert ask(tmp_path) == [30, 0]
