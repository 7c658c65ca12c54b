"""The motion of particles between their samples, as a file and a sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.estimation.particles.particle_fit import Explained, explain
from pipeline.chain import refuse_closed
from pipeline.engine.atomic_write import aside
from pipeline.io.particle_files import Shot, described, physics, read_particles, tracks_file, write_places


def interpolate_particles(source: Path, factor: int, out: Path, fps: float | None, as_json: bool) -> None:
    """Write the places of all shots of a tracks.csv, `factor` steps from sample to sample (shot, frame, t, id, x, y,
    sigma, observed), to a .csv or to tracks.csv in a folder, and say what the motion was taken to be."""
    target = out if out.suffix.lower() == ".csv" else out / "tracks.csv"
    refuse_closed(target.parent)
    shots = list(read_particles(tracks_file(source), fps))
    found = [explain(shot.particles) for shot in shots]
    target.parent.mkdir(parents=True, exist_ok=True)
    with aside(target) as fresh:
        write_places(fresh, shots, [finer(shot, one, factor) for shot, one in zip(shots, found, strict=True)])
    told = [_told(shot, one) for shot, one in zip(shots, found, strict=True)]
    if as_json:
        print(json.dumps({"tracks": str(target), "factor": factor, "shots": told}, allow_nan=False))
        return
    for shot in told:
        print(f"shot {shot['shot']}: {shot['particles']} particles, {shot['samples']} samples: {shot['motion']}")
        for line in described(shot):
            print(line)
    print(f"Look at {target}")


def finer(shot: Shot, found: Explained, factor: int) -> dict[str, FloatArray]:
    """Samples as they were, and factor - 1 places between each two; nothing before a particle was first seen or after
    it was last seen."""
    seen = shot.particles.seen
    coarse = np.arange(len(seen))
    t = np.interp(np.arange((len(coarse) - 1) * factor + 1) / factor, coarse, shot.particles.t)
    x = found.motion(t)
    first, last = seen.argmax(axis=0) * factor, (len(seen) - 1 - seen[::-1].argmax(axis=0)) * factor
    row = np.arange(len(t))[:, None]
    x[(row < first) | (row > last)] = np.nan
    x[::factor][seen] = shot.particles.x[seen]
    observed = np.zeros(x.shape[:2])
    observed[::factor] = seen
    known = np.where(np.isfinite(found.sigma), found.sigma, np.nan)
    return {"t": t, "x": x, "sigma": np.broadcast_to(known, observed.shape), "observed": observed}


def _told(shot: Shot, found: Explained) -> dict[str, Any]:
    sigma = float(np.sqrt(np.mean(found.sigma**2)))
    return {
        "shot": shot.number, "particles": len(shot.ids), "samples": len(shot.particles.t), "motion": found.kind,
        "sigma": sigma if np.isfinite(sigma) else None, **physics(found),
    }  # fmt: skip
