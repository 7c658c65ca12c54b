"""The files of the page: words in one place, libraries as npm gives them, nothing from elsewhere."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[3] / "pipeline" / "app" / "page"
VENDORED = PAGE / "vendor"
SCRIPTS = sorted(path for path in PAGE.rglob("*.js") if VENDORED not in path.parents)
WORDS = "strings.js"
"""The only script with words that a person reads or hears."""
SPOKEN = r"(?:aria-label|aria-valuetext|aria-description|title|placeholder|alt|label)"
"""Attributes that a person reads or hears."""


def find_templates(source: str) -> list[str]:
    """Find the templates of a script, with a placeholder for each value; nested templates stand for themselves."""
    found: list[str] = []

    def read_template(at: int) -> int:
        parts = []
        while source[at] != "`":
            if source.startswith("${", at):
                parts.append("\0")
                at = read_value(at + 2)
            else:
                parts.append(source[at])
                at += 2 if source[at] == "\\" else 1
        found.append("".join(parts))
        return at + 1

    def read_value(at: int) -> int:
        depth = 1
        while depth:
            depth += {"{": 1, "}": -1}.get(source[at], 0)
            is_markup = source.startswith("html`", at)
            if is_markup:
                at = read_template(at + 5)
            elif source[at] == "`":
                before = len(found)
                at = read_template(at + 1)
                del found[before:]  # a text, such as a class
            else:
                at += 1
        return at

    at = source.find("html`")
    while at >= 0:
        at = source.find("html`", read_template(at + 5))
    return found


def find_words(source: str) -> list[str]:
    """Find the literal words of the templates of a script that a person reads or hears."""
    words = []
    source = re.sub(r"(?m)^\s*//[^\n]*$|/\*\*(?s:.*?)\*/", "", source)
    for template in find_templates(source):
        words += re.findall(rf'\s{SPOKEN}="([^"\0]*[A-Za-z][^"]*)"', template)
        words += re.findall(r"[A-Za-z]{2,}[^\0<>]*", re.sub(r"<[^>]*>", "\0", template))
    return words


@pytest.mark.parametrize("script", [one for one in SCRIPTS if one.name != WORDS], ids=lambda one: one.name)
def test_no_word_lies_outside_the_file_of_strings(script: Path) -> None:
    assert find_words(script.read_text(encoding="utf-8")) == []


def test_literal_words_are_found_wherever_they_hide() -> None:
    source = 'html`<p title="Tip" class=${`a ${b} c`}>${x ? html`<b>Bold ${y}</b>` : null}<i>Plain</i> ${text.z}</p>`'
    assert sorted(find_words(source)) == ["Bold ", "Plain", "Tip"]


def test_every_import_is_a_file_of_the_page() -> None:
    for script in [*SCRIPTS, *VENDORED.glob("*.js")]:
        for target in re.findall(r'(?:from|import) ?"([^"]+)"', script.read_text(encoding="utf-8")):
            assert (script.parent / target).resolve().is_file(), f"{script.name} imports {target}"


def test_vendored_libraries_are_those_of_the_lock_file() -> None:
    locked = json.loads((VENDORED / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    for copy in VENDORED.glob("*.js"):
        name, version = re.match(r"/\*! (\S+) (\S+),", copy.read_text(encoding="utf-8")).groups()
        assert locked[f"node_modules/{name}"]["version"] == version
        assert (VENDORED / f"{name}.LICENSE").is_file()


def test_the_page_names_no_other_machine() -> None:
    for path in PAGE.rglob("*"):
        if path.suffix in (".html", ".css", ".js") and VENDORED not in path.parents:
            addresses = re.findall(r"(?:https?:)?//[a-z][\w.-]+\.\w+", path.read_text(encoding="utf-8"))
            assert addresses == [], path.name
