"""All compared methods, in the order of the tables."""

from __future__ import annotations

import time
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from models.core.recording import record_points
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.rigid_bodies.rigid_body_fit import fit_rigid_bodies
from models.estimation.springs.latent_inference import infer_springs
from models.neural.common.method_interface import CURVES, MotionMethod, TrainingBudget, validate_samples
from pipeline.experiments.thesis.arm_fit import fit_arms
from pipeline.experiments.thesis.pool_scene import parse_shot_number, read_complete_segment
from pipeline.experiments.thesis.thesis_scenes import (
    SWING_COUNT,
    THROW_COUNT,
    AssessedMotion,
    body_indices,
    convert_to_angles,
    convert_to_points,
    simulate_training_swings,
    simulate_training_throws,
)
from pipeline.io.observed_shot import read_observed_shot

PHYSICS_NAME = "physics fit"
Motion = Callable[[FloatArray], FloatArray]
# Number of parameters: friction, restitution, drag, gravity, radius and density of the ball.
BOXES_NUMBERS = 6


@dataclass(frozen=True, slots=True)
class PhysicsFit:
    """A fit of the physics behind the points; seed and budget have no effect, as a part of a fit is none."""

    explain: Callable[[FloatArray, FloatArray], tuple[Motion, int, Sequence[str]]]
    """Maps times (T,) and coordinates (T, N, 2) to the motion, its number of parameters, and doubts about it."""
    name: str = PHYSICS_NAME

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Fit the physics."""
        began = time.process_time()
        motion, count, doubts = self.explain(*validate_samples(times, states))
        return AssessedMotion(motion, np.empty(0), count, time.process_time() - began, tuple(doubts))


def _explain_springs(t: FloatArray, x: FloatArray) -> tuple[Motion, int, Sequence[str]]:
    """Find masses, springs, dampers and gravity behind the points, without further input."""
    latent = infer_springs(record_points(t, x))
    return lambda t: latent.states_at(t)[:, 0], len(latent.names), latent.rejections


def _explain_arms(t: FloatArray, x: FloatArray) -> tuple[Motion, int, Sequence[str]]:
    """Fit two rigid arms with friction behind the points of a recorded double pendulum."""
    motion, fitted = fit_arms(t, convert_to_angles(x))
    return lambda t: convert_to_points(motion(t)), len(fitted), ()


def _explain_boxes(t: FloatArray, x: FloatArray) -> tuple[Motion, int, Sequence[str]]:
    """Fit colliding rigid bodies behind the points of the boxes, given the body of each point."""
    bodies = fit_rigid_bodies(t, x, body_indices())
    return bodies.positions_at, BOXES_NUMBERS, bodies.warnings


@dataclass(frozen=True, slots=True)
class BilliardsFit:
    """The fit of a shot, given the table, the camera and the measurement errors of the run."""

    run: Path
    shot: int
    name: str = PHYSICS_NAME

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Fit the shot; seed and budget have no effect. Positions in metres are those of the run at these times."""
        from models.estimation.reconstruction.explain_shot import explain
        from models.estimation.reconstruction.shot_views import view_shot  # slow to import

        t, _ = validate_samples(times, states)
        segment = read_complete_segment(self.run, self.shot)
        tracks, scene, _ = read_observed_shot(self.run, self.shot)
        began = time.process_time()
        visible = select_tracks(tracks, find_nearest_rows(tracks.t, t + segment.t[0]), segment.ids)
        fit = view_shot(explain(visible, scene))
        seconds = time.process_time() - began
        radius = scene.table.ball_radius

        def motion(t: FloatArray) -> FloatArray:
            frames = tracks.frame[find_nearest_rows(tracks.t, t + segment.t[0])]
            xy = fit.trajectory.at(t + segment.t[0]).xy
            order = [fit.trajectory.ids.index(name) for name in segment.ids]
            return scene.camera.to_pixels(xy[:, order], radius, frames[:, None])

        doubts = fit.trust.reasons if fit.trust.level == "red" else ()
        return AssessedMotion(motion, np.empty(0), len(fit.parameters), seconds, tuple(doubts))


def find_nearest_rows(t: FloatArray, wanted: FloatArray) -> IntArray:
    """Find the row of t (T,) that is nearest to each of the times `wanted` (M,)."""
    return np.asarray(np.abs(t[:, None] - wanted).argmin(axis=0), np.int64)


def select_tracks(tracks: Tracks, rows: IntArray, ids: tuple[str, ...]) -> Tracks:
    """Select frames and balls of tracks."""
    balls = np.array([tracks.ids.index(name) for name in ids])
    part = np.ix_(rows, balls)
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], ids=ids, kinds=tuple(tracks.kinds[k] for k in balls),
        looks=tuple(tracks.looks[k] for k in balls),
        xy=tracks.xy[part], px=tracks.px[part], sigma=tracks.sigma[part], sigma_along=tracks.sigma_along[part],
        streak=tracks.streak[part], radius_px=tracks.radius_px[part], colour=tracks.colour[balls],
        image_jacobian=None if tracks.image_jacobian is None else tracks.image_jacobian[part],
    )  # fmt: skip


# The fit of the physics itself, by scene.
PHYSICS: dict[str, MotionMethod] = {
    "double-pendulum": PhysicsFit(_explain_springs), "real": PhysicsFit(_explain_arms),
    "boxes": PhysicsFit(_explain_boxes),
}  # fmt: skip
SPLINES = tuple(method.name for method in CURVES[1:])
# The network of Chen 2022 with corrected times (`models.neural.networks.neural_runge_kutta`).
THESIS_NET = "RK net"
THESIS_NETS = (THESIS_NET, "Euler net", "RK net as printed", "RK net, end miss", "extrapolation net")
CONSTRAINT_NET, PRETRAINED_NET = "ConstraintNet", "ConstraintNet, taught"
# One method of each kind, compared in all settings; the other methods run in the setting of the thesis alone.
REPRESENTATIVES = (
    "linear", *SPLINES, THESIS_NET, "RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net",
    CONSTRAINT_NET, PHYSICS_NAME,
)  # fmt: skip
# Those of `REPRESENTATIVES` that train on three coordinates within seconds.
QUICK_NETS = ("RK net, tanh, L-BFGS", "net(x, v)", "Hamiltonian net", "interaction net")
# Networks of a quick run by scene and noise (px): those whose training settles within its time limit.
NETS_IN_QUICK_RUN = {
    ("double-pendulum", 0.0): (THESIS_NET, "Hamiltonian net"),
    ("double-pendulum", 0.1): (THESIS_NET, "Hamiltonian net"),
    ("boxes", 0.0): (THESIS_NET,),
    ("pool", 0.0): (THESIS_NET,),
}
# Networks that run with one seed outside the setting of the thesis, by default.
SLOW_NETS = {
    "double-pendulum": (THESIS_NET, CONSTRAINT_NET), "boxes": (THESIS_NET, CONSTRAINT_NET, *QUICK_NETS),
}  # fmt: skip
# Inputs of methods beyond the visible samples, by scene.
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
    from models.neural.networks.constraint_net import PretrainedConstraintNet

    # four layers of 512 and ten projections where bodies collide: Yang, He, Zhu 2020
    net = replace(NARROW, widths=(512, 512, 512, 512), iterations=10) if scene == "boxes" else NARROW
    methods = [net if method is NARROW else method for method in METHODS]
    if scene in ("double-pendulum", "boxes"):
        lessons = partial(simulate_training_throws if scene == "boxes" else simulate_training_swings, variant)
        methods.append(PretrainedConstraintNet(lessons, PRETRAINED_NET, net))
    if scene == "pool" and run is not None:
        return [*methods, BilliardsFit(run, parse_shot_number(variant))]
    return [*methods, *([PHYSICS[scene]] if scene in PHYSICS else [])]
