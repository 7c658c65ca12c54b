"""Interpolation of particle tracks by a fitted motion."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import ParticleMotion, fit_particles
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.particle_files import (
    format_physics_lines,
    read_particles,
    summarize_physics,
    write_particle_positions,
)
from pipeline.io.run_views import view_run
from pipeline.io.shot_folder import SHOT_FOLDER, read_shot
from pipeline.io.text_table import require_tracks_file


def interpolate_particles(
    source: Path, factor: int, out: Path, fps: float | None, as_json: bool, on_activity: Callable[[str], None]
) -> None:
    """Write interpolated tracks of all shots of a tracks.csv, and print the fitted motion.

    Args:
        source: A tracks.csv or its folder.
        factor: Steps from sample to sample.
        out: File (.csv) to write, or folder of a tracks.csv; columns shot, frame, t, id, x, y, sigma, observed.
        fps: Frame rate (1/s) for files without times; None for the one of scene.json.
        as_json: Whether to print JSON.
        on_activity: Called with what is done next.
    """
    target = out if out.suffix.lower() == ".csv" else out / "tracks.csv"
    require_writable_folder(target.parent)
    tracks = require_tracks_file(source)
    shots, notes = read_particles(tracks, fps)
    motions = [_find_motion(shot, tracks.parent, on_activity) for shot in shots]
    target.parent.mkdir(parents=True, exist_ok=True)
    with replace_file(target) as fresh:
        write_particle_positions(
            fresh, shots, [refine_positions(shot, one, factor) for shot, one in zip(shots, motions, strict=True)]
        )
    summaries = [_summarize_motion(shot, one) for shot, one in zip(shots, motions, strict=True)]
    if as_json:
        document = {"tracks": str(target), "factor": factor, "shots": summaries, "notes": list(notes)}
        print(json.dumps(document, allow_nan=False))
        return
    for note in notes:
        print(f"Note: {note}.")
    for shot in summaries:
        print(f"shot {shot['shot']}: {shot['particles']} particles, {shot['samples']} samples: {shot['motion']}")
        for line in format_physics_lines(shot):
            print(line)
    print(f"Look at {target}")


def _find_motion(shot: Recording, folder: Path, on_activity: Callable[[str], None]) -> ParticleMotion:
    """Return the fitted motion of the run that wrote the tracks, if there is one; otherwise fit particles."""
    if (folder / SHOT_FOLDER).is_dir():
        fit = view_run(read_shot(folder))
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
    first, last = (
        is_observed.argmax(axis=0) * factor,
        (len(is_observed) - 1 - is_observed[::-1].argmax(axis=0)) * factor,
    )
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
