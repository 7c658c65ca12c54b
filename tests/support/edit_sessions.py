"""Sessions of corrections of a made-up run."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from support import synthetic_run as shot

import pipeline.editing.edit_session as edit_session
from models.core.fit_result import MarkOutcome
from pipeline.chain import hash_clip, honour_corrections
from pipeline.editing.edit_session import EditSession
from pipeline.editing.edited_clip import EditedClip
from pipeline.engine.result_cache import ResultCache
from pipeline.run_options import RunOptions
from video.io.clip import Clip

DEFAULT_OPTIONS = RunOptions()
HANG_S = 600.0
"""Time after which a run hangs, s."""
SHOWN_TABLES = "ab" * 32
"""Digest of the tables of the made-up run."""


@contextmanager
def replace_runs(
    folder: Path, runs: list[tuple[RunOptions, bool]] | None = None, outcomes: tuple[MarkOutcome, ...] = ()
) -> Iterator[tuple[Clip, tuple[Any, ...]]]:
    """Let the runs of sessions be made up; no correction changes them. Yield the clip and the values of a run.

    `runs` lists the options of every run, and whether it publishes its tables; `outcomes` are those of its marks.
    """
    clip = shot.write_clip(folder / "shot.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    fit = replace(shot.make_unsure_fit(tracks.t), mark_outcomes=outcomes)
    clip = replace(clip, path=folder / "shot.mp4")
    values = (scene, tracks, fit, SHOWN_TABLES)

    def run_tables(path: Path, _: Path, own: RunOptions, *rest: Any) -> tuple[object, ...]:
        if runs is not None:
            runs.append((honour_corrections(path, "", own), rest[-1]))
        return clip, *values

    with patch.object(edit_session, "run_tables", run_tables):
        yield clip, values


@contextmanager
def open_synthetic_session(
    folder: Path, options: RunOptions = DEFAULT_OPTIONS, runs: list[tuple[RunOptions, bool]] | None = None,
    history: Path | None = None,
) -> Iterator[EditSession]:  # fmt: skip
    """Open a session of a made-up run, and wait for its first result."""
    with replace_runs(folder, runs) as (clip, _):
        edited = EditedClip(clip.path, folder / "out", hash_clip(clip.path))
        session = EditSession(edited, options, ResultCache(folder / "cache"), history=history)
        try:
            wait_for_result(session)
            yield session
        finally:
            session.close()


def wait_for_result(session: EditSession, seconds: float = HANG_S) -> dict[str, Any]:
    """Wait until the run of the present corrections is shown, and return its description."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status = session.status
        assert not status.error, status.error
        if status.result == status.revision and not status.stage:
            return session.describe()
        time.sleep(0.01)
    raise AssertionError(f"no result after {seconds} s")
