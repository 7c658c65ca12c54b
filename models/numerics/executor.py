"""Who works through jobs on one subject, such as the shots of a fit; who did what changes no bit of the results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

Work = Callable[..., Any]
"""Function of a module, of a subject and a job's arguments; all that it takes and gives can go to another process."""


class Crew(Protocol):
    """Who works."""

    def each(self, subject: Any, work: Work, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
        """`work(subject, *job)` of all jobs, in their order."""
        ...


class Alone:
    """This process, and no other."""

    def each(self, subject: Any, work: Work, jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
        return [work(subject, *job) for job in jobs]


ALONE = Alone()
