"""The future of particles that no scene is named for, as a file and a sentence."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import Particles
from models.estimation.particles.particle_prediction import Foretold, foretell
from pipeline.chain import refuse_closed
from pipeline.engine.atomic_write import aside
from pipeline.io.particle_files import Shot, described, physics, read_particles, tracks_file, write_places

STEP = 0.02
"""s between rows of prediction.csv."""


def predict_particles(
    source: Path,
    seconds: float,
    at: float | None,
    out: Path | None,
    number: int | None,
    fps: float | None,
    as_json: bool,
) -> None:
    """Write prediction.csv (shot, frame, t, id, x, y, sigma) and say what the motion was taken to be."""
    path = tracks_file(source)
    shot = _chosen(list(read_particles(path, fps)), number, path)
    past = _until(shot.particles, at)
    steps = max(round(seconds / STEP), 1)
    found = foretell(past, past.t[-1] + np.arange(1, steps + 1) * (seconds / steps))
    folder = out if out is not None else path.parent
    refuse_closed(folder)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "prediction.csv"
    with aside(target) as fresh:
        write_places(fresh, [shot], [_rows(found)])
    if as_json:
        told = {"prediction": str(target), "shot": shot.number, "from": float(past.t[-1]), "motion": found.kind,
                "sigma_at_end": float(found.sigma[-1]), **physics(found)}  # fmt: skip
        print(json.dumps(told, allow_nan=False))
        return
    print(f"From {past.t[-1]:.3f} s, {found.kind}: after {seconds:g} s a coordinate is known to {found.sigma[-1]:.3g}.")
    for line in described(physics(found)):
        print(line)
    print(f"Look at {target}")


def _chosen(shots: list[Shot], number: int | None, path: Path) -> Shot:
    if number is None:
        return shots[0]
    for shot in shots:
        if shot.number == number:
            return shot
    there = ", ".join(str(shot.number) for shot in shots)
    raise OptionError(f"{path} holds the shots {there}; shot {number} is not among them")


def _until(particles: Particles, at: float | None) -> Particles:
    """What was seen up to a moment."""
    first, last = float(particles.t[0]), float(particles.t[-1])
    if at is None:
        return particles
    if not first <= at <= last:
        raise OptionError(f"--at lies within what was seen, {first:g} to {last:g} s; got {at:g}")
    rows = particles.t <= at + 1e-9
    try:
        return Particles(particles.t[rows], particles.x[rows], particles.body)
    except ValueError as error:
        raise OptionError(f"Too little was seen until {at:g} s: {error}") from error


def _rows(found: Foretold) -> dict[str, FloatArray]:
    sigma = np.broadcast_to(found.sigma[:, None], found.x.shape[:2])
    return {"t": found.t, "x": found.x, "sigma": sigma}
