"""A fitted motion with warnings."""

from __future__ import annotations

from dataclasses import dataclass

from models.neural.common.method_interface import ClipMotion


@dataclass(frozen=True, slots=True)
class AssessedMotion(ClipMotion):
    """A fitted motion with warnings."""

    warnings: tuple[str, ...]
    """Reasons not to trust it; empty where there are none."""
