"""Files to train on that are held in memory, one exchanged for another every so many steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

STEPS_PER_FILE = 50


@dataclass(slots=True)
class Shelf(Generic[T]):
    """The files that a step is drawn from: the same whenever it is asked, after an interruption too."""

    read: Callable[[int, int], T]
    """What is held of a file, by its number and by how many were taken before it."""
    files: int
    """How many there are; then they begin anew."""
    room: int
    held: list[T] = field(default_factory=list)

    def at(self, step: int) -> list[T]:
        """What is held in a step; steps come in order, but for the first one that is asked."""
        turn = step // STEPS_PER_FILE
        if not self.held:
            self._take(range(max(turn - self.room + 1, 0), turn + 1))
        elif step % STEPS_PER_FILE == 0:
            self._take(range(turn, turn + 1))
        return self.held

    def _take(self, turns: range) -> None:
        self.held.extend(self.read(turn % self.files, turn) for turn in turns)
        del self.held[: -self.room]
