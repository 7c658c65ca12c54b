"""Every method that is compared, in the order of the tables."""

from __future__ import annotations

from models.neural.method import Method
from pipeline.thesis.curves import CURVES
from pipeline.thesis.physics import ArmsFit, SpringsFit

PHYSICS: dict[str, Method] = {"double-pendulum": SpringsFit(), "real": ArmsFit()}
"""The fit of the physics itself, by scene."""
PHYSICS_NAMES = tuple(sorted({method.name for method in PHYSICS.values()}))
THESIS_NETS: tuple[str, ...] = ()
CONSTRAINT_NET = "ConstraintNet"


def methods_for(scene: str) -> list[Method]:
    """The methods that can be run on a scene."""
    return [*CURVES, *([PHYSICS[scene]] if scene in PHYSICS else [])]
