"""The rest of a shot: where every ball goes from a moment on, how surely, and what will happen with what probability.

While the motion hangs on its start by less than `SENSITIVE` and every course that is probable meets the same things in
the same order, mean and covariance are carried by the exact derivatives of the simulation. Beyond, contacts multiply
errors and courses part: an ensemble, drawn from all that is uncertain, stands for what may happen.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.scene import CUSHIONS, POCKETS
from models.core.typing import FloatArray
from models.estimation.forecast.probability_regions import level_by_neighbours, level_of_normal
from models.estimation.forecast.state_estimate import Outlook
from models.estimation.multiple_shooting.shooting_windows import SENSITIVE
from models.physics.billiards.parameters import CUSHION_LAWS
from models.physics.billiards.simulation.event_engine import BALL, FIRST, HOLE, KIND, LINE, SECOND, SOFT, TIME
from models.physics.billiards.simulation.simulate_shot import Run

Meeting = tuple[str, str, str]
"""Kind (ball, cushion, pocket, rest), ball, and what it meets; nothing for a rest."""

DRAWS = 256
"""Courses of the ensemble: shares are known to 3 %."""
PARTED = 0.01
"""share of courses that may meet other things, below which one order of contacts counts as sure."""
_STEP = 1e-6
"""of the derivatives of what a simulation starts from, which is smooth."""
RARE = 0.02
"""probability below which a meeting is not listed."""


@dataclass(frozen=True, slots=True)
class Foretold:
    """Something that may happen."""

    meeting: Meeting
    probability: float
    t: float
    """s, median of the first time where it happens; the others are its 5 % and 95 % quantiles."""
    t_low: float
    t_high: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """N balls at T moments; M courses."""

    outlook: Outlook
    t: FloatArray
    """(T,) s."""
    path: FloatArray
    """(T, N, 2) m: the course of the mean, then the mean of the courses; NaN where every course has the ball potted."""
    velocity: FloatArray
    """(T, N, 2) m/s."""
    covariance: FloatArray
    """(T, N, 2, 2) m^2."""
    ensemble: NDArray[np.bool_]
    """(T,) whether the ensemble stands for the future there."""
    courses: FloatArray
    """(M, T, N, 2) m; NaN once a ball is potted."""
    foretold: tuple[Foretold, ...]
    """in the order of time."""
    first: tuple[tuple[tuple[Meeting, float], ...], ...]
    """(N,) what each ball meets first, and how probably; the most probable first."""

    @property
    def sigma(self) -> FloatArray:
        """(T, N) m per axis."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=2, axis2=3) / 2), np.float64)

    @property
    def on_table(self) -> FloatArray:
        """(T, N) probability that a ball has not been potted."""
        return np.asarray(np.isfinite(self.courses[..., 0]).mean(axis=0), np.float64)

    def level(self, row: int, ball: int, xy: FloatArray, noise: FloatArray | None = None) -> float:
        """Share of the probability nearer to the middle than `xy` (2,), seen with errors of covariance `noise` (2, 2):
        the region of 90 % holds the places of at most 0.9. NaN where the ball should be in a pocket."""
        if not self.ensemble[row]:
            known = self.covariance[row, ball] + (0.0 if noise is None else noise)
            return level_of_normal(xy - self.path[row, ball], known)
        there = self.courses[:, row, ball]
        return level_by_neighbours(xy, there[np.isfinite(there[:, 0])], noise)


def predict(look: Outlook, t: FloatArray, seed: int = 0, draws: int = DRAWS) -> Prediction:
    """What follows an outlook at moments t (T,) s, ascending and not before it."""
    if len(t) == 0 or np.any(np.diff(t) < 0) or t[0] < look.t - 1e-9:
        raise ValueError(f"moments to predict ascend from {look.t:g} s on; got {t[:3]} ...")
    after = np.maximum(t - look.t, 0.0)
    seconds = float(max(after[-1], 1e-3)) + 1e-6
    central = look.play(look.inputs(look.mean, look.central_law), look.central_law, seconds)
    runs = _drawn(look, seconds, np.random.default_rng(seed), draws)
    states = np.stack([run.at(after) for run in runs])
    places, covariance, sensitive = _linear(look, central, after, seconds)
    order = [_meetings(run) for run in runs]
    parted = np.array([_parting(_meetings(central), other) for other in order])
    until = float(np.quantile(parted, PARTED, method="lower"))
    ensemble = np.asarray(np.maximum.accumulate(sensitive | (after > until)))
    mean, spread = _moments(states[..., :4])
    chosen = ensemble[:, None, None]
    return Prediction(
        look, t, np.where(chosen, mean[..., :2], places[..., :2]), np.where(chosen, mean[..., 2:], places[..., 2:]),
        np.where(chosen[..., None], spread, covariance), ensemble, states[..., :2],
        _foretold(look, order, _rests(look, after, states)),
        tuple(_first(order, ball) for ball in range(len(look.ids))),
    )  # fmt: skip


def drawn_courses(look: Outlook, t: FloatArray, seed: int, draws: int) -> FloatArray:
    """Places (M, T, N, 2) m of courses drawn from all that is uncertain, NaN once a ball is potted; no derivatives are
    needed for them."""
    after = np.maximum(t - look.t, 0.0)
    runs = _drawn(look, float(max(after[-1], 1e-3)) + 1e-6, np.random.default_rng(seed), draws)
    return np.stack([run.at(after)[..., :2] for run in runs])


def _drawn(look: Outlook, seconds: float, rng: np.random.Generator, draws: int) -> list[Run]:
    """Courses from draws of all that is uncertain, the cushion law among it."""
    value, vectors = np.linalg.eigh(look.covariance)
    root = vectors * np.sqrt(np.maximum(value, 0.0))
    laws = rng.choice(len(CUSHION_LAWS), draws, p=look.laws)
    numbers = look.mean + rng.standard_normal((draws, len(value))) @ root.T
    return [
        look.play(look.inputs(one, CUSHION_LAWS[law]), CUSHION_LAWS[law], seconds)
        for one, law in zip(numbers, laws, strict=True)
    ]


def _linear(
    look: Outlook, central: Run, after: FloatArray, seconds: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Places and velocities (T, N, 4), covariance (T, N, 2, 2) of the places, and where (T,) the motion is sensitive.

    The path is the mean over the cushion laws; how they differ adds to what the derivatives carry.
    """
    states = central.at(after)[..., :4]
    by = central.jacobian(after, central.columns)[:, :, :2] @ _slopes(look)
    covariance = by @ look.covariance @ np.swapaxes(by, 2, 3)
    each = np.stack([look.play(look.inputs(look.mean, law), law, seconds).at(after)[..., :4] for law in CUSHION_LAWS])
    path = np.einsum("l,ltnk->tnk", look.laws, each)
    apart = (each - path)[..., :2]
    covariance = covariance + np.einsum("l,ltni,ltnj->tnij", look.laws, apart, apart)
    known = np.nan_to_num(by[..., look.places], nan=0.0)
    size = np.linalg.norm(known, axis=(2, 3), ord=2).max(axis=1, initial=0.0)
    lost = ~np.isfinite(covariance).all(axis=(2, 3)) & np.isfinite(states[..., 0])
    lost |= np.isfinite(path[..., 0]) != np.isfinite(states[..., 0])
    return path, covariance, (size > SENSITIVE) | lost.any(axis=1)


def _slopes(look: Outlook) -> FloatArray:
    """Derivatives (9N + 17, D) of what a simulation starts from."""
    return np.stack(
        [
            (look.inputs(look.mean + step, look.central_law) - look.inputs(look.mean - step, look.central_law))
            / (2 * _STEP)
            for step in _STEP * np.eye(len(look.mean))
        ],
        axis=1,
    )


def _moments(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (T, N, 4), and covariance (T, N, 2, 2) of the places, over courses (M, T, N, 4) that have the ball."""
    there = np.isfinite(states[..., 0])
    count = there.sum(axis=0)
    share = np.where(count > 0, count, np.nan)[..., None]
    mean = np.where(there[..., None], states, 0.0).sum(axis=0) / share
    apart = np.where(there[..., None], states[..., :2] - mean[..., :2], 0.0)
    return mean, np.einsum("mtni,mtnj->tnij", apart, apart) / np.maximum(share - 1, 1.0)[..., None]


def _meetings(run: Run) -> list[list[tuple[float, Meeting]]]:
    """Per ball, what it meets and when, in the order of time; gentle contacts, of balls that lie together, left out."""
    ids = run.balls.ids
    found: list[list[tuple[float, Meeting]]] = [[] for _ in ids]
    sides = {0: run.rails.lines[:, 5], 1: run.rails.arcs[:, 3] if len(run.rails.arcs) else np.empty(0)}
    for event in run.contacts[run.contacts[:, SOFT] == 0]:
        t, kind, a, other = float(event[TIME]), int(event[KIND]), int(event[FIRST]), int(event[SECOND])
        if kind == BALL:
            found[a].append((t, ("ball", ids[a], ids[other])))
            found[other].append((t, ("ball", ids[other], ids[a])))
        elif kind == HOLE:
            found[a].append((t, ("pocket", ids[a], POCKETS[other])))
        else:
            found[a].append((t, ("cushion", ids[a], CUSHIONS[int(sides[int(kind != LINE)][other])])))
    return found


def _parting(one: list[list[tuple[float, Meeting]]], other: list[list[tuple[float, Meeting]]]) -> float:
    """When (s) some ball first meets something in one of two courses that it does not in the other."""
    parted = np.inf
    for a, b in zip(one, other, strict=True):
        for (t, what), (s, instead) in zip(a, b, strict=False):
            if what != instead:
                parted = min(parted, t, s)
                break
        else:
            rest = a[len(b) :] or b[len(a) :]
            if rest:
                parted = min(parted, rest[0][0])
    return parted


def _rests(look: Outlook, after: FloatArray, states: FloatArray) -> dict[Meeting, list[float]]:
    """When (s after the outlook) balls come to rest for good, one time per course where they do; to the next of the
    moments that are asked for."""
    moves = (states[..., 2] != 0) | (states[..., 3] != 0)  # a potted ball, NaN, never rests
    found: dict[Meeting, list[float]] = {}
    for ball, name in enumerate(look.ids):
        moved = moves[..., ball]
        stopped = moved.any(axis=1) & ~moved[:, -1]
        first = moved.shape[1] - np.argmax(moved[stopped][:, ::-1], axis=1)
        if stopped.any():
            found[("rest", name, "")] = after[first].tolist()
    return found


def _foretold(
    look: Outlook, order: list[list[list[tuple[float, Meeting]]]], rests: dict[Meeting, list[float]]
) -> tuple[Foretold, ...]:
    """What happens in at least `RARE` of the courses; two balls are named in the order of the clip."""
    times = dict(rests)
    for course in order:
        seen: dict[Meeting, float] = {}
        for t, what in (meeting for ball in course for meeting in ball):
            kind, a, b = what
            if kind != "ball" or look.ids.index(a) < look.ids.index(b):
                seen.setdefault(what, t)
        for what, t in seen.items():
            times.setdefault(what, []).append(t)
    listed = [
        Foretold(what, len(t) / len(order), *(look.t + float(q) for q in np.quantile(t, (0.5, 0.05, 0.95))))
        for what, t in times.items()
        if len(t) >= RARE * len(order)
    ]
    return tuple(sorted(listed, key=lambda one: one.t))


def _first(order: list[list[list[tuple[float, Meeting]]]], ball: int) -> tuple[tuple[Meeting, float], ...]:
    met = Counter(course[ball][0][1] for course in order if course[ball])
    return tuple((what, count / len(order)) for what, count in met.most_common())
