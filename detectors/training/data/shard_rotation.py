"""Rotation of the training files in memory: one is replaced by another every 50 steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")

STEPS_PER_SHARD = 50
"""Steps after which the next file is read."""


@dataclass(slots=True)
class ShardRotation(Generic[T]):
    """The shards from which the samples of a step are drawn; after an interruption they are the same."""

    read: Callable[[int, int], T]
    """Reads a shard, by its number and by the number of shards read before it."""
    files: int
    """Number of files; then they repeat."""
    capacity: int
    """Number of shards in memory."""
    shards: list[T] = field(default_factory=list)

    def shards_at(self, step: int) -> list[T]:
        """Read the shards of a step; calls after the first one must be in the order of the steps."""
        turn = step // STEPS_PER_SHARD
        if not self.shards:
            self._read_turns(range(max(turn - self.capacity + 1, 0), turn + 1))
        elif step % STEPS_PER_SHARD == 0:
            self._read_turns(range(turn, turn + 1))
        return self.shards

    def _read_turns(self, turns: range) -> None:
        self.shards.extend(self.read(turn % self.files, turn) for turn in turns)
        del self.shards[: -self.capacity]
