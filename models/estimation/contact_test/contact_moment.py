"""One moment looked at closely: a ball that may have met another one, or a cushion, and what physics makes of either.

Both hypotheses share what moves the balls: their states where the window begins, friction and slope. The contact adds
its time and an impulse whose strength and direction follow from the geometry: restitution and friction between the
bodies are known to the width of their priors. All states here are x, y, vx, vy and slip ux, uy: (6,).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.segmentation.track_segmentation import Samples, SpanStart, fit_span
from models.physics.billiards.cloth.closed_form_motion import STATE, Friction, kinematics, kinematics_jacobian

Complex = NDArray[np.complex128]

PATH = 6
"""Numbers of a moving ball's state."""
SHARED = 4
"""Slope as acceleration x, y while rolling (m/s^2), ln mu_sliding, ln mu_rolling."""
MEETING = 4
"""Time of contact (s), restitution, and the impulse of friction across and up, as shares of the normal one."""
LOG_RANGE = (-8.0, 1.0)
"""of the logarithms of friction, wider than any cloth: steps of a fit may overshoot."""
STILL = 4.0
"""standard deviations: a ball that got no farther before the moment in question may have rested."""
LEAST_SLIP = 1e-3
"""m/s: where slip is nothing at all, it has no direction, and no derivative that a fit could follow."""
FINE = 41
"""Moments among which the nearest one is sought, twice."""
_STEP = 1e-30
"""of the complex step."""


@dataclass(frozen=True, slots=True)
class Watched:
    """One ball within the window."""

    begin: float
    """s: where its state is given; nothing else happens to it from then to its last sample."""
    t: FloatArray
    """(n,) s."""
    xy: FloatArray
    """(n, 2) m."""
    sigma: FloatArray
    """(n,) m, one standard deviation per axis."""
    start: FloatArray
    """(6,) first guess of the state where the window begins, from the samples before the moment in question."""
    through: FloatArray
    """(6,) the same from all samples, as if nothing had been met."""
    rests: bool
    """At rest, as far as is seen, until something meets it: only its place is unknown."""
    rolls: bool = False
    """It is known to roll when its path begins: it has no slip then."""

    @property
    def size(self) -> int:
        """How many numbers of its state are unknown."""
        return 2 if self.rests else 4 if self.rolls else PATH


@dataclass(frozen=True, slots=True)
class Cushion:
    """A straight nose: centres turn where `inward` @ x = `offset`."""

    inward: FloatArray
    """(2,) unit vector into the table."""
    offset: float
    """m."""


@dataclass(frozen=True, slots=True)
class Encounter:
    """Balls and, where there is only one, the cushion that it may have met."""

    balls: tuple[Watched, ...]
    reach: float
    """m: distance of the centres of two touching balls."""
    reach_sigma: float
    """m, of the reach, or of where a cushion stands."""
    cushion: Cushion | None = None

    @property
    def begin(self) -> float:
        """s: from when on all balls are followed."""
        return max(ball.begin for ball in self.balls)

    @property
    def columns(self) -> tuple[slice, ...]:
        """Where the state of each ball stands among the parameters."""
        found, at = [], 0
        for ball in self.balls:
            found.append(slice(at, at + ball.size))
            at = found[-1].stop
        return tuple(found)

    @property
    def shared(self) -> int:
        """First column of what both hypotheses share beside the states; those of the meeting follow."""
        return sum(ball.size for ball in self.balls)


@dataclass(frozen=True, slots=True)
class Paths:
    """What parameters P predict for K samples."""

    xy: FloatArray
    """(K, 2) m, ball by ball."""
    slope: FloatArray
    """(K, 2, P)."""
    gap: float
    """m between the surfaces at the moment of contact, of free paths when they are nearest."""
    gap_slope: FloatArray
    """(P,)"""
    closing: float
    """m/s at that moment, along the normal."""
    closing_slope: FloatArray
    """(P,)"""
    t: float
    """s: that moment."""


def watch(samples: Samples, moment: float, begin: float, told: FloatArray | None = None) -> Watched:
    """A ball around a moment (s), with first guesses of how it moves; ValueError without samples before it.

    `told` is its state (6,) at `begin` where that is known already, roughly.
    """
    early = samples.t < moment
    if not early.any():
        raise ValueError(f"a moment at {moment:.4f} s needs samples before it; there are none")
    before = Samples(samples.t[early], samples.xy[early], samples.sigma[early])
    start = _state(fit_span(before, begin)) if told is None else _slipping(told)
    third = max(len(before.t) // 3, 1)  # means of some samples tell a drift from noise
    drift = float(np.hypot(*(before.xy[-third:].mean(axis=0) - before.xy[:third].mean(axis=0))))
    way = drift if len(before.t) > 2 else max(drift, float(np.hypot(*start[2:4])) * (moment - begin))
    rests = way < STILL * float(np.median(samples.sigma))
    if rests:
        start = np.concatenate([before.xy.mean(axis=0), start[2:]])
    return Watched(begin, samples.t, samples.xy, samples.sigma, start, _state(fit_span(samples, begin)), rests)


def _state(span: SpanStart) -> FloatArray:
    """State (6,) at the start of a span."""
    return _slipping(np.concatenate([span.x, span.v, span.slip]))


def _slipping(state: FloatArray) -> FloatArray:
    """The same state (6,); a ball that rolls gets a slip that a fit can grow."""
    if np.hypot(*state[4:6]) > LEAST_SLIP:
        return state
    return np.concatenate([state[:4], LEAST_SLIP * np.ones(2)])


def free_paths(encounter: Encounter, p: FloatArray) -> Paths:
    """Nothing is met; the gap is not asked for."""
    runs = [_run(encounter, p, k, ball.t) for k, ball in enumerate(encounter.balls)]
    xy, slope = (np.concatenate([run[i] for run in runs])[:, :2] for i in (0, 1))
    nothing = np.full(len(p), np.nan)
    return Paths(xy, slope, np.nan, nothing, np.nan, nothing, np.nan)


def nearest(encounter: Encounter, p: FloatArray) -> Paths:
    """`free_paths` with the gap of the moment at which the bodies are nearest."""
    free, t = free_paths(encounter, p), _nearest(encounter, p)
    ends = [_run(encounter, p, k, np.array([t])) for k in range(len(encounter.balls))]
    return Paths(free.xy, free.slope, *_geometry(encounter, ends), t)


def met_paths(encounter: Encounter, p: FloatArray) -> Paths:
    """The bodies meet at the time among the parameters, whether or not their surfaces are there."""
    moment = encounter.shared + SHARED
    t = float(p[moment])
    ends = [_run(encounter, p, k, np.array([t]), moment) for k in range(len(encounter.balls))]
    after, after_slope = _impact(encounter, ends, p)
    xy, slope = [], []
    for k, ball in enumerate(encounter.balls):
        early = ball.t < t
        for run in (
            _run(encounter, p, k, ball.t[early]),
            _go_on(encounter, p, after[k], after_slope[k], ball.t[~early] - t),
        ):
            xy.append(run[0][:, :2])
            slope.append(run[1][:, :2])
    return Paths(np.concatenate(xy), np.concatenate(slope), *_geometry(encounter, ends), t)


def _friction(encounter: Encounter, p: FloatArray) -> Friction:
    sliding, rolling = np.exp(np.clip(p[encounter.shared + 2 : encounter.shared + SHARED], *LOG_RANGE))
    return Friction(float(sliding), float(rolling))


def _run(
    encounter: Encounter, p: FloatArray, k: int, t: FloatArray, moment: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """States (n, 6) of ball k on its free path at t (n,), and their derivatives (n, 6, P); t is column `moment`."""
    ball, columns, shared = encounter.balls[k], encounter.columns[k], encounter.shared
    slope = np.zeros((len(t), PATH, len(p)))
    if ball.rests:
        value = np.zeros((len(t), PATH))
        value[:, :2] = p[columns]
        slope[:, [0, 1], [columns.start, columns.start + 1]] = 1.0
        return value, slope
    state = np.concatenate([p[columns], np.zeros(PATH - ball.size), p[shared : shared + 2]])
    states = np.repeat(state[None], len(t), axis=0)
    value, local = kinematics_jacobian(states, t - ball.begin, _friction(encounter, p))
    slope[:, :, columns] = local[:, :, : ball.size]
    slope[:, :, shared : shared + 2] = local[:, :, PATH:STATE]
    slope[:, :, shared + 2 : shared + SHARED] = local[:, :, STATE + 1 :]
    if moment is not None:
        slope[:, :, moment] += local[:, :, STATE]
    return value, slope


def _go_on(
    encounter: Encounter, p: FloatArray, state: FloatArray, slope: FloatArray, tau: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """States (n, 6) tau (n,) after a contact left a ball in `state` (6,) with derivatives (6, P), and theirs."""
    shared = encounter.shared
    states = np.repeat(np.concatenate([state, p[shared : shared + 2]])[None], len(tau), axis=0)
    value, local = kinematics_jacobian(states, tau, _friction(encounter, p))
    grown = local[:, :, :PATH] @ slope
    grown[:, :, shared : shared + 2] += local[:, :, PATH:STATE]
    grown[:, :, shared + 2 : shared + SHARED] += local[:, :, STATE + 1 :]
    grown[:, :, shared + SHARED] -= local[:, :, STATE]
    return value, grown


def _nearest(encounter: Encounter, p: FloatArray) -> float:
    """When the bodies are nearest on free paths, within the samples, s."""
    last = max(float(ball.t[-1]) for ball in encounter.balls)
    t = np.linspace(encounter.begin, last, FINE)
    for _ in range(2):
        runs = [_states(encounter, p, k, t) for k in range(len(encounter.balls))]
        gap = _gaps(encounter, *runs)
        least = int(np.argmin(gap))
        t = np.linspace(t[max(least - 1, 0)], t[min(least + 1, FINE - 1)], FINE)
    return float(
        t[int(np.argmin(_gaps(encounter, *[_states(encounter, p, k, t) for k in range(len(encounter.balls))])))]
    )


def _states(encounter: Encounter, p: FloatArray, k: int, t: FloatArray) -> FloatArray:
    """Places (n, 2) of ball k on its free path."""
    ball, shared = encounter.balls[k], encounter.shared
    place = p[encounter.columns[k]]
    if ball.rests:
        return np.repeat(place[None], len(t), axis=0)
    state = np.concatenate([place, np.zeros(PATH - ball.size), p[shared : shared + 2]])
    states = np.repeat(state[None], len(t), axis=0)
    return kinematics(states, t - ball.begin, _friction(encounter, p))[:, :2]


def _gaps(encounter: Encounter, *x: FloatArray) -> FloatArray:
    """Distances (n,) of the surfaces for places (n, 2) of each ball."""
    if encounter.cushion is not None:
        return x[0] @ encounter.cushion.inward - encounter.cushion.offset
    gap: FloatArray = np.hypot(*(x[1] - x[0]).T) - encounter.reach
    return gap


def _geometry(
    encounter: Encounter, ends: list[tuple[FloatArray, FloatArray]]
) -> tuple[float, FloatArray, float, FloatArray]:
    """Gap and closing speed at one moment, each with its derivatives (P,)."""
    if encounter.cushion is not None:
        n, (value, slope) = encounter.cushion.inward, ends[0]
        gap, closing = float(n @ value[0, :2]) - encounter.cushion.offset, -float(n @ value[0, 2:4])
        return gap, n @ slope[0, :2], closing, -n @ slope[0, 2:4]
    apart, slope = ends[1][0][0] - ends[0][0][0], ends[1][1][0] - ends[0][1][0]
    distance = max(float(np.hypot(*apart[:2])), 1e-9)
    n = apart[:2] / distance
    turn = (slope[:2] - np.outer(n, n @ slope[:2])) / distance  # of the normal
    closing = -float(n @ apart[2:4])
    return distance - encounter.reach, n @ slope[:2], closing, -(n @ slope[2:4] + apart[2:4] @ turn)


def _impact(
    encounter: Encounter, ends: list[tuple[FloatArray, FloatArray]], p: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """States (6,) of the balls after the contact, and their derivatives (6, P)."""
    first = encounter.shared + SHARED + 1
    law = p[first : first + MEETING - 1]
    inputs = np.concatenate([*(end[0][0] for end in ends), law])
    count = len(inputs)
    shifted = np.repeat(inputs[None].astype(np.complex128), count, axis=0)
    shifted[np.arange(count), np.arange(count)] += 1j * _STEP
    out = (_bounce if encounter.cushion is not None else _collide)(encounter, shifted)  # (inputs, 6 N)
    chosen = np.zeros((len(law), len(p)))
    chosen[np.arange(len(law)), first + np.arange(len(law))] = 1.0
    slope = (np.imag(out).T / _STEP) @ np.concatenate([*(end[1][0] for end in ends), chosen])
    value = np.real(out[0])
    balls = range(len(ends))
    return [value[PATH * k : PATH * k + PATH] for k in balls], [slope[PATH * k : PATH * k + PATH] for k in balls]


def _collide(encounter: Encounter, inputs: Complex) -> Complex:
    """States (M, 12) of two equal balls after they met, of states before, restitution and shares of friction.

    The friction of a ball that rolls into another one also turns both about the axis across the line of centres:
    Alciatore, technical proof A.14.
    """
    a, b, e, across, up = inputs[:, :6], inputs[:, 6:12], inputs[:, 12], inputs[:, 13], inputs[:, 14]
    apart = b[:, :2] - a[:, :2]
    n = apart / np.sqrt(apart[:, :1] ** 2 + apart[:, 1:] ** 2)
    left = np.stack([-n[:, 1], n[:, 0]], axis=1)
    normal = (1 + e) / 2 * ((a[:, 2:4] - b[:, 2:4]) * n).sum(axis=1)
    push = normal[:, None] * (n + across[:, None] * left)
    spun = (2.5 * normal * up)[:, None] * n
    one = np.concatenate([a[:, :2], a[:, 2:4] - push, a[:, 4:6] - push + spun], axis=1)
    two = np.concatenate([b[:, :2], b[:, 2:4] + push, b[:, 4:6] + push + spun], axis=1)
    return np.concatenate([one, two], axis=1)


def _bounce(encounter: Encounter, inputs: Complex) -> Complex:
    """States (M, 6) of a ball after it met a cushion; the nose takes part of its speed along it, and of its spin."""
    assert encounter.cushion is not None
    n = encounter.cushion.inward
    along = np.array([-n[1], n[0]])
    e, across, up = inputs[:, 6], inputs[:, 7], inputs[:, 8]
    into = -(inputs[:, 2:4] @ n)
    push = ((1 + e) * into)[:, None] * (n + across[:, None] * along)
    spun = ((1 + e) * into * up)[:, None] * n
    return np.concatenate([inputs[:, :2], inputs[:, 2:4] + push, inputs[:, 4:6] + push + spun], axis=1)
