"""`trueroll predict`: predict the rest of a shot from any moment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image
from rich.table import Table as Grid

from models.core.errors import OptionError
from models.core.naming import Naming, build_naming
from models.core.tracks import Tracks
from models.estimation.forecast.current_state import estimate_state
from models.estimation.forecast.ensemble_prediction import ENSEMBLE_SIZE, ShotPrediction, forecast_shot
from models.estimation.forecast.forecast_check import check_prediction
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.engine.result_cache import open_cache
from pipeline.io.explained_shot import explain_tracks
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.particle_files import is_particle_source
from pipeline.io.prediction_files import summarize_prediction, write_prediction
from pipeline.io.strict_json import format_strict_json
from pipeline.terminal.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    OutBesideOption,
    app,
    make_output_console,
)
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans

STEP_S = 0.02
"""Time between rows of prediction.csv, s; times of later observations are added."""


@app.command("predict")
def predict(
    source: Annotated[
        Path, typer.Argument(metavar="DIR|tracks.csv", help="Folder of a run, a track folder, or a tracks.csv.")
    ],
    seconds: Annotated[float, typer.Option("--seconds", help="How far to predict, in s.")] = 3.0,
    at: Annotated[
        float | None,
        typer.Option("--at", metavar="T", help="Time to predict from, in s. Default: the last observation."),
    ] = None,
    out: OutBesideOption = None,
    shot: Annotated[
        int | None, typer.Option("--shot", help="Number of the shot in the folder. Default: the first.")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            "--fps", metavar="F", help="Frame rate of a tracks.csv of particles without t, in frames per second."
        ),
    ] = None,
    draws: Annotated[
        int, typer.Option("--draws", min=ENSEMBLE_SIZE, help="Number of ensemble members.")
    ] = ENSEMBLE_SIZE,
    profile: Annotated[
        Path | None,
        typer.Option("--profile", metavar="FILE", help="What trueroll fit-table or diagnose learned about this table."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Random seed of the ensemble.")] = 0,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Predict the rest of a shot from any moment, with its uncertainty; later observations are not used.

    A tracks.csv without a scene holds any particles: springs, colliding rigid bodies, or bodies in flight.
    """
    if not 0 < seconds <= 60:
        raise OptionError(f"--seconds is above 0 and at most 60; got {seconds:g}")
    if is_particle_source(source):
        from pipeline.actions.predict_particles import predict_particles  # slow to import

        predict_particles(source, seconds, at, out, shot, fps, as_json)
        return
    tracks, scene, number = read_observed_shot(source, shot)
    folder = out if out is not None else source if source.is_dir() else source.parent
    require_writable_folder(folder)
    t = _choose_start_time(tracks, at)
    times = _list_prediction_times(tracks, t, seconds)
    learned = None
    if profile is not None:
        from pipeline.io.table_profile import parse_learned_table, read_profile_text  # slow to import

        learned = parse_learned_table(read_profile_text(profile))
    store = open_cache(cache)
    naming = build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)
    state = estimate_state(tracks, scene, t, learned, lambda past, place: explain_tracks(past, place, store))
    prediction = forecast_shot(state, times, seed, draws)
    later = check_prediction(prediction, tracks)
    document = summarize_prediction(prediction, number, later if len(later.t) else None)
    folder.mkdir(parents=True, exist_ok=True)
    with replace_file(folder / "prediction.csv") as path:
        write_prediction(prediction, number, path)
    with replace_file(folder / "prediction.json") as path:
        path.write_text(format_strict_json(document), encoding="utf-8")
    with replace_file(folder / "prediction.png") as path:
        Image.fromarray(_draw_prediction(prediction, tracks, naming)).save(path, format="PNG")
    if as_json:
        print(format_strict_json({"folder": str(folder), **document}))
    else:
        _print_prediction(document, folder)


def _choose_start_time(tracks: Tracks, at: float | None) -> float:
    first, last = float(tracks.t[0]), float(tracks.t[-1])
    if at is None:
        return last
    if not first <= at <= last:
        raise OptionError(f"--at lies within what was seen, {first:.3f} to {last:.3f} s; got {at:g}")
    return at


def _list_prediction_times(tracks: Tracks, t: float, seconds: float) -> np.ndarray:
    """List evenly spaced times and the times of later observations, s."""
    even = t + np.append(np.arange(0.0, seconds - 1e-9, STEP_S), seconds)
    later = tracks.t[(tracks.t > t + 1e-9) & (tracks.t <= t + seconds)]
    apart = later[np.abs(later[:, None] - even).min(axis=1) > 1e-9] if len(later) else later
    near = even[:, None] - later
    exact = np.where(np.abs(near) <= 1e-9, later, -np.inf).max(axis=1, initial=-np.inf)
    return np.unique(np.concatenate([np.where(np.isfinite(exact), exact, even), apart]))


def _draw_prediction(prediction: ShotPrediction, tracks: Tracks, naming: Naming) -> np.ndarray:
    state = prediction.state
    fans = []
    for k, name in enumerate(state.ids):
        observed, past = tracks.xy[:, tracks.ids.index(name)], tracks.t <= state.t + 1e-9
        courses = prediction.members[:, :, k]
        later = observed[~past & (tracks.t <= prediction.t[-1])]
        fans.append(PredictionFan(name, observed[past], courses, later))
    dots = " Dots: what was seen." if any(len(fan.later_path) for fan in fans) else ""
    title = (
        f"From {state.t:.2f} to {prediction.t[-1]:.2f} s. The stronger the shade, the more of {len(prediction.members)}"
        f" possible courses pass there. Line: the most typical one.{dots}"
    )
    return draw_prediction_fans(state.table, naming, fans, title)


def _print_prediction(document: dict[str, Any], folder: Path) -> None:
    for ball in document["balls"]:
        print(ball["sentence"])
    if document["compared"]:
        grid = Grid("observed later", "at", "error", "predicted sigma", "in 90 % region", box=None, pad_edge=False)
        for row in document["compared"]:
            share = "-" if row["within_90"] is None else f"{100 * row['within_90']:.0f} %"
            grid.add_row(
                row["id"], f"{row['t']:.2f} s", f"{row['error_mm']:.1f} mm", f"{row['sigma_mm']:.1f} mm", share
            )
        make_output_console().print(grid)
    if document["trust"]["light"] == "red":
        print(f"Do not trust this: {document['trust']['why'][0]}")
    print(f"Look at {folder / 'prediction.png'} and {folder / 'prediction.csv'}")
