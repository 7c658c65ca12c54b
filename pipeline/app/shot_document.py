"""What the page shows of a shot or a rally, as JSON values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.events import Events
from models.core.fit_result import Fit
from models.core.rally import Rally
from models.core.scene import POCKETS, Table
from models.core.trajectory import Trajectory
from models.core.typing import FloatArray
from models.estimation.contact_test.rule_answers import FIRST_BALL_GROUPS
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.stroke_summary import Stroke, sample_flights, summarize_strokes
from models.physics.billiards.cushion_geometry import find_mouth_line
from models.physics.billiards.tables import TABLE_PRESETS
from models.sports.sport_catalogue import find_sports
from pipeline.app.open_shots import OpenShot
from pipeline.editing.edit_session import EditSession
from pipeline.editing.rally_view import CourtRun, describe_rally_run
from pipeline.editing.run_view import ClipRun, describe_run
from pipeline.io.strict_json import read_json
from pipeline.reporting.pages.run_report import SUMMARY_FILE, answer_standard_questions
from pipeline.reporting.text.number_sentences import format_shot_line, list_number_rows
from pipeline.reporting.text.rally_sentences import format_landing, format_rally_event
from pipeline.reporting.text.shot_summary import ShotSummary, summarize_shots
from pipeline.reporting.text.stroke_sentences import NOT_KNOWN, STROKE_HEADINGS, format_point, list_stroke_rows
from pipeline.reporting.text.text_formatting import start_sentence
from video.calibration.table_classifier import D_RADIUS_WIDTHS

# Places of a path per second on a plan.
PLAN_HZ = 50.0
SLOW_MOTION = "slow.mp4"


def describe_shot(opened: OpenShot, session: EditSession | None, why_no_session: str = "") -> dict[str, Any]:
    """Describe a shot of billiards.

    Args:
        session: Its session of corrections; None where it cannot be corrected.
        why_no_session: Why not, as a sentence.

    Returns:
        JSON values; NaN may be among them.
    """
    state = _describe_state(session, why_no_session)
    if state["run"] is None:  # until the first run of a session
        run = opened.run
        assert isinstance(run, ClipRun)
        state["run"] = describe_run(run, None, opened.shot.corrections)
    if opened.motion is None:
        opened.motion = _describe_motion(opened)
    return state | opened.motion | {
        "kind": "shot", "tables": list(TABLE_PRESETS), "game": opened.shot.scene.table.game,
        "balls_on": list(FIRST_BALL_GROUPS[opened.shot.scene.table.game]), "clip": opened.has_clip,
        "video": _describe_video(opened, float(opened.shot.tracks.t[0]), float(opened.shot.tracks.t[-1])),
    }  # fmt: skip


def _describe_state(session: EditSession | None, why_no_session: str) -> dict[str, Any]:
    """Describe the corrections and the run of a session; None as run without one, or until its first run."""
    if session is not None:
        return session.describe() | asdict(session.status)
    return {
        "revision": 0, "result": 0, "corrections": {}, "set_by_hand": [],
        "notice": why_no_session, "run": None,
    }  # fmt: skip


def _describe_motion(opened: OpenShot) -> dict[str, Any]:
    """Describe what only the saved shot decides: summary, numbers and plan."""
    fit, table, tracks = opened.fit, opened.shot.scene.table, opened.shot.tracks
    calls = answer_standard_questions(opened.record) if len(fit.trajectory.start) else ()
    return {
        "summary": [line for one in summarize_shots(tracks, fit, table, (), calls) for line in _list(one)],
        "numbers": _describe_numbers(fit, table.ball_radius),
        "plan": {
            "length": table.length, "width": table.width, "ball_radius": table.ball_radius,
            "turns": fit.naming.view.turns, "pockets": _describe_pockets(table, fit),
            "paths": _describe_paths(fit.trajectory, fit.events),
            "baulk": opened.baulk_line, "d_radius": D_RADIUS_WIDTHS * table.width,
        },
    }  # fmt: skip


def _list(summary: ShotSummary) -> list[str]:
    """List the sentences of a summary in the order of the report."""
    lines = (summary.score, summary.first, summary.speed, summary.after, summary.spread, summary.potted,
             *summary.ends, summary.confidence)  # fmt: skip
    return [line for line in lines if len(line) > 1]


def _describe_numbers(fit: Fit, radius: float) -> list[dict[str, Any]]:
    """Describe the numbers for players, stroke by stroke."""
    return [
        {
            "title": start_sentence(format_shot_line(one, fit.naming, fit.events)),
            "rows": [[f"{name}, {subject}", value] for name, subject, value, _ in
                     list_number_rows(one, fit.naming, radius)],
        }
        for one in fit.shot_numbers
    ]  # fmt: skip


def _describe_pockets(table: Table, fit: Fit) -> list[dict[str, Any]]:
    """Describe the pockets of a table by their mouths; none for a table without."""
    names = POCKETS if table.pockets else ()
    mouths = [find_mouth_line(table, name).ends for name in names]
    return [
        {"name": name, "label": fit.naming.name_pocket(name), "x": float(x), "y": float(y),
         "radius": float(np.linalg.norm(mouth[1] - mouth[0])) / 2}
        for name, mouth, (x, y) in zip(names, mouths, table.pocket_centres, strict=True)
    ]  # fmt: skip


def _describe_paths(trajectory: Trajectory, events: Events) -> list[dict[str, Any]]:
    """Describe the fitted paths, with their corners at the events; null where a ball is off the table."""
    if not len(trajectory.start):
        return []
    t = np.union1d(trajectory.sample_times(PLAN_HZ), events.t[np.isfinite(events.t)])
    return list_paths(trajectory.ids, t, trajectory.at(t).xy)


def list_paths(ids: Sequence[str], t: FloatArray, places: FloatArray) -> list[dict[str, Any]]:
    """List paths of N balls as JSON values: id, t (s), and x, y, also z where there is one (m).

    Args:
        ids: Names of the balls.
        t: Times (T,), s.
        places: (T, N, 2 or 3) m; NaN where a ball is absent.
    """
    times, places = np.round(t, 4).tolist(), np.round(places, 4)
    return [
        {"id": name, "t": times, **{axis: places[:, k, n].tolist() for n, axis in enumerate("xyz"[: places.shape[2]])}}
        for k, name in enumerate(ids)
    ]


def _describe_video(opened: OpenShot, begin: float, end: float) -> dict[str, Any] | None:
    """Describe which time of the clip the slow motion shows when; None without it, or for a run that notes no times."""
    if not (opened.folder / SLOW_MOTION).is_file():
        return None
    try:
        times = read_json(opened.folder / SUMMARY_FILE, "A run folder has a summary.json")["video"]
        start, slow = float(times["start"]), float(times["slow"])
    except (OptionError, KeyError, TypeError, ValueError):
        return None
    start = max(start, begin)
    return {"file": SLOW_MOTION, "map": [[0.0, start], [(end - start) * slow, end]]}


def describe_rally(opened: OpenShot, session: EditSession | None, why_no_session: str = "") -> dict[str, Any]:
    """Describe a rally over a net; arguments and return value are those of `describe_shot`."""
    rally, state = opened.rally, _describe_state(session, why_no_session)
    if state["run"] is None:  # until the first run of a session
        run = opened.run
        assert isinstance(run, CourtRun)
        state["run"] = describe_rally_run(run, None)
    sport, name = rally.scene.sport, rally.scene.sport.object.name
    strokes, call = summarize_strokes(rally), judge_landing(rally)
    point = format_point(rally, call)
    middle, out = sport.length / 2, sport.net.overhang
    flights = sample_flights(rally, 1 / PLAN_HZ)
    return state | {
        "kind": "rally", "tables": [],
        "summary": [point.headline, point.reason, f"How sure: {point.confidence}"],
        "numbers": _describe_stroke_numbers(rally, strokes),
        "areas": list(sport.areas),
        "plan": {
            "length": sport.length, "width": sport.width, "sport": sport.name, "halves": list(sport.halves),
            "is_filmed_from_side": sport.is_filmed_from_side, "net_height": sport.net.height,
            "lines": [[*one.start, *one.end] for one in sport.lines],
            "net": [middle, -out, middle, sport.width + out],
            "paths": [path for one in flights for path in list_paths([name], one.t, one.xyz[:, None])],
        },
        "landings": [_describe_landing(rally, one) for one in strokes if one.call is not None and one.call.landing],
        "strokes": [
            {
                "t": one.hit.t, "player": one.hit.player, "x": float(one.hit.place[0]), "y": float(one.hit.place[1]),
                "speed": one.hit.speed, "text": format_rally_event(one.hit, name),
            }
            for one in strokes
        ],
        "sports": list(find_sports()),
        "video": _describe_video(opened, float(rally.t[0]), float(rally.t[-1])),
        "clip": opened.has_clip,
    }  # fmt: skip


def _describe_stroke_numbers(rally: Rally, strokes: tuple[Stroke, ...]) -> list[dict[str, Any]]:
    """Describe the numbers of every stroke that are known."""
    return [
        {
            "title": f"Stroke {k + 1}, {cells[0]}",
            "rows": [[start_sentence(heading), cell] for heading, cell in
                     zip(STROKE_HEADINGS[1:], cells[1:], strict=True) if cell not in ("", NOT_KNOWN)],
        }
        for k, (_, cells) in enumerate(list_stroke_rows(rally, strokes))
    ]  # fmt: skip


def _describe_landing(rally: Rally, stroke: Stroke) -> dict[str, Any]:
    """Describe where a stroke landed, or would have."""
    call = stroke.call
    assert call is not None
    assert call.landing is not None
    landing = call.landing
    return {
        "t": landing.t, "x": float(landing.place[0]), "y": float(landing.place[1]),
        "sxx": float(landing.covariance[0, 0]), "sxy": float(landing.covariance[0, 1]),
        "syy": float(landing.covariance[1, 1]), "verdict": call.verdict,
        "probability": max(call.probability, call.out_probability), "is_seen": landing.is_seen,
        "text": format_landing(call, rally).sentence,
    }  # fmt: skip
