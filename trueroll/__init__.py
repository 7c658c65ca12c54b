"""trueroll: a clip of a billiards shot goes in; slow motion, tracks, contact times and a fitted model come out.

    import trueroll

    shot = trueroll.run("shot.mp4")
    shot.events                       # strikes, contacts, pockets, rests, with their errors
    shot.trajectory.at(1.25).xy       # where every ball was at 1.25 s, m
    trueroll.call(shot, "first cue")  # an umpire's question; so what_if, predict, put_back, compare, ...
    report = trueroll.diagnose("out/shot-1", "out/shot-2")

This package is the public API: it re-exports documented names of other packages, and imports them at their first use.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from models.core.answer import Answer
    from models.core.errors import TruerollError
    from pipeline.analysis_api import detect, diagnose, simulate
    from pipeline.api import RallyRun, Run, load, run
    from pipeline.cli.answer_api import call, certify, compare, convert, fit_table, predict, put_back, what_if

    __version__: str

__all__ = [
    "Answer", "RallyRun", "Run", "TruerollError", "__version__", "call", "certify", "compare", "convert", "detect",
    "diagnose", "fit_table", "load", "predict", "put_back", "run", "simulate", "what_if",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a name at its first use: `import trueroll` and `python -m trueroll` would take seconds otherwise."""
    home: ModuleType
    match name:
        case "RallyRun" | "Run" | "load" | "run":
            from pipeline import api as home
        case "call" | "certify" | "compare" | "convert" | "fit_table" | "predict" | "put_back" | "what_if":
            from pipeline.cli import answer_api as home
        case "detect" | "diagnose" | "simulate":
            from pipeline import analysis_api as home
        case "Answer":
            from models.core import answer as home
        case "TruerollError":
            from models.core import errors as home
        case "__version__":
            from importlib.metadata import version

            return version("trueroll")
        case _:
            raise AttributeError(f"module 'trueroll' has no attribute {name!r}")
    return getattr(home, name)


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
