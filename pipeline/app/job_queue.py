"""The queue of clips and commands."""

from __future__ import annotations

from typing import Any

from pipeline.app.shot_library import ShotLibrary


class JobQueue:
    """The queue of one library."""

    def __init__(self, library: ShotLibrary) -> None:
        self._library = library

    def start(self) -> None:
        """Start to work on the queue."""

    def close(self) -> None:
        """Stop the work; what is not done is taken up again at the next start."""

    def describe(self) -> list[dict[str, Any]]:
        """Describe all jobs for the page."""
        return []
