"""What helps a network to find the frames between frames, on the double pendulum of Chen 2022, section 3.1.1.

    python benchmarks/neural.py [--kind stiff] [--fps 30] [--noise 0] [--seeds 3] [--first 100] [--thesis] [--only NAME]

Truth as in benchmarks/springs.py, 2.5 s, every other frame withheld. x linear and x cubic: how many times lower the
mean square error at the withheld frames is than that of the polygon and of the not-a-knot spline through the visible
ones; the median of the seeds, and the least. Horizon: s after the last frame until a ball is 10 px off, at most 1.
Seeds are those of the networks and, with noise, of the noise. `--thesis` adds the networks of 512 x 512 x 512: a minute
each.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from springs import LOST, truth

from models.core.typing import FloatArray
from models.neural.common.integration_steps import Euler
from models.neural.common.method_interface import Budget, Fitted, Method
from models.neural.common.network_training import Schedule
from models.neural.common.spline_methods import CUBIC, CURVES, LINEAR
from models.neural.method_catalogue import CONSTRAINT_NET, RIVALS, THESIS
from models.neural.networks.neural_runge_kutta import FOURIER, SMOOTH
from models.neural.networks.second_order_network import SECOND_ORDER

SECONDS, FUTURE = 2.5, 1.0
ADAM = Schedule(adam=3000)
CHANGES: tuple[Method, ...] = (
    replace(SMOOTH, name="tanh 64, Adam alone", schedule=ADAM, corrected=False),
    replace(SMOOTH, name="tanh 64, L-BFGS", corrected=False),
    replace(SMOOTH, name="... end miss"),
    replace(SMOOTH, name="... Euler", step=Euler()),
    replace(FOURIER, name="... waves of 4 steps"),
    replace(FOURIER, name="... waves of 2 steps", shortest_period=2.0),
    replace(FOURIER, name="... waves of 1 step", shortest_period=1.0),
    replace(SECOND_ORDER, name="net(x, v), Adam alone", schedule=ADAM),
    SECOND_ORDER,
)
"""One change at a time, each on top of the one before it but for steps and waves, which are on top of the end miss."""
CHEAP = tuple(method for method in RIVALS if method is not CONSTRAINT_NET)


@dataclass(frozen=True)
class Scene:
    """A series; every other frame of the first `frames` is shown."""

    t: FloatArray
    x: FloatArray
    frames: int
    noise: float

    def seen(self, seed: int) -> FloatArray:
        return self.x + self.noise * np.random.default_rng(seed).standard_normal(self.x.shape)

    def learn(self, method: Method, seed: int) -> Fitted:
        shown = slice(0, self.frames, 2)
        return method.fit(self.t[shown], self.seen(seed)[shown], seed, Budget())

    def mse(self, fitted: Fitted) -> float:
        hidden = slice(1, self.frames - 1, 2)
        return float(np.mean((fitted.at(self.t[hidden]) - self.x[hidden]) ** 2))

    def horizon(self, fitted: Fitted) -> float:
        later = self.t[self.frames :]
        off = np.linalg.norm(fitted.at(later) - self.x[self.frames :], axis=2).max(axis=1)
        lost = np.flatnonzero(~(off <= LOST))
        return float(later[lost[0]] - self.t[self.frames - 1]) if len(lost) else FUTURE


def scene(kind: str, fps: int, noise: float) -> Scene:
    frames = int(SECONDS * fps) // 2 * 2 + 1
    t = np.arange(frames + int(FUTURE * fps)) / fps
    return Scene(t, truth(kind, t), frames, noise)


def row(what: Scene, method: Method, seeds: range) -> str:
    rivals = [(what.mse(what.learn(LINEAR, seed)), what.mse(what.learn(CUBIC, seed))) for seed in seeds]
    learnt = [what.learn(method, seed) for seed in seeds]
    errors = np.array([what.mse(fitted) for fitted in learnt])[:, None]
    gains = np.array(rivals) / errors
    loss = np.median([fitted.loss_curve.min(initial=np.inf) for fitted in learnt])
    return (
        f"{method.name:28} {np.median(gains[:, 0]):9.1f} {gains[:, 0].min():9.1f} {np.median(gains[:, 1]):8.2f} "
        f"{gains[:, 1].min():8.2f} {np.median([what.horizon(fitted) for fitted in learnt]):7.2f} "
        f"{loss:9.1e} {learnt[0].parameters:8d} {np.median([fitted.seconds for fitted in learnt]):7.1f}"
    )


def methods(thesis: bool, only: str | None) -> Iterator[Method]:
    listed = (*CURVES, *(THESIS if thesis else ()), *CHANGES, *CHEAP, *((CONSTRAINT_NET,) if thesis else ()))
    yield from (method for method in listed if only is None or only in method.name)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", default="stiff", choices=("soft", "medium", "stiff"))
    parser.add_argument("--fps", type=int, default=30)
    parser.add_argument("--noise", type=float, default=0.0, help="px")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=100, help="first seed")
    parser.add_argument("--thesis", action="store_true", help="also the large networks")
    parser.add_argument("--only", help="methods whose name holds this")
    asked = parser.parse_args()
    what = scene(asked.kind, asked.fps, asked.noise)
    print(f"{asked.kind} {asked.fps} Hz, {asked.noise} px, {asked.seeds} seeds")
    print(f"{'':28}  x linear   (least)  x cubic  (least) horizon      loss  numbers   CPU s")
    for method in methods(asked.thesis, asked.only):
        print(row(what, method, range(asked.first, asked.first + asked.seeds)), flush=True)


if __name__ == "__main__":
    main()
