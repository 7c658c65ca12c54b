"""What the fit by shooting works on: windows of a recording, what a simulation says of one, and who simulates."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from models.core.typing import FloatArray, IntArray
from models.physics.effect import Prior

SENSITIVE = 40.0
"""|dx/dx0| beyond which a window should have ended: a millimetre at its start is four centimetres there."""


@dataclass(frozen=True, slots=True)
class Window:
    """One stretch of a recording that is simulated from a start of its own; S numbers of state, K observations."""

    shot: int
    """Windows of one shot stand next to each other, in the order of time."""
    t: FloatArray
    """(K,) s, when each observation was made, growing."""
    body: IntArray
    """(K,) what was observed: residuals of one body are neighbours in time."""
    start: FloatArray
    """(S,) first guess of the state, and what is known of it beforehand."""
    sigma: FloatArray
    """(S,) standard deviation of that knowledge; infinite where nothing is known."""
    link: FloatArray | None = None
    """(S,) standard deviation of the change of state since the end of the window before, infinite where anything may
    have happened; None where a shot begins."""
    others: tuple[FloatArray, ...] = ()
    """(S,) each: other first guesses, where what is hidden leaves several; the one that fits best is taken."""

    def __post_init__(self) -> None:
        if self.start.shape != self.sigma.shape or (self.link is not None and self.link.shape != self.start.shape):
            raise ValueError(f"start, sigma and link of a window need one shape; got {self.start.shape} and others")
        if self.t.shape != self.body.shape or np.any(np.diff(self.t) < 0):
            raise ValueError("a window needs one body per observation, and times that grow")


@dataclass(frozen=True, slots=True)
class Flow:
    """What a simulation of one window predicts; d numbers per observation, P shared numbers."""

    misfit: FloatArray
    """(K, d) predicted minus observed, in standard deviations."""
    by_start: FloatArray
    """(K, d, S)"""
    by_shared: FloatArray
    """(K, d, P)"""
    end: FloatArray
    """(S',) state where the next window of the shot begins, as that window counts it."""
    end_by_start: FloatArray
    """(S', S)"""
    end_by_shared: FloatArray
    """(S', P)"""
    order: Hashable = ()
    """What happened, in its order; where two flows differ in it, derivatives of one tell nothing about the other."""


@dataclass(frozen=True, slots=True)
class Glance:
    """A flow without its slopes: enough to say what a trial costs."""

    misfit: FloatArray
    """(K, d)"""
    end: FloatArray
    """(S',)"""
    order: Hashable = ()


class Model(Protocol):
    """A scene that can be fitted."""

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """The P numbers that all windows share, with what is known of them beforehand."""
        ...

    @property
    def windows(self) -> tuple[Window, ...]: ...

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        """Simulate window number `window` from `start` (S,) with `shared` (P,)."""
        ...


def narrowed(model: Model) -> Model:
    """A model for steps of states alone: it may leave slopes by shared numbers out, (K, d, 0) and (S', 0), and does so
    where it has a `narrowed` of its own."""
    narrow: Callable[[], Model] | None = getattr(model, "narrowed", None)
    return model if narrow is None else narrow()


def glance(model: Model, window: int, start: FloatArray, shared: FloatArray) -> Glance | Flow:
    """What a model predicts: by its own `glance`, quicker than `flow`, where it has one."""
    look: Callable[[int, FloatArray, FloatArray], Glance | Flow] = getattr(model, "glance", model.flow)
    return look(window, start, shared)


def in_order(flow: Flow | Glance) -> Flow | Glance:
    """The same, its numbers row by row in memory, as another process would hand them over: the order in which they lie
    is that in which sums are made."""
    if isinstance(flow, Glance):
        return Glance(np.ascontiguousarray(flow.misfit), np.ascontiguousarray(flow.end), flow.order)
    return Flow(
        np.ascontiguousarray(flow.misfit),
        np.ascontiguousarray(flow.by_start),
        np.ascontiguousarray(flow.by_shared),
        np.ascontiguousarray(flow.end),
        np.ascontiguousarray(flow.end_by_start),
        np.ascontiguousarray(flow.end_by_shared),
        flow.order,
    )


def sensitive_from(by_start: FloatArray, limit: float = SENSITIVE) -> int:
    """First of K observations that hangs on the start by more than `limit`, from slopes (K, d, S'); K if none does."""
    if by_start.size == 0:
        return len(by_start)
    size = np.linalg.norm(by_start, axis=(1, 2), ord=2)
    over = np.flatnonzero(~(size <= limit))
    return int(over[0]) if len(over) else len(by_start)
