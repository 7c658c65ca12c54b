"""Windows of a fit, as long as possible: until a simulation is too sensitive to its start or diverges from the data.

A window starts from the places of all bodies. A recorder that stores a sample only after a body has moved leaves out a
body at rest for seconds; its place is known nevertheless, from the samples before and after, and is added.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, build_window_model, fit_effects
from diagnosis.fitting.window_continuation import extend_windows, merge_lost_windows
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import ContactRichScene
from models.estimation.multiple_shooting.shooting_windows import find_sensitive_observation

# Least number of rows of a segment.
MIN_ROWS = 8
# Least number of observations of a body in a segment.
MIN_OBSERVATIONS = 2
# Duration of a segment that hardly ever holds more than one contact, s.
SHORT_SEGMENT_S = 0.5
# Largest lack of fit at which a fit is accepted without another attempt.
_GOOD_LACK_OF_FIT = 4.0
# Median residual from which a simulation has diverged from the observations, standard deviations. Where noise is small
# against the motion, a simulation that lacks an effect misses by more without having diverged: it then has where the
# residual is larger than the extent of the whole motion.
_DIVERGED_SIGMAS = 30.0
# Largest number of times that segments are split further.
_MAX_ROUNDS = 3


def split_into_segments(problem: DiagnosisProblem, recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Split recordings into segments of autonomous motion with at least `MIN_ROWS` rows.

    Args:
        problem: Scene and priors.
        recordings: One recording per shot.

    Returns:
        Segments in the order of the recordings.
    """
    whole = (segment for recording in recordings for segment in problem.scene.split_recording(recording))
    return tuple(segment for segment in whole if segment.is_observed.any(axis=1).sum() >= MIN_ROWS)


def count_windows(problem: DiagnosisProblem, recordings: tuple[Recording, ...]) -> int:
    """Count the windows of all recordings."""
    return sum(len(problem.scene.split_recording(one)) for one in recordings)


def thin_out_windows(problem: DiagnosisProblem, recordings: tuple[Recording, ...], most: int) -> tuple[Recording, ...]:
    """Keep about as many windows as decide, evenly over recordings and their time, so that long ones cost no more.

    Args:
        problem: Scene and priors.
        recordings: One recording per shot.
        most: Number of windows; every recording keeps at least one.

    Returns:
        The recordings with nothing observed in the other windows; the same ones where there are no more.
    """
    windows = [problem.scene.split_recording(one) for one in recordings]
    total = sum(map(len, windows))
    if total <= most:
        return recordings
    thinned = []
    for shot, (one, own) in enumerate(zip(recordings, windows, strict=True)):
        count = max(round(len(own) * most / total), 1)
        # a part of a cycle that all recordings share falls into another window of each
        places = (np.arange(count) * len(own) / count + shot * len(own) / count / len(recordings)).astype(int)
        times = [own[k].t for k in places.tolist()] if own else [one.t]
        is_kept = np.isin(one.t, np.concatenate(times))
        thinned.append(replace(one, positions=np.where(is_kept[:, None, None], one.positions, np.nan)))
    return tuple(thinned)


def fit_adaptively(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
) -> EffectFit:
    """Fit windows that are as long as the hypothesis allows.

    Args:
        problem: Scene and priors.
        recordings: One recording per shot, with its noise estimate applied.
        names: Effects beyond those of the simulator.
        forms: One form per choice between contact models; those of the simulator where not given.
        guess: (P,) initial guess of all parameters; the means of the priors where not given.

    Returns:
        The fit.

    Raises:
        ValueError: No recording has a segment of `MIN_ROWS` rows.
    """
    initial = fit_initial_windows(problem, recordings, names, forms, guess)
    return extend_windows(problem, initial) if isinstance(problem.scene, ContactRichScene) else initial


def fit_initial_windows(
    problem: DiagnosisProblem,
    recordings: tuple[Recording, ...],
    names: tuple[str, ...] = (),
    forms: tuple[str, ...] | None = None,
    guess: FloatArray | None = None,
) -> EffectFit:
    """Fit windows that converge from an initial guess.

    In a contact-rich scene the windows are short. Elsewhere whole segments are fitted, and those that are too sensitive
    to their start are split.

    Args:
        problem: Scene and priors.
        recordings: One recording per shot, with its noise estimate applied.
        names: Effects beyond those of the simulator.
        forms: One form per choice between contact models; those of the simulator where not given.
        guess: (P,) initial guess of all parameters; the means of the priors where not given.

    Returns:
        The fit.

    Raises:
        ValueError: No recording has a segment of `MIN_ROWS` rows.
    """
    segments = split_into_segments(problem, recordings)
    if not segments:
        raise ValueError(f"a diagnosis needs shots of at least {MIN_ROWS} frames; there is none")
    fit = partial(fit_effects, problem, names=names, forms=forms, guess=guess)
    if isinstance(problem.scene, ContactRichScene):
        short = _split_at_rest(segments, problem.scene.initial_window_length, problem.scene.find_bridged_rows)
        return merge_lost_windows(problem, fit(short))
    fitted = _fit_long_segments(problem, segments, fit)
    for _ in range(_MAX_ROUNDS):
        shorter = _split_sensitive_segments(problem, fitted)
        if len(shorter) == len(fitted.segments):
            break
        fitted = fit_effects(problem, shorter, names, forms, fitted.shared)
    return fitted


def fit_longer_windows(problem: DiagnosisProblem, recordings: tuple[Recording, ...], like: EffectFit) -> EffectFit:
    """Fit the hypothesis of another fit on windows that are as long as it allows.

    Args:
        problem: Scene and priors.
        recordings: The recordings of `like`.
        like: Fit of the hypothesis on shorter windows; the initial guess.

    Returns:
        The fit on the longer windows; `like` where there are none.
    """
    if isinstance(problem.scene, ContactRichScene):
        return extend_windows(problem, like)
    if len(like.segments) <= len(split_into_segments(problem, recordings)):
        return like
    return fit_adaptively(problem, recordings, like.names, like.forms, like.shared)


def _fit_long_segments(
    problem: DiagnosisProblem, segments: tuple[Recording, ...], fit: Callable[..., EffectFit]
) -> EffectFit:
    """Fit segments from a guess and, if the lack of fit is large, also from a fit of short parts; keep the better fit.

    Short parts hold too few contacts to be fitted in a wrong order; smooth paths need none.
    """
    long_fit = fit(segments)
    if problem.scene.is_smooth or long_fit.lack_of_fit < _GOOD_LACK_OF_FIT:
        return long_fit
    short = tuple(
        part for segment in segments for part in _split_segment(segment, _find_split_rows(segment, SHORT_SEGMENT_S))
    )
    if len(short) == len(segments):
        return long_fit
    return min((long_fit, fit(segments, guess=fit(short).shared)), key=lambda one: one.cost)


def _split_at_rest(
    segments: tuple[Recording, ...],
    span: float,
    find_bridged_rows: Callable[[Recording], tuple[int, ...]] = lambda _: (),
) -> tuple[Recording, ...]:
    """Split segments, also where a recording contains only a few samples of a body that rests."""
    parts: list[Recording] = []
    for segment in segments:
        firsts = _find_split_rows(segment, span, find_bridged_rows(segment))
        parts += _split_segment(add_rest_observations(segment, firsts), firsts, may_leave=True)
    return tuple(parts)


def _find_split_rows(segment: Recording, span: float, bridged: tuple[int, ...] = ()) -> IntArray:
    """Find the first row of every part of about `span` seconds, and the row after the last one.

    A part that would begin within `MIN_ROWS` of a `bridged` row begins earlier or later, so that one reaches across it:
    what acts there at once changes no part that begins or ends with it, and short windows would hide it.
    """
    count = min(round(float(segment.t[-1] - segment.t[0]) / span), len(segment.t) // MIN_ROWS)
    firsts = np.linspace(0, len(segment.t), max(count, 1) + 1).astype(np.int64)
    if not bridged:
        return firsts
    chosen = [0]
    for first in firsts[1:-1].tolist():
        for row in bridged:
            if abs(first - row) < MIN_ROWS:
                first = row + (MIN_ROWS if first >= row else -MIN_ROWS)
        if chosen[-1] + MIN_ROWS <= first <= len(segment.t) - MIN_ROWS:
            chosen.append(first)
    return np.array([*chosen, len(segment.t)], np.int64)


def _split_segment(segment: Recording, firsts: IntArray, may_leave: bool = False) -> list[Recording]:
    """Split a segment into parts from these first rows on, or longer ones where a body is rarely observed.

    With `may_leave`, a body that is not observed any more, such as a pocketed ball, is in none of the later parts.
    """
    parts: list[Recording] = []
    first = 0
    for end in map(int, firsts[1:]):
        part = segment.select_rows(first, end)
        needed = np.asarray(segment.is_observed[first:].any(axis=0)) if may_leave else True
        if _has_enough_observations(part, needed):
            parts, first = [*parts, part], end
    if first < len(segment.t):
        parts = [*parts[:-1], segment.select_rows(first - len(parts[-1].t) if parts else 0, len(segment.t))]
    return parts


def _has_enough_observations(segment: Recording, needed: BoolArray | bool = True) -> bool:
    """Return whether every body (N,) that is `needed` has `MIN_OBSERVATIONS` in a segment."""
    return bool((segment.is_observed.sum(axis=0) >= np.where(needed, MIN_OBSERVATIONS, 0)).all())


def _split_sensitive_segments(problem: DiagnosisProblem, fitted: EffectFit) -> tuple[Recording, ...]:
    """Split segments where they become too sensitive to their start, and in the middle where the model diverges."""
    model = build_window_model(problem, fitted.segments, fitted.forms, np.zeros(len(problem.priors), bool))
    parts: list[Recording] = []
    for k, segment in enumerate(fitted.segments):
        flow = model.linearize(k, fitted.starts[k], fitted.shared)
        rows, bodies = np.nonzero(segment.is_observed)
        first = find_sensitive_observation(flow.start_jacobian * segment.sigma[rows, bodies][:, None, None])
        cut = int(rows[first]) if first < len(rows) else len(segment.t)
        miss = float(np.median(np.linalg.norm(flow.residual, axis=1)))
        if not miss <= max(_DIVERGED_SIGMAS, _measure_extent(segment)):
            cut = min(cut, len(segment.t) // 2)
        parts += _split_at_row(segment, cut)
    return tuple(parts)


def _measure_extent(segment: Recording) -> float:
    """Measure how far the observed bodies move, standard deviations."""
    extent = np.nanmax(segment.positions, axis=0) - np.nanmin(segment.positions, axis=0)
    return float(np.linalg.norm(extent, axis=1).max() / np.median(segment.sigma[segment.is_observed]))


def _split_at_row(segment: Recording, row: int) -> list[Recording]:
    """Split a segment at a row, unless a part would be too short or hold too few observations."""
    if row < MIN_ROWS or len(segment.t) - row < MIN_ROWS:
        return [segment]
    parts = [segment.select_rows(0, row), segment.select_rows(row, len(segment.t))]
    return parts if all(_has_enough_observations(part) for part in parts) else [segment]


# m/s: mean speed between two samples up to which a body rests in between, but for its last steps.
_REST_SPEED = 0.01
# Rows at the start of a window in which a body at rest is observed: as many as show that it rests.
_ROWS = 2


def add_rest_observations(segment: Recording, firsts: IntArray) -> Recording:
    """Add observations of bodies that rest in the first rows of a window and have no sample there.

    They repeat other samples; all that are added for a body have together the information of one.

    Args:
        segment: Segment of a recording.
        firsts: First row of each window, and the row after the last one.

    Returns:
        The segment with these observations; the same one where there are none.
    """
    positions, sigma = segment.positions.copy(), segment.sigma.copy()
    for body in range(len(segment.bodies)):
        rows = np.flatnonzero(segment.is_observed[:, body])
        empty = [row for row in (firsts[:-1, None] + np.arange(_ROWS)).flat if not segment.is_observed[row, body]]
        sources = {int(row): _find_rest_sample(segment, body, rows, int(row)) for row in empty}
        sources = {row: source for row, source in sources.items() if source >= 0}
        for row, source in sources.items():
            positions[row, body] = segment.positions[source, body]
            sigma[row, body] = segment.sigma[source, body] * np.sqrt(len(sources))
    return replace(segment, positions=positions, sigma=sigma)


def _find_rest_sample(segment: Recording, body: int, rows: IntArray, first: int) -> int:
    """Find the sample, of those at `rows`, that shows where a body rests at row `first`; -1 where it may move."""
    after = int(np.searchsorted(rows, first))
    if after == 0:
        return -1
    is_still = after == 1 or _mean_speed(segment, body, rows[after - 2 : after]) < _REST_SPEED
    if after == len(rows):
        return int(rows[-1]) if is_still else -1
    if not _mean_speed(segment, body, rows[after - 1 : after + 1]) < _REST_SPEED:
        return -1
    return int(rows[after - 1] if is_still else rows[after])


def _mean_speed(segment: Recording, body: int, rows: IntArray) -> float:
    """Compute the mean speed (m/s) of a body between two rows."""
    way: FloatArray = segment.positions[rows[1], body] - segment.positions[rows[0], body]
    return float(np.linalg.norm(way) / (segment.t[rows[1]] - segment.t[rows[0]]))
