"""A fitted motion with warnings."""

from __future__ import annotations

from dataclasses import dataclass

from models.neural.common.method_interface import FittedMotion


@dataclass(frozen=True, slots=True)
class AssessedMotion(FittedMotion):
    """A fitted motion with warnings."""

    warnings: tuple[str, ...]
    """Reasons not to trust it; empty where there are none."""
