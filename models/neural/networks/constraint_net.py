"""ConstraintNet: projections on a learnt constraint (Yang, He and Zhu 2020, arXiv:2006.12745), the thesis' rival.

A network C(x) of all coordinates, no velocity, no time; its zero set stands for the rods and edges of the scene. A
guess x is projected by repeating x <- x - C(x) grad C(x) / (|grad C(x)|^2 + eps). C is never supervised: the projected
positions are, through all iterations. Here the guess is the straight line between two samples.

The protocol is meant to be fair to it. It learns from each of the two kinds of wrong positions that visible samples
offer: middles of the samples before and after, their errors left as they are and shrunk to a quarter, which is what a
line between samples misses; and samples with noise of that size. From what it learnt better, by samples held out, it
learns longer and on all samples. It needs no connectivity.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.coordinate_scaling import Scaling, scaling
from models.neural.common.method_interface import Budget, Fitted, checked
from models.neural.common.network_training import Schedule, one_thread, train
from models.neural.common.perceptron import Perceptron, count_parameters, seeded
from models.neural.common.spline_methods import spline
from models.neural.networks.hamiltonian_network import gradient

SMALLEST_GRADIENT = 1e-7
"""its square is this far from 0 at least."""
HELD_OUT = 4
"""every so many-th sample but the first and last chooses between the kinds of training."""
SHRUNK = 0.25
"""A line over half the time misses a quarter."""
NOISY_COPIES = 2
"""of every sample."""
STARTS = 2
"""first networks tried with each kind of pairs: some end on a flat C, whose zero set is a plane through the samples."""
CHOOSING = 0.25
"""share of the effort for each of the trainings that only choose; together they take as long as the last one."""
CONSTRAINT_SCHEDULE = Schedule(adam=600, rate=1e-3, last_rate=1e-6, clip=1.0)
"""The paper: 600 to 1000 epochs, the rate falling by a fifth every 20."""


class Constraint(nn.Module):
    """C(x), and the projection on where it vanishes."""

    def __init__(self, layers: Perceptron, iterations: int) -> None:
        super().__init__()
        self.layers, self.iterations = layers, iterations

    def forward(self, x: Tensor) -> Tensor:
        """Coordinates (B, C) to the projected ones."""
        for _ in range(self.iterations):
            slope = gradient(self.layers, x)
            x = x - self.layers(x) / ((slope**2).sum(dim=-1, keepdim=True) + SMALLEST_GRADIENT) * slope
        return x


@dataclass(frozen=True, slots=True)
class Pairs:
    """Wrong positions (B, C) and right ones."""

    wrong: Tensor
    right: Tensor

    def kept(self, which: Tensor) -> Pairs:
        """Some of them."""
        return Pairs(self.wrong[which], self.right[which])

    def shrunk(self) -> Pairs:
        """With errors as small as those of a line over half the time."""
        return Pairs(self.right + SHRUNK * (self.wrong - self.right), self.right)


@dataclass(frozen=True, slots=True)
class ConstraintNet:
    """Sizes of the paper: 4 layers of 256 (512 with collisions); 5 projections of a rigid body, 8 or 10 of others."""

    name: str = "ConstraintNet"
    widths: tuple[int, ...] = (256, 256, 256, 256)
    iterations: int = 8
    activation: type[nn.Module] = nn.LeakyReLU
    schedule: Schedule = CONSTRAINT_SCHEDULE
    dtype: torch.dtype = torch.float32

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """Short trainings of every kind and start; the best goes on with all samples."""
        began = time.process_time()
        t, x = checked(times, states)
        scale = scaling(t, x)
        seen = torch.as_tensor(scale.coordinates(x), dtype=self.dtype)
        network, curve = self._chosen(seen, torch.as_tensor(t, dtype=self.dtype), seed, budget or Budget())
        lines = spline(t, x, 1)
        motion = self.motion(network, lines, scale)
        return Fitted(motion, curve, count_parameters(network), time.process_time() - began)

    def _chosen(self, seen: Tensor, t: Tensor, seed: int, budget: Budget) -> tuple[Constraint, FloatArray]:
        middles = middles_of(seen, t)
        held = torch.arange(len(middles.right)) % HELD_OUT == HELD_OUT // 2
        test = middles.kept(held).shrunk()
        kinds = KINDS * STARTS
        short = Budget(budget.effort * CHOOSING, budget.seconds / 2 / len(kinds))
        tried = []
        for start, kind in enumerate(kinds):
            network = self.fresh(middles.right, 1000 * seed + start)
            curve = self._train(network, kind(middles.kept(~held), seed), short)
            tried.append((float(missed(network, test).detach()), start, network, curve, kind))
        _, _, network, curve, kind = min(tried)
        last = Budget(budget.effort, budget.seconds / 2)
        return network, np.concatenate([curve, self._train(network, kind(middles, seed), last)])

    def fresh(self, seen: Tensor, seed: int) -> Constraint:
        """An untrained network of coordinates like those that were seen (T, C)."""
        layers = Perceptron(seen.shape[1], 1, self.widths, self.activation, seeded(seed), self.dtype)
        with torch.no_grad():  # a first C that vanishes near the samples, or the first projections go anywhere
            layers.last.bias.sub_(layers(seen).mean())
        return Constraint(layers, self.iterations)

    def _train(self, network: Constraint, pairs: Pairs, budget: Budget) -> FloatArray:
        return train(network, lambda: missed(network, pairs), self.schedule, budget)

    def motion(
        self, network: Constraint, lines: Callable[[FloatArray], FloatArray], scale: Scaling
    ) -> Callable[[FloatArray], FloatArray]:
        """Lines through samples, projected."""

        def at(times: FloatArray) -> FloatArray:
            guess = torch.as_tensor(scale.coordinates(lines(times)), dtype=self.dtype)
            with one_thread(), torch.no_grad():
                return scale.states(network(guess).double().numpy())

        return at


def missed(network: Constraint, pairs: Pairs) -> Tensor:
    """Mean absolute error of projected positions."""
    error: Tensor = (network(pairs.wrong) - pairs.right).abs().mean()
    return error


def middles_of(seen: Tensor, t: Tensor) -> Pairs:
    """Every sample (T - 2, C) but the ends, and where a straight line between its neighbours has it."""
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    return Pairs((1 - share) * seen[:-2] + share * seen[2:], seen[1:-1])


def both_sizes(middles: Pairs, seed: int) -> Pairs:
    """Middles (2 B, C) as they are, and with their errors shrunk."""
    shrunk = middles.shrunk()
    return Pairs(torch.cat([middles.wrong, shrunk.wrong]), torch.cat([middles.right, shrunk.right]))


def noised(middles: Pairs, seed: int) -> Pairs:
    """The right positions (2 B, C), with noise as large as what a line between samples misses."""
    right = middles.right.repeat(NOISY_COPIES, 1)
    sigma = SHRUNK * (middles.wrong - middles.right).square().mean(dim=0).sqrt()
    return Pairs(right + sigma * torch.randn(right.shape, generator=seeded(seed), dtype=right.dtype), right)


KINDS = (both_sizes, noised)
CONSTRAINT_NET = ConstraintNet()
