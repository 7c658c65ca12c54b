"""The force that a model lacks: its acceleration on short pieces of motion, what it varies with, and its formula.

Such a force bends the residuals of a path: their second derivative is the acceleration that it causes, whatever its
law. It is measured piece by piece with a parabola, on pieces without a contact, with an error that follows from the
noise alone. The coefficient of a parabola is a mean of the acceleration over the piece with known weights, so that a
law is compared with the means of its own values along the path: pieces may be long. Every law is judged on shots that
it was not fitted to, so that a flexible curve has no advantage over a short formula.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
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
# Ratio of a force to its error in a piece from which pieces need not be longer.
_RESOLVED_RATIO = 6.0
# Power of the length of a piece with which its error falls.
_ERROR_POWER = 2.5
# Moments of a piece, from -1 to 1, at which a law is evaluated, and their shares in the mean that a parabola measures:
# for its weights, the second Legendre polynomial, are the second derivative of (1 - s^2)^2.
_MOMENTS = (2 * np.arange(9) + 1) / 9 - 1
_MOMENT_SHARES = np.square(1 - _MOMENTS**2) / np.square(1 - _MOMENTS**2).sum()
# Relative size of a singular value of the responses to a start that counts.
_RESPONSE_CONDITION = 1e-3
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
    motion: FloatArray | None = None
    """(M, Q, 1 + 2 D) time, position and velocity at Q moments of each piece; None where the means stand for them."""

    @property
    def speed(self) -> FloatArray:
        """(M,) in the unit of the scene per s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def select(self, chosen: BoolArray) -> ExcessAcceleration:
        """Return the chosen (M,) pieces."""
        return replace(
            self,
            **{one.name: values[chosen] for one in fields(self) if (values := getattr(self, one.name)) is not None},
        )

    def project(self, directions: FloatArray) -> FloatArray:
        """Return the components (M,) along unit vectors (M, D)."""
        return np.asarray((self.values * directions).sum(axis=1))


def measure_excess_acceleration(
    problem: DiagnosisProblem, fitted: EffectFit, rows: int | None = None
) -> ExcessAcceleration:
    """Measure the acceleration that the model of a fit lacks.

    Args:
        problem: Scene and noise.
        fitted: The fit.
        rows: Number of rows of a piece; where not given, as many as suit its window.

    Returns:
        Accelerations of all pieces; none where every window is too short.
    """
    fitted = fit_pieces(problem, fitted, rows)
    correlated = np.sqrt((1 + problem.noise.correlation) / (1 - problem.noise.correlation))
    measured: list[tuple[FloatArray, float, int, float, FloatArray, FloatArray, FloatArray]] = []
    for segment, start in zip(fitted.segments, fitted.starts, strict=True):
        path = problem.scene.predict_positions(segment, start, fitted.shared, fitted.forms)
        covariates = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
        responses = None if rows is None else _respond_to_start(problem, segment, start, fitted)
        measured += _measure_pieces(segment, path, covariates, float(correlated), responses)
    if not measured:
        nothing, flat = np.empty((0, 1)), np.empty(0)
        return ExcessAcceleration(nothing, flat, np.empty(0, np.int64), flat, nothing, nothing)
    values, sigma, shot, t, position, velocity, motion = zip(*measured, strict=True)
    return ExcessAcceleration(
        np.array(values), np.array(sigma), np.array(shot, np.int64), np.array(t), np.array(position),
        np.array(velocity), np.array(motion),
    )  # fmt: skip


def measure_resolved_acceleration(problem: DiagnosisProblem, fitted: EffectFit) -> ExcessAcceleration:
    """Measure the acceleration that the model of a fit lacks in pieces that are as long as the noise requires.

    Args:
        problem: Scene and noise.
        fitted: The fit.

    Returns:
        Accelerations of all pieces: the shortest that resolve them, else the longest of which there are enough.
    """
    if isinstance(problem.scene, ContactRichScene):
        return measure_excess_acceleration(problem, fitted)
    rows, longest = _MIN_PIECE_ROWS, max(len(segment.t) for segment in fitted.segments)
    longer = excess = measure_excess_acceleration(problem, fitted, rows)
    while len(longer.sigma) >= _MIN_SAMPLES and rows <= longest:
        excess = longer
        sigma, size = (float(np.sqrt(np.square(one).mean())) for one in (excess.sigma, excess.values))
        if size > _RESOLVED_RATIO * sigma:
            return excess
        rows = max(round(rows * (_RESOLVED_RATIO * sigma / size) ** (1 / _ERROR_POWER)), rows + 1)
        longer = measure_excess_acceleration(problem, fitted, rows)
    return excess


def _respond_to_start(
    problem: DiagnosisProblem, segment: Recording, start: FloatArray, fitted: EffectFit
) -> FloatArray:
    """Return derivatives (K, D, S) of the K observations of a segment by its start state."""
    model = problem.scene.build_model((segment,), fitted.forms, np.zeros(len(problem.priors), bool))
    rows, bodies = np.nonzero(segment.is_observed)
    response = model.linearize(0, start, fitted.shared).start_jacobian
    return np.asarray(response * segment.sigma[rows, bodies][:, None, None])


def fit_pieces(problem: DiagnosisProblem, fitted: EffectFit, rows: int | None = None) -> EffectFit:
    """Fit the start states of short pieces of the windows of a fit, so that every path stays near its observations.

    A force that pulls back changes the residuals of a long path. In a contact-rich scene, hidden spin forbids it.

    Args:
        problem: Scene and noise.
        fitted: The fit.
        rows: Observations of a piece; None for as many as its length allows.

    Returns:
        The fit on pieces; the same one in a contact-rich scene, or where every window is too short.
    """
    if isinstance(problem.scene, ContactRichScene):
        return fitted
    pieces = tuple(
        piece
        for segment, start in zip(fitted.segments, fitted.starts, strict=True)
        for piece in _cut_pieces(segment, _find_contact_rows(problem, segment, start, fitted), rows)
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


def _cut_pieces(segment: Recording, contacts: list[int], rows: int | None) -> list[Recording]:
    """Cut a segment between its contacts into pieces in which every body is observed often enough."""
    pieces = []
    for first, end in pairwise([0, *contacts, len(segment.t)]):
        length = min(rows or _piece_length(len(segment.t)), max(end - first, _MIN_PIECE_ROWS))
        # the errors of pieces that overlap by half correlate by -0.4 only
        step = length // 2 if rows else length
        pieces += [segment.select_rows(k, k + length) for k in range(first, end - length + 1, step)]
    return [one for one in pieces if (one.is_observed.sum(axis=0) >= MIN_ROWS).all()]


def _piece_length(rows: int) -> int:
    """Return the number of rows of the pieces of a window."""
    return int(np.clip(rows // _PIECES, _MIN_PIECE_ROWS, _MAX_PIECE_ROWS))


def _measure_pieces(
    segment: Recording,
    path: FloatArray,
    covariates: Covariates,
    correlated: float,
    responses: FloatArray | None,
) -> list[tuple[FloatArray, float, int, float, FloatArray, FloatArray, FloatArray]]:
    """Measure the pieces of one window: acceleration, sigma, shot, time, position, velocity and motion of each.

    A known force that pulls back accelerates what is off its path. What it does to a path from another start
    (`responses`) tells how much: with that taken off, another start alone shows no acceleration. The window is one
    piece then.
    """
    rows, bodies = np.nonzero(segment.is_observed)
    phases: NDArray[np.str_] = np.array(covariates.phase)
    measured = []
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(bodies == body)
        length = _piece_length(len(segment.t)) if responses is None else len(own)
        for k in range(0, len(own) - length + 1, length):
            here = own[k : k + length]
            t = segment.t[rows[here]]
            if np.isin(phases[here], _CONTACT_PHASES).any() or not np.isfinite(path[rows[here], body]).all():
                continue
            span = float(np.ptp(t))
            weights = 2 * np.linalg.pinv(np.vander((t - t.mean()) / span, 3))[0] / span**2  # of a second derivative
            miss = segment.positions[rows[here], body] - path[rows[here], body]
            value = weights @ miss
            if responses is not None:
                shares = np.square(1 - np.square(2 * (t - t[0]) / span - 1))
                shares /= shares.sum()
                mean, bend = (np.tensordot(one, responses[here], 1) for one in (shares, weights))
                value -= bend @ np.linalg.pinv(mean, rcond=_RESPONSE_CONDITION) @ (shares @ miss)
            whole = np.column_stack([t, covariates.position[here], covariates.velocity[here]])
            moments = (t[0] + t[-1] + _MOMENTS * span) / 2
            measured.append(
                (
                    value,
                    float(np.linalg.norm(weights) * segment.sigma[rows[here], body].mean() * correlated),
                    segment.shot,
                    float(t.mean()),
                    covariates.position[here].mean(axis=0),
                    covariates.velocity[here].mean(axis=0),
                    np.column_stack([np.interp(moments, t, column) for column in whole.T]),
                )
            )
    return measured


# Share of the unexplained force, on other shots, from which a law is reported: half of its rms is then the law's.
MIN_LAW_SHARE = 0.25
# Probability of any law in forces that vary with nothing.
_SIGNIFICANCE = 0.005
# Share of the curve's success from which a short formula stands for it: it then misses at most a tenth of the force.
_NEARLY_AS_GOOD = 0.99
# Share of the success of the best formula from which a more usual one, earlier in the list, is taken.
_ALIKE = 0.98
# Least number of pieces of motion, and of shots, from which a law is sought.
_MIN_SAMPLES, _MIN_SHOTS = 24, 3
# Largest number of groups of shots that are left out in turn.
_FOLDS = 5
# Number of points of a curve.
_BINS = 8
# Degrees of the polynomials of which one stands for any smooth curve; the last one follows two periods of a wave.
_CURVE_DEGREES = (3, 6, 10)
# Smallest size of a variable, relative to its largest, at which a power is evaluated.
_LEAST_BASE = 1e-3
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
        (_measure_law(values, excess.sigma, at, group, fit), direction, variable, values, at, fit, degree)
        for direction, values, shares in _iterate_components(excess, coordinates)
        for variable, along in _iterate_variables(excess, coordinates)
        for at in (PathVariable(along, shares),)
        for degree, fit in _CURVES.items()
    ]
    clear = [one for one in trials if one[0].gain > chi2.isf(_SIGNIFICANCE / len(trials), one[-1] + 1)]
    if not clear:
        return None
    success, direction, variable, values, at, curve, _ = max(clear, key=lambda one: one[0].share)
    if success.share < MIN_LAW_SHARE:
        return None
    fit = _find_formula(values, excess.sigma, at, group, success.share, curve)
    law, formula = fit(values, _robust_weights(values, excess.sigma), at)
    points = _average_in_bins(values, excess.sigma, at.middle)
    even = np.linspace(points[0][0], points[0][-1], _CURVE_POINTS)
    return ForceLaw(direction, variable, *points, np.stack([even, law(even)]), formula, success.share)


@dataclass(frozen=True, slots=True)
class PathVariable:
    """A quantity with which a force may vary, at Q moments of each of M pieces."""

    values: FloatArray
    """(M, Q)"""
    shares: FloatArray
    """(M, Q) of a law's value at each moment in the measured component of the acceleration."""

    @property
    def middle(self) -> FloatArray:
        """(M,) mean of each piece."""
        sizes = np.abs(self.shares)
        return np.asarray((sizes * self.values).sum(axis=1) / np.maximum(sizes.sum(axis=1), 1e-300))

    def average(self, law_values: FloatArray) -> FloatArray:
        """Average what a law gives at all moments (M, Q), or several laws (M, Q, K), to what pieces would show (M,)."""
        return np.asarray(np.einsum("mq,mq...->m...", self.shares, law_values))

    def select(self, chosen: BoolArray) -> PathVariable:
        """Return the chosen (M,) pieces."""
        return PathVariable(self.values[chosen], self.shares[chosen])


def _get_motion(excess: ExcessAcceleration) -> tuple[FloatArray, FloatArray]:
    """Return time, position and velocity (M, Q, 1 + 2 D) at the moments of all pieces, and their shares (Q,)."""
    if excess.motion is not None:
        return excess.motion, _MOMENT_SHARES
    return np.column_stack([excess.t, excess.position, excess.velocity])[:, None], np.ones(1)


def _iterate_components(
    excess: ExcessAcceleration, coordinates: tuple[str, ...]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield the components (M,) of the acceleration, and what each moment (M, Q) contributes to them."""
    motion, shares = _get_motion(excess)
    velocity = motion[:, :, 1 + len(coordinates) :]
    heading = velocity / np.maximum(np.linalg.norm(velocity, axis=2), 1e-12)[..., None]
    along = excess.velocity / np.maximum(excess.speed, 1e-12)[:, None]
    yield "along", excess.project(along), shares * np.einsum("mqd,md->mq", heading, along)
    even = np.broadcast_to(shares, velocity.shape[:2])
    if len(coordinates) == 2:
        # a force across the motion turns with it
        turned, across = (np.stack([-one[..., 1], one[..., 0]], axis=-1) for one in (heading, along))
        yield "across", excess.project(across), shares * np.einsum("mqd,md->mq", turned, across)
    yield from ((name, excess.values[:, k], even) for k, name in enumerate(coordinates))


def _iterate_variables(excess: ExcessAcceleration, coordinates: tuple[str, ...]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the quantities (M, Q) with which a force may vary."""
    motion, count = _get_motion(excess)[0], len(coordinates)
    yield "speed", np.asarray(np.linalg.norm(motion[:, :, 1 + count :], axis=2))
    yield "time", motion[:, :, 0]
    yield from ((name, motion[:, :, 1 + k]) for k, name in enumerate(coordinates))


Law = Callable[[FloatArray], FloatArray]
# Fits a law, and its formula, to values (M,), their weights (M,) and the variable.
LawFit = Callable[[FloatArray, FloatArray, PathVariable], tuple[Law, str]]


@dataclass(frozen=True, slots=True)
class LawSuccess:
    """What a law explains on shots that it was not fitted to."""

    gain: float
    """Decrease of chi2."""
    share: float
    """Share of the squared acceleration beyond noise."""


def _measure_law(values: FloatArray, sigma: FloatArray, at: PathVariable, group: IntArray, fit: LawFit) -> LawSuccess:
    """Measure what a law explains on the groups of shots that did not fit it."""
    weights = _robust_weights(values, sigma)
    before, left = float(weights @ np.square(values)), 0.0
    for number in np.unique(group):
        tested: BoolArray = group == number
        law, _ = fit(values[~tested], weights[~tested], at.select(~tested))
        own = at.select(tested)
        left += float(weights[tested] @ np.square(values[tested] - own.average(law(own.values))))
    excess = before - float(weights @ np.square(sigma))
    return LawSuccess(before - left, (before - left) / excess if excess > 0 else 0.0)


def _robust_weights(values: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return weights (M,): of the noise, and of a scatter beyond it that is the same for all pieces."""
    scatter = np.median(np.maximum(np.square(values) - np.square(sigma), 0.0))
    return np.asarray(1 / (np.square(sigma) + scatter))


def _fit_polynomial(degree: int, values: FloatArray, weights: FloatArray, at: PathVariable) -> Law:
    """Fit a polynomial that is constant beyond the fitted range."""
    low, high = float(at.values.min()), float(at.values.max())

    def evaluate_terms(u: FloatArray) -> FloatArray:
        scaled = (2 * np.clip(u, low, high) - low - high) / max(high - low, 1e-300)
        return np.asarray(np.polynomial.chebyshev.chebvander(scaled, degree))

    root = np.sqrt(weights)
    terms = at.average(evaluate_terms(at.values)) * root[:, None]
    # equal places give the flattest of the curves that fit
    coefficients = np.linalg.lstsq(terms, values * root, rcond=1e-6)[0]
    return lambda u: np.asarray(evaluate_terms(u) @ coefficients)


def _fit_curve(degree: int, values: FloatArray, weights: FloatArray, at: PathVariable) -> tuple[Law, str]:
    """Fit a polynomial that stands for any smooth curve and has no formula."""
    return _fit_polynomial(degree, values, weights, at), ""


# Fits of smooth curves by their degree.
_CURVES: dict[int, LawFit] = {degree: partial(_fit_curve, degree) for degree in _CURVE_DEGREES}


def _fit_constant(values: FloatArray, weights: FloatArray, at: PathVariable) -> tuple[Law, str]:
    c = _fit_factor(values, weights, at.average(np.ones_like(at.values)))
    return lambda u: np.full(u.shape, c), f"a = {c:.3g}"


def _fit_power(values: FloatArray, weights: FloatArray, at: PathVariable) -> tuple[Law, str]:
    """Fit the factor and the exponent of a power."""
    least = _LEAST_BASE * float(np.abs(at.values).max())

    def power(u: FloatArray, n: float) -> FloatArray:  # sign(u) |u|^n, bounded near zero
        return np.asarray(np.sign(u) * np.maximum(np.abs(u), least) ** n)

    c, n = _fit_shape(values, weights, at, power, (-_MAX_POWER, _MAX_POWER))
    return lambda u: c * power(u, n), f"a = {c:.3g} u^{n:.2f}"


def _fit_line(values: FloatArray, weights: FloatArray, at: PathVariable) -> tuple[Law, str]:
    line = _fit_polynomial(1, values, weights, at)
    low, high = float(at.values.min()), float(at.values.max())
    first, last = line(np.array([low, high])).tolist()
    slope = (last - first) / max(high - low, 1e-300)
    offset = first - slope * low
    return line, f"a = {slope:.3g} u {'-' if offset < 0 else '+'} {abs(offset):.3g}"


def _fit_saturation(values: FloatArray, weights: FloatArray, at: PathVariable) -> tuple[Law, str]:
    """Fit the limit of a saturating law, and the value of the variable at which half of it is reached."""
    largest = float(np.abs(at.values).max())

    def saturate(u: FloatArray, middle: float) -> FloatArray:
        return np.asarray(u / (np.abs(u) + middle))

    c, middle = _fit_shape(values, weights, at, saturate, (1e-3 * largest, largest))
    return lambda u: c * saturate(u, middle), f"a = {c:.3g} u / (|u| + {middle:.2g})"


def _fit_shape(
    values: FloatArray,
    weights: FloatArray,
    at: PathVariable,
    shape: Callable[[FloatArray, float], FloatArray],
    bounds: tuple[float, float],
) -> tuple[float, float]:
    """Fit the factor and the one parameter, within bounds, of a shape of the variable."""

    def misfit(parameter: float) -> float:
        own = at.average(shape(at.values, parameter))
        return float(weights @ np.square(values - _fit_factor(values, weights, own) * own))

    best = float(minimize_scalar(misfit, bounds=bounds, method="bounded").x)
    return _fit_factor(values, weights, at.average(shape(at.values, best))), best


def _fit_factor(values: FloatArray, weights: FloatArray, shape: FloatArray) -> float:
    """Fit the factor of a shape (M,)."""
    return float((weights * shape) @ values / max(float((weights * shape) @ shape), 1e-300))


# The most usual first.
_FORMULAS: tuple[LawFit, ...] = (_fit_constant, _fit_power, _fit_line, _fit_saturation)


def _find_formula(
    values: FloatArray, sigma: FloatArray, at: PathVariable, group: IntArray, curve_share: float, curve: LawFit
) -> LawFit:
    """Find the shortest formula that explains nearly as much as a curve on other shots; else the curve."""
    shares = [_measure_law(values, sigma, at, group, fit).share for fit in _FORMULAS]
    if max(shares) < _NEARLY_AS_GOOD * curve_share:
        return curve
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
