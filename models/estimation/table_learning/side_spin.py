"""Side spin, which no frame shows, as a distribution on a grid that every cushion contact of a ball narrows.

A spin that grips the nose one way or the other can explain the same contact, so that its distribution may have several
peaks: a grid keeps them all. The filter goes through the contacts of a chain: the cloth brakes the spin, a contact of
balls blurs it, a cushion weighs every value by how well the contact model then predicts velocity and slip after the
contact, and maps it to the spin that is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.table_learning.cushion_contacts import CushionContacts, SpinHistory, SpinLink
from models.estimation.table_learning.learned_table import DEGREES_OF_FREEDOM, ContactScatter, LearnedTable
from models.numerics.jit import compile_kernel
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION, correct_rebound
from models.physics.billiards.parameter_vector import SPIN_DECAY
from models.physics.billiards.simulation.contact_resolution import rebound_with_slip

# Values of the grid; a step is far less than what one contact resolves.
GRID_SIZE = 121
# The contact model is evaluated at every sixth value of the grid; its smooth result is interpolated between them.
NODE_STRIDE = 6
# Largest surface speed of side spin on the grid, over the greatest speed of the chain: 5/4 after a strike at R/2.
GRID_REACH = 1.3
# m/s, added to that.
GRID_REACH_AT_REST = 0.2
# m/s: slower contacts scatter as if they had this speed.
MIN_CONTACT_SPEED = 0.1
# Prior standard deviations that the grid of a spin without any contact covers.
_WIDE_REACH = 3.0
# m/s, least step of the mean slopes of a contact model by its inputs, which are taken over their standard deviations: a
# nose that slips or sticks makes a kink, at which a derivative would jump.
_LEAST_STEP = 1e-3
# (m/s)^2
_LEAST_VARIANCE = 1e-8


@dataclass(frozen=True, slots=True)
class SpinDistribution:
    """Distribution of the surface speed of side spin of one ball."""

    grid: FloatArray
    """(G,) m/s, even."""
    probability: FloatArray
    """(G,)"""

    @property
    def mean(self) -> float:
        """m/s."""
        return float(self.grid @ self.probability)

    @property
    def sigma(self) -> float:
        """m/s."""
        return float(np.sqrt(self.probability @ (self.grid - self.mean) ** 2))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw values (count,) m/s, evenly within a step of the grid."""
        chosen = rng.choice(len(self.grid), count, p=self.probability / self.probability.sum())
        step = self.grid[1] - self.grid[0]
        return np.asarray(self.grid[chosen] + step * (rng.random(count) - 0.5))


@dataclass(frozen=True, slots=True)
class SpinFilter:
    """Result of the filter for K contacts."""

    log_likelihood: FloatArray
    """(K,) of each contact, given those before it in its chain."""
    grid: FloatArray
    """(K, G) m/s: surface speeds of side spin."""
    before: FloatArray
    """(K, G) probabilities of the spin before each contact, given this contact and the earlier ones of its chain."""
    after: FloatArray
    """(K, G) probabilities of the spin after each contact, given the same."""
    deviation: FloatArray
    """(K, 4) observed minus predicted state after each contact, at the mean spin; shares of the speed."""

    @property
    def mean_before(self) -> FloatArray:
        """(K,) m/s."""
        return np.asarray((self.grid * self.before).sum(axis=1))


@dataclass(frozen=True, slots=True)
class Rebounds:
    """What a cushion model predicts for K contacts; it depends on its parameters alone."""

    grid: FloatArray
    """(K, G) m/s: surface speeds of side spin before the contact."""
    predicted: FloatArray
    """(K, G, 5) after it: velocity along n and t, slip along n and t, surface speed of side spin."""
    by_before: FloatArray
    """(K, 4, 4) mean slopes of the first four by the state before, within its errors, without side spin."""


def predict_rebounds(
    contacts: CushionContacts, law: int, physics: FloatArray, radius: float, mass: float,
    correction: FloatArray = NO_CORRECTION,
) -> Rebounds:  # fmt: skip
    """Predict the state after every contact for every value of side spin before it.

    Args:
        contacts: K cushion contacts.
        law: Index of the cushion model in `CUSHION_MODELS`.
        physics: (P,) physical parameters.
        radius: m, of the balls.
        mass: kg, of the balls.
        correction: Weights of `rebound_correction`, or none.

    Returns:
        The predictions.
    """
    count, physics = len(contacts.t), np.require(physics, requirements="W")  # one type of argument to compile for
    grid = _build_grids(contacts)
    nodes = np.empty((count, (GRID_SIZE - 1) // NODE_STRIDE + 1, 5))
    places = np.ascontiguousarray(grid[:, ::NODE_STRIDE])
    _predict_contacts(law, contacts.before, places, radius, mass, physics, correction, nodes)
    zero, ahead, behind = np.zeros((count, 1)), np.empty((count, 1, 5)), np.empty((count, 1, 5))
    spread = np.sqrt(np.einsum("kii->ki", contacts.covariance)[:, :4])
    by_before = np.empty((count, 4, 4))
    for k in range(4):
        low, high = contacts.before.copy(), contacts.before.copy()
        low[:, k] -= np.maximum(spread[:, k], _LEAST_STEP)
        high[:, k] += np.maximum(spread[:, k], _LEAST_STEP)
        low[:, 0] = np.maximum(low[:, 0], 0.5 * contacts.before[:, 0])  # it moves into the cushion
        _predict_contacts(law, low, zero, radius, mass, physics, correction, behind)
        _predict_contacts(law, high, zero, radius, mass, physics, correction, ahead)
        by_before[:, :, k] = (ahead[:, 0, :4] - behind[:, 0, :4]) / (high[:, k] - low[:, k])[:, None]
    return Rebounds(grid, _interpolate_nodes(nodes), by_before)


def filter_side_spin(
    contacts: CushionContacts, rebounds: Rebounds, radius: float, scatter: ContactScatter, decay: float
) -> SpinFilter:
    """Filter the side spin of every chain.

    Args:
        contacts: K cushion contacts.
        rebounds: What a cushion model predicts for them.
        radius: m, of the balls.
        scatter: Scatter of contacts about the model.
        decay: rad/s^2, deceleration of side spin.

    Returns:
        The log likelihood of each contact, and the distribution of the spin.
    """
    grid, predicted = rebounds.grid, rebounds.predicted
    speed = np.maximum(contacts.speed, MIN_CONTACT_SPEED)
    whitening, log_root = whiten_innovations(contacts, rebounds.by_before, scatter)
    evidence = np.empty(grid.shape)
    _weigh_spins(predicted, contacts.after, whitening, log_root, evidence)
    before, after, likelihood = np.empty_like(evidence), np.empty_like(evidence), np.empty(len(grid))
    _filter_chains(
        grid, evidence, np.ascontiguousarray(predicted[..., 4]), contacts.begins, contacts.elapsed, contacts.spin_sigma,
        scatter.side_spin * speed, decay * radius, before, after, likelihood,
    )  # fmt: skip
    expected = np.einsum("kg,kgi->ki", before, predicted[..., :4])
    return SpinFilter(likelihood, grid, before, after, (contacts.after - expected) / speed[:, None])


def brake_spin(grid: FloatArray, probability: FloatArray, loss: float, blur: float) -> FloatArray:
    """Let a distribution (G,) of surface speeds on an even grid (G,) lose `loss` m/s and blur by `blur` m/s."""
    out = np.empty_like(probability)
    _move_distribution(grid, probability, np.sign(grid) * np.maximum(np.abs(grid) - loss, 0.0), blur, out)
    return out


def _build_grids(contacts: CushionContacts) -> FloatArray:
    """Build an even grid (K, G) that is the same for all contacts of a chain."""
    chain = np.cumsum(contacts.begins) - 1
    fastest = np.zeros(int(chain[-1]) + 1 if len(chain) else 0)
    np.maximum.at(fastest, chain, np.maximum(contacts.speed, contacts.spin_sigma * contacts.begins))
    reach = GRID_REACH * fastest[chain] + GRID_REACH_AT_REST
    return np.asarray(reach[:, None] * np.linspace(-1.0, 1.0, GRID_SIZE))


def _interpolate_nodes(nodes: FloatArray) -> FloatArray:
    """Interpolate the states (K, J, 5) at every `NODE_STRIDE`th value of the grid to all values (K, G, 5)."""
    share = (np.arange(NODE_STRIDE) / NODE_STRIDE)[:, None]
    between = nodes[:, :-1, None] * (1 - share) + nodes[:, 1:, None] * share
    return np.concatenate([between.reshape(len(nodes), GRID_SIZE - 1, nodes.shape[2]), nodes[:, -1:]], axis=1)


def whiten_innovations(
    contacts: CushionContacts, by_before: FloatArray, scatter: ContactScatter
) -> tuple[FloatArray, FloatArray]:
    """Compute the whitening of observed minus predicted states.

    Args:
        contacts: K cushion contacts.
        by_before: (K, 4, 4) as in `Rebounds`.
        scatter: Scatter of contacts about the model.

    Returns:
        (K, 4, 4) lower triangular whitening, and the logarithm (K,) of its determinant.
    """
    speed = np.maximum(contacts.speed, MIN_CONTACT_SPEED)
    identity = np.broadcast_to(np.eye(4), by_before.shape)
    both = np.concatenate([-by_before, identity], axis=2)
    total = both @ contacts.covariance @ both.swapaxes(1, 2)
    total = total + np.eye(4) * ((scatter.shares[:4] * speed[:, None]) ** 2 + _LEAST_VARIANCE)[:, None]
    whitening = np.linalg.inv(np.linalg.cholesky(total))
    return whitening, np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1)


def infer_side_spins(
    contacts: CushionContacts, histories: tuple[SpinHistory, ...], since: dict[int, float], table: LearnedTable,
    radius: float, mass: float,
) -> dict[int, SpinDistribution]:  # fmt: skip
    """Infer the side spin of every moving ball from all cushion contacts of its shot.

    Args:
        contacts: Cushion contacts of the shot.
        histories: What happened to each moving ball since its last one.
        since: By ball, s since its last segment began.
        radius: m, of the balls.
        mass: kg, of the balls.

    Returns:
        The distribution by ball.
    """
    decay = float(table.physics[SPIN_DECAY])
    rebounds = predict_rebounds(contacts, table.law_code, table.physics, radius, mass, table.correction)
    filtered = filter_side_spin(contacts, rebounds, radius, table.scatter, decay)
    spins = {}
    for history in histories:
        link = history.link._replace(elapsed=history.link.elapsed + since[history.ball])
        if history.contact < 0:
            grid, start = _spread_prior(link)
            blur = 0.0
        else:
            grid, start, blur = filtered.grid[history.contact], filtered.after[history.contact], link.sigma
        loss = decay * radius * link.elapsed
        spins[history.ball] = SpinDistribution(grid, brake_spin(grid, start, loss, blur))
    return spins


def _spread_prior(link: SpinLink) -> tuple[FloatArray, FloatArray]:
    """Return a grid (G,) and the normal prior of a spin at the start of its chain on it."""
    reach = _WIDE_REACH * link.sigma + GRID_REACH_AT_REST
    grid = np.linspace(-reach, reach, GRID_SIZE)
    weight = np.exp(-0.5 * (grid / link.sigma) ** 2)
    return grid, weight / weight.sum()


@compile_kernel
def _predict_contacts(law, before, grid, radius, mass, physics, correction, out):  # type: ignore[no-untyped-def]
    """Write the states (K, G, 5) after contacts: velocity n, t, slip n, t, surface speed of side spin."""
    state = np.empty(5)
    for k in range(len(before)):
        state[:4] = before[k]
        for g in range(grid.shape[1]):
            state[4] = grid[k, g]
            rebound_with_slip(law, state, radius, mass, physics, out[k, g])
            correct_rebound(correction, state, out[k, g])


@compile_kernel
def _weigh_spins(predicted, after, whitening, log_root, out):  # type: ignore[no-untyped-def]
    """Write the log likelihood (K, G) of the states `after` (K, 4), by Student's t distribution."""
    nu = DEGREES_OF_FREEDOM
    for k in range(len(after)):
        for g in range(predicted.shape[1]):
            squares = 0.0
            for i in range(4):
                z = 0.0
                for j in range(i + 1):
                    z += whitening[k, i, j] * (after[k, j] - predicted[k, g, j])
                squares += z * z
            # up to a constant; the scale makes the variance that of the covariance
            out[k, g] = log_root[k] - 0.5 * (nu + 4.0) * np.log1p(squares / (nu - 2.0))


@compile_kernel
def _move_distribution(grid, probability, target, blur, out):  # type: ignore[no-untyped-def]
    """Write the distribution (G,) after every value of the grid moved to `target` (G,) and was blurred by `blur`."""
    size, step = len(grid), grid[1] - grid[0]
    moved = np.zeros(size)
    for g in range(size):
        place = min(max((target[g] - grid[0]) / step, 0.0), size - 1.000001)
        low = int(place)
        moved[low] += probability[g] * (1.0 - (place - low))
        moved[low + 1] += probability[g] * (place - low)
    reach = int(np.ceil(4.0 * blur / step))
    if reach == 0:
        out[:] = moved
        return
    kernel = np.empty(2 * reach + 1)
    for j in range(-reach, reach + 1):
        kernel[j + reach] = np.exp(-0.5 * (j * step / blur) ** 2)
    kernel /= kernel.sum()
    out[:] = 0.0
    for g in range(size):
        if moved[g] == 0.0:
            continue
        for j in range(-reach, reach + 1):
            out[min(max(g + j, 0), size - 1)] += moved[g] * kernel[j + reach]


@compile_kernel
def _filter_chains(grid, evidence, left, begins, elapsed, spin_sigma, blur, decay, before, after, likelihood):  # type: ignore[no-untyped-def]
    """Fill before (K, G), after (K, G) and likelihood (K,).

    left (K, G) is the side spin that a contact leaves, blur (K,) its scatter (m/s), decay in m/s^2.
    """
    size = grid.shape[1]
    prior, target = np.empty(size), np.empty(size)
    for k in range(len(grid)):
        step, loss = grid[k, 1] - grid[k, 0], decay * elapsed[k]
        for g in range(size):
            target[g] = np.sign(grid[k, g]) * max(abs(grid[k, g]) - loss, 0.0)
        if begins[k]:
            wide = max(spin_sigma[k], step)
            for g in range(size):
                after[k, g] = np.exp(-0.5 * (grid[k, g] / wide) ** 2)
            after[k] /= after[k].sum()
            _move_distribution(grid[k], after[k], target, 0.0, prior)
        else:
            _move_distribution(grid[k], after[k - 1], target, spin_sigma[k], prior)
        most = evidence[k].max()
        total = 0.0
        for g in range(size):
            before[k, g] = prior[g] * np.exp(evidence[k, g] - most)
            total += before[k, g]
        likelihood[k] = most + np.log(total + 1e-300)
        before[k] /= total + 1e-300
        _move_distribution(grid[k], before[k], left[k], blur[k], after[k])
