"""What the page shows of a run of a rally, as JSON values, and what changed since the run before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.fit_result import is_undecided
from models.core.number_format import format_probability, format_time
from models.core.rally import Rally
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.rally_marks import note_contradiction, resolve_marks
from pipeline.editing.run_view import ComparedEvent, compare_event_rows, describe_frames
from pipeline.reporting.text.rally_sentences import assess_rally_trust, format_landing, format_rally_event
from pipeline.reporting.text.stroke_sentences import format_point
from pipeline.reporting.text.text_formatting import start_sentence

# px, radius and colour with which the ball or shuttle is drawn: it measures three to eight pixels.
RADIUS_PX, COLOUR = 6.0, "#ffffff"


@dataclass(frozen=True, slots=True)
class CourtRun:
    """The values of a run of a rally that the page needs."""

    fps: float
    """Nominal frame rate of the clip, 1/s."""
    rally: Rally
    tables: str = ""
    """Digest of its tables."""


def describe_rally_run(
    run: CourtRun, before: CourtRun | None, corrections: Corrections = NO_CORRECTIONS
) -> dict[str, Any]:
    """Describe a run of a rally for the page; arguments and keys are those of `describe_run`."""
    rally = run.rally
    sport, camera, trust = rally.scene.sport, rally.scene.camera, assess_rally_trust(rally)
    first = int(rally.frame[0]) if len(rally.frame) else 0
    corners = camera.to_pixels(np.column_stack([sport.corners, np.zeros(4)]), np.full(4, first))
    name, events = sport.object.name, _describe_events(rally)
    return {
        "frames": describe_frames(rally.frame, rally.t),
        "image": [camera.width_px, camera.height_px],
        "moves": camera.motion is not None,
        "fps": round(run.fps, 4),
        "corners": np.round(corners, 3).tolist(),
        "table": {"name": sport.name, "length": sport.length, "width": sport.width},
        "balls": [
            {"id": name, "name": name, "kind": name, "radius": RADIUS_PX, "colour": COLOUR, "path": [
                [int(rally.frame[k]), *np.round(rally.px[k], 2).tolist(), 1]  # detected, also where no flight has it
                for k in np.flatnonzero(np.isfinite(rally.px[:, 0]))
            ]}
        ],
        "rails": {}, "events": events,
        "checks": [
            {"frame": round(one["frame"]), "t": one["t"], "balls": [name], "px": one["px"],
             "reason": f"{one['text']}: {one['share']}"}
            for one in events if is_undecided(one["probability"])
        ],
        "trust": {"level": trust.level, "reasons": list(trust.reasons)},
        "contradictions": _list_contradictions(rally, corrections),
        "calls": _list_calls(rally),
        "changes": [] if before is None else _compare(before.rally, rally),
    }  # fmt: skip


def _describe_events(rally: Rally) -> list[dict[str, Any]]:
    """Describe every event with its place in the image."""
    name, rows = rally.scene.sport.object.name, []
    for one in rally.events:
        frame = float(np.interp(one.t, rally.t, rally.frame))
        px = rally.scene.camera.to_pixels(one.place, int(rally.frame[np.argmin(np.abs(rally.t - one.t))]))
        rows.append({
            "kind": one.kind, "t": one.t, "t_sigma": one.t_sigma, "a": name, "b": "", "player": one.player,
            "frame": round(frame, 3), "px": np.round(px, 2).tolist() if np.isfinite(px).all() else None,
            "probability": one.probability, "text": format_rally_event(one, name),
            "share": format_probability(one.probability), "when": format_time(one.t, one.t_sigma),
        })  # fmt: skip
    return rows


def _list_contradictions(rally: Rally, corrections: Corrections) -> list[dict[str, Any]]:
    """List where the flights contradict what was set by hand: a `text`, and the number of a contradicted event."""
    own = [
        (note_contradiction(mark, rally.events), number)
        for number, one in enumerate(corrections.events)
        for mark in resolve_marks([one], rally.frame, rally.t)
    ]
    rows = []
    for note in (one for one in rally.notes if "-set-by-hand-" in one):
        match = next((one for one in own if one[0] == note), None)
        if match is not None:
            own.remove(match)  # of marks with the same sentence, each has its own
        number = None if match is None else match[1]
        rows.append({"text": f"{start_sentence(note.replace('-', ' '))}.", "contact": number})
    return rows


def _list_calls(rally: Rally) -> dict[str, str]:
    """List the answers that the report gives first, by question."""
    call = judge_landing(rally)
    words = format_landing(call, rally)
    return {"Who won the last point?": format_point(rally, call).headline, words.question: words.verdict}


def _compare(before: Rally, after: Rally) -> list[dict[str, str]]:
    """Compare two runs of a rally: court, events and answers."""
    old, new = before.scene.sport.name, after.scene.sport.name
    changes = [] if old == new else [{"kind": "changed", "text": f"The court is of {new} instead of {old}"}]
    changes += compare_event_rows(*([
        ComparedEvent((one.kind, one.player), one.t, one.t_sigma, one.probability,
                 f"{format_time(one.t, one.t_sigma)}: {format_rally_event(one, rally.scene.sport.object.name)}")
        for one in rally.events
    ] for rally in (before, after)))  # fmt: skip
    calls = _list_calls(before)
    return changes + [
        {"kind": "call", "text": f"{question} {answer} (before: {calls.get(question, 'no answer')})"}
        for question, answer in _list_calls(after).items()
        if calls.get(question) != answer
    ]
