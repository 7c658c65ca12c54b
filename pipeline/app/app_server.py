"""The server of the page: one page, the library behind it, and the queue of clips."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from dataclasses import asdict
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePosixPath
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route

from models.core.errors import OptionError, TruerollError
from pipeline.app import session_routes, shot_routes
from pipeline.app.access_guard import LOOPBACK, AccessGuard, AccessKeys
from pipeline.app.job_queue import JobQueue
from pipeline.app.refusals import Refusal
from pipeline.app.shot_library import FILE_TYPES, ShotLibrary

# Types of the files of the page; those with other suffixes are not served.
PAGE_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml",
              ".woff2": "font/woff2"}  # fmt: skip
# Of pages that commands write: their scripts run apart from this page, and reach nothing.
RESULT_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    " img-src data: blob: 'self'; media-src 'self' data: blob:; font-src data:; frame-ancestors 'self'"
)
# s between two looks for changes that other programs make, while a page is open.
WATCH_S = 1.0
# Messages that wait for one page; a page that falls behind is told to ask again.
MAX_WAITING = 200


class AppServer:
    """The server of one library."""

    def __init__(self, library: ShotLibrary, port: int = 0) -> None:
        self.library = library
        self.queue = JobQueue(library)
        self.keys = AccessKeys()
        try:
            self._sockets = [socket.create_server((LOOPBACK, port))]
        except OSError as error:
            raise OptionError(f"--port is a free port of this machine; {port}: {error.strerror}") from error
        app = build_app(library, self.queue, self.keys)
        config = uvicorn.Config(app, log_level="error", lifespan="off", access_log=False, server_header=False,
                                proxy_headers=False, timeout_graceful_shutdown=1)  # fmt: skip
        self._server = uvicorn.Server(config)

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{LOOPBACK}:{self._sockets[0].getsockname()[1]}/{self.keys.token}/"

    def run(self) -> None:
        """Serve until `stop` is called or the process is interrupted."""
        self.queue.start()
        try:
            self._server.run(sockets=self._sockets)
        finally:
            self.queue.close()
            for close in self.library.closers:
                close()

    def stop(self) -> None:
        """Let `run` return."""
        self._server.should_exit = True


def build_app(library: ShotLibrary, queue: JobQueue, keys: AccessKeys) -> Starlette:
    """Build the application of a library.

    Args:
        keys: Who may ask; the first part of every path is one of its tokens.

    Returns:
        The application.
    """
    handlers = LibraryHandlers(library, queue)
    api: list[BaseRoute] = [
        Route("/library", handlers.send_library),
        Route("/events", handlers.send_events),
        Route("/shots/{id}/thumbnail", handlers.send_thumbnail),
        Route("/shots/{id}/file/{name}", handlers.send_file),
        *shot_routes.build_routes(library),
        *session_routes.build_routes(library, queue),
        Route("/shots/{id}", handlers.delete, methods=["DELETE"]),
        Route("/trash/{undo}/restore", handlers.restore, methods=["POST"]),
        Route("/trash", handlers.empty_trash, methods=["DELETE"]),
    ]
    page = [Route(f"/{name}", _serve(file)) for name, file in find_page_files().items()]
    return Starlette(
        routes=[Mount("/{token}", routes=[Mount("/api", routes=api), *page])],
        middleware=[Middleware(AccessGuard, keys=keys)],
        exception_handlers={
            Refusal: _answer_refusal,
            HTTPException: _answer_http,
            TruerollError: _answer_error,
            Exception: _answer_fault,
        },
    )


def find_page_files() -> dict[str, Traversable]:
    """Find the files of the page by their addresses; that of the page itself is empty."""
    found: dict[str, Traversable] = {}
    waiting = [("", files("pipeline.app").joinpath("page"))]
    while waiting:
        place, folder = waiting.pop()
        for entry in folder.iterdir():
            if entry.is_dir():
                waiting.append((f"{place}{entry.name}/", entry))
            elif PurePosixPath(entry.name).suffix in PAGE_TYPES:
                found["" if f"{place}{entry.name}" == "index.html" else f"{place}{entry.name}"] = entry
    return found


def _serve(file: Traversable) -> Any:
    """Make the handler of a file of the page."""

    async def send(request: Request) -> Response:
        return Response(file.read_bytes(), media_type=PAGE_TYPES[PurePosixPath(file.name).suffix])

    return send


async def _answer_refusal(request: Request, error: Exception) -> Response:
    assert isinstance(error, Refusal)
    return error.to_response()


async def _answer_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    words = {404: "There is nothing at this address.", 405: "This address takes no such request."}
    return Refusal(error.status_code, words.get(error.status_code, "This request cannot be understood.")).to_response()


async def _answer_error(request: Request, error: Exception) -> Response:
    return Refusal(422, " ".join(str(error).split())).to_response()


async def _answer_fault(request: Request, error: Exception) -> Response:
    return Refusal(500, f"This failed by a fault of the program ({type(error).__name__}).").to_response()


class LibraryHandlers:
    """Handlers of the library: its list, its files, its changes."""

    def __init__(self, library: ShotLibrary, queue: JobQueue) -> None:
        self._library, self._queue = library, queue

    async def send_library(self, request: Request) -> Response:
        """Send all cards, the queue and the use of the disk."""
        return Response(await run_in_threadpool(self._describe, request.state.is_local), media_type="application/json")

    def _describe(self, is_local: bool) -> bytes:
        cards = [asdict(card) for card in self._library.list_cards()]
        document = {"revision": self._library.revision, "shots": cards, "jobs": self._queue.describe(),
                    "disk": self._library.measure_disk(), "local": is_local}  # fmt: skip
        return json.dumps(document).encode()

    async def send_thumbnail(self, request: Request) -> Response:
        """Send the small image of a card."""
        content = await run_in_threadpool(self._library.read_thumbnail, request.path_params["id"])
        return Response(content, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=60"})

    async def send_file(self, request: Request) -> Response:
        """Send a file of a run, or a part of it."""
        name = request.path_params["name"]
        path = await run_in_threadpool(self._library.find_file, request.path_params["id"], name)
        headers = {"Cache-Control": "private, no-cache"}
        if FILE_TYPES[name] == "text/html":
            headers["Content-Security-Policy"] = RESULT_POLICY
        return FileResponse(path, media_type=FILE_TYPES[name], headers=headers)

    async def delete(self, request: Request) -> Response:
        """Move a shot to the trash."""
        return JSONResponse({"undo": await run_in_threadpool(self._library.delete, request.path_params["id"])})

    async def restore(self, request: Request) -> Response:
        """Restore a shot from the trash."""
        await run_in_threadpool(self._library.restore, request.path_params["undo"])
        return JSONResponse({})

    async def empty_trash(self, request: Request) -> Response:
        """Empty the trash."""
        await run_in_threadpool(self._library.empty_trash)
        return JSONResponse({})

    async def send_events(self, request: Request) -> Response:
        """Send changes as they happen, until the page is closed."""
        return StreamingResponse(self._stream_events(), media_type="text/event-stream")

    async def _stream_events(self) -> AsyncIterator[str]:
        """Yield a message per change."""
        loop, waiting = asyncio.get_running_loop(), asyncio.Queue[dict[str, Any]](MAX_WAITING)

        def put(message: dict[str, Any]) -> None:
            if not waiting.full():
                waiting.put_nowait(message)

        def listen(message: dict[str, Any]) -> None:
            loop.call_soon_threadsafe(put, message)

        self._library.listeners.append(listen)
        try:
            yield "retry: 1000\n\n"
            while True:
                try:
                    message = await asyncio.wait_for(waiting.get(), WATCH_S)
                    yield f"data: {json.dumps(message)}\n\n"
                except TimeoutError:
                    await run_in_threadpool(self._library.announce_changes)
                    yield ":\n\n"  # a comment: the page has gone if it cannot be sent
        finally:
            self._library.listeners.remove(listen)
