"""A patch of the plane in which bodies are braked more, or less, than around it.

A patch changes the path of a body that crosses it by the double integral of an acceleration along that path, which is
observed. So the residuals of free motion are linear in the strength of a patch, in the place and velocity in which
each stretch begins, and in whatever is the same everywhere: resistance at any speed, a pull, a turn. For a disc of
given place and size, least squares give the strength and the gain; a map of the gain over all discs shows where a patch
may be. Its posterior distribution is sampled, so that the errors of the place hold where several discs explain the
paths.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import chi2

from diagnosis.fitting.hypothesis_fits import NOISE_COST_LIMITS, DiagnosisProblem, EffectFit, refit_effects
from diagnosis.unexplained.force_law import fit_pieces
from diagnosis.unexplained.free_stretches import FreeStretch, find_free_stretches
from models.core.recording import Recording
from models.core.typing import FloatArray, IntArray
from models.numerics.jit import compile_kernel
from models.numerics.statistics import correct_for_choices

# Probability of a patch in motion that is the same everywhere.
PATCH_SIGNIFICANCE = 0.005
# Distance of the centres on the map, and radii of its discs, as shares of the largest extent of the motion: each half
# as large again, from a disc that hardly a body crosses to one that holds most of the motion.
_MAP_STEP, _MAP_RADII = 0.02, (0.04, 0.06, 0.09, 0.13, 0.18, 0.27, 0.4)
# Usual radius as a share of that extent, and the standard deviation of its logarithm: a local patch is smaller than the
# plane, and paths along one side of it hardly tell how far it reaches.
_RADIUS_SHARE, _RADIUS_SPREAD = 0.2, 0.7
# Number of numbers that describe a patch: place, radius, strength.
_PATCH_NUMBERS = 4
# p-value below which the motion across the direction of a stretch is no parabola: the model missed a contact in it.
_MISSED_CONTACT_P_VALUE = 1e-5
# Standard deviations by which the places of a body that moves differ at least.
_MOTION_SIGMAS = 6.0
# Least information on the strength of a disc, as a share of the largest.
_LEAST_SHARE = 1e-9
# Chains that sample the posterior distribution, and the steps of a round, of which the last may lead to another mode.
_CHAINS, _STEPS = 60, 10
# Rounds in which chains reach the distribution from the discs of the map, and rounds that are samples of it.
_ROUNDS_TO_IMPROVE, _ROUNDS_OF_SAMPLES = 15, 25
# Logarithm of the density by which a chain is below the best at most: three numbers scatter by 15 in one of 10^6 cases.
_LOST_CHAIN = 15.0
# Random part of a step, as a share of the extent of the motion.
_KICK = 1e-4


@dataclass(frozen=True, slots=True)
class LocalPatch:
    """A disc in which the acceleration along the motion differs from that around it."""

    centre: FloatArray
    """(2,) m."""
    centre_sigma: FloatArray
    """(2,) m."""
    radius: float
    """m."""
    radius_sigma: float
    """m."""
    strength: float
    """m/s^2 along the motion, inside minus outside; negative where bodies are braked."""
    strength_sigma: float
    """m/s^2."""
    p_value: float
    """Probability of such a difference in motion that is the same everywhere."""


def find_local_patch(problem: DiagnosisProblem, fitted: EffectFit, rng: np.random.Generator) -> LocalPatch | None:
    """Find the patch that explains the residuals of free motion best, with the errors of its posterior distribution.

    Args:
        problem: Scene and noise.
        fitted: A fit without a patch.
        rng: Random generator of the samples.

    Returns:
        The patch; None where no disc is significant, where it leaves more than it explains, where its place is open, or
        where it rests on one stretch.
    """
    return locate_patch(find_free_stretches(problem, fitted), rng)


def locate_patch(stretches: tuple[FreeStretch, ...], rng: np.random.Generator) -> LocalPatch | None:
    """Locate the patch that explains the residuals of stretches best; arguments and result as in `find_local_patch`."""
    stretches = tuple(filter(_is_smooth_across, stretches))
    if not stretches:
        return None
    bare, fields = _build_system(stretches)
    full = bare.add_fields(fields)
    if full.freedom <= _PATCH_NUMBERS:
        return None
    # fields that nothing needs hide a patch where paths are few; without those that act, a patch stands for them
    hypotheses = [_suppose_patch(one, bare, fields, full, rng) for one in (bare.add_fields(fields[..., :1]), full)]
    likely = max((one for one in hypotheses if one is not None), key=lambda one: one.gain, default=None)
    if likely is None or likely.p_value > PATCH_SIGNIFICANCE:
        return None
    model = likely.model
    if likely.gain < model.misfit - NOISE_COST_LIMITS[1] * model.system.freedom:
        return None
    if not all(_shows_patch(rest, likely) for rest in combinations(stretches, len(stretches) - 1)):
        return None
    posterior = _PatchPosterior(model.system, likely.inflation, likely.strength_scale)
    values = posterior.sample(posterior.improve(likely.chains, rng), rng)
    (x, y, radius, strength), (x_sigma, y_sigma, radius_sigma, strength_sigma) = values.mean(axis=0), values.std(axis=0)
    # a place that is known no better than to lie among the paths is none
    if np.any([x_sigma, y_sigma] > np.ptp(model.system.position, axis=0) / np.sqrt(12)):
        return None
    return LocalPatch(
        np.array([x, y]), np.array([x_sigma, y_sigma]), float(radius), float(radius_sigma), float(strength),
        float(strength_sigma), likely.p_value,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _FieldChoice:
    """The common fields that motion needs, by the Bayesian information criterion (Schwarz 1978)."""

    system: _StretchSystem
    columns: tuple[int, ...]
    """Their numbers."""
    misfit: float
    """chi2 with them."""
    criterion: float
    """chi2 and the penalty of their number."""


@dataclass(frozen=True, slots=True)
class _PatchHypothesis:
    """A patch that motion may have, against motion that is the same everywhere."""

    model: _FieldChoice
    """The fields that are needed beside the patch."""
    disc: FloatArray
    """(1, 3) the best one."""
    chains: FloatArray
    """(N, 3) x, y and the logarithm of the radius, near it."""
    inflation: float
    """Factor on the variance of the noise."""
    strength_scale: float
    """m/s^2."""
    gain: float
    """Decrease of the criterion, without the penalty of the patch itself."""
    p_value: float
    """Probability of such a gain without a patch."""


def _suppose_patch(
    system: _StretchSystem, bare: _StretchSystem, fields: FloatArray, full: _StretchSystem, rng: np.random.Generator
) -> _PatchHypothesis | None:
    """Suppose the patch that some common fields let appear; None where no disc is significant beside these.

    Args:
        system: `bare` with some of the fields.
        bare: Motion without common fields.
        fields: (K, 2, F) all of these.
        full: `bare` with all of them.
        rng: Random generator of the chains.
    """
    discs = _list_discs(bare.position)
    gain, information = system.measure_gains(discs)
    first = int(np.argmax(gain))
    # a disc that hardly changes the paths explains nothing; each is tried beside two choices of fields
    count = 2 * int((information > 0).sum())
    if _patch_p_value(float(gain[first]), 1.0, count) > PATCH_SIGNIFICANCE:
        return None
    best = discs[np.argsort(-gain)[:_CHAINS]]
    posterior = _PatchPosterior(system, 1.0, float(np.sqrt(gain[first] / information[first])))
    chains = posterior.improve(np.column_stack([best[:, :2], np.log(best[:, 2])]), rng)
    disc = _to_discs(chains[[np.argmax(posterior.evaluate(chains)[0])]])
    inflation = max((full.chi2 - float(full.measure_gains(disc)[0][0])) / (full.freedom - _PATCH_NUMBERS), 1.0)
    beside = _choose_fields(bare, fields, inflation, disc)
    won = max(_choose_fields(bare, fields, inflation, disc[:0]).criterion - beside.criterion, 0.0)
    p_value = _patch_p_value(won, inflation, count)
    return _PatchHypothesis(beside, disc, chains, inflation, posterior.strength_scale, won, p_value)


def _shows_patch(stretches: tuple[FreeStretch, ...], likely: _PatchHypothesis) -> bool:
    """Return whether stretches, without the one that may show most of it, show a patch of a given place and size.

    What a single stretch shows may be a contact that the model missed.
    """
    bare, fields = _build_system(stretches)
    gain = bare.add_fields(fields[..., list(likely.model.columns)]).measure_gains(likely.disc)[0][0]
    return bool(chi2.sf(gain / likely.inflation, 1) < PATCH_SIGNIFICANCE)


def _patch_p_value(gain: float, inflation: float, count: int) -> float:
    """Return the probability that the best of `count` discs gains as much by chance."""
    return correct_for_choices(float(chi2.sf(gain / inflation, _PATCH_NUMBERS)), count)


def fit_outside_patch(problem: DiagnosisProblem, base: EffectFit, best: EffectFit, patch: LocalPatch) -> EffectFit:
    """Fit the effects of the simulator, and those that were named, to the windows in which no body crosses a patch.

    Effects that were named may only imitate the patch: by the Bayesian information criterion (Schwarz 1978) they must
    gain more outside it than their parameters could by chance.

    Args:
        problem: Scene and priors.
        base: Fit without named effects, on windows that need none.
        best: Fit with the named effects.
        patch: The patch.

    Returns:
        The better fit of those without and with the named effects; `best` where a body crosses every window.
    """
    pieces = fit_pieces(problem, base)
    reach = patch.radius + 2 * patch.radius_sigma
    outside = [k for k, one in enumerate(pieces.segments) if not _crosses(one, patch.centre, reach)]
    if not outside:
        return best
    segments, starts = tuple(pieces.segments[k] for k in outside), tuple(pieces.starts[k] for k in outside)
    fits = [refit_effects(problem, segments, one, starts) for one in ((base, best) if best.names else (base,))]
    noise = min(one.lack_of_fit for one in fits)
    return min(fits, key=lambda one: one.cost / noise + float(one.free.sum() * np.log(one.value_count)))


def _crosses(segment: Recording, centre: FloatArray, reach: float) -> bool:
    """Return whether a body that moves comes within `reach` (m) of a place."""
    for body in range(len(segment.bodies)):
        is_observed = segment.is_observed[:, body]
        places, sigma = segment.positions[is_observed, body], segment.sigma[is_observed, body]
        moves = len(places) > 0 and np.ptp(places, axis=0).max() > _MOTION_SIGMAS * sigma.max()
        if moves and np.linalg.norm(places - centre, axis=1).min() < reach:
            return True
    return False


@dataclass(frozen=True, slots=True)
class _StretchSystem:
    """Least squares of K rows of M stretches, all of it in standard deviations."""

    first: IntArray
    """(M + 1,) first row of each stretch, and K."""
    t: FloatArray
    """(K,) s."""
    position: FloatArray
    """(K, 2) m."""
    heading: FloatArray
    """(K, 2) unit vectors along the motion."""
    weight: FloatArray
    """(K,) 1/m."""
    start_basis: FloatArray
    """(K, 2) per stretch, the orthonormal basis of what its start changes in one coordinate."""
    common_basis: FloatArray
    """(K, 2, C) orthonormal basis of what is the same everywhere, without what starts explain."""
    residual: FloatArray
    """(K, 2) what neither explains."""

    @property
    def chi2(self) -> float:
        """chi2 of the residuals."""
        return float(np.square(self.residual).sum())

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return int(2 * (len(self.t) - 2 * (len(self.first) - 1)) - self.common_basis.shape[2])

    def score(self, discs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the information (C,) on the strengths of discs (C, 3), and those strengths times it (C,)."""
        weight, pull = np.zeros(len(discs)), np.zeros(len(discs))
        _score_discs(
            np.ascontiguousarray(discs), self.first, self.t, self.position, self.heading, self.weight,
            self.start_basis, self.common_basis, self.residual, weight, pull,
        )  # fmt: skip
        return np.maximum(weight, 0.0), pull

    def add_fields(self, fields: FloatArray) -> _StretchSystem:
        """Add common fields (K, 2, F), without what starts explain, to a system that has none."""
        flat, residual = fields.reshape(-1, fields.shape[2]), self.residual.ravel()
        axes, sizes, _ = np.linalg.svd(flat / np.maximum(np.linalg.norm(flat, axis=0), 1e-300), full_matrices=False)
        axes = axes[:, sizes > 1e-6]
        common = np.ascontiguousarray(axes.reshape(*self.residual.shape, -1))
        left = (residual - axes @ (axes.T @ residual)).reshape(self.residual.shape)
        return replace(self, common_basis=common, residual=left)

    def measure_gains(self, discs: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the decrease of chi2 (C,) by discs (C, 3) of the best strength, and its information (C,) or 0."""
        information, pull = self.score(discs)
        information = np.where(information > _LEAST_SHARE * information.max(initial=0.0), information, 0.0)
        return np.divide(np.square(pull), information, out=np.zeros(len(discs)), where=information > 0), information


def _build_system(stretches: tuple[FreeStretch, ...]) -> tuple[_StretchSystem, FloatArray]:
    """Build the system of some stretches without common fields, and these (K, 2, F), without what starts explain."""
    bases = [np.linalg.qr(np.vander(one.t - one.t[0], 2) / one.sigma[:, None])[0] for one in stretches]
    parts = [_remove_start(one, base, one.residual) for one, base in zip(stretches, bases, strict=True)]
    fields = [
        np.stack([_remove_start(one, base, _integrate_twice(one.t, field)) for field in _common_fields(one)], axis=-1)
        for one, base in zip(stretches, bases, strict=True)
    ]
    residual = np.concatenate(parts)
    system = _StretchSystem(
        np.cumsum([0, *(len(one.t) for one in stretches)]),
        np.concatenate([one.t for one in stretches]),
        np.concatenate([one.position for one in stretches]),
        np.concatenate([one.velocity / np.linalg.norm(one.velocity, axis=1)[:, None] for one in stretches]),
        np.concatenate([1 / one.sigma for one in stretches]),
        np.concatenate(bases),
        np.empty((*residual.shape, 0)),
        residual,
    )
    return system, np.concatenate(fields)


def _choose_fields(system: _StretchSystem, fields: FloatArray, inflation: float, discs: FloatArray) -> _FieldChoice:
    """Choose those common fields (K, 2, F) that a system needs beside a disc (1, 3), or without one (0, 3).

    Each costs information on a disc. The first one, resistance, always stays: the fit estimated it from the same
    motion.
    """
    columns = list(range(fields.shape[2]))

    def measure_misfit(numbers: list[int]) -> float:
        part = system.add_fields(fields[..., numbers])
        return part.chi2 - float(part.measure_gains(discs)[0].sum())

    misfit = measure_misfit(columns)
    penalty = inflation * float(np.log(system.residual.size))
    while len(columns) > 1:
        trials = [(measure_misfit([k for k in columns if k != one]), one) for one in columns[1:]]
        least, idle = min(trials)
        if least - misfit > penalty:
            break
        columns.remove(idle)
        misfit = least
    return _FieldChoice(
        system.add_fields(fields[..., columns]), tuple(columns), misfit, misfit + penalty * len(columns)
    )


def _is_smooth_across(stretch: FreeStretch) -> bool:
    """Return whether a body moves smoothly across its direction, where a patch does nothing: no contact was missed."""
    along = stretch.position[-1] - stretch.position[0]
    across = stretch.residual @ np.array([-along[1], along[0]]) / max(np.linalg.norm(along), 1e-9) / stretch.sigma
    basis = np.linalg.qr(np.vander(stretch.t - stretch.t[0], 3) / stretch.sigma[:, None])[0]
    left = across - basis @ (basis.T @ across)
    return bool(chi2.sf(left @ left, len(left) - 3) > _MISSED_CONTACT_P_VALUE)


def _remove_start(stretch: FreeStretch, basis: FloatArray, places: FloatArray) -> FloatArray:
    """Return places (T, 2) in standard deviations, without what the start of the stretch explains."""
    whitened = places / stretch.sigma[:, None]
    return np.asarray(whitened - basis @ (basis.T @ whitened))


def _integrate_twice(t: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Integrate accelerations (T, 2) to places (T, 2), from rest."""
    step = np.diff(t)[:, None]
    change = 0.5 * (acceleration[1:] + acceleration[:-1]) * step
    velocity = np.cumsum(change, axis=0)
    return np.concatenate([np.zeros((1, 2)), np.cumsum((velocity - 0.5 * change) * step, axis=0)])


def _common_fields(stretch: FreeStretch) -> list[FloatArray]:
    """Return accelerations (T, 2) that are the same everywhere: resistance, which may age by shots, turn and pull."""
    speed = np.linalg.norm(stretch.velocity, axis=1)[:, None]
    along = stretch.velocity / speed
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    pulls = [np.broadcast_to(axis, along.shape) for axis in np.eye(2)]
    return [along, along * stretch.shot, along * speed, along * speed**2, across, across * speed, *pulls]


@compile_kernel
def _score_discs(discs, first, t, position, heading, weight, start_basis, common, residual, information, pull):  # type: ignore[no-untyped-def]
    """Fill information and pull (C,) of discs (C, 3): x, y, radius; other arrays as in `_StretchSystem`."""
    longest = 0
    for m in range(len(first) - 1):
        longest = max(longest, first[m + 1] - first[m])
    place, shares = np.zeros((longest, 2)), np.zeros(common.shape[2])
    for k in range(len(discs)):
        centre_x, centre_y, square = discs[k, 0], discs[k, 1], discs[k, 2] * discs[k, 2]
        shares[:] = 0.0
        for m in range(len(first) - 1):
            start, count = first[m], first[m + 1] - first[m]
            v_x, v_y, x, y, is_hit = 0.0, 0.0, 0.0, 0.0, False
            place[0, 0], place[0, 1] = 0.0, 0.0
            for i in range(count - 1):
                row = start + i
                # part of the step from one row to the next that lies inside
                from_x, from_y = position[row, 0] - centre_x, position[row, 1] - centre_y
                step_x, step_y = position[row + 1, 0] - position[row, 0], position[row + 1, 1] - position[row, 1]
                a = step_x * step_x + step_y * step_y + 1e-18
                b = from_x * step_x + from_y * step_y
                root = b * b - a * (from_x * from_x + from_y * from_y - square)
                inside = 0.0
                if root > 0.0:
                    root = np.sqrt(root)
                    inside = min(max((root - b) / a, 0.0), 1.0) - min(max((-root - b) / a, 0.0), 1.0)
                is_hit = is_hit or inside > 0.0
                dt = t[row + 1] - t[row]
                dv_x = 0.5 * inside * dt * (heading[row, 0] + heading[row + 1, 0])
                dv_y = 0.5 * inside * dt * (heading[row, 1] + heading[row + 1, 1])
                x, y = x + (v_x + 0.5 * dv_x) * dt, y + (v_y + 0.5 * dv_y) * dt
                v_x, v_y = v_x + dv_x, v_y + dv_y
                place[i + 1, 0], place[i + 1, 1] = x * weight[row + 1], y * weight[row + 1]
            if not is_hit:
                continue
            for j in range(2):
                for axis in range(2):
                    dot = 0.0
                    for i in range(count):
                        dot += start_basis[start + i, j] * place[i, axis]
                    for i in range(count):
                        place[i, axis] -= start_basis[start + i, j] * dot
            for i in range(count):
                for axis in range(2):
                    value = place[i, axis]
                    information[k] += value * value
                    pull[k] += value * residual[start + i, axis]
                    for n in range(len(shares)):
                        shares[n] += value * common[start + i, axis, n]
        for n in range(len(shares)):
            information[k] -= shares[n] * shares[n]


def _measure_extent(position: FloatArray) -> float:
    """Return the largest extent (m) of places (K, 2)."""
    return float(np.ptp(position, axis=0).max())


def _list_discs(position: FloatArray) -> FloatArray:
    """List the discs (C, 3) of a map of places (K, 2): x, y, radius, m."""
    extent, low, high = _measure_extent(position), position.min(axis=0), position.max(axis=0)
    axes = [
        np.arange(first, last + _MAP_STEP * extent, _MAP_STEP * extent) for first, last in zip(low, high, strict=True)
    ]
    grid = np.meshgrid(*axes, np.multiply(_MAP_RADII, extent), indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, 3)


def _to_discs(numbers: FloatArray) -> FloatArray:
    """Convert x, y and the logarithm of the radius (C, 3) to discs."""
    return np.column_stack([numbers[:, :2], np.exp(numbers[:, 2])])


@dataclass(frozen=True, slots=True)
class _PatchPosterior:
    """Posterior distribution of a patch: x, y and the logarithm of the radius, sampled by chains (N, 3).

    The chains learn the shape of the distribution from each other: differential evolution (ter Braak 2006,
    doi:10.1007/s11222-006-8769-1).
    """

    system: _StretchSystem
    inflation: float
    """Factor on the variance of the noise."""
    strength_scale: float
    """m/s^2, standard deviation of the prior of the strength."""

    def evaluate(self, numbers: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the logarithm of the density (C,) at numbers (C, 3), and the strengths (C,) and their sigmas (C,)."""
        extent, place = _measure_extent(self.system.position), self.system.position
        weight, pull = self.system.score(_to_discs(numbers))
        information = weight / self.inflation + self.strength_scale**-2
        strength = pull / self.inflation / information
        away = (numbers[:, 2] - np.log(_RADIUS_SHARE * extent)) / _RADIUS_SPREAD
        density = 0.5 * (information * strength**2 - np.log(information * self.strength_scale**2) - away**2)
        low, high = place.min(axis=0) - extent, place.max(axis=0) + extent
        is_near = ((numbers[:, :2] > low) & (numbers[:, :2] < high)).all(axis=1) & (numbers[:, 2] < np.log(extent))
        return np.where(is_near, density, -np.inf), strength, 1 / np.sqrt(information)

    def improve(self, chains: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return chains that have reached the distribution, from starts (N, 3)."""
        for _ in range(_ROUNDS_TO_IMPROVE):
            *_, (chains, density, _, _) = self._walk(chains, rng)
            # a chain that stays at a lesser disc would never leave it
            lost = density < density.max() - _LOST_CHAIN
            chains = np.where(lost[:, None], chains[rng.choice(np.flatnonzero(~lost), len(chains))], chains)
        return chains

    def sample(self, chains: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Sample x, y, radius and strength (D, 4)."""
        drawn = []
        for _ in range(_ROUNDS_OF_SAMPLES):
            for numbers, _, strength, sigma in self._walk(chains, rng):
                drawn.append(np.column_stack([_to_discs(numbers), strength + sigma * rng.standard_normal(len(sigma))]))
                chains = numbers
        return np.concatenate(drawn)

    def _walk(
        self, chains: FloatArray, rng: np.random.Generator
    ) -> Iterator[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Yield chains (N, 3), their densities, and the strengths and their sigmas (N,), after each step of a round."""
        count, kick = len(chains), _KICK * _measure_extent(self.system.position)
        density, strength, sigma = self.evaluate(chains)
        for step in range(_STEPS):
            pairs = (np.arange(count)[:, None] + _draw_pairs(count, rng)) % count
            # the last step of a round may lead from one mode to another
            factor = 1.0 if step == _STEPS - 1 else 2.38 / np.sqrt(2 * chains.shape[1])
            jump = factor * (chains[pairs[:, 0]] - chains[pairs[:, 1]]) + kick * rng.standard_normal(chains.shape)
            moved = self.evaluate(chains + jump)
            accepts = np.log(rng.random(count)) < moved[0] - density
            chains = np.where(accepts[:, None], chains + jump, chains)
            density, strength, sigma = (
                np.where(accepts, new, old) for new, old in zip(moved, (density, strength, sigma), strict=True)
            )
            yield chains, density, strength, sigma


def _draw_pairs(count: int, rng: np.random.Generator) -> IntArray:
    """Draw for each of `count` chains the distances (N, 2) to two others that differ."""
    first, second = rng.integers(1, count, count), rng.integers(1, count - 1, count)
    return np.stack([first, second + (second >= first)], axis=1)
