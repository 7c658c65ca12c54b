"""The program `trueroll app` as a process: what it holds after being killed in the middle of everything."""

from __future__ import annotations

import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil
import pytest
from support.app_requests import MP4_HEADER
from support.carom_start import Home

ROOT = Path(__file__).resolve().parents[3]
LONGEST_S = 300.0


class RunningApp:
    """A server as a process of its own."""

    def __init__(self, library: Path, cache: Path) -> None:
        start = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from pipeline.cli.main import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", start, "app", "--library", str(library), "--cache", str(cache), "--no-browser"],
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stderr is not None
        address = re.search(r"http\S+", self.process.stderr.readline())
        assert address
        self.place = urlsplit(address[0])
        self.children = [one.pid for one in psutil.Process(self.process.pid).children(recursive=True)]

    def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
        connection = http.client.HTTPConnection(str(self.place.hostname), self.place.port, timeout=LONGEST_S)
        connection.request(method, self.place.path + path, body)
        answer = connection.getresponse()
        content = json.loads(answer.read())
        connection.close()
        return answer.status, content

    def wait_for_job(self, *states: str) -> dict[str, Any]:
        """Wait until the first job is in one of some states, and at work."""
        end = time.monotonic() + LONGEST_S
        while time.monotonic() < end:
            (job,) = self.ask("GET", "api/library")[1]["jobs"]
            if job["state"] in states and (job["state"] != "running" or job["stage"]):
                return dict(job)
            time.sleep(0.1)
        raise AssertionError(f"the job stays {job}")

    def kill(self) -> None:
        """Kill the server and wait until its processes have noticed."""
        children = psutil.Process(self.process.pid).children(recursive=True)
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        _, alive = psutil.wait_procs(children, LONGEST_S)
        assert not alive

    def close(self) -> None:
        with suppress(ProcessLookupError):
            self.process.terminate()
        self.process.wait(LONGEST_S)
        if self.process.stderr is not None:
            self.process.stderr.close()


@contextmanager
def run_app(library: Path, cache: Path) -> Iterator[RunningApp]:
    app = RunningApp(library, cache)
    try:
        yield app
    finally:
        app.close()


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
        huge = http.client.HTTPConnection(str(app.place.hostname), app.place.port)
        huge.putrequest("POST", f"{app.place.path}api/clips?name=huge.mp4")
        huge.putheader("Content-Length", "10000000000")
        huge.endheaders(MP4_HEADER)
        assert huge.getresponse().status == 413
        huge.close()
        begins = time.monotonic()
        os.kill(app.process.pid, signal.SIGTERM)
        app.process.wait(LONGEST_S)
        assert time.monotonic() - begins < LONGEST_S / 2
    left = [str(path.relative_to(library)) for path in library.rglob("*") if path.name.endswith(".part")]
    assert left == []
    assert sorted(path.name for path in library.iterdir()) == [".trueroll-app", "clips", "start"]
    assert [path.name for path in (library / "clips").iterdir()] == ["start.mp4"]
