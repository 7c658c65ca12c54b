"""Which experiments are run, and in which order: every seed of everything before the next seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TypeVar

from models.neural.method import Budget, Method
from pipeline.thesis.boxes import SPEEDS, boxes
from pipeline.thesis.methods import EACH_KIND, methods_for
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


Value = TypeVar("Value", str, float)


class Depth(StrEnum):
    """How much is run."""

    QUICK = "quick"
    """the settings of the thesis, one method of each kind, networks barely trained."""
    USUAL = "usual"
    """one change of setting at a time; one method of each kind, and all where the thesis' own setting is."""
    WHOLE = "whole"
    """every setting crossed with every method, networks trained to the end."""


BUDGETS = {Depth.QUICK: Budget(0.06, 4.0), Depth.USUAL: Budget(0.2, 15.0), Depth.WHOLE: Budget(1.0, 120.0)}
"""Share of their steps that networks get, and CPU s after which they learn no more."""
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

    @property
    def budget(self) -> Budget:
        return BUDGETS[self.depth]


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
    """All settings crossed; else what differs from the thesis' in one thing, and every variant with little noise."""
    own = FIRST_VARIANT[scene]
    for variant in _led_by(own, variants):
        for fps in _led_by(BASE[0], RATES):
            for noise in _led_by(BASE[1], NOISES):
                changed = (variant != own) + (fps != BASE[0]) + (noise != BASE[1])
                if depth is Depth.QUICK and (variant, fps, noise) != (own, *BASE):
                    continue
                if depth is Depth.USUAL and changed > 1 and not (fps == BASE[0] and noise == NOISES[1]):
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
        if plan.depth is Depth.WHOLE or method.name in EACH_KIND or _is_own(case, plan.depth)
    ]


def _is_own(case: Case, depth: Depth) -> bool:
    """Whether all methods are run: in the thesis' own setting, if there is time."""
    own = FIRST_VARIANT.get(case.scene, case.variant) == case.variant
    return own and depth is not Depth.QUICK and (case.scene not in ("boxes", "double-pendulum") or (
        case.fps, case.noise) == BASE)  # fmt: skip


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
