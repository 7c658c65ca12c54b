"""Every effect that the fit can hold; adding one is one file and one line here."""

from __future__ import annotations

from models.effects.ball_restitution import BallRestitution
from models.effects.cushion_restitution import CushionRestitution
from models.effects.effect import Effect, Prior
from models.effects.rolling_resistance import RollingResistance
from models.effects.sliding_friction import SlidingFriction

BILLIARDS: tuple[Effect, ...] = (RollingResistance(), SlidingFriction(), CushionRestitution(), BallRestitution())


def prior_of(effect: str, parameter: str) -> Prior:
    """The prior of a parameter; ValueError for a name that the catalogue does not hold."""
    for entry in BILLIARDS:
        for prior in entry.parameters:
            if (entry.name, prior.name) == (effect, parameter):
                return prior
    raise ValueError(f"the catalogue holds {', '.join(e.name for e in BILLIARDS)}; it has no {effect}.{parameter}")
