"""A motion that says what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass

from models.neural.common.method_interface import Fitted


@dataclass(frozen=True, slots=True)
class Judged(Fitted):
    """A motion that says what is wrong with it."""

    doubts: tuple[str, ...]
    """Why it should not be believed; empty where it may be."""
