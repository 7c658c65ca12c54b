"""A residual force inside the flight of filmed shuttles, learned over their flights, on flights that it never saw.

    python -m benchmarks.residual_drag [FILE.csv]

The drag of the law of flight is multiplied by 1 + w, with w a network of radial basis functions: over the speed, over
the length of path since the hit, along which a shuttle turns from lying across its path to flying with the nose ahead,
or over both. Its weights are fitted together with all training flights, each of which keeps a place, velocity, drag,
scale and change of distance of its own. Flights that were held out (five folds) are fitted with these weights fixed, to
their first 60 %, and continued; the table states the error of the whole fit and of the continuation.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.shuttle_flights import FLIGHTS, FPS, PX_PER_M, SPREADS, WORST_PX, read_flights
from models.core.typing import FloatArray, IntArray
from models.sports.badminton import SPORT

# m/s, and lengths of turn-over, at which basis functions stand.
SPEEDS, TURNS = np.array([4.0, 7.0, 11.0, 17.0, 26.0, 40.0]), np.array([0.3, 0.8, 1.5, 3.0])
# Standard deviation of a weight before any flight is seen.
WEIGHT_SIGMA = 0.2
# Turn-over drag and exponent of the law, as `shuttle_flights` finds them, and px of noise.
TURN_DRAG, EXPONENT, NOISE_PX = 1.0, -0.08, 1.5
# Steps between frames, share of a flight that is fitted before it is continued, folds, iterations of a fit.
STEPS, FITTED, FOLDS, ITERATIONS = 2, 0.6, 5, 6
SIZES = np.array([1e-3] * 4 + [1e-4] * 3)
DESIGNS = {
    "no network": 0,
    "over the speed": len(SPEEDS),
    "over the turn": len(TURNS),
    "over both": len(SPEEDS) * len(TURNS),
}


def evaluate_basis(speed: FloatArray, turn: FloatArray, count: int) -> FloatArray:
    """Evaluate the basis functions (count, n) at speeds (n,), m/s, and lengths of turn-over (n,) of path."""
    by_speed = np.exp(-0.5 * (np.log(np.maximum(speed, 1.0) / SPEEDS[:, None]) / 0.45) ** 2)
    if count in (0, len(SPEEDS)):
        return np.asarray(by_speed[:count])
    by_turn = np.exp(-0.5 * (np.log(np.maximum(turn, 0.05) / TURNS[:, None]) / 0.5) ** 2)
    if count == len(TURNS):
        return np.asarray(by_turn)
    return np.asarray((by_speed[:, None] * by_turn).reshape(count, -1))


def fly_flights(values: FloatArray, weights: FloatArray, frames: int) -> FloatArray:
    """Fly n flights with own values (n, 7) and weights (n, W); returns places in the image (n, T, 2), px."""
    count, length, h = weights.shape[1], SPORT.object.turn_length, 1 / (FPS * STEPS)
    drag = SPORT.object.drag.mean * np.exp(values[:, 5])

    def rate(state: FloatArray) -> FloatArray:
        speed, turn = np.hypot(state[:, 2], state[:, 3]), state[:, 4] / length
        u = 4 * turn
        more = 1 + (weights * evaluate_basis(speed, turn, count).T).sum(axis=1) if count else 1.0
        pull = drag * (speed / 10) ** EXPONENT * (1 + TURN_DRAG * u**2 * np.exp(-u) / 2) * more * speed
        return np.stack([state[:, 2], state[:, 3], -pull * state[:, 2], -9.81 - pull * state[:, 3], speed], axis=1)

    state, places = np.column_stack([values[:, :4], np.zeros(len(values))]), []
    for row in range(frames):
        places.append(state[:, :2] * (PX_PER_M * np.exp(values[:, 4]) / (1 + values[:, 6] * row / FPS))[:, None])
        for _ in range(STEPS):
            first = rate(state)
            second = rate(state + h / 2 * first)
            third = rate(state + h / 2 * second)
            state = state + h / 6 * (first + 2 * second + 2 * third + rate(state + h * third))
    return np.stack(places, axis=1)


def find_rows(flight: FloatArray) -> IntArray:
    """Find the frames since the first one in which a flight was seen."""
    return np.asarray(np.rint(FPS * (flight[:, 0] - flight[0, 0])), np.int64)


def linearize(
    flights: list[FloatArray], owns: FloatArray, w: FloatArray, share: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Return, of the first share of each flight, residuals (R,) and derivatives (R, 7 + W), in standard deviations."""
    steps, size = np.concatenate([SIZES, np.full(len(w), 1e-3)]), 7 + len(w)
    base = np.column_stack([owns, np.tile(w, (len(owns), 1))])
    values = (base[:, None] + np.vstack([np.zeros(size), np.diag(steps)])).reshape(-1, size)
    frames = max(int(find_rows(one)[-1]) for one in flights) + 1
    places = fly_flights(values[:, :7], values[:, 7:], frames).reshape(len(flights), size + 1, frames, 2)
    result = []
    for flight, own, path in zip(flights, owns, places, strict=True):
        rows = slice(0, int(share * len(flight)))
        off = (path[:, find_rows(flight)[rows]] - flight[rows, 1:]).reshape(size + 1, -1) / NOISE_PX
        weight = 1 / np.sqrt(1 + (off[0] / 3) ** 2)
        prior = np.eye(size)[4:7] / SPREADS[:, None]
        by = np.concatenate([((off[1:] - off[0]) / steps[:, None]).T * weight[:, None], prior])
        result.append((np.concatenate([off[0] * weight, own[4:7] / SPREADS]), by))
    return result


def start_flights(flights: list[FloatArray]) -> FloatArray:
    """Guess the own values (F, 7) of flights."""
    speeds = [(one[2, 1:] - one[0, 1:]) / (one[2, 0] - one[0, 0]) for one in flights]
    return np.array([[*one[0, 1:] / PX_PER_M, *v / PX_PER_M, 0, 0, 0] for one, v in zip(flights, speeds, strict=True)])


def fit_owns(flights: list[FloatArray], owns: FloatArray, w: FloatArray, share: float = 1.0) -> FloatArray:
    """Fit the own values of flights to their first share, with fixed weights."""
    for _ in range(ITERATIONS):
        parts = linearize(flights, owns, w, share)
        owns = owns - [np.clip(np.linalg.lstsq(by[:, :7], r, rcond=None)[0], -1.0, 1.0) for r, by in parts]
    return owns


def train(flights: list[FloatArray], owns: FloatArray, count: int) -> FloatArray:
    """Fit the weights together with the own values of all flights, from fits without weights."""
    w = np.zeros(count)
    for _ in range(ITERATIONS if count else 0):
        normal, right, moves = np.eye(count) / WEIGHT_SIGMA**2, w / WEIGHT_SIGMA**2, []
        for residual, by in linearize(flights, owns, w, 1.0):
            a, b = by[:, :7], by[:, 7:]
            solved = np.linalg.lstsq(a, np.column_stack([residual, b]), rcond=None)[0]
            normal += b.T @ (b - a @ solved[:, 1:])
            right += b.T @ (residual - a @ solved[:, 0])
            moves.append(solved)
        step = np.linalg.solve(normal, right)
        w = w - step
        owns = owns - [solved[:, 0] - solved[:, 1:] @ step for solved in moves]
    return w


def measure(flights: list[FloatArray], owns: FloatArray, w: FloatArray, share: float = 0.0) -> FloatArray:
    """Measure the root mean square errors (F,), px, of what follows the first share of each flight."""
    frames = max(int(find_rows(one)[-1]) for one in flights) + 1
    paths = fly_flights(owns, np.tile(w, (len(owns), 1)), frames)
    offs = [path[find_rows(one)] - one[:, 1:] for one, path in zip(flights, paths, strict=True)]
    return np.array([np.sqrt(np.mean(off[int(share * len(off)) :] ** 2)) for off in offs])


def main() -> None:
    """Compare the designs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", default=FLIGHTS)
    everything = read_flights(parser.parse_args().file)
    owns = fit_owns(everything, fit_owns(everything, start_flights(everything), np.zeros(0)), np.zeros(0))
    usable = np.flatnonzero(measure(everything, owns, np.zeros(0)) < WORST_PX)
    flights, owns = [everything[k] for k in usable], owns[usable]
    table = Table("network", "error of the fit, px", "of the continuation, px", "gain of the continuation, %")
    usual = 0.0
    for name, count in DESIGNS.items():
        fits, aheads = [], []
        for fold in range(FOLDS):
            is_held = np.arange(len(flights)) % FOLDS == fold
            w = train([flights[k] for k in np.flatnonzero(~is_held)], owns[~is_held], count)
            held = [flights[k] for k in np.flatnonzero(is_held)]
            fits.append(measure(held, fit_owns(held, owns[is_held], w), w))
            aheads.append(measure(held, fit_owns(held, owns[is_held], w, FITTED), w, FITTED))
        fit, ahead = (float(np.median(np.concatenate(one))) for one in (fits, aheads))
        usual = usual or ahead
        table.add_row(name, f"{fit:.2f}", f"{ahead:.2f}", f"{100 * (1 - ahead / usual):.0f}")
    console = Console()
    console.print(f"{len(flights)} of {len(everything)} flights")
    console.print(table)


if __name__ == "__main__":
    main()
