"""What the page shows of a run, as JSON values, and what changed since the run before."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.ball_look import format_colour
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.events import Events
from models.core.fit_result import Fit
from models.core.naming import Naming
from models.core.number_format import format_probability
from models.core.scene import CUSHIONS, Game, Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.contact_test.shot_record import make_shot_record
from models.estimation.hand_marks.resolved_marks import update_ball_names
from pipeline.reporting.pages.run_report import answer_standard_questions
from pipeline.reporting.text.call_sentences import format_call
from pipeline.reporting.text.check_list import select_check_places
from pipeline.reporting.text.check_sentences import format_check_place
from pipeline.reporting.text.fit_sentences import format_outcomes
from pipeline.reporting.text.text_formatting import format_event, format_event_time

# s within which events of two runs with the same bodies are one.
SAME_EVENT_S = 0.1
# Standard deviations of time, and probability, by which an event must differ to be listed as changed.
NOTED_SIGMAS, NOTED_SHARE = 2.0, 0.05
# Ball classes that the page offers, by game.
GAME_CLASSES: dict[Game, tuple[str, ...]] = {
    "pool": ("cue", "solid", "stripe", "eight", "red", "yellow", "ball"),
    "snooker": ("cue", "red", "yellow", "green", "brown", "blue", "pink", "black", "ball"),
    "carom": ("white", "yellow", "red", "ball"),
}


@dataclass(frozen=True, slots=True)
class ClipRun:
    """The values of a run that the page needs."""

    fps: float
    """Nominal frame rate of the clip, 1/s."""
    scene: Scene
    tracks: Tracks
    fit: Fit
    tables: str = ""
    """Digest of its tables."""

    @property
    def frames(self) -> dict[str, Any]:
        """Numbers and times of its frames, as JSON values; duplicates between distinct frames are counted too."""
        return describe_frames(self.tracks.frame, self.tracks.t)


def describe_frames(distinct: IntArray, t: FloatArray) -> dict[str, Any]:
    """Describe frames by the distinct ones (T,) and their times (T,), s."""
    count = int(distinct[-1] - distinct[0]) + 1 if len(distinct) else 0
    first = int(distinct[0]) if count else 0
    times = np.interp(np.arange(first, first + count), distinct, t) if count else np.empty(0)
    return {"first": first, "count": count, "distinct": distinct.tolist(), "t": np.round(times, 5).tolist()}


def describe_run(run: ClipRun, before: ClipRun | None, corrections: Corrections = NO_CORRECTIONS) -> dict[str, Any]:
    """Describe a run for the page.

    Args:
        before: The run before the last correction; None for the first one.
        corrections: Corrections of the run.

    Returns:
        JSON values.
    """
    scene, tracks, fit = run.scene, run.tracks, run.fit
    trust = fit.trust
    calls = list_calls(run)
    naming = fit.naming
    return {
        "frames": run.frames,
        "image": [scene.camera.width_px, scene.camera.height_px],
        "moves": scene.camera.motion is not None,
        "fps": round(run.fps, 4),
        "corners": np.round(scene.camera.corners_px, 3).tolist(),
        "classes": list(GAME_CLASSES[scene.table.game]),
        "table": {"name": scene.table.name, "length": scene.table.length, "width": scene.table.width},
        "ball_radius": scene.table.ball_radius,
        "balls": _describe_balls(run),
        "rails": {name: naming.name_rail(name) for name in CUSHIONS},
        "events": _describe_events(run),
        "checks": [
            {
                "frame": place.frame, "t": place.t, "balls": list(place.balls),
                "px": _round_pixels(scene, place.xy, place.frame), "reason": format_check_place(place, fit.naming),
            }
            for place in select_check_places(tracks, fit, scene.table)
        ],
        "trust": {"level": trust.level, "reasons": list(trust.reasons)},
        "contradictions": _list_contradictions(run, corrections),
        "calls": calls,
        "changes": [] if before is None else compare_runs(before, run),
    }  # fmt: skip


def list_calls(run: ClipRun) -> dict[str, str]:
    """List the answers to the questions that the report asks.

    Returns:
        Answer by question.
    """
    fit, scene = run.fit, run.scene
    if not len(fit.trajectory.start):
        return {}
    record = make_shot_record(run.tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
    words = [format_call(call, fit.naming) for call in answer_standard_questions(record)]
    return {row.question: row.verdict for row in words}


def compare_runs(before: ClipRun, after: ClipRun) -> list[dict[str, str]]:
    """Compare two runs of a clip: table, names, events and calls.

    Args:
        before: The earlier run.
        after: The later run.

    Returns:
        Per difference its `kind`, added, removed, changed or call, and a `text`. A ball that is only called otherwise
        is one difference.
    """
    changes = []
    old, new = before.scene.table, after.scene.table
    if (old.name, old.length, old.width) != (new.name, new.length, new.width):
        changes.append(
            {"kind": "changed", "text": f"The table is {_format_table(new)} instead of {_format_table(old)}"}
        )
    matched = match_names(before.tracks, after.tracks)
    old_name, new_name = before.fit.naming.name_ball, after.fit.naming.name_ball
    names = {old_name(one): new_name(two) for one, two in matched.items() if old_name(one) != new_name(two)}
    changes += [{"kind": "changed", "text": f"{one} is now called {two}"} for one, two in names.items()]
    added = {new_name(one): "added" for one in after.tracks.ids if one not in matched.values()}
    removed = [(old_name(one), "removed") for one in before.tracks.ids if one not in matched]
    changes += [{"kind": kind, "text": f"a ball: {one}"} for one, kind in (*added.items(), *removed)]
    events = before.fit.events
    a, b = (tuple(matched.get(one, one) for one in column) for column in (events.a, events.b))
    looks = {one: after.fit.naming.looks[two] for one, two in matched.items() if two in after.fit.naming.looks}
    renamed = replace(before.fit.naming, looks={**before.fit.naming.looks, **looks})
    calls = list_calls(replace(before, fit=replace(before.fit, naming=renamed)))
    changes += compare_events(replace(events, a=a, b=b), after.fit.events, after.fit.naming)
    changes += [
        {"kind": "call", "text": f"{question} {answer} (before: {calls.get(question, 'no answer')})"}
        for question, answer in list_calls(after).items()
        if calls.get(question) != answer
    ]
    return changes


def match_names(before: Tracks, after: Tracks) -> dict[str, str]:
    """Match the balls of two runs of a clip by their places.

    Args:
        before: Tracks of the earlier run.
        after: Tracks of the later run.

    Returns:
        Id in the later run by id in the earlier one, of the balls that both have.
    """
    _, one, two = np.intersect1d(before.frame, after.frame, return_indices=True)
    gap = np.linalg.norm(before.px[one][:, :, None] - after.px[two][:, None, :], axis=-1)
    is_same = gap < np.nan_to_num(before.radius_px[one])[:, :, None]
    rows, columns = linear_sum_assignment(is_same.sum(axis=0), maximize=True)
    return {before.ids[i]: after.ids[j] for i, j in zip(rows, columns, strict=True) if is_same[:, i, j].any()}


def _format_table(table: Table) -> str:
    return f"{table.name}, {table.length:g} x {table.width:g} m"


def _list_contradictions(run: ClipRun, corrections: Corrections) -> list[dict[str, Any]]:
    """List where the motion contradicts a contact that was set by hand: a `text`, and its number in the corrections."""
    contacts = update_ball_names(corrections, run.tracks).contacts
    rows = []
    for outcome in run.fit.mark_outcomes:
        distances = []
        for number, mark in enumerate(contacts):
            names = {place.id for place in (mark.ball, mark.other) if place is not None}
            t = float(np.interp(mark.at, run.tracks.frame, run.tracks.t))
            if (mark.kind, mark.cushion) == (outcome.kind, outcome.cushion):
                distances.append((names != set(outcome.balls), abs(t - outcome.t), number))
        contact = min(distances)[2] if distances else None
        rows += [{"text": text, "contact": contact} for text in format_outcomes([outcome], run.fit.naming)]
    return rows


@dataclass(frozen=True, slots=True)
class ComparedEvent:
    """An event of a run, as two runs are compared."""

    identity: Hashable
    """Kind and bodies, or kind and player: what two events must have in common to be one."""
    t: float
    t_sigma: float
    probability: float
    text: str


def compare_events(before: Events, after: Events, naming: Naming) -> list[dict[str, str]]:
    """Compare the events of two runs; `naming` is what balls, rails and pockets are called."""
    rows = (
        [
            ComparedEvent((one.kind[k], frozenset((one.a[k], one.b[k]))), float(one.t[k]), float(one.t_sigma[k]),
                     float(one.probability[k]), f"{format_event_time(one, k)}: {format_event(one, k, naming)}")
            for k in range(len(one))
        ]
        for one in (before, after)
    )  # fmt: skip
    return compare_event_rows(*rows)


def compare_event_rows(before: Sequence[ComparedEvent], after: Sequence[ComparedEvent]) -> list[dict[str, str]]:
    """Compare the events of an earlier and a later run.

    Returns:
        Per difference its `kind`, added, removed or changed, and a `text`.
    """
    changes = []
    unmatched = list(before)
    for row in after:
        same = [one for one in unmatched if one.identity == row.identity and abs(one.t - row.t) <= SAME_EVENT_S]
        if not same:
            changes.append({"kind": "added", "text": row.text})
            continue
        own = min(same, key=lambda one: abs(one.t - row.t))
        unmatched.remove(own)
        moved = row.t - own.t
        if abs(moved) > NOTED_SIGMAS * math.hypot(own.t_sigma, row.t_sigma):
            changes.append({"kind": "changed", "text": f"{row.text}, {1000 * abs(moved):.1f} ms "
                            f"{'later' if moved > 0 else 'earlier'} than before"})  # fmt: skip
        elif abs(row.probability - own.probability) > NOTED_SHARE:
            old, new = (format_probability(one.probability) for one in (own, row))
            changes.append({"kind": "changed", "text": f"{row.text}: probability {new} instead of {old}"})
    return changes + [{"kind": "removed", "text": one.text} for one in unmatched]


def _describe_balls(run: ClipRun) -> list[dict[str, Any]]:
    """Describe every ball with its path: frame, x, y, radius (px), and whether it was detected."""
    tracks, scene = run.tracks, run.scene
    fitted = run.fit.trajectory.at(tracks.t).xy
    rows = []
    for k, name in enumerate(tracks.ids):
        observed = tracks.is_observed[:, k]
        shown = observed | np.isfinite(fitted[:, k, 0])
        px = np.where(
            observed[:, None],
            tracks.px[:, k],
            scene.camera.to_pixels(fitted[:, k], scene.table.ball_radius, tracks.frame),
        )
        radius = float(np.nanmedian(tracks.radius_px[:, k])) if observed.any() else 6.0
        look = tracks.looks[k]
        path = [
            [int(tracks.frame[row]), round(float(px[row, 0]), 2), round(float(px[row, 1]), 2), int(observed[row])]
            for row in np.flatnonzero(shown & np.isfinite(px[:, 0]))
        ]  # fmt: skip
        rows.append({"id": name, "name": look.name, "kind": tracks.kinds[k], "radius": round(radius, 2),
                     "colour": format_colour(look.colour), "path": path})  # fmt: skip
    return rows


def _describe_events(run: ClipRun) -> list[dict[str, Any]]:
    """Describe every event with its place in the image."""
    events = run.fit.events
    return [
        {
            "kind": events.kind[k], "t": round(float(events.t[k]), 5), "t_sigma": float(events.t_sigma[k]),
            "frame": round(float(events.frame[k]), 3), "a": events.a[k], "b": events.b[k], "xy": events.xy[k].tolist(),
            "px": _round_pixels(run.scene, events.xy[k], int(events.frame[k])),
            "probability": round(float(events.probability[k]), 4), "text": format_event(events, k, run.fit.naming),
            "share": format_probability(events.probability[k]), "when": format_event_time(events, k),
        }
        for k in range(len(events))
    ]  # fmt: skip


def _round_pixels(scene: Scene, xy: np.ndarray, frame: int) -> list[float] | None:
    """Return the pixel of a place (2,) on the table; None where it is unknown."""
    px = scene.camera.to_pixels(np.asarray(xy, float), scene.table.ball_radius, frame)
    return [round(float(px[0]), 2), round(float(px[1]), 2)] if np.isfinite(px).all() else None
