"""The fit on tracks of three-cushion shots: real ones with marked events, and a rendered one with exact truth."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.sample_clips import read_sample_truth

from models.core.fit_result import Fit
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

RADIUS, LENGTH, WIDTH = 0.03075, 2.84, 1.42
PX_PER_M = (740 - 134) / (LENGTH - 2 * RADIUS)
SAMPLE_PX_PER_M, SAMPLE_NOISE_PX = 380.0, 0.4
"""The rendered clip: its scale, and the noise (px) that is added to its true centres."""
SAMPLE_TIME_S = 0.02
CUSHIONS = {"L": "left", "R": "right", "T": "top", "B": "bottom"}


def carom(folder: Path, name: str) -> tuple[Tracks, Scene, list[dict[str, object]]]:
    """Tracks of a clip from its marked centres; 15 fps are a guess."""
    marks = json.loads((folder / f"carom_{name}.gt.json").read_text())
    ids = tuple(marks["tracks"])
    px = np.full((max(len(rows) for rows in marks["tracks"].values()), 3, 2), np.nan)
    for ball, rows in enumerate(marks["tracks"].values()):
        for frame, row in enumerate(rows):
            px[frame, ball] = np.nan if row is None else row[1:3]
    xy = (px - [134, 103]) / PX_PER_M + RADIUS
    sigma = np.full(px.shape[:2], 0.4 / PX_PER_M)
    frames = np.arange(len(px))
    tracks = Tracks(
        frames, frames / 15, ids, ids, xy, px, sigma, sigma, np.zeros_like(xy),
        np.full(px.shape[:2], 6.5), np.zeros((3, 3)),
    )  # fmt: skip
    return tracks, make_carom_scene(), marks.get("events", [])


@cache
def fit_carom(folder: Path, name: str) -> tuple[Fit, list[dict[str, object]]]:
    """Fit a clip, and return its marked events too."""
    tracks, scene, marks = carom(folder, name)
    return view_shot(explain(tracks, scene)), marks


def make_carom_scene() -> Scene:
    """Build a match table under a camera straight above it."""
    table = Table("carom-match", "carom", LENGTH, WIDTH, RADIUS, 0.21, False)
    matrix = np.array([[PX_PER_M, 0, 0, 120.0], [0, PX_PER_M, 0, 96.0], [0, 0, 0, 1.0]])
    camera = Camera(matrix, 854, 480, table.corners * PX_PER_M, np.eye(8), "cloth", 3.0, 1.0)
    return Scene(table, camera, np.array([40.0, 0.0, -30.0]), ())


def is_matched(fit: Fit, mark: dict[str, object]) -> bool:
    """Whether a mark is among the events, within one and a half frames."""
    who, events = str(mark["who"]), fit.events
    for k in range(len(events)):
        near = abs(events.frame[k] - (float(str(mark["frame_1based"])) - 1)) <= 1.5
        pair = {events.a[k], events.b[k]}
        if mark["type"] == "ball_ball":
            same = events.kind[k] == "ball" and pair == set(who.split("-"))
        elif mark["type"] == "cushion":
            ball, side = who.split()
            same = events.kind[k] == "cushion" and pair == {ball, CUSHIONS[side]}
        else:
            same = events.kind[k] == "strike" and events.a[k] == who
        if near and same:
            return True
    return False


@pytest.mark.parametrize("name", ["F1", "F3"])
def test_marked_events_of_carom_shots_are_found(footage: Path, name: str) -> None:
    fit, marks = fit_carom(footage, name)
    assert np.mean([is_matched(fit, mark) for mark in marks]) >= 0.85
    contacts = sum(kind in ("ball", "cushion") for kind in fit.events.kind)
    marked = sum(mark["type"] != "cue_strike" for mark in marks)
    assert contacts <= marked / 0.85


@pytest.mark.parametrize("name", ["F1", "F2", "F3"])
def test_paths_of_carom_shots_stay_within_a_pixel(footage: Path, name: str) -> None:
    fit, _ = fit_carom(footage, name)
    miss = fit.residual[np.isfinite(fit.residual[..., 0]) & fit.accepted] * PX_PER_M
    assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.9
    assert (fit.moving & fit.accepted).sum() > 0.8 * fit.moving.sum()


def sample_carom() -> tuple[Tracks, Scene, list[dict[str, Any]]]:
    """Tracks of the rendered carom clip from its true centres with 0.4 px of noise."""
    truth = read_sample_truth("carom_match")
    scale = 1.0 / SAMPLE_PX_PER_M
    xy = truth.xy + np.random.default_rng(0).normal(0.0, SAMPLE_NOISE_PX * scale, truth.xy.shape)
    sigma = np.full(xy.shape[:2], SAMPLE_NOISE_PX * scale)
    tracks = Tracks(
        np.arange(len(truth.t)), truth.t, truth.ids, truth.ids, xy, truth.px, sigma, sigma, np.zeros_like(xy),
        truth.radius_px, np.zeros((len(truth.ids), 3)),
    )  # fmt: skip
    return tracks, make_carom_scene(), truth.events


def test_events_of_a_rendered_carom_shot_are_found() -> None:
    tracks, scene, events = sample_carom()
    fit = view_shot(explain(tracks, scene))
    kinds = ("strike", "ball", "cushion")
    contacts = [event for event in events if event["kind"] in kinds]
    rows = [k for k, kind in enumerate(fit.events.kind) if kind in kinds]
    matched = [
        any(
            fit.events.kind[k] == event["kind"]
            and {fit.events.a[k], fit.events.b[k]} == {event["a"], event["b"]}
            and abs(fit.events.t[k] - event["t"]) < SAMPLE_TIME_S
            for k in rows
        )
        for event in contacts
    ]
    assert np.mean(matched) >= 0.85
    assert len(rows) <= len(contacts) / 0.85


def test_paths_of_a_rendered_carom_shot_stay_within_a_pixel() -> None:
    tracks, scene, _ = sample_carom()
    fit = view_shot(explain(tracks, scene))
    miss = fit.residual[np.isfinite(fit.residual[..., 0]) & fit.accepted] * SAMPLE_PX_PER_M
    assert np.sqrt((miss**2).sum(axis=1).mean()) < 0.9
    assert (fit.moving & fit.accepted).sum() > 0.8 * fit.moving.sum()
