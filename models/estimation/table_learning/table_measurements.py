"""What a learned table does, in numbers that can be measured again: slope, restitution, speed of the cloth, sizes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import JointSolution
from models.core.errors import TrackError
from models.core.fit_result import Parameter
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import BoolArray, FloatArray
from models.estimation.table_learning.cushion_contacts import extract_cushion_contacts, join_contacts
from models.estimation.table_learning.learn_table import TableLesson, fit_cloth
from models.estimation.table_learning.learned_table import LearnedTable, rebound_rolling_balls
from models.estimation.table_learning.side_spin import filter_side_spin, predict_rebounds
from models.physics.billiards.parameter_vector import SPIN_DECAY

# m/s: restitution is that of a ball which rolls at this speed straight at a cushion.
TEST_SPEED = 1.0
# m/s, at which a ball begins to roll out.
ROLL_OUT_SPEED = 2.0
# Contacts from which the restitution of one cushion is stated: fewer give no scatter.
MIN_CONTACTS_PER_CUSHION = 3
# Shots from which their scatter is stated.
MIN_SHOTS_OF_SCATTER = 3
# Robust standard deviations beyond which a contact is cut wrongly (near a jaw, or two contacts in one frame).
OUTLIER_SCATTERS = 4.0
# Added to variances, in the squared unit of the values: an error of zero has no weight.
_LEAST_VARIANCE = 1e-12
# Relative step of numerical derivatives.
_STEP = 1e-3


@dataclass(frozen=True, slots=True)
class TableMeasurement:
    """A number of a certificate."""

    name: str
    value: float
    sigma: float
    """Standard deviation of `value`, with the scatter between shots; infinite where the shots do not determine it."""
    unit: str
    count: int
    """Number of contacts or shots behind it."""


@dataclass(frozen=True, slots=True)
class ContactMeasurement:
    """Restitution of K cushion contacts."""

    shot: FloatArray
    """(K,) number of the shot."""
    side: FloatArray
    """(K,) index in `CUSHIONS`."""
    speed: FloatArray
    """(K,) m/s, into the cushion."""
    restitution: FloatArray
    """(K,) speed out of the cushion over that into it."""
    excess: FloatArray
    """(K,) restitution minus that of the learned model for the same contact."""
    sigma: FloatArray
    """(K,) standard deviation of `excess`, from the paths."""


@dataclass(frozen=True, slots=True)
class MeasuredTable:
    """All numbers of a table, and what they rest on."""

    measurements: tuple[TableMeasurement, ...]
    repeatability: tuple[TableMeasurement, ...]
    """Standard deviations of one shot about the mean of all, without measurement errors; `sigma` is their own error."""
    contacts: ContactMeasurement
    rolling_by_shot: FloatArray
    """(N, 2) roll-out length from each of N shots alone and its standard deviation, m; NaN where it tells nothing."""


def measure_table(lesson: TableLesson, shots: list[tuple[JointSolution, Tracks]], table: Table) -> MeasuredTable:
    """Measure a table that was learned from shots.

    Args:
        lesson: The learned table.
        shots: Joint fit and tracks of each shot that it was learned from.
        table: Dimensions of the table.

    Returns:
        Its numbers. The error of each contains the scatter between shots, over the root of their number.
    """
    contacts = measure_contacts(lesson.table, [solution for solution, _ in shots], table)
    rolls = [_measure_shot_cloth(shot, table) for shot in shots]
    by_shot = np.array([one["roll_out"] for one in rolls])
    cloth, repeatability = _measure_cloth(lesson, rolls)
    scatter = _scatter_between(*_average_excess_by_shot(contacts))
    restitution = _measure_restitution(lesson.table, contacts, 0.0 if scatter is None else scatter[0], table)
    if scatter is not None:
        repeatability.append(TableMeasurement("restitution", *scatter, "", len(np.unique(contacts.shot))))
    sizes = _measure_sizes(lesson.table, table, contacts)
    return MeasuredTable((*cloth, *restitution, *sizes), tuple(repeatability), contacts, by_shot)


def measure_contacts(learned: LearnedTable, solutions: list[JointSolution], table: Table) -> ContactMeasurement:
    """Measure the restitution of every cushion contact beside that of the learned model.

    Args:
        learned: The learned table.
        solutions: Joint fit of each shot.
        table: Dimensions of the table.

    Returns:
        The contacts, without those that deviate by more than `OUTLIER_SCATTERS` robust standard deviations.
    """
    contacts = join_contacts(extract_cushion_contacts(solution, table, k)[0] for k, solution in enumerate(solutions))
    size = table.ball_radius, table.ball_mass
    rebounds = predict_rebounds(contacts, learned.law_code, learned.physics, *size, learned.correction)
    spins = filter_side_spin(contacts, rebounds, size[0], learned.scatter, float(learned.physics[SPIN_DECAY]))
    into = contacts.before[:, 0]
    excess = -spins.deviation[:, 0] * contacts.speed / into
    slope = -rebounds.by_before[:, 0, 0] + contacts.after[:, 0] / into  # of the excess by the speed into the cushion
    covariance = contacts.covariance[:, [0, 4]][:, :, [0, 4]]
    gradient = np.stack([slope, np.full(len(into), -1.0)], axis=1) / into[:, None]
    sigma = np.sqrt(np.maximum(np.einsum("ki,kij,kj->k", gradient, covariance, gradient), 0.0))
    middle = float(np.median(excess))
    width = 1.4826 * float(np.median(np.abs(excess - middle)))
    keep = np.abs(excess - middle) <= OUTLIER_SCATTERS * np.hypot(width, sigma)
    rows = (contacts.shot, contacts.side, into, -contacts.after[:, 0] / into, excess, sigma)
    return ContactMeasurement(*(np.asarray(one[keep], np.float64) for one in rows))


def compute_roll_out(rolling: float, drag: float, speed: float) -> float:
    """Compute how far a rolling ball comes, m.

    Args:
        rolling: Coefficient of rolling resistance.
        drag: Viscous drag, 1/s.
        speed: Speed at the start, m/s.

    Returns:
        The length.
    """
    brake = rolling * GRAVITY
    share = drag * speed / brake
    if share < 1e-6:
        return speed**2 / (2 * brake)
    return speed / drag - brake / drag**2 * math.log1p(share)


def _measure_cloth(
    lesson: TableLesson, rolls: list[dict[str, tuple[float, float]]]
) -> tuple[list[TableMeasurement], list[TableMeasurement]]:
    """Return the numbers of the cloth, and their scatter between shots."""
    values = _derive_cloth(lesson.parameters, lesson.cloth_covariance)
    prior_only = {one.name for one in lesson.parameters if one.prior_only}
    measurements, repeatability = [], []
    for name, unit, source in _CLOTH_NUMBERS:
        value, sigma = values[name]
        own = [roll[name] for roll in rolls if np.isfinite(roll[name]).all()]
        scatter = _scatter_between(*np.array(own).T) if len(own) > 1 else None
        if scatter is not None:
            sigma = math.hypot(sigma, scatter[0] / math.sqrt(len(own)))
            repeatability.append(TableMeasurement(name, *scatter, unit, len(own)))
        sigma = math.inf if source in prior_only else sigma
        measurements.append(TableMeasurement(name, value, sigma, unit, len(rolls)))
    return measurements, repeatability


# Name, unit and parameter of each number of the cloth.
_CLOTH_NUMBERS = (
    ("slope_x", "mm/m", "slope.slope_x"), ("slope_y", "mm/m", "slope.slope_y"),
    ("roll_out", "m", "rolling_resistance.mu"), ("rolling_friction", "", "rolling_resistance.mu"),
    ("sliding_friction", "", "sliding_friction.mu"),
)  # fmt: skip


def _derive_cloth(parameters: tuple[Parameter, ...], covariance: FloatArray) -> dict[str, tuple[float, float]]:
    """Derive the numbers of the cloth, each with its standard deviation, from its parameters; these come first."""
    at = {one.name: k for k, one in enumerate(parameters)}
    sources = {name: at[source] for name, _, source in _CLOTH_NUMBERS}
    derived = {name: (parameters[k].value, math.sqrt(covariance[k, k])) for name, k in sources.items()}
    pair = [at["rolling_resistance.mu"], at["viscous_drag.k"]]
    mu, k = parameters[pair[0]].value, max(parameters[pair[1]].value, 0.0)
    steps = _STEP * np.array([mu, max(k, 0.01)])
    length = compute_roll_out(mu, k, ROLL_OUT_SPEED)
    longer = (compute_roll_out(mu + a, k + b, ROLL_OUT_SPEED) for a, b in np.diag(steps))
    gradient = (np.array(list(longer)) - length) / steps
    derived["roll_out"] = length, math.sqrt(max(float(gradient @ covariance[np.ix_(pair, pair)] @ gradient), 0.0))
    # what a roll-out at this speed makes of friction alone, so that drag and friction are not told apart
    friction = ROLL_OUT_SPEED**2 / (2 * GRAVITY * length)
    derived["rolling_friction"] = friction, friction * derived["roll_out"][1] / length
    return derived


def _measure_shot_cloth(shot: tuple[JointSolution, Tracks], table: Table) -> dict[str, tuple[float, float]]:
    """Measure the cloth from one shot alone; NaN where it does not determine a number."""
    unknown = {name: (math.nan, math.nan) for name, _, _ in _CLOTH_NUMBERS}
    try:
        parameters, covariance = fit_cloth([shot], table)
    except (TrackError, ArithmeticError, ValueError):
        return unknown
    if not parameters:
        return unknown
    derived = _derive_cloth(parameters, covariance)
    prior_only = {one.name for one in parameters if one.prior_only}
    return {name: unknown[name] if source in prior_only else derived[name] for name, _, source in _CLOTH_NUMBERS}


def _measure_restitution(
    learned: LearnedTable, contacts: ContactMeasurement, between: float, table: Table
) -> list[TableMeasurement]:
    """Return the restitution of the test ball, of all cushions and of each; `between` is the scatter between shots."""
    test, model_sigma = _evaluate_test_ball(learned, table)

    def measure(name: str, own: BoolArray) -> TableMeasurement:
        mean, sigma = _average_excess(contacts, own)
        between_own = between / math.sqrt(max(len(np.unique(contacts.shot[own])), 1))
        sigma = math.hypot(math.hypot(sigma, model_sigma), between_own)
        return TableMeasurement(name, test + mean, sigma, "", int(own.sum()))

    rows = [measure("restitution", np.ones(len(contacts.excess), np.bool_))]
    for k, side in enumerate(CUSHIONS):
        own, name = contacts.side == k, f"restitution_{side}"
        unknown = TableMeasurement(name, math.nan, math.inf, "", int(own.sum()))
        rows.append(unknown if unknown.count < MIN_CONTACTS_PER_CUSHION else measure(name, own))
    return rows


def _evaluate_test_ball(learned: LearnedTable, table: Table) -> tuple[float, float]:
    """Return the restitution of the test ball by the learned model, and its standard deviation."""
    one, zero = np.array([TEST_SPEED]), np.zeros(1)

    def evaluate(model: LearnedTable) -> float:
        after = rebound_rolling_balls(model, one, zero, zero, table.ball_radius, table.ball_mass)
        return -float(after[0, 0]) / TEST_SPEED

    value, gradient = evaluate(learned), []
    for k in learned.uncertain:
        physics = learned.physics.copy()
        step = _STEP * max(abs(physics[k]), 0.1)
        physics[k] += step
        gradient.append((evaluate(replace(learned, physics=physics)) - value) / step)
    slopes = np.array(gradient)
    return value, math.sqrt(max(float(slopes @ learned.covariance @ slopes), 0.0)) if len(slopes) else 0.0


def _average_excess(contacts: ContactMeasurement, rows: BoolArray) -> tuple[float, float]:
    """Return the mean excess of contacts and its standard deviation, by their errors and the scatter of all."""
    weight = 1 / (contacts.sigma[rows] ** 2 + _variance_between(contacts.excess, contacts.sigma))
    return float(weight @ contacts.excess[rows] / weight.sum()), float(1 / math.sqrt(weight.sum()))


def _average_excess_by_shot(contacts: ContactMeasurement) -> tuple[FloatArray, FloatArray]:
    """Return the mean excess (n,) of each shot, and its standard deviation (n,) by the contacts of all shots."""
    rows = [_average_excess(contacts, contacts.shot == shot) for shot in np.unique(contacts.shot)]
    table = np.array(rows).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _scatter_between(values: FloatArray, sigmas: FloatArray) -> tuple[float, float] | None:
    """Return the standard deviation of values (n,) beyond their errors, and its own error; None for too few."""
    if len(values) < MIN_SHOTS_OF_SCATTER:
        return None
    variance = _variance_between(values, sigmas)
    total = variance + float(np.median(sigmas**2))
    return math.sqrt(variance), math.sqrt(total / (2 * (len(values) - 1)))


def _variance_between(values: FloatArray, sigmas: FloatArray) -> float:
    """Return the variance of values (n,) beyond their errors (DerSimonian and Laird 1986)."""
    if len(values) < 2:
        return 0.0
    weight = 1 / (sigmas**2 + _LEAST_VARIANCE)
    mean = float(weight @ values / weight.sum())
    excess = float(weight @ (values - mean) ** 2) - (len(values) - 1)
    return max(excess / float(weight.sum() - weight @ weight / weight.sum()), 0.0)


def _measure_sizes(learned: LearnedTable, table: Table, contacts: ContactMeasurement) -> list[TableMeasurement]:
    """Return length and width between the noses as the balls met them, on the scale of the calibration."""
    rows = []
    for name, nominal, sides in (("length", table.length, (0, 1)), ("width", table.width, (2, 3))):
        count = int(np.isin(contacts.side, sides).sum())
        is_met = all((contacts.side == side).any() for side in sides)
        value = nominal - float(learned.noses[list(sides)].sum())
        variance = float(learned.nose_covariance[np.ix_(sides, sides)].sum())
        rows.append(TableMeasurement(name, value, math.sqrt(variance) if is_met else math.inf, "m", count))
    return rows
