"""The program `trueroll app` as a process of its own."""

from __future__ import annotations

import http.client
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil

ROOT = Path(__file__).resolve().parents[2]
LONGEST_S = 300.0
"""s after which a process hangs."""


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

    def find_child(self, module: str) -> psutil.Process | None:
        """Find the process of the server that runs a module of the program."""
        children = psutil.Process(self.process.pid).children()
        return next((one for one in children if module in " ".join(one.cmdline())), None)

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
