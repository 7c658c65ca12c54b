"""The tables of a run: tracks.csv, events.csv, trajectory.csv and scene.json."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.events import Events
from models.core.fit_result import Fit, Parameter
from models.core.scene import Camera, Scene
from models.core.tracks import Tracks
from models.core.trajectory import State, Trajectory
from models.core.typing import FloatArray
from pipeline.reporting.text.run_trust import run_trust, trust_facts
from video.io.clip import Clip

Columns = dict[str, Sequence[str] | NDArray[Any]]

TRAJECTORY_HZ = 1000.0
DEFAULT_MODEL = ("rolling_resistance", "sliding_friction", "spin_decay", "cushion_restitution", "ball_restitution")
DECIMALS = {
    "x": 6,
    "y": 6,
    "sigma": 6,
    "t": 6,
    "t_sigma": 6,
    "x_px": 3,
    "y_px": 3,
    "radius_px": 2,
    "frame": 3,
    "xx": 12,
    "xy": 12,
    "yy": 12,
}
"""Places kept of each column (m, s, px); others get six."""
SHOT = 0
OF_TABLE = ("collision_radius", "nose")
"""What a fit tells that is no effect of the catalogue."""


def write_tracks(scene: Scene, tracks: Tracks, fit: Fit, path: Path) -> None:
    """One row per ball and distinct picture: as seen, or where the physics puts it (`observed` 0)."""
    filled = fit.trajectory.at(tracks.t)
    seen = tracks.observed
    row, ball = np.nonzero(seen | (np.isfinite(filled.xy[..., 0]) & ~filled.measured))
    observed = seen[row, ball]
    frame = tracks.frame[row]
    xy = np.where(observed[:, None], tracks.xy[row, ball], filled.xy[row, ball])
    computed = scene.camera.to_pixels(filled.xy[row, ball], scene.table.ball_radius, frame)
    px = np.where(observed[:, None], tracks.px[row, ball], computed)
    radius = np.where(observed, tracks.radius_px[row, ball], scene.camera.radius_px(xy, scene.table.ball_radius))
    columns: Columns = {
        "shot": np.full(len(row), SHOT), "frame": frame, "t": tracks.t[row],
        "id": [tracks.ids[k] for k in ball], "kind": [tracks.kinds[k] for k in ball],
        "x_px": px[:, 0], "y_px": px[:, 1], "x": xy[:, 0], "y": xy[:, 1],
        "sigma": np.where(observed, tracks.sigma[row, ball], filled.sigma[row, ball]),
        "radius_px": radius, "observed": observed.astype(np.int64),
    }  # fmt: skip
    write_columns(columns, path)


def write_events(events: Events, path: Path) -> None:
    """One row per event; gaps in mm."""
    columns: Columns = {
        "shot": np.full(len(events), SHOT), "kind": list(events.kind), "t": events.t, "t_sigma": events.t_sigma,
        "frame": events.frame, "a": list(events.a), "b": list(events.b), "x": events.xy[:, 0], "y": events.xy[:, 1],
        "probability": events.probability, "gap_mm": 1000 * events.gap, "gap_mm_sigma": 1000 * events.gap_sigma,
        "speed": events.speed,
    }  # fmt: skip
    write_columns(columns, path)


def write_trajectory(motion: Trajectory, path: Path) -> None:
    """The fitted motion at `TRAJECTORY_HZ`, ball by ball."""
    first = float(motion.start.min()) if len(motion.start) else 0.0
    last = float(motion.end.max()) if len(motion.end) else 0.0
    t = np.arange(math.ceil(first * TRAJECTORY_HZ), math.floor(last * TRAJECTORY_HZ) + 1) / TRAJECTORY_HZ
    write_states(motion.ids, t, motion.at(t), path)


def write_states(ids: tuple[str, ...], t: FloatArray, state: State, path: Path) -> None:
    """Balls `ids` (N,) at times t (T,), ball by ball; no row where a ball is not."""
    ball, row = np.nonzero(np.isfinite(state.xy[..., 0]).T) if len(ids) else (np.empty(0, int),) * 2
    columns: Columns = {"shot": np.full(len(row), SHOT), "t": t[row], "id": [ids[k] for k in ball]}
    for name, values in (
        ("x", state.xy[..., 0]), ("y", state.xy[..., 1]), ("vx", state.v[..., 0]), ("vy", state.v[..., 1]),
        ("wx", state.w[..., 0]), ("wy", state.w[..., 1]), ("wz", state.w[..., 2]),
        ("sigma", state.sigma), ("sigma_v", state.sigma_v),
    ):  # fmt: skip
        columns[name] = values[row, ball]
    write_columns(columns, path)


def write_scene(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, path: Path) -> None:
    """Table, calibration, the fitted model and how far to trust it."""
    table, trust = scene.table, run_trust(clip, fit)
    document = {
        "scene": "billiards",
        "units": "m",
        "fps": float(clip.rate),
        "table": {"name": table.name, "game": table.game, "length": table.length, "width": table.width,
                  "pockets": table.pockets, "cloth_lab": scene.cloth_lab.tolist()},
        "ball_radius": table.ball_radius,
        "ball_mass": table.ball_mass,
        "image": _image(scene.camera, table.ball_radius, scene),
        "calibration": _calibration(scene),
        "model": sorted(_effects(fit)) or list(DEFAULT_MODEL),
        "effects": _effects(fit),
        "laws": _laws(fit, table.ball_radius),
        "balls": _balls(tracks, fit),
        "fit": _quality(tracks, fit),
        "trust": trust_facts(trust),
        "notes": [*clip.notes, *scene.notes],
        "clip": {"sha256": clip.digest, "frames": clip.frame_count, "distinct": len(clip.distinct),
                 "repeats": np.flatnonzero(clip.repeat).tolist(), "seconds": float(clip.t[-1])},
    }  # fmt: skip
    path.write_text(json.dumps(_strict(document), indent=1, allow_nan=False), encoding="utf-8")


def _image(camera: Camera, radius: float, scene: Scene) -> dict[str, Any]:
    centre = np.array([scene.table.length / 2, scene.table.width / 2])
    scale = 1 / math.sqrt(abs(float(np.linalg.det(camera.metres_per_pixel(centre, radius)))))
    origin = camera.to_pixels(np.zeros(2), radius)
    return {"px_per_m": scale, "origin_px": origin.tolist(), "width_px": camera.width_px, "height_px": camera.height_px}


def _calibration(scene: Scene) -> dict[str, Any]:
    camera = scene.camera
    return {
        "plane": camera.plane,
        "matrix": camera.matrix.tolist(),
        "matrix_about": "(x, y, z above the cloth, 1) in m to homogeneous px of the reference picture",
        "corners_px": camera.corners_px.tolist(),
        "corner_covariance_px2": camera.corner_covariance.tolist(),
        "camera_height": camera.height,
        "camera_height_sigma": camera.height_sigma,
        "camera_moves": camera.motion is not None,
    }


def _effects(fit: Fit) -> dict[str, dict[str, Any]]:
    """Numbers of the effects of the catalogue; what else a fit of whole shots tells stands with its laws."""
    effects: dict[str, dict[str, Any]] = {}
    for p in fit.parameters if fit.laws is None else fit.laws.parameters:
        effect, _, name = p.name.partition(".")
        if effect not in OF_TABLE:
            effects.setdefault(effect, {})[name] = _number(p)
    return effects


def _number(p: Parameter) -> dict[str, Any]:
    return {"value": p.value, "sigma": p.sigma, "unit": p.unit, "prior_only": p.prior_only}


def _laws(fit: Fit, radius: float) -> dict[str, Any]:
    """By which laws balls and cushions touch, the radius at which they do, and where the noses are beyond the table."""
    if fit.laws is None:
        return {"cushion": None, "ball": None, "why": fit.lawless}
    told = {p.name: p for p in fit.laws.parameters}
    factor = told["collision_radius.factor"]
    size = replace(factor, value=factor.value * radius, sigma=factor.sigma * radius, unit="m")
    noses = {name.partition(".")[2]: _number(p) for name, p in told.items() if name.startswith("nose.")}
    return {
        "cushion": fit.laws.cushion,
        "ball": fit.laws.ball,
        "chi2_per_dof": fit.laws.chi2_per_dof,
        "collision_radius": _number(size),
        "noses": noses,
    }


def _balls(tracks: Tracks, fit: Fit) -> list[dict[str, Any]]:
    """Each ball with its state where its motion begins; where laws explain the whole shot, with its spin at the strike
    and the covariance of all seven numbers."""
    balls, motion = [], fit.trajectory
    for k, ball in enumerate(motion.ids):
        rows = np.flatnonzero(motion.ball == k)
        facts: dict[str, Any] = {"id": ball, "kind": tracks.kinds[tracks.ids.index(ball)]}
        if fit.laws is not None and ball in fit.laws.ids:
            at = fit.laws.ids.index(ball)
            facts |= _state(fit.laws.t, fit.laws.state[at], fit.laws.covariance[at])
        elif len(rows):
            first = rows[0]
            state = [*motion.position[first, 0], *motion.position[first, 1], *motion.spin[first, 0]]
            facts |= _state(motion.start[first], state, motion.covariance[first])
        balls.append(facts)
    return balls


def _state(t: float, state: Sequence[float] | FloatArray, covariance: FloatArray) -> dict[str, Any]:
    names = ("x", "y", "vx", "vy", "wx", "wy", "wz")
    return {"t": t, **dict(zip(names, state, strict=True)), "covariance": covariance.tolist()}


def _quality(tracks: Tracks, fit: Fit) -> dict[str, float]:
    """Noise, misfit, and how many ball-seconds of motion an accepted fit explains."""
    step = np.gradient(tracks.t)[:, None] if len(tracks.t) > 1 else np.zeros((len(tracks.t), 1))
    return {
        "noise_m": fit.noise,
        "chi2_per_dof": fit.chi2_per_dof,
        "moving_s": float(np.sum(step * fit.moving)),
        "accepted_s": float(np.sum(step * (fit.moving & fit.accepted))),
    }


def _strict(data: Any) -> Any:
    """The same tree with NaN and infinity as null, which strict JSON wants."""
    if isinstance(data, Mapping):
        return {key: _strict(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_strict(value) for value in data]
    if isinstance(data, float | np.floating):
        return float(data) if math.isfinite(data) else None
    return data.item() if isinstance(data, np.generic) else data


def write_columns(columns: Columns, path: Path) -> None:
    """A csv with rounded numbers and empty cells for NaN."""
    arrays = {}
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.dtype.kind == "f":
            rounded = np.round(values, DECIMALS.get(name, 6)) + 0.0
            arrays[name] = pa.array(rounded, mask=~np.isfinite(rounded))
        elif isinstance(values, np.ndarray):
            arrays[name] = pa.array(values)
        else:
            arrays[name] = pa.array(list(values), type=pa.string())
    csv.write_csv(pa.table(arrays), path, csv.WriteOptions(quoting_style="none", quoting_header="none"))
