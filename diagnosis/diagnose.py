"""The whole diagnosis: shots in, a report out. Shots that report are opened once, after the verdict stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import norm

from diagnosis.fitting.diagnosis_windows import LEAST
from diagnosis.fitting.noise_estimation import with_noise
from diagnosis.fitting.shot_split import Split, split_shots
from diagnosis.fitting.swapped_names import names_given_back
from diagnosis.selection.hypotheses import Watch, unwatched
from diagnosis.selection.study import studied
from diagnosis.verdicts.diagnosis_report import reported, undecidable
from diagnosis.verdicts.verdict import Report
from models.estimation.gap_scenes.gap_scene import GapScene, Recording
from models.numerics.executor import ALONE, Crew

_BY_CHANCE = 1e-4
"""chance that a body which lies still seems to move."""


def diagnose(
    scene: GapScene,
    recordings: tuple[Recording, ...],
    seed: int = 0,
    watch: Watch = unwatched,
    crew: Crew = ALONE,
) -> Report:
    """Where simulator and world part, which effect is missing, and how far the gap shrinks with it; `watch` is told
    what is being tried, and the `crew` shares out the work: the report is the same whoever does it."""
    own = [names_given_back(one) for one in recordings]
    split = split_shots(tuple(recording for recording, _ in own))
    reason = _too_little(scene, split)
    if reason:
        return undecidable(scene, reason)
    watch("fitting what the simulator has", ())
    study = studied(scene, split, np.random.default_rng(seed), watch, crew)
    watch("predicting shots that chose nothing", tuple(sorted(study.best.names)))
    report = tuple(with_noise(split.report, study.noise))
    found = reported(study, report, np.random.default_rng([seed, 1]))
    return replace(found, notes=tuple(str(exchange) for _, exchanges in own for exchange in exchanges))


def _too_little(scene: GapScene, split: Split) -> str:
    """Why nothing can be tested; empty where something can."""
    still = not any(_moves(one) for one in split.fit)
    if still and any(int(one.seen.sum(axis=0).max()) >= LEAST for one in split.fit):
        return "nothing moves in these shots"
    pieces = [piece.seen for one in split.fit for piece in scene.stretches(one)]
    rows = sum(int(seen.sum()) for seen in pieces if seen.any(axis=1).sum() >= LEAST)
    if rows < 2 * LEAST:
        return f"{rows} observations are too few to test anything; at least {2 * LEAST} are needed"
    return ""


def _moves(recording: Recording) -> bool:
    """Whether a body gets further than its own scatter explains."""
    for body in range(len(recording.bodies)):
        seen = recording.places[recording.seen[:, body], body]
        if len(seen) < LEAST:
            continue
        scatter = np.abs(np.diff(seen, axis=0)).mean() * np.sqrt(np.pi) / 2
        if np.ptp(seen, axis=0).max() > 2 * norm.isf(_BY_CHANCE / len(seen)) * scatter:
            return True
    return False
