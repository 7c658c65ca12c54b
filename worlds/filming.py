"""Film a simulated motion: add noise, gaps and outliers, and write a track folder.

Used by the simulators of bodies (`slide.py`, `flight.py`, `pendulum.py`), each a script:

    python worlds/slide.py EXPERIMENT.json OUT

EXPERIMENT.json holds `seed`, `shots`, `fps`, `seconds`, `noise` (in the unit of the coordinates), `correlation` of the
noise between frames, `outliers` and `missing` (shares of the frames), `tails` (degrees of freedom of Student's t; 0:
normal), `resolution` (steps of an encoder, in standard deviations of the noise), `smoothing` (frames of a quadratic
Savitzky-Golay filter), `effects` (name to parameters, all that act), `throw` (quantities that are not redrawn for every
shot: `speed`, m/s, and `angle`, rad, at the release), `model` (names of the effects that the user's simulator has),
`facts` (further entries of scene.json, which the simulator gets as well), `drive` (known inputs by the name of their
column: `amplitude` in its unit and `frequency`, Hz, of a wave whose phase is redrawn for every shot) and `stated`
(whether the columns of the inputs are written). OUT gets tracks.csv and scene.json, without the acting effects.
"""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

Floats = NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float]]
# Speed (m/s) and angle (rad) that are not redrawn.
Throw = Mapping[str, float]
# Maps time, position (D,) and velocity (D,) to an acceleration (D,).
Force = Callable[[float, Floats, Floats], Floats]

TOLERANCE = 1e-10
# Size of an outlier in standard deviations of the noise.
OUTLIER_SIGMAS = 20.0


@dataclass(frozen=True, kw_only=True)
class Flaws:
    """Measurement errors."""

    noise: float = 1e-3
    correlation: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    tails: float = 0.0
    resolution: float = 0.0
    smoothing: int = 0


@dataclass(frozen=True, kw_only=True)
class Experiment(Flaws):
    """Number and length of shots, quality of the film, and acting effects."""

    effects: Effects
    model: tuple[str, ...] = ()
    seed: int = 0
    shots: int = 12
    fps: float = 60.0
    seconds: float = 1.5
    throw: Throw = field(default_factory=dict)
    facts: Mapping[str, object] = field(default_factory=dict)
    """Further entries of scene.json; the simulator gets them as keywords."""
    drive: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Amplitude and frequency of each known input."""
    stated: bool = True
    """Whether the known inputs are written."""


@dataclass(frozen=True)
class Waves:
    """Known inputs of one shot: a sine per column."""

    drive: Mapping[str, Mapping[str, float]]
    phases: Mapping[str, float]

    def evaluate(self, name: str, t: float | Floats, derivative: int = 0) -> float | Floats:
        """Evaluate a derivative of an input at a time or times (T,), s; 0 where there is no such input."""
        if name not in self.drive:
            return 0.0 * np.asarray(t)
        turning = 2 * np.pi * self.drive[name]["frequency"]
        phase = turning * np.asarray(t) + self.phases[name] + derivative * np.pi / 2
        wave: Floats = self.drive[name]["amplitude"] * turning**derivative * np.sin(phase)
        return wave


STILL = Waves({}, {})


def read_experiment(path: Path, effects: Mapping[str, tuple[str, ...]]) -> Experiment:
    """Read an experiment; SystemExit with a message for an effect or parameter that the simulator lacks."""
    content = json.loads(path.read_text())
    for name, parameters in content["effects"].items():
        if name not in effects or set(parameters) != set(effects[name]):
            raise SystemExit(
                f"this simulator has {dict(effects)}; the experiment needs {name} with {sorted(parameters)}"
            )
    return Experiment(**{key: tuple(value) if key == "model" else value for key, value in content.items()})


def integrate_motion(
    force: Force, place: Floats, velocity: Floats, t: Floats, stop: Callable[..., float] | None = None
) -> Floats:
    """Integrate by DOP853; returns positions (T, D) at t (T,), constant once `stop(t, state)` crosses zero."""
    d = len(place)

    def rate(now: float, state: Floats) -> Floats:
        return np.concatenate([state[d:], force(now, state[:d], state[d:])])

    if stop is not None:
        stop.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(
        rate, (t[0], t[-1]), np.concatenate([place, velocity]), "DOP853", t_eval=t, events=stop, rtol=TOLERANCE,
        atol=1e-12, max_step=0.02,
    )  # fmt: skip
    places = np.empty((len(t), d))
    places[: solution.y.shape[1]] = solution.y[:d].T
    if solution.y.shape[1] < len(t):
        places[solution.y.shape[1] :] = solution.y_events[0][0][:d]
    return places


def add_flaws(places: Floats, flaws: Flaws, chance: np.random.Generator) -> Floats:
    """Add noise, outliers and gaps (NaN) to positions (T, ..., D); the first frame has no gaps."""
    noise = chance.normal(size=places.shape)
    if flaws.tails:
        noise /= np.sqrt(chance.chisquare(flaws.tails, places.shape) / flaws.tails)
    for k in range(1, len(noise)):
        noise[k] = flaws.correlation * noise[k - 1] + np.sqrt(1 - flaws.correlation**2) * noise[k]
    is_outlier = chance.random(places.shape[:-1]) < flaws.outliers
    noise[is_outlier] += chance.normal(size=(int(is_outlier.sum()), places.shape[-1])) * OUTLIER_SIGMAS
    shown = places + flaws.noise * noise
    if flaws.smoothing and len(shown) >= flaws.smoothing:
        shown = np.asarray(savgol_filter(shown, flaws.smoothing, 2, axis=0))
    if flaws.resolution:
        step = flaws.resolution * flaws.noise
        shown = step * np.round(shown / step)
    is_missing = chance.random(places.shape[:-1]) < flaws.missing
    is_missing[0] = False
    shown[is_missing] = np.nan
    return shown


def write_track_folder(
    out: Path, columns: Iterable[str], rows: Iterable[Iterable[object]], facts: Mapping[str, object]
) -> None:
    """Write tracks.csv with these columns and rows, and scene.json."""
    out.mkdir(parents=True, exist_ok=True)
    with (out / "tracks.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
    (out / "scene.json").write_text(json.dumps(facts, indent=1) + "\n")


def list_rows(observed: list[Floats], t: Floats, given: tuple[str, ...], waves: list[Waves]) -> Iterator[list[object]]:
    """Yield the rows of tracks.csv of observed shots (T, D) at t (T,), with the known inputs that are `given`."""
    for shot, (places, inputs) in enumerate(zip(observed, waves, strict=True)):
        for frame in np.flatnonzero(np.isfinite(places[:, 0])):
            values = (*places[frame], *(inputs.evaluate(name, t[frame]) for name in given))
            yield [shot, frame, f"{t[frame]:.9f}", "body", *(f"{value:.9f}" for value in values)]


def run_script(
    scene: str, columns: tuple[str, ...], effects: Mapping[str, tuple[str, ...]], play: Callable[..., Floats]
) -> None:
    """Run a script: `play(effects, throw, chance, t, **facts)` returns the positions (T, D) of one shot.

    Where the experiment has known inputs, `play` gets them as `waves`.
    """
    if len(sys.argv) != 3:
        raise SystemExit(f"usage: python {sys.argv[0]} EXPERIMENT.json OUT")
    experiment = read_experiment(Path(sys.argv[1]), effects)
    chance = np.random.default_rng(experiment.seed)
    t = np.arange(round(experiment.seconds * experiment.fps) + 1) / experiment.fps
    truth, driven = [], []
    for _ in range(experiment.shots):
        driven.append(Waves(experiment.drive, {name: chance.uniform(0, 2 * np.pi) for name in experiment.drive}))
        given = {"waves": driven[-1]} if experiment.drive else {}
        truth.append(play(experiment.effects, experiment.throw, chance, t, **experiment.facts, **given))
    observed = [add_flaws(places, experiment, chance) for places in truth]
    given, columns = tuple(experiment.drive) if experiment.stated else (), columns[: observed[0].shape[1]]
    units = "rad" if scene == "pendulum" else "m"
    facts = {"scene": scene, "units": units, "fps": experiment.fps, "model": list(experiment.model)}
    write_track_folder(
        Path(sys.argv[2]), ("shot", "frame", "t", "id", *columns, *given), list_rows(observed, t, given, driven),
        {**facts, **experiment.facts},
    )  # fmt: skip
