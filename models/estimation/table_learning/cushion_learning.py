"""Cushion model of a table learned from its contacts: parameters, scatter and decay of side spin by maximum posterior.

The side spin of every contact is summed over (`side_spin`), so that the likelihood depends on the shared parameters
alone: a dozen numbers whatever the number of shots.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace
from functools import lru_cache

import numpy as np

from models.core.contact_graph import JointSolution
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.core.typing import FloatArray, IntArray
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER, ContactScatter, LearnedTable
from models.estimation.table_learning.side_spin import Rebounds, filter_side_spin, predict_rebounds
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
from models.physics.effects.catalogue import find_prior

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
# Predictions that are kept: scatter and decay change nothing in them.
_REMEMBERED = 4
# Of the search.
_ITERATIONS = 40
# Step of second differences, in prior standard deviations.
_HESSIAN_STEP = 0.02
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
) -> tuple[CushionFit, ...]:
    """Fit every cushion model to the contacts of a table.

    Args:
        contacts: Contacts of all shots.
        radius: m, of the balls.
        mass: kg, of the balls.
        cloth: Parameters of the cloth by `effect.parameter`; some cushion models read sliding friction.
        laws: Names of the cushion models to fit.

    Returns:
        One fit per model, that of greatest evidence first. Of many contacts, a part decides between the models.
    """
    part, fits = _thin_chains(contacts), list[CushionFit]()
    for law in laws:
        fits.append(_fit_model(law, part, radius, mass, cloth, fits[0] if fits else None))
        fits.sort(key=lambda one: -one.log_evidence)
    if len(part.t) < len(contacts.t):
        best = _fit_model(fits[0].law, contacts, radius, mass, cloth, fits[0])
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


def _fit_model(
    law: str,
    contacts: CushionContacts,
    radius: float,
    mass: float,
    cloth: dict[str, float],
    neighbour: CushionFit | None,
) -> CushionFit:
    """Find the greatest posterior of one model by L-BFGS, in prior standard deviations.

    The search starts from the values of a neighbour, the best other model, else from the priors.
    """
    from scipy.optimize import minimize  # slow to import

    priors = _list_unknowns(law)
    low, high = _coordinate_bounds(priors)
    first = np.clip(_read_coordinates(neighbour, priors), low, high)
    fixed = neutral_parameters()
    for name, value in cloth.items():
        fixed[PARAMETER_NAMES.index(name)] = value

    @lru_cache(maxsize=_REMEMBERED)
    def predict(values: bytes) -> Rebounds:
        return predict_rebounds(contacts, CUSHION_MODELS.index(law), np.frombuffer(values), radius, mass)

    def cost(coordinates: FloatArray) -> float:
        physics, scatter = _decode(coordinates, priors, fixed)
        decay, physics[SPIN_DECAY] = float(physics[SPIN_DECAY]), 0.0  # contacts do not depend on it
        result = filter_side_spin(contacts, predict(physics.tobytes()), radius, scatter, decay)
        return 0.5 * float(coordinates @ coordinates) - float(result.log_likelihood.sum())

    best = minimize(
        cost, first, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)), options={"maxiter": _ITERATIONS}
    )
    hessian = _differentiate_twice(cost, best.x, low, high)
    curvatures, vectors = np.linalg.eigh(hessian)
    curvatures = np.maximum(curvatures, 1.0)  # that of the prior
    covariance = (vectors / curvatures) @ vectors.T
    spread = np.sqrt(np.diag(covariance))
    physics, scatter = _decode(best.x, priors, fixed)
    parameters = tuple(
        Parameter(one.name, v, s * _value_scale(one, v), one.unit, bool(s > _PRIOR_DOMINATED))
        for one, v, s in zip(priors, _values(best.x, priors), spread, strict=True)
        if one.name not in _SCATTER_NAMES
    )
    scale = np.array([_value_scale(one, v) for one, v in zip(priors, _values(best.x, priors), strict=True)])
    own = slice(0, len(parameters))
    evidence = -float(best.fun) - 0.5 * float(np.log(curvatures).sum())
    return CushionFit(law, parameters, scatter, physics, (covariance * scale * scale[:, None])[own, own], evidence)


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


def _coordinate_bounds(priors: tuple[Prior, ...]) -> tuple[FloatArray, FloatArray]:
    """Return the bounds of the coordinates."""
    edges = np.array([[_coordinate(one, edge) for edge in one.bounds] for one in priors])
    return edges[:, 0], edges[:, 1]


def _coordinate(prior: Prior, value: float) -> float:
    """Return the distance of a value from its prior, in prior standard deviations."""
    if prior.relative:
        return float(np.log(max(value, 1e-9) / prior.value)) / prior.sigma
    return (value - prior.value) / prior.sigma


def _decode(coordinates: FloatArray, priors: tuple[Prior, ...], fixed: FloatArray) -> tuple[FloatArray, ContactScatter]:
    """Convert coordinates into the parameters (P,) of the engine and the scatter."""
    physics, values = fixed.copy(), _values(coordinates, priors)
    for one, value in zip(priors[: -len(_SCATTER_NAMES)], values, strict=False):
        physics[PARAMETER_NAMES.index(one.name)] = value
    return physics, ContactScatter(*values[-len(_SCATTER_NAMES) :])


def _differentiate_twice(cost, best: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:  # type: ignore[no-untyped-def]
    """Compute the Hessian of a cost by central differences, inside its bounds."""
    size, step = len(best), _HESSIAN_STEP
    centre = np.clip(best, low + step, high - step)
    middle, hessian = cost(centre), np.empty((size, size))
    shift = step * np.eye(size)
    ahead = [cost(centre + one) for one in shift]
    behind = [cost(centre - one) for one in shift]
    for i in range(size):
        hessian[i, i] = (ahead[i] + behind[i] - 2 * middle) / step**2
        for j in range(i):
            cross = cost(centre + shift[i] + shift[j]) + cost(centre - shift[i] - shift[j])
            rest = ahead[i] + ahead[j] + behind[i] + behind[j] - 2 * middle
            hessian[i, j] = hessian[j, i] = (cross - rest) / (2 * step**2)
    return hessian


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
