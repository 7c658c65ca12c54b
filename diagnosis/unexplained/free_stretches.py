"""Stretches of motion between contacts: what each body does beyond the model of a fit, continuous over its windows.

A window starts anew from the observations, so what a model lacks shows in it only for the length of the window. Between
two contacts the windows of a body are therefore joined: the predicted path continues with the place and the velocity in
which the previous window ended, so that the residuals of a stretch are the double integral of the missing acceleration,
but for two numbers per coordinate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from scipy.signal import savgol_filter

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit
from diagnosis.unexplained.force_law import fit_pieces
from models.core.recording import Recording
from models.core.typing import FloatArray

# Phases in which a body moves under a resistance that a patch changes: friction brakes a ball that slides far more.
_FREE_PHASES = ("free_roll", "slide", "wall_contact")
# Speed from which a body moves, as a share of the largest: a body at rest shows no friction.
_MIN_SPEED_SHARE = 0.05
# s at the beginning and at the end that are left out: the end of sliding is known to some hundredths of a second, and a
# contact may come a frame or two off its prediction.
_MARGINS_S = 0.08, 0.03
# Rows over which a parabola smooths the observed places: a patch changes a path little within so few.
_SMOOTHED_ROWS = 9
# s without an observation over which windows are joined: an acceleration hardly changes meanwhile.
_MAX_JOIN_S = 0.1


@dataclass(frozen=True, slots=True)
class FreeStretch:
    """Motion of one body between two contacts, in the T rows in which it was observed."""

    shot: int
    """Index of the shot."""
    t: FloatArray
    """(T,) s."""
    residual: FloatArray
    """(T, 2) m, observed minus predicted: the double integral of what the model lacks, plus a + b t."""
    sigma: FloatArray
    """(T,) m, standard deviation of each coordinate."""
    position: FloatArray
    """(T, 2) m, observed and smoothed."""
    velocity: FloatArray
    """(T, 2) m/s."""


def find_free_stretches(problem: DiagnosisProblem, fitted: EffectFit) -> tuple[FreeStretch, ...]:
    """Find the stretches of motion in a plane between two contacts.

    Args:
        problem: Scene and noise.
        fitted: A fit.

    Returns:
        Stretches of at least `_SMOOTHED_ROWS` observations; none where the motion is not in a plane.
    """
    if any(one.positions.shape[2] != 2 for one in fitted.segments):
        return ()
    fitted = fit_pieces(problem, fitted)
    tracks: dict[tuple[int, str], list[_BodyRows]] = {}
    for segment, start in zip(fitted.segments, fitted.starts, strict=True):
        for body, rows in _measure_bodies(problem, fitted, segment, start):
            tracks.setdefault((segment.shot, body), []).append(rows)
    bodies = {track: _concatenate(windows) for track, windows in tracks.items()}
    speeds = [np.linalg.norm(one.velocity[one.is_free > 0], axis=1).max(initial=0.0) for one in bodies.values()]
    least = _MIN_SPEED_SHARE * max(speeds, default=0.0)
    stretches = (
        _continue_path(shot, part) for (shot, _), one in bodies.items() for part in _split_at_contacts(one, least)
    )
    return tuple(stretches)


@dataclass(frozen=True, slots=True)
class _BodyRows:
    """Observations of one body, in the order of time."""

    t: FloatArray
    residual: FloatArray
    sigma: FloatArray
    position: FloatArray
    velocity: FloatArray
    is_free: FloatArray
    """(T,) 1 where it moves freely, 0 elsewhere."""
    contact: FloatArray
    """(T,) s, time of its last contact; minus infinity where there was none."""
    window: FloatArray
    """(T,) s, when the window begins."""

    def select(self, rows: slice) -> _BodyRows:
        """Return some of the rows."""
        return _BodyRows(*(getattr(self, field.name)[rows] for field in fields(self)))


def _concatenate(windows: list[_BodyRows]) -> _BodyRows:
    """Concatenate the windows of one body."""
    return _BodyRows(*(np.concatenate([getattr(one, field.name) for one in windows]) for field in fields(_BodyRows)))


def _measure_bodies(
    problem: DiagnosisProblem, fitted: EffectFit, segment: Recording, start: FloatArray
) -> Iterator[tuple[str, _BodyRows]]:
    """Yield each body that is seen in a window with its residuals."""
    path = problem.scene.predict_positions(segment, start, fitted.shared, fitted.forms)
    covariates = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
    is_free = np.isin(np.array(covariates.phase), _FREE_PHASES)
    rows, bodies = np.nonzero(segment.is_observed)
    # the noise of neighbouring frames may be correlated, and an acceleration is an average over many frames
    factor = float(np.sqrt((1 + problem.noise.correlation) / (1 - problem.noise.correlation)))
    for body, name in enumerate(segment.bodies):
        own = np.flatnonzero(bodies == body)
        if not len(own):
            continue
        here = rows[own]
        t, residual = segment.t[here], segment.positions[here, body] - path[here, body]
        yield (
            name,
            _BodyRows(
                t,
                residual,
                factor * segment.sigma[here, body],
                segment.positions[here, body],
                covariates.velocity[own],
                (is_free[own] & np.isfinite(residual).all(axis=1)).astype(np.float64),
                np.nan_to_num(t - covariates.since_contact[own], nan=-np.inf),
                np.full(len(own), segment.t[0]),
            ),
        )


def _split_at_contacts(body: _BodyRows, least_speed: float) -> Iterator[_BodyRows]:
    """Yield the stretches in which a body moves freely, and faster than `least_speed` (m/s)."""
    moves = (body.is_free > 0) & (np.linalg.norm(body.velocity, axis=1) > least_speed)
    meets = body.contact[1:] > body.t[:-1]
    is_far = (np.diff(body.window) > 0) & (np.diff(body.t) > _MAX_JOIN_S)
    ends = np.flatnonzero(~moves[1:] | ~moves[:-1] | meets | is_far) + 1
    for first, end in pairwise([0, *ends.tolist(), len(body.t)]):
        # motion that is already free when the recording begins follows no contact
        follows_contact = first > 0 or np.isfinite(body.contact[0])
        inside = np.array([body.t[first] + _MARGINS_S[0] * follows_contact, body.t[end - 1] - _MARGINS_S[1]])
        begin, stop = (first + np.searchsorted(body.t[first:end], inside, side="left")).tolist()
        if stop - begin >= _SMOOTHED_ROWS and moves[first]:
            yield body.select(slice(begin, stop))


def _continue_path(shot: int, body: _BodyRows) -> FreeStretch:
    """Continue the path of each window from the end of the previous one."""
    residual, velocity = body.residual.copy(), body.velocity.copy()
    acceleration = np.zeros_like(velocity)
    firsts = np.flatnonzero(np.diff(body.window, prepend=-np.inf))
    for first, end in pairwise([*firsts.tolist(), len(body.t)]):
        if end - first > 1:
            acceleration[first:end] = np.gradient(velocity[first:end], body.t[first:end], axis=0)
    path = body.position - residual
    for first, end in pairwise([*firsts[1:].tolist(), len(body.t)]):
        last, step = first - 1, float(body.t[first] - body.t[first - 1])
        change = 0.5 * (acceleration[last] + acceleration[first]) * step
        off = path[last] + (velocity[last] + 0.5 * change) * step - path[first]
        turn = velocity[last] + change - velocity[first]
        moved = off + turn * (body.t[first:end] - body.t[first])[:, None]
        path[first:end], velocity[first:end] = path[first:end] + moved, velocity[first:end] + turn
        residual[first:end] -= moved
    noise = residual - savgol_filter(residual, _SMOOTHED_ROWS, 2, axis=0)
    return FreeStretch(shot, body.t, residual, body.sigma, body.position - noise, body.velocity)
