"""Scores of what the program says about rendered rallies, against their truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from scipy.stats import beta

from benchmarks.court_cases.court_clips import CourtTruth
from benchmarks.court_cases.landing_bound import bound_landing
from models.core.typing import BoolArray, FloatArray

# px (of 1280) within which the object is found, and from which on what is found is something else.
FOUND_PX, FALSE_PX = 5.0, 10.0
# m/s from which on it is expected to be found: before the serve it lies in a hand, at the end on the floor.
MOVING = 0.5
# m from a line within which a landing is close.
CLOSE = 0.10
# Frames within which a certain event must have a true one.
CERTAIN_FRAMES = 3.0


@dataclass(frozen=True)
class RallyScore:
    """Numbers of one clip, or of many: lists are joined."""

    visible: int = 0
    found: int = 0
    candidate: int = 0
    """Visible frames with a candidate that is the object."""
    stated: list[float] = field(default_factory=list)
    """Probabilities of all candidates."""
    is_own: list[bool] = field(default_factory=list)
    """Whether each of them is the object."""
    frames: int = 0
    false: int = 0
    refused: int = 0
    clips: int = 0
    off_px: list[float] = field(default_factory=list)
    events: int = 0
    events_found: int = 0
    events_extra: int = 0
    nets: int = 0
    """Touches of the net before the landing."""
    nets_found: int = 0
    nets_false: int = 0
    """Touches held for more probable than not that did not happen."""
    landing: list[float] = field(default_factory=list)
    """m, errors of the landing place."""
    landings_missed: int = 0
    bound: list[float] = field(default_factory=list)
    """m, errors drawn from the least covariance that each view allows."""
    z: list[float] = field(default_factory=list)
    """Errors of landings in standard deviations, along the principal axes."""
    close_right: int = 0
    close_wrong: int = 0
    close_open: int = 0
    certain: int = 0
    certain_false: int = 0
    speed: list[float] = field(default_factory=list)
    """Relative errors of speeds at the racket."""
    speed_z: list[float] = field(default_factory=list)
    line: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    """CPU s per frame."""


def join_scores(scores: Sequence[RallyScore]) -> RallyScore:
    """Add the scores of clips."""
    empty = RallyScore()
    columns: dict[str, Any] = {}
    for one in fields(RallyScore):
        values = [getattr(score, one.name) for score in scores]
        columns[one.name] = sum(values, [] if isinstance(getattr(empty, one.name), list) else 0)
    return RallyScore(**columns)


def score_answer(truth: CourtTruth, answer: dict[str, Any]) -> RallyScore:
    """Score what the program says about a clip."""
    is_visible, frames = find_visible(truth), len(truth.columns["t"])
    if answer["error"]:
        return RallyScore(
            visible=int(is_visible.sum()), frames=frames, refused=1, clips=1, events=len(true_events(truth))
        )
    landing = _score_landing(truth, answer)
    events = _score_events(truth, answer)
    return RallyScore(
        **_score_places(truth, answer), **events, **landing, clips=1, line=[answer["line_error"]],
        seconds=[sum(s for name, s in answer["seconds"].items() if name != "wall") / frames],
    )  # fmt: skip


def find_visible(truth: CourtTruth) -> BoolArray:
    """Return the frames (T,) in which the object can be seen and moves."""
    steps = np.linalg.norm(np.diff(truth.columns["xyz"], axis=0), axis=1) * truth.fps
    speed = np.maximum(np.append(steps, 0.0), np.append(0.0, steps))
    return np.asarray(truth.columns["is_visible"].astype(bool) & (speed > MOVING))


def _score_places(truth: CourtTruth, answer: dict[str, Any]) -> dict[str, Any]:
    columns, scale = truth.columns, truth.stated["width"] / 1280
    px = np.full(columns["px"].shape, np.nan)
    px[np.array(answer["frame"], int)] = np.array(answer["px"], np.float64).reshape(-1, 2)
    off = np.linalg.norm(px - columns["px"], axis=1) / scale
    is_visible, stated = find_visible(truth), np.isfinite(px).all(axis=1)
    near = is_visible & stated & (off < FOUND_PX)
    # a place at the object is not false where it is barely visible
    false = stated & (~(off < FALSE_PX) | (columns["shown"] < 0.02))
    frame = np.array(answer["candidates"]["frame"], int)
    centre = np.array(answer["candidates"]["px"], np.float64).reshape(-1, 2)
    close = np.linalg.norm(centre - columns["px"][frame], axis=1) / scale < FOUND_PX
    hit = np.zeros(len(is_visible), bool)
    hit[frame[close]] = True
    return {
        "stated": answer["candidates"]["score"], "is_own": close.tolist(),
        "visible": int(is_visible.sum()), "found": int(near.sum()), "candidate": int((hit & is_visible).sum()),
        "frames": len(is_visible), "false": int(false.sum()), "off_px": off[near].tolist(),
    }  # fmt: skip


def true_events(truth: CourtTruth) -> list[dict[str, Any]]:
    """Return hits, bounces and the landing; what follows the landing, and touches of the net, are left to chance."""
    return [e for e in truth.stated["events"] if not e.get("after") and e["kind"] != "net"]


def stated_events(answer: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the events that the program holds for more probable than not, its landing included."""
    events = [e for e in answer["events"] if e["probability"] >= 0.5 and e["kind"] != "net"]
    best = answer["landings"][0] if answer["landings"] else None
    touches = [e["t"] for e in events if e["kind"] != "hit"]
    if best and best["weight"] >= 0.5 and not any(abs(t - best["t"]) < 0.02 for t in touches):
        events.append({"kind": "landing", "probability": best["weight"], **best})
    return events


def _score_events(truth: CourtTruth, answer: dict[str, Any]) -> dict[str, Any]:
    expected, events = true_events(truth), stated_events(answer)
    late = [e for e in truth.stated["events"] if e.get("after")]
    pairs, free = [], list(range(len(events)))
    for one in expected:
        gaps = [(abs(events[i]["t"] - one["t"]), i) for i in free if is_hit(events[i]) == is_hit(one)]
        gap, best = min(gaps, default=(np.inf, -1))
        # the frame in which it happens, or its neighbours
        if gap * truth.fps <= 1.0 + 1e-6:
            pairs.append((one, events[best]))
            free.remove(best)
    extra = [i for i in free if not any(abs(events[i]["t"] - e["t"]) * truth.fps <= 2 for e in late)]
    strokes = {round(s["t"] - truth.stated["start"], 6): s for s in truth.stated["strokes"]}
    speed, speed_z = [], []
    for one, other in pairs:
        stroke = strokes.get(round(one["t"], 6))
        if is_hit(one) and stroke is not None and np.isfinite(other["speed"]):
            speed.append(abs(other["speed"] / stroke["speed"] - 1))
            speed_z.append((other["speed"] - stroke["speed"]) / max(other["speed_sigma"], 1e-9))
    touches = [e for e in answer["events"] if e["probability"] >= 0.5 and e["kind"] == "net"]
    certain = [e for e in events + touches if e["probability"] >= 0.99]
    every = truth.stated["events"]
    nets = [e for e in every if e["kind"] == "net" and not e.get("after")]
    false = [e for e in certain if not any(_is_near(e, o, truth) for o in every)]
    call, is_in = answer["call"], truth.stated["ending"]["is_in"]
    called = max(call["in"], call["out"]) >= 0.99
    wrong = called and (call["in"] > call["out"]) != is_in
    return {
        "events": len(expected), "events_found": len(pairs), "events_extra": len(extra),
        "nets": len(nets), "nets_found": sum(any(_is_near(e, o, truth) for e in touches) for o in nets),
        "nets_false": sum(not any(_is_near(e, o, truth) for o in every) for e in touches),
        "speed": speed, "speed_z": speed_z,
        "certain": len(certain) + int(called), "certain_false": len(false) + int(wrong),
    }  # fmt: skip


def _is_near(stated: dict[str, Any], other: dict[str, Any], truth: CourtTruth) -> bool:
    """Check whether an event is of the same kind as a true one, ground, net or hit, and within some frames of it."""
    is_same = is_hit(stated) == is_hit(other) and (stated["kind"] == "net") == (other["kind"] == "net")
    return bool(is_same and abs(stated["t"] - other["t"]) * truth.fps <= CERTAIN_FRAMES)


def is_hit(event: dict[str, Any]) -> bool:
    """Check whether an event is a hit; the others are touches of the ground, or of the net."""
    return bool(event["kind"] == "hit")


def _score_landing(truth: CourtTruth, answer: dict[str, Any]) -> dict[str, Any]:
    ending = truth.stated["ending"]
    place = np.array(ending["place"])
    least = _keep_bound(truth)
    score: dict[str, Any] = {"bound": [] if least is None else draw_errors(least)}
    # a landing that more probably does not happen is no answer
    best = answer["landings"][0] if sum(one["weight"] for one in answer["landings"]) >= 0.5 else None
    if best is None:
        score["landings_missed"] = 1
    else:
        off = np.array(best["place"])[:2] - place[:2]
        score["landing"] = [float(np.hypot(*off))]
        values, axes = np.linalg.eigh(np.array(best["covariance"])[:2, :2])
        score["z"] = (axes.T @ off / np.sqrt(np.maximum(values, 1e-12))).tolist()
    if abs(ending["margin"]) <= CLOSE and not ending["net"]:
        call = answer["call"]
        if max(call["in"], call["out"]) < 0.9:
            score["close_open"] = 1
        else:
            score["close_right" if (call["in"] > call["out"]) == ending["is_in"] else "close_wrong"] = 1
    return score


def _keep_bound(truth: CourtTruth) -> FloatArray | None:
    """Return the bound of a landing, which is stored beside the truth: it takes longer than the inference."""
    path = truth.folder / "bound.npy"
    if not path.exists():
        least = bound_landing(truth)
        np.save(path, np.empty((0, 2)) if least is None else least)
    stored = np.load(path)
    return stored if len(stored) else None


def draw_errors(covariance: FloatArray) -> list[float]:
    """Draw errors (m) of places with a covariance (2, 2)."""
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(2), covariance, 40, method="svd")
    return np.linalg.norm(draws, axis=1).tolist()


def upper_bound(false: int, count: int) -> float:
    """Return the upper end of the one-sided 95 % interval of a share (Clopper and Pearson 1934)."""
    return float(beta.ppf(0.95, false + 1, max(count - false, 1e-9))) if count else 1.0
