"""The process that answers questions about shots, so that the server stays small whatever is asked of it.

Requests pass as messages of ASGI over a pair of sockets. The process starts when it is first needed. It is replaced
when it has grown and nobody loses anything by that, and ends when nobody has asked anything for long. A request that
comes meanwhile goes to the next process: one that retires works until its input ends.
"""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, MutableMapping
from contextlib import suppress
from itertools import count, islice
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.types import Message, Receive, Scope, Send

from models.core.errors import TruerollError
from pipeline.app.job_queue import JobQueue
from pipeline.app.refusals import EXCEPTION_HANDLERS, Refusal, read_body
from pipeline.app.shot_library import ShotLibrary
from pipeline.engine.process_setup import limit_library_threads

if TYPE_CHECKING:
    from pipeline.app.open_shots import ShotDesk

# Resident memory above which the process is replaced, bytes. A fresh one that has answered about one shot has 400 MB.
RENEWAL_BYTES = 1_000_000_000
# s without a request after which a process that has grown is replaced, and after which any process ends; s between two
# looks at its size.
QUIET_S, IDLE_S, LOOK_S = 5.0, 1200.0, 2.0
# s after a page has got the library, before the process starts in the background.
START_S = 1.0
# Newest shots of which the first that can be read is what code is loaded by.
PREPARED_FROM = 3
# Longest time for the process to end, s.
EXIT_S = 5.0
# Of the C library of Linux: with an arena per thread, as by default, 40 corrections took 2.5 GB instead of 1.5.
ALLOCATION = {"MALLOC_ARENA_MAX": "2"}
# What a request is described by; the rest of its scope belongs to the server.
SCOPE_KEYS = ("type", "asgi", "http_version", "method", "scheme", "path", "raw_path", "root_path", "query_string",
              "headers", "client", "server")  # fmt: skip

Listener = Callable[[Message | None], None]


class AnswerProcess:
    """Passes requests to the process that answers them; an application of ASGI, safe to use from several threads."""

    def __init__(self, library: ShotLibrary) -> None:
        self._library = library
        self._lock = threading.Lock()
        self._child: _Child | None = None
        self._is_closed = False
        self.preparing = ""
        """What the process does before it can answer at once: starting, compiling, or nothing."""
        library.closers.append(self.close)
        library.closing_listeners.append(self._close_session)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and its answer back."""
        body = await read_body(Request(scope, receive))
        loop, messages = asyncio.get_running_loop(), asyncio.Queue[Message | None]()

        def put(message: Message | None) -> None:
            with suppress(RuntimeError):  # the server has just ended
                loop.call_soon_threadsafe(messages.put_nowait, message)

        request = {key: scope[key] for key in SCOPE_KEYS if key in scope}
        await run_in_threadpool(self._ask, ("answer", request, body), put)
        is_open = True
        while is_open:
            message = await messages.get()
            if message is None:
                raise Refusal(503, "What computes answers has ended unexpectedly; ask again.")
            await send(message)
            is_open = message["type"] != "http.response.body" or message.get("more_body", False)

    def start_soon(self) -> None:
        """Start the process in the background, a moment later, when the page is drawn."""
        if self._child is None:
            timer = threading.Timer(START_S, self._start)
            timer.daemon = True
            timer.start()

    def _start(self) -> None:
        with self._lock, suppress(Refusal):  # it was closed meanwhile
            self._find_child()

    def close(self) -> None:
        """End the process for good."""
        with self._lock:
            child, self._child, self._is_closed = self._child, None, True
        if child is not None:
            child.end_input()
            child.wait()

    def _find_child(self) -> _Child:
        """Return the process; start it if there is none. The caller holds the lock."""
        if self._is_closed:
            raise Refusal(503, "trueroll ends now.")
        if self._child is None:
            self._child = _Child(self._library.root)
            threading.Thread(target=self._listen, args=(self._child,), daemon=True).start()
            self._note(preparing="starting")
        return self._child

    def _ask(self, question: tuple[Any, ...], listener: Listener) -> None:
        """Send a question; one that could not be sent to a process that has just died goes to another one."""
        with self._lock:
            try:
                self._find_child().send(question, listener)
            except OSError:
                self._child = None
                self._find_child().send(question, listener)

    def _listen(self, child: _Child) -> None:
        """Pass on what a process says until it has ended."""
        for message in child.read_messages():
            if message["type"] == "retire":
                self._replace(child, is_needed=message["is_large"])
            elif message["type"] == "preparing":
                if self._child is child:  # of one that retires, no page waits for more than the answer it asked for
                    self._note(preparing=message["preparing"])
            else:
                self._library.announce(**message)
        with self._lock:
            if self._child is child:
                self._child = None
                self._note(preparing="")
        child.wait()

    def _replace(self, child: _Child, *, is_needed: bool) -> None:
        """Let a process end; start the next one where it is needed soon, and a page is open."""
        with self._lock:
            if self._child is child:
                self._child = None
            child.end_input()
            if is_needed and self._library.listeners and not self._is_closed:
                self._find_child()

    def _note(self, preparing: str) -> None:
        self.preparing = preparing
        self._library.announce(type="preparing", preparing=preparing)

    def _close_session(self, shot: str) -> None:
        """Close what is open of a shot before its folder is moved."""
        is_closed = threading.Event()
        with self._lock:
            if self._child is None or not self._child.was_asked:  # it holds nothing open, and may still be starting
                return
            try:
                self._child.send(("close", shot), lambda _: is_closed.set())
            except OSError:  # it has just died, and holds nothing open
                return
        is_closed.wait(EXIT_S)


class _Child:
    """A running process and the requests that it has not answered yet."""

    def __init__(self, library: Path) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            root = str(Path(__file__).resolve().parents[2])
            start = f"import sys; sys.path.insert(0, {root!r}); from {__name__} import main; main()"
            self._process = subprocess.Popen(
                [sys.executable, "-c", start, str(library), str(theirs.fileno())], stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()], env={**ALLOCATION, **os.environ},
            )  # fmt: skip
        self._socket = ours
        self._connection = Connection(os.dup(ours.fileno()))
        self._listeners: dict[int, Listener] = {}
        self._numbers, self._is_over, self._lock = count(), False, threading.Lock()
        self.was_asked = False
        """Whether anybody has asked it for an answer."""

    def send(self, question: tuple[Any, ...], listener: Listener) -> None:
        """Send a question, whose answer the listener is called with in parts; None means that the process has died."""
        number = next(self._numbers)
        with self._lock:
            if self._is_over:  # nobody would tell this listener
                raise BrokenPipeError
            self._listeners[number], self.was_asked = listener, True
        try:
            self._connection.send((number, *question))
        except OSError:
            del self._listeners[number]
            raise

    def end_input(self) -> None:
        """Tell the process that no more questions come."""
        with suppress(OSError):  # it has died
            self._socket.shutdown(socket.SHUT_WR)

    def read_messages(self) -> Any:
        """Pass answers on, and yield what is no answer, until the process ends."""
        with suppress(EOFError, OSError):
            while True:
                number, message = self._connection.recv()
                if number is None:
                    yield message
                    continue
                self._listeners[number](message)
                if message is None or (message["type"] == "http.response.body" and not message.get("more_body")):
                    del self._listeners[number]
        with self._lock:
            self._is_over = True
        for listener in list(self._listeners.values()):
            listener(None)

    def wait(self) -> None:
        """Wait until the process has ended; kill one that does not."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(EXIT_S)
        self._process.kill()
        self._process.wait()
        self._connection.close()
        self._socket.close()


def build_answers(library: ShotLibrary, queue: JobQueue, desk: ShotDesk) -> Starlette:
    """Build the application that answers requests about shots, in the process that computes the answers."""
    from pipeline.app import session_routes, shot_routes

    routes = [*shot_routes.build_routes(desk), *session_routes.build_routes(library, queue)]
    return Starlette(routes=routes, exception_handlers=EXCEPTION_HANDLERS)


def main() -> None:
    """Answer questions about the shots of a library until the input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the keyboard interrupts the server, which ends this process
    limit_library_threads()
    root, handle = sys.argv[1:]
    Answering(Path(root), Connection(int(handle))).run()


class Answering:
    """The work of the process."""

    def __init__(self, root: Path, connection: Connection) -> None:
        self._root, self._connection = root, connection
        self._send_lock = threading.Lock()
        self._open, self._asked, self._was_asked, self._is_prepared = 0, time.monotonic(), False, False
        self._is_compiling = False
        self._input: asyncio.Queue[tuple[Any, ...] | None] = asyncio.Queue()

    def run(self) -> None:
        """Answer until the input ends."""
        asyncio.run(self._serve())
        os._exit(0)  # what libraries do at their end takes a second

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        threading.Thread(target=self._read, args=(loop,), daemon=True).start()
        from models.numerics.jit import notify_first_compilation  # this takes seconds, and the input is read already
        from pipeline.app.open_shots import ShotDesk

        library = ShotLibrary(self._root)
        library.listeners.append(self._announce)
        desk = ShotDesk(library)
        app = build_answers(library, JobQueue(library), desk)
        with notify_first_compilation(lambda: self._note("compiling")):
            tasks = {asyncio.create_task(self._watch(desk))}
            threading.Thread(target=self._prepare, args=(desk, library), daemon=True).start()
            while (question := await self._input.get()) is not None:
                number, kind, *content = question
                if kind == "close":
                    await run_in_threadpool(desk.close_session, *content)
                    self._send(number, None)
                else:  # counted here: a task begins later, and the input may have ended by then
                    self._open, self._asked, self._was_asked = self._open + 1, time.monotonic(), True
                    task = asyncio.create_task(self._answer(app, number, *content))
                    tasks.add(task)
                    task.add_done_callback(tasks.discard)
        while self._open:  # of a process that retires
            await asyncio.sleep(0.05)
        await run_in_threadpool(desk.close)

    def _prepare(self, desk: ShotDesk, library: ShotLibrary) -> None:
        """Load compiled code, or compile it, by what the page will ask about the newest shot."""
        try:
            for shot in islice((card.id for card in library.list_cards() if card.kind == "shot"), PREPARED_FROM):
                with suppress(Refusal, TruerollError):  # a folder that cannot be read is refused when it is asked for
                    opened = desk.open(shot)
                    opened.prepare()
                    opened.prepare_prediction()
                    break
        finally:  # whatever prevents it, such as a full disk, prevents neither answers nor the end
            self._is_prepared, self._asked = True, time.monotonic()
            self._note("")

    def _note(self, preparing: str) -> None:
        """Tell the page what keeps this process from answering at once."""
        self._is_compiling = preparing == "compiling"
        self._send(None, {"type": "preparing", "preparing": preparing})

    def _read(self, loop: asyncio.AbstractEventLoop) -> None:
        """Read the input, in a thread of its own."""
        question: tuple[Any, ...] | None = ()
        while question is not None:
            try:
                question = self._connection.recv()
            except (EOFError, OSError):
                question = None
            loop.call_soon_threadsafe(self._input.put_nowait, question)

    def _send(self, number: int | None, message: MutableMapping[str, Any] | None) -> None:
        with self._send_lock, suppress(OSError):  # the server has died; so does this process
            self._connection.send((number, message))

    def _announce(self, message: dict[str, Any]) -> None:
        """Pass on what concerns a shot; the server sees by itself what else changes."""
        if message["type"] == "shot":
            self._send(None, message)

    async def _answer(self, app: Starlette, number: int, scope: Scope, body: bytes) -> None:
        """Answer one request."""
        parts = [{"type": "http.request", "body": body, "more_body": False}]

        async def receive() -> Message:
            if not parts:
                await asyncio.Event().wait()  # the server decides whether the answer is still wanted
            return parts.pop()

        async def send(message: Message) -> None:
            await run_in_threadpool(self._send, number, dict(message))

        try:
            with suppress(Exception):  # a fault is answered too, and raised again for a log
                await app(scope, receive, send)
        finally:
            self._open, self._asked = self._open - 1, time.monotonic()

    async def _watch(self, desk: ShotDesk) -> None:
        """Ask for a successor once this process is too large, or nobody has asked it anything for long."""
        import psutil

        own = psutil.Process()
        while True:
            await asyncio.sleep(LOOK_S)
            if self._is_compiling and self._is_prepared and not self._open:  # it was for a question
                self._note("")
            quiet = time.monotonic() - self._asked
            is_large = self._was_asked and own.memory_info().rss > RENEWAL_BYTES  # else its successor would be too
            is_at_rest = self._is_prepared and not self._open and quiet > (QUIET_S if is_large else IDLE_S)
            if is_at_rest and desk.can_be_closed:
                self._send(None, {"type": "retire", "is_large": is_large})
                return
