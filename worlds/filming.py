"""What a camera makes of a motion: noise, gaps and mistakes; a track folder is written.

Used by the worlds of bodies (`slide.py`, `flight.py`, `pendulum.py`), each a script of its own:

    python worlds/slide.py EXPERIMENT.json OUT

EXPERIMENT.json holds `seed`, `shots`, `fps`, `seconds`, `noise` (in the unit of the coordinates), `correlation` of
the noise from picture to picture, `outliers` and `missing` (shares of the pictures), `effects` (name to parameters,
what acts), `throw` (what is not drawn anew in every shot: `speed`, m/s, and `angle`, rad, of how a body is let go), and
`model` (names of the effects that the simulator of the user is said to have). OUT gets tracks.csv and scene.json; the
effects that act are not told there.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]
Throw = Mapping[str, float]
"""speed (m/s), angle (rad): what is not drawn anew."""
Force = Callable[[float, Floats, Floats], Floats]
"""Time, place (D,) and velocity (D,) to an acceleration (D,)."""

PRECISION = 1e-10
OUTLIER = 20.0
"""Standard deviations of a mistake."""


@dataclass(frozen=True)
class Experiment:
    """What is filmed, how well, and what acts."""

    effects: Effects
    model: tuple[str, ...] = ()
    seed: int = 0
    shots: int = 12
    fps: float = 60.0
    seconds: float = 1.5
    noise: float = 1e-3
    correlation: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    throw: Throw = field(default_factory=dict)
    facts: Mapping[str, object] = field(default_factory=dict)
    """Written into scene.json as they are."""


@dataclass(frozen=True)
class Flaws:
    """How badly places are measured, as in `Experiment`."""

    noise: float
    correlation: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0


def read_experiment(path: Path, known: Mapping[str, tuple[str, ...]]) -> Experiment:
    """SystemExit with a sentence where an effect or a parameter is not one of this world's."""
    said = json.loads(path.read_text())
    for name, parameters in said["effects"].items():
        if name not in known or set(parameters) != set(known[name]):
            raise SystemExit(f"this world has {dict(known)}; asked for {name} with {sorted(parameters)}")
    return Experiment(**{key: tuple(value) if key == "model" else value for key, value in said.items()})


def flown(force: Force, place: Floats, velocity: Floats, t: Floats, stop: Callable[..., float] | None = None) -> Floats:
    """Places (T, D) at times t (T,), by DOP853; held where `stop(t, state)` crosses zero."""
    d = len(place)

    def rate(now: float, state: Floats) -> Floats:
        return np.concatenate([state[d:], force(now, state[:d], state[d:])])

    if stop is not None:
        stop.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(
        rate, (t[0], t[-1]), np.concatenate([place, velocity]), "DOP853", t_eval=t, events=stop, rtol=PRECISION,
        atol=1e-12, max_step=0.02,
    )  # fmt: skip
    places = np.empty((len(t), d))
    places[: found.y.shape[1]] = found.y[:d].T
    if found.y.shape[1] < len(t):
        places[found.y.shape[1] :] = found.y_events[0][0][:d]
    return places


def filmed(experiment: Experiment, truth: list[Floats], chance: np.random.Generator) -> list[tuple[Floats, Floats]]:
    """Times (T,) and what is seen (T, D) of each shot, NaN where nothing was."""
    flaws = Flaws(experiment.noise, experiment.correlation, experiment.outliers, experiment.missing)
    return [(np.arange(len(places)) / experiment.fps, flawed(places, flaws, chance)) for places in truth]


def flawed(places: Floats, flaws: Flaws, chance: np.random.Generator) -> Floats:
    """Places (T, ..., D) as they are measured; NaN where nothing was seen, which in the first picture never is so."""
    noise = chance.normal(size=places.shape)
    for k in range(1, len(noise)):
        noise[k] = flaws.correlation * noise[k - 1] + np.sqrt(1 - flaws.correlation**2) * noise[k]
    wrong = chance.random(places.shape[:-1]) < flaws.outliers
    noise[wrong] += chance.normal(size=(int(wrong.sum()), places.shape[-1])) * OUTLIER
    shown = places + flaws.noise * noise
    lost = chance.random(places.shape[:-1]) < flaws.missing
    lost[0] = False
    shown[lost] = np.nan
    return shown


def write_track_folder(
    experiment: Experiment, scene: str, columns: tuple[str, ...], seen: list[tuple[Floats, Floats]], out: Path
) -> None:
    out.mkdir(parents=True, exist_ok=True)
    with (out / "tracks.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("shot", "frame", "t", "id", *columns))
        for shot, (t, places) in enumerate(seen):
            for frame in np.flatnonzero(np.isfinite(places[:, 0])):
                rows.writerow((shot, frame, f"{t[frame]:.9f}", "body", *(f"{value:.9f}" for value in places[frame])))
    units = "rad" if scene == "pendulum" else "m"
    facts = {"scene": scene, "units": units, "fps": experiment.fps, "model": list(experiment.model)}
    (out / "scene.json").write_text(json.dumps({**facts, **experiment.facts}, indent=1) + "\n")


def run(
    scene: str, columns: tuple[str, ...], known: Mapping[str, tuple[str, ...]], play: Callable[..., Floats]
) -> None:
    """The script: `play(effects, throw, chance, t)` gives the places (T, D) of one shot."""
    if len(sys.argv) != 3:
        raise SystemExit(f"usage: python {sys.argv[0]} EXPERIMENT.json OUT")
    experiment = read_experiment(Path(sys.argv[1]), known)
    chance = np.random.default_rng(experiment.seed)
    t = np.arange(round(experiment.seconds * experiment.fps) + 1) / experiment.fps
    truth = [play(experiment.effects, experiment.throw, chance, t) for _ in range(experiment.shots)]
    write_track_folder(experiment, scene, columns, filmed(experiment, truth, chance), Path(sys.argv[2]))
