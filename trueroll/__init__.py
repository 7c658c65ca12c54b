"""trueroll: a clip of a billiards shot goes in; slow motion, tracks, contact times and a fitted model come out.

    import trueroll

    shot = trueroll.run("shot.mp4")
    shot.events                       # strikes, contacts, pockets, rests, with their errors
    shot.trajectory.at(1.25).xy       # where every ball was at 1.25 s, m
    report = trueroll.diagnose("out/shot-1", "out/shot-2")

This package is the public API: it re-exports documented names of other packages, and imports them at their first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from models.core.errors import TruerollError
    from pipeline.analysis_api import detect, diagnose, simulate
    from pipeline.api import Run, run

__all__ = ["Run", "TruerollError", "detect", "diagnose", "run", "simulate"]

_MODULES = {
    "Run": "pipeline.api",
    "TruerollError": "models.core.errors",
    "detect": "pipeline.analysis_api",
    "diagnose": "pipeline.analysis_api",
    "run": "pipeline.api",
    "simulate": "pipeline.analysis_api",
}
"""Module of each name."""


def __getattr__(name: str) -> Any:
    """Import a name at its first use: `import trueroll` and `python -m trueroll` would take seconds otherwise."""
    if name not in _MODULES:
        raise AttributeError(f"module 'trueroll' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
