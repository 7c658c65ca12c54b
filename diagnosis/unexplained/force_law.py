"""The law of a force that a model lacks: with which quantity it varies, as a curve and as the nearest short formula.

Every law is judged on shots that it was not fitted to, so that a flexible curve has no advantage over a short formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from diagnosis.unexplained.excess_acceleration import ExcessAcceleration
from models.core.typing import BoolArray, FloatArray, IntArray

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
    formula, fit = _find_formula(values, excess.sigma, at, group, success.share)
    points = _average_in_bins(values, excess.sigma, at)
    even = np.linspace(points[0][0], points[0][-1], _CURVE_POINTS)
    curve = np.stack([even, fit(values, _robust_weights(values, excess.sigma), at)(even)])
    return ForceLaw(direction, variable, *points, curve, formula, success.share)


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
# Fits a law to values (M,), their weights (M,) and the variable (M,).
LawFit = Callable[[FloatArray, FloatArray, FloatArray], Law]


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
        law = fit(values[~tested], weights[~tested], at[~tested])
        left += float(weights[tested] @ np.square(values[tested] - law(at[tested])))
    excess = before - float(weights @ np.square(sigma))
    return LawSuccess(before - left, (before - left) / excess if excess > 0 else 0.0)


def _robust_weights(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return weights (M,): of the noise, and of a scatter beyond it that is the same for all pieces."""
    scatter = np.median(np.maximum(np.square(values) - np.square(sigma), 0.0))
    return np.asarray(1 / (np.square(sigma) + scatter))


def _fit_curve(values: FloatArray, weights: FloatArray, at: FloatArray) -> Law:
    """Fit a polynomial that stands for any smooth curve; beyond the fitted range it is constant."""
    low, high = float(at.min()), float(at.max())
    # with `full`, equal places give the flattest of the curves that fit, without a warning
    curve, _ = np.polynomial.Polynomial.fit(at, values, _CURVE_DEGREE, w=np.sqrt(weights), full=True)
    return lambda u: np.asarray(curve(np.clip(u, low, high)))


def _fit_constant(values: FloatArray, weights: FloatArray, at: FloatArray) -> Law:
    c = _fit_factor(values, weights, np.ones(len(at)))
    return lambda u: np.full(len(u), c)


def _fit_power(values: FloatArray, weights: FloatArray, at: FloatArray) -> Law:
    c, n = _fit_power_numbers(values, weights, at)
    return lambda u: c * _signed_power(u, n)


def _fit_saturation(values: FloatArray, weights: FloatArray, at: FloatArray) -> Law:
    c, middle = _fit_saturation_numbers(values, weights, at)
    return lambda u: c * u / (np.abs(u) + middle)


def _fit_line(values: FloatArray, weights: FloatArray, at: FloatArray) -> Law:
    slope, offset = np.polyfit(at, values, 1, w=np.sqrt(weights))
    return lambda u: slope * u + offset


def _fit_factor(values: FloatArray, weights: FloatArray, shape: FloatArray) -> float:
    """Fit the factor of a shape (M,)."""
    return float((weights * shape) @ values / max(float((weights * shape) @ shape), 1e-300))


def _signed_power(u: FloatArray, n: float) -> FloatArray:
    """Return sign(u) |u|^n, bounded near zero."""
    return np.asarray(np.sign(u) * np.maximum(np.abs(u), 1e-6) ** n)


def _fit_power_numbers(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[float, float]:
    """Fit the factor and the exponent of a power."""

    def misfit(n: float) -> float:
        shape = _signed_power(at, n)
        return float(weights @ np.square(values - _fit_factor(values, weights, shape) * shape))

    n = float(minimize_scalar(misfit, bounds=(-_MAX_POWER, _MAX_POWER), method="bounded").x)
    return _fit_factor(values, weights, _signed_power(at, n)), n


def _fit_saturation_numbers(values: FloatArray, weights: FloatArray, at: FloatArray) -> tuple[float, float]:
    """Fit the limit of a saturating law, and the value of the variable at which half of it is reached."""
    largest = float(np.abs(at).max())

    def misfit(middle: float) -> float:
        shape = at / (np.abs(at) + middle)
        return float(weights @ np.square(values - _fit_factor(values, weights, shape) * shape))

    middle = float(minimize_scalar(misfit, bounds=(1e-3 * largest, largest), method="bounded").x)
    return _fit_factor(values, weights, at / (np.abs(at) + middle)), middle


def _find_formula(
    values: FloatArray, sigma: FloatArray, at: FloatArray, group: IntArray, curve_share: float
) -> tuple[str, LawFit]:
    """Find the shortest formula that explains nearly as much as a curve on other shots; else none, and the curve."""
    weights = _robust_weights(values, sigma)
    families: tuple[tuple[LawFit, Callable[[], str]], ...] = (
        (_fit_constant, lambda: f"a = {_fit_factor(values, weights, np.ones(len(at))):.3g}"),
        (_fit_power, lambda: "a = {:.3g} u^{:.2f}".format(*_fit_power_numbers(values, weights, at))),
        (_fit_line, lambda: _format_line(*np.polyfit(at, values, 1, w=np.sqrt(weights)))),
        (
            _fit_saturation,
            lambda: "a = {:.3g} u / (|u| + {:.2g})".format(*_fit_saturation_numbers(values, weights, at)),
        ),
    )
    shares = [_measure_law(values, sigma, at, group, fit).share for fit, _ in families]
    if max(shares) < _NEARLY_AS_GOOD * curve_share:
        return "", _fit_curve
    return next(
        (describe(), fit)
        for share, (fit, describe) in zip(shares, families, strict=True)
        if share >= _ALIKE * max(shares)
    )


def _format_line(slope: float, offset: float) -> str:
    return f"a = {slope:.3g} u {'-' if offset < 0 else '+'} {abs(offset):.3g}"


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
