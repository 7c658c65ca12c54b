"""True events of a shot: from labels by eye, and from the engine behind rendered and simulated shots."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.support.run_folder import read_columns
from models.core.scene import CUSHIONS, POCKETS, Scene, Table
from models.core.typing import FloatArray

# Closing speeds below which a simulated contact is too soft to count, and to count as sure, m/s.
UNSURE_CLOSING, LIKELY_CLOSING = 0.02, 0.05
# Simulated events so close to the end of the clip are not sure.
LAST_FRAMES = 1.5
# Time in which a pocketed ball falls by a radius, s.
FALL_SECONDS = 0.08
# Ball radii: distance from its place of rest from which a ball comes to rest, and way per frame below which it rests:
# a ball stops within a frame or two then, whatever the frame rate.
REST_RADII = (0.1, 0.0005)


@dataclass(frozen=True, slots=True)
class TrueEvent:
    """An event between the frames `lo` and `hi` at `xy` (2,) m; `a`, `b` name balls, a cushion or a pocket."""

    kind: str
    a: str
    b: str
    lo: float
    hi: float
    certainty: str
    xy: FloatArray

    def __str__(self) -> str:
        return f"{self.kind} {self.a}{' - ' + self.b if self.b else ''} in frames {self.lo:.2f} to {self.hi:.2f}"


@dataclass(frozen=True, slots=True)
class TruePaths:
    """True positions `xy` (T, N, 2) m of the balls `names` in the frames `frame` (T,); NaN where there is none."""

    frame: FloatArray
    names: tuple[str, ...]
    xy: FloatArray


@dataclass(frozen=True, slots=True)
class ShotTruth:
    """All events of a shot in order of time."""

    events: tuple[TrueEvent, ...]
    complete: bool = True
    spans: tuple[tuple[float, float], ...] = ()
    """Frames between which events may be missing."""
    first: str | None = None
    """Ball that the cue ball touched first, `none`, or None where unknown."""
    paths: TruePaths | None = None
    """Exact paths, of an engine."""
    tracked: TruePaths | None = None
    """Paths of the balls of a labelled clip as tracked without damage."""
    doubts: tuple[str, ...] = ()
    """Places where the labels contradict themselves."""

    @property
    def cue(self) -> str | None:
        """Name of the ball that was struck first."""
        return next((event.a for event in self.events if event.kind == "strike"), None)

    def is_complete_at(self, frame: float) -> bool:
        """Return whether all events about a frame are known."""
        return not any(lo - 0.5 <= frame <= hi + 0.5 for lo, hi in self.spans)


def read_labels(path: Path, scene: Scene, width_px: int, label_width_px: int) -> ShotTruth:
    """Read events labelled by eye; cushions and pockets get their names from the places.

    Args:
        path: The file `*.events.json`.
        scene: Calibrated scene of the clip.
        width_px: Width of the clip that the scene belongs to.
        label_width_px: Width of the clip that was labelled.

    Returns:
        The truth.
    """
    content = json.loads(path.read_text())
    scale = width_px / label_width_px
    events, doubts = [], []
    for row in content["events"]:
        px = (np.array([row["x_px"], row["y_px"]], dtype=float) + 0.5) * scale - 0.5
        xy = scene.camera.to_table(px, scene.table.ball_radius, round(row["t_best"]))
        other = row["b"] or ""
        if row["kind"] == "cushion":
            other = name_cushion(scene, xy)
            if other != _cushion_of_image_side(scene, row["side"]):
                doubts.append(f"{path.stem}: {row['a']} at {row['t_best']}: place says {other}, side {row['side']}")
        elif row["kind"] == "pocket":
            other = POCKETS[int(np.argmin(np.linalg.norm(scene.table.pocket_centres - xy, axis=1)))]
        events.append(TrueEvent(row["kind"], row["a"], other, row["lo"], row["hi"], row["certainty"], xy))
    first = content["first_contact"]["object"] or "none"
    return ShotTruth(
        tuple(sorted(events, key=lambda event: event.lo + event.hi)), bool(content["complete"]),
        tuple((float(lo), float(hi)) for lo, hi in content["incomplete_spans"]), first, doubts=tuple(doubts),
    )  # fmt: skip


def name_cushion(scene: Scene, xy: FloatArray) -> str:
    """Return the cushion whose nose a ball at `xy` (2,) m is nearest to."""
    table = scene.table
    return CUSHIONS[int(np.argmin([xy[0], table.length - xy[0], xy[1], table.width - xy[1]]))]


def read_rendered_truth(clip: Path, table: Table) -> ShotTruth:
    """Read the truth of a rendered clip, scaled to the size that the program holds the table to be.

    Args:
        clip: The clip, with `NAME.truth.json` and `NAME.truth.csv` beside it.
        table: Table as calibrated; a wrong size is no wrong event.

    Returns:
        The truth.
    """
    facts, rows = json.loads(clip.with_suffix(".truth.json").read_text()), read_columns(clip.with_suffix(".truth.csv"))
    scale = table.length / facts["table"]["length"], table.width / facts["table"]["width"]
    names = tuple(dict.fromkeys(str(name) for name in rows["id"]))
    frames, first = np.unique(rows["frame"], return_index=True)
    xy = np.full((len(frames), len(names), 2), np.nan)
    for name, frame, x, y in zip(rows["id"], rows["frame"], rows["x"], rows["y"], strict=True):
        xy[np.searchsorted(frames, frame), names.index(str(name))] = scale[0] * x, scale[1] * y
    events = [row | {"x": scale[0] * row["x"], "y": scale[1] * row["y"]} for row in facts["events"]]
    return make_engine_truth(events, rows["t"][first], TruePaths(frames, names, xy), table.ball_radius)


def make_engine_truth(rows: Iterable[Mapping[str, Any]], t: FloatArray, paths: TruePaths, radius: float) -> ShotTruth:
    """Make the truth of a shot from the events and paths of an engine.

    Args:
        rows: Events with `kind`, `t` (s), `a`, `b`, `x`, `y` (m), `speed` (m/s); rests are taken from the paths.
        t: (T,) s, times of the frames of the paths.
        paths: True positions in every frame.
        radius: Radius of the balls, m.

    Returns:
        The truth; contacts that are too soft, or too late to be seen, are not sure.
    """
    events, last, fps = [], paths.frame[-1], 1 / float(np.median(np.diff(t)))
    for row in rows:
        frame = float(np.interp(row["t"], t, paths.frame))
        if row["kind"] == "rest" or row["t"] > t[-1]:
            continue
        soft = row["kind"] in ("ball", "cushion") and row["speed"] < LIKELY_CLOSING
        certainty = "unsure" if soft and row["speed"] < UNSURE_CLOSING else "likely" if soft else "sure"
        if frame > last - LAST_FRAMES and certainty == "sure":
            certainty = "likely"
        hi = frame + (FALL_SECONDS * fps if row["kind"] == "pocket" else 0.0)
        place = np.array([row["x"], row["y"]], dtype=float)
        events.append(TrueEvent(row["kind"], str(row["a"]), str(row["b"] or ""), frame, hi, certainty, place))
    events += _find_rests(paths, radius)
    events.sort(key=lambda event: event.lo)
    cue = next(event.a for event in events if event.kind == "strike")
    return ShotTruth(tuple(events), first=_find_first_contact(events, cue), paths=paths)


def _find_first_contact(events: list[TrueEvent], cue: str) -> str | None:
    """Return the first ball that the cue ball touches; None where a soft contact may have come before."""
    for event in events:
        if event.kind == "ball" and cue in (event.a, event.b):
            return (event.b if event.a == cue else event.a) if event.certainty == "sure" else None
    return "none"


def _find_rests(paths: TruePaths, radius: float) -> list[TrueEvent]:
    """Find where balls come to rest on the table for three frames, whether or not they are hit again."""
    rests = []
    for k, name in enumerate(paths.names):
        xy = paths.xy[:, k]
        still = np.linalg.norm(np.diff(xy, axis=0), axis=1) < REST_RADII[1] * radius  # False once it is pocketed
        for row in np.flatnonzero(~still[:-3] & still[1:-2] & still[2:-1] & still[3:]) + 1:
            away = np.flatnonzero(np.linalg.norm(xy[:row] - xy[row], axis=1) > REST_RADII[0] * radius)
            if len(away):
                rests.append(TrueEvent("rest", name, "", paths.frame[away[-1]], paths.frame[row], "sure", xy[row]))
    return rests


def _cushion_of_image_side(scene: Scene, side: str) -> str:
    """Return the cushion whose middle lies furthest towards a side of the image."""
    length, width = scene.table.length, scene.table.width
    middles = np.array([[0, width / 2], [length, width / 2], [length / 2, 0], [length / 2, width]])
    px = scene.camera.to_pixels(middles, scene.table.ball_radius)
    sign, axis = {"left": (-1, 0), "right": (1, 0), "top": (-1, 1), "bottom": (1, 1)}[side]
    return CUSHIONS[int(np.argmax(sign * px[:, axis]))]
