"""Names of the product: what the glossary and the style guide ask of them."""

from __future__ import annotations

from pathlib import Path

from support.code_structure import (
    denied_names,
    duplicate_base_names,
    duplicate_class_names,
    is_one_word,
    is_participle,
    names_bound_twice,
    read_modules,
)

ROOT = Path(__file__).resolve().parent.parent
MODULES = read_modules(ROOT)
MOST_PARTICIPLES = 0.02
MOST_ONE_WORD_NAMES = 0.1


def test_no_two_modules_share_a_base_name() -> None:
    assert not duplicate_base_names(MODULES)


def test_no_two_classes_share_a_name() -> None:
    assert not duplicate_class_names(MODULES)


def test_no_module_binds_a_name_twice() -> None:
    """The second of two constants would silently replace the first in the functions above it."""
    assert not {module.name: names for module in MODULES if (names := names_bound_twice(module))}


def test_every_package_describes_itself() -> None:
    folders = {module.path.parent for module in MODULES}
    described = {m.path.parent for m in MODULES if m.path.name == "__init__.py" and m.tree.body}
    assert folders == described


def test_no_variable_is_called_by_a_bare_participle() -> None:
    assert not [f"{m.path}:{line} {name}" for m in MODULES for line, name in denied_names(m)]


def test_functions_are_verbs() -> None:
    functions = [node.name for module in MODULES for node in module.functions()]
    participles = [name for name in functions if is_participle(name)]
    assert len(participles) <= MOST_PARTICIPLES * len(functions), participles


def test_private_functions_have_names_of_several_words() -> None:
    functions = [node.name for module in MODULES for node in module.functions()]
    one_word = [name for name in functions if is_one_word(name)]
    assert len(one_word) <= MOST_ONE_WORD_NAMES * len(functions), one_word
