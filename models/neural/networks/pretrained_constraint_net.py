"""ConstraintNet trained as in its paper: on minibatches of many poses of simulated scenes of the same kind.

`models.neural.networks.constraint_net` learns from the visible samples of one motion only, as every other network here;
these are too few for a network of all coordinates. Yang, He and Zhu 2020 (arXiv:2006.12745) simulate thousands of
poses. Here the poses come from other motions of the same kind of scene. The perturbed position is the midpoint of the
line between two poses, the correct one the pose at that time; the interval is that of the visible samples.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.core.typing import FloatArray
from models.neural.common.coordinate_scaling import estimate_scaling
from models.neural.common.method_interface import FittedMotion, TrainingBudget, validate_samples
from models.neural.common.network_training import TrainingSchedule, train_network
from models.neural.common.perceptron import count_parameters, make_generator
from models.neural.common.spline_methods import fit_spline
from models.neural.networks.constraint_net import CONSTRAINT_NET, ConstraintNet, TrainingPairs, projection_loss

PoseSampler = Callable[[float, int], FloatArray]
"""Maps (seconds, seed) to coordinates (B, 3, N, D): begin, middle and end of B intervals of that duration."""
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
        motion, seconds = self.net.build_motion(network, fit_spline(t, x, 1), scale), time.process_time() - began
        return FittedMotion(
            motion, result.loss_curve, count_parameters(network), seconds, is_trained=result.is_complete
        )
