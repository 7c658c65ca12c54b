"""The viewer is started on the recording, alone and without analytics."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import pytest
from support.pseudo_terminal import Terminal, terminal

from models.core.errors import OptionError, TruerollError
from pipeline.reporting.recording.rerun_viewer import free_port, recordings_of, show_recordings

trueroll = pytest.fixture(terminal)

FAKE = """#!/bin/sh
printf '%s\\n' "$RERUN_ANALYTICS" "$@" > "$(dirname "$0")/told"
exit 3
"""


@pytest.fixture(autouse=True)
def usual_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if nothing else listened on this machine."""
    monkeypatch.setattr("pipeline.reporting.recording.rerun_viewer.free_port", lambda wanted: wanted)


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a stand-in for the viewer writes what it was told."""
    (tmp_path / "rerun").write_text(FAKE)
    (tmp_path / "rerun").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    monkeypatch.setenv("RERUN_ANALYTICS", "1")
    monkeypatch.setenv("DISPLAY", ":0")
    return tmp_path / "told"


def test_the_viewer_shows_the_recording_without_analytics_and_its_status_is_ours(told: Path) -> None:
    assert show_recordings([Path("shot.rrd")], web=False) == 3
    assert told.read_text().split() == ["0", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876"]
    assert os.environ["RERUN_ANALYTICS"] == "1"


def test_in_the_browser_only_this_machine_is_served(told: Path) -> None:
    show_recordings([Path("shot.rrd")], web=True)
    assert told.read_text().split() == [
        "0", "shot.rrd", "--bind", "127.0.0.1", "--port", "9876", "--web-viewer", "--web-viewer-port", "9090"
    ]  # fmt: skip


def test_a_folder_of_a_run_is_viewed_by_its_recording(told: Path, trueroll: Terminal, tmp_path: Path) -> None:
    (tmp_path / "recording.rrd").touch()
    assert trueroll("view", tmp_path, "--web").status == 3
    assert told.read_text().split()[1] == str(tmp_path / "recording.rrd")


def test_no_display_is_one_sentence_that_names_the_browser(told: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(TruerollError, match="use --web"):
        show_recordings([Path("shot.rrd")], web=False)
    assert not told.exists()


def test_a_missing_viewer_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(OptionError, match="pip install rerun-sdk"):
        show_recordings([Path("shot.rrd")], web=False)


def test_a_folder_of_runs_is_viewed_by_all_of_them_and_their_gaps(tmp_path: Path) -> None:
    for name in ("a/recording.rrd", "b/c/recording.rrd", "b/c/gap/gap.rrd"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert [str(p.relative_to(tmp_path)) for p in recordings_of(tmp_path)] == [
        "a/recording.rrd", "b/c/gap/gap.rrd", "b/c/recording.rrd"
    ]  # fmt: skip
    assert [p.name for p in recordings_of(tmp_path / "b" / "c")] == ["recording.rrd", "gap.rrd"]
    with pytest.raises(OptionError, match="trueroll run CLIP"):
        recordings_of(tmp_path / "nowhere")


def test_a_port_that_is_taken_is_not_used() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        assert free_port(taken) != taken
