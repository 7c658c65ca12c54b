"""One case of benchmarks/diagnosis/gap.py from end to end: simulation, diagnosis, and comparison with an oracle."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.gap_cases import NEAR, GapCase
from diagnosis.diagnose import diagnose
from diagnosis.fitting.hypothesis_fits import linearize_fit
from diagnosis.selection.hypotheses import compute_signatures
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene
from models.physics.effect import Effect
from pipeline.experiments.gapcheck.blind_case import WORLDS, Oracle, build_oracle, grade_report
from pipeline.io.track_folder import TrackFolder, read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

# Share of its natural strength that a disabled effect may have.
POWERLESS = 1e-9
# Further shots of the same simulator that test the interval of the closed share.
FRESH = 24


@dataclass(frozen=True)
class GapRow:
    """Result of one case, a row of the CSV file."""

    question: str
    kind: str
    seed: int
    truth: str
    answer: str
    """Names, joined by +; or none, unknown, undecidable; all names of a group, joined by |."""
    right: int
    excused: int
    """1 where an oracle cannot separate the named group, or the named twin of a removed effect, either."""
    probability: float
    before: float
    after: float
    floor: float
    closed: float
    low: float
    high: float
    oracle: float
    """Closed share of an oracle that knows the missing effects."""
    fresh: float
    """Closed share on FRESH further shots."""
    phase: str
    p_value: float
    cpu: float
    strengths: str
    law: str
    """Direction, variable and formula of the unexplained acceleration; empty where none was found."""


def run_trial(case: GapCase, seed: int, folder: Path, compares_closure: bool = True) -> GapRow:
    """Simulate, diagnose and score one case, without an oracle's closure where it is not compared."""
    rng = np.random.default_rng([seed, 5, *case.name.encode()])
    drawn = case.kind.draw_experiment(int(rng.integers(2**31)), case.shots, case.fps)
    drawn["noise"] *= case.noise
    if case.question == "near":
        drawn = _weaken_effects(case, drawn, rng, folder / "absent")
    read = play_case(case, drawn, folder / "case")
    scene = _disable_effects(build_gap_scene(read), case.hidden)
    begun = time.process_time()
    report = diagnose(scene, read.recordings, seed)
    cpu = time.process_time() - begun
    right, excused = _score_answer(case, report, read)
    if case.question == "garbage":
        right = _is_unchanged_by_garbage(scene, read.recordings, report, seed, rng)
    closed = _score_closing(case, report, read, drawn, folder, compares_closure)
    return GapRow(
        question=case.question, kind=case.kind.name, seed=seed, truth="+".join(sorted(case.kind.withheld)),
        answer=_format_answer(report), right=int(right), excused=int(excused),
        probability=report.probability, **closed,
        phase=report.where[0].phase if report.where else "", p_value=report.p_value, cpu=cpu,
        strengths=json.dumps({n: p for n, p in drawn["effects"].items() if n in case.kind.withheld}),
        law=_format_law(report),
    )  # fmt: skip


def play_case(case: GapCase, drawn: dict[str, Any], folder: Path) -> TrackFolder:
    sealed = folder.with_suffix(".json")
    sealed.parent.mkdir(parents=True, exist_ok=True)
    sealed.write_text(json.dumps(drawn), encoding="utf-8")
    subprocess.run([sys.executable, str(WORLDS / f"{case.kind.scene}.py"), str(sealed), str(folder)], check=True)
    read = read_track_folders([folder])
    return replace(read, recordings=tuple(replace(one, t=one.t * case.clock) for one in read.recordings))


def _disable_effects(scene: GapScene, names: frozenset[str]) -> GapScene:
    """Return a scene without these effects: probes are never candidates, and a tiny prior keeps them inactive."""
    left = tuple(_disable_effect(one) if one.name in names else one for one in scene.effects)
    return replace(scene, effects=left) if names else scene  # type: ignore[type-var]


def _disable_effect(effect: Effect) -> Effect:
    parameters = tuple(replace(one, sigma=POWERLESS * one.sigma) for one in effect.parameters)
    return replace(effect, kind="probe", parameters=parameters)  # type: ignore[type-var]


def _weaken_effects(case: GapCase, drawn: dict[str, Any], rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """Weaken the withheld effects to NEAR standard deviations, all else adjusted."""
    missing = {name: drawn["effects"][name] for name in case.kind.withheld}
    absent = {name: values for name, values in drawn["effects"].items() if name not in missing}
    read = play_case(case, {**drawn, "effects": absent}, folder)
    oracle = build_oracle(build_gap_scene(read), read.recordings)
    wanted = [
        missing[effect.name][prior.name]
        for effect in oracle.problem.scene.effects
        if effect.name in missing
        for prior in effect.parameters
    ]
    factor = rng.uniform(*NEAR) / measure_strength(oracle, case.kind.withheld, np.array(wanted))
    weak = {name: {key: value * factor for key, value in values.items()} for name, values in missing.items()}
    return {**drawn, "effects": absent | weak}


def measure_strength(oracle: Oracle, names: frozenset[str], strengths: FloatArray) -> float:
    """Return how many standard deviations the strengths (p,) of missing effects are, all else adjusted."""
    problem, base = oracle.problem, oracle.base
    information = linearize_fit(problem, base).shot_information
    mask = problem.mask(tuple(names))
    signatures = compute_signatures(problem, information, base.free, base.lack_of_fit)
    size = float(strengths @ signatures.information[np.ix_(mask, mask)] @ strengths)
    return float(np.sqrt(max(size, 0.0)))


def _format_answer(report: DiagnosisReport) -> str:
    if report.verdict == "group":
        return "|".join(report.candidates[0].group)
    return "+".join(report.effects) or report.verdict


def _format_law(report: DiagnosisReport) -> str:
    law = report.unexplained.law
    return "" if law is None else f"{law.direction}, over {law.variable}: {law.formula or 'no short formula'}"


def _score_answer(case: GapCase, report: DiagnosisReport, read: TrackFolder) -> tuple[bool, bool]:
    """Return whether the answer is right, and whether a wrong answer is excused."""
    if case.question == "trap":
        return _is_trap_recognised(case, report, read), False
    if case.hidden:
        right = report.verdict == "unknown"
        named = frozenset(report.effects or report.candidates[0].group if not right else ())
        return right, bool(named) and not _can_separate(case, read, [named - {"none", "unknown"}])
    if grade_report(case.kind, report) != "group":
        return grade_report(case.kind, report) == "right", False
    rivals = [case.kind.withheld ^ {report.candidates[0].effect}, *map(frozenset, report.candidates[0].group)]
    others = [frozenset({name}) for name in report.candidates[0].group if {name} != case.kind.withheld]
    return False, not _can_separate(case, read, others if len(case.kind.withheld) == 1 else rivals)


def _is_trap_recognised(case: GapCase, report: DiagnosisReport, read: TrackFolder) -> bool:
    """Return whether a trap is answered rightly.

    Right are a group, or no name with the cause reported as not identifiable. The right name counts only if an oracle
    can separate it from its partners.
    """
    if report.effects and set(report.effects) == case.kind.withheld:
        scene = build_gap_scene(read)
        partners = {name for one in scene.effects if one.name in case.kind.withheld for name in one.partners}
        return _can_separate(case, read, [frozenset({name}) for name in sorted(partners)])
    hidden = case.kind.withheld if case.clock == 1.0 else {"frame_rate"}
    if report.verdict == "group":
        return hidden <= set(report.candidates[0].group)
    return not report.effects and hidden <= set(report.unidentifiable)


def _can_separate(case: GapCase, read: TrackFolder, rivals: list[frozenset[str]]) -> bool:
    """Return whether an oracle with the whole library can separate the truth from any of the rivals."""
    oracle = build_oracle(build_gap_scene(read), read.recordings)
    truth = oracle.fit_with_effects(case.kind.withheld)
    return any(oracle.can_separate(truth, rival) for rival in rivals)


def _is_unchanged_by_garbage(
    scene: GapScene, recordings: tuple[Recording, ...], report: DiagnosisReport, seed: int, rng: np.random.Generator
) -> bool:
    """Return whether the verdict stays the same with garbage in place of the reporting shots."""
    poisoned = tuple(
        replace(one, positions=rng.normal(0, 1, one.positions.shape)) if one.shot in report.gap.shots else one
        for one in recordings
    )
    again = diagnose(scene, poisoned, seed)
    decided = [repr((one.verdict, one.candidates, one.where)) for one in (report, again)]
    return decided[0] == decided[1]


def _score_closing(
    case: GapCase, report: DiagnosisReport, read: TrackFolder, drawn: dict[str, Any], folder: Path, compares: bool
) -> dict[str, float]:
    """Return the closed share of the gap: as reported, for an oracle, and on fresh shots."""
    closing = asdict(report.gap.closure)
    low, high = closing["interval"] if closing["resolved"] else (math.nan, math.nan)
    scores = {
        "before": closing["before"], "after": closing["after"], "floor": closing["floor"], "low": low, "high": high,
        "closed": closing["closed"] if closing["resolved"] else math.nan, "oracle": math.nan, "fresh": math.nan,
    }  # fmt: skip
    asked = case.question in ("natural", "pair", "form", "30 fps", "5 shots", "1 px")
    if not compares or not asked or case.kind.foreign:
        return scores
    oracle = build_oracle(build_gap_scene(read), read.recordings)
    missing = frozenset(oracle.problem.candidates) & (case.kind.withheld | case.kind.family)
    scores["oracle"] = _evaluate_closing(oracle, missing, oracle.holdout_shots)
    if case.question == "natural" and report.effects:
        fresh = play_case(case, {**drawn, "seed": drawn["seed"] + 1, "shots": FRESH}, folder / "fresh")
        scores["fresh"] = _evaluate_closing(oracle, frozenset(report.effects), fresh.recordings)
    return scores


def _evaluate_closing(oracle: Oracle, names: frozenset[str], shots: tuple[Recording, ...]) -> float:
    closing = oracle.measure_closure(oracle.fit_with_effects(names), shots)
    return closing.closed if closing.resolved else math.nan
