"""Answers about one shot for the page."""

from __future__ import annotations

from starlette.routing import BaseRoute

from pipeline.app.shot_library import ShotLibrary


def build_routes(library: ShotLibrary) -> list[BaseRoute]:
    """Build the routes below `api`."""
    return []
