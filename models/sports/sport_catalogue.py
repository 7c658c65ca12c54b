"""The sports that are known, by name."""

from __future__ import annotations

from functools import cache

from models.core.court import Sport
from models.core.module_discovery import discover_modules


@cache
def find_sports() -> dict[str, Sport]:
    """Find the sports: every module of this package that defines `SPORT`, by the name of the sport."""
    modules = discover_modules("models.sports")
    sports = (module.SPORT for module in modules if hasattr(module, "SPORT"))
    return {sport.name: sport for sport in sports}
