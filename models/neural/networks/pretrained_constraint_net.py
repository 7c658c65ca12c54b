"""ConstraintNet as its paper trains it: on many poses of simulated scenes of the same kind, a few at a time.

`models.neural.networks.constraint_net` learns from the visible samples of one motion alone, as every other network here does; that
is too little for a network of all coordinates. Yang, He and Zhu 2020 (arXiv:2006.12745) simulate thousands of poses. So
lessons are given: samples of other motions of the same kind of scene, wrong where the straight line has the middle of
two and right where the middle is, at the very distance at which the visible samples lie.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from models.core.typing import FloatArray
from models.neural.common.coordinate_scaling import scaling
from models.neural.common.method_interface import Budget, Fitted, checked
from models.neural.common.network_training import Schedule, train
from models.neural.common.perceptron import count_parameters, seeded
from models.neural.common.spline_methods import spline
from models.neural.networks.constraint_net import CONSTRAINT_NET, ConstraintNet, Pairs, missed

Lessons = Callable[[float, int], FloatArray]
"""(seconds, seed) to coordinates (B, 3, N, D): B stretches of that length at their beginning, middle and end."""
TAUGHT_SCHEDULE = Schedule(adam=7500, rate=2e-3, last_rate=1e-6, patience=7500, clip=1.0, sampled=True)


@dataclass(frozen=True, slots=True)
class TaughtConstraintNet:
    """A constraint learnt from lessons; of the motion itself only the lines between its samples are projected."""

    lessons: Lessons
    name: str = "ConstraintNet, taught"
    net: ConstraintNet = CONSTRAINT_NET
    schedule: Schedule = TAUGHT_SCHEDULE
    batch: int = 32
    """lessons a step."""

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """Never looks at the visible samples while it learns but for the time between them."""
        began = time.process_time()
        t, x = checked(times, states)
        seen = self.lessons(float(np.median(np.diff(t))), seed)
        scale = scaling(np.arange(len(seen), dtype=np.float64), seen[:, 1])
        right, ends = (torch.as_tensor(scale.coordinates(part), dtype=self.net.dtype) for part in (
            seen[:, 1], (seen[:, 0] + seen[:, 2]) / 2
        ))  # fmt: skip
        pairs = Pairs(ends, right)
        network = self.net.fresh(right, seed)
        chance = seeded(seed)

        def loss() -> Tensor:
            return missed(network, pairs.kept(torch.randint(len(right), (self.batch,), generator=chance)))

        curve = train(network, loss, self.schedule, budget or Budget())
        motion = self.net.motion(network, spline(t, x, 1), scale)
        return Fitted(motion, curve, count_parameters(network), time.process_time() - began)
