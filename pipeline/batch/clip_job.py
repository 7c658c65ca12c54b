"""A clip of a batch and its result, as plain values that can be sent to another machine as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from pipeline.reporting.text.text_formatting import escape_text

if TYPE_CHECKING:
    from pipeline.run_options import RunOptions

# Attempts for a clip whose process dies unexpectedly. Three deaths in a row are taken as a fault of the clip.
MAX_TRIES = 3


@dataclass(frozen=True, slots=True)
class ClipLimits:
    """Limits of one clip, or of each shot of a long recording."""

    seconds: float = 3600.0
    """Wall-clock time, s."""
    megabytes: float = 4096.0
    """Resident memory of the process that runs it, MB."""

    def __post_init__(self) -> None:
        if not (self.seconds > 0 and self.megabytes > 0):
            raise ValueError(f"limits are above 0; got {self.seconds} s and {self.megabytes} MB")


@dataclass(frozen=True, slots=True)
class ClipJob:
    """One clip to run."""

    clip: str
    """Absolute path."""
    name: str
    """Path below the folder of the batch, as it is printed."""
    folder: str
    """Folder of the results."""
    cache: str
    """Folder of the cache."""
    mark: str
    """Mark of the cache: a folder of the same name on another machine may be another cache."""
    settings: Mapping[str, Any]
    """Values of all settings by name."""
    limits: ClipLimits = ClipLimits()
    preview: str = ""
    """JPEG file that shows a frame with what is found in it so far, for who follows the run; empty for none."""
    for_page: bool = False
    """Whether the page shows the result, which has no options, instead of a command."""

    @property
    def options(self) -> RunOptions:
        """The options of all stages, built from the settings."""
        from pipeline.run_options import build_options  # slow to import, and only the process of the clip needs it

        return build_options(dict(self.settings))

    def to_json(self) -> str:
        """Format the job as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> ClipJob:
        """Parse a job that `to_json` formatted."""
        parts = json.loads(text)
        return cls(**{**parts, "limits": ClipLimits(**parts["limits"])})


@dataclass(frozen=True, slots=True)
class ClipResult:
    """Result of one clip of a batch: a row of summary.csv."""

    clip: str
    """Path below the folder of the batch."""
    status: Literal["done", "failed"]
    trust: str
    """Trust level: green, amber or red; the worst of its shots. Empty if it failed."""
    contacts: int
    seconds_in: float
    """Time of the last event in the clip, s; 0 without events."""
    folder: str
    sentence: str
    """Why the clip or some of its shots failed; else empty."""
    shots: int = 1
    """Number of usable shots."""
    in_shots: bool = False
    """Whether the clip was split into shots, with a folder each."""
    seconds: float = 0.0
    """Wall-clock time of this run, s."""
    compiling: float = 0.0
    """Part of it in which numerical code was compiled, s; only the first clips on a machine need any."""
    peak_mb: float = 0.0
    """Largest resident memory of its process, MB."""
    tries: int = 1
    """Number of attempts."""
    cached: bool = False
    """Whether all stages were cached."""
    remedy: str = ""
    """What a person could do about a failure, a name in `COMMAND_REMEDIES`; empty for nothing."""

    def to_json(self) -> str:
        """Format the result as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> ClipResult:
        """Parse a result that `to_json` formatted."""
        return cls(**json.loads(text))


def build_failed_result(name: str, sentence: str, **facts: Any) -> ClipResult:
    """Build the result of a clip that failed."""
    return replace(ClipResult(name, "failed", "", 0, 0.0, "", escape_text(sentence), shots=0), **facts)


def format_duration(seconds: float) -> str:
    """Format a duration in seconds or minutes."""
    return f"{seconds:.3g} s" if seconds < 120 or math.isinf(seconds) else f"{seconds / 60:.3g} min"


# Clips to run. None means that there is none now, but more may come.
JobStream = Iterator[ClipJob | None]
# Called with the name of a clip and a progress message; see `clip_runner`.
ProgressListener = Callable[[str, dict[str, Any]], None]
# Runs clips and yields each result when its clip is done.
ClipRunner = Callable[[JobStream, ProgressListener], Iterator[ClipResult]]
