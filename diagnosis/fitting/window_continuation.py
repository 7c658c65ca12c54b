"""Continuation fit: windows are merged with the following ones while the hypothesis explains the data.

Long windows hold most information on a weak effect, whose deviation grows with time. In a contact-rich scene, however,
a fit of long windows from an initial guess ends in a wrong order of contacts. Short windows converge from a guess;
where a hypothesis explains two neighbours, the start of the first is that of their union. Where it does not explain the
union, the two stay separate.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from diagnosis.fitting.hypothesis_fits import (
    MIN_IMPROVEMENT,
    DiagnosisProblem,
    EffectFit,
    build_window_model,
    fit_start_states,
    refit_effects,
    simulate_misfits,
)
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.shooting_windows import find_sensitive_observation
from models.numerics.statistics import evaluate_huber_loss

Item = TypeVar("Item")

# Cost per value, and its ratio to the usual shot, from which a simulation is nowhere near the observations.
_UNREACHABLE_COST, _UNREACHABLE_RATIO = 25.0, 10.0
# Share of unreachable shots from which the simulator, not the shots, is at fault.
_MAX_UNREACHABLE_SHARE = 0.25
# Ratio to the cost per value of noise, or of the usual shot, from which a shot is fitted from other starts.
_POOR_RATIO = 1.5
# The same for a hypothesis that is compared with others: twice the chance deviation of a thousand values.
_SLIGHTLY_POOR_RATIO = 1.1
# The same, up to which a window may be very sensitive to its start: a wrong start would not have this cost.
_GOOD_COST = 1.3
# Ratio to the cost per value of noise, or of the initial windows, up to which a union is explained.
#
# A missing effect causes a small misfit; a large one means a wrong path.
_FAILED_MERGE_RATIO = 3.0


def extend_windows(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Extend the windows of a fit while its hypothesis explains the data; fixed parameters stay fixed."""
    fitted, ends = restart_poor_shots(problem, fitted), set[tuple[int, int]]()
    usual = max(float(np.divide(*_window_costs(problem, fitted).sum(axis=0))), 1.0)
    while True:
        pairs = _find_mergeable_pairs(problem, fitted, ends)
        if not len(pairs):
            mean = np.divide(*_window_costs(problem, fitted).sum(axis=0))
            # hidden spin has several nearly right solutions; the residuals of a wrong one would be taken for an effect
            return adopt_better_starts(problem, fitted, fitted.starts, True) if mean < _GOOD_COST else fitted
        merged = refit_effects(problem, *_merge_pairs(fitted, pairs, fitted.starts))
        failed = _find_failed_merges(problem, merged, pairs, usual)
        if failed.any():
            ends |= {_segment_key(fitted.segments[k + 1]) for k in pairs[failed]}
            successful = pairs[~failed]
            starts = list(fitted.starts)
            for place, k in enumerate(pairs):
                starts[k] = starts[k] if failed[place] else merged.starts[k - place]
            merged = (
                refit_effects(problem, *_merge_pairs(fitted, successful, tuple(starts))) if len(successful) else fitted
            )
        fitted = merged


def merge_lost_windows(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Merge windows that do not converge from their own guess with the preceding window.

    A single lost window would outweigh the information of all others.
    """
    costs = _window_costs(problem, fitted)
    mean = costs[:, 0] / np.maximum(costs[:, 1], 1.0)
    lost = _is_unreachable(mean)
    follows = _find_mergeable_pairs(problem, fitted, {_segment_key(fitted.segments[k]) for k in np.flatnonzero(~lost)})
    if not len(follows):
        return fitted
    merged = refit_effects(problem, *_merge_pairs(fitted, follows, fitted.starts))
    return merged if merged.cost < fitted.cost else fitted


def _segment_key(segment: Recording) -> tuple[int, int]:
    """Return the shot and the first frame of a segment."""
    return segment.shot, int(segment.frame[0])


def _find_mergeable_pairs(problem: DiagnosisProblem, fitted: EffectFit, ends: set[tuple[int, int]]) -> np.ndarray:
    """Find the indices of windows that are to be merged with the next one."""
    first_windows: list[int] = []
    for k in range(len(fitted.segments) - 1):
        one, other = fitted.segments[k], fitted.segments[k + 1]
        follows = one.shot == other.shot and one.bodies == other.bodies and other.t[0] > one.t[-1]
        if follows and _segment_key(other) not in ends and k - 1 not in first_windows[-1:]:
            first_windows.append(k)
    pairs = np.array(first_windows, dtype=np.int64)
    windows = build_window_model(
        problem, _merge_pairs(fitted, pairs, fitted.starts)[0], fitted.forms, fitted.free
    ).windows
    alike = [windows[k - place].start.shape == fitted.starts[k].shape for place, k in enumerate(first_windows)]
    return np.asarray(pairs[np.array(alike, dtype=bool)])


def _merge_pairs(
    fitted: EffectFit, pairs: np.ndarray, starts: tuple[FloatArray, ...]
) -> tuple[tuple[Recording, ...], EffectFit, tuple[FloatArray, ...]]:
    """Merge some windows with the next one; each keeps the start of its first window."""
    segments, merged_starts = [], []
    for k, segment in enumerate(fitted.segments):
        if k - 1 in pairs:
            continue
        segments.append(_concatenate_segments(segment, fitted.segments[k + 1]) if k in pairs else segment)
        merged_starts.append(starts[k])
    return tuple(segments), fitted, tuple(merged_starts)


def _concatenate_segments(one: Recording, other: Recording) -> Recording:
    """Concatenate two segments of a shot."""
    return replace(
        one,
        frame=np.concatenate([one.frame, other.frame]),
        t=np.concatenate([one.t, other.t]),
        positions=np.concatenate([one.positions, other.positions]),
        sigma=np.concatenate([one.sigma, other.sigma]),
    )


def _find_failed_merges(problem: DiagnosisProblem, merged: EffectFit, pairs: np.ndarray, usual: float) -> BoolArray:
    """Return which merged windows are not explained, at a usual cost per value, or are too sensitive to their start."""
    costs, failed = _window_costs(problem, merged), []
    for place, k in enumerate(pairs):
        cost, numbers = costs[k - place]
        sure = cost <= _GOOD_COST * usual * numbers
        failed.append(
            not sure
            and (not cost <= _FAILED_MERGE_RATIO * usual * numbers or _is_too_sensitive(problem, merged, k - place))
        )
    return np.array(failed, dtype=bool)


def restart_poor_shots(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Restart the shots with a poor fit from their initial guesses.

    Args:
        problem: Scene and priors.
        fitted: Fit of a hypothesis.

    Returns:
        The better of both fits.
    """
    return _restart_windows(problem, fitted, _find_poor_windows(fitted, _mean_shot_costs(problem, fitted), _POOR_RATIO))


def _restart_windows(problem: DiagnosisProblem, fitted: EffectFit, is_poor: BoolArray) -> EffectFit:
    """Restart poor windows from their initial guesses, with the parameters that the other windows determine.

    A window on a wrong path distorts the shared parameters until no other path fits it; where paths are smooth, there
    is no other one.
    """
    if problem.scene.is_smooth or not is_poor.any() or is_poor.all():
        return fitted
    good, poor = np.flatnonzero(~is_poor), np.flatnonzero(is_poor)
    unbent = refit_effects(problem, _select_items(fitted.segments, good), fitted, _select_items(fitted.starts, good))
    fresh = fit_start_states(
        problem, _select_items(fitted.segments, poor), unbent, _select_items(fitted.starts, poor), retry_guesses=True
    )
    order = np.argsort(np.concatenate([good, poor]))
    refitted = refit_effects(problem, fitted.segments, unbent, _select_items((*unbent.starts, *fresh.starts), order))
    return refitted if refitted.cost < fitted.cost else fitted


def restart_while_improving(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Restart poor shots as long as the fit improves, if the hypothesis explains the other shots.

    A missing effect makes shots poor as well; restarts would not help there.

    Args:
        problem: Scene and priors.
        fitted: Fit of a hypothesis.

    Returns:
        The best fit.
    """
    while _typical_cost(mean := _mean_shot_costs(problem, fitted)) < _GOOD_COST:
        restarted = _restart_windows(problem, fitted, _find_poor_windows(fitted, mean, _SLIGHTLY_POOR_RATIO))
        if fitted.cost - restarted.cost < MIN_IMPROVEMENT:
            return restarted
        fitted = restarted
    return fitted


def _find_poor_windows(fitted: EffectFit, mean: dict[int, float], factor: float) -> BoolArray:
    """Return which windows belong to shots whose cost per value exceeds `factor` times that of the usual shot."""
    odd = {shot for shot, cost in mean.items() if cost > factor * _typical_cost(mean)}
    return np.array([segment.shot in odd for segment in fitted.segments])


def _typical_cost(mean: dict[int, float]) -> float:
    """Return the cost per value of the usual shot, at least that of noise."""
    return max(float(np.median(list(mean.values()))), 1.0)


def _mean_shot_costs(problem: DiagnosisProblem, fitted: EffectFit) -> dict[int, float]:
    """Compute the cost per value of every shot."""
    costs, shots = _window_costs(problem, fitted), np.array([segment.shot for segment in fitted.segments])
    sums = {int(shot): costs[shots == shot].sum(axis=0) for shot in np.unique(shots)}
    return {shot: float(cost / max(numbers, 1.0)) for shot, (cost, numbers) in sums.items()}


def _select_items(all_of_them: tuple[Item, ...], places: np.ndarray) -> tuple[Item, ...]:
    """Select items by index."""
    return tuple(all_of_them[k] for k in places)


def find_unreachable_shots(problem: DiagnosisProblem, fitted: EffectFit) -> tuple[int, ...]:
    """Find shots that no simulation comes near, although most others are explained.

    Examples: a ball moved by hand or off the table, or a cut in the video.

    Args:
        problem: Scene and priors.
        fitted: Fit of the simulator.

    Returns:
        Indices of the shots; empty where many shots are unreachable.
    """
    mean = _mean_shot_costs(problem, fitted)
    lost = _is_unreachable(np.array(list(mean.values())))
    return (
        tuple(shot for shot, far in zip(mean, lost, strict=True) if far) if lost.mean() < _MAX_UNREACHABLE_SHARE else ()
    )


def _is_unreachable(mean: FloatArray) -> BoolArray:
    """Return which costs per value are large both in absolute terms and relative to the others."""
    return np.asarray((mean > _UNREACHABLE_COST) & (mean > _UNREACHABLE_RATIO * np.median(mean)))


def adopt_better_starts(
    problem: DiagnosisProblem, fitted: EffectFit, starts: tuple[FloatArray, ...], retry_guesses: bool = False
) -> EffectFit:
    """Refit a hypothesis from other start states in the shots where they give a better fit.

    Args:
        problem: Scene and priors.
        fitted: Fit of the hypothesis.
        starts: Start state (S,) of each window, from another fit.
        retry_guesses: Also try the initial guesses of the windows.

    Returns:
        The better of both fits.
    """
    if problem.scene.is_smooth:  # one path fits a window best
        return fitted
    costs, shots = _window_costs(problem, fitted), np.array([segment.shot for segment in fitted.segments])
    fresh = fit_start_states(problem, fitted.segments, fitted, starts, retry_guesses)
    now, chosen = _window_costs(problem, fresh), list(fitted.starts)
    improved = [shot for shot in np.unique(shots) if now[shots == shot, 0].sum() < costs[shots == shot, 0].sum()]
    for k in np.flatnonzero(np.isin(shots, improved)):
        chosen[k] = fresh.starts[k]
    if not improved:
        return fitted
    refitted = refit_effects(problem, fitted.segments, fitted, tuple(chosen))
    return refitted if refitted.cost < fitted.cost else fitted


def _window_costs(problem: DiagnosisProblem, fitted: EffectFit) -> FloatArray:
    """Compute (W, 2): the robust cost of every window and its number of observed values."""
    misfits = simulate_misfits(problem, fitted, fitted.forms, fitted.shared)
    return np.array([(evaluate_huber_loss(one)[1], one.size) for one in misfits], dtype=np.float64)


def _is_too_sensitive(problem: DiagnosisProblem, fitted: EffectFit, window: int) -> bool:
    """Return whether a window becomes too sensitive to its start before its end."""
    segment = fitted.segments[window]
    model = build_window_model(problem, fitted.segments, fitted.forms, np.zeros(len(problem.priors), bool))
    rows, bodies = np.nonzero(segment.is_observed)
    by_start = model.linearize(window, fitted.starts[window], fitted.shared).start_jacobian
    return find_sensitive_observation(by_start * segment.sigma[rows, bodies][:, None, None]) < len(by_start)
