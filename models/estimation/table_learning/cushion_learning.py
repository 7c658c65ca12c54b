"""Choice of the cushion law of a table by its evidence from contacts, with parameters by maximum posterior.

`learn_cushions` fits every law: its parameters, the scatter of contacts about it and the decay of side spin. The law of
greatest evidence comes first, and is the table's. `models.estimation.whole_shot.table_fit.search_laws` chooses from
whole shots instead.

The side spin of every contact is summed over (`side_spin`), so that the likelihood depends on the shared parameters
alone: a dozen numbers whatever the number of shots.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, field, replace
from functools import partial

import numpy as np

from models.core.contact_graph import JointSolution
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER, ContactScatter, LearnedTable
from models.estimation.table_learning.side_spin import filter_side_spin, predict_rebounds
from models.numerics.executor import SERIAL, Executor
from models.physics.billiards.contact_model import find_model
from models.physics.billiards.contact_models import CUSHION_MODELS, REGISTERED_CUSHION_MODELS
from models.physics.billiards.parameter_vector import (
    BALL_E,
    BALL_MU,
    PARAMETER_NAMES,
    ROLLING_MU,
    SPIN_DECAY,
    neutral_parameters,
)
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# Prior standard deviation of the logarithm of each scatter about `DEFAULT_SCATTER`.
SCATTER_SPREAD = 0.7
# Contacts that decide between models: their log evidences then differ by tens.
SELECTION_CONTACTS = 100
# Cushion contacts of one shot from which its own cushions are learned.
MIN_OWN_CONTACTS = 2
# Cushion models of one shot; that of Mathavan 2010 costs 140 us per contact, and Han's is its nearest neighbour.
OWN_LAWS = ("mirror", "han_2005", "stronge")
# m, least spread of nose offsets between shots: calibration is no better.
MIN_NOSE_SIGMA = 1e-3
# Of the search.
_ITERATIONS = 40
# Step of second differences, in prior standard deviations; that of first ones, in those of the posterior.
_HESSIAN_STEP, _SLOPE_STEP = 0.02, 1e-3
# Slope of the cost by standard deviations at the start at which a search ends: about that far from its least value.
_LEAST_SLOPE = 0.02
# Posterior over prior standard deviation from which the contacts did not determine a parameter.
_PRIOR_DOMINATED = 0.8
# The cloth is learned from free paths; the noses keep the height of their contact model.
_NOT_LEARNED = ("sliding_friction.mu", "cushion_height.ratio")
_SCATTER_NAMES = ("scatter.velocity", "scatter.slip", "scatter.side_spin")


@dataclass(frozen=True, slots=True)
class CushionFit:
    """A cushion model fitted to contacts."""

    law: str
    parameters: tuple[Parameter, ...]
    """Those of the cushion model and the decay of side spin."""
    scatter: ContactScatter
    physics: FloatArray
    """(P,) parameters of the engine that the fit used."""
    covariance: FloatArray
    """(M, M) of `parameters`."""
    log_evidence: float
    """Laplace approximation."""
    curvature: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """(M + 3, M + 3) Hessian of the negative logarithm of the posterior by `parameters` and scatter, in prior standard
    deviations, at least that of the prior; empty where it is unknown."""
    contact_count: int = 0

    @property
    def indices(self) -> IntArray:
        """(M,) indices of `parameters` in the vector of the engine."""
        return np.array([PARAMETER_NAMES.index(one.name) for one in self.parameters], np.int64)

    @property
    def physics_with_balls(self) -> FloatArray:
        """(P,) `physics` with usual contacts of balls, of which cushion contacts say nothing."""
        physics = self.physics.copy()
        for index in (BALL_E, BALL_MU):
            physics[index] = find_prior(*PARAMETER_NAMES[index].split(".")).value
        return physics


def learn_cushions(
    contacts: CushionContacts,
    radius: float,
    mass: float,
    cloth: dict[str, float],
    laws: tuple[str, ...] = CUSHION_MODELS,
    executor: Executor = SERIAL,
) -> tuple[CushionFit, ...]:
    """Fit every cushion model to the contacts of a table.

    Args:
        contacts: Contacts of all shots.
        radius: m, of the balls.
        mass: kg, of the balls.
        cloth: Parameters of the cloth by `effect.parameter`; some cushion models read sliding friction.
        laws: Names of the cushion models to fit.
        executor: Distributes the points at which the posterior is evaluated over processes.

    Returns:
        One fit per model, that of greatest evidence first. Of many contacts, a part decides between the models.
    """
    part, fits = _thin_chains(contacts), list[CushionFit]()
    for law in laws:
        fits.append(_fit_model(law, part, radius, mass, cloth, fits[0] if fits else None, executor))
        fits.sort(key=lambda one: -one.log_evidence)
    if len(part.t) < len(contacts.t):
        best = _fit_model(fits[0].law, contacts, radius, mass, cloth, fits[0], executor)
        fits[0] = replace(best, log_evidence=fits[0].log_evidence)
    return tuple(fits)


def _thin_chains(contacts: CushionContacts) -> CushionContacts:
    """Keep evenly spaced chains with about `SELECTION_CONTACTS` contacts: enough to tell contact models apart."""
    every = max(len(contacts.t) // SELECTION_CONTACTS, 1)
    return contacts.select_chains((np.cumsum(contacts.begins) - 1) % every == 0)


def refit_scatter(
    contacts: CushionContacts, fit: CushionFit, correction: FloatArray, radius: float, mass: float
) -> CushionFit:
    """Fit the scatter about a model anew, once a correction has made it better.

    Args:
        contacts: Contacts of all shots.
        fit: The fitted model.
        correction: Weights of `rebound_correction`.
        radius: m, of the balls.
        mass: kg, of the balls.

    Returns:
        The fit with its new scatter.
    """
    from scipy.optimize import minimize  # slow to import

    rebounds = predict_rebounds(contacts, CUSHION_MODELS.index(fit.law), fit.physics, radius, mass, correction)
    decay, first = float(fit.physics[SPIN_DECAY]), np.log(astuple(fit.scatter))

    def cost(logarithms: FloatArray) -> float:
        scatter = ContactScatter(*np.exp(logarithms).tolist())
        deviation = (logarithms - np.log(astuple(DEFAULT_SCATTER))) / SCATTER_SPREAD
        likelihood = filter_side_spin(contacts, rebounds, radius, scatter, decay).log_likelihood.sum()
        return 0.5 * float(deviation @ deviation) - float(likelihood)

    best = minimize(cost, first, method="L-BFGS-B", options={"maxiter": _ITERATIONS})
    return replace(fit, scatter=ContactScatter(*np.exp(best.x).tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class _CushionPosterior:
    """Posterior of the coordinates of one cushion model: distances from the priors in prior standard deviations."""

    law: str
    contacts: CushionContacts
    radius: float
    mass: float
    cloth: dict[str, float]
    priors: tuple[Prior, ...]

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Least and greatest coordinates."""
        edges = np.array([[_coordinate(one, edge) for edge in one.bounds] for one in self.priors])
        return edges[:, 0], edges[:, 1]

    def decode(self, coordinates: FloatArray) -> tuple[FloatArray, ContactScatter]:
        """Convert coordinates into the parameters (P,) of the engine and the scatter."""
        physics, values = neutral_parameters(), _values(coordinates, self.priors)
        named = zip((one.name for one in self.priors[: -len(_SCATTER_NAMES)]), values, strict=False)
        for name, value in (*self.cloth.items(), *named):
            physics[PARAMETER_NAMES.index(name)] = value
        return physics, ContactScatter(*values[-len(_SCATTER_NAMES) :])

    def measure_costs(self, points: FloatArray, executor: Executor) -> FloatArray:
        """Compute the negative logarithm (N,) of the posterior at coordinates (N, M).

        Beyond their bounds parameters stay at them, while the prior goes on: the greatest posterior is within them.
        """
        alike: dict[bytes, list[int]] = {}
        inside = np.clip(points, *self.bounds)
        for k, one in enumerate(inside):
            physics, _ = self.decode(one)
            physics[SPIN_DECAY] = 0.0  # what a contact does depends neither on the decay before it nor on the scatter
            alike.setdefault(physics.tobytes(), []).append(k)
        tasks = [(inside[rows],) for rows in alike.values()]
        sums = executor.map_tasks(self, _sum_likelihoods, tasks)
        costs = 0.5 * np.sum(points * points, axis=1)
        for rows, likelihoods in zip(alike.values(), sums, strict=True):
            costs[rows] -= likelihoods
        return np.asarray(costs)

    def measure_slope(
        self, point: FloatArray, free: IntArray, steps: FloatArray, executor: Executor
    ) -> tuple[float, FloatArray]:
        """Compute the cost at coordinates (M,) and its slope (F,) by the `free` ones, by differences over `steps` (F,).

        At an upper bound the difference is taken inwards: beyond it only the prior goes on.
        """
        steps = np.where(point[free] + steps > self.bounds[1][free], -steps, steps)
        moved = np.repeat(point[None], len(free), axis=0)
        moved[np.arange(len(free)), free] += steps
        first, *ahead = self.measure_costs(np.vstack([point, moved]), executor)
        return float(first), (np.array(ahead) - first) / steps

    def measure_curvature(self, point: FloatArray, executor: Executor) -> FloatArray:
        """Compute the Hessian of the cost by central differences inside the bounds; at least that of the prior.

        Returns:
            (M, M), positive definite.
        """
        size, step = len(point), _HESSIAN_STEP
        low, high = self.bounds
        centre, shift = np.clip(point, low + step, high - step), step * np.eye(size)
        i, j = np.tril_indices(size, -1)
        moves = [np.zeros((1, size)), shift, -shift, shift[i] + shift[j], -shift[i] - shift[j]]
        costs = self.measure_costs(centre + np.vstack(moves), executor)
        middle, ahead, behind, *_ = np.split(costs, np.cumsum([len(one) for one in moves]))
        both, neither = costs[1 + 2 * size :].reshape(2, len(i))
        hessian = np.diag((ahead + behind - 2 * middle) / step**2)
        rest = ahead[i] + ahead[j] + behind[i] + behind[j] - 2 * middle
        hessian[i, j] = hessian[j, i] = (both + neither - rest) / (2 * step**2)
        curvatures, vectors = np.linalg.eigh(hessian)
        return np.asarray((vectors * np.maximum(curvatures, 1.0)) @ vectors.T)


def _sum_likelihoods(posterior: _CushionPosterior, points: FloatArray) -> list[float]:
    """Sum the log likelihoods of all contacts at points (N, M) that differ in scatter and decay alone."""
    contacts, radius = posterior.contacts, posterior.radius
    physics, _ = posterior.decode(points[0])
    rebounds = predict_rebounds(contacts, CUSHION_MODELS.index(posterior.law), physics, radius, posterior.mass)
    sums = []
    for point in points:
        physics, scatter = posterior.decode(point)
        side_spin = filter_side_spin(contacts, rebounds, radius, scatter, float(physics[SPIN_DECAY]))
        sums.append(float(side_spin.log_likelihood.sum()))
    return sums


def _fit_model(
    law: str,
    contacts: CushionContacts,
    radius: float,
    mass: float,
    cloth: dict[str, float],
    neighbour: CushionFit | None,
    executor: Executor,
) -> CushionFit:
    """Find the greatest posterior of one model, from the values of a neighbour, the best other model, or the priors."""
    priors = _list_unknowns(law)
    posterior = _CushionPosterior(law, contacts, radius, mass, cloth, priors)
    first = np.clip(_read_coordinates(neighbour, priors), *posterior.bounds)
    if neighbour is not None and neighbour.law == law:  # of fewer contacts
        start = neighbour.curvature * (len(contacts.t) / neighbour.contact_count)
    else:
        start = posterior.measure_curvature(first, executor)
    best = _search_greatest(posterior, first, start, executor)
    curvature = posterior.measure_curvature(best, executor)
    covariance = np.linalg.inv(curvature)
    spread = np.sqrt(np.diag(covariance))
    physics, scatter = posterior.decode(best)
    values = _values(best, priors)
    scale = np.array([_value_scale(one, v) for one, v in zip(priors, values, strict=True)])
    parameters = tuple(
        Parameter(one.name, v, s * change, one.unit, bool(s > _PRIOR_DOMINATED))
        for one, v, s, change in zip(priors, values, spread, scale, strict=True)
        if one.name not in _SCATTER_NAMES
    )
    own = slice(0, len(parameters))
    evidence = -float(posterior.measure_costs(best[None], executor)[0]) - 0.5 * float(np.linalg.slogdet(curvature)[1])
    covariance = (covariance * scale * scale[:, None])[own, own]
    return CushionFit(law, parameters, scatter, physics, covariance, evidence, curvature, len(contacts.t))


def _search_greatest(
    posterior: _CushionPosterior, first: FloatArray, curvature: FloatArray, executor: Executor
) -> FloatArray:
    """Search the coordinates (M,) of the greatest posterior by BFGS, in ones in which `curvature` (M, M) is 1.

    The posterior has a kink at a bound: what arrives at one stays there while the rest is searched once more.
    """
    from scipy.optimize import minimize  # slow to import

    low, high = posterior.bounds
    best, free = first, np.arange(len(first))
    while len(free):
        root = np.linalg.cholesky(np.linalg.inv(curvature[np.ix_(free, free)]))
        steps = _SLOPE_STEP * np.sqrt(np.sum(root * root, axis=1))

        measure = partial(_measure_along, posterior, best, free, root, steps, executor)
        options = {"maxiter": _ITERATIONS, "gtol": _LEAST_SLOPE}
        moves = minimize(measure, np.zeros(len(free)), method="BFGS", jac=True, options=options).x
        best = best.copy()
        best[free] = np.clip(best[free] + root @ moves, low[free], high[free])
        inside = (best > low) & (best < high)
        if inside[free].all():
            break
        free = free[inside[free]]
    return best


def _measure_along(
    posterior: _CushionPosterior, at: FloatArray, free: IntArray, root: FloatArray, steps: FloatArray,
    executor: Executor, moves: FloatArray,
) -> tuple[float, FloatArray]:  # fmt: skip
    """Compute cost and slope (F,) at `moves` (F,) of the free coordinates from `at` (M,), along the columns of root."""
    point = at.copy()
    point[free] += root @ moves
    cost, slope = posterior.measure_slope(point, free, steps, executor)
    return cost, root.T @ slope


def _list_unknowns(law: str) -> tuple[Prior, ...]:
    """List the priors of a model's own parameters, the decay of side spin, and the scatter."""
    names = [*find_model(REGISTERED_CUSHION_MODELS, law).parameters, "spin_decay.rate"]
    own = [name for name in names if name not in _NOT_LEARNED]
    priors = [replace(find_prior(*name.split(".")), name=name) for name in own]
    shares = zip(_SCATTER_NAMES, astuple(DEFAULT_SCATTER), strict=True)
    return (*priors, *(Prior(name, "1", share, SCATTER_SPREAD, True, (1e-3, 1.0)) for name, share in shares))


def _read_coordinates(fit: CushionFit | None, priors: tuple[Prior, ...]) -> FloatArray:
    """Return the coordinates of a fit; 0 for parameters that it does not have."""
    if fit is None:
        return np.zeros(len(priors))
    values = {one.name: one.value for one in fit.parameters}
    values |= dict(zip(_SCATTER_NAMES, astuple(fit.scatter), strict=True))
    return np.array([_coordinate(one, values[one.name]) if one.name in values else 0.0 for one in priors])


def _values(coordinates: FloatArray, priors: tuple[Prior, ...]) -> list[float]:
    """Convert coordinates, in prior standard deviations from the prior, into values."""
    return [
        float(one.value * np.exp(c * one.sigma) if one.relative else one.value + c * one.sigma)
        for c, one in zip(coordinates, priors, strict=True)
    ]


def _value_scale(prior: Prior, value: float) -> float:
    """Return the change of a value per coordinate."""
    return prior.sigma * (value if prior.relative else 1.0)


def _coordinate(prior: Prior, value: float) -> float:
    """Return the distance of a value from its prior, in prior standard deviations."""
    if prior.relative:
        return float(np.log(max(value, 1e-9) / prior.value)) / prior.sigma
    return (value - prior.value) / prior.sigma


def learn_own_cushions(contacts: CushionContacts, solution: JointSolution, table: Table) -> LearnedTable | None:
    """Learn the cushions of a table from the contacts of one shot alone.

    Args:
        contacts: Its cushion contacts.
        solution: Its joint fit.
        table: Dimensions of the table.

    Returns:
        The table, with the cloth and the noses of the fit; None with fewer than `MIN_OWN_CONTACTS` contacts.
    """
    if len(contacts.t) < MIN_OWN_CONTACTS:
        return None
    cloth = {"sliding_friction.mu": solution.friction.sliding}
    best = learn_cushions(contacts, table.ball_radius, table.ball_mass, cloth, OWN_LAWS)[0]
    physics = best.physics_with_balls
    physics[ROLLING_MU] = solution.friction.rolling
    return LearnedTable(
        best.law, physics, best.scatter, solution.nose_offsets, MIN_NOSE_SIGMA**2 * np.eye(4),
        best.indices, best.covariance,
    )  # fmt: skip
