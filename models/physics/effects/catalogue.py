"""Every effect that the fit and the diagnosis can hold; adding one is one file and one line here."""

from __future__ import annotations

from models.physics.effect import Choice, Effect, Prior
from models.physics.effects.cloth.air_drag import AirDrag
from models.physics.effects.cloth.nap import Nap
from models.physics.effects.cloth.rolling_resistance import RollingResistance
from models.physics.effects.cloth.sliding_friction import SlidingFriction
from models.physics.effects.cloth.slope import Slope
from models.physics.effects.cloth.spin_decay import SpinDecay
from models.physics.effects.cloth.viscous_drag import ViscousDrag
from models.physics.effects.contacts.ball_friction import BallFriction
from models.physics.effects.contacts.ball_law import BallLaw
from models.physics.effects.contacts.ball_restitution import BallRestitution
from models.physics.effects.contacts.cushion_cloth import CushionCloth
from models.physics.effects.contacts.cushion_friction import CushionFriction
from models.physics.effects.contacts.cushion_law import CushionLaw
from models.physics.effects.contacts.cushion_restitution import CushionRestitution
from models.physics.effects.contacts.cushion_restitution_power import CushionRestitutionPower
from models.physics.effects.contacts.cushion_restitution_speed import CushionRestitutionSpeed
from models.physics.effects.contacts.unequal_mass import UnequalMass
from models.physics.effects.contacts.unequal_radius import UnequalRadius
from models.physics.effects.observation.dropped_frames import DroppedFrames
from models.physics.effects.observation.lens_distortion import LensDistortion
from models.physics.effects.observation.lens_second_term import LensSecondTerm
from models.physics.effects.observation.perspective import Perspective
from models.physics.effects.observation.rolling_shutter import RollingShutter
from models.physics.effects.observation.scale import Scale

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
