"""The force that a model lacks: its acceleration on short pieces of motion, what it varies with, and its formula.

Such a force bends the residuals of a path: their second derivative is the acceleration that it causes, whatever its
law. It is measured piece by piece with a parabola, on pieces without a contact, with an error that follows from the
noise alone. Every law is judged on shots that it was not fitted to, so that a flexible curve has no advantage over a
short formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from diagnosis.fitting.diagnosis_windows import MIN_ROWS
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.gap_scene import ContactRichScene, Covariates

# Number of pieces of a window; their length is limited by the next two.
_PIECES = 4
# Least and largest number of rows of a piece: a parabola leaves six degrees of freedom of the least.
_MIN_PIECE_ROWS, _MAX_PIECE_ROWS = 9, 30
# Phases in which a residual is no measure of a force: an impulse acts, or nothing moves.
_CONTACT_PHASES = ("ball_contact", "cushion_contact", "wall_contact", "rest")


@dataclass(frozen=True, slots=True)
class ExcessAcceleration:
    """Acceleration that a model lacks, in M pieces of motion with D coordinates."""

    values: FloatArray
    """(M, D) in the unit of the scene per s^2."""
    sigma: FloatArray
    """(M,) standard deviation of each coordinate, from the noise alone."""
    shot: IntArray
    """(M,) index of the shot."""
    t: FloatArray
    """(M,) s since the start of the shot."""
    position: FloatArray
    """(M, D) in the unit of the scene."""
    velocity: FloatArray
    """(M, D) in the unit of the scene per s."""

    @property
    def speed(self) -> FloatArray:
        """(M,) in the unit of the scene per s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def select(self, chosen: BoolArray) -> ExcessAcceleration:
        """Return the chosen (M,) pieces."""
        return ExcessAcceleration(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def project(self, directions: FloatArray) -> FloatArray:
        """Return the components (M,) along unit vectors (M, D)."""
        return np.asarray((self.values * directions).sum(axis=1))


def measure_excess_acceleration(problem: DiagnosisProblem, fitted: EffectFit) -> ExcessAcceleration:
    """Measure the acceleration that the model of a fit lacks.

    Args:
        problem: Scene and noise.
        fitted: The fit.

    Returns:
        Accelerations of all pieces; none where every window is too short.
    """
    fitted = fit_pieces(problem, fitted)
    correlated = np.sqrt((1 + problem.correlation) / (1 - problem.correlation))
    rows: list[tuple[FloatArray, float, int, float, FloatArray, FloatArray]] = []
    for segment, start in zip(fitted.segments, fitted.starts, strict=True):
        path = problem.scene.predict_positions(segment, start, fitted.shared, fitted.forms)
        covariates = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
        rows += _measure_pieces(segment, path, covariates, float(correlated))
    values, sigma, shot, t, position, velocity = (
        zip(*rows, strict=True) if rows else (np.empty((0, 1)), (), (), (), np.empty((0, 1)), np.empty((0, 1)))
    )
    return ExcessAcceleration(
        np.array(values), np.array(sigma), np.array(shot, np.int64), np.array(t), np.array(position), np.array(velocity)
    )


def fit_pieces(problem: DiagnosisProblem, fitted: EffectFit) -> EffectFit:
    """Fit the start states of short pieces of the windows of a fit, so that every path stays near its observations.

    A force that pulls back changes the residuals of a long path. In a contact-rich scene, hidden spin forbids it.

    Args:
        problem: Scene and noise.
        fitted: The fit.

    Returns:
        The fit on pieces; the same one in a contact-rich scene, or where every window is too short.
    """
    if isinstance(problem.scene, ContactRichScene):
        return fitted
    pieces = tuple(
        piece
        for segment, start in zip(fitted.segments, fitted.starts, strict=True)
        for piece in _cut_pieces(segment, _find_contact_rows(problem, segment, start, fitted))
    )
    return fit_start_states(problem, pieces, fitted) if pieces else fitted


def _find_contact_rows(
    problem: DiagnosisProblem, segment: Recording, start: FloatArray, fitted: EffectFit
) -> list[int]:
    """Find the rows of a segment before which a body meets a wall, in order."""
    since = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms).since_contact
    rows, bodies = np.nonzero(segment.is_observed)
    contact_rows: set[int] = set()
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        last = np.nan_to_num(segment.t[rows[own]] - since[own], nan=-np.inf)
        contact_rows.update(int(row) for row in rows[own[1:]][last[1:] > last[:-1] + 1e-9])
    return sorted(contact_rows)


def _cut_pieces(segment: Recording, contacts: list[int]) -> list[Recording]:
    """Cut a segment between its contacts into pieces in which every body is observed often enough."""
    pieces = []
    for first, end in pairwise([0, *contacts, len(segment.t)]):
        length = min(_piece_length(len(segment.t)), max(end - first, _MIN_PIECE_ROWS))
        pieces += [segment.select_rows(k, k + length) for k in range(first, end - length + 1, length)]
    return [one for one in pieces if (one.is_observed.sum(axis=0) >= MIN_ROWS).all()]


def _piece_length(rows: int) -> int:
    """Return the number of rows of the pieces of a window."""
    return int(np.clip(rows // _PIECES, _MIN_PIECE_ROWS, _MAX_PIECE_ROWS))


def _measure_pieces(
    segment: Recording, path: FloatArray, covariates: Covariates, correlated: float
) -> list[tuple[FloatArray, float, int, float, FloatArray, FloatArray]]:
    """Measure the pieces of one window: acceleration, sigma, shot, time, position and velocity of each."""
    rows, bodies = np.nonzero(segment.is_observed)
    phases: NDArray[np.str_] = np.array(covariates.phase)
    length, measured = _piece_length(len(segment.t)), []
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        for k in range(0, len(own) - length + 1, length):
            here = own[k : k + length]
            t = segment.t[rows[here]]
            if np.isin(phases[here], _CONTACT_PHASES).any() or not np.isfinite(path[rows[here], body]).all():
                continue
            span = float(np.ptp(t))
            weights = 2 * np.linalg.pinv(np.vander((t - t.mean()) / span, 3))[0] / span**2  # of a second derivative
            miss = segment.positions[rows[here], body] - path[rows[here], body]
            measured.append(
                (
                    weights @ miss,
                    float(np.linalg.norm(weights) * segment.sigma[rows[here], body].mean() * correlated),
                    segment.shot,
                    float(t.mean()),
                    covariates.position[here].mean(axis=0),
                    covariates.velocity[here].mean(axis=0),
                )
            )
    return measured


# Share of the unexplained force, on other shots, from which a law is reported: half of its rms is then the law's.
MIN_LAW_SHARE = 0.25
# Probability of any law in forces that vary with nothing.
_SIGNIFICANCE = 0.005
# Share of the curve's success from which a short formula stands for it.
_NEARLY_AS_GOOD = 0.9
# Share of the success of the best formula from which a more usual one, earlier in the list, is taken.
_ALIKE = 0.98
# Least number of pieces of motion, and of shots, from which a law is sought.
_MIN_SAMPLES, _MIN_SHOTS = 24, 3
# Largest number of groups of shots that are left out in turn.
_FOLDS = 5
# Number of points of a curve.
_BINS = 8
# Degree of the polynomial that stands for any smooth curve.
_CURVE_DEGREE = 3
# Number of points of the fitted curve.
_CURVE_POINTS = 60
# Largest size of an exponent.
_MAX_POWER = 4.0


@dataclass(frozen=True, slots=True)
class ForceLaw:
    """How an unexplained acceleration varies with one quantity."""

    direction: str
    """`along` or `across` the motion, or the name of a coordinate."""
    variable: str
    """`speed`, `time`, or the name of a coordinate."""
    at: FloatArray
    """(B,) values of the variable, at which the curve is given."""
    acceleration: FloatArray
    """(B,) mean acceleration there, in the unit of the scene per s^2."""
    sigma: FloatArray
    """(B,) its standard deviation, from the scatter of the pieces."""
    curve: FloatArray
    """(2, _CURVE_POINTS) the variable, and the fitted acceleration: of the formula, else of a smooth curve."""
    formula: str
    """The nearest short formula with its fitted numbers, `a` in terms of `u`; empty where none comes near the curve."""
    explained: float
    """Share of the squared unexplained acceleration beyond noise that the law explains on other shots."""


def find_force_law(excess: ExcessAcceleration, coordinates: tuple[str, ...]) -> ForceLaw | None:
    """Find the quantity that explains most of an unexplained acceleration on other shots.

    Args:
        excess: Accelerations of M pieces of motion.
        coordinates: (D,) names of the coordinates.

    Returns:
        The law; None where there are too few pieces or nothing explains enough.
    """
    shots = np.unique(excess.shot)
    if len(excess.sigma) < _MIN_SAMPLES or len(shots) < _MIN_SHOTS:
        return None
    group = np.searchsorted(shots, excess.shot) % min(_FOLDS, len(shots))
    trials = [
        (_measure_law(values, excess.sigma, at, group, _fit_curve), direction, variable, values, at)
        for direction, values in _iterate_components(excess, coordinates)
        for variable, at in _iterate_variables(excess, coordinates)
    ]
    clear = [one for one in trials if one[0].gain > chi2.isf(_SIGNIFICANCE / len(trials), _CURVE_DEGREE + 1)]
    if not clear:
        return None
    success, direction, variable, values, at = max(clear, key=lambda one: one[0].share)
    if success.share < MIN_LAW_SHARE:
        return None
    fit = _find_formula(values, excess.sigma, at, group, success.share)
    law, formula = fit(values, _robust_weights(values, excess.sigma), at)
    points = _average_in_bins(values, excess.sigma, at)
    even = np.linspace(points[0][0], points[0][-1], _CURVE_POINTS)
    return ForceLaw(direction, variable, *points, np.stack([even, law(even)]), formula, success.share)


def _iterate_components(excess: ExcessAcceleration, coordinates: tuple[str, ...]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the components (M,) of the acceleration."""
    along = excess.velocity / np.maximum(excess.speed, 1e-12)[:, None]
    yield "along", excess.project(along)
    if len(coordinates) == 2:
        yield "across", excess.project(np.stack([-along[:, 1], along[:, 0]], axis=1))
    if len(coordinates) > 1:
        yield from ((name, excess.values[:, k]) for k, name in enumerate(coordinates))


def _iterate_variables(excess: ExcessAcceleration, coordinates: tuple[str, ...]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the quantities (M,) with which a force may vary."""
    yield "speed", excess.speed
    yield "time", excess.t
    yield from ((name, excess.position[:, k]) for k, name in enumerate(coordinates))


Law = Callable[[FloatArray], FloatArray]
# Fits a law, and its formula, to values (M,), their weights (M,) and the variable (M,).
LawFit = Callable[[FloatArray, FloatArray, FloatArray], tuple[Law, str]]


@dataclass(frozen=True, slots=True)
class LawSuccess:
    """What a law explains on shots that it was not fitted to."""

    gain: float
    """Decrease of chi2."""
    share: float
    """Share of the squared acceleration beyond noise."""


def _measure_law(values: FloatArray, sigma: FloatArray, at: FloatArray, group: IntArray, fit: LawFit) -> LawSuccess:
    """Measure what a law explains on the groups of shots that did not fit it."""
    weights = _robust_weights(values, sigma)
    before, left = float(weights @ np.square(values)), 0.0
    for number in np.unique(group):
        tested: BoolArray = group == number
        law, _ = fit(values[~tested], weights[~tested], at[~tested])
        left += float(weights[tested] @ np.square(values[tested] - law(at[tested])))
    excess = before - float(weights @ np.square(sigma))
    return LawSuccess(before - left, (before - left) / excess if excess > 0 else 0.0)


def _robust_weights(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return weights (M,): of the noise, and of a scatter beyond it that is the same for all pieces."""
    scatter = np.median(np.maximum(np.square(values) - np.square(sigma), 0.0))
    return np.asarray(1 / (np.square(sigma) + scatter))


def _fit_curve(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[Law, str]:
    """Fit a polynomial that stands for any smooth curve and has no formula; beyond the fitted range it is constant."""
    low, high = float(at.min()), float(at.max())
    # with `full`, equal places give the flattest of the curves that fit, without a warning
    curve, _ = np.polynomial.Polynomial.fit(at, values, _CURVE_DEGREE, w=np.sqrt(weights), full=True)
    return lambda u: np.asarray(curve(np.clip(u, low, high))), ""


def _fit_constant(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[Law, str]:
    c = _fit_factor(values, weights, np.ones(len(at)))
    return lambda u: np.full(len(u), c), f"a = {c:.3g}"


def _fit_power(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[Law, str]:
    """Fit the factor and the exponent of a power."""

    def power(u: FloatArray, n: float) -> FloatArray:  # sign(u) |u|^n, bounded near zero
        return np.asarray(np.sign(u) * np.maximum(np.abs(u), 1e-6) ** n)

    c, n = _fit_shape(values, weights, lambda n: power(at, n), (-_MAX_POWER, _MAX_POWER))
    return lambda u: c * power(u, n), f"a = {c:.3g} u^{n:.2f}"


def _fit_line(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[Law, str]:
    slope, offset = np.polyfit(at, values, 1, w=np.sqrt(weights))
    return lambda u: slope * u + offset, f"a = {slope:.3g} u {'-' if offset < 0 else '+'} {abs(offset):.3g}"


def _fit_saturation(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[Law, str]:
    """Fit the limit of a saturating law, and the value of the variable at which half of it is reached."""
    largest = float(np.abs(at).max())
    c, middle = _fit_shape(values, weights, lambda middle: at / (np.abs(at) + middle), (1e-3 * largest, largest))
    return lambda u: c * u / (np.abs(u) + middle), f"a = {c:.3g} u / (|u| + {middle:.2g})"


def _fit_shape(
    values: FloatArray, weights: FloatArray, shape: Callable[[float], FloatArray], bounds: tuple[float, float]
) -> tuple[float, float]:
    """Fit the factor and the one parameter, within bounds, of a shape (M,)."""

    def misfit(parameter: float) -> float:
        own = shape(parameter)
        return float(weights @ np.square(values - _fit_factor(values, weights, own) * own))

    best = float(minimize_scalar(misfit, bounds=bounds, method="bounded").x)
    return _fit_factor(values, weights, shape(best)), best


def _fit_factor(values: FloatArray, weights: FloatArray, shape: FloatArray) -> float:
    """Fit the factor of a shape (M,)."""
    return float((weights * shape) @ values / max(float((weights * shape) @ shape), 1e-300))


# The most usual first.
_FORMULAS: tuple[LawFit, ...] = (_fit_constant, _fit_power, _fit_line, _fit_saturation)


def _find_formula(values: FloatArray, sigma: FloatArray, at: FloatArray, group: IntArray, curve_share: float) -> LawFit:
    """Find the shortest formula that explains nearly as much as a curve on other shots; else the curve."""
    shares = [_measure_law(values, sigma, at, group, fit).share for fit in _FORMULAS]
    if max(shares) < _NEARLY_AS_GOOD * curve_share:
        return _fit_curve
    return next(fit for share, fit in zip(shares, _FORMULAS, strict=True) if share >= _ALIKE * max(shares))


def _average_in_bins(
    values: FloatArray, sigma: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Average in bins of about equal size: the variable (B,), the values (B,) and their sigma (B,)."""
    weights = _robust_weights(values, sigma)
    parts = [part for part in np.array_split(np.argsort(at, kind="stable"), _BINS) if len(part) > 1]
    points = []
    for part in parts:
        own = weights[part] / weights[part].sum()
        mean = float(own @ values[part])
        error = float(np.sqrt((own**2) @ np.square(values[part] - mean) * len(part) / (len(part) - 1)))
        points.append((float(own @ at[part]), mean, error))
    middle, mean, error = np.array(points).T
    return middle, mean, error
