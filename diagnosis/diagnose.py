"""The whole diagnosis, from recordings to a report. Hold-out shots only withdraw what they do not confirm.

Which effects exist the diagnosis learns from the scene (`GapScene.effects`), and each scene in
`models/estimation/gap_scenes/` from its catalogue:

- `billiards_scene`: `models.physics.effects.billiards_catalogue`, and the contact models of
  `models.physics.billiards.contact_models` as `GapScene.alternatives`;
- `simulator_scene`, a simulator from outside: `models.physics.mechanisms.mechanism_catalogue`;
- `sliding_scene`, `flight_scene` and `pendulum_scene`: the list in their own file.

`pipeline.io.track_folder_scene` builds the scene of a track folder, `pipeline.simulator_diagnosis` that of a simulator
from outside. Effects that recordings cannot show are left out by the scene (`GapScene.not_tested`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import norm

from diagnosis.fitting.diagnosis_windows import MIN_ROWS
from diagnosis.fitting.shot_preparation import NoiseEstimate, ShotSplit, apply_noise_estimate, split_shots
from diagnosis.selection.hypotheses import ProgressCallback, SearchOutlook, ignore_progress
from diagnosis.selection.study import run_study
from diagnosis.verdicts.diagnosis_report import build_report, build_undecidable_report
from diagnosis.verdicts.verdict import DiagnosisReport, ShotUse
from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import GapScene
from models.estimation.gap_scenes.simulator_scene import SimulatorScene
from models.numerics.executor import SERIAL, Executor

# Probability that a body at rest appears to move.
_FALSE_MOTION_PROBABILITY = 1e-4
# s between frames beyond which no motion is followed: bodies land, stop or swing back within a second.
_MAX_FRAME_INTERVAL = 1.0


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
    # joints are told apart by their columns
    has_names = isinstance(scene, SimulatorScene)
    restored = [(one, ()) if has_names else undo_identity_switches(one) for one in recordings]
    split = split_shots(tuple(recording for recording, _ in restored))
    reason = explain_insufficient_data(scene, split)
    if reason:
        return build_undecidable_report(scene, recordings[0].reference.unit, reason)
    on_progress("fitting the simulator", (), SearchOutlook())
    study = run_study(scene, split, np.random.default_rng(seed), on_progress, executor)
    names, steps = tuple(sorted(study.best.names)), study.search.steps_done
    on_progress("predicting hold-out shots", names, SearchOutlook(names, steps, 1))
    reporting_shots = tuple(apply_noise_estimate(split.holdout, study.noise))
    report = build_report(study, reporting_shots, np.random.default_rng([seed, 1]))
    switches = tuple(switch for _, switches in restored for switch in switches)
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


def explain_insufficient_data(scene: GapScene, split: ShotSplit) -> str:
    """Explain why nothing can be tested; empty where something can.

    Args:
        scene: Scene with a catalogue of effects.
        split: Recordings by use.
    """
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
    if not split.holdout:
        return "one shot leaves none to check an effect on; two are the least, eight or more name an effect surely"
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


# Steps on either side from which the speed of a body is estimated.
_SIDE_STEPS = 5
# Least number of rows on either side for an estimate of speed.
_MIN_SIDE_ROWS = 3
# Ratio to the speed on either side from which a step is a jump: a contact changes a speed, not a position.
_JUMP_SPEED_RATIO = 2.0
# Additional length of a jump, standard deviations.
_JUMP_SIGMAS = 10.0


def undo_identity_switches(recording: Recording) -> tuple[Recording, tuple[str, ...]]:
    """Undo all identity switches in a recording.

    Args:
        recording: Recording of one shot.

    Returns:
        The corrected recording, or the same object where there was no switch; and one sentence per switch.
    """
    t, positions, sigma, switches = recording.t, recording.positions.copy(), recording.sigma.copy(), []
    rows = _find_observed_rows(positions)
    for row in range(1, len(t)):
        jumped = [
            body for body in range(len(recording.bodies)) if _has_jump(t, positions, sigma, rows, row, body, body)
        ]
        if not recording.is_observed[row, jumped].any():
            continue
        identities = _match_identities(t, positions, sigma, rows, row, jumped)
        if identities is not None:
            positions[row:, identities], sigma[row:, identities] = positions[row:, jumped], sigma[row:, jumped]
            rows = _find_observed_rows(positions)
            names = " and ".join(recording.bodies[body] for body in jumped)
            place = f"in shot {recording.shot} bodies {names} were exchanged at {t[row]:.2f} s"
            switches.append(f"{place}; the exchange was undone")
    return (replace(recording, positions=positions, sigma=sigma), tuple(switches)) if switches else (recording, ())


def _find_observed_rows(positions: FloatArray) -> list[IntArray]:
    """Find the rows in which each body was observed."""
    return [np.flatnonzero(is_observed) for is_observed in np.asarray(np.isfinite(positions).all(axis=2)).T]


def _match_identities(
    t: FloatArray, positions: FloatArray, sigma: FloatArray, rows: list[IntArray], row: int, jumped: list[int]
) -> list[int] | None:
    """Match each body that jumped to its identity before, by the shortest distances.

    None where a matched body would still jump, or is itself.
    """
    before = np.array([positions[_find_adjacent_rows(rows, row, body, body)[0][-1], body] for body in jumped])
    after = np.array([positions[_find_adjacent_rows(rows, row, body, body)[1][0], body] for body in jumped])
    distances = np.linalg.norm(after[:, None] - before[None], axis=2)
    chosen = [jumped[k] for k in linear_sum_assignment(distances)[1]]
    for old, new in zip(jumped, chosen, strict=True):
        if old == new or _has_jump(t, positions, sigma, rows, row, new, old):
            return None
    return chosen or None


def _has_jump(
    t: FloatArray, positions: FloatArray, sigma: FloatArray, rows: list[IntArray], row: int, before: int, after: int
) -> bool:
    """Return whether the step to `row` of a body named `before` and then `after` exceeds the speed on either side."""
    first, later = _find_adjacent_rows(rows, row, before, after)
    if min(len(first), len(later)) < _MIN_SIDE_ROWS:
        return False
    one, other = positions[first, before], positions[later, after]
    step, time = float(np.linalg.norm(other[0] - one[-1])), float(t[later[0]] - t[first[-1]])
    excess = step - _JUMP_SIGMAS * float(np.median(sigma[later, after]))
    if excess <= 0:
        return False
    fastest = max(_typical_speed(t[first], one), _typical_speed(t[later], other))
    return excess > _JUMP_SPEED_RATIO * fastest * time


def _find_adjacent_rows(rows: list[IntArray], row: int, before: int, after: int) -> tuple[IntArray, IntArray]:
    """Find the last rows before `row`, and the first from `row` on, in which a body was observed."""
    first, later = rows[before], rows[after]
    return (
        first[: np.searchsorted(first, row)][-_SIDE_STEPS - 1 :],
        later[np.searchsorted(later, row) :][: _SIDE_STEPS + 1],
    )


def _typical_speed(t: FloatArray, positions: FloatArray) -> float:
    """Return the upper quartile of the speed from frame to frame, as a body that is hit is slow in some frames."""
    return float(np.quantile(np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(t), 0.75))
