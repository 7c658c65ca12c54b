"""Laws, numbers and spin of a clip's whole shots, from its tracks and from what the fit of its pieces found.

Between contacts the fit of the pieces asks for little, so that it tells what happened on any table. Here published laws
have to explain each shot from its strike to its end, spin and all; where they do, they say more.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Fit, Laws
from models.core.options import FitOptions
from models.core.scene import Table
from models.core.tracks import Tracks
from models.estimation.whole_shot.initial_states import beginning
from models.estimation.whole_shot.shot_segments import Stretch
from models.estimation.whole_shot.table_fit import TableFit, fit_known, fit_table
from models.estimation.whole_shot.table_prior import KnownTable
from models.physics.billiards.simulation.parametrised_shot import slips, spins
from models.tracking.track_noise import estimate_noise, with_noise

MOST_BALLS = 4
"""that move: a break hangs on its start too much to be explained whole."""
MOST_CONTACTS = 40
APART = 0.1
"""s between two strikes."""
AFTER = 0.3
"""s after the last ball came to rest that still belong to a shot."""
ACCEPTED = 2.0
"""chi2 per degree of freedom up to which laws are taken to explain shots: real noise is known to some ten per cent, and
errors are widened by what is left."""
FEWEST = 10
"""pictures of a shot."""


def with_laws(fit: Fit, tracks: Tracks, table: Table, options: FitOptions, known: KnownTable | None = None) -> Fit:
    """The fit with the laws that explain its whole shots, or with the reason why there are none; those of the table
    where it is `known`."""
    why = _hopeless(fit, tracks)
    if why:
        return replace(fit, lawless=why)
    noise = estimate_noise(tracks, 5 * options.moving_speed, table.ball_radius)
    balls = np.flatnonzero(fit.moving.any(axis=0))
    stretches = stretches_of(fit, with_noise(tracks, noise), balls, options.moving_speed, table.ball_radius)
    if not stretches:
        return replace(fit, lawless="No shot was seen from its strike on.")
    try:
        found = fit_table(stretches, table) if known is None else fit_known(stretches, table, known)
    except np.linalg.LinAlgError as failure:
        return replace(fit, lawless=f"The fit of whole shots failed: {failure}.")
    if not (found.converged and found.chi2_per_dof < ACCEPTED):
        return replace(fit, lawless=_unexplained(found))
    return replace(fit, laws=_laws(found, stretches, tuple(tracks.ids[k] for k in balls), table))


def stretches_of(
    fit: Fit, tracks: Tracks, balls: NDArray[np.int64], moving_speed: float, radius: float
) -> tuple[Stretch, ...]:
    """What was seen of these balls (N,) from where each shot begins to the next one, or until all lie."""
    strikes = [float(t) for kind, t in zip(fit.events.kind, fit.events.t, strict=True) if kind == "strike"]
    first = float(tracks.t[np.flatnonzero(fit.moving.any(axis=1))[0]])
    if not strikes or strikes[0] > first + APART:  # the clip begins when the balls are on their way
        strikes = [first, *strikes]
    begins = [t for k, t in enumerate(strikes) if k == 0 or t - strikes[k - 1] > APART]
    found: list[Stretch] = []
    for begin, end in pairwise([*begins, np.inf]):
        rows = np.flatnonzero((tracks.t >= begin) & (tracks.t < end))
        busy = rows[fit.moving[rows].any(axis=1)]
        if len(busy) >= FEWEST:
            rows = rows[tracks.t[rows] <= tracks.t[busy[-1]] + AFTER]
            found.append(_stretch(fit, tracks, rows, balls, moving_speed, radius, bool(found)))
    return tuple(found)


def _stretch(
    fit: Fit, tracks: Tracks, rows: NDArray[np.int64], balls: NDArray[np.int64], moving_speed: float, radius: float,
    follows: bool,
) -> Stretch:  # fmt: skip
    part = np.ix_(rows, balls)
    t, sigma, whiten = tracks.t[rows], tracks.sigma[part], tracks.whitening[part]
    xy = np.where(np.isfinite(whiten.sum(axis=(2, 3)))[..., None], tracks.xy[part], np.nan)
    start, moving = beginning(t, xy, sigma)
    state = fit.trajectory.at(t[0])
    whole = np.concatenate([state.xy, state.v, np.nan_to_num(state.w)], axis=1)[balls]
    known = np.isfinite(whole[:, :4]).all(axis=1)
    start[known] = slips(whole[known], np.full(int(known.sum()), radius))
    moving[known] = np.linalg.norm(whole[known, 2:4], axis=1) > moving_speed
    start[~moving, 2:] = 0.0
    return Stretch(0, float(t[0]), t, xy, whiten, start, moving, follows)


def _hopeless(fit: Fit, tracks: Tracks) -> str:
    """Why nothing is tried, a sentence; empty where it is worth a try."""
    moved = int(fit.moving.any(axis=0).sum())
    contacts = sum(kind in ("ball", "cushion") for kind in fit.events.kind)
    if not moved:
        return "No ball moved."
    if moved > MOST_BALLS or contacts > MOST_CONTACTS:
        return f"{moved} balls with {contacts} contacts are too many to be explained whole."
    return ""


def _unexplained(found: TableFit) -> str:
    if found.chi2_per_dof < ACCEPTED:
        return "The fit of whole shots did not settle."
    return (
        f"No published law explains the shots whole: the best, {found.laws.cushion} with {found.laws.ball}, leaves"
        f" {found.chi2_per_dof:.1f} times the noise in variance."
    )


def _laws(found: TableFit, stretches: tuple[Stretch, ...], ids: tuple[str, ...], table: Table) -> Laws:
    factor = next(p.value for p in found.parameters if p.name == "collision_radius.factor")
    state, turn = spins(found.states[0], table.ball_radius * factor)
    return Laws(
        found.laws.cushion, found.laws.ball, found.chi2_per_dof, found.parameters, stretches[0].begin, ids,
        state, turn @ found.covariances[0] @ turn.T,
    )  # fmt: skip
