"""Requests to the application of the page without a network, and libraries of run folders for it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from starlette.applications import Starlette

from pipeline.app.access_guard import AccessKeys
from pipeline.app.answer_process import build_answers
from pipeline.app.app_server import build_app
from pipeline.app.job_queue import JobQueue
from pipeline.app.shot_library import ShotLibrary

PORT = 8000
HANG_S = 600.0
"""s after which a request hangs."""
NETWORK = "192.168.1.5"
# Start of an MP4 file: a box `ftyp`, then one of free space.
MP4_HEADER = b"\x00\x00\x00\x18ftypisom\x00\x00\x02\x00isomiso2" + b"\x00\x00\x01\x00free" + bytes(600)
PATH_TRICKS = (
    "../secret.txt", "..%2fsecret.txt", "....//secret.txt", "..\\secret.txt", "%2e%2e/secret.txt", "\0", "C:\\x",
    "/etc/passwd", "//etc/passwd", "~", ".", "..", "break", "scene.json/..", "\u2025/secret.txt", "x" * 5000,
)  # fmt: skip
"""Names that a careless program would follow out of a folder."""
THUMBNAIL = b"\xff\xd8\xff\xe0 a small image"


@dataclass(slots=True)
class Reply:
    """Answer to a request."""

    status: int = 0
    headers: dict[str, str] = field(default_factory=dict)
    body: bytes = b""

    @property
    def document(self) -> dict[str, Any]:
        return dict(json.loads(self.body))

    @property
    def sentence(self) -> str:
        """Why the request was refused."""
        return str(self.document["error"])


def build_local_answers(library: ShotLibrary, queue: JobQueue) -> Starlette:
    """Build what answers requests about shots in this process, where a test can replace functions."""
    from pipeline.app.open_shots import ShotDesk

    desk = ShotDesk(library)
    library.closers.append(desk.close)
    library.closing_listeners.append(desk.close_session)
    return build_answers(library, queue, desk)


class Visitor:
    """Sends requests to an application, as a browser on this machine or on a device in the network."""

    def __init__(self, library: Path) -> None:
        self.library = ShotLibrary(library)
        self.queue = JobQueue(self.library)
        self.keys = AccessKeys()
        answers = build_local_answers(self.library, self.queue)
        self.app: Starlette = build_app(self.library, self.queue, self.keys, answers, f"http://{NETWORK}:{PORT}")

    def ask(self, method: str, path: str, body: bytes | object = b"", device: str = "", **headers: str) -> Reply:
        """Send a request. A path without a slash at its start is below the token; a device asks over the network."""
        return asyncio.run(self.ask_within(method, path, body, device, **headers))

    async def ask_within(
        self, method: str, path: str, body: bytes | object = b"", device: str = "", **headers: str
    ) -> Reply:
        """Send a request within a running loop."""
        parts = [body] if isinstance(body, bytes) else body if isinstance(body, Iterable) else None
        content = iter(parts if parts is not None and not isinstance(body, dict) else [json.dumps(body).encode()])
        reply, is_over = Reply(), False
        host = NETWORK if device else "127.0.0.1"
        target = path if path.startswith(("/", "*")) else f"/{self.keys.token}/{path}"
        place, _, query = target.partition("?")
        named = {"host": f"{host}:{PORT}"} | {key.replace("_", "-"): value for key, value in headers.items()}
        scope = {
            "type": "http", "http_version": "1.1", "method": method, "path": place, "raw_path": place.encode(),
            "query_string": query.encode(), "root_path": "", "scheme": "http", "server": (host, PORT),
            "client": (device or "127.0.0.1", 5000),
            "headers": [(key.encode(), value.encode("latin-1")) for key, value in named.items()],
        }  # fmt: skip

        async def receive() -> dict[str, Any]:
            nonlocal is_over
            if is_over:
                await asyncio.sleep(HANG_S)  # the connection stays until the answer has come
            try:
                part = next(content)
            except StopIteration:
                is_over = True
                return {"type": "http.request", "body": b"", "more_body": False}
            if part is None:  # the other side goes away
                is_over = True
                return {"type": "http.disconnect"}
            await asyncio.sleep(0)
            return {"type": "http.request", "body": part, "more_body": True}

        async def send(message: Any) -> None:
            if message["type"] == "http.response.start":
                reply.status = message["status"]
                reply.headers = {key.decode(): value.decode("latin-1") for key, value in message["headers"]}
            else:
                reply.body += message.get("body", b"")

        with suppress(Exception):  # a fault is answered too, and then raised again for the log
            await self.app(scope, receive, send)
        return reply


def write_run(folder: Path, **changes: Any) -> Path:
    """Write what the library reads of a run folder."""
    import base64

    facts = {"balls": ["cue ball", "red 3"], "trust": {"light": "green"}, "begins": 0.0, "ends": 2.0,
             "sentences": ["The cue ball hit red 3 first. It went on."],
             "thumbnail": "data:image/jpeg;base64," + base64.b64encode(THUMBNAIL).decode()} | changes  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    scene = {"scene": "billiards", "table": {"name": "pool-9ft"}, "clip": {"seconds": 2.0}}
    for name, document in (("scene.json", scene), ("summary.json", facts)):
        (folder / name).write_text(json.dumps(document), encoding="utf-8")
    (folder / "slow.mp4").write_bytes(bytes(range(100)))
    (folder / "report.html").write_text("<title>Report</title>", encoding="utf-8")
    return folder


def list_tree(folder: Path) -> dict[str, bytes]:
    """List all files below a folder with their content."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
