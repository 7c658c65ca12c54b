"""Every effect that the fit and the diagnosis can hold; adding one is one file and one line here."""

from __future__ import annotations

from models.effects.air_drag import AirDrag
from models.effects.ball_friction import BallFriction
from models.effects.ball_law import BallLaw
from models.effects.ball_restitution import BallRestitution
from models.effects.cushion_cloth import CushionCloth
from models.effects.cushion_friction import CushionFriction
from models.effects.cushion_law import CushionLaw
from models.effects.cushion_restitution import CushionRestitution
from models.effects.cushion_restitution_power import CushionRestitutionPower
from models.effects.cushion_restitution_speed import CushionRestitutionSpeed
from models.effects.dropped_frames import DroppedFrames
from models.effects.effect import Choice, Effect, Prior
from models.effects.lens_distortion import LensDistortion
from models.effects.lens_second_term import LensSecondTerm
from models.effects.nap import Nap
from models.effects.perspective import Perspective
from models.effects.rolling_resistance import RollingResistance
from models.effects.rolling_shutter import RollingShutter
from models.effects.scale import Scale
from models.effects.sliding_friction import SlidingFriction
from models.effects.slope import Slope
from models.effects.spin_decay import SpinDecay
from models.effects.unequal_mass import UnequalMass
from models.effects.unequal_radius import UnequalRadius
from models.effects.viscous_drag import ViscousDrag

BILLIARDS: tuple[Effect, ...] = (
    RollingResistance(),
    SlidingFriction(),
    SpinDecay(),
    Slope(),
    AirDrag(),
    ViscousDrag(),
    Nap(),
    CushionRestitution(),
    CushionRestitutionSpeed(),
    CushionRestitutionPower(),
    CushionFriction(),
    CushionCloth(),
    BallRestitution(),
    BallFriction(),
    UnequalMass(),
    UnequalRadius(),
    LensDistortion(),
    LensSecondTerm(),
    Perspective(),
    Scale(),
    RollingShutter(),
    DroppedFrames(),
)
BILLIARDS_LAWS: tuple[Choice, ...] = (CushionLaw(), BallLaw())
"""Choices between published forms, as effects."""


def prior_of(effect: str, parameter: str) -> Prior:
    """The prior of a parameter; ValueError for a name that the catalogue does not hold."""
    for entry in BILLIARDS:
        for prior in entry.parameters:
            if (entry.name, prior.name) == (effect, parameter):
                return prior
    raise ValueError(f"the catalogue holds {', '.join(e.name for e in BILLIARDS)}; it has no {effect}.{parameter}")
