"""Compiled code that is cached on disk is never that of an older source, and one process compiles it."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest
from numba.core.event import Event, Listener, install_listener

from models.numerics.jit import compile_kernel

Call = Callable[..., list[int]]
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
CALLS = """
import json, os, sys
import numba

numba.njit(lambda x: x)(1)  # children that import the rest have a compiler that is ready
for line in sys.stdin:
    folder, script = json.loads(line)
    if not os.fork():
        sys.path.insert(0, folder)
        numba.config.CACHE_DIR = f"{folder}/cache"
        exec(script)
        sys.stdout.flush()
        os._exit(0)
    if os.wait()[1]:
        sys.exit("a call failed")
"""
MEASURE = """
from models.billiards.caller import outer
from models.numerics.jit import measure_compilation, notify_first_compilation
notes = []
with notify_first_compilation(lambda: notes.append(1)), measure_compilation() as measure:
    before = measure()
    outer(1)
print(len(notes), int(before > 0), int(measure() > 0))
"""
BUILDER = """
from models.numerics.jit import compile_kernel

def build(inner, factor):
    @compile_kernel
    def outer(x):
        return factor * inner(x)

    return outer
"""
CALL_CLOSURES = """
from models.billiards.builder import build
from models.billiards.callee import inner
closures = [build(inner, factor) for factor in (10, 100)]
print(*(closure(1) for closure in closures), *(sum(closure.stats.cache_hits.values()) for closure in closures))
"""
FORK = """
import os
from models.billiards.caller import outer
child = os.fork()
if not child:
    os._exit(outer(1) != 20)
print(os.waitpid(child, 0)[1], outer(1))
"""
COPIED = ("core/module_discovery.py", "numerics/jit.py")


@pytest.fixture(scope="module")
def call_in_new_process() -> Iterator[Call]:
    """Return the numbers that a new process prints: the value of `outer(1)`, and its number of cache hits."""
    command = [sys.executable, "-P", "-c", CALLS]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        stdin, stdout = process.stdin, process.stdout

        def call(folder: Path, script: str = CALL) -> list[int]:
            stdin.write(json.dumps([str(folder), script]) + "\n")
            stdin.flush()
            return [int(word) for word in stdout.readline().split()]

        yield call


def copy_package(tmp_path: Path, callee: str) -> Path:
    """Copy the compiler into a new package `models` with the modules `caller` and `callee`."""
    models = tmp_path / "models"
    package = models / "billiards"
    for folder in (models, models / "core", models / "numerics", package):
        folder.mkdir()
        (folder / "__init__.py").write_text("")
    for name in COPIED:
        (models / name).write_text((ROOT / "models" / name).read_text())
    (package / "caller.py").write_text(dedent(CALLER))
    (package / "callee.py").write_text(dedent(callee))
    return package


def test_a_change_in_another_file_that_is_called_compiles_again(tmp_path: Path, call_in_new_process: Call) -> None:
    package = copy_package(tmp_path, CALLEE.format(number=1))
    assert call_in_new_process(tmp_path) == [20, 0]
    assert call_in_new_process(tmp_path) == [20, 1]
    (package / "bystander.py").write_text(dedent(CALLEE.format(number=7)))
    assert call_in_new_process(tmp_path) == [20, 1]
    # Python tells sources apart by size and full seconds: a number of another length is seen at once
    (package / "callee.py").write_text(dedent(CALLEE.format(number=12)))
    assert call_in_new_process(tmp_path) == [130, 0]


def test_a_closure_is_loaded_for_what_it_encloses_alone(tmp_path: Path, call_in_new_process: Call) -> None:
    """Its source does not import what it encloses: the kernel in it counts with the source of its own module."""
    package = copy_package(tmp_path, CALLEE.format(number=1))
    (package / "builder.py").write_text(dedent(BUILDER))
    assert call_in_new_process(tmp_path, CALL_CLOSURES) == [20, 200, 0, 0]
    assert call_in_new_process(tmp_path, CALL_CLOSURES) == [20, 200, 1, 1]
    (package / "callee.py").write_text(dedent(CALLEE.format(number=12)))
    assert call_in_new_process(tmp_path, CALL_CLOSURES) == [130, 1300, 0, 0]


def test_only_the_first_process_has_something_to_compile_and_says_so(tmp_path: Path, call_in_new_process: Call) -> None:
    copy_package(tmp_path, CALLEE.format(number=1))
    assert call_in_new_process(tmp_path, MEASURE) == [1, 0, 1]
    assert call_in_new_process(tmp_path, MEASURE) == [0, 0, 0]


def test_closures_that_enclose_different_values_have_names_of_their_own() -> None:
    """Numba numbers symbols per process: code of two processes that shares a name would be linked as one."""

    def close_over(number: float) -> Any:
        def add(x):  # type: ignore[no-untyped-def]
            return x + number

        return compile_kernel(add)

    one, two, again = close_over(1.0), close_over(2.0), close_over(1.0)
    assert one.py_func.__qualname__ == again.py_func.__qualname__ != two.py_func.__qualname__
    assert (one(1.0), two(1.0)) == (2.0, 3.0)
    assert one.overloads.popitem()[1].fndesc.mangled_name != two.overloads.popitem()[1].fndesc.mangled_name


def test_a_process_that_was_forked_after_the_import_compiles_too(tmp_path: Path, call_in_new_process: Call) -> None:
    """As the workers of `multiprocessing` are on Linux: locks of the parent must not be theirs."""
    copy_package(tmp_path, CALLEE.format(number=1))
    assert call_in_new_process(tmp_path, FORK) == [0, 20]


def test_threads_that_compile_do_not_disturb_the_timers_of_each_other() -> None:
    """A timer of numba counts what begins and ends in all threads; two at once fail now and then."""

    class Recorder(Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.threads: list[int] = []

        def on_start(self, event: Event) -> None:
            self.threads.append(threading.get_ident())

        def on_end(self, event: Event) -> None:
            self.threads.append(threading.get_ident())

    def compile_another(number: int) -> None:
        def add(x: float) -> float:
            return x + number

        kernel = compile_kernel(add)
        barrier.wait()
        assert kernel(1.0) == 1.0 + number

    barrier = threading.Barrier(4)
    with install_listener("numba:compiler_lock", Recorder()) as recorder, ThreadPoolExecutor(4) as pool:
        list(pool.map(compile_another, range(4)))
    changes = sum(one != other for one, other in pairwise(recorder.threads))
    assert len(set(recorder.threads)) == 4
    assert changes == 3, "each thread ends before the next begins"
