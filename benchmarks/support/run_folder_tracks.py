"""Rebuild tracks for the models from a run folder, using only the files that every user gets."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.support.run_folder import FOOTAGE, ROOT, RunFolder, read_run, run_clip
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock
from models.estimation.gap_scenes.billiards_scene import TimeJump, add_pauses, find_time_jumps
from models.estimation.reconstruction.capture_times import estimate_capture_times
from models.tracking.track_noise import NOISE_FLOOR_RADII, apply_noise, estimate_noise

_UNCERTAIN = np.empty(0)


@dataclass(frozen=True)
class FilmedClip:
    """One clip: its tracks at capture times, its table, and its clock."""

    name: str
    tracks: Tracks
    scene: Scene
    clock: CaptureClock
    time_jumps: tuple[TimeJump, ...]
    """Gaps of more frames than a clock may skip."""


def parse_clip_arguments(description: str | None) -> argparse.Namespace:
    """Parse the command line of a script over the real clips: `out`, `reuse`. SystemExit where there is no footage."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "out" / "real_clips", help="folder of the runs")
    parser.add_argument("--reuse", action="store_true", help="use existing run folders")
    arguments = parser.parse_args()
    if not FOOTAGE.is_dir():
        raise SystemExit(f"real footage is not at {FOOTAGE}")
    return arguments


def read_filmed_clips(game: str, folder: Path, reuse: bool) -> Iterator[FilmedClip]:
    """Read every real clip of a game, in order of name; clips without a reusable run folder are run first."""
    for file in sorted(FOOTAGE.glob(f"{game}_*.mp4")):
        tracks = folder / file.stem / "tracks.csv"
        if not (reuse and tracks.is_file()):
            outcome = run_clip(file, folder / file.stem)
            if not tracks.is_file():
                raise SystemExit(f"the run of {file.name} failed: {outcome.sentence}")
        yield read_filmed_clip(read_run(folder / file.stem))


def read_filmed_clip(run: RunFolder) -> FilmedClip:
    """Read the tracks of a run at estimated capture times.

    The clock corrects single dropped, duplicated or late frames; common jumps of all moving balls reveal longer gaps.
    """
    tracks, scene = _read_tracks(run), _read_scene(run)
    clock = estimate_capture_times(tracks, NOISE_FLOOR_RADII * scene.table.ball_radius)
    retimed, interval = replace(tracks, t=clock.capture_time), float(np.median(np.diff(tracks.t)))
    lost = find_time_jumps(retimed.record_positions(), interval)
    retimed = replace(retimed, t=add_pauses(retimed.t, lost, interval))
    return FilmedClip(run.path.name, retimed, scene, replace(clock, capture_time=retimed.t), lost)


def measure_noise(tracks: Tracks, radius: float) -> Tracks:
    """Return tracks with sigmas estimated from the samples, irregular capture times included."""
    return apply_noise(tracks, estimate_noise(tracks, 0.1, radius))


def _read_tracks(run: RunFolder) -> Tracks:
    c = run.tracks
    observed = (c["observed"] == 1) & np.isfinite(c["x"])
    frames, place = np.unique(c["frame"][observed], return_inverse=True)
    ids, ball = np.unique(c["id"][observed], return_inverse=True)
    shape = (len(frames), len(ids))
    grids = {name: np.full(shape, np.nan) for name in ("x", "y", "x_px", "y_px", "sigma", "radius_px")}
    for name, grid in grids.items():
        grid[place, ball] = c[name][observed]
    t = np.full(len(frames), np.nan)
    t[place] = c["t"][observed]
    kinds = tuple(str(c["kind"][observed][ball == k][0]) for k in range(len(ids)))
    xy = np.stack([grids["x"], grids["y"]], axis=-1)
    px = np.stack([grids["x_px"], grids["y_px"]], axis=-1)
    return Tracks(
        frames.astype(np.int64), t, tuple(str(i) for i in ids), kinds, xy, px, grids["sigma"], grids["sigma"],
        np.zeros_like(xy), grids["radius_px"], np.zeros((len(ids), 3)),
    )  # fmt: skip


def _read_scene(run: RunFolder) -> Scene:
    s, image = run.scene, run.scene["image"]
    table = Table(
        s["table"]["name"], s["table"]["game"], s["table"]["length"], s["table"]["width"], s["ball_radius"],
        s["ball_mass"], s["table"]["pockets"],
    )  # fmt: skip
    camera = Camera(
        np.array(s["calibration"]["matrix"]), int(image["width_px"]), int(image["height_px"]),
        np.array(s["calibration"]["corners_px"]), np.eye(8), "noses", 1.8, 0.6,
    )  # fmt: skip
    return Scene(table, camera, np.array(s["table"]["cloth_lab"]), ())
