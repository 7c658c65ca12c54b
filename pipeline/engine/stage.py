"""A stage: a named step with options, inputs from other stages, and one output."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from models.core.progress import Progress

# By stage name: the output value of the stage, or the folder of its files.
Inputs = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class NoOptions:
    """Options of a stage without options."""


def describe_facts(value: Any) -> dict[str, Any]:
    """Describe what a stage depends on, a dataclass, as JSON values by name; what is not set is left out of its key."""
    return {name: part for name, part in asdict(value).items() if part}


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of the chain.

    `run(inputs, options, folder, progress)` returns a value of type `output`, which the graph saves. Where `output` is
    None, it writes files into `folder` and returns None. Its result must depend only on these arguments and `facts`.
    """

    name: str
    module: str
    """Module of its code. The sources of all project modules that it imports are part of the cache key."""
    needs: tuple[str, ...]
    output: type | None
    run: Callable[[Inputs, Any, Path, Progress], Any]
    options: Any
    """A frozen dataclass of plain values."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What else the result depends on, such as the digest of the clip, as JSON values."""
    adapt: Callable[[Any], Any] | None = None
    """Adds to a loaded output what no entry of the cache can hold, such as the present path of the clip."""

    @property
    def json_options(self) -> dict[str, Any]:
        """The options as JSON values, by name."""
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self.options).items()}
