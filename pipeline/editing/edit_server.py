"""The server of the editor: one page and its data, on this machine only.

A random token in the address keeps other users and pages out; the Host header is checked against DNS rebinding, and the
Origin of every change. Paths are a fixed list, so that no file outside the run is reachable.
"""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from importlib.resources import files
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from models.core.errors import OptionError
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.editing.edit_session import ConflictError, EditSession
from pipeline.io.corrections_file import MAX_BYTES, SCHEMA, parse_corrections

HOST = "127.0.0.1"
# Files of the page by the last part of their address, with their types.
PAGE_FILES = {"": ("edit.html", "text/html"), "edit.css": ("edit.css", "text/css"),
              "edit.js": ("edit.js", "text/javascript")}  # fmt: skip
SECURITY_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}

Handler = Callable[[Request], Awaitable[Response]]


class EditServer:
    """The server of one editing session."""

    def __init__(self, session: EditSession, port: int = 0) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(18)
        try:
            self._socket = socket.create_server((HOST, port))
        except OSError as error:
            raise OptionError(f"--port is a free port of this machine; {port}: {error.strerror}") from error
        config = uvicorn.Config(build_app(session, self.token), log_level="error", lifespan="off", access_log=False,
                                server_header=False, timeout_graceful_shutdown=1)  # fmt: skip
        self._server = uvicorn.Server(config)

    @property
    def url(self) -> str:
        """Address of the page, with its token."""
        return f"http://{HOST}:{self._socket.getsockname()[1]}/{self.token}/"

    def run(self) -> None:
        """Serve until `stop` is called or the process is interrupted."""
        self._server.run(sockets=[self._socket])

    def stop(self) -> None:
        """Let `run` return."""
        self._server.should_exit = True


def build_app(session: EditSession, token: str) -> Starlette:
    """Build the application of a session.

    Args:
        token: Secret first part of every path.

    Returns:
        The application.
    """
    handlers = _SessionHandlers(session)
    routes = [
        *(Route(f"/{token}/{name}", _serve_page_file(name)) for name in PAGE_FILES),
        Route(f"/{token}/status", handlers.send_status),
        Route(f"/{token}/state", handlers.send_state),
        Route(f"/{token}/frame/{{number:int}}", handlers.send_frame),
        Route(f"/{token}/corrections", handlers.change_corrections, methods=["PUT"]),
        *(Route(f"/{token}/{name}", handlers.step, methods=["POST"]) for name in ("undo", "redo")),
        Route(f"/{token}/finish", handlers.finish, methods=["POST"]),
    ]
    middleware = [
        Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"], www_redirect=False),
        Middleware(BaseHTTPMiddleware, dispatch=_guard),
    ]
    return Starlette(routes=routes, middleware=middleware)


async def _guard(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
    """Refuse changes that another page asks for, and add the headers of security to every answer."""
    origin = request.headers.get("origin")
    if request.method not in ("GET", "HEAD") and origin not in (None, f"http://{request.headers.get('host')}"):
        response: Response = _refuse(403, "Changes are accepted from the page of the editor only.")
    else:
        response = await call_next(request)
    for name, value in SECURITY_HEADERS.items():
        response.headers.setdefault(name, value)
    return response


def _serve_page_file(name: str) -> Handler:
    """Make the handler of a file of the page."""
    file, kind = PAGE_FILES[name]

    async def send(request: Request) -> Response:
        return Response(files("pipeline.editing").joinpath("page", file).read_bytes(), media_type=kind)

    return send


def _refuse(status: int, sentence: str) -> JSONResponse:
    return JSONResponse({"error": sentence}, status)


class _SessionHandlers:
    """Handlers of the data of a session."""

    def __init__(self, session: EditSession) -> None:
        self._session = session

    async def send_status(self, request: Request) -> Response:
        """Send progress and revision."""
        return JSONResponse(asdict(self._session.status))

    async def send_state(self, request: Request) -> Response:
        """Send corrections and run; the ETag is the revision."""
        state = await run_in_threadpool(self._session.describe)
        state |= {"tables": list(TABLE_PRESETS)}
        return JSONResponse(state, headers={"ETag": f'"{state["revision"]}"'})

    async def send_frame(self, request: Request) -> Response:
        """Send a frame as JPEG."""
        content = await run_in_threadpool(self._session.read_frame, request.path_params["number"])
        if content is None:
            return _refuse(404, "There is no such frame.")
        return Response(content, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=3600"})

    async def change_corrections(self, request: Request) -> Response:
        """Replace the corrections by those of the request, which must name their revision in If-Match."""
        content = b""
        async for part in request.stream():
            content += part
            if len(content) > MAX_BYTES:
                return _refuse(413, "These corrections are too many for one file.")
        try:
            document = json.loads(content.decode("utf-8"))
            if isinstance(document, dict):
                document = {"schema": SCHEMA, **document}
            corrections = parse_corrections(document).corrections
        except (ValueError, RecursionError, OverflowError) as error:
            return _refuse(422, f"The correction cannot be used: {' '.join(str(error).split())}.")
        return await self._change(request, lambda revision: self._session.change(corrections, revision))

    async def step(self, request: Request) -> Response:
        """Undo the last correction, or redo the one that was undone last."""
        forward = request.url.path.endswith("redo")
        return await self._change(request, lambda revision: self._session.step(revision, forward=forward))

    async def finish(self, request: Request) -> Response:
        """Start the stages that write video, report and recording."""
        self._session.finish()
        return JSONResponse(asdict(self._session.status))

    async def _change(self, request: Request, change: Callable[[int], Any]) -> Response:
        """Make a change to the revision that the request names."""
        try:
            revision = int(request.headers.get("if-match", "").strip('"'))
        except ValueError:
            return _refuse(428, "A change names the revision that it is made to, in the header If-Match.")
        try:
            await run_in_threadpool(change, revision)
        except ConflictError as error:
            return _refuse(412, str(error))
        except OptionError as error:
            return _refuse(422, str(error))
        status = self._session.status
        return JSONResponse(asdict(status), headers={"ETag": f'"{status.revision}"'})
