"""A ball that drops and bounces, in closed form: the simplest scene with contacts for the fit by shooting."""

from __future__ import annotations

from cmath import sqrt
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, SimulatedWindow, Window
from models.physics.effect import Prior

GRAVITY = Prior("gravity", "m/s^2", 9.0, 0.3, True, (1.0, 30.0))
RESTITUTION = Prior("restitution", "1", 0.7, 0.2, False, (0.0, 1.0))
NOTHING = Prior("nothing", "1", 0.5, 0.1, False, (0.0, 1.0))
"""A number that acts on nothing."""
STEP = 1e-30


@dataclass(frozen=True)
class Bounces:
    """`heights[k]` (K,) m seen in window k with noise `sigma`; state: height and speed, upwards."""

    windows: tuple[Window, ...]
    heights: tuple[FloatArray, ...]
    ends: tuple[float, ...]
    """s at which windows end."""
    sigma: float
    unknowns: tuple[Prior, ...] = (GRAVITY, RESTITUTION)

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        t, inputs = self.windows[window].t, np.concatenate([start, shared])
        heights, ends = np.empty((len(inputs), len(t))), np.empty((len(inputs), 2))
        for k in range(len(inputs)):
            stepped = inputs.astype(np.complex128)
            stepped[k] += 1j * STEP
            path, last, order = flight(stepped[:2], stepped[2], stepped[3], t, self.ends[window])
            heights[k], ends[k] = path.imag / STEP, last.imag / STEP
        return LinearizedWindow(
            ((path.real - self.heights[window]) / self.sigma)[:, None],
            heights[:2].T[:, None] / self.sigma, heights[2:].T[:, None] / self.sigma,
            last.real, ends[:2].T, ends[2:].T, order,
        )  # fmt: skip

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow:
        path, last, order = flight(start, *shared, self.windows[window].t, self.ends[window])
        return SimulatedWindow(((path.real - self.heights[window]) / self.sigma)[:, None], last.real, order)


def flight(
    start: FloatArray | NDArray[np.complex128], gravity: complex, restitution: complex, t: FloatArray, end: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], tuple[int, ...]]:
    """Heights (K,) at t, height and speed at `end`, and how many bounces came before each moment."""
    # complex numbers of Python: scalars of numpy are several times slower
    height, speed, gravity, restitution = (complex(one) for one in (*start, gravity, restitution))
    root = sqrt(speed**2 + 2 * gravity * height)
    began, fall, path, bounces = 0j, (speed + root) / gravity, [], []
    for moment in (*t.tolist(), end):
        for _ in range(100):
            if began.real + fall.real > moment or root.real < 1e-6:
                break
            began, height, speed = began + fall, 0j, restitution * root
            root, fall = speed, 2 * speed / gravity
            bounces.append(moment)
        tau = moment - began
        path.append((height + speed * tau - gravity * tau**2 / 2, speed - gravity * tau))
    whole = np.array(path)
    return whole[:-1, 0], whole[-1], tuple(int(np.searchsorted(bounces, moment, "right")) for moment in t)


def filmed(
    rng: np.random.Generator, shots: int, sigma: float, gravity: float = 9.81, restitution: float = 0.8,
    guess: float = 0.05,
) -> Bounces:  # fmt: skip
    """Drops of 1.5 s seen 30 times a second; first guesses are off by `guess` in m and m/s."""
    windows, heights = [], []
    for shot in range(shots):
        start = np.array([rng.uniform(0.5, 1.0), rng.uniform(-1.0, 2.0)])
        t = np.arange(1, 46) / 30
        path, _, _ = flight(start, gravity, restitution, t, 1.5)
        heights.append(path.real + sigma * rng.standard_normal(len(t)))
        first = start + guess * rng.standard_normal(2)
        windows.append(Window(shot, t, np.zeros(len(t), np.int64), first, np.full(2, np.inf)))
    return Bounces(tuple(windows), tuple(heights), (1.5,) * shots, sigma)
