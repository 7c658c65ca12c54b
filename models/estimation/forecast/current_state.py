"""What is known of a shot at a moment, from the joint fit of what was seen until then.

The errors of speeds and of friction, which a prediction adds up, keep their correlation. What no picture tells has an
honest spread instead: spin about the vertical, the level of the table, the friction of cushions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.errors import TrackError
from models.core.fit_result import Trust
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.state_estimate import NOSE_FRICTION, PER_BALL, SHARED, Outlook, law_probabilities
from models.estimation.joint_fit.fit_solution import Data, Solution, gather, layout, owners, residuals
from models.estimation.joint_fit.joint_refinement import HUBER
from models.estimation.joint_fit.physics_priors import (
    BALL_RESTITUTION,
    DIAMETER_SIGMA,
    NOSE_SCATTER,
    NOSE_SIGMA,
    ROLLING_PRIOR,
    RUBBER_SIGMA,
    SLIDING_PRIOR,
)
from models.estimation.multiple_shooting.lack_of_fit import correlation_factor
from models.estimation.reconstruction.fit_shot import fit_and_solution
from models.estimation.segmentation.contact_graph import Span
from models.estimation.whole_shot.free_paths import PIECE, ROLLING_SHARE, SLOPE, UNEVENNESS
from models.physics.billiards.cloth.closed_form_motion import GRAVITY, STATE, kinematics_jacobian
from models.tracking.track_noise import estimate_noise, with_noise

FEWEST = 5
"""pictures that speeds can be told from."""
NOISY_FROM = 0.1
"""m/s: balls that move faster tell the noise."""
WORST_FIT = 30.0
"""factor on variances beyond which a fit is no worse, only wrong."""
SIDE_SPIN = 0.5
"""standard deviation of the surface speed of side spin after a contact, over the speed of the ball: a nose that sticks
gives 5/7 of the speed along it, a cue up to 5/4."""
LEAST_SIDE_SPIN = 0.05
"""the same, however long ago."""
DECAY, DECAY_SIGMA = 10.0, 0.4
"""rad/s^2, and of its logarithm."""
RETURN_SCATTER = 0.075
"""of the restitution: what real cushions add to every law, 5 % of the speed, and what scatter of the spin, 12 %, comes
to once the ball rolls."""
NOSE_FRICTION_SIGMA = 0.4
"""of its logarithm (Marlow 1995: 0.14 to 0.2)."""


def outlook_at(tracks: Tracks, scene: Scene, t: float) -> Outlook:
    """What was known at t (s): only what was seen until then is fitted. TrackError where that tells nothing."""
    seen = tracks.until(t)
    if len(seen.t) < FEWEST:
        raise TrackError(f"{len(seen.t)} pictures were seen until {t:g} s; a prediction needs at least {FEWEST}")
    fit, solution = fit_and_solution(seen, scene)
    if solution is None:
        raise TrackError(f"physics could not be fitted to what was seen until {t:g} s; {fit.trust.reasons[0]}")
    measured = with_noise(seen, estimate_noise(seen, NOISY_FROM, scene.table.ball_radius))
    inflation = lack_of_fit(solution, gather(measured))
    events = fit.events
    gone = {a for a, kind in zip(events.a, events.kind, strict=True) if kind == "pocket"}
    return outlook(solution, seen.ids, t, scene.table, gone, fit.trust, inflation)


def lack_of_fit(solution: Solution, data: Data) -> float:
    """>= 1: factor on variances for residuals of moving balls that are larger than the noise, or alike for a while.

    Balls that were seen too seldom to be in the story say nothing.
    """
    told = [ball for ball in np.unique(data.ball) if solution.story.of_ball(int(ball))]
    rows = np.isin(data.ball, told)
    data = Data(data.ball[rows], data.t[rows], data.xy[rows], data.whiten[rows])
    owner, miss = owners(solution.story, data), residuals(solution, data)
    whitened = np.einsum("kij,kj->ki", data.whiten, miss)
    size = np.linalg.norm(whitened, axis=1, keepdims=True)
    bounded = whitened * np.minimum(1.0, HUBER / np.maximum(size, 1e-12))
    series = [bounded[owner == k] for k, span in enumerate(solution.story.spans) if not span.static]
    free = sum(min(one.size, 5) for one in series)
    count = sum(one.size for one in series)
    if count <= free:
        return 1.0
    chi2 = sum(float((one**2).sum()) for one in series) / (count - free)
    return float(np.clip(chi2 * correlation_factor(series), 1.0, WORST_FIT))


def outlook(
    solution: Solution,
    ids: tuple[str, ...],
    t: float,
    table: Table,
    gone: set[str],
    trust: Trust,
    inflation: float = 1.0,
) -> Outlook:
    """What a fit of everything up to t (s) knows then; `gone` balls have been potted; `inflation` of its variances."""
    shift, covariance = _levelled(replace(solution, covariance=_inflated(solution, inflation)))
    story = solution.story
    balls = [k for k, name in enumerate(ids) if name not in gone and story.of_ball(k)]
    size = PER_BALL * len(balls) + SHARED
    mean, by = np.zeros(size), np.zeros((size, len(covariance)))
    side = np.zeros(size)
    moving = np.zeros(len(balls), bool)
    for row, ball in enumerate(balls):
        span = story.of_ball(ball)[-1]
        here = slice(PER_BALL * row, PER_BALL * row + 6)
        mean[here], by[here], moving[row] = _state(solution, span, t, len(covariance))
        if moving[row]:
            side[PER_BALL * row + 6] = _side_spin(story.spans[span], t - story.begin(span), table.ball_radius)
    _shared(solution, mean, by)
    known = by @ covariance @ by.T + np.diag(side**2)
    known[np.diag_indices(SHARED)[0] - SHARED, np.diag_indices(SHARED)[1] - SHARED] += _unseen()
    names = tuple(ids[k] for k in balls)
    grip = layout(story).globals + 9
    laws = law_probabilities(float(solution.rubber[2] + shift[grip]), float(np.sqrt(covariance[grip, grip])))
    return Outlook(t, names, table, mean + by @ shift, (known + known.T) / 2, moving, trust, laws)


def _inflated(solution: Solution, factor: float) -> FloatArray:
    """The covariance of a fit times a factor, but what is known beforehand of what all share is not forgotten."""
    covariance = factor * solution.covariance
    first = layout(solution.story).globals
    prior = np.array([SLIDING_PRIOR[1], ROLLING_PRIOR[1], DIAMETER_SIGMA, *[NOSE_SIGMA] * 4, *RUBBER_SIGMA])
    known = covariance[first:, first:] + np.diag(prior**2)
    if factor > 1:
        covariance = covariance - covariance[:, first:] @ np.linalg.solve(known, covariance[first:])
    return np.asarray(covariance, np.float64)


def _levelled(solution: Solution) -> tuple[FloatArray, FloatArray]:
    """How the numbers of a fit move (P + 2,), and their covariance (P + 2, P + 2) with two more for the slope of the
    table (m/s^2): the extra accelerations of all spans are one slope, but for an uneven cloth."""
    plan, story = layout(solution.story), solution.story
    covariance = np.zeros((plan.size + 2, plan.size + 2))
    covariance[:-2, :-2] = solution.covariance
    covariance[-2:, -2:] = np.eye(2) * (SLOPE * _per_slope()) ** 2
    moving = [k for k, span in enumerate(story.spans) if not span.static]
    if not moving:
        return np.zeros(plan.size + 2), covariance
    tied = np.zeros((2 * len(moving), plan.size + 2))
    for row, k in enumerate(moving):
        for axis in range(2):
            tied[2 * row + axis, plan.span[k] + 6 + axis] = 1.0
            tied[2 * row + axis, plan.size + axis] = -1.0
    apart = np.concatenate([story.spans[k].state[6:8] for k in moving])
    gain = np.linalg.solve(tied @ covariance @ tied.T + UNEVENNESS**2 * np.eye(len(tied)), tied @ covariance).T
    return -gain @ apart, covariance - gain @ tied @ covariance


def _per_slope() -> float:
    """m/s^2 that a rolling ball feels of a slope of 1 mm/m."""
    return ROLLING_SHARE * GRAVITY * 1e-3


def _state(solution: Solution, span: int, t: float, columns: int) -> tuple[FloatArray, FloatArray, bool]:
    """Place, velocity and slip (6,) of a ball at t, their derivatives (6, columns), and whether it moves."""
    plan, described = layout(solution.story), solution.story.spans[span]
    first, by = int(plan.span[span]), np.zeros((6, columns))
    if described.static:
        by[[0, 1], [first, first + 1]] = 1.0
        return np.concatenate([described.state[:2], np.zeros(4)]), by, False
    tau = np.array([max(t - solution.story.begin(span), 0.0)])
    value, slope = kinematics_jacobian(described.state[None], tau, solution.friction)
    by[:, first : first + STATE] = slope[0, :, :STATE]
    by[:, plan.globals : plan.globals + 2] = slope[0, :, STATE + 1 :]
    if described.start is not None:
        by[:, plan.contact + described.start] = -slope[0, :, STATE]
    return value[0], by, bool(np.hypot(*value[0, 2:4]) > 0)


def _side_spin(span: Span, since: float, radius: float) -> float:
    """Standard deviation of the surface speed of side spin, m/s, some time after a contact."""
    speed = float(np.hypot(*span.state[2:4]))
    return max(SIDE_SPIN * speed - DECAY * radius * since, LEAST_SIDE_SPIN * speed)


def _shared(solution: Solution, mean: FloatArray, by: FloatArray) -> None:
    """Fill in what all balls share."""
    plan = layout(solution.story)
    friction = solution.friction
    mean[-SHARED:] = [
        np.log(friction.sliding), np.log(friction.rolling), 0.0, 0.0, solution.diameter, *solution.nose,
        *solution.rubber[:2], BALL_RESTITUTION[0], np.log(NOSE_FRICTION), np.log(DECAY),
    ]  # fmt: skip
    first = len(mean) - SHARED
    for row, column in ((0, 0), (1, 1), *((4 + k, 2 + k) for k in range(7))):
        by[first + row, plan.globals + column] = 1.0
    by[first + 2, -2] = by[first + 3, -1] = 1 / _per_slope()


def _unseen() -> FloatArray:
    """(SHARED,) variances of what the fit says nothing of."""
    variance = np.zeros(SHARED)
    # what short stretches of an uneven cloth come to over a second, as one slope
    variance[2:4] = 4 / 3 * PIECE * (UNEVENNESS / _per_slope()) ** 2
    variance[5:9] = NOSE_SCATTER**2
    variance[9] = RETURN_SCATTER**2
    variance[11:] = BALL_RESTITUTION[1] ** 2, NOSE_FRICTION_SIGMA**2, DECAY_SIGMA**2
    return variance
