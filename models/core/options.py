"""What can be chosen where balls are followed and fitted: light to import, the command line is made from it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TrackOptions:
    """How detections become tracks."""

    breadth: int = 8
    """readings of an ambiguous moment that are followed side by side; 1 decides at once"""
    patience: float = 0.4
    """s that an ambiguous moment may stay undecided"""
    balls: int = 0
    """most balls on the table; 0: as many as are seen"""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How a shot is fitted."""

    quick: bool = False
    """fewer iterations of the joint refinement."""
    break_price: float = 20.0
    """chi2 that a contact must improve where something is near that may cause it."""
    free_price: float = 150.0
    """chi2 that a change of velocity must improve where nothing is near."""
    laws: bool = False
    """explain whole shots by published laws as well: spin, friction of the cushions, the size of the balls. Takes up
    to a minute, and the first time on a machine two more to compile."""
    profile: str = ""
    """a table profile that trueroll diagnose wrote (FILE): laws and numbers to start from, as with --laws."""
    moving_speed: float = 0.02
    """m/s above which a ball counts as moving."""


@dataclass(frozen=True, slots=True)
class ForecastOptions:
    """What is foretold beside what happened."""

    fans: bool = False
    """show in the recording where balls could have gone, foretold from a few moments of the shot. The first time on
    a machine it takes a minute to compile."""
