"""Time-independent vector fields: a network for d(q, p)/dt, trained by multiple shooting from sample to sample.

Coordinates q are observed; velocities or momenta p are not. p at every sample is estimated together with the network,
so that the state integrated from one sample matches the next one, in q and in p. Between two samples the motions from
both are blended; after the last one the vector field is integrated. Multiple shooting: Bock and Plitt 1984,
doi:10.1016/S1474-6670(17)61205-9.

The plain fields are built here: Newton's second law with net(x, v) for the acceleration, and a network for dz/dt.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
from models.neural.common.integration_steps import (
    IntegrationStep,
    RungeKuttaStep,
    integrate_steps,
    integrate_to_tolerance,
)
from models.neural.common.method_interface import (
    FittedMotion,
    Scaling,
    TrainingBudget,
    estimate_scaling,
    fit_spline,
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

# Most integration steps from sample to sample in the evaluation; a field that needs more was not learned.
MAX_SUBSTEPS = 16
FLOW_SCHEDULE = TrainingSchedule(adam_steps=600, learning_rate=3e-3, lbfgs_evaluations=1200)


@dataclass(frozen=True, slots=True)
class FlowDimensions:
    """Dimensions and samples of a motion of N points in D axes, with C = N D coordinates, before training."""

    points: int
    """Number of points N."""
    axes: int
    """Number of axes D."""
    free: Tensor
    """(C,) 1 for a coordinate that changes, 0 for one that never does."""
    samples: Tensor
    """(T, C) scaled coordinates at the samples, which determine neighbours."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates C = N D."""
        return self.points * self.axes


# Builds a network from z = (q, p) (..., 2 C) to dz/dt (..., 2 C), in units in which q, p, dq/dt are about 1.
FlowArchitecture = Callable[[FlowDimensions, torch.Generator], nn.Module]


class ShootingNetwork(nn.Module):
    """The vector field and the momenta at the samples."""

    def __init__(self, law: nn.Module, q: Tensor, p: Tensor, free: Tensor) -> None:
        super().__init__()
        self.flow, self.q, self.free = law, q, free
        self.momenta = nn.Parameter(p)

    def evaluate_field(self, z: Tensor, _: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C); fixed coordinates have derivative 0."""
        derivative: Tensor = self.flow(z) * torch.cat([self.free, self.free])
        return derivative

    def sample_states(self) -> Tensor:
        """Return the states (T, 2 C) at the samples."""
        return torch.cat([self.q, self.momenta * self.free], dim=-1)


@dataclass(frozen=True, slots=True)
class NeuralFlowMethod:
    """Method that learns a vector field by multiple shooting."""

    name: str
    architecture: FlowArchitecture
    step: IntegrationStep
    substeps: int = 2
    """Integration steps from sample to sample during training."""
    schedule: TrainingSchedule = FLOW_SCHEDULE
    tolerance: float = 1e-6
    """In scaled states: integration steps are halved in the evaluation until the result changes by less."""

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Train a vector field for one motion, in float64; arguments as in `MotionMethod.fit`."""
        began = time.process_time()
        t, x = validate_samples(times, states)
        scale = estimate_scaling(t, x)
        pace = float(np.sqrt(np.mean(scale.speed**2))) or 1.0  # scaled lengths per step: the unit of velocities
        steps = torch.as_tensor(scale.count_steps(t) * pace)[:, None]
        network = _build_network(self.architecture, scale, t, x, pace, seed)
        spans = steps[1:] - steps[:-1]

        def loss() -> Tensor:
            z = network.sample_states()
            miss = integrate_steps(self.step, network.evaluate_field, z[:-1], steps[:-1], spans, self.substeps) - z[1:]
            half = miss.shape[-1] // 2
            return (miss[:, :half] ** 2 + (spans * miss[:, half:]) ** 2).sum(dim=-1).mean()

        def build_motion() -> Motion:
            return self._build_motion(network, scale, steps, pace)

        result = train_network(network, loss, self.schedule, budget or TrainingBudget(), build_motion)
        return summarize_training(build_motion(), result, network, began)

    def _build_motion(self, network: ShootingNetwork, scale: Scaling, steps: Tensor, pace: float) -> Motion:
        @torch.no_grad()
        def at(times: FloatArray) -> FloatArray:
            t = torch.as_tensor(scale.count_steps(times) * pace)[:, None]
            with use_one_thread():
                states = torch.where(
                    t > steps[-1],
                    self._extrapolate_states(network, steps, t),
                    self._interpolate_states(network, steps, t),
                )
            return scale.restore_states(states[:, : scale.centre.size].numpy())

        return at

    def _interpolate_states(self, network: ShootingNetwork, steps: Tensor, t: Tensor) -> Tensor:
        """Blend the motions from the sample before and back from the sample after; states (M, 2 C) at times (M, 1)."""
        z = network.sample_states()
        k = (torch.searchsorted(steps[:, 0], t[:, 0], right=True) - 1).clamp(0, len(steps) - 2)
        begin, end = steps[k], steps[k + 1]
        until = torch.minimum(t, end)
        ahead = integrate_to_tolerance(
            self.step, network.evaluate_field, z[k], begin, until - begin, self.tolerance, MAX_SUBSTEPS
        )
        back = integrate_to_tolerance(
            self.step, network.evaluate_field, z[k + 1], end, until - end, self.tolerance, MAX_SUBSTEPS
        )
        share = ((t - begin) / (end - begin)).clamp(0.0, 1.0)
        weight = share**2 * (3 - 2 * share)
        return (1 - weight) * ahead + weight * back

    def _extrapolate_states(self, network: ShootingNetwork, steps: Tensor, t: Tensor) -> Tensor:
        """Integrate from the last sample; states (M, 2 C) at times (M, 1)."""
        h = (steps[-1:] - steps[:1]) / (len(steps) - 1)  # (1, 1)
        ahead = ((t - steps[-1]) / h).clamp(min=0)
        path = [network.sample_states()[-1:]]
        for _ in range(int(ahead.max()) if len(t) else 0):
            path.append(
                integrate_to_tolerance(self.step, network.evaluate_field, path[-1], h, h, self.tolerance, MAX_SUBSTEPS)
            )
        whole = ahead.floor().clamp(max=len(path) - 1)
        rest = (ahead - whole) * h
        return integrate_to_tolerance(
            self.step,
            network.evaluate_field,
            torch.cat(path)[whole[:, 0].long()],
            rest,
            rest,
            self.tolerance,
            MAX_SUBSTEPS,
        )


def _build_network(
    architecture: FlowArchitecture, scale: Scaling, t: FloatArray, x: FloatArray, pace: float, seed: int
) -> ShootingNetwork:
    """Build an untrained network, with the velocities of a spline as momenta."""
    q = scale.scale_states(x)
    speed = fit_spline(scale.count_steps(t) * pace, q, 5).derivative()(scale.count_steps(t) * pace)  # type: ignore[attr-defined]
    free = torch.as_tensor((scale.speed > 0).astype(np.float64))
    sizes = FlowDimensions(*scale.shape, free, torch.as_tensor(q))
    return ShootingNetwork(architecture(sizes, make_generator(seed)), torch.as_tensor(q), torch.as_tensor(speed), free)


class _AccelerationFlow(nn.Module):
    """Vector field dx/dt = v, dv/dt = net(x, v)."""

    def __init__(self, layers: Perceptron) -> None:
        super().__init__()
        self.layers = layers

    def forward(self, z: Tensor) -> Tensor:
        """Evaluate dz/dt (..., 2 C) at z (..., 2 C)."""
        _, v = z.chunk(2, dim=-1)
        return torch.cat([v, self.layers(z)], dim=-1)


def _build_acceleration_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64, 64)
) -> nn.Module:
    """Build an untrained net(x, v)."""
    count = sizes.coordinates
    return _AccelerationFlow(Perceptron(2 * count, count, widths, nn.Tanh, generator))


def build_first_order_flow(
    sizes: FlowDimensions, generator: torch.Generator, widths: Sequence[int] = (64, 64, 64)
) -> nn.Module:
    """Build an untrained dz/dt = net(z) without any structure of mechanics: the baseline of Greydanus et al. 2019."""
    return Perceptron(2 * sizes.coordinates, 2 * sizes.coordinates, widths, nn.Tanh, generator)


SECOND_ORDER = NeuralFlowMethod("net(x, v)", _build_acceleration_flow, RungeKuttaStep())
PLAIN_FLOW = NeuralFlowMethod("net(x, v), first order", build_first_order_flow, RungeKuttaStep())
