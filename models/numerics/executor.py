"""The interface of executors: they run one function on many sets of arguments that share a subject.

How tasks are spread over processes changes no bit of the results. `pipeline.engine.helper_executor` has an executor
with two processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

# A module-level function of a subject and the arguments of one task. Its arguments and its result can be pickled.
TaskFunction = Callable[..., Any]


class Executor(Protocol):
    """Runs independent tasks, in this process or in several."""

    def map_tasks(self, subject: Any, function: TaskFunction, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Evaluate `function(subject, *one)` for every `one` in `arguments`.

        Args:
            subject: What all tasks share, e.g. the recordings of a fit. It is sent to another process only when it is
                another object than in the previous call.
            function: Function of a module.
            arguments: One tuple per task.

        Returns:
            One result per task, in the order of `arguments`.
        """


class SerialExecutor:
    """Runs all tasks in this process, one after another."""

    def map_tasks(self, subject: Any, function: TaskFunction, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """Evaluate `function(subject, *one)` for every `one` in `arguments`."""
        return [function(subject, *one) for one in arguments]


# The executor of calls that name no other.
SERIAL = SerialExecutor()
