"""The page of the rerun viewer, served so that the browser asks no other machine for anything."""

from __future__ import annotations

import re
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from urllib.error import HTTPError, URLError
from urllib.request import urlopen

START_S, RETRY_S = 20.0, 0.1
"""s for which a request waits for the viewer to start, and between two attempts."""
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
