"""Play and film shots on a billiard table; `billiards.py` simulates the physics.

    python worlds/billiards_table.py EXPERIMENT.json OUT

EXPERIMENT.json holds `effects` (name to parameters, all that act: those of `billiards.py`, of `table_camera.py`, and
the three below), `laws` (`cushion` and `ball`), `model` (names of the effects that the user's simulator has), `chance`
(the state of numpy's PCG64, from which shots and noise are drawn), `shots`, `fps`, `said` (the stated frame rate),
`seconds`, `noise` (m), `correlation`, `outliers` and `missing` as in `filming.py`, and `along` (every shot in one
direction and at one speed). OUT gets tracks.csv and scene.json, without the acting effects.

`unequal_mass` and `unequal_radius`: all other balls are heavier or larger than the cue ball by the share `ratio`;
`ageing`: rolling resistance grows by `mu` with every shot.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filming import Flaws, add_flaws, write_track_folder
from numpy.typing import NDArray
from table_camera import EFFECTS as CAMERA_EFFECTS
from table_camera import TableCamera

Floats = NDArray[np.float64]

PHYSICS = Path(__file__).resolve().parent / "billiards.py"
# m, of a nine-foot pool table and its balls.
LENGTH, WIDTH, RADIUS = 2.54, 1.27, 0.028575
TABLE_EFFECTS = ("unequal_mass", "unequal_radius", "ageing")
# Seconds, and frames, that a shot is simulated beyond its film, for late capture times.
EXTRA_SECONDS, EXTRA_FRAMES = 0.2, 4
# Speed of shots that are all alike, m/s.
ALONG_SPEED = 1.5


@dataclass(frozen=True, kw_only=True)
class Experiment(Flaws):
    """Content of EXPERIMENT.json, see above."""

    effects: Mapping[str, Mapping[str, float]]
    laws: Mapping[str, str]
    model: tuple[str, ...]
    chance: Mapping[str, Any]
    shots: int
    fps: float
    said: float
    seconds: float
    along: bool = False

    @property
    def camera(self) -> TableCamera:
        return TableCamera(LENGTH, WIDTH, self.fps, self.effects)

    def ball_ratio(self, effect: str) -> float:
        """Return the ratio of all other balls to the cue ball."""
        return 1 + self.effects.get(effect, {}).get("ratio", 0.0)

    def effects_of_shot(self, shot: int) -> dict[str, dict[str, float]]:
        """Return the effects of a shot for `billiards.py`."""
        elsewhere = (*TABLE_EFFECTS, *CAMERA_EFFECTS)
        effects = {name: dict(values) for name, values in self.effects.items() if name not in elsewhere}
        if "ageing" in self.effects:
            effects["rolling_resistance"]["mu"] += shot * self.effects["ageing"]["mu"]
        return effects


def draw_shot(experiment: Experiment, number: int, chance: np.random.Generator) -> dict[str, Any]:
    """Draw a cue ball with arbitrary spin, aimed at the second of two to five balls, as `billiards.py` reads it."""
    count = int(chance.integers(2, 6))
    places = draw_positions(count, experiment.along, chance)
    aim = places[1] - places[0]
    off = 0.0 if experiment.along else chance.uniform(-1.6, 1.6) * RADIUS / np.hypot(*aim)
    angle = 0.0 if experiment.along else np.arctan2(aim[1], aim[0]) + off
    v = (ALONG_SPEED if experiment.along else chance.uniform(1.2, 3.0)) * np.array([np.cos(angle), np.sin(angle)])
    roll, side = chance.uniform(0.0, 0.9), chance.uniform(-0.6, 0.6) * np.hypot(*v) / RADIUS
    larger, heavier = experiment.ball_ratio("unequal_radius"), experiment.ball_ratio("unequal_mass")
    balls: list[dict[str, Any]] = [
        {"id": str(k), "x": x, "y": y, "radius": RADIUS * (larger if k else 1), "mass": heavier if k else 1.0}
        for k, (x, y) in enumerate(places)
    ]
    balls[0] |= {"vx": v[0], "vy": v[1], "wx": -roll * v[1] / RADIUS, "wy": roll * v[0] / RADIUS, "wz": side}
    return {
        "scene": "billiards", "table": {"length": LENGTH, "width": WIDTH, "pockets": False}, "balls": balls,
        "seconds": experiment.seconds + max(EXTRA_SECONDS, EXTRA_FRAMES / experiment.fps), "hz": experiment.camera.rate,
        "effects": experiment.effects_of_shot(number), "laws": dict(experiment.laws),
    }  # fmt: skip


def draw_positions(count: int, along: bool, chance: np.random.Generator) -> Floats:
    """Draw positions (N, 2) m away from each other and the cushions; the second ball ahead if all shots go one way."""
    while True:
        places = chance.uniform([0.15, 0.15], [2.39, 1.12], (count, 2))
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(count)
        if apart.min() > 0.2 and not (along and places[1, 0] < places[0, 0] + 0.5):
            return np.asarray(places)


def simulate_shots(shots: list[dict[str, Any]]) -> list[Floats]:
    """Simulate all shots with `billiards.py` as a process; returns (S, N, 2) m of every shot."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, arguments = Path(scratch), []
        for number, shot in enumerate(shots):
            (folder / f"{number}.json").write_text(json.dumps(shot))
            arguments += [str(folder / f"{number}.json"), str(folder / str(number))]
        subprocess.run([sys.executable, str(PHYSICS), *arguments], check=True)
        return [
            np.loadtxt(folder / str(number) / "trajectory.csv", delimiter=",", skiprows=1, usecols=(2, 3)).reshape(
                -1, len(shot["balls"]), 2
            )
            for number, shot in enumerate(shots)
        ]


def film_shot(experiment: Experiment, number: int, path: Floats, chance: np.random.Generator) -> Floats:
    """Return observed positions (T, N, 2) m, NaN where a ball is missing."""
    t = experiment.camera.capture_times(round(experiment.fps * experiment.seconds), number)
    return add_flaws(experiment.camera.film_path(path, t), experiment, chance)


def list_rows(experiment: Experiment, observed: list[Floats]) -> Iterator[tuple[float, ...]]:
    """Yield the rows of tracks.csv, with all digits of the positions."""
    for shot, places in enumerate(observed):
        for frame, ball in np.argwhere(np.isfinite(places[..., 0])).tolist():
            x, y = places[frame, ball].tolist()
            yield shot, frame, frame / experiment.said, ball, x, y, experiment.noise


def main() -> None:
    if len(sys.argv) != 3:
        raise SystemExit(f"usage: python {sys.argv[0]} EXPERIMENT.json OUT")
    experiment = Experiment(**json.loads(Path(sys.argv[1]).read_text()))
    chance = np.random.default_rng(0)
    chance.bit_generator.state = dict(experiment.chance)
    paths = simulate_shots([draw_shot(experiment, number, chance) for number in range(experiment.shots)])
    observed = [film_shot(experiment, number, path, chance) for number, path in enumerate(paths)]
    facts = {
        "scene": "billiards", "units": "m", "fps": experiment.said, "table": {"length": LENGTH, "width": WIDTH},
        "ball_radius": RADIUS, "model": list(experiment.model),
    }  # fmt: skip
    columns = ("shot", "frame", "t", "id", "x", "y", "sigma")
    write_track_folder(Path(sys.argv[2]), columns, list_rows(experiment, observed), facts)


if __name__ == "__main__":
    main()
