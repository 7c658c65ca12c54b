"""Score run folders against the marks of the real footage: snooker, carom, pool, and events labelled by eye."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.support.run_folder import RunFolder

CLASSES_OF_COLOUR = {"WHITE": ("cue",), "RED": ("red",)}
CUSHION_OF_LETTER = {"L": "left", "R": "right", "T": "top", "B": "bottom"}
# Frame offsets, from the notes of the footage, that replace the estimate in the truth file.
SNOOKER_OFFSET = {"snooker_simulation_vs_reality_1_0008_0011": 0}
# Marks whose position is wrong according to the notes of the footage.
MARKS_WITH_WRONG_POSITION = {("snooker_gleitreibungskoeffizient_0000_0005", "rest")}
MARKS_WITH_WRONG_FRAME: set[tuple[str, str]] = {("snooker_gleitreibungskoeffizient_0000_0005", "rest")}


@dataclass(frozen=True)
class MarkScore:
    """One row of a table: name, cells, and raw samples for the pooled line."""

    name: str
    cells: tuple[str, ...]
    samples: dict[str, list[float]]


# snooker: marks by hand


def snooker_marks(truth: dict[str, Any], stem: str) -> list[tuple[str, str, float, np.ndarray]]:
    """Return (kind of event, ball, frame, pixel (2,)) of every event once."""
    offset = SNOOKER_OFFSET.get(stem, truth["frame_offset_estimate"])
    marks: dict[tuple[str, str], tuple[str, str, float, np.ndarray]] = {}
    for event in truth["events"]:
        kind = _snooker_kind(event["event"])
        marks.setdefault(
            (kind, event["ball"]), (kind, event["ball"], event["frame"] + offset, np.array(event["pixel"]))
        )
    return list(marks.values())


def _snooker_kind(name: str) -> str:
    if "rail" in name:
        return "cushion"
    return {"start": "strike", "in rest": "rest", "pocket": "pocket", "in pocket": "pocket"}.get(name, "ball")


def score_snooker(stem: str, run: RunFolder, truth: dict[str, Any]) -> MarkScore:
    places, times, missed = [], [], []
    for kind, colour, frame, pixel in snooker_marks(truth, stem):
        ids = run.ids_of_kind(*CLASSES_OF_COLOUR[colour])
        if kind != "pocket" and (stem, kind) not in MARKS_WITH_WRONG_POSITION:
            places.append(_nearest_on_path(run, ids, frame, pixel))
        if kind != "pocket" and (stem, kind) not in MARKS_WITH_WRONG_FRAME:
            times.append(_nearest_event(run, kind, ids, frame))
            if not times[-1] <= 3:
                missed.append(f"{colour.lower()} {kind} at {frame:g} ({times[-1]:.1f})")
    cells = (
        f"{np.median(places):.1f}",
        f"{np.mean(np.array(places) <= 5):.0%}",
        f"{np.mean(np.array(times) <= 3):.0%}",
        "; ".join(missed),
    )
    return MarkScore(stem, cells, {"place": places, "frame": times})


def _frame_times(run: RunFolder) -> tuple[np.ndarray, np.ndarray]:
    frames, first = np.unique(run.tracks["frame"], return_index=True)
    return frames, run.tracks["t"][first]


def _nearest_on_path(run: RunFolder, ids: list[str], frame: float, pixel: np.ndarray) -> float:
    """Return the least distance (px) of the fitted paths of these balls from a mark, within 2 frames of it."""
    frames, t = _frame_times(run)
    low, high = np.interp([frame - 2, frame + 2], frames, t)
    best = np.inf
    for ball in ids:
        times, px = run.path_of(ball)
        near = (times >= low - 1e-9) & (times <= high + 1e-9)
        if near.any():
            best = min(best, float(np.linalg.norm(px[near] - pixel, axis=1).min()))
    return best


def _nearest_event(run: RunFolder, kind: str, ids: list[str], frame: float) -> float:
    """Return the distance in frames to the nearest event of this kind with one of these balls."""
    e = run.events
    hit = (e["kind"] == kind) & (np.isin(e["a"], ids) | np.isin(e["b"], ids))
    return float(np.abs(e["frame"][hit] - frame).min()) if hit.any() else np.inf


# carom: every frame of three balls


def score_carom(stem: str, run: RunFolder, truth: dict[str, Any]) -> MarkScore:
    rows = {
        kind: np.array([r for r in truth["tracks"][kind] if r is not None and None not in r], dtype=float)
        for kind in ("white", "yellow", "red")
    }
    offsets, switches, missing, total = [], 0, 0, 0
    for kind, marks in rows.items():
        ids = run.ids_of_kind(kind)
        if not ids:
            missing += len(marks)
            total += len(marks)
            continue
        mine = _rows_by_frame(run, ids[0])
        for frame, x, y in marks:
            total += 1
            if int(frame) not in mine:
                missing += 1
                continue
            offset = mine[int(frame)] - (x, y)
            switches += bool(np.linalg.norm(offset) > 10)
            offsets.append(offset)
    errors = np.array(offsets)
    distances = np.linalg.norm(errors - errors.mean(axis=0), axis=1) if len(errors) else np.array([np.inf])
    rms = float(np.sqrt(np.mean(distances**2)))
    matched, marked, extra = _score_carom_events(run, truth.get("events") or [])
    events = (f"{matched}/{marked}", f"{extra[0]}/{extra[1]}") if marked else ("-", "-")
    cells = (f"{rms:.2f}", f"{missing}/{total}", str(switches), *events)
    return MarkScore(stem, cells, {"distance": distances.tolist(), "switches": [switches], "rows": [total]})


def _rows_by_frame(run: RunFolder, ball: str) -> dict[int, np.ndarray]:
    rows = np.flatnonzero((run.tracks["id"] == ball) & np.isfinite(run.tracks["x_px"]))
    return {int(run.tracks["frame"][r]): np.array([run.tracks["x_px"][r], run.tracks["y_px"][r]]) for r in rows}


def _score_carom_events(run: RunFolder, marks: list[dict[str, Any]]) -> tuple[int, int, tuple[int, int]]:
    """Return marked events matched within 1.5 frames, all marked ones, and (reported contacts matched, reported)."""
    e = run.events
    kinds = {k: (run.ids_of_kind(k) or [""])[0] for k in ("white", "yellow", "red")}
    taken: set[int] = set()
    for mark in marks:
        names = mark["who"].replace("-", " ").split()
        ball, other = kinds[names[0]], names[1] if len(names) > 1 else ""
        other = CUSHION_OF_LETTER.get(other, kinds.get(other, other))
        kind = {"cue_strike": "strike", "ball_ball": "ball", "cushion": "cushion"}[mark["type"]]
        for k in range(len(e["kind"])):
            pair = {str(e["a"][k]), str(e["b"][k])} - {""}
            near = abs(e["frame"][k] - (mark["frame_1based"] - 1)) <= 1.5
            if near and e["kind"][k] == kind and pair == {ball, other} - {""} and k not in taken:
                taken.add(k)
                break
    contacts = [k for k in range(len(e["kind"])) if e["kind"][k] in ("ball", "cushion")]
    return len(taken), len(marks), (sum(k in taken for k in contacts), len(contacts))


# pool: boxes of the first and the last frame


# Ball class of each class number of the boxes.
CLASS_OF_BOX = {1: "cue", 2: "eight", 3: "solid", 4: "stripe"}


def score_pool(stem: str, run: RunFolder, truth: dict[str, Any]) -> MarkScore:
    matched, boxed, claimed, true, named = 0, 0, 0, 0, 0
    missed = []
    for name, frame in (("first", run.tracks["frame"].min()), ("last", run.tracks["frame"].max())):
        rows = np.flatnonzero((run.tracks["frame"] == frame) & np.isfinite(run.tracks["x_px"]))
        centres = np.stack([run.tracks["x_px"][rows], run.tracks["y_px"][rows]], axis=-1)
        used: set[int] = set()
        for x, y, w, h, kind in truth["boxes"][name]:
            boxed += 1
            distance = np.linalg.norm(centres - (x + (w - 1) / 2, y + (h - 1) / 2), axis=1)
            order = [int(k) for k in np.argsort(distance) if int(k) not in used]
            if order and distance[order[0]] <= (w + h) / 8:
                used.add(order[0])
                matched += 1
                named += run.tracks["kind"][rows[order[0]]] == CLASS_OF_BOX[kind]
            else:
                missed.append(f"{name} ({x},{y}) by {distance[order[0]]:.1f} px" if order else f"{name} ({x},{y})")
        claimed += len(rows)
        true += len(used)
    cells = (
        f"{matched}/{boxed} = {matched / boxed:.0%}",
        f"{true}/{claimed} = {true / max(claimed, 1):.0%}",
        f"{named}/{matched} = {named / max(matched, 1):.0%}",
        "; ".join(missed),
    )
    return MarkScore(stem, cells, {"found": [matched], "boxed": [boxed], "true": [true], "claimed": [claimed]})


# events labelled by eye


# Frames around a labelled interval, and px from its place, within which an event is the labelled one: the balls of two
# contacts of a kind at one moment are farther apart, and the place of a contact may be that of either ball.
LABEL_FRAMES, LABEL_PX = 2.0, 120.0
# Probabilities from which an event counts as reported, and from which one that did not happen counts as false.
LISTED_PROBABILITY, SURE_PROBABILITY = 0.5, 0.9


def score_labelled_events(stem: str, run: RunFolder, truth: dict[str, Any]) -> MarkScore:
    """Match reported events with labels of the same kind, time and place; labels that are unsure neither count nor
    make an event false, and nor do spans in which not all events are labelled."""
    e = run.events
    px = run.to_pixels(np.stack([e["x"], e["y"]], axis=-1).astype(float))
    labels = sorted(truth["events"], key=lambda one: one["certainty"] == "unsure")
    taken: set[int] = set()
    missed, counted = [], 0
    for label in labels:
        apart = np.maximum(np.maximum(label["lo"] - e["frame"], e["frame"] - label["hi"]), 0.0)
        near = np.linalg.norm(px - (label["x_px"], label["y_px"]), axis=1) <= LABEL_PX
        fits = (e["kind"] == label["kind"]) & (e["probability"] >= LISTED_PROBABILITY) & (apart <= LABEL_FRAMES) & near
        rows = [int(k) for k in np.argsort(apart, kind="stable") if fits[k] and k not in taken]
        taken |= set(rows[:1])
        if label["certainty"] != "unsure":
            counted += 1
            if not rows:
                missed.append(f"{label['kind']} {label['a']} {label['b'] or ''} at {label['lo']} to {label['hi']}")
    false = [
        f"{e['kind'][k]} {e['a'][k]} {e['b'][k]} at {e['frame'][k]:.1f} ({e['probability'][k]:.0%})"
        for k in np.flatnonzero(e["probability"] >= SURE_PROBABILITY).tolist()
        if k not in taken and not any(low <= e["frame"][k] <= high for low, high in truth["incomplete_spans"])
    ]
    hits = counted - len(missed)
    cells = (f"{hits}/{counted}", "; ".join(missed), f"{len(false)}", "; ".join(false))
    return MarkScore(stem, cells, {"hits": [hits], "labels": [counted], "false": [len(false)]})
