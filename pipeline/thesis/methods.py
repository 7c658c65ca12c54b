"""Every method that is compared, in the order of the tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.curves import CURVES
from models.neural.method import Method
from pipeline.thesis.physics import ArmsFit, BoxesFit, SpringsFit
from pipeline.thesis.pool import number_of
from pipeline.thesis.pool_fit import BilliardsFit

PHYSICS: dict[str, Method] = {"double-pendulum": SpringsFit(), "real": ArmsFit(), "boxes": BoxesFit()}
"""The fit of the physics itself, by scene."""
PHYSICS_NAME = SpringsFit().name
SPLINES = tuple(method.name for method in CURVES[1:])
THESIS_NET = "RK net"
"""The network of Chen 2022 with its times mended (`models.neural.simulator`)."""
THESIS_NETS = (THESIS_NET, "Euler net", "RK net as printed", "RK net, end miss", "extrapolation net")
CONSTRAINT_NET = "ConstraintNet"


def methods_for(scene: str, variant: str = "", run: Path | None = None) -> list[Method]:
    """The methods that can be run on a variant of a scene, pool being that of a run's folder."""
    from models.neural.catalogue import METHODS  # torch takes seconds to import
    from models.neural.constraint import CONSTRAINT_NET as NARROW

    # four layers of 512 and ten projections where bodies collide: Yang, He, Zhu 2020
    wide = replace(NARROW, widths=(512, 512, 512, 512), iterations=10)
    networks = [wide if scene == "boxes" and method is NARROW else method for method in METHODS]
    if scene == "pool" and run is not None:
        return [*networks, BilliardsFit(run, number_of(variant))]
    return [*networks, *([PHYSICS[scene]] if scene in PHYSICS else [])]
