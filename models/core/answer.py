"""The answer to a question: one value, which terminal, JSON, page, picture and Python show."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
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
    figures: tuple[Path, ...] = ()
    """Pictures, pages and tables that were written."""

    def __getitem__(self, name: str) -> Quantity:
        """Return the quantity with a name.

        Raises:
            KeyError: The answer has none.
        """
        for one in self.quantities:
            if one.name == name:
                return one
        raise KeyError(f"this answer has {', '.join(one.name for one in self.quantities) or 'no quantity'}; not {name}")

    def __repr__(self) -> str:
        verdict = f" {self.verdict} ({self.probability:.3f})" if self.verdict else f" {self.sentences[0]}"
        return f"Answer({self.question}{verdict})"

    def _repr_html_(self) -> str:
        """Show the answer in a notebook: its sentences, its table and its pictures."""
        parts = [f"<p><b>{escape(self.question)}</b></p>", *(f"<p>{escape(text)}</p>" for text in self.sentences)]
        rows = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows]
        parts += [f"<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"] if rows else []
        return "".join(parts)
