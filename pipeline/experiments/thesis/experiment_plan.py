"""Which experiments are run, and in which order: every seed of everything before the next seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

from models.neural.common.method_interface import Budget, Method
from pipeline.experiments.thesis.compared_methods import EACH_KIND, SLOW_NETS, methods_for
from pipeline.experiments.thesis.scenes.boxes_scene import SPEEDS, boxes
from pipeline.experiments.thesis.scenes.double_pendulum_scene import (
    KINDS,
    RECORDING,
    STARTS,
    double_pendulum,
    real_pendulum,
)
from pipeline.experiments.thesis.scenes.pool_scene import pool, shots_of
from pipeline.experiments.thesis.scenes.withheld_series import Case, Series

SCENES = ("double-pendulum", "real", "boxes", "pool")
RATES, NOISES = (60.0, 30.0, 15.0), (0.0, 0.1, 0.5)
"""Hz; px."""
REAL_RATES = (200 / 13, 200 / 26)
"""Hz: 13 and 26 samples apart; above them every spline is good enough."""
SECONDS = 2.5
"""of the simulated scenes."""


Value = TypeVar("Value", str, float)


class Depth(StrEnum):
    """How much is run."""

    QUICK = "quick"
    """the settings of the thesis, one method of each kind, networks barely trained."""
    USUAL = "usual"
    """one change of setting at a time; all methods in the thesis' own setting, one of each kind in the others, where
    slow networks have the first seed alone."""
    WHOLE = "whole"
    """every setting crossed with every method, networks trained to the end."""


BUDGETS = {Depth.QUICK: Budget(0.06, 4.0), Depth.USUAL: Budget(0.25, 20.0), Depth.WHOLE: Budget(1.0, 120.0)}
"""Share of their steps that networks get, and CPU s after which they learn no more."""
SHORTER = {(Depth.USUAL, "boxes"): 5.0}
"""CPU s where that is less: 402 coordinates make a step ten times as long, and the claim there is a small one."""
BASE = (30.0, 0.0)
"""Hz and px of the thesis."""
FIRST_VARIANT = {"double-pendulum": "stiff", "boxes": "800", "real": "0 s"}
"""Of the thesis, or the first."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is asked for."""

    scenes: tuple[str, ...] = SCENES
    seeds: tuple[int, ...] = (0, 1, 2)
    depth: Depth = Depth.USUAL
    data: Path | None = None
    """Folder of the recorded pendulum, None where there is none."""
    run: Path | None = None
    """Folder of a run whose shots are the pool scene."""

    def budget(self, scene: str) -> Budget:
        """How long a network may learn on a scene."""
        usual = BUDGETS[self.depth]
        return Budget(usual.effort, SHORTER.get((self.depth, scene), usual.seconds))


@dataclass(frozen=True, slots=True)
class Task:
    """One method on one case."""

    case: Case
    method: str


def cases(plan: Plan) -> list[Case]:
    """Every case of the plan."""
    return [
        Case(scene, variant, fps, noise, seed)
        for seed in plan.seeds
        for scene in plan.scenes
        if scene != "real" or seed == plan.seeds[0] or plan.depth is Depth.WHOLE  # three starts are three tries
        for variant, fps, noise in _settings(scene, plan)
    ]


def _settings(scene: str, plan: Plan) -> Iterator[tuple[str, float, float]]:
    """Variants, rates and noises of a scene, the thesis' own setting first."""
    if scene in ("double-pendulum", "boxes"):
        yield from _grid(scene, tuple(KINDS) if scene == "double-pendulum" else SPEEDS, plan.depth)
    elif scene == "real" and plan.data is not None:
        slow = REAL_RATES[-1]
        starts = tuple(STARTS)[: 1 if plan.depth is Depth.QUICK else None]
        yield from ((start, slow, 0.0) for start in starts)
        if plan.depth is not Depth.QUICK:
            yield from ((start, fps, 0.0) for start in starts for fps in REAL_RATES if fps != slow)
    elif scene == "pool" and plan.run is not None:
        yield from ((shot, fps, 0.0) for shot, fps in shots_of(plan.run))


def _grid(scene: str, variants: tuple[str, ...], depth: Depth) -> Iterator[tuple[str, float, float]]:
    """All settings crossed; else rate or noise changed from the thesis' own, and other variants with little noise."""
    own = FIRST_VARIANT[scene]
    for variant in _led_by(own, variants):
        for fps in _led_by(BASE[0], RATES):
            for noise in _led_by(BASE[1], NOISES):
                changed = (fps != BASE[0]) + (noise != BASE[1])
                if depth is Depth.QUICK and (variant != own or changed):
                    continue
                near = changed < 2 if variant == own else (fps, noise) == (BASE[0], NOISES[1])
                if depth is Depth.USUAL and not near:
                    continue
                yield variant, fps, noise


def _led_by(first: Value, values: tuple[Value, ...]) -> tuple[Value, ...]:
    """The values, one of them before all others."""
    return tuple(sorted(values, key=lambda value: value != first))


def tasks(plan: Plan) -> list[Task]:
    """Every method on every case, or what stands for it."""
    return [
        Task(case, method.name)
        for case in cases(plan)
        for method in methods_for(case.scene, case.variant, plan.run)
        if plan.depth is Depth.WHOLE or _is_own(case, plan.depth) or _is_told(case, method.name, plan)
    ]


def _is_told(case: Case, method: str, plan: Plan) -> bool:
    """Whether a method stands for its kind in a setting, with the seed of the case."""
    first = case.seed == plan.seeds[0] or method not in SLOW_NETS.get(case.scene, ())
    return method in EACH_KIND and (first or plan.depth is Depth.QUICK)


def _is_own(case: Case, depth: Depth) -> bool:
    """Whether all methods are run: in the thesis' own setting, if there is time."""
    own = FIRST_VARIANT.get(case.scene) == case.variant and (case.fps, case.noise) == BASE
    return depth is not Depth.QUICK and (own or case.scene == "pool")


def series_of(case: Case, plan: Plan) -> Series:
    """The series of a case. OptionError where its material is missing."""
    if case.scene == "double-pendulum":
        return double_pendulum(case, SECONDS)
    if case.scene == "boxes":
        return boxes(case, SECONDS)
    if case.scene == "real":
        assert plan.data is not None
        return real_pendulum(case, plan.data)
    assert plan.run is not None
    return pool(case, plan.run)


def method_of(task: Task, plan: Plan) -> Method:
    """The method of a task."""
    there = methods_for(task.case.scene, task.case.variant, plan.run)
    return next(method for method in there if method.name == task.method)


def left_out(plan: Plan) -> list[str]:
    """A sentence for every scene of the plan that cannot be run."""
    said = []
    if "real" in plan.scenes and plan.data is None:
        said.append(f"The real pendulum is left out: give --data a folder with {RECORDING}.")
    if "pool" in plan.scenes and plan.run is None:
        said.append("The pool scene is left out: give --run the folder of a run of `trueroll run`.")
    return said


def trained(plan: Plan) -> str:
    """A sentence on how long networks learnt, and which of them learnt with one seed."""
    usual = BUDGETS[plan.depth]
    shorter = [f"{seconds:.0f} s on {scene}" for (depth, scene), seconds in SHORTER.items() if depth is plan.depth]
    within = "; ".join([f"{usual.seconds:.0f} CPU s", *shorter])
    if usual.effort == 1:
        return f"Networks learnt to the end of their training or for {within}."
    said = f"Networks had {usual.effort:.0%} of their training, at most {within}, and can be better than this."
    if plan.depth is Depth.USUAL and len(plan.seeds) > 1:
        said += " Outside the thesis' own setting the slow ones learnt with the first seed alone."
    return said
