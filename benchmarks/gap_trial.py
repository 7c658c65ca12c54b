"""One case of benchmarks/gap.py from end to end: a world plays, the diagnosis answers, and an oracle is asked."""

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
from gap_cases import NEAR, Case

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import Report
from models.estimation.gap_scenes.gap_scene import GapScene, Recording
from models.physics.effect import Effect
from pipeline.experiments.gapcheck.blind_case import WORLDS, answer
from pipeline.experiments.gapcheck.gap_oracle import Oracle, oracle_of
from pipeline.io.track_folder import TrackFolder, read_track_folders
from pipeline.io.track_folder_scene import open_scene

POWERLESS = 1e-9
"""share of its natural strength that an effect out of the library may have."""
FRESH = 24
"""Shots of the same world on which the interval of the closed part is tried."""


@dataclass(frozen=True)
class Row:
    """What one case gave, as the table of rows holds it."""

    asked: str
    kind: str
    seed: int
    truth: str
    said: str
    """names, joined by +; or none, unknown, undecidable; of a group all names, joined by |."""
    right: int
    excused: int
    """1 where the answer is a group, or a twin of what was taken out, that an oracle cannot tell apart either."""
    probability: float
    before: float
    after: float
    floor: float
    closed: float
    low: float
    high: float
    oracle: float
    """closed part for whoever knows what is missing."""
    fresh: float
    """closed part on FRESH further shots."""
    phase: str
    p_value: float
    cpu: float
    strengths: str


def trial(case: Case, seed: int, folder: Path) -> Row:
    """Play, diagnose, open the seal, judge."""
    rng = np.random.default_rng([seed, 5, *case.name.encode()])
    drawn = case.kind.drawn(int(rng.integers(2**31)), case.shots, case.fps)
    drawn["noise"] *= case.noise
    if case.asked == "near":
        drawn = _just_seen(case, drawn, rng, folder / "absent")
    read = _played(case, drawn, folder / "case")
    scene = _without(open_scene(read), case.hidden)
    begun = time.process_time()
    report = diagnose(scene, read.recordings, seed)
    cpu = time.process_time() - begun
    right, excused = _judged(case, report, read)
    if case.asked == "garbage":
        right = _unmoved(scene, read.recordings, report, seed, rng)
    closed = _closed(case, report, read, drawn, folder)
    return Row(
        asked=case.asked, kind=case.kind.name, seed=seed, truth="+".join(sorted(case.kind.withheld)),
        said=_said(report), right=int(right), excused=int(excused),
        probability=report.probability, **closed,
        phase=report.where[0].phase if report.where else "", p_value=report.p_value, cpu=cpu,
        strengths=json.dumps({n: p for n, p in drawn["effects"].items() if n in case.kind.withheld}),
    )  # fmt: skip


def _played(case: Case, drawn: dict[str, Any], folder: Path) -> TrackFolder:
    sealed = folder.with_suffix(".json")
    sealed.parent.mkdir(parents=True, exist_ok=True)
    sealed.write_text(json.dumps(drawn), encoding="utf-8")
    subprocess.run([sys.executable, str(WORLDS / f"{case.kind.scene}.py"), str(sealed), str(folder)], check=True)
    read = read_track_folders([folder])
    return replace(read, recordings=tuple(replace(one, t=one.t * case.clock) for one in read.recordings))


def _without(scene: GapScene, names: frozenset[str]) -> GapScene:
    """A scene whose library lacks these effects: probes are never offered as a cause, and may not act at all."""
    left = tuple(_powerless(one) if one.name in names else one for one in scene.effects)
    return replace(scene, effects=left) if names else scene  # type: ignore[type-var]


def _powerless(effect: Effect) -> Effect:
    parameters = tuple(replace(one, sigma=POWERLESS * one.sigma) for one in effect.parameters)
    return replace(effect, kind="probe", parameters=parameters)  # type: ignore[type-var]


def _just_seen(case: Case, drawn: dict[str, Any], rng: np.random.Generator, folder: Path) -> dict[str, Any]:
    """The experiment with what is withheld so weak that it is NEAR standard deviations, all else adjusted."""
    missing = {name: drawn["effects"][name] for name in case.kind.withheld}
    absent = {name: given for name, given in drawn["effects"].items() if name not in missing}
    read = _played(case, {**drawn, "effects": absent}, folder)
    oracle = oracle_of(open_scene(read), read.recordings)
    wanted = [
        missing[effect.name][prior.name]
        for effect in oracle.question.scene.effects
        if effect.name in missing
        for prior in effect.parameters
    ]
    factor = rng.uniform(*NEAR) / oracle.sigmas(case.kind.withheld, np.array(wanted))
    weak = {name: {key: value * factor for key, value in given.items()} for name, given in missing.items()}
    return {**drawn, "effects": absent | weak}


def _said(report: Report) -> str:
    if report.verdict == "group":
        return "|".join(report.candidates[0].group)
    return "+".join(report.effects) or report.verdict


def _judged(case: Case, report: Report, read: TrackFolder) -> tuple[bool, bool]:
    """Whether it is right, and whether an answer that is not may be excused."""
    if case.asked == "trap":
        return _caught(case, report, read), False
    if case.hidden:
        right = report.verdict == "unknown"
        named = frozenset(report.effects or report.candidates[0].group if not right else ())
        return right, bool(named) and not _told_apart(case, read, [named - {"none", "unknown"}])
    if answer(case.kind, report) != "group":
        return answer(case.kind, report) == "right", False
    rivals = [case.kind.withheld ^ {report.candidates[0].effect}, *map(frozenset, report.candidates[0].group)]
    others = [frozenset({name}) for name in report.candidates[0].group if {name} != case.kind.withheld]
    return False, not _told_apart(case, read, others if len(case.kind.withheld) == 1 else rivals)


def _caught(case: Case, report: Report, read: TrackFolder) -> bool:
    """A trap is answered by a group, or by no name, the cause being called unidentifiable; the right name is right only
    if it is no guess: if an oracle can tell it from its partners."""
    if report.effects and set(report.effects) == case.kind.withheld:
        scene = open_scene(read)
        partners = {name for one in scene.effects if one.name in case.kind.withheld for name in one.partners}
        return _told_apart(case, read, [frozenset({name}) for name in sorted(partners)])
    hidden = case.kind.withheld if case.clock == 1.0 else {"frame_rate"}
    if report.verdict == "group":
        return hidden <= set(report.candidates[0].group)
    return not report.effects and hidden <= set(report.unidentifiable)


def _told_apart(case: Case, read: TrackFolder, rivals: list[frozenset[str]]) -> bool:
    """Whether an oracle with the whole library can tell the truth from any of the rivals."""
    oracle = oracle_of(open_scene(read), read.recordings)
    truth = oracle.knowing(case.kind.withheld)
    return any(oracle.tells(truth, rival) for rival in rivals)


def _unmoved(
    scene: GapScene, recordings: tuple[Recording, ...], report: Report, seed: int, rng: np.random.Generator
) -> bool:
    """Whether garbage in place of the held-out shots leaves the verdict as it was."""
    poisoned = tuple(
        replace(one, places=rng.normal(0, 1, one.places.shape)) if one.shot in report.gap.shots else one
        for one in recordings
    )
    again = diagnose(scene, poisoned, seed)
    decided = [repr((one.verdict, one.candidates, one.where)) for one in (report, again)]
    return decided[0] == decided[1]


def _closed(case: Case, report: Report, read: TrackFolder, drawn: dict[str, Any], folder: Path) -> dict[str, float]:
    """How far the gap shrinks: as said, for an oracle, and on fresh shots of the same world."""
    told = asdict(report.gap.closing)
    low, high = told["interval"] if told["resolved"] else (math.nan, math.nan)
    found = {
        "before": told["before"], "after": told["after"], "floor": told["floor"], "low": low, "high": high,
        "closed": told["closed"] if told["resolved"] else math.nan, "oracle": math.nan, "fresh": math.nan,
    }  # fmt: skip
    if case.asked not in ("natural", "pair", "form", "30 fps", "5 shots", "1 px") or case.kind.foreign:
        return found
    oracle = oracle_of(open_scene(read), read.recordings)
    known = frozenset(oracle.question.candidates) & (case.kind.withheld | case.kind.family)
    found["oracle"] = _resolved(oracle, known, oracle.held_out)
    if case.asked == "natural" and report.effects:
        fresh = _played(case, {**drawn, "seed": drawn["seed"] + 1, "shots": FRESH}, folder / "fresh")
        found["fresh"] = _resolved(oracle, frozenset(report.effects), fresh.recordings)
    return found


def _resolved(oracle: Oracle, names: frozenset[str], shots: tuple[Recording, ...]) -> float:
    found = oracle.closes(oracle.knowing(names), shots)
    return found.closed if found.resolved else math.nan
