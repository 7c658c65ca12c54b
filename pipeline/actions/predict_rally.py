"""Prediction of a flight from any moment of a rally, with its files prediction.csv and prediction.json."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from models.core.answer import Answer, Quantity
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.errors import OptionError
from models.core.number_format import format_moment, format_with_sigma
from models.core.progress import ignore_progress
from models.core.rally import BallCandidates, Rally
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.point_judgement import name_half
from models.estimation.rally.rally_views import PlacesInSpace, continue_flight
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.csv_tables import SHOT_NUMBER, Columns, write_columns
from pipeline.io.strict_json import write_json
from pipeline.reporting.text.rally_sentences import assess_rally_trust, describe_landing_call, format_landing
from pipeline.reporting.text.text_formatting import summarize_trust

# Seconds of observation without which no flight is known.
LEAST_PAST_S = 0.1


def predict_rally(
    rally: Rally, seconds: float, at: float | None, folder: Path, corrections: Corrections = NO_CORRECTIONS
) -> Answer:
    """Predict where the object flies from a moment on, by the places at which it was seen until then.

    Which detections are of the object was decided with the whole clip; the flight and its errors use those until then.

    Args:
        seconds: How far to predict, s; a prediction ends at the playing surface or the floor.
        at: Time to predict from, s; None for the last place at which it was seen.
        folder: Folder of the results; created if it does not exist.
        corrections: What a person corrected; places and events until then count.

    Returns:
        Where it would land unless somebody returns it, with the difference from what was seen later.

    Raises:
        OptionError: The time is outside of what was seen, no flight is known there, or the object rolls.
    """
    require_writable_folder(folder)
    path, answer = state_flight_prediction(rally, seconds, at, corrections)
    write_flight_prediction(path, rally.scene.sport.object.name, folder / "prediction.csv")
    write_json(answer.document, folder / "prediction.json")
    document = {"folder": str(folder), **answer.document}
    return replace(answer, document=document, figures=(str(folder / "prediction.csv"),))


def state_flight_prediction(
    rally: Rally, seconds: float, at: float | None, corrections: Corrections = NO_CORRECTIONS
) -> tuple[PlacesInSpace, Answer]:
    """Predict a flight without writing files; the arguments and errors are those of `predict_rally`.

    Returns:
        The predicted path, and the answer.
    """
    own = np.flatnonzero(np.isfinite(rally.px[:, 0]))
    if not len(own):
        raise OptionError("nothing was seen to fly in this rally, so nothing can be predicted")
    first, last = float(rally.t[own[0]]), float(rally.t[own[-1]])
    t = last if at is None else at
    if not first + LEAST_PAST_S <= t <= last:
        raise OptionError(
            f"must lie within what was seen, {first + LEAST_PAST_S:.3f} to {last:.3f} s; got {t:g}", option="at"
        )
    past = rally if t == last else explain_past(rally, t, corrections)
    if not past.flights:
        raise OptionError(f"is a time at which a flight is known; {t:g} s is none, a later one may be", option="at")
    name, call = rally.scene.sport.object.name, judge_landing(past)
    if call.landing is not None and call.landing.is_rolling and call.landing.t <= t:
        begin = format_moment(call.landing.t)
        raise OptionError(
            f"is a time at which nothing flies: from {begin} on the {name} rolls on the {name_half(past, call.landing)}"
            " half of the table; choose an earlier one",
            option="at",
        )
    path = _continue_from(past, t, seconds)
    words = format_landing(call, past)
    until = min((one.t for one in rally.events if one.t > t), default=np.inf)  # what comes then was not foreseen
    later = own[(rally.t[own] > t + 1e-9) & (rally.t[own] <= min(path.t[-1], until))]
    error = _compare_later(rally, path, later)
    document = {
        "schema": "trueroll.flight_prediction/1", "t": t, "until": float(path.t[-1]), "object": name,
        "trust": summarize_trust(assess_rally_trust(past)), "landing": describe_landing_call(call, past),
        "compared": {"frames": len(later), "rms_px": error},
    }  # fmt: skip
    end = path.xyz[-1]
    spread = np.sqrt(np.maximum(np.diag(path.covariance[-1]), 0.0))
    place = ", ".join(
        f"{axis} = {format_with_sigma(float(end[k]), float(spread[k]))} m" for k, axis in enumerate("xyz")
    )
    sentence = f"From {format_moment(t)} the {name} flies to {place} at {format_moment(float(path.t[-1]))}."
    quantities = [Quantity("xyz"[k], float(end[k]), float(spread[k]), "m") for k in range(3)]
    quantities.append(Quantity("time", float(path.t[-1]), unit="s"))
    off = f"Where it was seen later lies {error:.1f} px from there in the image, rms over {len(later)} frames."
    return path, Answer(
        f"Where does the {name} fly from {format_moment(t)}?",
        tuple(filter(None, (sentence, words.sentence if call.landing else "", off if len(later) else ""))),
        quantities=tuple(quantities), document=document,
    )  # fmt: skip


def explain_past(rally: Rally, t: float, corrections: Corrections = NO_CORRECTIONS) -> Rally:
    """Explain a rally by what was seen, and what a person corrected, until a time, s."""
    from models.estimation.rally.explain_rally import explain_rally  # slow to import

    rows = np.flatnonzero(rally.t <= t + 1e-9)
    own = rows[np.isfinite(rally.px[rows, 0])]
    candidates = BallCandidates(
        rally.frame[own], rally.px[own], rally.streak[own], np.ones(len(own)), rally.px_sigma[own, 0],
        rally.px_sigma[own, 1], rally.players[rally.players[:, 0] <= rally.frame[rows[-1]]],
    )  # fmt: skip
    last = int(rally.frame[rows[-1]])
    past = corrections.select_span(int(rally.frame[rows[0]]), last + 1)
    parts = (part for one in corrections.events for part in one.split_move())
    past = replace(past, events=tuple(part for part in parts if part.frame <= last))
    return explain_rally(rally.scene, candidates, rally.frame[rows], rally.t[rows], ignore_progress, past)


def _continue_from(past: Rally, t: float, seconds: float) -> PlacesInSpace:
    """Continue the last flight of a rally from a time, s, within or after it."""
    index = len(past.flights) - 1
    flight = past.flights[index]
    cut = replace(flight, end=max(min(t, flight.end), flight.start))
    until = max(t - cut.end, 0.0) + seconds
    path = continue_flight(replace(past, flights=(*past.flights[:index], cut)), index, until)
    rows = np.flatnonzero(path.t >= min(t, float(path.t[-1])) - 1e-9)
    return PlacesInSpace(path.t[rows], path.xyz[rows], path.v[rows], path.covariance[rows])


def _compare_later(rally: Rally, path: PlacesInSpace, later: np.ndarray) -> float:
    """Compare a path with places that were seen later, px root mean square; NaN without any."""
    if not len(later):
        return float("nan")
    xyz = np.stack([np.interp(rally.t[later], path.t, path.xyz[:, k]) for k in range(3)], axis=1)
    off = rally.scene.camera.to_pixels(xyz, rally.frame[later]) - rally.px[later]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def write_flight_prediction(path: PlacesInSpace, name: str, file: Path) -> None:
    """Write prediction.csv: a row per time; m, m/s, m^2.

    Args:
        name: Id of the object.
        file: File to write.
    """
    sigma = np.sqrt(np.maximum(np.trace(path.covariance, axis1=1, axis2=2), 0.0) / 3)
    columns: Columns = {
        "shot": np.full(len(path.t), SHOT_NUMBER), "t": path.t, "id": [name] * len(path.t),
        "x": path.xyz[:, 0], "y": path.xyz[:, 1], "z": path.xyz[:, 2],
        "vx": path.v[:, 0], "vy": path.v[:, 1], "vz": path.v[:, 2], "sigma": sigma,
        "xx": path.covariance[:, 0, 0], "xy": path.covariance[:, 0, 1], "yy": path.covariance[:, 1, 1],
        "zz": path.covariance[:, 2, 2],
    }  # fmt: skip
    write_columns(columns, file)
