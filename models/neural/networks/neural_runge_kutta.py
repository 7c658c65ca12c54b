"""The neural Runge-Kutta simulator of Chen 2022, section 2.3.3: a network for the velocity, numerical steps through it.

From every visible sample two half steps lead to the next one (eqs 17 to 19); their end has to meet it (eq. 20), and the
state between them is the interpolation. The thesis prints three layers of 512 and neither activation, optimiser, number
of steps nor normalisation: ReLU, Adam for 3000 steps of all samples at once and coordinates about 1 are our choice.

Eq. 20 never sees the midpoint: a velocity sin(2 pi t) on top changes no end, so that the smoothness of the network
alone decides there.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.coordinate_scaling import Scaling, scaling
from models.neural.common.integration_steps import Euler, RungeKutta, Step
from models.neural.common.method_interface import Budget, Fitted, checked
from models.neural.common.network_training import Schedule, one_thread, train
from models.neural.common.perceptron import Perceptron, count_parameters, seeded
from models.neural.common.time_encoding import Clock

THESIS_WIDTHS = (512, 512, 512)
THESIS_SCHEDULE = Schedule()


class Velocity(nn.Module):
    """net(x(t), t) of Chen 2022: the velocity of all coordinates, in scaled units a step."""

    def __init__(self, layers: Perceptron, clock: Clock, speed: Tensor) -> None:
        super().__init__()
        self.layers, self.clock, self.speed = layers, clock, speed

    def forward(self, x: Tensor, t: Tensor) -> Tensor:
        """Coordinates (..., C) at times (..., 1) to (..., C)."""
        found: Tensor = self.layers(torch.cat([x, self.clock.tell(t)], dim=-1)) * self.speed
        return found


@dataclass(frozen=True, slots=True)
class NeuralSimulator:
    """A velocity network, a numerical step, and how often the step is taken from sample to sample."""

    name: str
    step: Step
    substeps: int = 2
    """2 to interpolate (eqs 17 to 19), 1 to extrapolate (eq. 21)."""
    widths: tuple[int, ...] = THESIS_WIDTHS
    activation: type[nn.Module] = nn.ReLU
    schedule: Schedule = THESIS_SCHEDULE
    shortest_period: float = math.inf
    """steps: of the Fourier features of time; none where infinite, as in the thesis."""
    corrected: bool = False
    """take from a state between two samples its share of the miss at the second: half of it from a midpoint."""
    dtype: torch.dtype = torch.float32

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """A network for this one motion."""
        began = time.process_time()
        t, x = checked(times, states)
        scale = scaling(t, x)
        network = self._network(scale, float(scale.steps(t)[-1]), x.shape[1] * x.shape[2], seed)
        seen = Samples.of(scale.steps(t), scale.coordinates(x), self.dtype)

        def loss() -> Tensor:
            ends = self._march(network, seen)[-1]
            return 0.5 * ((ends - seen.x[1:]) ** 2).sum(dim=-1).mean()  # eq. 20, the mean over the samples

        curve = train(network, loss, self.schedule, budget or Budget())
        motion = self._motion(network, seen, scale)
        return Fitted(motion, curve, count_parameters(network), time.process_time() - began)

    def _network(self, scale: Scaling, span: float, coordinates: int, seed: int) -> Velocity:
        clock = Clock(span, self.shortest_period)
        layers = Perceptron(
            coordinates + clock.width, coordinates, self.widths, self.activation, seeded(seed), self.dtype
        )
        return Velocity(layers, clock, torch.as_tensor(scale.speed, dtype=self.dtype))

    def _march(self, network: Velocity, seen: Samples) -> list[Tensor]:
        """States (T - 1, C) after 0, 1, ... substeps from every sample but the last."""
        h = seen.spans / self.substeps
        found = [seen.x[:-1]]
        for k in range(self.substeps):
            found.append(self.step(network, found[-1], seen.t[:-1] + k * h, h))
        return found

    @torch.no_grad()
    def _motion(self, network: Velocity, seen: Samples, scale: Scaling) -> Callable[[FloatArray], FloatArray]:
        with one_thread():
            marched = torch.stack(self._march(network, seen), dim=1)  # (T - 1, substeps + 1, C)
        miss = marched[:, -1] - seen.x[1:] if self.corrected else torch.zeros_like(seen.x[1:])

        @torch.no_grad()
        def at(times: FloatArray) -> FloatArray:
            steps = torch.as_tensor(scale.steps(times), dtype=self.dtype)[:, None]
            with one_thread():
                within = self._within(network, seen, marched, miss, steps)
                beyond = self._beyond(network, seen, steps)
            return scale.states(torch.where(steps > seen.t[-1], beyond, within).double().numpy())

        return at

    def _within(self, network: Velocity, seen: Samples, marched: Tensor, miss: Tensor, t: Tensor) -> Tensor:
        """States (M, C) at times (M, 1) between samples: whole substeps, then a part of one."""
        k = (torch.searchsorted(seen.t[:, 0], t[:, 0], right=True) - 1).clamp(0, len(seen.t) - 2)
        h = seen.spans[k] / self.substeps
        whole = ((t - seen.t[k]) / h).floor().clamp(0, self.substeps - 1)
        begin = seen.t[k] + whole * h
        found = self.step(network, marched[k, whole[:, 0].long()], begin, t - begin)
        return found - miss[k] * (t - seen.t[k]) / seen.spans[k]

    def _beyond(self, network: Velocity, seen: Samples, t: Tensor) -> Tensor:
        """States (M, C) after the last sample: substeps from it as long as they last, as in eq. 21."""
        h = torch.ones_like(seen.t[-1:]) / self.substeps  # (1, 1)
        ahead = ((t - seen.t[-1]) / h).clamp(min=0)
        path = [seen.x[-1:]]
        for k in range(int(ahead.max()) if len(t) else 0):
            path.append(self.step(network, path[-1], seen.t[-1:] + k * h, h))
        whole = ahead.floor().clamp(max=len(path) - 1)
        return self.step(network, torch.cat(path)[whole[:, 0].long()], seen.t[-1] + whole * h, (ahead - whole) * h)


@dataclass(frozen=True, slots=True)
class Samples:
    """What a network is shown: T samples of C scaled coordinates."""

    t: Tensor
    """(T, 1) steps since the first."""
    x: Tensor
    """(T, C)"""

    @classmethod
    def of(cls, t: FloatArray, x: FloatArray, dtype: torch.dtype) -> Samples:
        """From numpy."""
        return cls(torch.as_tensor(np.asarray(t), dtype=dtype)[:, None], torch.as_tensor(x, dtype=dtype))

    @property
    def spans(self) -> Tensor:
        """(T - 1, 1) steps from each sample to the next."""
        return self.t[1:] - self.t[:-1]


EULER = NeuralSimulator("Euler net", Euler())
RUNGE_KUTTA = NeuralSimulator("RK net", RungeKutta())
PRINTED = NeuralSimulator("RK net as printed", RungeKutta(late=2.0))
CORRECTED = NeuralSimulator("RK net, end miss", RungeKutta(), corrected=True)
EXTRAPOLATION = NeuralSimulator("extrapolation net", Euler(), substeps=1)
"""Eq. 21: whole steps of Euler. Between two samples it can be no better than a straight line."""
WAVES = 4.0
"""steps: twice the shortest period that samples can tell from a longer one."""
SMOOTH = NeuralSimulator(
    "RK net, tanh, L-BFGS", RungeKutta(), widths=(64, 64, 64), activation=nn.Tanh,
    schedule=Schedule(adam=500, lbfgs=2000), corrected=True, dtype=torch.float64,
)  # fmt: skip
FOURIER = replace(SMOOTH, name="RK net, Fourier features", shortest_period=WAVES)
