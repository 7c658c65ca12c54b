"""Servers of the page that run in a thread of the test."""

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

from support import synthetic_run as synthetic

import pipeline.app.open_shots as open_shots
import pipeline.editing.edit_session as edit_session
from models.core.fit_result import MarkOutcome
from pipeline.app.app_server import AppServer
from pipeline.app.shot_library import ShotLibrary
from pipeline.editing.run_view import ClipRun
from pipeline.engine.result_cache import ResultCache
from pipeline.io.strict_json import write_json

HANG_S = 600.0
"""Time after which a server hangs, s."""
SHOWN_TABLES = "ab" * 32
"""Digest of the tables of the made-up run."""


@contextmanager
def serve_app(library: Path, port: int = 0) -> Iterator[AppServer]:
    """Serve the page of a library."""
    server = AppServer(ShotLibrary(library), port)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()


def ask_app(server: AppServer, method: str, path: str, body: object = None, **headers: str) -> Any:
    """Send a request to the page's own address and return the JSON values of the answer."""
    place = urlsplit(server.url)
    connection = http.client.HTTPConnection(str(place.hostname), place.port, timeout=HANG_S)
    content = None if body is None else json.dumps(body)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, place.path + path, content, {"Content-Type": "application/json", **named})
    answer = connection.getresponse()
    read = answer.read()
    connection.close()
    assert answer.status < 400, f"{method} {path}: {answer.status} {read[:300]!r}"
    return json.loads(read)


@contextmanager
def serve_synthetic_shot(
    folder: Path, outcomes: tuple[MarkOutcome, ...] = ()
) -> Iterator[tuple[AppServer, str]]:
    """Serve the page of a library with one made-up shot, which no correction changes; yield server and id of the shot.

    `outcomes` are those of its marks.
    """
    clip = synthetic.write_clip(folder / "shot.mp4")
    scene = synthetic.make_scene()
    tracks = synthetic.make_tracks(clip, scene)
    fit = replace(synthetic.make_unsure_fit(tracks.t), mark_outcomes=outcomes)
    out = folder / "out"
    out.mkdir()
    synthetic.save_shot(synthetic.make_unexplained_shot(tracks, scene), out)
    write_json({"fps": synthetic.RATE}, out / "scene.json")
    write_json({"path": str(folder / "shot.mp4")}, out / "source.json")
    run = ClipRun(synthetic.RATE, scene, tracks, fit, SHOWN_TABLES)

    def run_tables(*_: object) -> tuple[object, ...]:
        return replace(clip, path=folder / "shot.mp4"), scene, tracks, fit, SHOWN_TABLES

    with (
        patch.object(edit_session, "run_tables", run_tables),
        patch.object(open_shots.OpenShot, "run", property(lambda _: run)),
        patch.object(open_shots, "open_cache", lambda _: ResultCache(folder / "cache")),
        serve_app(folder) as server,
    ):
        yield server, server.library.identify(out)


def wait_for_corrections(server: AppServer, shot: str, seconds: float = HANG_S) -> dict[str, Any]:
    """Wait until the run of the present corrections is shown, and return the document of the shot."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        status = ask_app(server, "GET", f"api/shots/{shot}/status")
        assert not status["error"], status["error"]
        if status["result"] == status["revision"] and not status["stage"]:
            return dict(ask_app(server, "GET", f"api/shots/{shot}"))
        time.sleep(0.05)
    raise AssertionError(f"no result after {seconds} s")
