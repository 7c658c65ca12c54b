"""The sensitivity benchmark finds constants, patches them wherever they are imported, and restores them."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from benchmarks.sensitivity import (
    Constant,
    Effect,
    count_changed,
    digest,
    explain_exclusion,
    find_bindings,
    find_constants,
    format_report,
    list_modules,
    patch_constant,
    record_reads,
    vary,
)
from models.core.events import Events

LIMITS = """
from functools import cache
import math
# m: largest
# distance.
REACH = 0.25
# Rounds.
ROUNDS, FLAG, ONE = 7, True, 1
STEPS = (0.0, (2, 0.5))
TURN: float = math.radians(90.0)
lower, Mixed, WORDS, TABLE = 0.5, 0.5, ("a", "b"), {"a": 0.5}
STRIKE, BALL, CUSHION = range(3)
STATE_SIZE = 6
BASE = 3.0
DERIVED = 2 * BASE
HARD, SPARE = 1.5, 2.5
GRIP = 0.5

def compile_kernel(function):
    return function

@compile_kernel
def kernel(x):
    return x * HARD

def options(reach=SPARE):
    return reach + DERIVED

@cache
def reach_twice():
    return 2 * REACH

def last_step():
    return STEPS[1][1], TURN, ROUNDS, BALL, CUSHION, STATE_SIZE

half_grip = GRIP / 2
def grip():
    return GRIP + half_grip
"""
USERS = """
from {name}.limits import REACH, ROUNDS as MOST_ROUNDS
if True:
    from .limits import STEPS

def reach():
    return REACH

def values():
    return REACH, MOST_ROUNDS, STEPS
"""
ACROSS = """
from {name}.users import REACH as FAR

def far():
    return FAR
"""
STRANGER = """
ROUNDS = 7
REACH = 0.25

def rounds():
    return ROUNDS
"""
LATE = """
from {name}.limits import REACH

def reach():
    return REACH
"""
NUMBERS = count()
Package = dict[str, ModuleType]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Package]:
    """Import a package of a fresh name whose modules share constants."""
    name = f"sensitivity_sample_{next(NUMBERS)}"
    folder = tmp_path / name
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    texts = {"limits": LIMITS, "users": USERS, "across": ACROSS, "stranger": STRANGER, "late": LATE}
    for module, text in texts.items():
        (folder / f"{module}.py").write_text(text.replace("{name}", name))
    monkeypatch.syspath_prepend(tmp_path)
    yield {module: importlib.import_module(f"{name}.{module}") for module in texts if module != "late"}
    for loaded in [one for one in sys.modules if one.split(".")[0] == name]:
        del sys.modules[loaded]


def root_of(package: Package) -> tuple[str, ...]:
    return (package["limits"].__name__.split(".")[0],)


def pick(package: Package, name: str, *path: int) -> Constant:
    (one,) = [c for c in find_constants(package["limits"]) if (c.name, c.path) == (name, path)]
    return one


def test_constants_are_floats_integers_above_one_and_items_of_tuples(package: Package) -> None:
    found = {(c.name, c.path): c.value for c in find_constants(package["limits"])}
    assert found == {
        ("REACH", ()): 0.25, ("ROUNDS", ()): 7, ("STEPS", (0,)): 0.0, ("STEPS", (1, 0)): 2, ("STEPS", (1, 1)): 0.5,
        ("TURN", ()): np.pi / 2, ("CUSHION", ()): 2, ("STATE_SIZE", ()): 6, ("BASE", ()): 3.0, ("DERIVED", ()): 6.0,
        ("HARD", ()): 1.5, ("SPARE", ()): 2.5, ("GRIP", ()): 0.5,
    }  # fmt: skip


def test_the_comment_above_describes_a_constant(package: Package) -> None:
    assert pick(package, "REACH").doc == "m: largest distance."
    assert pick(package, "ROUNDS").doc == "Rounds."
    assert pick(package, "TURN").doc == ""


@pytest.mark.parametrize(
    ("name", "path", "reason"),
    [
        ("REACH", (), ""),
        ("ROUNDS", (), ""),
        ("STEPS", (1, 1), ""),
        ("STEPS", (0,), "zero"),
        ("HARD", (), "compiled"),
        ("SPARE", (), "used at import time only"),  # the default of a function
        ("BASE", (), "used at import time only"),  # part of another constant
        ("DERIVED", (), ""),
        ("CUSHION", (), "index"),
        ("STATE_SIZE", (), "index"),
    ],
)
def test_constants_that_cannot_be_varied_say_why(
    package: Package, name: str, path: tuple[int, ...], reason: str
) -> None:
    stated, _ = explain_exclusion(pick(package, name, *path), root_of(package))
    assert stated.startswith(reason)
    assert bool(stated) == bool(reason)


def test_a_constant_that_is_also_copied_at_import_time_carries_a_remark(package: Package) -> None:
    assert explain_exclusion(pick(package, "GRIP"), root_of(package)) == ("", "its copy from import time is not varied")
    assert explain_exclusion(pick(package, "REACH"), root_of(package)) == ("", "")


def test_a_constant_without_a_reader_is_never_used(package: Package) -> None:
    (one,) = [c for c in find_constants(package["stranger"]) if c.name == "REACH"]
    assert explain_exclusion(one, root_of(package))[0] == "never used"


def test_a_kernel_of_another_module_makes_a_constant_compiled(package: Package, tmp_path: Path) -> None:
    name = root_of(package)[0]
    text = (
        f"from {name}.limits import ROUNDS as N, compile_kernel\n\n@compile_kernel\ndef repeat(x):\n    return N * x\n"
    )
    (tmp_path / name / "kernels.py").write_text(text)
    assert explain_exclusion(pick(package, "ROUNDS"), (name,))[0] == ""
    importlib.import_module(f"{name}.kernels")
    assert explain_exclusion(pick(package, "ROUNDS"), (name,))[0] == "compiled, not varied"


def test_bindings_follow_imports_under_other_names_but_not_equal_values(package: Package) -> None:
    def find(name: str) -> set[tuple[str, str]]:
        bindings = find_bindings(package["limits"].__name__, name, root_of(package))
        return {(module.__name__.split(".")[1], local) for module, local in bindings}

    assert find("REACH") == {("limits", "REACH"), ("users", "REACH"), ("across", "FAR")}
    assert find("ROUNDS") == {("limits", "ROUNDS"), ("users", "MOST_ROUNDS")}
    assert find("STEPS") == {("limits", "STEPS"), ("users", "STEPS")}


def test_a_patch_reaches_every_importer_and_is_undone(package: Package) -> None:
    users, across, stranger, limits = (package[name] for name in ("users", "across", "stranger", "limits"))
    before = [dict(vars(module)) for module in package.values()]
    with patch_constant(pick(package, "REACH"), 0.5, root_of(package)):
        assert (limits.REACH, users.reach(), across.far(), stranger.REACH) == (0.5, 0.5, 0.5, 0.25)
        assert users.values()[1:] == (7, (0.0, (2, 0.5)))
    with patch_constant(pick(package, "ROUNDS"), 9, root_of(package)):
        assert (limits.ROUNDS, users.values()[1], stranger.rounds()) == (9, 9, 7)
    assert [dict(vars(module)) for module in package.values()] == before


def test_a_patch_replaces_one_item_of_a_tuple(package: Package) -> None:
    old = package["limits"].STEPS
    with patch_constant(pick(package, "STEPS", 1, 1), 0.75, root_of(package)):
        assert package["limits"].last_step()[0] == 0.75
        assert package["users"].values()[2] == (0.0, (2, 0.75))
    assert package["limits"].STEPS is old
    assert package["users"].STEPS is old


def test_a_patch_is_undone_after_an_error(package: Package) -> None:
    with pytest.raises(ZeroDivisionError), patch_constant(pick(package, "REACH"), 0.5, root_of(package)):
        raise ZeroDivisionError
    assert (package["limits"].REACH, package["users"].reach(), package["across"].far()) == (0.25, 0.25, 0.25)


def test_a_module_that_is_imported_during_a_patch_is_restored(package: Package) -> None:
    with patch_constant(pick(package, "REACH"), 0.5, root_of(package)):
        late = importlib.import_module(f"{root_of(package)[0]}.late")
        assert late.reach() == 0.5
    assert late.reach() == 0.25


def test_cached_results_do_not_outlive_a_patch(package: Package) -> None:
    limits = package["limits"]
    assert limits.reach_twice() == 0.5
    with patch_constant(pick(package, "REACH"), 0.5, root_of(package)):
        assert limits.reach_twice() == 1.0
    assert limits.reach_twice() == 0.5


def test_reads_are_those_of_the_called_functions(package: Package) -> None:
    with record_reads() as reads:
        package["users"].reach()
    assert (package["users"].__file__, "REACH") in reads
    assert (package["users"].__file__, "MOST_ROUNDS") not in reads


@pytest.mark.parametrize(
    ("value", "factor", "name", "expected"),
    [
        (0.5, 1.3, "REACH", 0.65),
        (-2.0, 0.7, "REACH", -1.4),
        (10, 1.3, "ROUNDS", 13),
        (2, 0.7, "ROUNDS", 1),
        (2, 1.1, "ROUNDS", 3),  # at least 1 more
        (0.9, 1.3, "MIN_SHARE", 0.95),  # half of the way to 1
        (0.9, 1.3, "REACH", 1.17),
    ],
)
def test_values_are_multiplied(value: float, factor: float, name: str, expected: float) -> None:
    result = vary(Constant("m", name, (), value, ""), factor)
    assert result == pytest.approx(expected)
    assert isinstance(result, int) == isinstance(value, int)


def make_events(*rows: tuple[str, float, str, str, float]) -> Events:
    kind, frame, a, b, p = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    n, frames = len(rows), np.array(frame, dtype=float)
    nan = np.full(n, np.nan)
    columns = (kind, frames / 50, np.ones(n), frames, a, b, np.zeros((n, 2)), np.array(p, dtype=float), nan, nan, nan)
    return Events(*columns)


def test_events_change_by_kind_balls_and_half_a_frame() -> None:
    hit = ("ball", 20.0, "cue", "red", 0.99)
    changed, total, change = count_changed(make_events(hit), make_events(("ball", 20.4, "red", "cue", 0.79)))
    assert (changed, total) == (0, 1)
    assert change == pytest.approx(0.2)
    for other in (
        ("ball", 20.6, "cue", "red", 0.99),
        ("strike", 20.0, "cue", "", 0.99),
        ("ball", 20.0, "cue", "8", 0.9),
    ):
        assert count_changed(make_events(hit), make_events(other))[:2] == (2, 2)
    assert count_changed(make_events(hit, hit), make_events(hit)) == (1, 2, 0.0)  # each at most once
    assert count_changed(make_events(), make_events(hit))[:2] == (1, 1)


@dataclass
class Held:
    """A value in a dataclass."""

    xy: np.ndarray
    names: tuple[str, ...]


def test_digests_depend_on_content_alone() -> None:
    one = Held(np.array([1.0, np.nan]), ("a", "b"))
    assert digest(one) == digest(Held(np.array([1.0, np.nan]), ("a", "b")))
    assert digest(one) != digest(Held(np.array([1.0 + 1e-15, np.nan]), ("a", "b")))
    assert digest(one) != digest(Held(np.array([1.0, np.nan]), ("ab",)))


def test_the_report_sorts_by_effect_and_lists_what_has_none() -> None:
    weak, strong, idle, unread, fixed = (Constant("models.m", name, (), 2.0, "") for name in "WSIUF")
    rows = [
        (weak, "", "", [Effect(1.4, changed=1, of=100, read=3, differing=1), Effect(2.6, of=100, read=3)]),
        (strong, "", "", [Effect(1.4, of=100, read=3), Effect(2.6, changed=50, of=100, found=-4, read=3, differing=2)]),
        (idle, "", "", [Effect(1.4, of=100, read=3), Effect(2.6, of=100, read=3)]),
        (unread, "", "", [Effect(1.4, of=100), Effect(2.6, of=100)]),
        (fixed, "compiled, not varied", "", []),
    ]
    text = format_report(rows)
    assert "| m.S | 2 -> 1.4, 2.6 | 0.0 / 50.0 | +0 / -4 |" in text
    positions = [text.index(f"m.{name} ") for name in "SW"]
    assert positions == sorted(positions)
    sections = {part.splitlines()[0]: part for part in text.split("## ")[1:]}
    assert "m.I = 2:  (read in 3 cases)" in sections["No effect: candidate for removal (1)"]
    assert "m.U = 2" in sections["No case calls a function that reads it (1)"]
    assert "m.F = 2" in sections["Compiled, not varied (1)"]


def test_the_thresholds_of_the_program_are_found() -> None:
    module = importlib.import_module("models.estimation.structure_search.motion_starts")
    found = {c.name: c for c in find_constants(module)}
    assert {"MAX_REST_SAMPLES", "MIN_SPEED_RADII"} <= set(found)
    assert found["MIN_SPEED_RADII"].doc.startswith("Ball radii per frame")
    assert module.__name__ in list_modules()
