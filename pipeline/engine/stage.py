"""A stage: a named step with options, inputs from other stages, and one output."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from models.core.progress import Progress

Inputs = Mapping[str, Any]
"""By stage name: the value that the stage made, or the folder of its files."""


@dataclass(frozen=True, slots=True)
class Stage:
    """One step of the chain.

    `run(inputs, options, folder, progress)` returns a value of type `output`, which is saved for it, or writes its
    files into `folder` and returns None where `output` is None. It must depend on nothing else.
    """

    name: str
    module: str
    """Where its code begins: everything of the project imported from there is part of its key."""
    needs: tuple[str, ...]
    output: type | None
    run: Callable[[Inputs, Any, Path, Progress], Any]
    options: Any
    """A frozen dataclass of plain values."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What else the result depends on, such as the digest of the clip; JSON-able."""

    @property
    def settings(self) -> dict[str, Any]:
        """Options as JSON-able values."""
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self.options).items()}
