"""Motion around one moment, with and without a contact of a ball with another one or a cushion.

Both hypotheses share the states of the balls where the window begins, friction and slope. The contact adds its time and
an impulse whose strength and direction follow from the geometry; restitution and friction between the bodies have
priors. All states here are x, y, vx, vy and slip ux, uy: (6,).

This module only predicts motion. `contact_probability.estimate_contact_time` fits it to find the time of a contact,
`contact_probability.evaluate_contact` to find the probability that there was one. Which time a contact gets in the end
is decided in `models.estimation.reconstruction.contact_times`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import SEGMENT_STATE_SIZE, ClothFriction
from models.core.typing import FloatArray
from models.estimation.segmentation.track_segmentation import BallSamples, SegmentFit, fit_segment
from models.physics.billiards.cloth.closed_form_motion import differentiate_kinematics, evaluate_kinematics
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

Complex = NDArray[np.complex128]

# Parameters of a moving ball's state.
STATE_SIZE = 6
# Slope as acceleration x, y while rolling (m/s^2), ln mu_sliding, ln mu_rolling.
SHARED_COUNT = 4
# Time of contact (s), restitution, and the impulse of friction across and up, as shares of the normal one.
CONTACT_COUNT = 4
# Bounds of the logarithms of friction, wider than any cloth: steps of a fit may overshoot.
LOG_RANGE = (-8.0, 1.0)
# Standard deviations: a ball that moved less before the moment in question may have rested.
REST_SIGMAS = 4.0
# m/s: zero slip has no direction, and no derivative that a fit could follow.
MIN_SLIP = 1e-3
# Grid points of the search for the nearest approach, three times.
GRID_POINTS = 41
# Size of the complex step.
_COMPLEX_STEP = 1e-30


@dataclass(frozen=True, slots=True)
class BallWindow:
    """One ball within the window."""

    begin: float
    """s: time of its state; no other contact follows until its last sample."""
    t: FloatArray
    """(n,) s."""
    xy: FloatArray
    """(n, 2) m."""
    sigma: FloatArray
    """(n,) m, one standard deviation per axis."""
    start_state: FloatArray
    """(6,) initial guess of the state where the window begins, from the samples before the moment in question."""
    through_state: FloatArray
    """(6,) the same from all samples, without a contact."""
    rests: bool
    """The ball seems to rest until something meets it: only its place is unknown."""
    rolls: bool = False
    """The ball rolls when its path begins: it has no slip then."""

    @property
    def parameter_count(self) -> int:
        """Number of unknowns of its state."""
        return 2 if self.rests else 4 if self.rolls else STATE_SIZE


# Priors of sliding and rolling friction; standard deviations are those of their logarithms.
ClothPriors = tuple[Prior, Prior]
USUAL_CLOTH: ClothPriors = find_prior("sliding_friction", "mu"), find_prior("rolling_resistance", "mu")


@dataclass(frozen=True, slots=True)
class CushionLine:
    """A straight nose: centres turn where `inward` @ x = `offset`."""

    inward: FloatArray
    """(2,) unit vector into the table."""
    offset: float
    """m."""


@dataclass(frozen=True, slots=True)
class PossibleContact:
    """Balls and, if there is only one, the cushion that it may have met."""

    balls: tuple[BallWindow, ...]
    reach: float
    """m: distance of the centres of two touching balls."""
    reach_sigma: float
    """m, of the reach, or of the contact line of a cushion."""
    cushion: CushionLine | None = None
    cloth: ClothPriors = USUAL_CLOTH
    """What is known about the friction of the cloth."""

    @property
    def begin(self) -> float:
        """Time from which all balls are tracked, s."""
        return max(ball.begin for ball in self.balls)

    @property
    def columns(self) -> tuple[slice, ...]:
        """Columns of each ball's state among the parameters."""
        slices, column = [], 0
        for ball in self.balls:
            slices.append(slice(column, column + ball.parameter_count))
            column = slices[-1].stop
        return tuple(slices)

    @property
    def common_column(self) -> int:
        """First column of the parameters that both hypotheses share beside the states."""
        return sum(ball.parameter_count for ball in self.balls)

    @property
    def contact_column(self) -> int:
        """First column of the parameters of the contact: its time; number of parameters without a contact."""
        return self.common_column + SHARED_COUNT

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return max(float(ball.t[-1]) for ball in self.balls)


@dataclass(frozen=True, slots=True)
class PathPrediction:
    """Prediction of parameters P for K samples."""

    xy: FloatArray
    """(K, 2) m, ball by ball."""
    jacobian: FloatArray
    """(K, 2, P)."""
    gap: float
    """m between the surfaces at the moment of contact, or at the nearest approach of free paths."""
    gap_gradient: FloatArray
    """(P,)"""
    closing: float
    """m/s at that moment, along the normal."""
    closing_gradient: FloatArray
    """(P,)"""
    t: float
    """s: that moment."""


def make_ball_window(
    samples: BallSamples, moment: float, begin: float, known_state: FloatArray | None = None
) -> BallWindow:
    """Make a window around a moment (s) with initial guesses of the state.

    `known_state` (6,) is a rough state at `begin`, if any. Raises ValueError without samples before the moment.
    """
    early = samples.t < moment
    if not early.any():
        raise ValueError(f"a moment at {moment:.4f} s needs samples before it; there are none")
    before = BallSamples(samples.t[early], samples.xy[early], samples.sigma[early])
    start = _guess_state(fit_segment(before, begin)) if known_state is None else _ensure_slip(known_state)
    third = max(len(before.t) // 3, 1)  # means of several samples separate a drift from noise
    drift = float(np.hypot(*(before.xy[-third:].mean(axis=0) - before.xy[:third].mean(axis=0))))
    distance = drift if len(before.t) > 2 else max(drift, float(np.hypot(*start[2:4])) * (moment - begin))
    rests = distance < REST_SIGMAS * float(np.median(samples.sigma))
    if rests:
        start = np.concatenate([before.xy.mean(axis=0), start[2:]])
    return BallWindow(
        begin, samples.t, samples.xy, samples.sigma, start, _guess_state(fit_segment(samples, begin)), rests
    )


def _guess_state(curve: SegmentFit) -> FloatArray:
    """Return the state (6,) at the start of a fitted segment."""
    return _ensure_slip(np.concatenate([curve.x, curve.v, curve.slip]))


def _ensure_slip(state: FloatArray) -> FloatArray:
    """Return the state (6,) with at least a little slip, so that a fit can change it."""
    if np.hypot(*state[4:6]) > MIN_SLIP:
        return state
    return np.concatenate([state[:4], MIN_SLIP * np.ones(2)])


def predict_free_paths(contact: PossibleContact, parameters: FloatArray) -> PathPrediction:
    """Predict the samples without a contact; the gap is not evaluated."""
    runs = [_propagate_ball(contact, parameters, k, ball.t) for k, ball in enumerate(contact.balls)]
    xy, jacobian = (np.concatenate([run[i] for run in runs])[:, :2] for i in (0, 1))
    nothing = np.full(len(parameters), np.nan)
    return PathPrediction(xy, jacobian, np.nan, nothing, np.nan, nothing, np.nan)


def predict_nearest_approach(contact: PossibleContact, parameters: FloatArray) -> PathPrediction:
    """Predict the samples as `predict_free_paths`, with the gap at the nearest approach."""
    free, t = predict_free_paths(contact, parameters), _time_of_nearest_approach(contact, parameters)
    ends = [_propagate_ball(contact, parameters, k, np.array([t])) for k in range(len(contact.balls))]
    return PathPrediction(free.xy, free.jacobian, *_gap_and_closing_speed(contact, ends), t)


def predict_contact_paths(contact: PossibleContact, parameters: FloatArray) -> PathPrediction:
    """Predict the samples with a contact at its time parameter, whether or not the surfaces touch then."""
    moment = contact.contact_column
    t = float(parameters[moment])
    ends = [_propagate_ball(contact, parameters, k, np.array([t]), moment) for k in range(len(contact.balls))]
    after, after_jacobian = _resolve_contact(contact, ends, parameters)
    xy, jacobian = [], []
    for k, ball in enumerate(contact.balls):
        early = ball.t < t
        for run in (
            _propagate_ball(contact, parameters, k, ball.t[early]),
            _propagate_after_contact(contact, parameters, after[k], after_jacobian[k], ball.t[~early] - t),
        ):
            xy.append(run[0][:, :2])
            jacobian.append(run[1][:, :2])
    return PathPrediction(np.concatenate(xy), np.concatenate(jacobian), *_gap_and_closing_speed(contact, ends), t)


def _extract_friction(contact: PossibleContact, parameters: FloatArray) -> ClothFriction:
    """Extract the friction of the cloth from the parameters."""
    sliding, rolling = np.exp(np.clip(parameters[contact.common_column + 2 : contact.contact_column], *LOG_RANGE))
    return ClothFriction(float(sliding), float(rolling))


def _start_states(contact: PossibleContact, parameters: FloatArray, k: int, count: int) -> FloatArray:
    """Return the state (8,) of a moving ball k where its path begins, with the slope, `count` times."""
    own, shared = parameters[contact.columns[k]], contact.common_column
    state = np.concatenate([own, np.zeros(STATE_SIZE - len(own)), parameters[shared : shared + 2]])
    return np.repeat(state[None], count, axis=0)


def _propagate_ball(
    contact: PossibleContact, parameters: FloatArray, k: int, t: FloatArray, moment: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return states (n, 6) of ball k on its free path at t (n,), and derivatives (n, 6, P); t is column `moment`."""
    ball, columns, shared = contact.balls[k], contact.columns[k], contact.common_column
    jacobian = np.zeros((len(t), STATE_SIZE, len(parameters)))
    if ball.rests:
        value = np.zeros((len(t), STATE_SIZE))
        value[:, :2] = parameters[columns]
        jacobian[:, [0, 1], [columns.start, columns.start + 1]] = 1.0
        return value, jacobian
    states = _start_states(contact, parameters, k, len(t))
    value, local = differentiate_kinematics(states, t - ball.begin, _extract_friction(contact, parameters))
    jacobian[:, :, columns] = local[:, :, : ball.parameter_count]
    jacobian[:, :, shared : shared + 2] = local[:, :, STATE_SIZE:SEGMENT_STATE_SIZE]
    jacobian[:, :, shared + 2 : shared + SHARED_COUNT] = local[:, :, SEGMENT_STATE_SIZE + 1 :]
    if moment is not None:
        jacobian[:, :, moment] += local[:, :, SEGMENT_STATE_SIZE]
    return value, jacobian


def _propagate_after_contact(
    contact: PossibleContact, parameters: FloatArray, state: FloatArray, jacobian: FloatArray, tau: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states (n, 6) at tau (n,) after a contact, from `state` (6,) with derivatives (6, P), and theirs."""
    shared = contact.common_column
    states = np.repeat(np.concatenate([state, parameters[shared : shared + 2]])[None], len(tau), axis=0)
    value, local = differentiate_kinematics(states, tau, _extract_friction(contact, parameters))
    grown = local[:, :, :STATE_SIZE] @ jacobian
    grown[:, :, shared : shared + 2] += local[:, :, STATE_SIZE:SEGMENT_STATE_SIZE]
    grown[:, :, shared + 2 : shared + SHARED_COUNT] += local[:, :, SEGMENT_STATE_SIZE + 1 :]
    grown[:, :, shared + SHARED_COUNT] -= local[:, :, SEGMENT_STATE_SIZE]
    return value, grown


def _time_of_nearest_approach(contact: PossibleContact, parameters: FloatArray) -> float:
    """Return the time of the nearest approach on free paths, within the samples, s."""
    first, last = contact.begin, contact.end
    for _ in range(3):
        t = np.linspace(first, last, GRID_POINTS)
        places = [_free_places(contact, parameters, k, t) for k in range(len(contact.balls))]
        least = int(np.argmin(_surface_gaps(contact, *places)))
        first, last = t[max(least - 1, 0)], t[min(least + 1, GRID_POINTS - 1)]
    return float(t[least])


def _free_places(contact: PossibleContact, parameters: FloatArray, k: int, t: FloatArray) -> FloatArray:
    """Return the places (n, 2) of ball k on its free path."""
    ball = contact.balls[k]
    if ball.rests:
        return np.repeat(parameters[contact.columns[k]][None], len(t), axis=0)
    states = _start_states(contact, parameters, k, len(t))
    return evaluate_kinematics(states, t - ball.begin, _extract_friction(contact, parameters))[:, :2]


def _surface_gaps(contact: PossibleContact, *places: FloatArray) -> FloatArray:
    """Return the gaps (n,) of the surfaces for places (n, 2) of each ball."""
    if contact.cushion is not None:
        return places[0] @ contact.cushion.inward - contact.cushion.offset
    gap: FloatArray = np.hypot(*(places[1] - places[0]).T) - contact.reach
    return gap


def _gap_and_closing_speed(
    contact: PossibleContact, ends: list[tuple[FloatArray, FloatArray]]
) -> tuple[float, FloatArray, float, FloatArray]:
    """Return gap and closing speed at one moment, each with its derivatives (P,)."""
    if contact.cushion is not None:
        n, (value, jacobian) = contact.cushion.inward, ends[0]
        gap, closing = float(n @ value[0, :2]) - contact.cushion.offset, -float(n @ value[0, 2:4])
        return gap, n @ jacobian[0, :2], closing, -n @ jacobian[0, 2:4]
    separation, jacobian = ends[1][0][0] - ends[0][0][0], ends[1][1][0] - ends[0][1][0]
    distance = max(float(np.hypot(*separation[:2])), 1e-9)
    n = separation[:2] / distance
    turn = (jacobian[:2] - np.outer(n, n @ jacobian[:2])) / distance  # derivative of the normal
    closing = -float(n @ separation[2:4])
    return distance - contact.reach, n @ jacobian[:2], closing, -(n @ jacobian[2:4] + separation[2:4] @ turn)


def _resolve_contact(
    contact: PossibleContact, ends: list[tuple[FloatArray, FloatArray]], parameters: FloatArray
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the states (6,) of the balls after the contact, and their derivatives (6, P)."""
    first = contact.contact_column + 1
    law = parameters[first : first + CONTACT_COUNT - 1]
    inputs = np.concatenate([*(end[0][0] for end in ends), law])
    count = len(inputs)
    shifted = np.repeat(inputs[None].astype(np.complex128), count, axis=0)
    shifted[np.arange(count), np.arange(count)] += 1j * _COMPLEX_STEP
    out = (_bounce_off_cushion if contact.cushion is not None else _collide_balls)(contact, shifted)  # (inputs, 6 N)
    chosen = np.zeros((len(law), len(parameters)))
    chosen[np.arange(len(law)), first + np.arange(len(law))] = 1.0
    jacobian = (np.imag(out).T / _COMPLEX_STEP) @ np.concatenate([*(end[1][0] for end in ends), chosen])
    return np.split(np.real(out[0]), len(ends)), np.split(jacobian, len(ends))


def _collide_balls(contact: PossibleContact, inputs: Complex) -> Complex:
    """Return the states (M, 12) of two equal balls after a contact, from inputs (M, 15).

    The inputs are the states before, restitution and friction shares. The friction of a ball that rolls into another
    one also turns both about the axis across the line of centres: Alciatore, technical proof A.14.
    """
    a, b, e, across, up = inputs[:, :6], inputs[:, 6:12], inputs[:, 12], inputs[:, 13], inputs[:, 14]
    apart = b[:, :2] - a[:, :2]
    n = apart / np.sqrt(apart[:, :1] ** 2 + apart[:, 1:] ** 2)
    tangent = np.stack([-n[:, 1], n[:, 0]], axis=1)
    normal = (1 + e) / 2 * ((a[:, 2:4] - b[:, 2:4]) * n).sum(axis=1)
    push = normal[:, None] * (n + across[:, None] * tangent)
    spin_change = (2.5 * normal * up)[:, None] * n
    one = np.concatenate([a[:, :2], a[:, 2:4] - push, a[:, 4:6] - push + spin_change], axis=1)
    two = np.concatenate([b[:, :2], b[:, 2:4] + push, b[:, 4:6] + push + spin_change], axis=1)
    return np.concatenate([one, two], axis=1)


def _bounce_off_cushion(contact: PossibleContact, inputs: Complex) -> Complex:
    """Return the states (M, 6) of a ball after a cushion contact.

    The nose takes part of its speed along the nose, and of its spin.
    """
    assert contact.cushion is not None
    n = contact.cushion.inward
    along = np.array([-n[1], n[0]])
    e, across, up = inputs[:, 6], inputs[:, 7], inputs[:, 8]
    into = -(inputs[:, 2:4] @ n)
    push = ((1 + e) * into)[:, None] * (n + across[:, None] * along)
    spin_change = ((1 + e) * into * up)[:, None] * n
    return np.concatenate([inputs[:, :2], inputs[:, 2:4] + push, inputs[:, 4:6] + push + spin_change], axis=1)
