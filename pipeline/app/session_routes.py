"""Sessions of several shots: the commands that compare, certify or diagnose them, run by the queue."""

from __future__ import annotations

import threading
from datetime import date
from itertools import count
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from pipeline.actions.compare_session import GROUPINGS
from pipeline.app.job_queue import JobQueue
from pipeline.app.refusals import Refusal, read_json_body
from pipeline.app.shot_library import SESSION_FOLDER, SESSION_NAMES, ShotLibrary
from pipeline.io.simulators.pooltool_simulator import POOLTOOL_NAME

# Values of a command that a page may choose, with the option of the command.
CHOICES: dict[str, dict[str, tuple[str, ...]]] = {
    "compare": {"group": GROUPINGS}, "certify": {}, "diagnose": {"simulator": (POOLTOOL_NAME,)}
}  # fmt: skip


def build_routes(library: ShotLibrary, queue: JobQueue) -> list[BaseRoute]:
    """Build the routes below `api`."""
    return [Route("/sessions", SessionHandlers(library, queue).start, methods=["POST"])]


class SessionHandlers:
    """Handlers of sessions."""

    def __init__(self, library: ShotLibrary, queue: JobQueue) -> None:
        self._library, self._queue = library, queue
        self._lock = threading.Lock()

    async def start(self, request: Request) -> Response:
        """Put a command on several shots into the queue."""
        return JSONResponse({"job": await run_in_threadpool(self._start, await read_json_body(request))})

    def _start(self, body: dict[str, Any]) -> dict[str, Any]:
        action, shots = body.get("action"), body.get("shots")
        if not isinstance(action, str) or action not in SESSION_NAMES:
            raise Refusal(422, f"action is one of {', '.join(SESSION_NAMES)}.")
        if not isinstance(shots, list) or not shots or not all(isinstance(shot, str) for shot in shots):
            raise Refusal(422, "Choose at least one shot.")
        folders = [self._library.find_folder(shot) for shot in dict.fromkeys(shots)]
        arguments = [action, *map(str, folders)]
        for name, values in CHOICES[action].items():
            if (value := body.get(name)) is not None:
                if value not in values:
                    raise Refusal(422, f"{name} is one of {', '.join(values)}.")
                arguments += [f"--{name}", value]
        with self._lock:
            folder = self._reserve_folder(action)
        name = f"{SESSION_NAMES[action]} of {len(folders)} shot{'s' * (len(folders) != 1)}"
        return self._queue.add_command(name, [*arguments, "-o", str(folder)], folder)

    def _reserve_folder(self, action: str) -> Path:
        """Make a new folder for the results."""
        home = self._library.root / SESSION_FOLDER
        names = (home / f"{action}-{date.today().isoformat()}-{k}" for k in count(1))
        folder = next(one for one in names if not one.exists())
        folder.mkdir(parents=True)
        return folder
