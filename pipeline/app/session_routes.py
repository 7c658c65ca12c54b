"""Answers about sessions for the page."""

from __future__ import annotations

from starlette.routing import BaseRoute

from pipeline.app.job_queue import JobQueue
from pipeline.app.shot_library import ShotLibrary


def build_routes(library: ShotLibrary, queue: JobQueue) -> list[BaseRoute]:
    """Build the routes below `api`."""
    return []
