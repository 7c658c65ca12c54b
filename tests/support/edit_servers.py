"""Editors that run in a thread of the test, and a browser that corrects with them."""

from __future__ import annotations

import http.client
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

from support import synthetic_run as shot

import pipeline.editing.edit_session as edit_session
from models.core.fit_result import MarkOutcome
from pipeline.chain import hash_clip, honour_corrections
from pipeline.editing.edit_server import EditServer
from pipeline.editing.edit_session import EditSession
from pipeline.editing.edited_clip import EditedClip
from pipeline.engine.result_cache import ResultCache
from pipeline.run_options import RunOptions

DEFAULT_OPTIONS = RunOptions()
HANG_S = 600.0
"""Time after which a server hangs, s."""
SHOWN_TABLES = "ab" * 32
"""Digest of the tables of the made-up run."""


@contextmanager
def serve(clip: Path, folder: Path, options: RunOptions, cache: Path) -> Iterator[EditServer]:
    """Serve the editor of a clip."""
    session = EditSession(EditedClip(clip, folder, hash_clip(clip)), options, ResultCache(cache))
    server = EditServer(session)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        session.close()


@contextmanager
def serve_synthetic_run(
    folder: Path,
    options: RunOptions = DEFAULT_OPTIONS,
    runs: list[tuple[RunOptions, bool]] | None = None,
    outcomes: tuple[MarkOutcome, ...] = (),
) -> Iterator[EditServer]:
    """Serve the editor of a made-up run, which no correction changes.

    `runs` lists the options of every run, and whether it publishes its tables; `outcomes` are those of its marks.
    """
    clip = shot.write_clip(folder / "shot.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    fit = replace(shot.make_unsure_fit(tracks.t), mark_outcomes=outcomes)
    run = (replace(clip, path=folder / "shot.mp4"), scene, tracks, fit)

    def run_tables(clip: Path, _: Path, own: RunOptions, *rest: Any) -> tuple[object, ...]:
        if runs is not None:
            runs.append((honour_corrections(clip, "", own), rest[-1]))
        return *run, SHOWN_TABLES

    with (
        patch.object(edit_session, "run_tables", run_tables),
        serve(folder / "shot.mp4", folder / "out", options, folder / "cache") as server,
    ):
        ask(server, "GET", "status")
        wait_for_result(server)
        yield server


def ask(
    server: EditServer, method: str, path: str, body: object = None, **headers: str
) -> tuple[int, Any, dict[str, str]]:
    """Send a request; return status, content and headers. A path that begins with a slash is absolute."""
    place = urlsplit(server.url)
    connection = http.client.HTTPConnection(str(place.hostname), place.port, timeout=HANG_S)
    content = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path if path.startswith("/") else place.path + path, content, named)
    answer = connection.getresponse()
    read = answer.read()
    connection.close()
    is_json = "json" in answer.headers.get("content-type", "")
    return answer.status, json.loads(read) if is_json else read, dict(answer.headers.items())


def wait_for_result(server: EditServer, seconds: float = HANG_S) -> dict[str, Any]:
    """Wait until the run of the present corrections is shown, and return its state."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        _, status, _ = ask(server, "GET", "status")
        if status["error"]:
            raise AssertionError(status["error"])
        if status["result"] == status["revision"] and not status["stage"]:
            return dict(ask(server, "GET", "state")[1])
        time.sleep(0.05)
    raise AssertionError(f"no result after {seconds} s")
