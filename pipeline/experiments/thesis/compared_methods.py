"""All compared methods, in the order of the tables."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import replace
from functools import partial
from pathlib import Path

from models.neural.common.method_interface import MotionMethod
from models.neural.common.spline_methods import CURVES
from pipeline.experiments.thesis.physics_methods import ArmsFit, BoxesFit, SpringsFit
from pipeline.experiments.thesis.pool_method import BilliardsFit
from pipeline.experiments.thesis.scenes.constraint_training_data import (
    SWING_COUNT,
    THROW_COUNT,
    simulate_training_swings,
    simulate_training_throws,
)
from pipeline.experiments.thesis.scenes.pool_scene import parse_shot_number

PHYSICS: dict[str, MotionMethod] = {"double-pendulum": SpringsFit(), "real": ArmsFit(), "boxes": BoxesFit()}
"""The fit of the physics itself, by scene."""
PHYSICS_NAME = SpringsFit().name
SPLINES = tuple(method.name for method in CURVES[1:])
THESIS_NET = "RK net"
"""The network of Chen 2022 with corrected times (`models.neural.networks.neural_runge_kutta`)."""
THESIS_NETS = (THESIS_NET, "Euler net", "RK net as printed", "RK net, end miss", "extrapolation net")
CONSTRAINT_NET, PRETRAINED_NET = "ConstraintNet", "ConstraintNet, taught"
REPRESENTATIVES = (
    "linear", *SPLINES, THESIS_NET, "RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net",
    CONSTRAINT_NET, PHYSICS_NAME,
)  # fmt: skip
"""One method of each kind, compared in all settings; the other methods run in the setting of the thesis alone."""
QUICK_NETS = ("RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net")
"""Those of `REPRESENTATIVES` that train on three coordinates within seconds."""
NETS_IN_QUICK_RUN = {
    ("double-pendulum", 0.0): (THESIS_NET, "Hamiltonian net"),
    ("double-pendulum", 0.1): (THESIS_NET, "Hamiltonian net"),
    ("boxes", 0.0): (THESIS_NET,),
    ("pool", 0.0): (THESIS_NET,),
}
"""Networks of a quick run by scene and noise (px): those whose training settles within its time limit."""
SLOW_NETS = {
    "double-pendulum": (THESIS_NET, CONSTRAINT_NET), "boxes": (THESIS_NET, CONSTRAINT_NET, *QUICK_NETS),
}  # fmt: skip
"""Networks that run with one seed outside the setting of the thesis, by default."""
EXTRA_INPUTS: dict[str, dict[str, str]] = {
    "double-pendulum": {
        PRETRAINED_NET: (
            f"trained on {SWING_COUNT} simulated swings of the same pendulum, released at other angles, without noise."
        ),
        PHYSICS_NAME: "nothing beyond the samples.",
    },
    "real": {PHYSICS_NAME: "given that the points are joined by two rigid arms."},
    "boxes": {
        PRETRAINED_NET: f"trained on {THROW_COUNT} other throws of the same speed, without noise.",
        PHYSICS_NAME: "given which corners belong to one box.",
    },
    "pool": {PHYSICS_NAME: "given the table and the camera of the run."},
}
"""Inputs of methods beyond the visible samples, by scene."""


def is_network(method: str) -> bool:
    """Return whether a method is a network: no spline and no fit of the physics."""
    return method not in ("linear", *SPLINES, PHYSICS_NAME)


def describe_extra_inputs(scene: str, methods: Container[str]) -> str:
    """Describe the inputs of methods beyond the visible samples.

    Args:
        scene: Name of the scene.
        methods: Names of methods.

    Returns:
        One sentence for each of these methods that had more inputs.
    """
    return " ".join(f"{name}: {text}" for name, text in EXTRA_INPUTS[scene].items() if name in methods)


def build_methods(scene: str, variant: str = "", run: Path | None = None) -> list[MotionMethod]:
    """Build the methods that can run on a variant of a scene.

    Args:
        scene: Name of the scene.
        variant: Variant of the scene.
        run: Run folder of the pool scene.

    Returns:
        Methods in the order of the tables.
    """
    from models.neural.method_catalogue import METHODS  # torch takes seconds to import
    from models.neural.networks.constraint_net import CONSTRAINT_NET as NARROW
    from models.neural.networks.pretrained_constraint_net import PretrainedConstraintNet

    # four layers of 512 and ten projections where bodies collide: Yang, He, Zhu 2020
    net = replace(NARROW, widths=(512, 512, 512, 512), iterations=10) if scene == "boxes" else NARROW
    methods = [net if method is NARROW else method for method in METHODS]
    if scene in ("double-pendulum", "boxes"):
        lessons = partial(simulate_training_throws if scene == "boxes" else simulate_training_swings, variant)
        methods.append(PretrainedConstraintNet(lessons, PRETRAINED_NET, net))
    if scene == "pool" and run is not None:
        return [*methods, BilliardsFit(run, parse_shot_number(variant))]
    return [*methods, *([PHYSICS[scene]] if scene in PHYSICS else [])]
