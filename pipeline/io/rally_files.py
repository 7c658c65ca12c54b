"""The tables of a rally: tracks.csv, events.csv, strokes.csv, trajectory.csv and scene.json."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.rally import FLIGHT_PARAMETERS, Flight, Rally
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray
from models.estimation.rally.rally_columns import RallyTrajectory, tabulate_tracks
from models.estimation.rally.stroke_summary import Stroke, summarize_strokes
from pipeline.io.corrections_file import describe_corrections
from pipeline.io.csv_tables import SHOT_NUMBER, Columns, write_columns
from pipeline.io.strict_json import format_strict_json
from pipeline.reporting.text.rally_sentences import assess_rally_trust, format_rally_notes
from pipeline.reporting.text.text_formatting import summarize_trust
from video.io.clip import Clip

TRAJECTORY_HZ = 1000.0
# Columns of times.
TIMES = ("t", "landing_t")
# Numbers of a stroke in strokes.csv: s, km/h, m.
STROKE_NUMBERS = (
    "t", "t_sigma", "probability", "speed_kmh", "speed_kmh_sigma", "apex", "apex_sigma", "net", "net_sigma",
    "in_probability", "out_probability", "landing_t", "landing_x", "landing_y", "landing_x_sigma", "landing_y_sigma",
    "landing_seen",
)  # fmt: skip
# Units of `FLIGHT_PARAMETERS`; a turn-over drag is one too.
UNITS = ("m", "m", "m", "m/s", "m/s", "m/s", "1/m", "1/m", "1/m", "1/m", "1/m", "1", "1")
CAMERA_PARAMETERS = (
    "x (m)", "y (m)", "z (m)", "rotation 1 (rad)", "rotation 2 (rad)", "rotation 3 (rad)", "log focal length (px)",
    "k1",
)  # fmt: skip


def write_rally_files(clip: Clip, rally: Rally, folder: Path, corrections: Corrections = NO_CORRECTIONS) -> None:
    """Write tracks.csv, events.csv, strokes.csv, trajectory.csv and scene.json.

    Args:
        clip: The clip, for its facts.
        folder: An existing folder.
        corrections: What a person corrected.
    """
    clock = build_rally_clock(clip, rally)
    tables = {"tracks.csv": _tabulate_places(rally), "events.csv": _tabulate_events(rally),
              "trajectory.csv": _tabulate_flights(rally, clock)}  # fmt: skip
    for name, columns in tables.items():
        write_columns(_state_shown_times(columns, clock), folder / name)
    write_columns(tabulate_strokes(rally, clock), folder / "strokes.csv")
    document = {**describe_rally(clip, rally), "set_by_hand": describe_corrections(corrections)}
    (folder / "scene.json").write_text(format_strict_json(document), encoding="utf-8")


def build_rally_clock(clip: Clip, rally: Rally) -> CaptureClock:
    """Build the clock that relates when frames of a rally were taken to when its clip shows them."""
    return CaptureClock(clip.times_of(rally.frame), rally.t, np.zeros(len(rally.t)))


def _state_shown_times(columns: Columns, clock: CaptureClock) -> Columns:
    """Replace the times of a table, at which something happened, by those at which the clip shows it."""
    return columns | {one: clock.presentation_time_at(np.asarray(columns[one])) for one in TIMES if one in columns}


def _tabulate_places(rally: Rally) -> Columns:
    """Tabulate tracks.csv: a row per frame in which the object was seen, or filled in by physics (`observed` 0)."""
    tracks = tabulate_tracks(rally)
    return {
        "shot": np.full(len(tracks), SHOT_NUMBER), "frame": tracks.frame, "t": tracks.t,
        "id": [*tracks.ids] * len(tracks), "kind": [*tracks.ids] * len(tracks),
        "x_px": tracks.px[:, 0], "y_px": tracks.px[:, 1],
        "x": tracks.xyz[:, 0], "y": tracks.xyz[:, 1], "z": tracks.xyz[:, 2], "sigma": tracks.sigma,
        "radius_px": tracks.radius_px, "observed": tracks.is_observed.astype(np.int64),
    }  # fmt: skip


def _tabulate_events(rally: Rally) -> Columns:
    """Tabulate events.csv: hits, bounces, touches of the net and landings; `b` is the player of a hit."""
    events = rally.events
    t = np.array([one.t for one in events], np.float64)
    place = np.array([one.place for one in events], np.float64).reshape(-1, 3)
    blank = np.full(len(events), np.nan)
    return {
        "shot": np.full(len(events), SHOT_NUMBER), "kind": [one.kind for one in events], "t": t,
        "t_sigma": np.array([one.t_sigma for one in events], np.float64), "frame": find_frames(rally, t),
        "a": [rally.scene.sport.object.name] * len(events), "b": [one.player for one in events],
        "x": place[:, 0], "y": place[:, 1], "z": place[:, 2],
        "probability": np.array([one.probability for one in events], np.float64),
        "gap_mm": blank, "gap_mm_sigma": blank, "speed": np.array([one.speed for one in events], np.float64),
    }  # fmt: skip


def tabulate_strokes(rally: Rally, clock: CaptureClock) -> Columns:
    """Tabulate the strokes: speed at the racket, apex, height over the net, landing and its probabilities.

    The landing is where the object first touched the surface, or would have had nobody returned it (`landing_seen` 0).
    Times are those of the clip.
    """
    strokes = summarize_strokes(rally)
    numbers = np.array([_list_numbers(one) for one in strokes], np.float64).reshape(-1, len(STROKE_NUMBERS))
    columns: Columns = {
        "shot": np.full(len(strokes), SHOT_NUMBER), "frame": find_frames(rally, numbers[:, 0]),
        "player": [one.hit.player for one in strokes],
    }  # fmt: skip
    return _state_shown_times({**columns, **dict(zip(STROKE_NUMBERS, numbers.T, strict=True))}, clock)


def _list_numbers(stroke: Stroke) -> list[float]:
    """List the `STROKE_NUMBERS` of a stroke; NaN where they are not known."""
    hit, net, call = stroke.hit, stroke.net, stroke.call
    numbers = [hit.t, hit.t_sigma, hit.probability, 3.6 * hit.speed, 3.6 * hit.speed_sigma]
    numbers += [float(stroke.apex[2]), stroke.apex_sigma]
    numbers += [math.nan] * 2 if net is None else [net.height, net.height_sigma]
    landing = None if call is None else call.landing
    if call is None or landing is None:
        return numbers + [math.nan] * 8
    sigma = np.sqrt(np.diag(landing.covariance))
    numbers += [call.probability, call.out_probability, landing.t]
    return [*numbers, *landing.place[:2].tolist(), *sigma[:2].tolist(), float(landing.is_seen)]


def find_frames(rally: Rally, t: FloatArray) -> FloatArray:
    """Find the fractional numbers (K,) of the frames at times t (K,) s."""
    if len(rally.t) < 2:
        return np.full(len(t), float(rally.frame[0]) if len(rally.t) else np.nan)
    return np.asarray(np.interp(t, rally.t, rally.frame.astype(np.float64)))


def _tabulate_flights(rally: Rally, clock: CaptureClock) -> Columns:
    """Tabulate trajectory.csv: flights at `TRAJECTORY_HZ` of the clip; where none covers a time, there is no row."""
    motion, flights = RallyTrajectory(rally), rally.flights
    ends = [min((one.start for one in flights), default=0.0), max((one.end for one in flights), default=-1.0)]
    first, last = clock.presentation_time_at(np.array(ends)).tolist()
    t = np.arange(math.ceil(first * TRAJECTORY_HZ), math.floor(last * TRAJECTORY_HZ) + 1) / TRAJECTORY_HZ
    t = clock.capture_time_at(t)
    places = motion.at(t)
    rows = np.flatnonzero(np.isfinite(places.xyz[:, 0]))
    xyz, v, blank = places.xyz[rows], places.v[rows], np.full(len(rows), np.nan)
    sigma = np.sqrt(np.trace(places.covariance[rows], axis1=1, axis2=2) / 3)
    return {
        "shot": np.full(len(rows), SHOT_NUMBER), "t": t[rows], "id": [*motion.ids] * len(rows),
        "x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2], "vx": v[:, 0], "vy": v[:, 1], "vz": v[:, 2],
        "wx": blank, "wy": blank, "wz": blank, "sigma": sigma, "sigma_v": blank,
    }  # fmt: skip


def describe_rally(clip: Clip, rally: Rally) -> dict[str, Any]:
    """Describe the scene of a rally as JSON values: court, calibration, flights, landings and trust level."""
    sport, camera = rally.scene.sport, rally.scene.camera
    dropped = int(np.count_nonzero(np.isfinite(rally.px[:, 0]) & ~rally.is_used))
    chi2 = [one.chi2 for one in rally.flights if math.isfinite(one.chi2)]
    used, clock = rally.px_sigma[rally.is_used], build_rally_clock(clip, rally)
    return {
        "scene": "rally",
        "sport": sport.name,
        "units": "m",
        "fps": float(clip.fps),
        "court": {"length": sport.length, "width": sport.width, "floor": sport.floor,
                  "net": {"height": sport.net.height, "post_height": sport.net.post_height,
                          "overhang": sport.net.overhang},
                  "areas": {name: [list(one) for one in areas] for name, areas in sport.areas.items()}},
        "object": {"name": sport.object.name, "radius": sport.object.radius, "mass": sport.object.mass},
        "image": {"width_px": camera.width_px, "height_px": camera.height_px},
        "calibration": {
            "matrix": camera.matrix,
            "matrix_about": "(x, y, z above the surface, 1) in m to homogeneous px of the reference image without"
            " distortion",
            "parameters": dict(zip(CAMERA_PARAMETERS, camera.parameters.tolist(), strict=True)),
            "covariance": camera.covariance, "is_left_handed": camera.is_left_handed,
            "camera_moves": camera.motion is not None, "line_error_px": rally.scene.line_error,
        },
        "model": ["gravity", "air_drag", *(["lift"] if sport.object.lift else []),
                  *(["turn_drag"] if sport.object.turn_drag.mean else [])],
        "flights": [_describe_flight(one) for one in rally.flights],
        "landings": [
            {"probability": one.weight, "t": float(clock.presentation_time_at(np.array(one.t))),
             "t_sigma": one.t_sigma, "place": one.place, "covariance": one.covariance, "is_seen": one.is_seen,
             "is_rolling": one.is_rolling}
            for one in rally.landings
        ],
        "no_landing": rally.no_landing,
        "fit": {"noise_px": float(np.sqrt(np.mean(used**2))) if len(used) else math.nan,
                "chi2_per_dof": float(np.mean(chi2)) if chi2 else math.nan,
                "observed": int(np.isfinite(rally.px[:, 0]).sum()), "not_used": dropped},
        "trust": summarize_trust(assess_rally_trust(rally)),
        "notes": list(dict.fromkeys([*clip.notes, *format_rally_notes(rally)])),
        "clip": {"sha256": clip.digest, "frames": clip.frame_count, "distinct": len(clip.distinct_frames),
                 "repeats": clip.frames[clip.is_duplicate].tolist(), "first_frame": clip.first_frame,
                 "begins": float(clip.t[0]), "seconds": float(clip.t[-1] - clip.t[0])},
    }  # fmt: skip


def _describe_flight(flight: Flight) -> dict[str, Any]:
    """Describe a flight with its parameters at its start, each with sigma and unit."""
    sigma = np.sqrt(np.maximum(np.diag(flight.covariance), 0.0))
    return {
        "start": flight.start, "end": flight.end, "begins_with_hit": flight.begins_with_hit,
        "chi2_per_dof": flight.chi2, "covariance": flight.covariance,
        "parameters": {
            name: {"value": float(flight.parameters[k]), "sigma": float(sigma[k]), "unit": UNITS[k]}
            for k, name in enumerate(FLIGHT_PARAMETERS)
        },
    }  # fmt: skip
