"""A case from end to end: a sealed simulation, the diagnosis of its track folder, the comparison with the seal; scores.

An oracle that knows the missing effects: how far it closes the gap, and which effects it cannot separate.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import binomtest

from diagnosis.diagnose import diagnose
from diagnosis.fitting.diagnosis_windows import fit_adaptively
from diagnosis.fitting.gap_closure import GapClosure, measure_closure
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import NoiseEstimate, apply_noise_estimate, estimate_noise, split_shots
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.errors import TruerollError
from models.core.recording import Recording
from models.estimation.gap_scenes.gap_scene import GapScene
from models.numerics.executor import SERIAL, Executor
from pipeline.experiments.gapcheck.billiards_cases import CaseKind
from pipeline.io.gap_files import write_gap_files
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

WORLDS = Path(__file__).resolve().parents[3] / "worlds"
Answer = Literal["right", "group", "unknown", "none", "undecidable", "wrong"]


class WorldError(TruerollError):
    """A simulated world failed."""


@dataclass(frozen=True, slots=True)
class OpenedCase:
    """A case whose seal was opened after its report was written."""

    kind: CaseKind
    seed: int
    answer: Answer
    named: tuple[str, ...]
    """Effects that the report names, or its verdict where it names none."""
    probability: float
    """Probability of the answer."""
    closed: float
    """Closed part of the gap; NaN where it is not resolved."""
    interval: tuple[float, float]
    oracle: float
    """Closed part for a simulator that has the withheld effects; NaN where it is not resolved or foreign."""
    seconds: float = np.nan
    """Duration of the diagnosis, s."""


def simulate_case(kind: CaseKind, seed: int, shots: int, fps: float, sealed: Path, folder: Path) -> None:
    """Simulate a case and write its track folder; the effects that act are written to `sealed` alone.

    Args:
        kind: Kind of case.
        seed: Seed of all random values.
        shots: Number of shots.
        fps: Frame rate, Hz.
        sealed: JSON file of the experiment.
        folder: Track folder.

    Raises:
        WorldError: The simulation failed.
    """
    simulate_experiment(kind, kind.draw_experiment(seed, shots, fps), sealed, folder)


def simulate_experiment(kind: CaseKind, drawn: Mapping[str, Any], sealed: Path, folder: Path) -> None:
    """Simulate an experiment whose random values are drawn already; files as in `simulate_case`."""
    sealed.write_text(json.dumps(drawn), encoding="utf-8")
    command = [sys.executable, str(WORLDS / f"{kind.world}.py"), str(sealed), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        errors = done.stderr.strip().splitlines()
        raise WorldError(f"the world of {kind.name!r} failed: {errors[-1] if errors else 'no reason given'}")


def diagnose_case(kind: CaseKind, seed: int, folder: Path, executor: Executor = SERIAL) -> OpenedCase:
    """Diagnose a track folder, write its report, and only then compare it with the withheld effects.

    Args:
        kind: Kind of case.
        seed: Seed of the case and of the diagnosis.
        folder: Track folder; the report is written to `gap` in it.
        executor: Distributes the fits over processes; it does not change the report.

    Returns:
        The opened case.
    """
    read = read_track_folders([folder])
    scene = kind.simulator(build_gap_scene(read))
    start = time.perf_counter()
    report = diagnose(scene, read.recordings, seed, executor=executor)
    seconds = time.perf_counter() - start
    write_gap_files(report, folder / "gap")
    closure = report.gap.closure
    names = report.effects or (report.verdict,)
    grade = grade_report(kind, report)
    if kind.trap and report.effects and grade == "right" and not is_separable(kind, scene, read.recordings):
        grade = "wrong"
    return OpenedCase(
        kind, seed, grade, names, report.probability, closure.closed if closure.resolved else np.nan, closure.interval,
        _measure_oracle_closure(kind, scene, read.recordings, report), seconds,
    )  # fmt: skip


def grade_report(kind: CaseKind, report: DiagnosisReport) -> Answer:
    """Grade a report against the withheld effects; in a trap, a right name counts even if it is a guess."""
    if kind.trap and kind.withheld and not report.effects:
        return "right"
    if report.verdict == "undecidable":
        return "undecidable"
    if report.verdict == "unknown":
        return "right" if kind.foreign else "unknown"
    if report.verdict == "none":
        return "none" if kind.withheld else "right"
    if report.verdict == "group":
        group = set(report.candidates[0].group)
        return "group" if kind.withheld and (kind.withheld <= group or group & kind.family) else "wrong"
    return "right" if kind.is_named_by(frozenset(report.effects)) and not kind.foreign else "wrong"


def is_separable(kind: CaseKind, scene: GapScene, recordings: tuple[Recording, ...]) -> bool:
    """Return whether an oracle that knows the missing effect can separate it from its partners."""
    partners = {name for one in scene.effects if one.name in kind.withheld for name in one.partners}
    oracle = build_oracle(scene, recordings)
    truth = oracle.fit_with_effects(kind.withheld)
    return all(
        oracle.can_separate(truth, frozenset({name})) for name in sorted(partners - set(scene.simulator_effects))
    )


def _measure_oracle_closure(
    kind: CaseKind, scene: GapScene, recordings: tuple[Recording, ...], report: DiagnosisReport
) -> float:
    """Measure the closed part of the gap for an oracle that knows the missing effects."""
    if not kind.withheld or kind.foreign or not report.gap.closure.resolved:
        return np.nan
    oracle = build_oracle(scene, recordings)
    names = frozenset(oracle.problem.candidates) & (kind.withheld | kind.family)
    closure = oracle.measure_closure(oracle.fit_with_effects(names, kind.forms), oracle.holdout_shots)
    return closure.closed if closure.resolved else np.nan


# chi2 from which two causes are separable when only they are compared: three standard deviations.
SEPARATION_CHI2 = 9.0


@dataclass(frozen=True, slots=True)
class Oracle:
    """The shots of a case as the diagnosis splits them, and the fit of the simulator."""

    problem: DiagnosisProblem
    noise: NoiseEstimate
    fitting_shots: tuple[Recording, ...]
    """Fitting and selection shots."""
    holdout_shots: tuple[Recording, ...]
    """Hold-out shots."""
    base: EffectFit
    """Fit of the simulator."""

    def fit_with_effects(self, names: frozenset[str], forms: tuple[str, ...] = ()) -> EffectFit:
        """Fit a simulator that also has these effects, and contact models of these forms where given."""
        return fit_adaptively(self.problem, self.fitting_shots, tuple(sorted(names)), forms or None)

    def measure_closure(self, better: EffectFit, shots: tuple[Recording, ...]) -> GapClosure:
        """Measure which share of the prediction error the true simulator removes on hold-out shots."""
        with_sigmas = apply_noise_estimate(shots, self.noise)
        return measure_closure(self.problem, with_sigmas, self.base, better, np.random.default_rng(0))

    def can_separate(self, truth: EffectFit, other: frozenset[str]) -> bool:
        """Return whether other effects explain the same shots worse than the true ones."""
        rival = fit_effects(self.problem, truth.segments, tuple(sorted(other)))
        return (rival.cost - truth.cost) / truth.lack_of_fit > SEPARATION_CHI2


def build_oracle(scene: GapScene, recordings: tuple[Recording, ...]) -> Oracle:
    """Split recordings and fit the simulator.

    Args:
        scene: Scene with a catalogue of effects.
        recordings: One recording per shot.

    Returns:
        The oracle.

    Raises:
        ValueError: There is nothing to fit.
    """
    split = split_shots(recordings)
    noise = estimate_noise((*split.fitting, *split.selection))
    question = build_diagnosis_problem(scene, noise)
    opened = apply_noise_estimate((*split.fitting, *split.selection), noise)
    return Oracle(question, noise, opened, split.holdout, fit_adaptively(question, opened))


# Coverage of the intervals.
CONFIDENCE = 0.95
# Edges of the bins of probability in the calibration.
PROBABILITY_BINS = (0.0, 0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


@dataclass(frozen=True, slots=True)
class Proportion:
    """A proportion `hits` of `of`, with Wilson's interval (1927, doi:10.1080/01621459.1927.10502953)."""

    hits: int
    of: int

    @property
    def interval(self) -> tuple[float, float]:
        """Interval at CONFIDENCE; (0, 1) where `of` is 0."""
        if not self.of:
            return 0.0, 1.0
        limits = binomtest(self.hits, self.of).proportion_ci(CONFIDENCE, method="wilson")
        return float(limits.low), float(limits.high)

    def __str__(self) -> str:
        if not self.of:
            return "-"
        low, high = self.interval
        return f"{self.hits}/{self.of} = {self.hits / self.of:.0%} ({low:.0%} to {high:.0%})"


@dataclass(frozen=True, slots=True)
class CaseScores:
    """Scores of all cases by their kind."""

    named: Proportion
    """One effect is missing: its name is given."""
    grouped: Proportion
    """One effect is missing: its name or a group that holds it is given."""
    pairs: Proportion
    """Two effects are missing: both names are given."""
    alarms: Proportion
    """Nothing is missing: an effect is named (false alarm)."""
    unknowns: Proportion
    """The missing effect is in no library: the verdict is `unknown`."""
    traps: Proportion
    """The shots cannot show the missing effect: no name is guessed."""
    closed: tuple[float, float]
    """Closed part of the gap over that of an oracle, where an effect is missing: median and tenth percentile."""
    covered: Proportion
    """The interval of the closed part holds that of the oracle."""


def score_cases(cases: Sequence[OpenedCase]) -> CaseScores:
    """Score opened cases.

    Args:
        cases: Opened cases of all kinds.

    Returns:
        Rates by kind of question, and the closed part of the gap.
    """
    traps = [one for one in cases if one.kind.trap]
    plain = [one for one in cases if not one.kind.trap]
    foreign = [one for one in plain if one.kind.foreign]
    single, pairs, clean = (
        [one for one in plain if len(one.kind.withheld) == count and not one.kind.foreign] for count in (1, 2, 0)
    )
    missing = [one for one in (*single, *pairs) if np.isfinite(one.oracle)]
    resolved = [one for one in missing if np.isfinite(one.closed)]
    # 0 where only the oracle's closure is resolved
    shares = np.array([max(np.nan_to_num(one.closed), -1.0) / one.oracle for one in missing if one.oracle > 0])
    return CaseScores(
        _count_answers(single, "right"),
        _count_answers(single, "right", "group"),
        _count_answers(pairs, "right"),
        Proportion(len(clean) - _count_answers(clean, "right").hits, len(clean)),
        _count_answers(foreign, "right"),
        _count_answers(traps, "right"),
        (float(np.median(shares)), float(np.quantile(shares, 0.1))) if len(shares) else (np.nan, np.nan),
        Proportion(sum(one.interval[0] <= one.oracle <= one.interval[1] + 1e-9 for one in resolved), len(resolved)),
    )


def count_confusions(cases: Sequence[OpenedCase]) -> list[tuple[str, str, int]]:
    """Count the answers to each kind of case.

    Args:
        cases: Opened cases.

    Returns:
        Kind, answer and count, in the order of the kinds; the most frequent answer of each first.
    """
    counts = Counter((one.kind.name, " + ".join(one.named)) for one in cases)
    order = list(dict.fromkeys(one.kind.name for one in cases))
    return sorted(
        ((kind, answer, n) for (kind, answer), n in counts.items()), key=lambda row: (order.index(row[0]), -row[2])
    )


def compute_calibration(cases: Sequence[OpenedCase]) -> list[tuple[float, float, Proportion]]:
    """Compute the rate of right answers by their stated probability.

    Args:
        cases: Opened cases.

    Returns:
        Lower edge, upper edge and rate of each bin.
    """
    rows = []
    for low, high in pairwise(PROBABILITY_BINS):
        inside = [one for one in cases if low <= one.probability < high or (high == 1.0 and one.probability == 1.0)]
        rows.append((low, high, _count_answers(inside, "right")))
    return rows


def _count_answers(cases: Sequence[OpenedCase], *answers: str) -> Proportion:
    """Return the proportion of cases with one of these answers."""
    return Proportion(sum(one.answer in answers for one in cases), len(cases))
