"""Every method that is compared, in the order of the tables."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import partial
from pathlib import Path

from models.neural.common.method_interface import Method
from models.neural.common.spline_methods import CURVES
from pipeline.experiments.thesis.physics_methods import ArmsFit, BoxesFit, SpringsFit
from pipeline.experiments.thesis.pool_method import BilliardsFit
from pipeline.experiments.thesis.scenes.constraint_lessons import SWINGS, THROWS, swings, throws
from pipeline.experiments.thesis.scenes.pool_scene import number_of

PHYSICS: dict[str, Method] = {"double-pendulum": SpringsFit(), "real": ArmsFit(), "boxes": BoxesFit()}
"""The fit of the physics itself, by scene."""
PHYSICS_NAME = SpringsFit().name
SPLINES = tuple(method.name for method in CURVES[1:])
THESIS_NET = "RK net"
"""The network of Chen 2022 with its times mended (`models.neural.networks.neural_runge_kutta`)."""
THESIS_NETS = (THESIS_NET, "Euler net", "RK net as printed", "RK net, end miss", "extrapolation net")
CONSTRAINT_NET, TAUGHT = "ConstraintNet", "ConstraintNet, taught"
EACH_KIND = (
    "linear", *SPLINES, THESIS_NET, "RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net",
    CONSTRAINT_NET, PHYSICS_NAME,
)  # fmt: skip
"""One method of each kind: what is compared in all settings; the others in the setting of the thesis alone."""
QUICK_NETS = ("RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net")
"""Those of `EACH_KIND` that learn three coordinates within seconds."""
SLOW_NETS = {
    "double-pendulum": (THESIS_NET, CONSTRAINT_NET), "boxes": (THESIS_NET, CONSTRAINT_NET, *QUICK_NETS),
}  # fmt: skip
"""Networks that have one seed outside the thesis' own setting, if nothing else is asked for."""
GIVEN: dict[str, dict[str, str]] = {
    "double-pendulum": {
        TAUGHT: f"learnt from {SWINGS} simulated swings of the same pendulum, let go at other angles, without noise.",
        PHYSICS_NAME: "told nothing.",
    },
    "real": {PHYSICS_NAME: "told that the points are joined by two stiff arms."},
    "boxes": {
        TAUGHT: f"learnt from {THROWS} other throws of the same speed, without noise.",
        PHYSICS_NAME: "told which corners are of one box.",
    },
    "pool": {PHYSICS_NAME: "told the table and the camera, as the run found them."},
}
"""What methods had beside the visible samples, by scene."""


def given(scene: str, methods: Container[str]) -> str:
    """A sentence for each of some methods that had more than the visible samples."""
    return " ".join(f"{name}: {text}" for name, text in GIVEN[scene].items() if name in methods)


def methods_for(scene: str, variant: str = "", run: Path | None = None) -> list[Method]:
    """The methods that can be run on a variant of a scene, pool being that of a run's folder."""
    from models.neural.method_catalogue import METHODS  # torch takes seconds to import
    from models.neural.networks.constraint_net import CONSTRAINT_NET as NARROW
    from models.neural.networks.pretrained_constraint_net import TaughtConstraintNet

    # four layers of 512 and ten projections where bodies collide: Yang, He, Zhu 2020
    net = replace(NARROW, widths=(512, 512, 512, 512), iterations=10) if scene == "boxes" else NARROW
    methods = [net if method is NARROW else method for method in METHODS]
    if scene in ("double-pendulum", "boxes"):
        lessons = partial(throws if scene == "boxes" else swings, variant)
        methods.append(TaughtConstraintNet(lessons, TAUGHT, net))
    if scene == "pool" and run is not None:
        return [*methods, BilliardsFit(run, number_of(variant))]
    return [*methods, *([PHYSICS[scene]] if scene in PHYSICS else [])]
