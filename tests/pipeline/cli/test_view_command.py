"""The viewer is started on the recording, and asks no other machine."""

from __future__ import annotations

import os
import re
import socket
import sys
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from support.pseudo_terminal import Terminal, make_terminal

from models.core.errors import OptionError, TruerollError
from pipeline.reporting.recording import rerun_viewer
from pipeline.reporting.recording.rerun_viewer import (
    find_free_port,
    find_recordings,
    serve_sealed_page,
    show_recordings,
)

trueroll = pytest.fixture(make_terminal)

FAKE = """#!/bin/sh
printf '%s\\n' "$HTTPS_PROXY" "$@" > "$(dirname "$0")/arguments"
exit 3
"""


@pytest.fixture(autouse=True)
def usual_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pretend that all ports are free."""
    monkeypatch.setattr("pipeline.reporting.recording.rerun_viewer.find_free_port", lambda wanted: wanted)


@pytest.fixture
def arguments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """File in which a stand-in for the viewer writes its environment and arguments."""
    (tmp_path / "rerun").write_text(FAKE)
    (tmp_path / "rerun").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("HTTPS_PROXY", "http://proxy.example")
    monkeypatch.setenv("DISPLAY", ":0")
    return tmp_path / "arguments"


def test_the_viewer_shows_the_recording_without_the_network_and_its_status_is_ours(arguments: Path) -> None:
    assert show_recordings([Path("shot.rrd")], web=False) == 3
    assert arguments.read_text().split() == ["http://127.0.0.1:9", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876"]
    assert os.environ["HTTPS_PROXY"] == "http://proxy.example"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Pages that the browser was asked to open."""
    pages: list[str] = []
    monkeypatch.setattr("webbrowser.open", pages.append)
    monkeypatch.setattr(rerun_viewer, "serve_sealed_page", lambda *arguments: None)
    return pages


def test_in_the_browser_only_this_machine_is_served(arguments: Path, opened: list[str]) -> None:
    show_recordings([Path("shot.rrd")], web=True)
    assert arguments.read_text().split() == [
        "http://127.0.0.1:9", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876", "--serve-web", "--web-viewer-port",
        "0",
    ]  # fmt: skip
    assert [page.partition("?")[0] for page in opened] == ["http://127.0.0.1:9090/"]


class ForeignPage(BaseHTTPRequestHandler):
    """A page that asks another host for its letters."""

    def do_GET(self) -> None:
        self.send_response(200 if self.path.startswith("/?") else 404)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(
            b'<link rel="icon" href="own.ico">\n<link\n href="https://letters.example/inter"\n><p>page</p>'
        )

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def test_the_page_of_the_viewer_may_ask_this_machine_alone() -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), ForeignPage) as foreign:
        Thread(target=foreign.serve_forever, daemon=True).start()
        source = f"http://127.0.0.1:{foreign.server_port}"
        with serve_sealed_page("127.0.0.1", 0, source, "http://127.0.0.1:9876") as sealed:
            with urlopen(f"http://127.0.0.1:{sealed.server_port}/?theme=dark") as answer:
                policy, page = answer.headers["Content-Security-Policy"], answer.read()
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"http://127.0.0.1:{sealed.server_port}/missing")
            sealed.shutdown()
        foreign.shutdown()
    assert page == b'<link rel="icon" href="own.ico">\n<p>page</p>'
    assert policy.startswith("default-src 'self'")
    assert re.findall(r"https?://[^ ;]+", policy) == ["http://127.0.0.1:9876"]


def test_a_folder_of_a_run_is_viewed_by_its_recording(
    arguments: Path, opened: list[str], trueroll: Terminal, tmp_path: Path
) -> None:
    (tmp_path / "recording.rrd").touch()
    assert trueroll("view", tmp_path, "--web").status == 3
    assert arguments.read_text().split()[1] == str(tmp_path / "recording.rrd")


def test_no_display_is_one_sentence_that_names_the_browser(arguments: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(TruerollError, match="use --web"):
        show_recordings([Path("shot.rrd")], web=False)
    assert not arguments.exists()


def test_a_missing_viewer_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(OptionError, match="pip install rerun-sdk"):
        show_recordings([Path("shot.rrd")], web=False)


def test_a_folder_of_runs_is_viewed_by_all_of_them(tmp_path: Path) -> None:
    for name in ("a/recording.rrd", "b/c/recording.rrd"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = [str(path.relative_to(tmp_path)) for path in find_recordings(tmp_path)]
    assert found == ["a/recording.rrd", "b/c/recording.rrd"]
    assert find_recordings(tmp_path / "b" / "c") == [tmp_path / "b" / "c" / "recording.rrd"]
    with pytest.raises(OptionError, match="trueroll run CLIP"):
        find_recordings(tmp_path / "nowhere")


def test_a_port_that_is_taken_is_not_used() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        assert find_free_port(taken) != taken
