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

from support.app_requests import build_local_answers
from support.edit_sessions import HANG_S, replace_runs
from support.synthetic_run import RATE, make_unexplained_shot, save_shot

import pipeline.app.open_shots as open_shots
from models.core.fit_result import MarkOutcome
from pipeline.app.app_server import AppServer
from pipeline.app.shot_library import ShotLibrary
from pipeline.editing.run_view import ClipRun
from pipeline.io.strict_json import write_json


@contextmanager
def serve_app(library: Path, port: int = 0) -> Iterator[AppServer]:
    """Serve the page of a library; answers about shots are computed here too, so that a test can replace functions."""
    server = AppServer(ShotLibrary(library), port, build_answers=build_local_answers)
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
def serve_synthetic_shot(folder: Path, outcomes: tuple[MarkOutcome, ...] = ()) -> Iterator[tuple[AppServer, str]]:
    """Serve the page of a library with one made-up shot, which no correction changes; yield server and id of the shot.

    `outcomes` are those of its marks.
    """
    with replace_runs(folder, outcomes=outcomes) as (clip, values):
        out = folder / "out"
        out.mkdir()
        scene, tracks, *_ = values
        matrix = scene.camera.matrix.copy()
        matrix[2, 2] = -1e-9  # the camera is far above, not infinitely far
        seen = replace(scene, camera=replace(scene.camera, matrix=matrix))
        save_shot(make_unexplained_shot(tracks, seen), out)
        write_json({"scene": "billiards", "fps": RATE}, out / "scene.json")
        write_json({"path": str(clip.path)}, out / "source.json")
        run = ClipRun(RATE, *values)
        with patch.object(open_shots.OpenShot, "run", property(lambda _: run)), serve_app(folder) as server:
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
