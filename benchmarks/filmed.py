"""A run folder as tracks for the models: what any user of the program gets, put together again."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from run_folder import FOOTAGE, ROOT, RunFolder, read_run, run_clip

from models.core.capture_clock import Clock
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.gap_scenes.time_jumps import TimeJump, time_jumps, with_pauses
from models.estimation.reconstruction.capture_times import clock_of
from models.tracking.track_noise import FLOOR, estimate_noise, with_noise

_UNCERTAIN = np.empty(0)


@dataclass(frozen=True)
class Filmed:
    """One clip: its tracks at the times at which pictures were taken, its table, and its clock."""

    name: str
    tracks: Tracks
    scene: Scene
    clock: Clock
    lost: tuple[TimeJump, ...]
    """more pictures at once than a clock may lose."""


def asked_clips(description: str | None) -> argparse.Namespace:
    """The command line of a script over the real clips: `out`, `reuse`. SystemExit where there is no footage."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "real_clips", help="where the runs go")
    parser.add_argument("--reuse", action="store_true", help="take the run folders that are there")
    arguments = parser.parse_args()
    if not FOOTAGE.is_dir():
        raise SystemExit(f"real footage is not at {FOOTAGE}")
    return arguments


def filmed_clips(game: str, folder: Path, reuse: bool) -> Iterator[Filmed]:
    """Every real clip of a game, in order of name; run into `folder` first, unless it is there and may be reused."""
    for file in sorted(FOOTAGE.glob(f"{game}_*.mp4")):
        if not (reuse and (folder / file.stem / "tracks.csv").is_file()):
            run_clip(file, folder / file.stem)
        yield filmed(read_run(folder / file.stem))


def filmed(run: RunFolder) -> Filmed:
    """Tracks of a run at the times at which its balls say that pictures were taken: the clock tells of single pictures
    that were dropped, held or late, jumps of all that moves tell of whole stretches that are missing."""
    tracks, scene = _tracks(run), _scene(run)
    clock = clock_of(tracks, FLOOR * scene.table.ball_radius)
    taken, interval = replace(tracks, t=clock.taken), float(np.median(np.diff(tracks.t)))
    lost = time_jumps(taken, interval)
    taken = replace(taken, t=with_pauses(taken.t, lost, interval))
    return Filmed(run.path.name, taken, scene, replace(clock, taken=taken.t), lost)


def with_measured_noise(tracks: Tracks, radius: float) -> Tracks:
    """Tracks whose sigmas say what the samples show, irregular exposure times included."""
    return with_noise(tracks, estimate_noise(tracks, 0.1, radius))


def _tracks(run: RunFolder) -> Tracks:
    c = run.tracks
    seen = (c["observed"] == 1) & np.isfinite(c["x"])
    frames, place = np.unique(c["frame"][seen], return_inverse=True)
    ids, ball = np.unique(c["id"][seen], return_inverse=True)
    shape = (len(frames), len(ids))
    grids = {name: np.full(shape, np.nan) for name in ("x", "y", "x_px", "y_px", "sigma", "radius_px")}
    for name, grid in grids.items():
        grid[place, ball] = c[name][seen]
    t = np.full(len(frames), np.nan)
    t[place] = c["t"][seen]
    kinds = tuple(str(c["kind"][seen][ball == k][0]) for k in range(len(ids)))
    xy = np.stack([grids["x"], grids["y"]], axis=-1)
    px = np.stack([grids["x_px"], grids["y_px"]], axis=-1)
    return Tracks(
        frames.astype(np.int64), t, tuple(str(i) for i in ids), kinds, xy, px, grids["sigma"], grids["sigma"],
        np.zeros_like(xy), grids["radius_px"], np.zeros((len(ids), 3)),
    )  # fmt: skip


def _scene(run: RunFolder) -> Scene:
    s, picture = run.scene, run.scene["image"]
    table = Table(
        s["table"]["name"], s["table"]["game"], s["table"]["length"], s["table"]["width"], s["ball_radius"],
        s["ball_mass"], s["table"]["pockets"],
    )  # fmt: skip
    camera = Camera(
        np.array(s["calibration"]["matrix"]), int(picture["width_px"]), int(picture["height_px"]),
        np.array(s["calibration"]["corners_px"]), np.eye(8), "noses", 1.8, 0.6,
    )  # fmt: skip
    return Scene(table, camera, np.array(s["table"]["cloth_lab"]), ())
