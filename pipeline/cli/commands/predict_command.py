"""trueroll predict: the rest of a shot from any moment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from PIL import Image
from rich.table import Table as Grid

from models.core.errors import OptionError
from models.core.tracks import Tracks
from models.estimation.forecast.current_state import outlook_at
from models.estimation.forecast.ensemble_prediction import DRAWS, Prediction, predict
from models.estimation.forecast.forecast_check import hindsight
from models.estimation.forecast.probability_regions import outlyingness
from pipeline.actions.predict_particles import predict_particles
from pipeline.chain import refuse_closed
from pipeline.engine.atomic_write import aside
from pipeline.io.observed_shot import read_seen_shot
from pipeline.io.particle_files import is_particles
from pipeline.io.prediction_files import as_text, summary, write_prediction
from pipeline.terminal.command_line import DebugOption, JsonOption, app, named, standard_output
from video.drawing.prediction_fan import Fan, draw_fans

STEP = 0.02
"""s between rows of prediction.csv; moments at which balls were seen later come on top."""


@app.command("predict")
def predict_shot(
    source: Annotated[
        Path, typer.Argument(metavar="DIR|tracks.csv", help="A run's folder, a track folder, a tracks.csv.")
    ],
    seconds: Annotated[float, typer.Option("--seconds", help="How far to look ahead, s.")] = 3.0,
    at: Annotated[
        float | None, typer.Option("--at", metavar="T", help="From when, s; the end of what was seen if not given.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", parser=named, metavar="PATH", help="Folder of the results; DIR.")
    ] = None,
    shot: Annotated[int | None, typer.Option("--shot", help="Which shot of the folder; the first.")] = None,
    fps: Annotated[
        float | None,
        typer.Option("--fps", metavar="F", help="Of a tracks.csv of particles without t: frames a second."),
    ] = None,
    draws: Annotated[int, typer.Option("--draws", min=DRAWS, help="Courses of the ensemble.")] = DRAWS,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the ensemble.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The rest of a shot from any moment, with its uncertainty; nothing seen later is used.

    A tracks.csv without a scene is of any particles: springs, rigid bodies that collide, or bodies in flight.
    """
    if not 0 < seconds <= 60:
        raise OptionError(f"--seconds is above 0 and at most 60; got {seconds:g}")
    if is_particles(source):
        predict_particles(source, seconds, at, out, shot, fps, as_json)
        return
    tracks, scene, number = read_seen_shot(source, shot)
    folder = out if out is not None else source if source.is_dir() else source.parent
    refuse_closed(folder)
    t = _moment(tracks, at)
    found = predict(outlook_at(tracks, scene, t), _moments(tracks, t, seconds), seed, draws)
    later = hindsight(found, tracks)
    document = summary(found, number, later if len(later.t) else None)
    folder.mkdir(parents=True, exist_ok=True)
    with aside(folder / "prediction.csv") as path:
        write_prediction(found, number, path)
    with aside(folder / "prediction.json") as path:
        path.write_text(as_text(document), encoding="utf-8")
    with aside(folder / "prediction.png") as path:
        Image.fromarray(_picture(found, tracks)).save(path, format="PNG")
    if as_json:
        print(as_text({"folder": str(folder), **document}))
    else:
        _tell(document, folder)


def _moment(tracks: Tracks, at: float | None) -> float:
    first, last = float(tracks.t[0]), float(tracks.t[-1])
    if at is None:
        return last
    if not first <= at <= last:
        raise OptionError(f"--at lies within what was seen, {first:g} to {last:g} s; got {at:g}")
    return at


def _moments(tracks: Tracks, t: float, seconds: float) -> np.ndarray:
    """Even steps, and the moments of what was seen later."""
    even = t + np.append(np.arange(0.0, seconds - 1e-9, STEP), seconds)
    later = tracks.t[(tracks.t > t + 1e-9) & (tracks.t <= t + seconds)]
    apart = later[np.abs(later[:, None] - even).min(axis=1) > 1e-9] if len(later) else later
    near = even[:, None] - later
    exact = np.where(np.abs(near) <= 1e-9, later, -np.inf).max(axis=1, initial=-np.inf)
    return np.unique(np.concatenate([np.where(np.isfinite(exact), exact, even), apart]))


def _picture(found: Prediction, tracks: Tracks) -> np.ndarray:
    look = found.outlook
    fans = []
    for k, name in enumerate(look.ids):
        seen, past = tracks.xy[:, tracks.ids.index(name)], tracks.t <= look.t + 1e-9
        courses = found.courses[:, :, k]
        later = seen[~past & (tracks.t <= found.t[-1])]
        fans.append(Fan(name, seen[past], courses, outlyingness(courses), later))
    span = f"from {look.t:.2f} to {found.t[-1]:.2f} s"
    dots = "; dots: what was seen" if any(len(fan.after) for fan in fans) else ""
    title = f"{span}: shaded where 50 and 90 % of {len(found.courses)} courses go; line: the one nearest to all{dots}"
    return draw_fans(look.table, fans, title)


def _tell(document: dict[str, Any], folder: Path) -> None:
    for ball in document["balls"]:
        print(ball["sentence"])
    if document["compared"]:
        grid = Grid("seen later", "at", "error", "promised sigma", "in 90 % region", box=None, pad_edge=False)
        for row in document["compared"]:
            share = "-" if row["within_90"] is None else f"{row['within_90']:.0%}"
            grid.add_row(
                row["id"], f"{row['t']:.2f} s", f"{row['error_mm']:.1f} mm", f"{row['sigma_mm']:.1f} mm", share
            )
        standard_output().print(grid)
    if document["trust"]["light"] == "red":
        print(f"Do not trust this: {document['trust']['why'][0]}")
    print(f"Look at {folder / 'prediction.png'} and {folder / 'prediction.csv'}")
