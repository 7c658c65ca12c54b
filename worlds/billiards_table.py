"""A table of billiards that is played on and filmed; the physics are those of `billiards.py`.

    python worlds/billiards_table.py EXPERIMENT.json OUT

EXPERIMENT.json holds `effects` (name to parameters, what acts: those of `billiards.py`, of `table_camera.py`, and the
three below), `laws` (`cushion` and `ball`), `model` (names of the effects that the simulator of the user is said to
have), `chance` (the state of numpy's PCG64, from which shots and noise are drawn), `shots`, `fps`, `said` (pictures a
second that are claimed), `seconds`, `noise` (m), `correlation`, `outliers` and `missing` as in `filming.py`, and
`along` (every shot in one direction and at one speed). OUT gets tracks.csv and scene.json; what acts is not told there.

`unequal_mass` and `unequal_radius`: `ratio` is by how much heavier and larger than the cue ball all others are;
`ageing`: `mu` more of rolling resistance with every shot.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filming import Flaws, flawed
from numpy.typing import NDArray
from table_camera import EFFECTS as OF_CAMERA
from table_camera import TableCamera

Floats = NDArray[np.float64]

PHYSICS = Path(__file__).resolve().parent / "billiards.py"
LENGTH, WIDTH, RADIUS = 2.54, 1.27, 0.028575
"""m, of a nine-foot pool table and its balls."""
OF_TABLE = ("unequal_mass", "unequal_radius", "ageing")
LONGER, LOST = 0.2, 4
"""s, and pictures, that a shot is played on beyond its film, for what a camera shows late."""
ALONG = 1.5
"""m/s of shots that are all alike."""


@dataclass(frozen=True)
class Experiment:
    """See above."""

    effects: Mapping[str, Mapping[str, float]]
    laws: Mapping[str, str]
    model: tuple[str, ...]
    chance: Mapping[str, Any]
    shots: int
    fps: float
    said: float
    seconds: float
    noise: float
    correlation: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    along: bool = False

    @property
    def camera(self) -> TableCamera:
        return TableCamera(LENGTH, WIDTH, self.fps, self.effects)

    def ratio(self, effect: str) -> float:
        """Of all other balls to the cue ball."""
        return 1 + self.effects.get(effect, {}).get("ratio", 0.0)

    def acting(self, shot: int) -> dict[str, dict[str, float]]:
        """What `billiards.py` is asked for in a shot."""
        beside = (*OF_TABLE, *OF_CAMERA)
        found = {name: dict(values) for name, values in self.effects.items() if name not in beside}
        if "ageing" in self.effects:
            found["rolling_resistance"]["mu"] += shot * self.effects["ageing"]["mu"]
        return found


def shot_of(experiment: Experiment, number: int, chance: np.random.Generator) -> dict[str, Any]:
    """A cue ball with any spin, played at the second ball of two to five, as `billiards.py` reads it."""
    count = int(chance.integers(2, 6))
    places = places_of(count, experiment.along, chance)
    aim = places[1] - places[0]
    off = 0.0 if experiment.along else chance.uniform(-1.6, 1.6) * RADIUS / np.hypot(*aim)
    angle = 0.0 if experiment.along else np.arctan2(aim[1], aim[0]) + off
    v = (ALONG if experiment.along else chance.uniform(1.2, 3.0)) * np.array([np.cos(angle), np.sin(angle)])
    roll, side = chance.uniform(0.0, 0.9), chance.uniform(-0.6, 0.6) * np.hypot(*v) / RADIUS
    larger, heavier = experiment.ratio("unequal_radius"), experiment.ratio("unequal_mass")
    balls: list[dict[str, Any]] = [
        {"id": str(k), "x": x, "y": y, "radius": RADIUS * (larger if k else 1), "mass": heavier if k else 1.0}
        for k, (x, y) in enumerate(places)
    ]
    balls[0] |= {"vx": v[0], "vy": v[1], "wx": -roll * v[1] / RADIUS, "wy": roll * v[0] / RADIUS, "wz": side}
    return {
        "scene": "billiards", "table": {"length": LENGTH, "width": WIDTH, "pockets": False}, "balls": balls,
        "seconds": experiment.seconds + max(LONGER, LOST / experiment.fps), "hz": experiment.camera.rate,
        "effects": experiment.acting(number), "laws": dict(experiment.laws),
    }  # fmt: skip


def places_of(count: int, along: bool, chance: np.random.Generator) -> Floats:
    """(N, 2) m, apart from each other and from the cushions; the second ball ahead where all shots go one way."""
    while True:
        places = chance.uniform([0.15, 0.15], [2.39, 1.12], (count, 2))
        apart = np.linalg.norm(places[:, None] - places[None], axis=-1) + np.eye(count)
        if apart.min() > 0.2 and not (along and places[1, 0] < places[0, 0] + 0.5):
            return np.asarray(places)


def played(shots: list[dict[str, Any]]) -> list[Floats]:
    """(S, N, 2) m of every shot, by `billiards.py` as a process."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, asked = Path(scratch), []
        for number, shot in enumerate(shots):
            (folder / f"{number}.json").write_text(json.dumps(shot))
            asked += [str(folder / f"{number}.json"), str(folder / str(number))]
        subprocess.run([sys.executable, str(PHYSICS), *asked], check=True)
        return [
            np.loadtxt(folder / str(number) / "trajectory.csv", delimiter=",", skiprows=1, usecols=(2, 3)).reshape(
                -1, len(shot["balls"]), 2
            )
            for number, shot in enumerate(shots)
        ]


def filmed(experiment: Experiment, number: int, path: Floats, chance: np.random.Generator) -> Floats:
    """(T, N, 2) m, NaN where a ball was not seen."""
    t = experiment.camera.moments(round(experiment.fps * experiment.seconds), number)
    flaws = Flaws(experiment.noise, experiment.correlation, experiment.outliers, experiment.missing)
    return flawed(experiment.camera.shows(path, t), flaws, chance)


def write_track_folder(experiment: Experiment, seen: list[Floats], out: Path) -> None:
    """Every number to its last digit, so that nothing is lost between a world and who looks at it."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / "tracks.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("shot", "frame", "t", "id", "x", "y", "sigma"))
        for shot, places in enumerate(seen):
            for frame, ball in np.argwhere(np.isfinite(places[..., 0])).tolist():
                x, y = places[frame, ball].tolist()
                rows.writerow((shot, frame, frame / experiment.said, ball, x, y, experiment.noise))
    facts = {
        "scene": "billiards", "units": "m", "fps": experiment.said, "table": {"length": LENGTH, "width": WIDTH},
        "ball_radius": RADIUS, "model": list(experiment.model),
    }  # fmt: skip
    (out / "scene.json").write_text(json.dumps(facts, indent=1) + "\n")


def main() -> None:
    if len(sys.argv) != 3:
        raise SystemExit(f"usage: python {sys.argv[0]} EXPERIMENT.json OUT")
    experiment = Experiment(**json.loads(Path(sys.argv[1]).read_text()))
    chance = np.random.default_rng(0)
    chance.bit_generator.state = dict(experiment.chance)
    paths = played([shot_of(experiment, number, chance) for number in range(experiment.shots)])
    seen = [filmed(experiment, number, path, chance) for number, path in enumerate(paths)]
    write_track_folder(experiment, seen, Path(sys.argv[2]))


if __name__ == "__main__":
    main()
