"""Prediction of particle tracks without a named scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from models.core.answer import Answer
from models.core.errors import OptionError
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import MIN_SAMPLES, ParticlePrediction, forecast_particles
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.particle_files import (
    format_physics_lines,
    read_particles,
    summarize_physics,
    write_particle_positions,
)
from pipeline.io.text_table import require_tracks_file

# s between rows of prediction.csv.
ROW_STEP = 0.02


def predict_particles(
    source: Path, seconds: float, at: float | None, folder: Path, number: int | None, fps: float | None
) -> Answer:
    """Predict the motion of particles, and write prediction.csv (shot, frame, t, id, x, y, sigma).

    Args:
        source: A tracks.csv or its folder.
        seconds: Length of the prediction, s.
        at: Time at which it starts, s; None for the last sample.
        folder: Folder of the file; created if it does not exist.
        number: Shot to predict; None for the first.
        fps: Frame rate (1/s) for files without times; None for the one of scene.json.

    Returns:
        The fitted motion and how far it can be predicted.
    """
    path = require_tracks_file(source)
    shots, notes = read_particles(path, fps)
    shot = _select_shot(shots, number, path)
    past = _truncate_at(shot, at)
    steps = max(round(seconds / ROW_STEP), 1)
    prediction = forecast_particles(past, past.t[-1] + np.arange(1, steps + 1) * (seconds / steps))
    require_writable_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / "prediction.csv"
    with replace_file(target) as fresh:
        write_particle_positions(fresh, [shot], [_build_rows(prediction)])
    physics, sigma = summarize_physics(prediction), float(prediction.sigma[-1])
    return Answer(
        f"Where do the particles go from {past.t[-1]:.3f} s on?",
        (f"From {past.t[-1]:.3f} s, {prediction.kind}: after {seconds:g} s the sigma of a coordinate is {sigma:.3g}.",
         *format_physics_lines(physics)),
        document={"prediction": str(target), "shot": shot.shot, "from": float(past.t[-1]), "motion": prediction.kind,
                  "sigma_at_end": sigma, "notes": list(notes), **physics},
        notes=tuple(f"Note: {note}." for note in notes),
        figures=(str(target),),
    )  # fmt: skip


def _select_shot(shots: list[Recording], number: int | None, path: Path) -> Recording:
    if number is None:
        return shots[0]
    for shot in shots:
        if shot.shot == number:
            return shot
    there = ", ".join(str(shot.shot) for shot in shots)
    raise OptionError(f"{path} has the shots {there}; shot {number} is not among them")


def _truncate_at(particles: Recording, at: float | None) -> Recording:
    """Return the observations up to a time (s)."""
    first, last = float(particles.t[0]), float(particles.t[-1])
    if at is None:
        return particles
    if not first <= at <= last:
        raise OptionError(f"--at must be within the observed times, {first:g} to {last:g} s; got {at:g}")
    past = particles.select_rows(0, int(np.searchsorted(particles.t, at + 1e-9, "right")))
    try:
        past.require_samples(MIN_SAMPLES)
    except ValueError as error:
        raise OptionError(f"There are too few observations until {at:g} s: {error}") from error
    return past


def _build_rows(prediction: ParticlePrediction) -> dict[str, FloatArray]:
    sigma = np.broadcast_to(prediction.sigma[:, None], prediction.x.shape[:2])
    return {"t": prediction.t, "x": prediction.x, "sigma": sigma}
