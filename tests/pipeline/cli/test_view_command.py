"""The viewer is started on the recording, alone and without analytics."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import pytest
from support.pseudo_terminal import Terminal, make_terminal

from models.core.errors import OptionError, TruerollError
from pipeline.reporting.recording.rerun_viewer import find_free_port, find_recordings, show_recordings

trueroll = pytest.fixture(make_terminal)

FAKE = """#!/bin/sh
printf '%s\\n' "$RERUN_ANALYTICS" "$@" > "$(dirname "$0")/arguments"
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
    monkeypatch.setenv("RERUN_ANALYTICS", "1")
    monkeypatch.setenv("DISPLAY", ":0")
    return tmp_path / "arguments"


def test_the_viewer_shows_the_recording_without_analytics_and_its_status_is_ours(arguments: Path) -> None:
    assert show_recordings([Path("shot.rrd")], web=False) == 3
    assert arguments.read_text().split() == ["0", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876"]
    assert os.environ["RERUN_ANALYTICS"] == "1"


def test_in_the_browser_only_this_machine_is_served(arguments: Path) -> None:
    show_recordings([Path("shot.rrd")], web=True)
    assert arguments.read_text().split() == [
        "0", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876", "--web-viewer", "--web-viewer-port", "9090"
    ]  # fmt: skip


def test_a_folder_of_a_run_is_viewed_by_its_recording(arguments: Path, trueroll: Terminal, tmp_path: Path) -> None:
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


def test_a_folder_of_runs_is_viewed_by_all_of_them_and_their_gaps(tmp_path: Path) -> None:
    for name in ("a/recording.rrd", "b/c/recording.rrd", "b/c/gap/gap.rrd"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert [str(p.relative_to(tmp_path)) for p in find_recordings(tmp_path)] == [
        "a/recording.rrd", "b/c/gap/gap.rrd", "b/c/recording.rrd"
    ]  # fmt: skip
    assert [p.name for p in find_recordings(tmp_path / "b" / "c")] == ["recording.rrd", "gap.rrd"]
    with pytest.raises(OptionError, match="trueroll run CLIP"):
        find_recordings(tmp_path / "nowhere")


def test_a_port_that_is_taken_is_not_used() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        assert find_free_port(taken) != taken
