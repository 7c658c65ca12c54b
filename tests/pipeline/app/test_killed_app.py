"""The program `trueroll app` as a process: what it holds after being killed in the middle of everything."""

from __future__ import annotations

import os
import signal
import socket
import time
from pathlib import Path

import pytest
from support.app_processes import LONGEST_S, RunningApp, run_app
from support.app_requests import MP4_HEADER
from support.carom_start import Home


def begin_upload(app: RunningApp) -> socket.socket:
    """Send a half of an upload."""
    half = socket.create_connection((str(app.place.hostname), app.place.port or 80))
    request = f"POST {app.place.path}api/clips?name=half.mp4 HTTP/1.1\r\nHost: {app.place.netloc}"
    head = f"{request}\r\nContent-Length: 2000\r\n\r\n"
    half.sendall(head.encode() + MP4_HEADER)
    return half


@pytest.mark.slow
def test_a_killed_server_loses_nothing_and_leaves_nothing_half_done(own_home: Home, tmp_path: Path) -> None:
    library = tmp_path / "library"
    uploads = library / ".trueroll-app" / "uploads"
    with run_app(library, own_home.cache) as app:
        half = begin_upload(app)
        status, answer = app.ask("POST", "api/clips?name=start.mp4", own_home.clip.read_bytes())
        assert status == 201
        assert app.wait_for_job("running")["id"] == answer["job"]["id"]
        assert len(list(uploads.iterdir())) == 1
        app.kill()
        half.close()
    assert (library / "clips" / "start.mp4").read_bytes() == own_home.clip.read_bytes()
    with run_app(library, own_home.cache) as app:
        done = app.wait_for_job("done", "failed")
        assert (done["error"], done["state"]) == ("", "done")
        assert done["found"]
        (card,) = app.ask("GET", "api/library")[1]["shots"]
        assert (card["id"], card["name"], card["state"], card["trust"] != "") == (done["shot"], "start", "done", True)
        begins = time.monotonic()
        os.kill(app.process.pid, signal.SIGTERM)
        app.process.wait(LONGEST_S)
        assert time.monotonic() - begins < LONGEST_S / 2
    left = [str(path.relative_to(library)) for path in library.rglob("*") if path.name.endswith(".part")]
    assert left == []
    assert sorted(path.name for path in library.iterdir()) == [".trueroll-app", "clips", "start"]
    assert [path.name for path in (library / "clips").iterdir()] == ["start.mp4"]
