"""ConstraintNet: projection on a learned constraint (Yang, He and Zhu 2020, arXiv:2006.12745), compared in Chen 2022.

The network C(x) takes all coordinates, without velocity or time; its zero set represents the rods and edges of the
scene. A guess x is projected by iterating x <- x - C(x) grad C(x) / (|grad C(x)|^2 + eps). C itself is not supervised;
the loss compares the projected positions, through all iterations. Here the guess is the straight line between samples.

Visible samples offer two kinds of training pairs. Midpoints of the samples before and after have the error of a line
over twice the interval, used as it is and reduced to a quarter, the error of a line over one interval; or samples get
noise of that size. The protocol is meant to be fair to the method: short trainings with both kinds are compared on
held-out samples, and the better kind is trained longer on all samples. The connectivity of the points is not needed.

`PretrainedConstraintNet` is trained as in its paper, on minibatches of many poses of simulated scenes of the same kind:
the visible samples of one motion are too few for a network of all coordinates, and Yang, He and Zhu simulate thousands
of poses. Here the poses come from other motions of the same kind of scene. The perturbed position is the midpoint of
the line between two poses, the correct one the pose at that time; the interval is that of the visible samples.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from models.core.typing import FloatArray
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
    TrainingResult,
    TrainingSchedule,
    make_generator,
    summarize_training,
    train_network,
    use_one_thread,
)
from models.neural.networks.hamiltonian_network import evaluate_gradient

# eps of the projection: lower bound on the squared gradient.
MIN_SQUARED_GRADIENT = 1e-7
# Interval between held-out midpoints, in samples; they select the kind of training pairs.
HOLDOUT_STRIDE = 4
# Error of a straight line over half the interval, relative to that over the whole interval.
ERROR_SHRINKAGE = 0.25
# Noisy copies of every sample.
NOISY_COPIES = 2
# Initial networks for each kind of pairs. Some end at a flat C, whose zero set is a plane through the samples.
STARTS_PER_GENERATOR = 2
# Effort of each short training for the selection; all together take as long as the final training.
SELECTION_EFFORT = 0.25
# Yang, He and Zhu 2020 train 600 to 1000 epochs and lower the rate by a fifth every 20.
CONSTRAINT_SCHEDULE = TrainingSchedule(adam_steps=600, learning_rate=1e-3, final_learning_rate=1e-6, gradient_clip=1.0)


class ConstraintProjection(nn.Module):
    """The network C(x), and the projection on its zero set."""

    def __init__(self, layers: Perceptron, iterations: int) -> None:
        super().__init__()
        self.layers, self.iterations = layers, iterations

    def forward(self, x: Tensor) -> Tensor:
        """Project coordinates (B, C)."""
        for _ in range(self.iterations):
            slope = evaluate_gradient(self.layers, x)
            x = x - self.layers(x) / ((slope**2).sum(dim=-1, keepdim=True) + MIN_SQUARED_GRADIENT) * slope
        return x


@dataclass(frozen=True, slots=True)
class TrainingPairs:
    """Perturbed positions (B, C) and the correct ones."""

    perturbed: Tensor
    correct: Tensor

    def select(self, which: Tensor) -> TrainingPairs:
        """Select rows by a mask or by indices."""
        return TrainingPairs(self.perturbed[which], self.correct[which])

    def shrink_errors(self) -> TrainingPairs:
        """Reduce the errors to those of a line over half the interval."""
        return TrainingPairs(self.correct + ERROR_SHRINKAGE * (self.perturbed - self.correct), self.correct)


@dataclass(frozen=True, slots=True)
class ConstraintNet:
    """Options of ConstraintNet.

    The paper uses 4 layers of 256, or 512 with collisions; 5 projections for a rigid body, 8 or 10 for other scenes.
    """

    name: str = "ConstraintNet"
    widths: tuple[int, ...] = (256, 256, 256, 256)
    iterations: int = 8
    activation: type[nn.Module] = nn.LeakyReLU
    schedule: TrainingSchedule = CONSTRAINT_SCHEDULE
    dtype: torch.dtype = torch.float32

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Select the kind of pairs by short trainings, then train on all samples.

        Arguments as in `MotionMethod.fit`.
        """
        began = time.process_time()
        t, x = validate_samples(times, states)
        scale = estimate_scaling(t, x)
        samples = torch.as_tensor(scale.scale_states(x), dtype=self.dtype)
        lines = fit_spline(t, x, 1)
        network, result = self._select_network(
            samples,
            torch.as_tensor(t, dtype=self.dtype),
            seed,
            budget or TrainingBudget(),
            lambda network: self.build_motion(network, lines, scale),
        )
        return summarize_training(self.build_motion(network, lines, scale), result, network, began)

    def _select_network(
        self,
        samples: Tensor,
        t: Tensor,
        seed: int,
        budget: TrainingBudget,
        build_motion: Callable[[ConstraintProjection], Motion],
    ) -> tuple[ConstraintProjection, TrainingResult]:
        """Train every candidate on a part of the samples, and the best one on all; return it and both its trainings."""
        middles = make_midpoint_pairs(samples, t)
        is_held_out = torch.arange(len(middles.correct)) % HOLDOUT_STRIDE == HOLDOUT_STRIDE // 2
        test = middles.select(is_held_out).shrink_errors()
        generators = PAIR_GENERATORS * STARTS_PER_GENERATOR
        short = TrainingBudget(budget.effort * SELECTION_EFFORT, budget.seconds / 2 / len(generators))
        candidates = []
        for start, generator in enumerate(generators):
            network = self.build_network(middles.correct, 1000 * seed + start)
            result = self._train_network(network, generator(middles.select(~is_held_out), seed), short)
            candidates.append((float(projection_loss(network, test).detach()), start, network, result, generator))
        _, _, network, first, generator = min(candidates)
        rest = None if budget.evaluations is None else max(budget.evaluations - len(first.loss_curve), 1)
        last = self._train_network(
            network,
            generator(middles, seed),
            replace(budget, seconds=budget.seconds / 2, evaluations=rest),
            lambda: build_motion(network),
        )
        curve = np.concatenate([first.loss_curve, last.loss_curve])
        return network, TrainingResult(curve, first.is_complete and last.is_complete)

    def build_network(self, samples: Tensor, seed: int) -> ConstraintProjection:
        """Build an untrained network for coordinates in the range of samples (T, C)."""
        layers = Perceptron(samples.shape[1], 1, self.widths, self.activation, make_generator(seed), self.dtype)
        with torch.no_grad():  # C must vanish near the samples, or the first projections diverge
            layers.last.bias.sub_(layers(samples).mean())
        return ConstraintProjection(layers, self.iterations)

    def _train_network(
        self,
        network: ConstraintProjection,
        pairs: TrainingPairs,
        budget: TrainingBudget,
        build_motion: Callable[[], Motion] | None = None,
    ) -> TrainingResult:
        return train_network(network, lambda: projection_loss(network, pairs), self.schedule, budget, build_motion)

    def build_motion(self, network: ConstraintProjection, lines: Motion, scale: Scaling) -> Motion:
        """Build the motion: lines between samples, projected on the constraint."""

        def at(times: FloatArray) -> FloatArray:
            guess = torch.as_tensor(scale.scale_states(lines(times)), dtype=self.dtype)
            with use_one_thread(), torch.no_grad():
                return scale.restore_states(network(guess).double().numpy())

        return at


def projection_loss(network: ConstraintProjection, pairs: TrainingPairs) -> Tensor:
    """Evaluate the mean absolute error of projected positions."""
    error: Tensor = (network(pairs.perturbed) - pairs.correct).abs().mean()
    return error


def make_midpoint_pairs(samples: Tensor, t: Tensor) -> TrainingPairs:
    """Pair every inner sample (T - 2, C) with the point on the line between its neighbours at the same time."""
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    return TrainingPairs((1 - share) * samples[:-2] + share * samples[2:], samples[1:-1])


def add_shrunk_errors(middles: TrainingPairs, seed: int) -> TrainingPairs:
    """Return midpoint pairs (2 B, C): unchanged, and with reduced errors."""
    shrunk = middles.shrink_errors()
    return TrainingPairs(torch.cat([middles.perturbed, shrunk.perturbed]), torch.cat([middles.correct, shrunk.correct]))


def add_noise(middles: TrainingPairs, seed: int) -> TrainingPairs:
    """Return correct positions (2 B, C) with noise of the size of the error of a line between samples."""
    right = middles.correct.repeat(NOISY_COPIES, 1)
    sigma = ERROR_SHRINKAGE * (middles.perturbed - middles.correct).square().mean(dim=0).sqrt()
    return TrainingPairs(
        right + sigma * torch.randn(right.shape, generator=make_generator(seed), dtype=right.dtype), right
    )


PAIR_GENERATORS = (add_shrunk_errors, add_noise)
CONSTRAINT_NET = ConstraintNet()


# Maps (seconds, seed) to coordinates (B, 3, N, D): begin, middle and end of B intervals of that duration.
PoseSampler = Callable[[float, int], FloatArray]
PRETRAINING_SCHEDULE = TrainingSchedule(
    adam_steps=7500,
    learning_rate=2e-3,
    final_learning_rate=1e-6,
    patience=7500,
    gradient_clip=1.0,
    uses_minibatches=True,
)


@dataclass(frozen=True, slots=True)
class PretrainedConstraintNet:
    """Method with a constraint that is learned from simulated poses.

    Of the motion itself, only the lines between its samples are projected.
    """

    sample_poses: PoseSampler
    name: str = "ConstraintNet, taught"
    net: ConstraintNet = CONSTRAINT_NET
    schedule: TrainingSchedule = PRETRAINING_SCHEDULE
    batch: int = 32
    """Poses per training step."""

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Train on simulated poses, then project the lines between samples; arguments as in `MotionMethod.fit`.

        Of the visible samples, the training uses only their median interval.
        """
        began = time.process_time()
        t, x = validate_samples(times, states)
        poses = self.sample_poses(float(np.median(np.diff(t))), seed)
        scale = estimate_scaling(np.arange(len(poses), dtype=np.float64), poses[:, 1])
        right, ends = (torch.as_tensor(scale.scale_states(part), dtype=self.net.dtype) for part in (
            poses[:, 1], (poses[:, 0] + poses[:, 2]) / 2
        ))  # fmt: skip
        pairs = TrainingPairs(ends, right)
        network = self.net.build_network(right, seed)
        generator = make_generator(seed)

        def loss() -> Tensor:
            return projection_loss(network, pairs.select(torch.randint(len(right), (self.batch,), generator=generator)))

        result = train_network(network, loss, self.schedule, budget or TrainingBudget())
        return summarize_training(self.net.build_motion(network, fit_spline(t, x, 1), scale), result, network, began)
