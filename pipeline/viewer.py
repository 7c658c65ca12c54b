"""Open a recording in the rerun viewer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from models.errors import OptionError, TruerollError

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
WEB_ADDRESS = "http://127.0.0.1:9090?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"
"""Where rerun serves its page, with the place that the page takes the recording from."""


def show_recording(recording: Path, *, web: bool) -> int:
    """Run the viewer on a recording until it is closed; its exit status.

    The `rerun` script starts the viewer as a child that would outlive it: both run in a group of their own, which is
    ended with us. The viewer's analytics stay off.
    """
    program = Path(sys.executable).with_name("rerun")
    if not program.exists():
        raise OptionError(f"The rerun viewer was expected at {program}; install it with: pip install rerun-sdk")
    if not web and sys.platform.startswith("linux") and not any(os.environ.get(name) for name in DISPLAYS):
        raise TruerollError("The viewer needs a display and there is none; use --web")
    # Both viewers listen for recordings: on this machine only.
    command = [str(program), str(recording), "--bind", "127.0.0.1", *(["--web-viewer"] if web else [])]
    process = subprocess.Popen(command, env=os.environ | {"RERUN_ANALYTICS": "0"}, start_new_session=True)
    try:
        return process.wait()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
