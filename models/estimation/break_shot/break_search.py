"""Plays of a burst that end where the balls were seen: many racks are tried, good ones mended, mended ones shaken.

Which of two contacts comes first changes all that follows, so that the loss has as many valleys as there are orders.
Within one, the exact derivatives of the play lead down (Levenberg-Marquardt). So racks are drawn from what pictures
tell of them; what is seen shortly after the hit is looked at first, when few contacts have happened; the better ones
go on, samples counting as noisy at first; and the best are shaken and mended again, as in basin hopping (Wales and
Doye 1997, doi:10.1021/jp970984n). At last racks are drawn around the best, as far as it is determined: what all those
that end in the same place have in common is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.break_shot.break_data import Burst
from models.estimation.break_shot.break_simulation import Play
from models.physics.billiards.simulation.parametrised_shot import MOVING
from models.physics.billiards.simulation.simulated_shot import Run

ATTEMPTS, EXPLAINED = 2, 3.0
"""Searches at most, and the chi2 per degree of freedom with which one is content: valleys are many."""
DRAWN = 40
"""racks begun with."""
STAGES = ((0.4, 16, 5), (0.67, 8, 6), (1.0, 5, 12))
"""Share of the time after the hit that is looked at, how many racks go on, and steps taken for each."""
SHAKEN, STEPS = 200, 10
"""times that one of the best is shaken, and steps to mend it."""
SOFT = 0.07
"""ball radii: at first no sample is taken to be surer, about the noise of a pixel."""
MUCH = 1.5
"""How many times surer samples may be before they are taken to be noisier."""
HOPELESS = 30.0
"""chi2 per degree of freedom of the best rack so far, from which shaking helps no more."""
QUIET = 50
"""shakes in a row that may gain nothing."""
AROUND = 24
"""racks drawn around the best."""
WORTH_TELLING = 9.0
"""How much less likely than the best a play may be, as chi2."""
_GAIN = 0.5
"""cost that a step must gain to go on."""
_NOTABLE = 1.0
"""cost that a shake must gain to count."""
_DAMPINGS = 5
"""how often a step is shortened."""
_STEEPEST = 1e12
"""standard deviations over a unit of a number."""
_LEAST_KNOWN, _RIDGE = 1e-6, 1e-9
"""1/variance of a number that nothing tells, in its own unit, and what is added to a unit diagonal."""
_SHAKES = (-1.5, 0.0)
"""powers of ten, standard deviations by which numbers are shaken."""


@dataclass(frozen=True, slots=True)
class Played:
    """One play, and how far it misses what was seen."""

    numbers: FloatArray
    """(P,) as `Play` counts them."""
    run: Run
    missed: FloatArray
    """(R,) standard deviations, as `Play.missed` gives them."""
    cost: float


@dataclass(frozen=True, slots=True)
class Plays:
    """M plays of one burst that what was seen does not tell apart, the best one first."""

    burst: Burst
    played: tuple[Played, ...]
    weight: FloatArray
    """(M,) probabilities of the plays; they sum to 1."""
    covariance: FloatArray
    """(P, P) of the numbers of the best, scaled by its lack of fit."""
    chi2_per_dof: float
    """robust, of the best."""


def search(burst: Burst, rng: np.random.Generator) -> Plays | None:
    """The plays that explain a burst best; None where none could be played."""
    found: Plays | None = None
    for _ in range(ATTEMPTS):
        other = _searched(burst, rng)
        if found is None or (other is not None and other.chi2_per_dof < found.chi2_per_dof):
            found = other
        if found is None or found.chi2_per_dof < EXPLAINED:
            break
    return found


def _searched(burst: Burst, rng: np.random.Generator) -> Plays | None:
    """The same, from racks drawn once."""
    play = Play(burst, burst.ends)
    value, sigma = _spread(play)
    racks = [play.apart(value)] + [
        play.apart(play.within(value + sigma * rng.normal(size=len(value)))) for _ in range(DRAWN - 1)
    ]
    softness = _softness(burst)
    best: list[Played] = []
    for share, kept, steps in STAGES:
        early = Play(burst.softened(softness[0]), burst.hit + share * (burst.ends - burst.hit))
        best = _all_mended(early, racks, steps)[:kept]
        racks = [one.numbers for one in best]
    dof = max(2 * len(play.rows) - MOVING, 1)
    if not best or best[0].cost > HOPELESS * dof:
        return None
    for soft in softness:
        blurred = Play(burst.softened(soft), burst.ends)
        best = _all_mended(blurred, [one.numbers for one in best], STEPS)
        best = _shaken(blurred, best, sigma, SHAKEN // len(softness), rng)
    misfit = max(best[0].cost / dof, 1.0)
    axes = _axes(play, best[0]) * np.sqrt(misfit)
    around = _around(play, best[0], axes, misfit, rng)
    others = [(one, np.exp(-(one.cost - best[0].cost) / (2 * misfit))) for one in best[1:]]
    told = [(best[0], 1.0 / (1 + len(around)))] + [(one, share / (1 + len(around))) for one, share in around] + others
    weight = np.array([share for _, share in told])
    return Plays(burst, tuple(one for one, _ in told), weight / weight.sum(), axes @ axes.T, best[0].cost / dof)


def _softness(burst: Burst) -> tuple[float, ...]:
    """How many times noisier samples are taken to be, at first, midway, and at last: the sharper they are, the narrower
    the valleys, and a rack that is nearly right looks as bad as any."""
    usual = float(np.median(1 / np.linalg.norm(burst.whiten, -2, axis=(1, 2))))
    most = SOFT * burst.table.ball_radius / usual
    return (most, float(np.sqrt(most)), 1.0) if most > MUCH else (1.0,)


def _all_mended(play: Play, racks: list[FloatArray], steps: int) -> list[Played]:
    """All racks that can be played, led downhill, the best one first."""
    tried = [mended for rack in racks if (mended := _mended(play, rack, steps)) is not None]
    return sorted(tried, key=lambda one: one.cost)


def _spread(play: Play) -> tuple[FloatArray, FloatArray]:
    """Numbers (P,) to begin with, and by how much they are drawn and shaken: what samples alone tell is told by all of
    them, and needs no draws."""
    value, sigma = play.usual
    return value, np.where(np.isfinite(sigma), sigma, 0.0)


def _shaken(play: Play, best: list[Played], sigma: FloatArray, times: int, rng: np.random.Generator) -> list[Played]:
    """The best plays after more were found beside them."""
    kept, quiet = len(best), 0
    for _ in range(times):
        one = best[min(int(rng.exponential()), len(best) - 1)]
        size = 10 ** rng.uniform(*_SHAKES)
        other = _mended(play, play.apart(play.within(one.numbers + size * sigma * rng.normal(size=len(sigma)))), STEPS)
        if other is None:
            continue
        quiet = 0 if other.cost < best[0].cost - _NOTABLE else quiet + 1
        best = sorted([*best, other], key=lambda one: one.cost)[:kept]
        if quiet >= QUIET:
            break
    return best


def _axes(play: Play, best: Played) -> FloatArray:
    """Directions (P, P), one a column, in which the numbers of a play err by a standard deviation each."""
    weight, _ = play.weights(best.missed)
    slope = play.slopes(best.numbers, best.run) * np.sqrt(weight)[:, None]
    normal = slope.T @ slope
    scale = 1 / np.sqrt(np.maximum(np.diag(normal), _LEAST_KNOWN))
    values, axes = np.linalg.eigh(normal * scale * scale[:, None])
    spread: FloatArray = scale[:, None] * axes / np.sqrt(np.maximum(values, _RIDGE))
    return spread


def _around(
    play: Play, best: Played, axes: FloatArray, misfit: float, rng: np.random.Generator
) -> list[tuple[Played, float]]:
    """Plays drawn around the best along its `axes` (P, P), each with how likely it is beside its draw."""
    found = []
    for _ in range(AROUND):
        draw = rng.normal(size=len(axes))
        numbers = play.apart(play.within(best.numbers + axes @ draw))
        other = _at(play, numbers)
        if other is not None:
            worse = (other.cost - best.cost) / misfit - float(draw @ draw)
            found.append((other, float(np.exp(-0.5 * max(worse, 0.0)))))
    return [(one, share) for one, share in found if share > np.exp(-0.5 * WORTH_TELLING)]


def _at(play: Play, numbers: FloatArray) -> Played | None:
    """The play of these numbers; None where it cannot be played."""
    try:
        missed, run = play.missed(numbers)
    except ArithmeticError:
        return None
    cost = play.weights(missed)[1]
    return Played(numbers, run, missed, cost) if np.isfinite(cost) else None


def _mended(play: Play, numbers: FloatArray, steps: int) -> Played | None:
    """The numbers led downhill by Levenberg and Marquardt's steps; None where they cannot be played."""
    now, damping = _at(play, numbers), 1e-2
    if now is None:
        return None
    for _ in range(steps):
        weight, _ = play.weights(now.missed)
        slope = play.slopes(now.numbers, now.run)
        if not np.abs(slope).max() < _STEEPEST:  # a contact that is only just one, or not a number
            return now
        normal, gradient = slope.T @ (slope * weight[:, None]), slope.T @ (weight * now.missed)
        scale = 1 / np.sqrt(np.maximum(np.diag(normal), _LEAST_KNOWN))
        scaled, further = normal * scale * scale[:, None], None
        for _ in range(_DAMPINGS):
            step = scale * np.linalg.solve(scaled + (damping + _RIDGE) * np.eye(len(scale)), -gradient * scale)
            tried = _at(play, play.within(now.numbers + step)) if np.all(np.isfinite(step)) else None
            if tried is not None and tried.cost < now.cost:
                further = tried
                break
            damping = max(damping * 5, 1e-3)
        if further is None:
            return now
        gained, now, damping = now.cost - further.cost, further, damping * 0.2
        if gained < _GAIN:
            return now
    return now
