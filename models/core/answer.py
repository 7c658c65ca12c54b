"""The answer to a question: one value, which terminal, JSON, page, image and Python show.

A new answer is a new question, and a question is a command: a file `pipeline/cli/commands/NAME_command.py` with a
function under `@answer_command("NAME")` that returns an `Answer`; what it does lies in `pipeline/actions/`, numbers in
`models/`. The name is then listed in `COMMAND_NAMES` of `pipeline/cli/commands/__init__.py`, the function exported in
`pipeline/cli/answer_api.py` and `trueroll/__init__.py`, and the command described in docs/reference/commands.md.
Printing and `--json` need no code. docs/how-to/extend.md gives the details.
"""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from html import escape
from typing import Any


@dataclass(frozen=True, slots=True)
class Quantity:
    """One measured quantity of an answer."""

    name: str
    value: float
    sigma: float = math.nan
    """Standard deviation; NaN where it is unknown."""
    unit: str = ""
    ball: str = ""
    """Id of the ball that it belongs to; empty for none."""
    ball_name: str = ""
    """What a person calls that ball."""


@dataclass(frozen=True, slots=True, repr=False)
class Answer:
    """Answer to one question about shots."""

    question: str
    """In words, with the names of the balls."""
    sentences: tuple[str, ...]
    """The answer in words, the main sentence first."""
    verdict: str = ""
    """In few words, such as `yes`, `red 3`, `cannot be decided`; empty for a question that is not decided."""
    probability: float = math.nan
    """Of the verdict."""
    quantities: tuple[Quantity, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    """A table in words: the headings, then the rows."""
    notes: tuple[str, ...] = ()
    """What else one must know, after the table."""
    refusals: tuple[str, ...] = ()
    """What was left out because it could not be used, and why."""
    document: Mapping[str, Any] = field(default_factory=dict)
    """The answer as JSON values."""
    figures: tuple[str, ...] = ()
    """Files of the images, pages and tables that were written."""

    def __getitem__(self, key: str | tuple[str, str]) -> Quantity:
        """Return a quantity by its name, or by its name and a ball where every ball has one.

        Args:
            key: Such as `"margin"`, or `("x", "red 3")`; a ball by its id or by what a person calls it.

        Raises:
            KeyError: The answer has none, or of several balls.
        """
        name, ball = (key, "") if isinstance(key, str) else key
        fitting = [one for one in self.quantities if one.name == name and ball in ("", one.ball, one.ball_name)]
        if len(fitting) == 1:
            return fitting[0]
        names = ", ".join(dict.fromkeys(one.name for one in self.quantities)) or "no quantity"
        balls = f" of a ball, such as {name!r}, {fitting[0].ball_name!r}" if fitting else ""
        raise KeyError(f"this answer has {names}{balls}; got {key!r}")

    def __repr__(self) -> str:
        verdict = f"{self.verdict} ({self.probability:.3f})" if self.verdict else self.sentences[0]
        return f"Answer({self.question} {verdict})"

    def _repr_html_(self) -> str:
        """Show the answer in a notebook: its sentences, its table and its images."""
        parts = [format_html((self.question, *self.sentences), self.rows), format_html(self.notes)]
        parts.append(format_html([f"Left out: {one}" for one in self.refusals]))
        for path in self.figures:
            if path.endswith(".png"):
                with suppress(OSError), open(path, "rb") as file:
                    parts.append(f'<img src="data:image/png;base64,{b64encode(file.read()).decode()}"/>')
        return "".join(parts)


def format_html(sentences: Iterable[str], rows: Sequence[Sequence[str]] = ()) -> str:
    """Format sentences and a table for a notebook.

    Args:
        sentences: One paragraph each.
        rows: The headings, then the rows; empty for no table.

    Returns:
        HTML.
    """
    parts = [f"<p>{escape(text)}</p>" for text in sentences]
    lines = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "".join([*parts, f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>" if lines else ""])
