"""The rerun viewer as a process, native or in the browser."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
import webbrowser
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.error import HTTPError, URLError
from urllib.parse import quote
from urllib.request import urlopen

from models.core.errors import OptionError, TruerollError
from pipeline.io.run_folder import find_files_below

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")
# Preferred port on which rerun receives recordings.
PORT = 9876
# Preferred port of its web page.
WEB_PORT = 9090
# Address on which both viewers listen: this machine only.
HOST = "127.0.0.1"
# Environment of the viewer: a proxy that is not there takes its telemetry and its question for the latest version.
NO_OUTSIDE = dict.fromkeys(("ALL_PROXY", "HTTPS_PROXY", "HTTP_PROXY"), f"http://{HOST}:9") | {"NO_PROXY": HOST}


@dataclass(frozen=True, slots=True)
class Viewer:
    """A running viewer."""

    process: subprocess.Popen[bytes]
    page_url: str
    """URL of its page, with the dark theme that the colours of recordings suit; empty for a native viewer."""
    page: ThreadingHTTPServer | None = None
    """Server of its page."""

    def close(self) -> None:
        """Terminate it, its page, and its child process, which shows the window."""
        if self.page is not None:
            self.page.shutdown()
            self.page.server_close()
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGTERM)
            self.process.wait()


def find_recordings(target: Path) -> list[Path]:
    """Find the recordings of a file, a run folder, or all run folders below a folder.

    Args:
        target: File or folder.

    Returns:
        The .rrd files.

    Raises:
        OptionError: There are none.
    """
    if target.is_file():
        return [target]
    own = target / "recording.rrd"
    recordings = [own] if own.is_file() else find_files_below(target, "recording.rrd")
    if not recordings:
        raise OptionError(f"A recording was expected; {target} contains none. Run the clip first: trueroll run CLIP")
    return recordings


def has_display() -> bool:
    """Return whether a window can be opened.

    Returns:
        False on Linux without a display.
    """
    return not sys.platform.startswith("linux") or any(os.environ.get(name) for name in DISPLAY_VARIABLES)


def start_viewer(recordings: Sequence[Path], *, web: bool) -> Viewer:
    """Start a viewer on recordings.

    The `rerun` script starts the viewer as a child process that would outlive it, so both run in their own process
    group. Viewer and page reach this machine alone.

    Args:
        recordings: Recordings to show.
        web: Whether to serve a web page instead of opening a window.

    Returns:
        The running viewer.

    Raises:
        OptionError: rerun is not installed.
        TruerollError: There is no display or no free port.
    """
    program = Path(sys.executable).with_name("rerun")
    if not program.exists():
        raise OptionError(f"The rerun viewer was expected at {program}; install it with: pip install rerun-sdk")
    if not web and not has_display():
        raise TruerollError("The viewer needs a display and there is none; use --web")
    port = find_free_port(PORT)
    page, address = None, ""
    command = [str(program), *map(str, recordings), "--bind", HOST, "--port", str(port)]
    if web:
        inner, outer = find_free_port(0), find_free_port(WEB_PORT)
        command += ["--serve-web", "--web-viewer-port", str(inner)]
        page = serve_sealed_page(HOST, outer, f"http://{HOST}:{inner}", f"http://{HOST}:{port}")
        listens = quote(f"rerun+http://{HOST}:{port}/proxy", safe="")
        address = f"http://{HOST}:{outer}/?theme=dark&url={listens}"
    process = subprocess.Popen(
        command,
        env=os.environ | NO_OUTSIDE | {name.lower(): value for name, value in NO_OUTSIDE.items()},
        start_new_session=True,
    )
    return Viewer(process, address, page)


def find_free_port(wanted: int) -> int:
    """Return the wanted port if it is free, otherwise any free port."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a port that was closed recently is free
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise TruerollError("The viewer needs a port to listen on, and there is none")


def show_recordings(recordings: Sequence[Path], *, web: bool) -> int:
    """Run the viewer on recordings until it is closed.

    Args:
        recordings: Recordings to show.
        web: Whether to serve a web page instead of opening a window.

    Returns:
        Exit status of the viewer.
    """
    with closing(start_viewer(recordings, web=web)) as viewer:
        if len(recordings) > 1:
            print(f"{len(recordings)} recordings: the left panel lists them (button at the top right)", flush=True)
        if viewer.page_url:
            print(f"Look at {viewer.page_url} (end with Ctrl-C)", flush=True)
            if has_display():
                webbrowser.open(viewer.page_url)
        return viewer.process.wait()


# s for which a request waits for the viewer to start, and between two attempts.
START_S, RETRY_S = 20.0, 0.1
_OUTER_LINK = re.compile(rb"<link\s[^>]*https://[^>]*>")


def serve_sealed_page(host: str, port: int, source: str, recordings: str) -> ThreadingHTTPServer:
    """Serve the files of a web page with a content security policy that admits this page and its recordings alone.

    The page of the viewer asks for telemetry, fonts, its latest version and examples at four other hosts.

    Args:
        host: Address on which to serve.
        port: Port on which to serve.
        source: URL of the page, without a slash at its end.
        recordings: URL to which the page connects for its recordings.

    Returns:
        The running server, which ends with this process.
    """

    class SealedHandler(BaseHTTPRequestHandler):
        """Passes requests on."""

        def do_GET(self) -> None:
            try:
                body, kind = _fetch(source + self.path)
            except HTTPError as error:
                self.send_error(error.code)
                return
            except URLError:
                self.send_error(502, "The viewer does not run")
                return
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header(
                "Content-Security-Policy", f"default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob: {recordings}"
            )
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Print nothing."""

    server = ThreadingHTTPServer((host, port), SealedHandler)
    Thread(target=server.serve_forever, daemon=True).start()
    return server


def _fetch(url: str) -> tuple[bytes, str]:
    """Return the bytes of a file of the page, without links to other hosts, and its media type."""
    deadline = time.monotonic() + START_S
    while True:
        try:
            with urlopen(url) as answer:
                body, kind = answer.read(), answer.headers.get_content_type()
            return _OUTER_LINK.sub(b"", body) if kind == "text/html" else body, kind
        except HTTPError:
            raise
        except URLError:
            if time.monotonic() > deadline:
                raise
            time.sleep(RETRY_S)
