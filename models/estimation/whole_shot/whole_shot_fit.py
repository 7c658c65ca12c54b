"""Fit of a clip's whole shots: contact models, parameters and spin, from tracks and the fit of their segments.

The fit of segments makes few assumptions about contacts, so that it reconstructs events on any table. Here published
contact models have to explain each shot from strike to end, including spin; where they do, the result contains more.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.fit_result import Fit, WholeShotFit, WholeShotMisfit, WholeShotSolution
from models.core.options import FitOptions
from models.core.scene import Table
from models.core.tracks import Tracks
from models.estimation.whole_shot.continuation_fit import VIEW_BEYOND_CONTACT, UnexplainedView
from models.estimation.whole_shot.known_table import TablePrior
from models.estimation.whole_shot.shot_segments import ShotSegment, estimate_initial_states
from models.estimation.whole_shot.table_fit import LawSearch, TableFit, search_laws
from models.numerics.statistics import huber_losses
from models.physics.billiards.simulation.parametrised_shot import convert_to_starts, convert_to_states
from models.tracking.track_noise import apply_noise, estimate_noise

# More moving balls make a break shot, which is too sensitive to its start to be explained whole.
MAX_MOVING_BALLS = 4
MAX_CONTACTS = 40
# s between two strikes.
MIN_STRIKE_INTERVAL = 0.1
# s after the last ball stopped that still belong to a shot.
REST_MARGIN = 0.3
# chi2 per degree of freedom up to which contact models explain shots: real noise is known to about 10 %, and the errors
# are inflated by the excess.
MAX_CHI2 = 2.0
# Frames of a shot.
MIN_FRAMES = 10


def fit_shot_laws(
    fit: Fit, tracks: Tracks, table: Table, options: FitOptions, table_prior: TablePrior | None = None
) -> WholeShotFit:
    """Find the contact models that explain a clip's whole shots.

    Args:
        fit: Fit of the segments of the clip.
        tracks: Tracks of the clip.
        table: Dimensions of the table.
        options: Options of the fit.
        table_prior: Physics of the table, where it is known.

    Returns:
        The models, or why there are none.
    """
    refusal = _find_refusal(fit)
    if refusal:
        return WholeShotFit(refusal=refusal)
    noise = estimate_noise(tracks, 5 * options.moving_speed, table.ball_radius)
    balls = np.flatnonzero(fit.moving.any(axis=0))
    segments = extract_segments(fit, apply_noise(tracks, noise), balls, options.moving_speed, table.ball_radius)
    if not segments:
        return WholeShotFit(refusal="No shot was recorded from its strike on.")
    try:
        search = search_laws(segments, table, table_prior)
    except np.linalg.LinAlgError as failure:
        return WholeShotFit(refusal=f"The fit of whole shots failed: {failure}.")
    best, ids = search.best, tuple(tracks.ids[k] for k in balls)
    if best.converged and best.chi2_per_dof < MAX_CHI2:
        return WholeShotFit(_summarize_laws(best, segments, ids, table))
    if search.unexplained:
        return WholeShotFit(misfit=_summarize_misfit(search, fit.events, ids))
    return WholeShotFit(refusal=_format_failure(best))


def extract_segments(
    fit: Fit, tracks: Tracks, balls: NDArray[np.int64], moving_speed: float, radius: float
) -> tuple[ShotSegment, ...]:
    """Extract the observations of every shot, from its strike to the next one or until all balls rest.

    Args:
        fit: Fit of the segments of the clip.
        tracks: Tracks of the clip.
        balls: (N,) indices of the balls that move.
        moving_speed: m/s above which a ball counts as moving.
        radius: m, of a ball.

    Returns:
        One segment per shot.
    """
    strikes = [float(t) for kind, t in zip(fit.events.kind, fit.events.t, strict=True) if kind == "strike"]
    first = float(tracks.t[np.flatnonzero(fit.moving.any(axis=1))[0]])
    if not strikes or strikes[0] > first + MIN_STRIKE_INTERVAL:  # the clip begins when the balls are on their way
        strikes = [first, *strikes]
    begins = [t for k, t in enumerate(strikes) if k == 0 or t - strikes[k - 1] > MIN_STRIKE_INTERVAL]
    segments: list[ShotSegment] = []
    for begin, end in pairwise([*begins, np.inf]):
        rows = np.flatnonzero((tracks.t >= begin) & (tracks.t < end))
        busy = rows[fit.moving[rows].any(axis=1)]
        if len(busy) >= MIN_FRAMES:
            rows = rows[tracks.t[rows] <= tracks.t[busy[-1]] + REST_MARGIN]
            segments.append(_build_segment(fit, tracks, rows, balls, moving_speed, radius, bool(segments)))
    return tuple(segments)


def _build_segment(
    fit: Fit, tracks: Tracks, rows: NDArray[np.int64], balls: NDArray[np.int64], moving_speed: float, radius: float,
    follows: bool,
) -> ShotSegment:  # fmt: skip
    part = np.ix_(rows, balls)
    t, sigma, whiten = tracks.t[rows], tracks.sigma[part], tracks.whitening[part]
    xy = np.where(np.isfinite(whiten.sum(axis=(2, 3)))[..., None], tracks.xy[part], np.nan)
    start, moving = estimate_initial_states(t, xy, sigma)
    state = fit.trajectory.at(t[0])
    fitted_state = np.concatenate([state.xy, state.v, np.nan_to_num(state.w)], axis=1)[balls]
    is_fitted = np.isfinite(fitted_state[:, :4]).all(axis=1)
    start[is_fitted] = convert_to_starts(fitted_state[is_fitted], np.full(int(is_fitted.sum()), radius))
    moving[is_fitted] = np.linalg.norm(fitted_state[is_fitted, 2:4], axis=1) > moving_speed
    start[~moving, 2:] = 0.0
    return ShotSegment(0, float(t[0]), t, xy, whiten, start, moving, follows)


def _find_refusal(fit: Fit) -> str:
    """Return a sentence with the reason why whole shots are not fitted; empty where they are."""
    moved = int(fit.moving.any(axis=0).sum())
    contacts = sum(kind in ("ball", "cushion") for kind in fit.events.kind)
    if not moved:
        return "No ball moved."
    if moved > MAX_MOVING_BALLS or contacts > MAX_CONTACTS:
        return f"{moved} balls with {contacts} contacts are too many for a fit of the whole shot."
    return ""


def _format_failure(best: TableFit) -> str:
    if best.chi2_per_dof < MAX_CHI2:
        return "The fit of whole shots did not converge."
    return (
        f"No published contact models explain the whole shots: the best, {best.laws.cushion} with {best.laws.ball},"
        f" leave {np.sqrt(best.chi2_per_dof):.1f} times the measurement noise."
    )


def _summarize_misfit(search: LawSearch, events: Events, ids: tuple[str, ...]) -> WholeShotMisfit:
    """Summarize where the model that explains the longest part of the shot fails; of equals, the nearest one."""
    longest = search.unexplained[0][1].explained_until
    rivals = [one for one in search.unexplained if one[1].explained_until == longest]
    laws, view, ball, _ = min(((laws, view, *_find_worst_ball(view)) for laws, view in rivals), key=lambda one: one[3])
    k = _find_contact(events, ids[ball], view)
    names = {events.a[k], events.b[k]} - {ids[ball]} if k >= 0 else {""}
    deviation, times_noise = _measure_deviation(view, ball, float(events.t[k]) if k >= 0 else -np.inf)
    explained_until = min(longest, float(events.t[k])) if k >= 0 else longest
    return WholeShotMisfit(
        laws.cushion, laws.ball, explained_until, ids[ball], events.kind[k] if k >= 0 else "", "".join(names),
        float(events.t[k]) if k >= 0 else float("nan"), deviation, times_noise,
        float(np.sqrt(search.best.chi2_per_dof)),
    )  # fmt: skip


def _find_worst_ball(view: UnexplainedView) -> tuple[int, float]:
    """Find the ball with the largest mean cost in the last window, and return it with the total cost of this window."""
    last = len(view.model.windows) - 1
    window = view.model.windows[last]
    cost = huber_losses(view.model.simulate(last, view.guess.starts[last], view.guess.shared).residual)
    balls = np.unique(window.body)
    return int(balls[np.argmax([cost[window.body == ball].mean() for ball in balls])]), float(cost.sum())


def _find_contact(events: Events, ball: str, view: UnexplainedView) -> int:
    """Find the first contact of a ball whose outcome the explained part does not show; else its last one; else -1."""
    end = float(view.model.segments[-1].t[-1])
    own = [
        k
        for k in np.argsort(events.t, kind="stable")
        if events.kind[k] in ("strike", "ball", "cushion") and ball in (events.a[k], events.b[k]) and events.t[k] < end
    ]
    late = [k for k in own if events.t[k] > view.explained_until - VIEW_BEYOND_CONTACT]
    return int(late[0]) if late else int(own[-1]) if own else -1


def _measure_deviation(view: UnexplainedView, ball: int, since: float) -> tuple[float, float]:
    """Return the RMS distance (m) of a ball from the best fit since a time (s), and per axis over the noise."""
    last = len(view.model.segments) - 1
    segment = view.model.segments[last]
    path = view.model.predict_observed_path(last, view.guess.starts[last], view.guess.shared)[:, ball]
    distance = path - segment.xy[:, ball]
    shown = np.isfinite(distance[:, 0])
    rows = shown & (segment.t > since) if (shown & (segment.t > since)).any() else shown
    whitened = np.einsum("tij,tj->ti", segment.whitening[rows, ball], distance[rows])
    return float(np.sqrt(np.mean(np.sum(distance[rows] ** 2, axis=1)))), float(np.sqrt(np.mean(whitened**2)))


def _summarize_laws(
    table_fit: TableFit, segments: tuple[ShotSegment, ...], ids: tuple[str, ...], table: Table
) -> WholeShotSolution:
    factor = next(p.value for p in table_fit.parameters if p.name == "collision_radius.factor")
    state, turn = convert_to_states(table_fit.states[0], table.ball_radius * factor)
    return WholeShotSolution(
        table_fit.laws.cushion, table_fit.laws.ball, table_fit.chi2_per_dof, table_fit.parameters, segments[0].begin,
        ids, state, turn @ table_fit.covariances[0] @ turn.T, segments[0].moving,
        np.array([one.start for one in table_fit.samples]), np.array([one.values for one in table_fit.samples]),
        tuple(one.ball_model for one in table_fit.samples), table_fit.equal_models,
    )  # fmt: skip
