"""How long to learn, and what: chosen by visible samples alone.

A network that learns until its loss is gone learns the noise too. So every candidate, a method and a share of its
steps, first learns from a series in which some visible samples are held out; the one that finds them best learns once
more, from all of them. What is to be found in the end is never looked at.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import LEAST_SAMPLES, Budget, Fitted, LostMotion, Method, checked

HELD_OUT = 4
"""every so many-th sample."""


@dataclass(frozen=True, slots=True)
class Chosen:
    """The best of several candidates as a method."""

    name: str
    candidates: tuple[tuple[Method, float], ...]
    """methods, and the share of their steps."""

    def fit(self, times: FloatArray, states: FloatArray, seed: int = 0, budget: Budget | None = None) -> Fitted:
        """One fit for each candidate and one more; the first candidate where samples are too few to choose by."""
        began = time.process_time()
        t, x = checked(times, states)
        whole = budget or Budget()
        scores = [
            missed(method, t, x, seed, shared(whole, effort, len(self.candidates)))
            for method, effort in self.candidates
        ]
        method, effort = self.candidates[int(np.argmin(scores))]
        found = method.fit(t, x, seed, shared(whole, effort, 1))
        return Fitted(found.motion, found.loss_curve, found.parameters, time.process_time() - began)


def shared(budget: Budget, effort: float, count: int) -> Budget:
    """The budget of one of `count` candidates, which together may take half the time."""
    return Budget(budget.effort * effort, budget.seconds / 2 / count)


def missed(method: Method, t: FloatArray, x: FloatArray, seed: int, budget: Budget) -> float:
    """Mean square miss of held-out samples; infinite where the method finds no motion."""
    held = np.arange(len(t)) % HELD_OUT == HELD_OUT // 2
    held[[0, -1]] = False
    if not held.any() or np.sum(~held) < LEAST_SAMPLES:
        return 0.0
    try:
        guess = method.fit(t[~held], x[~held], seed, budget).at(t[held])
    except LostMotion:
        return float("inf")
    error = float(np.mean((guess - x[held]) ** 2))
    return error if np.isfinite(error) else float("inf")
