"""The rerun viewer, beside us or in the browser: opened on recordings, or waiting for one that is being made."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from models.core.errors import OptionError, TruerollError

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
PORT = 9876
"""Where rerun listens for recordings."""
WEB_PORT = 9090
"""Where it serves its page."""
HERE = "127.0.0.1"
"""Both viewers listen: on this machine only."""
LAYERS = ("recording.rrd", "gap.rrd", "gap/gap.rrd")
"""What a run's folder may hold for the viewer: the run, and what a diagnosis adds to it."""


@dataclass(frozen=True, slots=True)
class Viewer:
    """A running viewer."""

    process: subprocess.Popen[bytes]
    address: str
    """of its page, dark as recordings are coloured for; empty where it is no page."""
    listens: str
    """where it takes recordings from."""

    def close(self) -> None:
        """End it, with the child that shows the window."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGTERM)
            self.process.wait()


def recordings_of(target: Path) -> list[Path]:
    """The .rrd files of a file, a run's folder, or every run below a folder; OptionError where there are none."""
    if target.is_file():
        return [target]
    own = [target / name for name in LAYERS if (target / name).is_file()]
    below = sorted(path for name in ("recording.rrd", "gap.rrd") for path in target.rglob(name))
    found = own or below
    if not found:
        raise OptionError(f"A recording was expected; {target} holds none. Run the clip first: trueroll run CLIP")
    return found


def has_display() -> bool:
    """Whether a window can be opened."""
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in DISPLAYS)


@contextmanager
def open_viewer(recordings: Sequence[Path], *, web: bool) -> Iterator[Viewer]:
    """A viewer that is ended with the context."""
    viewer = start_viewer(recordings, web=web)
    try:
        yield viewer
    finally:
        viewer.close()


def start_viewer(recordings: Sequence[Path], *, web: bool) -> Viewer:
    """A viewer on these recordings, which also listens for more.

    The `rerun` script starts the viewer as a child that would outlive it: both run in a group of their own. The
    viewer's analytics stay off.
    """
    program = Path(sys.executable).with_name("rerun")
    if not program.exists():
        raise OptionError(f"The rerun viewer was expected at {program}; install it with: pip install rerun-sdk")
    if not web and not has_display():
        raise TruerollError("The viewer needs a display and there is none; use --web")
    port = free_port(PORT)
    listens = f"rerun+http://{HERE}:{port}/proxy"
    page, address = free_port(WEB_PORT), ""
    command = [str(program), *map(str, recordings), "--bind", HERE, "--port", str(port)]
    if web:
        command += ["--web-viewer", "--web-viewer-port", str(page)]
        address = f"http://{HERE}:{page}?theme=dark&url={quote(listens, safe='')}"
    process = subprocess.Popen(command, env=os.environ | {"RERUN_ANALYTICS": "0"}, start_new_session=True)
    return Viewer(process, address, listens)


def free_port(wanted: int) -> int:
    """The port that is wanted, or, where something listens on it already, any other."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that was left a moment ago is free
            try:
                probe.bind((HERE, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise TruerollError("The viewer needs a port to listen on, and there is none")


def show_recordings(recordings: Sequence[Path], *, web: bool) -> int:
    """Run the viewer on recordings until it is closed; its exit status."""
    with open_viewer(recordings, web=web) as viewer:
        if len(recordings) > 1:
            print(f"{len(recordings)} recordings: the panel on the left (top right button) lists them", flush=True)
        if viewer.address:
            print(f"Look at {viewer.address} (end with Ctrl-C)", flush=True)
        return viewer.process.wait()
