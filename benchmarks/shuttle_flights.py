"""Real shuttle flights, filmed from the side, against the law of flight with other constants.

    python -m benchmarks.shuttle_flights [FILE.csv]

Each flight is fitted alone: place and velocity at its first frame, drag, px per m, and the change of the distance.
Flights that no constants explain (a second hit, a wrong track) are left out. The table states the robust misfit of all
others, and the root mean square residual, for each turn-over drag, exponent of the drag and share of gravity that a
lagging nose carries. The flights are no part of this project.
"""

from __future__ import annotations

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from models.core.typing import FloatArray
from models.physics.flight.flight_motion import PARAMETER_COUNT, fly
from models.sports.badminton import SPORT

FLIGHTS = Path("../shared/data/physics/badminton_morishita/shuttle_tracks_px.csv")
# Frames per second, px per m, and the middle of the image, px, of these films.
FPS, PX_PER_M, MIDDLE = 60.0, 159.0, np.array([960.0, 540.0])
# px up to which a residual counts in full, and beyond which no law explains a flight; least number of frames.
ROBUST_PX, WORST_PX, FEWEST = 3.0, 2.6, 20
# Standard deviations of the logarithms of scale and drag, and of the change of the distance, 1/s.
SPREADS = np.array([0.1, 0.06, 0.1])
# Turn-over drag, exponent, share of gravity.
LAWS = (
    (0.0, 0.0, 0.0), (0.0, -0.08, 0.0), (0.0, -0.08, 0.035), (0.0, -0.08, -0.05), (-0.5, -0.08, 0.0),
    (0.5, -0.08, 0.0), (1.0, -0.08, 0.0), (1.5, -0.08, 0.0), (2.0, -0.08, 0.0), (3.0, -0.08, 0.0),
    (1.0, -0.2, 0.0), (1.0, 0.1, 0.0), (2.0, 0.1, 0.0),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="?", default=FLIGHTS)
    flights = read_flights(parser.parse_args().file)
    usable = [flight for flight in flights if fit_flight(flight, (0.0, 0.0, 0.0))[1] < WORST_PX]
    table = Table("turn-over drag", "exponent", "gravity carried", "misfit", "residual, px")
    for law in LAWS:
        fits = [fit_flight(flight, law) for flight in usable]
        misfit, residual = sum(fit[0] for fit in fits), np.median([fit[1] for fit in fits])
        table.add_row(*(f"{value:g}" for value in law), f"{misfit:.0f}", f"{residual:.2f}")
    console = Console()
    console.print(f"{len(usable)} of {len(flights)} flights")
    console.print(table)


def read_flights(path: Path) -> list[FloatArray]:
    """Read flights as columns (N, 3): s, and x and y of the image, px from its middle, y up."""
    flights = defaultdict(list)
    with path.open() as file:
        for row in csv.DictReader(file):
            place = (np.array([float(row["x_px"]), float(row["y_px"])]) - MIDDLE) * [1, -1]
            flights[row["session"], row["shot"]].append([int(row["frame"]) / FPS, *place])
    return [np.array(rows) for rows in flights.values() if len(rows) >= FEWEST]


def fit_flight(flight: FloatArray, law: tuple[float, float, float]) -> tuple[float, float]:
    """Fit a flight; returns its robust misfit, and the root mean square of its residuals, px."""
    t, px = flight[:, 0] - flight[0, 0], flight[:, 1:]
    p = np.zeros(PARAMETER_COUNT)
    p[[10, 11, 12]] = law

    def place(q: FloatArray) -> FloatArray:
        p[[0, 2, 3, 5]], p[6] = q[:4], SPORT.object.drag.mean * np.exp(q[5])
        scale = PX_PER_M * np.exp(q[4]) / (1 + q[6] * t)
        return np.asarray(fly(p, t, SPORT.object.turn_length).states[:, [0, 2]] * scale[:, None])

    def residual(q: FloatArray) -> FloatArray:
        return np.append(np.arcsinh((place(q) - px).ravel() / ROBUST_PX) * ROBUST_PX, q[4:] / SPREADS)

    v = (px[2] - px[0]) / (t[2] - t[0])
    fit = least_squares(residual, np.concatenate([px[0], v, np.zeros(3)]) / [*[PX_PER_M] * 4, 1, 1, 1], max_nfev=30)
    return 2 * float(fit.cost), float(np.sqrt(np.mean((place(fit.x) - px) ** 2)))


if __name__ == "__main__":
    main()
