"""The whole diagnosis, from recordings to a report. Hold-out shots are used once, after the verdict is final."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import norm

from diagnosis.fitting.diagnosis_windows import MIN_ROWS
from diagnosis.fitting.identity_switch_correction import undo_identity_switches
from diagnosis.fitting.noise_estimation import NoiseEstimate, apply_noise_estimate
from diagnosis.fitting.shot_split import ShotSplit, split_shots
from diagnosis.selection.hypotheses import ProgressCallback, SearchOutlook, ignore_progress
from diagnosis.selection.study import run_study
from diagnosis.verdicts.diagnosis_report import build_report, build_undecidable_report
from diagnosis.verdicts.verdict import DiagnosisReport, ShotUse
from models.core.recording import Recording
from models.estimation.gap_scenes.gap_scene import GapScene
from models.numerics.executor import SERIAL, Executor

_FALSE_MOTION_PROBABILITY = 1e-4
"""Probability that a body at rest appears to move."""
_MAX_FRAME_INTERVAL = 1.0
"""s between frames beyond which no motion is followed: bodies land, stop or swing back within a second."""


def diagnose(
    scene: GapScene,
    recordings: tuple[Recording, ...],
    seed: int = 0,
    on_progress: ProgressCallback = ignore_progress,
    executor: Executor = SERIAL,
) -> DiagnosisReport:
    """Find where a simulator and recordings differ, which effect is missing, and how far the gap shrinks with it.

    Args:
        scene: Scene with a catalogue of effects, and the effects that the user's simulator has.
        recordings: One recording per shot.
        seed: Seed of the noise and bootstrap draws.
        on_progress: Receives a description of each step, the names of the effects that it concerns, and the outlook:
            the best hypothesis so far and the number of steps.
        executor: Distributes the fits over processes; it does not change the report.

    Returns:
        The report; its verdict is `undecidable` where the recordings are too few to test.
    """
    restored = [undo_identity_switches(one) for one in recordings]
    split = split_shots(tuple(recording for recording, _ in restored))
    reason = _explain_insufficient_data(scene, split)
    if reason:
        return build_undecidable_report(scene, recordings[0].reference.unit, reason)
    on_progress("fitting the simulator", (), SearchOutlook())
    study = run_study(scene, split, np.random.default_rng(seed), on_progress, executor)
    names, steps = tuple(sorted(study.best.names)), study.search.steps_done
    on_progress("predicting hold-out shots", names, SearchOutlook(names, steps, 1))
    reporting_shots = tuple(apply_noise_estimate(split.holdout, study.noise))
    report = build_report(study, reporting_shots, np.random.default_rng([seed, 1]))
    switches = tuple(str(switch) for _, switches in restored for switch in switches)
    return replace(report, notes=(*switches, *report.notes), shot_use=describe_shots(split, study.noise))


def describe_shots(split: ShotSplit, noise: NoiseEstimate) -> ShotUse:
    """Describe which shots were used for what, and their noise.

    Args:
        split: Recordings by use.
        noise: Noise of all recordings.

    Returns:
        Numbers of shots, and the median standard deviation of an observed coordinate; NaN where it was neither stated
        nor measured.
    """
    everything = apply_noise_estimate((*split.fitting, *split.selection, *split.holdout), noise)
    sigmas = np.concatenate([one.sigma[one.is_observed] for one in everything])
    is_stated = all(one.is_sigma_stated for one in everything)
    fitting, selection, holdout = (
        tuple(one.shot for one in part) for part in (split.fitting, split.selection, split.holdout)
    )
    return ShotUse(
        fitting, selection, holdout, float(np.median(sigmas)) if noise.is_measured or is_stated else float("nan")
    )


def _explain_insufficient_data(scene: GapScene, split: ShotSplit) -> str:
    """Explain why nothing can be tested; empty where something can."""
    is_still = not any(_has_motion(one) for one in split.fitting)
    if is_still and any(int(one.is_observed.sum(axis=0).max()) >= MIN_ROWS for one in split.fitting):
        return "nothing moves in these shots"
    segments = [segment.is_observed for one in split.fitting for segment in scene.split_recording(one)]
    rows = sum(int(is_observed.sum()) for is_observed in segments if is_observed.any(axis=1).sum() >= MIN_ROWS)
    if rows < 2 * MIN_ROWS:
        return f"{rows} observations are too few to test anything; at least {2 * MIN_ROWS} are needed"
    interval = float(np.median(np.concatenate([np.diff(one.t) for one in split.fitting])))
    if interval > _MAX_FRAME_INTERVAL:
        return f"the frames are {interval:.3g} s apart; t is in seconds, and a motion needs several frames per second"
    return ""


def _has_motion(recording: Recording) -> bool:
    """Return whether a body moves further than its own scatter explains."""
    for body in range(len(recording.bodies)):
        positions = recording.positions[recording.is_observed[:, body], body]
        if len(positions) < MIN_ROWS:
            continue
        scatter = np.abs(np.diff(positions, axis=0)).mean() * np.sqrt(np.pi) / 2
        if np.ptp(positions, axis=0).max() > 2 * norm.isf(_FALSE_MOTION_PROBABILITY / len(positions)) * scatter:
            return True
    return False
