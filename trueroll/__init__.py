"""trueroll: a clip of a billiards shot goes in; slow motion, tracks, contact times and a fitted model come out.

    import trueroll

    shot = trueroll.run("shot.mp4")
    shot.events                       # strikes, contacts, pockets, rests, with their errors
    shot.trajectory.at(1.25).xy       # where every ball was at 1.25 s, m
    report = trueroll.diagnose("out/shot-1", "out/shot-2")

This package is the public API: it re-exports documented names of `pipeline` and holds no code of its own.
"""

from models.core.errors import TruerollError
from pipeline.analysis_api import detect, diagnose, simulate
from pipeline.api import Run, run

__all__ = ["Run", "TruerollError", "detect", "diagnose", "run", "simulate"]
