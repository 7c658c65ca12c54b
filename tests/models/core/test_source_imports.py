"""Imports are found as parsing the whole source would find them."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from models.core.module_discovery import find_imports

ROOT = Path(__file__).resolve().parents[3]


def parse_imports(source: bytes) -> set[tuple[int, str, tuple[str, ...]]]:
    imports: set[tuple[int, str, tuple[str, ...]]] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            imports.update((0, alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            imports.add((node.level, node.module or "", tuple(alias.name for alias in node.names)))
    return imports


@pytest.mark.parametrize(
    "source",
    [
        "import a\nimport b.c as d, e\n",
        "from a import (\n    b,\n    c as d,\n)\n",
        "from . import a\nfrom ..b import c\n",
        "from a import b, \\\n    c\n",
        "from a import (  # (of all)\n    b,\n    c,\n)\n",
        "def f():\n    if g:\n        import a\n    else:\n        from b import c  # noqa\n",
        "try:\n    import a\nexcept ImportError:\n    import b\nfinally:\n    import c\n",
        "match a:\n    case 1:\n        import b\n",
        "if a: import b\n",
        "a = 1; import b\n",
        "# import is a word here\nimport a\n",
        "x = 1\n",
        "",
    ],
)
def test_every_import_is_found_wherever_it_stands(source: str) -> None:
    assert set(find_imports(source.encode())) == parse_imports(source.encode())


def test_every_import_of_the_project_is_found() -> None:
    sources = [
        path.read_bytes() for package in ("models", "video", "pipeline") for path in (ROOT / package).rglob("*.py")
    ]
    assert sources
    for source in sources:
        assert parse_imports(source) <= set(find_imports(source))


def test_a_source_that_cannot_be_parsed_is_a_syntax_error() -> None:
    with pytest.raises(SyntaxError):
        find_imports(b"if a: import b, (\n")
