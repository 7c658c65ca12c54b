"""Numbers of the first contact of the cue ball with another ball."""

from __future__ import annotations

from math import erf, sqrt

import numpy as np

from models.core.fit_result import WholeShotSolution
from models.core.scene import Table
from models.core.shot_numbers import SPIN_STATES, ShotNumber, SpinState
from models.core.typing import FloatArray
from models.estimation.joint_fit.segment_prior_residuals import STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import PosteriorView, turn_angle
from models.estimation.shot_numbers.shot_course import FirstMeeting
from models.estimation.shot_numbers.strike_numbers import list_numbers, rolling_share
from models.physics.billiards.cloth.closed_form_motion import GRAVITY, sliding_duration
from models.physics.billiards.parameter_vector import SLIDING_MU
from models.physics.billiards.simulation.event_engine import BALL, EVENT_FIRST, EVENT_KIND, EVENT_SECOND, EVENT_TIME
from models.physics.billiards.simulation.parametrised_shot import ContactModels, convert_to_starts, simulate_start
from models.physics.billiards.simulation.simulated_shot import SimulatedShot

STATE_LIMITS = (-0.1, 0.1, 0.9)
"""Shares of rolling spin between the states. A tenth of the rolling spin turns the final path of the cue ball by less
than 5 degrees in a half-ball hit, which players take for the tangent line, or for natural roll."""
THROW_SIGMA = 3.4
"""Degrees, prior standard deviation of throw: friction 0.06 of clean balls."""
MIN_SPEED = 0.05
"""m/s: below it, a direction after a contact is not observable."""
CONTACT_NUMBERS = (
    ("contact_speed", "m/s"), ("contact_spin_share", ""), ("cut_angle", "deg"), ("throw", "deg"),
    ("object_speed", "m/s"), ("deflection", "deg"),
)  # fmt: skip
"""Names and units, in the order of `evaluate_contact`."""
_VIEW_AFTER = 1.0
"""s after the contact that a simulation lasts: every ball rolls by then."""
_INSTANT = 1e-7
"""s before and after a contact at which its states are taken: a fast ball moves a micrometre in it."""
_MIN_AGREEMENT = 0.95
"""Share of the posterior samples that must meet the ball that was met; else the contact is too thin for them."""


def measure_contact(view: PosteriorView, meeting: FirstMeeting, cue: str, other: str) -> list[ShotNumber]:
    """Measure spin, cut angle, throw, speeds and deflection at the first contact from the paths around it.

    Args:
        view: Joint fit with its covariance.
        meeting: The contact.
        cue: Id of the struck ball.
        other: Id of the ball that it hits.

    Returns:
        The numbers. Angles turn to the right of the player where they are positive.
    """
    graph, k = view.solution.graph, meeting.cue_after
    rolls = graph.start_time(k) + float(sliding_duration(graph.segments[k].state[None], view.solution.friction)[0])
    values, sigmas = view.evaluate(
        lambda x: evaluate_contact(x.reshape(5, 6)),
        view.state_at_end(meeting.cue_before),
        view.state_at_end(meeting.other_before),
        view.state_at_start(k),
        view.state_at_start(meeting.other_after),
        view.state_at_end(k) if rolls >= view.end_time(k) else view.state_at(k, rolls),
    )
    leaves = float(np.hypot(*view.state_at_start(k).value[2:4])) > MIN_SPEED
    return _list_contact(values, sigmas, cue, other, leaves)


def simulate_contact(
    whole: WholeShotSolution, table: Table, seconds: float, cue: str, other: str
) -> list[ShotNumber] | None:
    """Measure the same numbers from posterior samples of a fit of the whole shot, which also knows both friction laws.

    Args:
        whole: The fit.
        table: Dimensions of the table.
        seconds: s from its start to the contact.
        cue: Id of the struck ball.
        other: Id of the ball that it hits.

    Returns:
        The numbers; None if there are no samples, or too many of them miss the ball.
    """
    pair = whole.ids.index(cue), whole.ids.index(other)
    rows = []
    samples = zip(whole.start_samples, whole.parameter_samples, whole.sample_ball_models, strict=True)
    for start, values, ball_model in samples:
        laws = ContactModels(whole.cushion_model, ball_model)
        try:
            shot = simulate_start(start, whole.moving, table, values, laws, seconds + _VIEW_AFTER)
        except ArithmeticError:  # balls that meet without end: no shot
            continue
        states = _states_of_contact(shot, *pair, float(values[SLIDING_MU]))
        if states is not None:
            rows.append(evaluate_contact(states))
    if not rows or len(rows) < _MIN_AGREEMENT * len(whole.start_samples):
        return None
    numbers = np.array(rows)
    middle = np.median(numbers, axis=0)
    angles = [k for k, (_, unit) in enumerate(CONTACT_NUMBERS) if unit == "deg"]
    numbers[:, angles] = middle[angles] + (numbers[:, angles] - middle[angles] + 180.0) % 360.0 - 180.0
    return _list_contact(numbers.mean(axis=0), numbers.std(axis=0, ddof=1), cue, other, True)


def classify_spin(share: ShotNumber) -> tuple[SpinState, tuple[float, ...]]:
    """Classify the spin of the cue ball at its first contact.

    Args:
        share: Its share of rolling spin.

    Returns:
        The most probable state, and the probabilities (4,) of `SPIN_STATES`.
    """
    below = [0.5 * (1 + erf((limit - share.value) / max(share.sigma, 1e-9) / sqrt(2))) for limit in STATE_LIMITS]
    probabilities = np.diff([0.0, *below, 1.0])
    state = SPIN_STATES[int(np.argmax(probabilities))] if share.observable else "unknown"
    return state, tuple(float(p) for p in probabilities)


def evaluate_contact(states: FloatArray) -> FloatArray:
    """Evaluate the numbers of a contact.

    Args:
        states: (5, 6) place, velocity and slip: of the cue ball and the other ball before the contact, of both after
            it, and of the cue ball when it rolls.

    Returns:
        (6,) in the order of `CONTACT_NUMBERS`.
    """
    before, other_before, after, other_after, rolling = states
    line = other_after[:2] - after[:2]
    return np.array(
        [
            np.hypot(*before[2:4]),
            rolling_share(before),
            turn_angle(before[2:4] - other_before[2:4], line),
            turn_angle(line, other_after[2:4] - other_before[2:4]),
            np.hypot(*other_after[2:4]),
            turn_angle(before[2:4], rolling[2:4]),
        ]
    )


def _list_contact(values: FloatArray, sigmas: FloatArray, cue: str, other: str, leaves: bool) -> list[ShotNumber]:
    """List the numbers of a contact, in the order of `CONTACT_NUMBERS`."""
    is_observable = (
        True, sigmas[1] < PRIOR_DOMINATED * STRUCK_SLIP, values[0] > MIN_SPEED,
        sigmas[3] < PRIOR_DOMINATED * THROW_SIGMA, True, leaves,
    )  # fmt: skip
    return list_numbers(CONTACT_NUMBERS, values, sigmas, is_observable, (cue, cue, other, other, other, cue))


def _states_of_contact(shot: SimulatedShot, cue: int, other: int, friction: float) -> FloatArray | None:
    """Return the states (5, 6) around the first contact of the cue ball with a ball; None if it is another ball."""
    own = shot.contacts[(shot.contacts[:, [EVENT_FIRST, EVENT_SECOND]] == cue).any(axis=1)]
    own = own[(own[:, EVENT_KIND] == BALL) | (own[:, EVENT_FIRST] == cue)]
    met = np.flatnonzero(own[:, EVENT_KIND] == BALL)
    if not len(met) or {int(own[met[0], EVENT_FIRST]), int(own[met[0], EVENT_SECOND])} != {cue, other}:
        return None
    t = float(own[met[0], EVENT_TIME])
    later = own[own[:, EVENT_TIME] > t + 2 * _INSTANT, EVENT_TIME]
    next_contact = float(later[0]) if len(later) else shot.seconds

    def states(time: float) -> FloatArray:
        return convert_to_starts(shot.states_at(time), shot.balls.radius)[[cue, other], :6]

    before, after = states(t - _INSTANT), states(t + _INSTANT)
    slide = 2 / 7 * float(np.hypot(*after[0, 4:6])) / (friction * GRAVITY)
    return np.vstack([before, after, states(min(t + slide, next_contact - _INSTANT))[:1]])
