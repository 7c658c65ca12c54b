"""Prediction of the rest of a shot from any moment, with its files prediction.csv, .json and .png."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError
from models.core.naming import Naming, build_naming
from models.core.number_format import format_measured, format_moment
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.contact_test.shot_record import NOSE_SIGMA
from models.estimation.forecast.ensemble_prediction import (
    QUANTILES,
    ShotPrediction,
    compute_quantiles,
    forecast_shot,
)
from models.estimation.forecast.forecast_check import PredictionCheck, check_prediction, estimate_state
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.table_learning.learned_table import LearnedTable
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.engine.result_cache import ResultCache
from pipeline.io.csv_tables import Columns, write_columns
from pipeline.io.image_file import write_image
from pipeline.io.kept_values import explain_tracks, load_shot
from pipeline.io.observed_shot import read_observed_shot
from pipeline.io.saved_shot import has_shot
from pipeline.io.strict_json import write_json
from pipeline.reporting.text.prediction_sentences import format_ball_prediction, stays_at_rest
from pipeline.reporting.text.text_formatting import summarize_trust
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans

# Time between rows of prediction.csv, s; times of later observations are added.
STEP_S = 0.02
# Samples per second of the drawn path until the prediction.
PATH_HZ = 60.0


@dataclass(frozen=True, slots=True)
class PredictedShot:
    """Prediction of the rest of a shot, beside what was seen of it."""

    prediction: ShotPrediction
    number: int
    """Number of the shot."""
    tracks: Tracks
    """All observations, also later ones."""
    motion: Trajectory
    """The fitted motion until the moment of the prediction."""
    naming: Naming
    calibration_sigma: float
    """m, of every place, where a camera filmed the shot."""
    assumed: tuple[str, ...]
    """What was assumed of the scene."""

    def draw_fans(self) -> list[PredictionFan]:
        """Return the fan of every ball, over the fitted motion until the moment of the prediction."""
        prediction, tracks, state = self.prediction, self.tracks, self.prediction.state
        past = self.motion.at(self.motion.sample_times(PATH_HZ)).xy
        is_later = (tracks.t > state.t + 1e-9) & (tracks.t <= prediction.t[-1])
        return [
            PredictionFan(
                name, past[:, self.motion.ids.index(name)], prediction.members[:, :, k],
                tracks.xy[is_later, tracks.ids.index(name)],
            )
            for k, name in enumerate(state.ids)
        ]  # fmt: skip


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
    require_writable_folder(folder)
    predicted = forecast_from(source, seconds, at, number, learned, seed, draws, cache)
    answer = state_prediction(predicted)
    write_prediction(predicted.prediction, predicted.number, folder / "prediction.csv")
    document = {name: value for name, value in answer.document.items() if name != "notes"}
    write_json(document, folder / "prediction.json")
    write_image(_draw_prediction(predicted), folder / "prediction.png")
    return replace(
        answer, document={"folder": str(folder), **answer.document},
        figures=(str(folder / "prediction.png"), str(folder / "prediction.csv")),
    )  # fmt: skip


def forecast_from(
    source: Path, seconds: float, at: float | None, number: int | None, learned: LearnedTable | None, seed: int,
    draws: int, cache: ResultCache,
) -> PredictedShot:  # fmt: skip
    """Predict the rest of a shot without writing files; the arguments and errors are those of `predict_shot`."""
    tracks, scene, number = read_observed_shot(source, number)
    first, last = float(tracks.t[0]), float(tracks.t[-1])
    t = last if at is None else at
    if not first <= t <= last:
        raise OptionError(f"must lie within what was seen, {first:.3f} to {last:.3f} s; got {t:g}", option="at")
    times = _list_prediction_times(tracks, t, seconds)
    shots: list[Shot] = []

    def explain_past(past: Tracks, place: Scene) -> Shot:
        shots.append(load_shot(source, number, cache) if t == last else explain_tracks(past, place, cache))
        return shots[0]

    state = estimate_state(tracks, scene, t, learned, explain_past)
    prediction = forecast_shot(state, times, seed, draws)
    motion, naming = view_shot(shots[0]).trajectory, build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)
    calibration, assumed = 0.0 if scene.camera is None else NOSE_SIGMA, () if has_shot(source) else scene.notes
    return PredictedShot(prediction, number, tracks, motion, naming, calibration, assumed)


def state_prediction(predicted: PredictedShot) -> Answer:
    """State a prediction in words and numbers, with the difference from what was seen later."""
    prediction, naming, state = predicted.prediction, predicted.naming, predicted.prediction.state
    later = check_prediction(prediction, predicted.tracks)
    document = summarize_prediction(prediction, predicted.number, later if len(later.t) else None, naming)
    compared = [
        (naming.name_ball(row["id"]), format_moment(row["t"]),
         *(f"{one} cm" for one in format_measured(row["error_mm"] / 10, row["sigma_mm"] / 10, 1)),
         "-" if row["within_90"] is None else f"{100 * row['within_90']:.0f} %")
        for row in document["compared"] or ()
    ]  # fmt: skip
    why = state.trust.reasons[0] if state.trust.level == "red" else ""
    return Answer(
        f"Where do the balls go from {format_moment(state.t)} to {format_moment(prediction.t[-1])}?",
        tuple(ball["sentence"] for ball in document["balls"]),
        quantities=tuple(
            Quantity(axis, ball["end"][axis], float(np.hypot(ball["end"]["sigma"], predicted.calibration_sigma)), "m",
                     ball["id"], naming.name_ball(ball["id"]))
            for ball in document["balls"] if ball["end"]
            for axis in "xy"
        ),
        rows=(("seen later", "at", "off by", "expected ±", "time inside the 90 % area"), *compared) if compared else (),
        notes=(
            *((f"Do not trust this: {why}",) if why else ()), *(f"Note: {note}." for note in predicted.assumed),
        ),
        document={"notes": list(predicted.assumed), **document},
    )  # fmt: skip


def _list_prediction_times(tracks: Tracks, t: float, seconds: float) -> np.ndarray:
    """List evenly spaced times and the times of later observations, s."""
    even = t + np.append(np.arange(0.0, seconds - 1e-9, STEP_S), seconds)
    later = tracks.t[(tracks.t > t + 1e-9) & (tracks.t <= t + seconds)]
    is_apart = np.abs(even[:, None] - later).min(axis=1, initial=np.inf) > 1e-9
    return np.unique(np.concatenate([even[is_apart], later]))


def _draw_prediction(predicted: PredictedShot) -> np.ndarray:
    """Draw where the balls may go, over the fitted motion until then."""
    prediction, fans = predicted.prediction, predicted.draw_fans()
    dots = " Dots: what was seen." if any(len(fan.later_path) for fan in fans) else ""
    title = (
        f"From {format_moment(prediction.state.t)} to {format_moment(prediction.t[-1])}. The stronger the shade, the"
        f" more of {len(prediction.members)} possible courses pass there. Line: the most typical one.{dots}"
    )
    return draw_prediction_fans(prediction.state.table, predicted.naming, fans, title)


def write_prediction(prediction: ShotPrediction, shot: int, path: Path) -> None:
    """Write prediction.csv: one row per time and ball that may be on the table.

    Args:
        prediction: Predicted motion of N balls.
        shot: Number of the shot.
        path: File to write; m, m/s, covariance in m^2, quantiles in m.
    """
    row, ball = np.nonzero(np.isfinite(prediction.path[..., 0]))
    cov = prediction.covariance[row, ball]
    columns: Columns = {
        "shot": np.full(len(row), shot), "t": prediction.t[row], "id": [prediction.state.ids[k] for k in ball],
        "x": prediction.path[row, ball, 0], "y": prediction.path[row, ball, 1],
        "vx": prediction.velocity[row, ball, 0], "vy": prediction.velocity[row, ball, 1],
        "sigma": prediction.sigma[row, ball],
        "xx": cov[:, 0, 0], "xy": cov[:, 0, 1], "yy": cov[:, 1, 1],
    }  # fmt: skip
    for axis, letter in enumerate("xy"):
        for name, values in _compute_quantiles(prediction, axis).items():
            columns[f"{letter}{name}"] = values[row, ball]
    columns["on_table"] = prediction.on_table[row, ball]
    columns["ensemble"] = prediction.is_ensemble[row].astype(np.int64)
    write_columns(columns, path)


def _compute_quantiles(prediction: ShotPrediction, axis: int) -> dict[str, FloatArray]:
    """Compute quantiles (T, N): normal at first, later those of the ensemble members with the ball on the table."""
    middle, spread = prediction.path[..., axis], np.sqrt(prediction.covariance[..., axis, axis])
    shares = compute_quantiles(prediction.members[..., axis])
    chosen = prediction.is_ensemble[:, None]
    pairs = zip(QUANTILES.items(), shares, strict=True)
    return {name: np.where(chosen, share, middle + ndtri(p) * spread) for (name, p), share in pairs}


def summarize_prediction(
    prediction: ShotPrediction, shot: int, check: PredictionCheck | None, naming: Naming
) -> dict[str, Any]:
    """Build the content of prediction.json: possible events, final positions, and a comparison with observations.

    Args:
        prediction: Predicted motion of N balls.
        shot: Number of the shot.
        check: Comparison with later observations; None without any.
        naming: What balls, rails and pockets are called.

    Returns:
        A tree of JSON values with the schema `trueroll.prediction/1`.
    """
    state = prediction.state
    return {
        "schema": "trueroll.prediction/1", "shot": shot, "t": state.t, "until": float(prediction.t[-1]),
        "linear_until": float(prediction.t[~prediction.is_ensemble].max(initial=state.t)),
        "draws": len(prediction.members),
        "trust": summarize_trust(state.trust),
        "balls": [_summarize_ball(prediction, k, naming) for k in range(len(state.ids))],
        "events": [
            {"kind": one.event[0], "a": one.event[1], "b": one.event[2], "probability": one.probability, "t": one.t,
             "t_sigma": one.t_sigma, "t05": one.t_low, "t95": one.t_high}
            for one in prediction.events
        ],
        "compared": None if check is None else _compare_with_observations(prediction, check),
    }  # fmt: skip


def _summarize_ball(prediction: ShotPrediction, k: int, naming: Naming) -> dict[str, Any]:
    on_table = float(prediction.on_table[-1, k])
    end = None
    if on_table > 0:
        row = 0 if stays_at_rest(prediction, k) else -1
        place, sigma = prediction.path[row, k], float(prediction.sigma[row, k])
        end = {"x": float(place[0]), "y": float(place[1]), "sigma": sigma, "on_table": on_table}
    first = [{"kind": what[0], "b": what[2], "probability": p} for what, p in prediction.first_contacts[k]]
    sentence = format_ball_prediction(prediction, k, naming)
    return {"id": prediction.state.ids[k], "sentence": sentence, "first": first, "end": end}


def _compare_with_observations(prediction: ShotPrediction, check: PredictionCheck) -> list[dict[str, Any]]:
    """Compare errors with predicted standard deviations and regions, for each ball that was observed later."""
    rows = []
    for k, name in enumerate(prediction.state.ids):
        own = check.ball == k
        if own.any():
            level = check.level[own & np.isfinite(check.level)]
            row = {"id": name, "t": float(check.t[own][-1])}
            for key, values in (("error_mm", 1e3 * check.error[own]), ("sigma_mm", 1e3 * check.sigma[own])):
                row |= {key: float(values[-1]), f"rms_{key}": float(np.sqrt(np.mean(values**2)))}
            shares = {f"within_{p}": float(np.mean(level <= p / 100)) if len(level) else None for p in (50, 90)}
            rows.append(row | shares)
    return rows
