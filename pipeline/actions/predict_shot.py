"""Prediction of the rest of a shot from any moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError
from models.core.naming import Naming, build_naming
from models.core.number_format import format_measured
from models.core.tracks import Tracks
from models.estimation.forecast.current_state import estimate_state
from models.estimation.forecast.ensemble_prediction import ShotPrediction, forecast_shot
from models.estimation.forecast.forecast_check import check_prediction
from models.estimation.table_learning.learned_table import LearnedTable
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.engine.result_cache import ResultCache
from pipeline.io.explained_shot import explain_tracks
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.prediction_files import summarize_prediction, write_prediction
from pipeline.io.strict_json import format_strict_json
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans

STEP_S = 0.02
"""Time between rows of prediction.csv, s; times of later observations are added."""


def predict_shot(
    source: Path, seconds: float, at: float | None, number: int | None, learned: LearnedTable | None, seed: int,
    draws: int, folder: Path, cache: ResultCache,
) -> Answer:  # fmt: skip
    """Predict the rest of a shot, and write prediction.csv, prediction.json and prediction.png.

    Args:
        source: Run folder, track folder or tracks.csv.
        seconds: How far to predict, s.
        at: Time to predict from, s; None for the last observation.
        number: Number of the shot; None for the first.
        learned: What other shots taught about the table.
        seed: Random seed of the ensemble.
        draws: Number of ensemble members.
        folder: Folder of the results; created if it does not exist.
        cache: Holds the explanation of the past.

    Returns:
        Where the balls go; observations after `at` are compared, never used.

    Raises:
        OptionError: The source is no shot of billiards, or `at` lies outside it.
        TrackError: The motion until then is too short.
    """
    tracks, scene, number = read_observed_shot(source, number)
    require_writable_folder(folder)
    t = _choose_start_time(tracks, at)
    times = _list_prediction_times(tracks, t, seconds)
    naming = build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)
    state = estimate_state(tracks, scene, t, learned, lambda past, place: explain_tracks(past, place, cache))
    prediction = forecast_shot(state, times, seed, draws)
    later = check_prediction(prediction, tracks)
    document = summarize_prediction(prediction, number, later if len(later.t) else None, naming)
    folder.mkdir(parents=True, exist_ok=True)
    with replace_file(folder / "prediction.csv") as path:
        write_prediction(prediction, number, path)
    with replace_file(folder / "prediction.json") as path:
        path.write_text(format_strict_json(document), encoding="utf-8")
    with replace_file(folder / "prediction.png") as path:
        Image.fromarray(_draw_prediction(prediction, tracks, naming)).save(path, format="PNG")
    compared = [
        (naming.name_ball(row["id"]), f"{row['t']:.2f} s",
         *(f"{one} cm" for one in format_measured(row["error_mm"] / 10, row["sigma_mm"] / 10, 1)),
         "-" if row["within_90"] is None else f"{100 * row['within_90']:.0f} %")
        for row in document["compared"] or ()
    ]  # fmt: skip
    why = state.trust.reasons[0] if state.trust.level == "red" else ""
    return Answer(
        f"Where do the balls go from {t:.2f} s to {times[-1]:.2f} s?",
        tuple(ball["sentence"] for ball in document["balls"]),
        quantities=tuple(
            Quantity(axis, float(prediction.path[-1, k, column]), float(prediction.sigma[-1, k]), "m", ball)
            for k, ball in enumerate(state.ids)
            for column, axis in enumerate("xy")
        ),
        rows=(("seen later", "at", "off by", "expected ±", "time inside the 90 % area"), *compared) if compared else (),
        notes=(f"Do not trust this: {why}",) if why else (),
        document={"folder": str(folder), **document},
        figures=(str(folder / "prediction.png"), str(folder / "prediction.csv")),
    )  # fmt: skip


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
