"""Parts of the chain of rallies that need no video: a court that every clip shows, and a rally with known truth."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from support.staged_rally import stage_rally

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.court_camera import CourtScene
from models.core.errors import ClipError
from models.core.rally import BallCandidates, Rally
from models.estimation.rally.rally_marks import resolve_marks, settle_marks
from models.sports.sport_catalogue import find_sports
from video.io.clip import Clip


def locate_court(clip: Clip, sport: str | None, corners: str | None, progress: object) -> CourtScene:
    """Find a badminton court unless the clip is small; a clip of 200 px or less shows none."""
    if clip.width <= 200:
        raise ClipError("no lines of a known court are in view")
    return stage_rally(
        find_sports()[sport or "badminton"], (2.5, 1.0) if sport == "table-tennis" else (13.0, 3.0)
    ).scene


def find_candidates(clip: Clip, scene: CourtScene, progress: object) -> BallCandidates:
    """Find nothing."""
    none = np.empty(0)
    return BallCandidates(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)), none, none, none)


def explain_rally(
    scene: CourtScene, candidates: BallCandidates, frame: np.ndarray, t: np.ndarray, progress: object,
    corrections: Corrections = NO_CORRECTIONS,
) -> Rally:  # fmt: skip
    """Return the staged rally, with corrections."""
    rally = stage_rally(scene.sport, (2.5, 1.0) if scene.sport.floor < 0 else (13.0, 3.0), frames=len(frame))
    marks = resolve_marks(corrections.events, frame, t)
    return settle_marks(replace(rally, frame=frame, t=t), corrections.balls, marks)


def write_file(path: Path, *_: Any) -> None:
    path.write_bytes(b"stand-in")


def use_stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace what looks at frames and what draws."""
    image = np.full((36, 64, 3), 90, np.uint8)
    for module, name, function in (
        ("video.calibration.court_finder", "locate_court", locate_court),
        ("detectors.flying.find_candidates", "find_candidates", find_candidates),
        ("models.estimation.rally.explain_rally", "explain_rally", explain_rally),
        ("video.overlay.rally_poster", "draw_rally_poster", lambda *_: image),
        ("video.overlay.landing_close_up", "draw_landing", lambda *_: image),
        ("video.overlay.rally_slow_motion", "render_rally", lambda clip, rally, path, *_: write_file(path)),
        ("pipeline.reporting.pages.rally_report", "write_rally_report", lambda *given: write_file(given[5])),
        ("pipeline.reporting.recording.rally_recording", "write_rally_recording", lambda *given: write_file(given[3])),
    ):
        try:
            import_module(module)
        except ModuleNotFoundError:  # another part of the work is not there yet
            monkeypatch.setitem(sys.modules, module, ModuleType(module))
        monkeypatch.setattr(sys.modules[module], name, function, raising=False)
