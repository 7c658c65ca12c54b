"""Which experiments are run, and in which order: every seed of everything before the next seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from models.neural.method import Budget, Method
from pipeline.thesis.boxes import SPEEDS, boxes
from pipeline.thesis.methods import methods_for
from pipeline.thesis.pendulum import KINDS, RECORDING, STARTS, double_pendulum, real_pendulum
from pipeline.thesis.pool import pool, shots_of
from pipeline.thesis.series import Case, Series

SCENES = ("double-pendulum", "real", "boxes", "pool")
RATES, NOISES = (60.0, 30.0, 15.0), (0.0, 0.1, 0.5)
"""Hz; px."""
REAL_RATES = (200 / 13, 200 / 26)
"""Hz: 13 and 26 samples apart; above them every spline is good enough."""
SECONDS = 2.5
"""of the simulated scenes."""
QUICK_EFFORT = 0.06
"""share of their steps that networks get in a quick run."""
QUICK_SECONDS, MOST_SECONDS = 8.0, 120.0
"""CPU s after which a network learns no more, in a quick run and in a whole one."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is asked for."""

    scenes: tuple[str, ...] = SCENES
    seeds: tuple[int, ...] = (0, 1, 2)
    quick: bool = False
    data: Path | None = None
    """Folder of the recorded pendulum, None where there is none."""
    run: Path | None = None
    """Folder of a run whose shots are the pool scene."""

    @property
    def budget(self) -> Budget:
        return Budget(QUICK_EFFORT, QUICK_SECONDS) if self.quick else Budget(1.0, MOST_SECONDS)


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
        for variant, fps, noise in _settings(scene, plan)
    ]


def _settings(scene: str, plan: Plan) -> Iterator[tuple[str, float, float]]:
    """Variants, rates and noises of a scene; the quick ones are those that the thesis has."""
    if scene == "double-pendulum":
        yield from _grid(("stiff",) if plan.quick else tuple(KINDS), plan)
    elif scene == "boxes":
        yield from [("800", 30.0, 0.0)] if plan.quick else _grid(SPEEDS, plan)
    elif scene == "real" and plan.data is not None:
        yield from ((start, fps, 0.0) for start in (["0 s"] if plan.quick else STARTS)
                    for fps in (REAL_RATES[1:] if plan.quick else REAL_RATES))  # fmt: skip
    elif scene == "pool" and plan.run is not None:
        yield from ((shot, fps, 0.0) for shot, fps in shots_of(plan.run))


def _grid(variants: tuple[str, ...], plan: Plan) -> Iterator[tuple[str, float, float]]:
    for variant in variants:
        for fps in (30.0,) if plan.quick else RATES:
            for noise in (0.0, 0.1) if plan.quick else NOISES:
                yield variant, fps, noise


def tasks(plan: Plan) -> list[Task]:
    """Every method on every case."""
    return [
        Task(case, method.name) for case in cases(plan) for method in methods_for(case.scene, case.variant, plan.run)
    ]


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
