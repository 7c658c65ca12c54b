"""Mutants change one number that decides, in a copy, and the tests that run are those of its modules."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from benchmarks import mutants
from benchmarks.mutants import SourceTree

SOURCE = '''"""Two ways to decide, and numbers that decide nothing."""
from models.numbers import STRANGE
GATE, SHARES, SCALE = 2.0, (0.1, 0.5), 1000.0
START, KIND, COLUMN, HIDDEN = 3, 4, 5, 6
def decide(x, kind, start=START):
    level = SHARES[0] * x
    if kind == KIND or x[COLUMN] > call(HIDDEN):
        return SCALE * x
    return x > GATE * 2 and clip(x, 0, level) and x >= start
'''


@pytest.fixture
def tree(tmp_path: Path) -> SourceTree:
    """A product of two modules with three test files."""
    files = {
        "models/gates.py": SOURCE,
        "models/reader.py": "from models.gates import GATE\n",
        "models/numbers.py": "STRANGE = 7.5\n",
        "tests/models/test_gates.py": "def test_it():\n    from models import gates\n",
        "tests/models/test_reader.py": "from support.helper import decide\n",
        "tests/models/test_other.py": "import models.other\n",
        "tests/support/helper.py": "from models.reader import decide\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return SourceTree(tmp_path)


def test_a_number_decides_in_an_order_comparison_a_limiting_call_and_by_a_local_name(tree: SourceTree) -> None:
    found = {one.name: one.value for one in mutants.list_decision_constants(tree)}
    assert found == {"GATE": 2.0, "SHARES[0]": 0.1, "SHARES[1]": 0.5, "START": 3}


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("models.gates.GATE", ["test_gates.py", "test_reader.py"]),  # the reader by a module in support/
        ("models.gates.START", ["test_gates.py"]),
        ("models.numbers.STRANGE", ["test_gates.py", "test_reader.py"]),  # no mirror: files beside it that reach it
    ],
)
def test_tests_of_a_constant_are_those_of_its_module_and_its_readers(
    name: str, files: list[str], tree: SourceTree
) -> None:
    module, _, base = name.rpartition(".")
    (constant,) = [one for one in mutants.find_constants(tree, module) if one.name == base]
    assert [path.name for path in tree.select_tests(constant)] == files


def test_a_draw_hardly_changes_where_a_constant_goes(tree: SourceTree) -> None:
    constants = [mutants.Constant("models.m", f"LIMIT_{k}", 1.0, (1, 0), (1, 1)) for k in range(50)]
    drawn = mutants.draw_mutants(constants, 3, 10, [1.3, 0.7])
    rest = mutants.draw_mutants([one for one in constants if one != drawn[0][0]], 3, 10, [1.3, 0.7])
    assert rest[:-1] == drawn[1:]
    assert {new for _, new in drawn} == {1.3, 0.7}


@pytest.mark.parametrize(("old", "factor", "new"), [(3, 0.7, 2), (1, 1.3, 2), (10, 1.3, 13), (0.3, 1.3, 0.39)])
def test_an_integer_is_rounded_away_from_its_old_value(old: float, factor: float, new: float) -> None:
    assert mutants.change(old, factor) == new
    assert type(mutants.change(old, factor)) is type(old)


def test_a_mutant_changes_one_number_and_no_tree_that_is_linked_to_it(tree: SourceTree, tmp_path: Path) -> None:
    path, linked = tmp_path / "models" / "gates.py", tmp_path / "linked.py"
    os.link(path, linked)
    (constant,) = [one for one in mutants.find_constants(tree, "models.gates") if one.name == "SHARES[1]"]
    mutants.write_mutant(path, constant, 0.65)
    assert path.read_text() == SOURCE.replace("0.5", "0.65")
    assert linked.read_text() == SOURCE
