"""Residuals of a fit, and their systematic structure by groups: shot, body, phase, position, speed, time, image.

Two statistics are computed: the mean residual of each group, along and across the motion and by coordinate; and the
energy of slow variation within windows. Both are compared with noise that was projected through the same fit, which
accounts for absorption by the fit and for overlap of groups; the largest deviation gives one p-value.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from diagnosis.fitting.display_names import format_group
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, LinearizedFit
from diagnosis.fitting.shot_preparation import build_noise_chain
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_problem import require_linearized
from models.numerics.statistics import correct_for_choices, evaluate_huber_loss

# Number of noise samples.
NOISE_DRAWS = 300


@dataclass(frozen=True, slots=True)
class FitResiduals:
    """Residuals of all windows of a fit: K observations with D coordinates; white noise where the model is right."""

    values: FloatArray
    """(K, D) observed minus predicted, in standard deviations, outliers bounded, divided by `scale`."""
    noise_draws: FloatArray
    """(K, D, NOISE_DRAWS) unit noise, projected through the same fit."""
    window: IntArray
    """(K,) index of the window."""
    shot: IntArray
    """(K,) index of the shot."""
    body: IntArray
    """(K,) index of the body in its window."""
    t: FloatArray
    """(K,) s since the start of the window."""
    phase: NDArray[np.str_]
    """(K,) phase of motion."""
    position: FloatArray
    """(K, D) in the unit of the frame of reference."""
    velocity: FloatArray
    """(K, D) in the unit of the frame of reference per s."""
    since_contact: FloatArray
    """(K,) s since the last contact; NaN where there was none."""
    image: FloatArray | None
    """(K, 2) px from the image centre; None without an image."""
    reference: ReferenceFrame
    """Frame of reference of `position` and `velocity`."""
    scale: float
    """Overall size of the residuals, 1 where noise explains them."""

    @property
    def speed(self) -> FloatArray:
        """(K,) in the unit of the frame of reference per s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))


def compute_residuals(
    problem: DiagnosisProblem, fitted: EffectFit, linearized: LinearizedFit, rng: np.random.Generator
) -> FitResiduals:
    """Compute the residuals of a fit, and noise samples projected through it.

    Args:
        problem: Scene and noise.
        fitted: The fit.
        linearized: The fit, linearised by its parameters and start states.
        rng: Random generator of the noise.

    Returns:
        Residuals of all K observations.
    """
    weights = [np.sqrt(evaluate_huber_loss(flow.residual)[0]) for flow in linearized.point.windows]
    left = [-flow.residual * weight[:, None] for flow, weight in zip(linearized.point.windows, weights, strict=True)]
    correlation = problem.noise.correlation_estimate
    # all windows have the noise of one sensor: the error of its correlation is one for all
    drawn = None if correlation is None else correlation.draw(NOISE_DRAWS, rng)
    noise = [_draw_noise(problem.noise.correlation, drawn, segment, rng) for segment in fitted.segments]
    # the residuals are projected like the noise: an iteration stops slightly before its minimum
    both = [np.concatenate([a[..., None], b], axis=2) for a, b in zip(left, noise, strict=True)]
    through = _project_out_fit(linearized, fitted, weights, both)
    # the weight once more: one outlier must not represent a group
    left = [one[..., 0] * weight[:, None] for one, weight in zip(through, weights, strict=True)]
    through = [one[..., 1:] for one in through]
    expected = sum(float(np.square(one).sum()) for one in through) / NOISE_DRAWS
    size = float(np.sqrt(sum(float(np.square(one).sum()) for one in left) / max(expected, 1e-12)))
    parts = []
    for k, (segment, start) in enumerate(zip(fitted.segments, fitted.starts, strict=True)):
        rows, bodies = np.nonzero(segment.is_observed)
        own = problem.scene.observation_covariates(segment, start, fitted.shared, fitted.forms)
        parts.append(
            FitResiduals(
                values=left[k] / size, noise_draws=through[k], window=np.full(len(rows), k),
                shot=np.full(len(rows), segment.shot), body=bodies, t=segment.t[rows] - segment.t[0],
                phase=np.array(own.phase), position=own.position, velocity=own.velocity,
                since_contact=own.since_contact, image=own.image, reference=segment.reference, scale=size,
            )
        )  # fmt: skip
    return concatenate_residuals(parts)


# Properties that all parts of residuals share.
_COMMON = ("reference", "scale")


def concatenate_residuals(parts: list[FitResiduals]) -> FitResiduals:
    """Concatenate residuals of one scale and frame of reference; without an image where a part has none."""
    columns: dict[str, Any] = {
        field.name: [getattr(one, field.name) for one in parts] for field in fields(FitResiduals)
    }
    if any(image is None for image in columns["image"]):
        del columns["image"]
    joined: dict[str, Any] = {name: np.concatenate(columns[name]) for name in columns if name not in _COMMON}
    return replace(parts[0], **{"image": None, **joined})


def _draw_noise(
    correlation: float, drawn: FloatArray | None, segment: Recording, rng: np.random.Generator
) -> FloatArray:
    """Draw noise (K, D, NOISE_DRAWS) of correlations `drawn` (NOISE_DRAWS,), whitened by the estimated correlation.

    Its variance is 1 whatever was drawn: the size of the residuals is measured by itself, and errors of the correlation
    that add to it on average would let misfit pass as noise. None draws white noise.
    """
    count, coordinates = int(segment.is_observed.sum()), segment.positions.shape[2]
    fresh = rng.standard_normal((count, coordinates, NOISE_DRAWS))
    if drawn is None:
        return fresh
    own = build_noise_chain(segment, 1.0)
    rows, _ = np.nonzero(segment.is_observed)
    steps = rows - rows[own.previous]
    for k in np.flatnonzero(own.correlation):
        correlations = drawn ** steps[k]
        fresh[k] = correlations * fresh[own.previous[k]] + np.sqrt(1 - correlations**2) * fresh[k]
    variance = (1 + correlation**2 - 2 * correlation * drawn) / (1 - correlation**2)
    return build_noise_chain(segment, correlation).whiten(fresh / np.sqrt(variance))


def _project_out_fit(
    linearized: LinearizedFit, fitted: EffectFit, weights: list[FloatArray], noise: list[FloatArray]
) -> list[FloatArray]:
    """Remove from values what start states and free parameters absorb, to first order; priors and links are ignored."""
    left, by_shared = [], []
    for k, (weight, drawn) in enumerate(zip(weights, noise, strict=True)):
        flow = require_linearized(linearized.point, k)
        states = (flow.start_jacobian * weight[:, None, None]).reshape(-1, flow.start_jacobian.shape[2])
        free = (flow.shared_jacobian[..., fitted.free] * weight[:, None, None]).reshape(len(states), -1)
        basis = _orthonormal_basis(states)
        values = drawn.reshape(len(states), -1)
        left.append(values - basis @ (basis.T @ values))
        by_shared.append(free - basis @ (basis.T @ free))
    shared = _orthonormal_basis(np.concatenate(by_shared))
    values = np.concatenate(left)
    values = values - shared @ (shared.T @ values)
    ends = np.cumsum([len(one) for one in left])[:-1]
    return [part.reshape(drawn.shape) for part, drawn in zip(np.split(values, ends), noise, strict=True)]


def _orthonormal_basis(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the span of columns (R, m)."""
    if columns.shape[1] == 0:
        return columns
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, sizes > 1e-9 * max(float(sizes[0]), 1e-300)]) if len(sizes) else scaled


# Share of the largest edge below which an edge is 0: what a simulation leaves of a body that has stopped.
_ROUNDING = 1e-6
# Least number of observations of a group.
_MIN_OBSERVATIONS = 8
# Median of the absolute deviation of one group: that of several is larger, and one-sided sums alone may be smaller.
_MEDIAN_OF_ONE_GROUP = float(norm.isf(0.25))
# Least share of a sum of noise that the fit must not absorb for the sum to be informative.
_MIN_REMAINING_SHARE = 0.1
# Number of groups by a variable.
_BINS = 5
# Number of groups by position, per axis.
_GRID_CELLS = 3
# Number of cosine waves, up to which variation within a window is slow.
_SLOW_WAVES = 5


@dataclass(frozen=True, slots=True)
class ObservationGroup:
    """A group of observations with a common property."""

    family: str
    """shot, body, phase, speed, direction, place, time, since_contact, radius, row, slow."""
    label: str
    """Member of the family; of `slow`, the group that varies slowly, in words."""
    mask: BoolArray
    """(K,) True for observations of the group."""


@dataclass(frozen=True, slots=True)
class GroupFinding:
    """The deviation of a group of observations."""

    group: ObservationGroup
    direction: str
    """along, across, the number of a coordinate, or `waves` for slow variation."""
    z: float
    """Deviation in standard deviations of noise."""


@dataclass(frozen=True, slots=True)
class ResidualStructure:
    """Whether residuals are systematic, and in which groups."""

    p_value: float
    """Probability that the largest deviation of all groups is noise."""
    findings: tuple[GroupFinding, ...]
    """The largest deviation of each family, largest first."""


def find_structure(residuals: FitResiduals) -> ResidualStructure:
    """Find the groups of residuals with the largest deviation from noise.

    Args:
        residuals: Residuals of a fit, and noise projected through it.

    Returns:
        The p-value of the largest deviation, and the largest one of each family.
    """
    named, sums, drawn = [], [], []
    groups = list(iterate_groups(residuals))
    masks = np.array([block.mask for block in groups], dtype=np.float64)
    for direction, unit in _iterate_directions(residuals):
        sizes = np.sqrt(masks @ np.square(unit).sum(axis=1))
        chances = masks @ np.einsum("kd,kdn->kn", unit, residuals.noise_draws)
        measured = masks @ (unit * residuals.values).sum(axis=1)
        for block, size, chance, value in zip(groups, sizes, chances, measured, strict=True):
            if chance.std() >= _MIN_REMAINING_SHARE * size:
                named.append((block, direction))
                sums.append(float(value))
                drawn.append(chance)
    for block, energy, chance in _sum_slow_waves(residuals, groups):
        named.append((block, "waves"))
        sums.append(energy)
        drawn.append(chance)
    return _compare_with_noise(named, np.array(sums), np.array(drawn))


def _compare_with_noise(
    named: list[tuple[ObservationGroup, str]], sums: FloatArray, drawn: FloatArray
) -> ResidualStructure:
    """Compare sums (G,) of groups with those of the noise samples (G, NOISE_DRAWS)."""
    if not len(sums):
        return ResidualStructure(1.0, ())
    spread = np.maximum(drawn.std(axis=1), 1e-12)
    middle = np.where([direction == "waves" for _, direction in named], drawn.mean(axis=1), 0.0)
    z, chance = (sums - middle) / spread, (drawn - middle[:, None]) / spread[:, None]
    one_sided = np.array([direction == "waves" for _, direction in named])
    z = np.where(one_sided, z, np.abs(z))
    largest = np.where(one_sided[:, None], chance, np.abs(chance)).max(axis=0)
    best: dict[str, GroupFinding] = {}
    for k in np.argsort(-z):
        block, direction = named[k]
        best.setdefault(block.family, GroupFinding(block, direction, float(z[k])))
    return ResidualStructure(_largest_p_value(float(z.max()), largest), tuple(best.values()))


def _largest_p_value(largest: float, chance: FloatArray) -> float:
    """Return the p-value of the largest deviation: from the samples, or beyond them from a normal tail.

    The tail is that of the number of independent groups that explains the median of the samples.
    """
    counted = (1 + int((chance >= largest).sum())) / (1 + len(chance))
    middle = max(float(np.median(chance)), _MEDIAN_OF_ONE_GROUP)
    alike = np.log(0.5) / np.log1p(-2 * norm.sf(middle))
    beyond = correct_for_choices(2 * float(norm.sf(largest)), float(alike))
    return float(counted if counted > 5 / len(chance) else min(counted, beyond))


def _iterate_directions(residuals: FitResiduals) -> Iterator[tuple[str, FloatArray]]:
    """Yield unit vectors (K, D) along and across the motion, and of each coordinate."""
    count, coordinates = residuals.values.shape
    speed = residuals.speed[:, None]
    along = np.where(speed > 0, residuals.velocity / np.maximum(speed, 1e-12), 0.0)
    yield "along", along
    if coordinates == 2:
        yield "across", np.stack([-along[:, 1], along[:, 0]], axis=1)
    for axis in range(coordinates):
        yield str(axis), np.broadcast_to(np.eye(coordinates)[axis], (count, coordinates))


def iterate_groups(residuals: FitResiduals) -> Iterator[ObservationGroup]:
    """Yield all groups with enough observations that do not hold all of them."""
    count = len(residuals.values)
    for block in _iterate_all_groups(residuals):
        if block.mask.sum() >= _MIN_OBSERVATIONS and (block.family == "all" or block.mask.sum() < count):
            yield block


def _iterate_all_groups(residuals: FitResiduals) -> Iterator[ObservationGroup]:
    """Yield all groups, including small ones."""
    yield ObservationGroup("all", "all", np.ones(len(residuals.values), bool))
    for family, values in (("shot", residuals.shot), ("body", residuals.body), ("phase", residuals.phase)):
        yield from (ObservationGroup(family, str(value), values == value) for value in np.unique(values))
    yield from _bin_by_value("time", residuals.t)
    yield from _bin_by_value("speed", residuals.speed)
    yield from _bin_by_value("since_contact", residuals.since_contact)
    if residuals.values.shape[1] == 2:
        heading = np.arctan2(residuals.velocity[:, 1], residuals.velocity[:, 0])
        sector = np.round(heading / (np.pi / 4)).astype(int) % 8
        yield from (ObservationGroup("direction", f"{45 * k} degrees", sector == k) for k in range(8))
        yield from _bin_by_position(residuals.position)
    if residuals.image is not None:
        yield from _bin_by_value("radius", np.linalg.norm(residuals.image, axis=1))
        yield from _bin_by_value("row", residuals.image[:, 1])


def _bin_by_value(family: str, values: FloatArray) -> Iterator[ObservationGroup]:
    """Yield groups of equal size, by a variable."""
    is_valid = np.isfinite(values)
    if is_valid.sum() < _BINS * _MIN_OBSERVATIONS or np.ptp(values[is_valid]) == 0:
        return
    edges = np.quantile(values[is_valid], np.linspace(0, 1, _BINS + 1))
    labels = np.where(np.abs(edges) < _ROUNDING * np.abs(edges).max(), 0.0, edges)
    for k in range(_BINS):
        here = is_valid & (values >= edges[k]) & ((values < edges[k + 1]) | (k == _BINS - 1))
        yield ObservationGroup(family, f"{labels[k]:.3g} to {labels[k + 1]:.3g}", here)


def _bin_by_position(place: FloatArray) -> Iterator[ObservationGroup]:
    """Yield groups by position, on a grid over the positions of all bodies."""
    low, high = np.quantile(place, 0.01, axis=0), np.quantile(place, 0.99, axis=0)
    cell = np.clip(((place - low) / np.maximum(high - low, 1e-12) * _GRID_CELLS).astype(int), 0, _GRID_CELLS - 1)
    for i in range(_GRID_CELLS):
        for j in range(_GRID_CELLS):
            middle = low + (np.array([i, j]) + 0.5) / _GRID_CELLS * (high - low)
            label = f"({middle[0]:.2f}, {middle[1]:.2f})"
            yield ObservationGroup("place", label, (cell[:, 0] == i) & (cell[:, 1] == j))


def _sum_slow_waves(
    residuals: FitResiduals, groups: list[ObservationGroup]
) -> Iterator[tuple[ObservationGroup, float, FloatArray]]:
    """Yield the energy of slow waves in the residuals and in the noise (NOISE_DRAWS,) of each group.

    Groups are shots, bodies, phases and everything. The cube root of the energy is returned: the energy of few waves is
    far from normal, its cube root is nearly normal (Wilson and Hilferty 1931, doi:10.1073/pnas.17.12.684).
    """
    energy: dict[str, tuple[ObservationGroup, float, FloatArray]] = {}
    wanted = [block for block in groups if block.family in ("all", "shot", "body", "phase")]
    for window in np.unique(residuals.window):
        for body in np.unique(residuals.body[residuals.window == window]):
            own = np.flatnonzero((residuals.window == window) & (residuals.body == body))
            if len(own) < 2 * _SLOW_WAVES:
                continue
            waves = np.cos(np.pi * np.outer(np.arange(_SLOW_WAVES), (np.arange(len(own)) + 0.5) / len(own)))
            one = float(np.square(waves @ residuals.values[own]).sum()) / len(own)
            chance = np.square(np.tensordot(waves, residuals.noise_draws[own], axes=1)).sum(axis=(0, 1)) / len(own)
            for block in wanted:
                if block.mask[own].mean() > 0.5:
                    slow = ObservationGroup("slow", format_group(block.family, block.label), block.mask)
                    before = energy.get(block.family + block.label, (slow, 0.0, np.zeros(NOISE_DRAWS)))
                    energy[block.family + block.label] = (slow, before[1] + one, before[2] + chance)
    yield from ((block, float(np.cbrt(one)), np.cbrt(chance)) for block, one, chance in energy.values())
