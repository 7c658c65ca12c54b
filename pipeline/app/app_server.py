"""The server of the page: one page, the library behind it, and the queue of clips."""

from __future__ import annotations

import asyncio
import hashlib
import json
import socket
import webbrowser
from collections.abc import AsyncGenerator, Callable
from contextlib import suppress
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path, PurePosixPath
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from models.core.errors import OptionError
from pipeline.app.access_guard import CODE_S, LOOPBACK, AccessGuard, AccessKeys
from pipeline.app.answer_process import AnswerProcess
from pipeline.app.job_queue import JobQueue
from pipeline.app.refusals import EXCEPTION_HANDLERS, Refusal, read_json_body, refuse_status
from pipeline.app.shot_library import FILE_TYPES, RELOAD, ShotLibrary
from pipeline.app.uploads import MAX_UPLOAD_BYTES, UploadDesk
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.terminal.command_line import print_note

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


class SentenceProtocol(H11Protocol):
    """HTTP whose refusals have the form of all others, also of what is no HTTP."""

    def send_400_response(self, msg: str) -> None:
        """Refuse what cannot be read as a request, and end the connection."""
        response = refuse_status(400).to_response()
        head = [b"HTTP/1.1 400 Bad Request", b"connection: close", *(b": ".join(one) for one in response.raw_headers)]
        self.transport.write(b"\r\n".join([*head, b"", bytes(response.body)]))
        self.transport.close()


class AppServer:
    """The server of one library."""

    def __init__(
        self, library: ShotLibrary, port: int = 0, *, lan: bool = False,
        build_answers: Callable[[ShotLibrary, JobQueue], ASGIApp] = lambda library, _: AnswerProcess(library),
    ) -> None:  # fmt: skip
        """Open the port, but serve nothing yet.

        Args:
            port: Port of the page; 0 for a free one.
            lan: Whether devices in the same network may be paired.
            build_answers: Builds what answers requests about shots.

        Raises:
            OptionError: The port is taken, or this machine is in no network.
        """
        self.library = library
        self.queue = JobQueue(library)
        self.keys = AccessKeys()
        hosts = [LOOPBACK, find_network_address()] if lan else [LOOPBACK]
        self._sockets: list[socket.socket] = []
        for host in hosts:
            try:
                self._sockets.append(socket.create_server((host, port)))
            except OSError as error:
                raise OptionError(f"--port is a free port of this machine; {port}: {error.strerror}") from error
            port = self._sockets[0].getsockname()[1]
        network = f"http://{hosts[1]}:{port}" if lan else ""
        answers = build_answers(library, self.queue)
        app = build_app(library, self.queue, self.keys, answers, network, lambda: self._server.should_exit)
        config = uvicorn.Config(app, log_level="error", lifespan="off", access_log=False, server_header=False,
                                proxy_headers=False,
            ws="none", http=SentenceProtocol, timeout_graceful_shutdown=2)  # fmt: skip
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


def find_network_address() -> str:
    """Find the address of this machine in its network, without sending anything.

    Raises:
        OptionError: It is in none.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address for documentation (RFC 5737): only the route is looked up
        except OSError as error:
            raise OptionError("--lan needs a network; this machine is in none") from error
        return str(probe.getsockname()[0])


def open_page(library: ShotLibrary, port: int, *, browser: bool, lan: bool = False, shot: Path | None = None) -> None:
    """Serve a library until the process is interrupted, and open its page.

    Args:
        port: Port of the page; 0 for a free one.
        browser: Whether to open it in the browser.
        lan: Whether devices in the same network may be paired.
        shot: Folder of a shot in the library, which the page shows first.

    Raises:
        OptionError: The library cannot be written, or the port is taken.
    """
    require_writable_folder(library.root)
    server = AppServer(library, port, lan=lan)
    address = server.url if shot is None else f"{server.url}#/shot/{library.identify(shot)}"
    print_note(f"The page is at {address} (end with Ctrl-C)")
    if browser:
        webbrowser.open(address)
    with suppress(KeyboardInterrupt):  # the way to end it
        server.run()


def build_app(
    library: ShotLibrary,
    queue: JobQueue,
    keys: AccessKeys,
    answers: ASGIApp,
    network: str = "",
    is_stopping: Callable[[], bool] = lambda: False,
) -> Starlette:
    """Build the application of a library.

    Args:
        keys: Who may ask; the first part of every path is one of its tokens.
        answers: What answers requests about one shot, and those for a command on several; it takes seconds to import.
        network: Address in the network, such as `http://192.168.1.5:8000`; empty where devices cannot be paired.
        is_stopping: Whether the server ends, so that streams of events end too.

    Returns:
        The application.
    """
    handlers = LibraryHandlers(library, queue, keys, network, is_stopping)
    if isinstance(answers, AnswerProcess):
        handlers.answers = answers
    api: list[BaseRoute] = [
        Route("/library", handlers.send_library),
        Route("/events", handlers.send_events),
        Route("/shots/{id}/thumbnail", handlers.send_thumbnail),
        Route("/shots/{id}/file/{name}", handlers.send_file),
        Route("/shots/{id}/shared/{name}", handlers.send_shared),
        Route("/clips", handlers.take_clip, methods=["POST"]),
        Route("/paths", handlers.take_path, methods=["POST"]),
        Route("/jobs/{id}/preview", handlers.send_preview),
        Route("/jobs/{id}/corners", handlers.place_corners, methods=["POST"]),
        Route("/jobs/{id}/{action}", handlers.change_job, methods=["POST"]),
        Route("/lan/code", handlers.start_pairing, methods=["POST"]),
        Route("/shots/{id}", handlers.delete, methods=["DELETE"]),
        Route("/shots/{id}/name", handlers.rename, methods=["PUT"]),
        Route("/trash/{undo}/restore", handlers.restore, methods=["POST"]),
        Route("/trash", handlers.send_trash),
        Route("/trash", handlers.empty_trash, methods=["DELETE"]),
        *(Route(f"/{name}", answers) for name in ("shots/{id}", "shots/{id}/{rest:path}", "sessions")),
    ]
    page = [Route(f"/{name}", _serve(file)) for name, file in find_page_files().items()]
    return Starlette(
        routes=[Mount("/{token}", routes=[Mount("/api", routes=api), *page])],
        middleware=[Middleware(AccessGuard, keys=keys)],
        exception_handlers=EXCEPTION_HANDLERS,
    )


def find_page_files() -> dict[str, Traversable]:
    """Find the files of the page by their addresses; that of the page itself is empty."""
    page_files: dict[str, Traversable] = {}
    waiting = [("", files("pipeline.app").joinpath("page"))]
    while waiting:
        place, folder = waiting.pop()
        for entry in folder.iterdir():
            if entry.is_dir():
                waiting.append((f"{place}{entry.name}/", entry))
            elif PurePosixPath(entry.name).suffix in PAGE_TYPES:
                page_files["" if f"{place}{entry.name}" == "index.html" else f"{place}{entry.name}"] = entry
    return page_files


def _serve(file: Traversable) -> Any:
    """Make the handler of a file of the page."""

    async def send(request: Request) -> Response:
        return Response(file.read_bytes(), media_type=PAGE_TYPES[PurePosixPath(file.name).suffix])

    return send


def _require_local(request: Request) -> None:
    """Require that a request comes from this machine; raises Refusal."""
    if not request.state.is_local:
        raise Refusal(403, "This is possible on the computer itself only.")


class LibraryHandlers:
    """Handlers of the library: its list, its files, its changes."""

    def __init__(
        self, library: ShotLibrary, queue: JobQueue, keys: AccessKeys, network: str, is_stopping: Callable[[], bool]
    ) -> None:
        self._library, self._queue, self._keys, self._network = library, queue, keys, network
        self._uploads, self._is_stopping = UploadDesk(library, queue), is_stopping
        self.answers: AnswerProcess | None = None
        """What answers requests about shots, where that is a process of its own."""

    async def send_library(self, request: Request) -> Response:
        """Send all cards, the queue and the use of the disk."""
        return Response(await run_in_threadpool(self._describe, request.state.is_local), media_type="application/json")

    def _describe(self, is_local: bool) -> bytes:
        cards, jobs = self._library.list_cards(), self._queue.describe()
        if cards and self.answers is not None:
            self.answers.start_soon()
        busy = self._queue.list_running()
        document = {
            "revision": self._library.revision,
            "shots": [card.describe() | ({"state": "running"} if card.id in busy else {}) for card in cards],
            "former_names": self._library.read_former_names(),
            "jobs": jobs,
            "disk": self._library.measure_disk(),
            "local": is_local,
            "lan": bool(self._network),
            "limits": {"upload_bytes": MAX_UPLOAD_BYTES},
            "preparing": "" if self.answers is None else self.answers.preparing,
        }
        return json.dumps(document).encode()

    async def send_thumbnail(self, request: Request) -> Response:
        """Send the small image of a card."""
        content = await run_in_threadpool(self._library.read_thumbnail, request.path_params["id"])
        headers = {"Cache-Control": "private, no-cache", "ETag": f'"{hashlib.sha256(content).hexdigest()[:16]}"'}
        if request.headers.get("if-none-match") == headers["ETag"]:
            return Response(status_code=304, headers=headers)
        return Response(content, media_type="image/jpeg", headers=headers)

    async def send_file(self, request: Request) -> Response:
        """Send a file of a run, or a part of it."""
        name = request.path_params["name"]
        path = await run_in_threadpool(self._library.find_file, request.path_params["id"], name)
        # a sandboxed report has an origin of its own and shows the video beside it; the secret path protects both
        headers = {"Cache-Control": "private, no-cache", "Cross-Origin-Resource-Policy": "cross-origin"}
        if FILE_TYPES[name] == "text/html":
            headers["Content-Security-Policy"] = RESULT_POLICY
        return FileResponse(path, media_type=FILE_TYPES[name], headers=headers)

    async def send_shared(self, request: Request) -> Response:
        """Send a file that was written to be shared."""
        path = await run_in_threadpool(
            self._library.find_shared, request.path_params["id"], request.path_params["name"]
        )
        return FileResponse(path, headers={"Cache-Control": "private, no-cache"})

    async def take_clip(self, request: Request) -> Response:
        """Take an uploaded clip."""
        job = await self._uploads.take(request)
        return JSONResponse({"job": job, "jobs": [job]}, 201)

    async def take_path(self, request: Request) -> Response:
        """Take a clip, or all clips below a folder, where they lie on this machine."""
        _require_local(request)
        document = await read_json_body(request)
        jobs = await run_in_threadpool(self._add_path, document.get("path"))
        return JSONResponse({"job": jobs[0], "jobs": jobs}, 201)

    def _add_path(self, text: object) -> list[dict[str, Any]]:
        """Add the clip or clips of a path; raises Refusal."""
        from pipeline.batch.clip_discovery import survey_folder  # slow to import
        from video.io.image_sequence import is_image_sequence

        if not isinstance(text, str) or not text.strip() or "\0" in text:
            raise Refusal(422, "The path of a clip or of a folder was expected.")
        path = Path(text.strip().strip("\"'")).expanduser()
        if not path.is_absolute() or not path.exists():
            raise Refusal(404, f"There is nothing at {path}; give the whole path of a clip or of a folder.")
        is_folder = path.is_dir() and not is_image_sequence(path)
        clips = survey_folder(path, excluded=self._library.root).clips if is_folder else (path,)
        if not clips:
            raise Refusal(422, f"There are no clips in {path}.")
        return [self._queue.add_clip(clip) for clip in clips]

    async def send_preview(self, request: Request) -> Response:
        """Send the image of the first results of a clip."""
        path = await run_in_threadpool(self._queue.find_preview, request.path_params["id"])
        return FileResponse(path, media_type="image/jpeg", headers={"Cache-Control": "private, no-cache"})

    async def change_job(self, request: Request) -> Response:
        """Cancel, retry or dismiss a job."""
        actions = {"cancel": self._queue.cancel, "retry": self._queue.retry, "dismiss": self._queue.dismiss}
        if request.path_params["action"] not in actions:
            raise HTTPException(404)
        job = await run_in_threadpool(actions[request.path_params["action"]], request.path_params["id"])
        return JSONResponse({"job": job})

    async def place_corners(self, request: Request) -> Response:
        """Run a clip again with the corners of its table or court."""
        document, job = await read_json_body(request), request.path_params["id"]
        job = await run_in_threadpool(self._queue.place_corners, job, document.get("corners"), document.get("sport"))
        return JSONResponse({"job": job})

    async def start_pairing(self, request: Request) -> Response:
        """Make a code that pairs a phone, with its address as an image that a phone reads."""
        _require_local(request)
        if not self._network:
            raise Refusal(409, "Start trueroll app with --lan to open the page on a phone.")
        import segno  # only who pairs a phone needs it

        pairing = self._keys.start_pairing()
        address = f"{self._network}/pair?code={pairing.code}"
        image = segno.make(address, error="m").svg_inline(scale=6, border=4, light="#fff")
        return JSONResponse({"code": pairing.code, "address": address, "svg": image, "expires_s": CODE_S})

    async def delete(self, request: Request) -> Response:
        """Move a shot to the trash."""
        return JSONResponse({"undo": await run_in_threadpool(self._delete, request.path_params["id"])})

    def _delete(self, shot: str) -> str:
        self._queue.require_idle(shot)
        return self._library.delete(shot)

    async def rename(self, request: Request) -> Response:
        """Rename the folder of a shot; its id changes with it."""
        document = await read_json_body(request)
        shot, before = await run_in_threadpool(self._rename, request.path_params["id"], document.get("name"))
        return JSONResponse({"shot": shot, "before": before})

    def _rename(self, shot: str, name: object) -> tuple[str, str]:
        self._queue.require_idle(shot)
        return self._library.rename(shot, name if isinstance(name, str) else "")

    async def restore(self, request: Request) -> Response:
        """Restore a shot from the trash."""
        await run_in_threadpool(self._library.restore, request.path_params["undo"])
        return JSONResponse({})

    async def send_trash(self, request: Request) -> Response:
        """Send what lies in the trash."""
        return JSONResponse({"entries": await run_in_threadpool(self._library.list_trash)})

    async def empty_trash(self, request: Request) -> Response:
        """Empty the trash."""
        await run_in_threadpool(self._library.empty_trash)
        return JSONResponse({})

    async def send_events(self, request: Request) -> Response:
        """Send changes as they happen, until the page is closed."""
        return StreamingResponse(self.stream_events(), media_type="text/event-stream")

    async def stream_events(self) -> AsyncGenerator[str, None]:
        """Yield a message per change."""
        loop, waiting = asyncio.get_running_loop(), asyncio.Queue[dict[str, Any]](MAX_WAITING)

        def put(message: dict[str, Any]) -> None:
            if waiting.full():  # this page asks for everything again
                while not waiting.empty():
                    waiting.get_nowait()
                message = RELOAD
            waiting.put_nowait(message)

        def listen(message: dict[str, Any]) -> None:
            with suppress(RuntimeError):  # the server has just ended
                loop.call_soon_threadsafe(put, message)

        self._library.listeners.append(listen)
        try:
            yield "retry: 1000\n\n"
            next_look = loop.time() + WATCH_S
            while not self._is_stopping():
                try:
                    message = await asyncio.wait_for(waiting.get(), max(next_look - loop.time(), 0.001))
                    yield f"data: {json.dumps(message)}\n\n"
                except TimeoutError:
                    yield ":\n\n"  # a comment: the page has gone if it cannot be sent
                if loop.time() >= next_look:
                    await run_in_threadpool(self._library.announce_changes)
                    next_look = loop.time() + WATCH_S
        finally:
            self._library.listeners.remove(listen)
