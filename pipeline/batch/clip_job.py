"""One clip of a batch as words and numbers that any machine can read, and how it went."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from pipeline.options import RunOptions, collect, run_settings
from pipeline.reporting.text.sentences import told

TRIES = 3
"""How often a clip is begun whose process dies without having been told to: once is bad luck, thrice is the clip."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What one clip may take; of a long recording, each of its shots."""

    seconds: float = 3600.0
    """s of wall-clock time."""
    megabytes: float = 4096.0
    """Resident memory of the process that runs it, MB."""

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.megabytes > 0):
            raise ValueError(f"limits are above 0; got {self.seconds} s and {self.megabytes} MB")


@dataclass(frozen=True, slots=True)
class Job:
    """One clip to run."""

    clip: str
    """Its path, absolute."""
    name: str
    """Its path below the folder of the batch, as it is told."""
    folder: str
    """Where its results go."""
    cache: str
    """Folder of the cache."""
    mark: str
    """What the cache is recognised by: a folder of the same name elsewhere is another one."""
    settings: Mapping[str, Any]
    """The options of all stages, by the name of the setting."""
    limits: Limits = Limits()

    @property
    def options(self) -> RunOptions:
        """The options of all stages."""
        return collect(dict(self.settings))

    def as_text(self) -> str:
        """JSON, in one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> Job:
        """Read back what `as_text` wrote."""
        parts = json.loads(text)
        return cls(**{**parts, "limits": Limits(**parts["limits"])})


def settings_of(options: RunOptions) -> dict[str, Any]:
    """The values of all settings, JSON-able."""
    return {name: getattr(getattr(options, one.parts[0]), name) for name, one in run_settings().items()}


@dataclass(frozen=True, slots=True)
class Row:
    """How one clip of a batch went."""

    clip: str
    """Path below the folder."""
    status: Literal["done", "failed"]
    trust: str
    """green, amber or red; the worst of its shots."""
    contacts: int
    seconds_in: float
    """s of the clip with its last event; 0 where nothing happened"""
    folder: str
    sentence: str
    """Why it failed, empty else."""
    shots: int = 1
    """How many could be used."""
    in_shots: bool = False
    """Whether it was cut into shots, with a folder each."""
    seconds: float = 0.0
    """s that it took this time"""
    peak_mb: float = 0.0
    """Largest resident memory of its process, MB."""
    tries: int = 1
    """How often it was begun."""
    cached: bool = False
    """Whether all of it was there already."""

    def as_text(self) -> str:
        """JSON, in one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> Row:
        """Read back what `as_text` wrote."""
        return cls(**json.loads(text))


def failed(name: str, sentence: str, **facts: Any) -> Row:
    """The row of a clip that could not be used."""
    return replace(Row(name, "failed", "", 0, 0.0, "", told(sentence), shots=0), **facts)


def seconds_told(seconds: float) -> str:
    """A stretch of time as one would say it."""
    return f"{seconds:.3g} s" if seconds < 120 or math.isinf(seconds) else f"{seconds / 60:.3g} min"
