"""The experiments to run and their order: every setting with one seed before the next seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from models.neural.common.method_interface import (
    HOLDOUT_PATIENCE,
    MIN_HOLDOUT_GAIN,
    EarlyStopping,
    MotionMethod,
    TrainingBudget,
)
from pipeline.experiments.thesis.compared_methods import (
    NETS_IN_QUICK_RUN,
    REPRESENTATIVES,
    SLOW_NETS,
    build_methods,
    is_network,
)
from pipeline.experiments.thesis.pool_scene import build_pool_series, list_shots
from pipeline.experiments.thesis.thesis_scenes import (
    BASE_SETTING,
    FIRST_VARIANT,
    RECORDING,
    SPEEDS,
    SPRING_KINDS,
    STARTS,
    ExperimentCase,
    WithheldSeries,
    build_boxes_series,
    build_pendulum_series,
    read_recorded_series,
)

SCENES = ("double-pendulum", "real", "boxes", "pool")
# Frame rates, Hz; noise, px.
RATES, NOISES = (60.0, 30.0, 15.0), (0.0, 0.1, 0.5)
# Frame rates, Hz: 13 and 26 samples apart; at higher rates every spline is good enough.
REAL_RATES = (200 / 13, 200 / 26)


Value = TypeVar("Value", str, float)


class Depth(StrEnum):
    """Extent of the experiments."""

    QUICK = "quick"
    """The settings of the thesis, without and with little noise, and few networks, trained until they gain nothing."""
    USUAL = "usual"
    """One setting changed at a time.

    All methods run in the setting of the thesis. Elsewhere one of each kind runs, and slow networks with one seed.
    """
    WHOLE = "whole"
    """Every setting with every method, networks trained to the end."""


# Share of their training steps that networks get, and CPU time after which they stop, s.
BUDGETS = {
    Depth.QUICK: TrainingBudget(1.0, 120.0),
    Depth.USUAL: TrainingBudget(0.25, 20.0),
    Depth.WHOLE: TrainingBudget(1.0, 120.0),
}
# CPU time where it is less, s: with 402 coordinates a step takes ten times as long.
SHORTER_TRAINING_S = {(Depth.USUAL, "boxes"): 5.0}


@dataclass(frozen=True, slots=True)
class ExperimentPlan:
    """The requested experiments."""

    scenes: tuple[str, ...] = SCENES
    seeds: tuple[int, ...] = (0, 1, 2)
    depth: Depth = Depth.USUAL
    data: Path | None = None
    """Folder of the recorded pendulum; None without one."""
    run: Path | None = None
    """Run folder whose shots are the pool scene."""

    def budget(self, scene: str) -> TrainingBudget:
        """Return the training budget of a network on a scene."""
        usual = BUDGETS[self.depth]
        return TrainingBudget(usual.effort, SHORTER_TRAINING_S.get((self.depth, scene), usual.seconds))


@dataclass(frozen=True, slots=True)
class TrialTask:
    """One method on one case."""

    case: ExperimentCase
    method: str


def list_cases(plan: ExperimentPlan) -> list[ExperimentCase]:
    """List every case of the plan."""
    return [
        ExperimentCase(scene, variant, fps, noise, seed)
        for seed in plan.seeds
        for scene in plan.scenes
        if scene != "real"
        or seed == plan.seeds[0]
        or plan.depth is Depth.WHOLE  # three start times replace three seeds
        for variant, fps, noise in _iterate_settings(scene, plan)
    ]


def _iterate_settings(scene: str, plan: ExperimentPlan) -> Iterator[tuple[str, float, float]]:
    """Yield variants, frame rates and noises of a scene, the setting of the thesis first."""
    if scene == "double-pendulum" or (scene == "boxes" and _has_boxes()):
        yield from _iterate_grid(scene, tuple(SPRING_KINDS) if scene == "double-pendulum" else SPEEDS, plan.depth)
    elif scene == "real" and plan.data is not None:
        slow = REAL_RATES[-1]
        starts = tuple(STARTS)[: 1 if plan.depth is Depth.QUICK else None]
        yield from ((start, slow, 0.0) for start in starts)
        if plan.depth is not Depth.QUICK:
            yield from ((start, fps, 0.0) for start in starts for fps in REAL_RATES if fps != slow)
    elif scene == "pool" and plan.run is not None:
        yield from ((shot, fps, 0.0) for shot, fps in list_shots(plan.run))


def _has_boxes() -> bool:
    """Return whether the boxes can run: their simulator is a package of an extra."""
    return find_spec("pymunk") is not None


def _iterate_grid(scene: str, variants: tuple[str, ...], depth: Depth) -> Iterator[tuple[str, float, float]]:
    """Yield all settings; else those with one change from the thesis, and other variants with little noise."""
    own = FIRST_VARIANT[scene]
    for variant in _put_first(own, variants):
        for fps in _put_first(BASE_SETTING[0], RATES):
            for noise in _put_first(BASE_SETTING[1], NOISES):
                changed = (fps != BASE_SETTING[0]) + (noise != BASE_SETTING[1])
                if depth is Depth.QUICK and (variant != own or fps != BASE_SETTING[0] or noise > NOISES[1]):
                    continue
                near = changed < 2 if variant == own else (fps, noise) == (BASE_SETTING[0], NOISES[1])
                if depth is Depth.USUAL and not near:
                    continue
                yield variant, fps, noise


def _put_first(first: Value, values: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return the values with one of them first."""
    return tuple(sorted(values, key=lambda value: value != first))


def list_tasks(plan: ExperimentPlan) -> list[TrialTask]:
    """List the methods to run on every case.

    Args:
        plan: The requested experiments.

    Returns:
        Tasks in the order in which they run.
    """
    return [
        TrialTask(case, method.name)
        for case in list_cases(plan)
        for method in build_methods(case.scene, case.variant, plan.run)
        if plan.depth is Depth.WHOLE
        or (plan.depth is not Depth.QUICK and (case.is_own or case.scene == "pool"))
        or _is_representative(case, method.name, plan)
    ]


def _is_representative(case: ExperimentCase, method: str, plan: ExperimentPlan) -> bool:
    """Return whether a method represents its kind in a setting, with the seed of the case."""
    if plan.depth is Depth.QUICK and is_network(method):
        return method in NETS_IN_QUICK_RUN.get((case.scene, case.noise), ())
    first = case.seed == plan.seeds[0] or method not in SLOW_NETS.get(case.scene, ())
    return method in REPRESENTATIVES and first


def build_case_series(case: ExperimentCase, plan: ExperimentPlan) -> WithheldSeries:
    """Build the series of a case. OptionError where its data are missing."""
    if case.scene == "double-pendulum":
        return build_pendulum_series(case)
    if case.scene == "boxes":
        return build_boxes_series(case)
    if case.scene == "real":
        assert plan.data is not None
        return read_recorded_series(case, plan.data)
    assert plan.run is not None
    return build_pool_series(case, plan.run)


def prepare_trial(task: TrialTask, plan: ExperimentPlan) -> tuple[MotionMethod, WithheldSeries, TrainingBudget]:
    """Prepare the method, the series and the training budget of a task."""
    return find_method(task, plan), build_case_series(task.case, plan), plan.budget(task.case.scene)


def find_method(task: TrialTask, plan: ExperimentPlan) -> MotionMethod:
    """Find the method of a task; networks of a quick run stop early."""
    there = build_methods(task.case.scene, task.case.variant, plan.run)
    method = next(method for method in there if method.name == task.method)
    return EarlyStopping(method) if plan.depth is Depth.QUICK and is_network(task.method) else method


def explain_omissions(plan: ExperimentPlan) -> list[str]:
    """Explain which scenes of a plan cannot run.

    Args:
        plan: The requested experiments.

    Returns:
        One sentence for every scene that is left out.
    """
    omissions = []
    if "boxes" in plan.scenes and not _has_boxes():
        omissions.append("The boxes are left out: they need pymunk, which the extra `check` of trueroll installs.")
    if "real" in plan.scenes and plan.data is None:
        omissions.append(f"The real pendulum is left out: give --data a folder with {RECORDING}.")
    if "pool" in plan.scenes and plan.run is None:
        omissions.append("The pool scene is left out: give --run the folder of a run of `trueroll run`.")
    return omissions


def describe_training(plan: ExperimentPlan) -> str:
    """Describe how long networks trained, and which of them with one seed.

    Args:
        plan: The requested experiments.

    Returns:
        One or two sentences.
    """
    usual = BUDGETS[plan.depth]
    shorter = [
        f"{seconds:.0f} s on {scene}" for (depth, scene), seconds in SHORTER_TRAINING_S.items() if depth is plan.depth
    ]
    within = "; ".join([f"{usual.seconds:.0f} CPU s", *shorter])
    if plan.depth is Depth.QUICK:
        return (
            f"Networks were trained until {HOLDOUT_PATIENCE} steps lowered the error at held-out visible frames by "
            f"less than {MIN_HOLDOUT_GAIN:.0%}, then for as many steps on all visible frames. A network that needs "
            f"more than {within} is marked and not compared. The other networks run without --quick."
        )
    if usual.effort == 1:
        return f"Networks were trained to the end or for {within}."
    sentence = f"Networks had {usual.effort:.0%} of their training, at most {within}, and can be better than this."
    if plan.depth is Depth.USUAL and len(plan.seeds) > 1:
        sentence += " Outside the thesis' own setting the slow ones ran with the first seed alone."
    return sentence
