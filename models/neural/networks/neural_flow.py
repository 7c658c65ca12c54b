"""A law of motion that does not know the time: a network for d(q, p)/dt, learnt by shooting from sample to sample.

Coordinates q are seen, velocities or momenta p are not: p at every sample is sought together with the network, so that
the state that leaves a sample meets the next one, in q and in p. Between two samples the motions from both are blended;
after the last one the law goes on alone. Multiple shooting: Bock and Plitt 1984, doi 10.1016/S1474-6670(17)61205-9.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.coordinate_scaling import Scaling, scaling
from models.neural.common.integration_steps import Step, march, settled
from models.neural.common.method_interface import Budget, Fitted, checked
from models.neural.common.network_training import Schedule, one_thread, train
from models.neural.common.perceptron import count_parameters, seeded
from models.neural.common.spline_methods import spline

FINEST = 16
"""steps from sample to sample of the finished motion, at most: what needs more was not learnt."""
FLOW_SCHEDULE = Schedule(adam=600, rate=3e-3, lbfgs=1200)


@dataclass(frozen=True, slots=True)
class Sizes:
    """What a law of N points in D axes may know before it is learnt."""

    points: int
    """N"""
    axes: int
    """D"""
    free: Tensor
    """(C,) 1 where a coordinate moves, 0 where it never does."""
    seen: Tensor
    """(T, C) coordinates at the samples, scaled: who is near whom."""

    @property
    def coordinates(self) -> int:
        """C = N D."""
        return self.points * self.axes


class Law(Protocol):
    """A kind of law: a frozen dataclass of the sizes of its network."""

    def __call__(self, sizes: Sizes, generator: torch.Generator) -> nn.Module:
        """A fresh network of z = (q, p) (..., 2 C) to dz/dt (..., 2 C), in units in which q, p, dq/dt are about 1."""


class Shooting(nn.Module):
    """The law and the momenta at the samples."""

    def __init__(self, law: nn.Module, q: Tensor, p: Tensor, free: Tensor) -> None:
        super().__init__()
        self.law, self.q, self.free = law, q, free
        self.momenta = nn.Parameter(p)

    def slope(self, z: Tensor, _: Tensor) -> Tensor:
        """dz/dt; what never moves stays."""
        found: Tensor = self.law(z) * torch.cat([self.free, self.free])
        return found

    def states(self) -> Tensor:
        """(T, 2 C) at the samples."""
        return torch.cat([self.q, self.momenta * self.free], dim=-1)


@dataclass(frozen=True, slots=True)
class LearntFlow:
    """A law, the step through it, and how often the step is taken from sample to sample while it learns."""

    name: str
    law: Law
    step: Step
    substeps: int = 2
    schedule: Schedule = FLOW_SCHEDULE
    tolerance: float = 1e-6
    """of scaled states: the steps of the finished motion are halved until it changes by less."""

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """A law for this one motion, in float64."""
        began = time.process_time()
        t, x = checked(times, states)
        scale = scaling(t, x)
        pace = float(np.sqrt(np.mean(scale.speed**2))) or 1.0  # scaled lengths a step: the unit of velocities
        steps = torch.as_tensor(scale.steps(t) * pace)[:, None]
        network = _network(self.law, scale, t, x, pace, seed)
        spans = steps[1:] - steps[:-1]

        def loss() -> Tensor:
            z = network.states()
            miss = march(self.step, network.slope, z[:-1], steps[:-1], spans, self.substeps) - z[1:]
            half = miss.shape[-1] // 2
            return (miss[:, :half] ** 2 + (spans * miss[:, half:]) ** 2).sum(dim=-1).mean()

        curve = train(network, loss, self.schedule, budget or Budget())
        motion = self._motion(network, scale, steps, pace)
        return Fitted(motion, curve, count_parameters(network), time.process_time() - began)

    def _motion(
        self, network: Shooting, scale: Scaling, steps: Tensor, pace: float
    ) -> Callable[[FloatArray], FloatArray]:
        @torch.no_grad()
        def at(times: FloatArray) -> FloatArray:
            t = torch.as_tensor(scale.steps(times) * pace)[:, None]
            with one_thread():
                found = torch.where(t > steps[-1], self._beyond(network, steps, t), self._within(network, steps, t))
            return scale.states(found[:, : scale.centre.size].numpy())

        return at

    def _within(self, network: Shooting, steps: Tensor, t: Tensor) -> Tensor:
        """States (M, 2 C) at times (M, 1): the motion from the sample before, and back from the one after."""
        z = network.states()
        k = (torch.searchsorted(steps[:, 0], t[:, 0], right=True) - 1).clamp(0, len(steps) - 2)
        begin, end = steps[k], steps[k + 1]
        until = torch.minimum(t, end)
        ahead = settled(self.step, network.slope, z[k], begin, until - begin, self.tolerance, FINEST)
        back = settled(self.step, network.slope, z[k + 1], end, until - end, self.tolerance, FINEST)
        share = ((t - begin) / (end - begin)).clamp(0.0, 1.0)
        weight = share**2 * (3 - 2 * share)
        return (1 - weight) * ahead + weight * back

    def _beyond(self, network: Shooting, steps: Tensor, t: Tensor) -> Tensor:
        """States (M, 2 C) after the last sample."""
        h = (steps[-1:] - steps[:1]) / (len(steps) - 1)  # (1, 1)
        ahead = ((t - steps[-1]) / h).clamp(min=0)
        path = [network.states()[-1:]]
        for _ in range(int(ahead.max()) if len(t) else 0):
            path.append(settled(self.step, network.slope, path[-1], h, h, self.tolerance, FINEST))
        whole = ahead.floor().clamp(max=len(path) - 1)
        rest = (ahead - whole) * h
        return settled(
            self.step, network.slope, torch.cat(path)[whole[:, 0].long()], rest, rest, self.tolerance, FINEST
        )


def _network(law: Law, scale: Scaling, t: FloatArray, x: FloatArray, pace: float, seed: int) -> Shooting:
    """A fresh law, with the velocities of a spline for momenta."""
    q = scale.coordinates(x)
    speed = spline(scale.steps(t) * pace, q, 5).derivative()(scale.steps(t) * pace)  # type: ignore[attr-defined]
    free = torch.as_tensor((scale.speed > 0).astype(np.float64))
    sizes = Sizes(*scale.shape, free, torch.as_tensor(q))
    return Shooting(law(sizes, seeded(seed)), torch.as_tensor(q), torch.as_tensor(speed), free)
