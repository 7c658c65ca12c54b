"""Interpolation and prediction of particle tracks, which belong to no named scene, by a fitted motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from models.core.answer import Answer
from models.core.errors import OptionError
from models.core.rally import Rally
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.particle_fit import (
    MIN_SAMPLES,
    ParticleMotion,
    ParticlePrediction,
    fit_particles,
    forecast_particles,
)
from models.estimation.rally.rally_columns import RallyTrajectory, tabulate_tracks
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.csv_tables import write_columns
from pipeline.io.particle_files import read_particles
from pipeline.io.saved_shot import SHOT_FOLDER, read_saved
from pipeline.io.text_table import Columns, require_tracks_file


def interpolate_particles(
    source: Path, factor: int, out: Path, fps: float | None, on_activity: Callable[[str], None]
) -> Answer:
    """Write interpolated tracks of all shots of a tracks.csv.

    Args:
        source: A tracks.csv or its folder.
        factor: Steps from sample to sample.
        out: File (.csv) to write, or folder of a tracks.csv; columns shot, frame, t, id, x, y, sigma, observed.
        fps: Frame rate (1/s) for files without times; None for the one of scene.json.
        on_activity: Called with what is done next.

    Returns:
        The fitted motion.
    """
    target = out if out.suffix.lower() == ".csv" else out / "tracks.csv"
    require_writable_folder(target.parent)
    tracks = require_tracks_file(source)
    shots, notes = read_particles(tracks, fps)
    motions = [_find_motion(shot, tracks.parent, on_activity) for shot in shots]
    write_particle_positions(
        target, shots, [refine_positions(shot, one, factor) for shot, one in zip(shots, motions, strict=True)]
    )
    summaries = [_summarize_motion(shot, one) for shot, one in zip(shots, motions, strict=True)]
    sentences: list[str] = []
    for one in summaries:
        sentences.append(f"shot {one['shot']}: {one['particles']} particles, {one['samples']} samples: {one['motion']}")
        sentences += format_physics_lines(one)
    return Answer(
        "Where are the particles between the samples?",
        tuple(sentences),
        notes=tuple(f"Note: {note}." for note in notes),
        document={"tracks": str(target), "factor": factor, "shots": summaries, "notes": list(notes)},
        figures=(str(target),),
    )


def _find_motion(shot: Recording, folder: Path, on_activity: Callable[[str], None]) -> ParticleMotion:
    """Return the fitted motion of the run that wrote the tracks, if there is one; otherwise fit particles."""
    if (folder / SHOT_FOLDER).is_dir():
        saved = read_saved(folder)
        if isinstance(saved, Rally):
            flights, error = RallyTrajectory(saved), tabulate_tracks(saved).sigma
            sigma = np.full(len(shot.bodies), float(np.nanmedian(error)) if len(error) else np.nan)
            return ParticleMotion("the flights of the run", lambda t: flights.at(t).xyz[:, None], sigma, {})
        fit = view_shot(saved)
        trajectory, sigma = fit.trajectory, np.full(len(shot.bodies), fit.noise)
        if set(shot.bodies) <= set(trajectory.ids):
            order = [trajectory.ids.index(ball) for ball in shot.bodies]
            return ParticleMotion("the fitted motion of the run", lambda t: trajectory.at(t).xy[:, order], sigma, {})
    count = f"{len(shot.bodies)} particles, {len(shot.t)} samples"
    on_activity(f"Fitting shot {shot.shot} ({count}); many particles take minutes")
    return fit_particles(shot)


def refine_positions(shot: Recording, motion: ParticleMotion, factor: int) -> dict[str, FloatArray]:
    """Keep the samples and add factor - 1 fitted positions between each two.

    There are no rows before the first and after the last observation of a particle.
    """
    is_observed = shot.is_observed
    coarse = np.arange(len(is_observed))
    t = np.interp(np.arange((len(coarse) - 1) * factor + 1) / factor, coarse, shot.t)
    x = motion.motion(t)
    first = is_observed.argmax(axis=0) * factor
    last = (len(is_observed) - 1 - is_observed[::-1].argmax(axis=0)) * factor
    row = np.arange(len(t))[:, None]
    x[(row < first) | (row > last)] = np.nan
    x[::factor][is_observed] = shot.positions[is_observed]
    observed = np.zeros(x.shape[:2])
    observed[::factor] = is_observed
    sigma = np.where(np.isfinite(motion.sigma), motion.sigma, np.nan)
    return {"t": t, "x": x, "sigma": np.broadcast_to(sigma, observed.shape), "observed": observed}


def _summarize_motion(shot: Recording, motion: ParticleMotion) -> dict[str, Any]:
    sigma = float(np.sqrt(np.mean(motion.sigma**2)))
    return {
        "shot": shot.shot, "particles": len(shot.bodies), "samples": len(shot.t), "motion": motion.kind,
        "sigma": sigma if np.isfinite(sigma) else None, **summarize_physics(motion),
    }  # fmt: skip


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
        The fitted physics, and the standard deviation of a coordinate at the end of the prediction.
    """
    path = require_tracks_file(source)
    shots, notes = read_particles(path, fps)
    shot = _select_shot(shots, number, path)
    past = _truncate_at(shot, at)
    steps = max(round(seconds / ROW_STEP), 1)
    prediction = forecast_particles(past, past.t[-1] + np.arange(1, steps + 1) * (seconds / steps))
    require_writable_folder(folder)
    target = folder / "prediction.csv"
    spread = np.broadcast_to(prediction.sigma[:, None], prediction.x.shape[:2])
    write_particle_positions(target, [shot], [{"t": prediction.t, "x": prediction.x, "sigma": spread}])
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
    chosen = [shot for shot in shots if number in (None, shot.shot)]
    if not chosen:
        there = ", ".join(str(shot.shot) for shot in shots)
        raise OptionError(f"{path} has the shots {there}; shot {number} is not among them")
    return chosen[0]


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


def summarize_physics(result: ParticleMotion | ParticlePrediction) -> dict[str, Any]:
    """Summarize the fitted physics of particles for --json.

    Args:
        result: Fitted motion or prediction.

    Returns:
        Parameters, their standard deviations (None if not finite), and sentences on what is not identifiable.
    """
    sigmas = {name: sigma if np.isfinite(sigma) else None for name, sigma in result.parameter_sigma.items()}
    return {"numbers": result.parameters, "numbers_sigma": sigmas, "not_told": list(result.not_identifiable)}


def format_physics_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Format a summary of the fitted physics for the terminal.

    Args:
        summary: Result of `summarize_physics`.

    Yields:
        One line per parameter and per sentence.
    """
    for name, value in summary["numbers"].items():
        sigma = summary["numbers_sigma"].get(name)
        yield f"  {name} {value:.5g}{'' if sigma is None else f' ± {sigma:.2g}'}"
    yield from (f"  {sentence}" for sentence in summary["not_told"])


def write_particle_positions(path: Path, shots: list[Recording], rows: list[dict[str, FloatArray]]) -> None:
    """Write positions of particles of several shots as one table; positions that are not finite have no row.

    Args:
        path: File to write.
        rows: Per shot: t (M,) s, x (M, N, D), sigma (M, N) and further columns (M, N).
    """
    parts = [_build_columns(shot, values) for shot, values in zip(shots, rows, strict=True)]
    write_columns({name: np.concatenate([part[name] for part in parts]) for name in parts[0]}, path)


def _build_columns(shot: Recording, values: dict[str, FloatArray]) -> Columns:
    x = values["x"]
    row, k = np.nonzero(np.isfinite(x).all(axis=2))
    columns: Columns = {"shot": np.full(len(row), shot.shot), "frame": row, "t": values["t"][row],
                        "id": np.array(shot.bodies)[k]}  # fmt: skip
    columns |= {axis: x[row, k, number] for number, axis in enumerate(shot.reference.coordinates)}
    columns |= {name: column[row, k] for name, column in values.items() if name not in ("t", "x")}
    if "observed" in columns:
        columns["observed"] = columns["observed"].astype(np.int64)
    return columns
