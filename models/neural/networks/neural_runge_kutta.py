"""The neural Runge-Kutta simulator of Chen 2022, section 2.3.3: a velocity network and numerical steps through it.

Two half steps lead from every visible sample to the next one (Chen 2022, eq. 17, eq. 18 and eq. 19). Their end must
match that sample (eq. 20), and the state between them is the interpolation. The thesis states three layers of 512, but
no activation, optimiser, number of steps or normalisation. ReLU, Adam with 3000 full-batch steps, and coordinates
scaled to about 1 are the choice of this implementation.

The loss of eq. 20 does not contain the midpoint: an additional velocity sin(2 pi t) changes no end. Only the smoothness
of the network determines the midpoint.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.integration_steps import EulerStep, IntegrationStep, RungeKuttaStep
from models.neural.common.method_interface import (
    FittedMotion,
    Scaling,
    TrainingBudget,
    estimate_scaling,
    validate_samples,
)
from models.neural.common.network_training import (
    Motion,
    Perceptron,
    TrainingSchedule,
    make_generator,
    summarize_training,
    train_network,
    use_one_thread,
)

THESIS_WIDTHS = (512, 512, 512)
THESIS_SCHEDULE = TrainingSchedule()


class VelocityNetwork(nn.Module):
    """net(x(t), t) of Chen 2022: the velocity of all C coordinates, in scaled units per step."""

    def __init__(self, layers: Perceptron, clock: TimeEncoding, speed: Tensor) -> None:
        super().__init__()
        self.layers, self.time_encoding, self.speed = layers, clock, speed

    def forward(self, x: Tensor, t: Tensor) -> Tensor:
        """Evaluate velocities (..., C) at coordinates (..., C) and times (..., 1)."""
        velocity: Tensor = self.layers(torch.cat([x, self.time_encoding.encode(t)], dim=-1)) * self.speed
        return velocity


@dataclass(frozen=True, slots=True)
class NeuralSimulator:
    """Method that learns a velocity network through numerical integration steps (Chen 2022, section 2.3.3)."""

    name: str
    step: IntegrationStep
    substeps: int = 2
    """Integration steps from sample to sample: 2 interpolate (Chen 2022, eq. 17 to 19), 1 extrapolates (eq. 21)."""
    widths: tuple[int, ...] = THESIS_WIDTHS
    activation: type[nn.Module] = nn.ReLU
    schedule: TrainingSchedule = THESIS_SCHEDULE
    shortest_period: float = math.inf
    """Shortest period of the Fourier features of time, in steps; infinite: no features, as in the thesis."""
    corrects_end_error: bool = False
    """Whether the error at the end of an interval is subtracted linearly from the states in it: half of it at the
    midpoint."""
    dtype: torch.dtype = torch.float32

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Train a network for one motion; arguments as in `MotionMethod.fit`."""
        began = time.process_time()
        t, x = validate_samples(times, states)
        scale = estimate_scaling(t, x)
        network = self._build_network(scale, float(scale.count_steps(t)[-1]), x.shape[1] * x.shape[2], seed)
        samples = TrainingSamples.from_arrays(scale.count_steps(t), scale.scale_states(x), self.dtype)

        def loss() -> Tensor:
            ends = self._integrate_substeps(network, samples)[-1]
            return (
                0.5 * ((ends - samples.x[1:]) ** 2).sum(dim=-1).mean()
            )  # Chen 2022, eq. 20, averaged over the samples

        def build_motion() -> Motion:
            return self._build_motion(network, samples, scale)

        result = train_network(network, loss, self.schedule, budget or TrainingBudget(), build_motion)
        return summarize_training(build_motion(), result, network, began)

    def _build_network(self, scale: Scaling, span: float, coordinates: int, seed: int) -> VelocityNetwork:
        clock = TimeEncoding(span, self.shortest_period)
        layers = Perceptron(
            coordinates + clock.width, coordinates, self.widths, self.activation, make_generator(seed), self.dtype
        )
        return VelocityNetwork(layers, clock, torch.as_tensor(scale.speed, dtype=self.dtype))

    def _integrate_substeps(self, network: VelocityNetwork, samples: TrainingSamples) -> list[Tensor]:
        """Integrate from every sample but the last (Chen 2022, eq. 17 to 19); states (T - 1, C) after each substep."""
        h = samples.intervals / self.substeps
        states = [samples.x[:-1]]
        for k in range(self.substeps):
            states.append(self.step(network, states[-1], samples.t[:-1] + k * h, h))
        return states

    @torch.no_grad()
    def _build_motion(self, network: VelocityNetwork, samples: TrainingSamples, scale: Scaling) -> Motion:
        with use_one_thread():
            substates = torch.stack(self._integrate_substeps(network, samples), dim=1)  # (T - 1, substeps + 1, C)
        end_error = substates[:, -1] - samples.x[1:] if self.corrects_end_error else torch.zeros_like(samples.x[1:])

        @torch.no_grad()
        def at(times: FloatArray) -> FloatArray:
            steps = torch.as_tensor(scale.count_steps(times), dtype=self.dtype)[:, None]
            with use_one_thread():
                within = self._interpolate_states(network, samples, substates, end_error, steps)
                beyond = self._extrapolate_states(network, samples, steps)
            return scale.restore_states(torch.where(steps > samples.t[-1], beyond, within).double().numpy())

        return at

    def _interpolate_states(
        self, network: VelocityNetwork, samples: TrainingSamples, substates: Tensor, end_error: Tensor, t: Tensor
    ) -> Tensor:
        """Evaluate states (M, C) at times (M, 1) between samples: whole substeps, then a part of one."""
        k = (torch.searchsorted(samples.t[:, 0], t[:, 0], right=True) - 1).clamp(0, len(samples.t) - 2)
        h = samples.intervals[k] / self.substeps
        whole = ((t - samples.t[k]) / h).floor().clamp(0, self.substeps - 1)
        begin = samples.t[k] + whole * h
        states = self.step(network, substates[k, whole[:, 0].long()], begin, t - begin)
        return states - end_error[k] * (t - samples.t[k]) / samples.intervals[k]

    def _extrapolate_states(self, network: VelocityNetwork, samples: TrainingSamples, t: Tensor) -> Tensor:
        """Integrate from the last sample to times (M, 1), as in Chen 2022, eq. 21; states (M, C)."""
        h = torch.ones_like(samples.t[-1:]) / self.substeps  # (1, 1)
        ahead = ((t - samples.t[-1]) / h).clamp(min=0)
        path = [samples.x[-1:]]
        for k in range(int(ahead.max()) if len(t) else 0):
            path.append(self.step(network, path[-1], samples.t[-1:] + k * h, h))
        whole = ahead.floor().clamp(max=len(path) - 1)
        return self.step(network, torch.cat(path)[whole[:, 0].long()], samples.t[-1] + whole * h, (ahead - whole) * h)


@dataclass(frozen=True, slots=True)
class TrainingSamples:
    """T visible samples of C scaled coordinates."""

    t: Tensor
    """(T, 1) steps since the first sample."""
    x: Tensor
    """(T, C) scaled coordinates."""

    @classmethod
    def from_arrays(cls, t: FloatArray, x: FloatArray, dtype: torch.dtype) -> TrainingSamples:
        """Convert arrays t (T,) and x (T, C) to tensors."""
        return cls(torch.as_tensor(np.asarray(t), dtype=dtype)[:, None], torch.as_tensor(x, dtype=dtype))

    @property
    def intervals(self) -> Tensor:
        """Time (T - 1, 1) from each sample to the next, in the unit of `t`."""
        return self.t[1:] - self.t[:-1]


EULER_NET = NeuralSimulator("Euler net", EulerStep())
RUNGE_KUTTA_NET = NeuralSimulator("RK net", RungeKuttaStep())
PRINTED_NET = NeuralSimulator("RK net as printed", RungeKuttaStep(time_factor=2.0))
CORRECTED_NET = NeuralSimulator("RK net, end miss", RungeKuttaStep(), corrects_end_error=True)
# Chen 2022, eq. 21: whole Euler steps. Between two samples it can be no better than a straight line.
EXTRAPOLATION_NET = NeuralSimulator("extrapolation net", EulerStep(), substeps=1)
# Shortest Fourier period, in steps: twice the Nyquist period of the samples.
FOURIER_PERIOD = 4.0
SMOOTH_NET = NeuralSimulator(
    "RK net, tanh, L-BFGS", RungeKuttaStep(), widths=(64, 64, 64), activation=nn.Tanh,
    schedule=TrainingSchedule(adam_steps=500, lbfgs_evaluations=2000), corrects_end_error=True, dtype=torch.float64,
)  # fmt: skip
FOURIER_NET = replace(SMOOTH_NET, name="RK net, Fourier features", shortest_period=FOURIER_PERIOD)


@dataclass(frozen=True, slots=True)
class TimeEncoding:
    """Time scaled to -1 to 1, optionally with Fourier features."""

    span: float
    """Steps from the first sample to the last."""
    shortest_period: float = math.inf
    """Shortest period of a Fourier feature, in steps. At periods of 2 and below, a network can move midpoints without
    changing its loss."""

    @property
    def harmonic_count(self) -> int:
        """Number of harmonics of the whole series."""
        return int(self.span / self.shortest_period)

    @property
    def width(self) -> int:
        """Number of inputs that encode one time."""
        return 1 + 2 * self.harmonic_count

    def encode(self, t: Tensor) -> Tensor:
        """Encode times (..., 1) in steps as inputs (..., width)."""
        plain = 2 * t / self.span - 1
        if not self.harmonic_count:
            return plain
        angle = math.pi * plain * torch.arange(1, self.harmonic_count + 1, dtype=t.dtype)
        return torch.cat([plain, torch.sin(angle), torch.cos(angle)], dim=-1)
