"""The process that answers questions about shots: the server stays small, and nobody notices when it is replaced."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import time
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest
from support.app_processes import LONGEST_S, RunningApp, run_app
from support.app_requests import Visitor
from support.carom_start import Home

from pipeline.app import answer_process
from pipeline.app.answer_process import Answering, AnswerProcess
from pipeline.app.app_server import build_app

SHOTS = 8
SERVER_BYTES, GROWTH_BYTES = 130e6, 10e6
"""Resident memory of the server, and by how much all questions may increase it."""


@pytest.mark.parametrize(
    ("is_large", "was_asked", "quiet_s", "can_be_closed", "retires"),
    [
        (True, True, 10.0, True, True),
        (True, False, 10.0, True, False),
        (True, True, 0.0, True, False),
        (True, True, 10.0, False, False),
        (False, True, 10.0, True, False),
        (False, True, 1e6, True, True),
        (False, True, 1e6, False, False),
    ],
    ids=[
        "large",
        "as large as any",
        "asked just now",
        "undo would be lost",
        "small",
        "idle",
        "idle, but undo would be lost",
    ],
)
def test_a_process_retires_when_it_is_large_or_idle_and_nobody_loses_anything(
    is_large: bool,
    was_asked: bool,
    quiet_s: float,
    can_be_closed: bool,
    retires: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(answer_process, "RENEWAL_BYTES", 0 if is_large else 1e15)
    monkeypatch.setattr(answer_process, "LOOK_S", 0.01)
    server, child = Pipe()

    async def watch() -> None:
        answering = Answering(Path(), child)
        answering._asked, answering._is_prepared = time.monotonic() - quiet_s, True
        answering._was_asked = was_asked
        desk: Any = SimpleNamespace(can_be_closed=can_be_closed)
        await asyncio.wait_for(answering._watch(desk), 0.2)

    if retires:
        asyncio.run(watch())
        assert server.recv() == (None, {"type": "retire", "is_large": is_large})
    else:
        with pytest.raises(TimeoutError):
            asyncio.run(watch())
        assert not server.poll()


@pytest.mark.parametrize(("is_prepared", "open_questions"), [(True, 0), (True, 1), (False, 0)])
def test_the_note_of_a_compilation_ends_with_the_question_that_needs_it(
    is_prepared: bool, open_questions: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answer_process, "LOOK_S", 0.01)
    server, child = Pipe()

    async def watch() -> None:
        answering = Answering(Path(), child)
        answering._is_prepared, answering._open = is_prepared, open_questions
        answering._note("compiling")
        desk: Any = SimpleNamespace(can_be_closed=True)
        await asyncio.wait_for(answering._watch(desk), 0.2)

    with pytest.raises(TimeoutError):
        asyncio.run(watch())
    child.close()
    notes = [server.recv()[1]["preparing"]]
    while server.poll():
        try:
            notes.append(server.recv()[1]["preparing"])
        except EOFError:
            break
    assert notes == ["compiling", *([""] if is_prepared and not open_questions else [])]


def test_a_process_that_could_not_be_prepared_answers_and_retires_all_the_same() -> None:
    server, child = Pipe()

    def list_cards() -> list[Any]:
        raise OSError(28, "No space left on device")

    async def prepare() -> None:
        answering, desk = Answering(Path(), child), Any
        library: Any = SimpleNamespace(list_cards=list_cards)
        with pytest.raises(OSError, match="No space"):
            answering._prepare(desk, library)  # type: ignore[arg-type]
        assert answering._is_prepared

    asyncio.run(prepare())
    assert server.recv() == (None, {"type": "preparing", "preparing": ""})


def test_a_question_is_answered_though_the_input_ends_right_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[Any]()

    async def app(scope: Any, *_: Any) -> None:
        await asyncio.sleep(0.01)
        asked.append(scope)

    async def serve() -> None:
        answering = Answering(tmp_path, Pipe()[1])

        def put() -> None:
            answering._input.put_nowait((0, "answer", "a question", b""))
            answering._input.put_nowait(None)

        monkeypatch.setattr(answering, "_read", lambda loop: loop.call_soon_threadsafe(put))
        await answering._serve()

    monkeypatch.setattr(answer_process, "build_answers", lambda *_: app)
    asyncio.run(serve())
    assert asked == ["a question"]


@pytest.mark.slow
def test_a_process_that_has_grown_is_replaced_and_every_question_is_answered(
    home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []

    def start(command: list[str], **settings: Any) -> subprocess.Popen[bytes]:
        module, small = "pipeline.app.answer_process", "one.RENEWAL_BYTES, one.QUIET_S, one.LOOK_S = 0, 0.2, 0.1"
        code = command[2].partition("from ")[0] + f"import {module} as one; {small}; one.main()"
        started.append(Popen([*command[:2], code, *command[3:]], **settings))
        return started[-1]

    Popen = subprocess.Popen
    monkeypatch.setattr(answer_process.subprocess, "Popen", start)
    monkeypatch.setenv("TRUEROLL_CACHE", str(home.cache))
    shutil.copytree(home.out, tmp_path / "library" / "shot")
    visitor = Visitor(tmp_path / "library")
    visitor.library.listeners.append(lambda _: None)  # a page is open
    answers = AnswerProcess(visitor.library)
    visitor.app = build_app(visitor.library, visitor.queue, visitor.keys, answers)
    (card,) = visitor.library.list_cards()
    end = time.monotonic() + LONGEST_S
    while len(started) < 3 and time.monotonic() < end:
        reply = visitor.ask("POST", f"api/shots/{card.id}/ask", {"question": "first"})
        assert reply.status == 200, reply.body
        time.sleep(0.5)
    assert len(started) >= 3
    assert started[0].wait(LONGEST_S) == 0, "it has ended by itself"
    for close in visitor.library.closers:
        close()
    assert all(one.poll() is not None for one in started)


def find_answers(app: RunningApp) -> psutil.Process:
    """Wait for the process that answers questions."""
    end = time.monotonic() + LONGEST_S
    while (child := app.find_child("answer_process")) is None and time.monotonic() < end:
        time.sleep(0.1)
    assert child is not None
    return child


@pytest.mark.slow
def test_the_server_stays_small_whatever_is_asked_and_outlives_what_answers(home: Home, tmp_path: Path) -> None:
    library = tmp_path / "library"
    for number in range(SHOTS):
        shutil.copytree(home.out, library / f"shot {number}")
    with run_app(library, home.cache) as app:
        cards = app.ask("GET", "api/library")[1]["shots"]
        server, before = psutil.Process(app.process.pid), 0
        for card in cards:
            place, own = f"api/shots/{card['id']}", dict[str, Any]()
            assert app.ask("GET", place)[1]["name"] == card["name"]
            for path, body in (("ask", {"question": "first"}), ("what-if", {"speed_percent": 3}), ("share", own)):
                status, answer = app.ask("POST", f"{place}/{path}", json.dumps(body).encode())
                assert status == 200, answer
            before = before or server.memory_info().rss
        assert len(cards) == SHOTS
        assert server.memory_info().rss < min(SERVER_BYTES, before + GROWTH_BYTES)
        first = find_answers(app)
        assert first.memory_info().rss > SERVER_BYTES, "this is where the memory is"
        first.kill()
        first.wait()
        status, answer = app.ask("POST", f"{place}/ask", b'{"question": "first"}')
        assert (status, find_answers(app).pid == first.pid) == (200, False), answer
        assert app.ask("DELETE", place)[0] == 200
        last = find_answers(app)
    psutil.wait_procs([last], LONGEST_S)
    assert not last.is_running()
