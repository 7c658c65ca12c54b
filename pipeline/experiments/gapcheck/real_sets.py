"""Sets of real shots with sealed answers: each is diagnosed, and only then its answer is opened.

A folder of sets holds one track folder per set, and `answers.json`: for each name of a track folder `accepted`, a list
of the sets of effects that are a right answer. An empty set accepts that nothing is named (`none` or `undecidable`),
`["unknown"]` that verdict. Further keys, such as `source`, are free.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.errors import OptionError, TruerollError
from models.numerics.executor import SERIAL, Executor
from pipeline.experiments.gapcheck.measured_cases import write_measured_sets
from pipeline.io.gap_files import write_gap_files
from pipeline.io.track_folder import TrackFolder, read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

ANSWERS_FILE = "answers.json"
CERTAIN = 0.995
"""Probability that a table of two decimals rounds to 1."""
MOST_OF_GAP = 0.9
"""Closed part of the gap from which `unknown` cannot be certain."""


class SealedAnswer(BaseModel):
    """The answers to one set that are right."""

    model_config = ConfigDict(extra="allow")
    accepted: list[list[str]]


@dataclass(frozen=True, slots=True)
class RealSet:
    """A track folder of real shots, whose answer is sealed."""

    name: str
    folder: Path
    answers: Path
    """File with the answer under `name`."""


@dataclass(frozen=True, slots=True)
class OpenedSet:
    """A set whose answer was opened after its report was written."""

    name: str
    unreadable: str = ""
    """Why the set could not be diagnosed; empty where it was."""
    shots: int = 0
    verdict: str = ""
    named: tuple[str, ...] = ()
    """Named effects or the group, the first one first; the verdict where none is named."""
    probability: float = np.nan
    """Probability of the answer."""
    right: bool = False
    """Whether the effects, or each one of a group, are one of the accepted sets."""
    first_right: bool | None = None
    """Whether the first named effect is in an accepted set; None where none is named."""
    shares: dict[str, float] = field(default_factory=dict)
    """Closed part of the gap by effect: of the named ones, otherwise of the best one."""
    closed: float = np.nan
    """Closed part of the gap, also where the verdict is `unknown`; NaN where it is not resolved."""
    before: float = np.nan
    """rms prediction error on hold-out shots, in `unit`."""
    after: float = np.nan
    floor: float = np.nan
    unit: str = ""
    """m or rad."""
    seconds: float = np.nan
    """Duration of the diagnosis, s."""

    @property
    def is_falsely_certain(self) -> bool:
        """Whether `unknown` is certain although named effects close most of the gap."""
        return self.verdict == "unknown" and self.probability >= CERTAIN and self.closed >= MOST_OF_GAP


def list_real_sets(folder: Path, scratch: Path) -> list[RealSet]:
    """List the sets in a folder.

    Args:
        folder: Folder with answers.json and one track folder per set, or with the public measurements of
            `measured_cases`.
        scratch: Folder in which track folders of public measurements are written.

    Returns:
        The sets, in the order of answers.json.

    Raises:
        OptionError: The folder holds neither, or its answers cannot be read.
    """
    if not (folder / ANSWERS_FILE).is_file():
        answers = write_measured_sets(folder, scratch)
        if not answers:
            raise OptionError(f"{folder} holds neither {ANSWERS_FILE} nor one of the public measurements")
        folder = scratch
        (folder / ANSWERS_FILE).write_text(json.dumps(answers, indent=1), encoding="utf-8")
    path = folder / ANSWERS_FILE
    return [RealSet(name, folder / name, path) for name in _read_answers(path)]


def diagnose_real_set(one: RealSet, report_folder: Path, seed: int = 0, executor: Executor = SERIAL) -> OpenedSet:
    """Diagnose a set, write its report, and only then open its answer.

    Args:
        one: The set.
        report_folder: Folder of the report.
        seed: Random seed of the diagnosis.
        executor: Distributes the fits over processes; it does not change the report.

    Returns:
        The opened set; `unreadable` where it cannot be diagnosed.
    """
    start = time.perf_counter()
    try:
        read = read_track_folders([one.folder])
        report = diagnose(build_gap_scene(read), read.recordings, seed, executor=executor)
    except TruerollError as error:
        return OpenedSet(one.name, str(error))
    seconds = time.perf_counter() - start
    write_gap_files(report, report_folder)
    return open_answer(one, read, report, seconds)


def open_answer(one: RealSet, read: TrackFolder, report: DiagnosisReport, seconds: float = np.nan) -> OpenedSet:
    """Compare a report with the sealed answer of its set.

    Args:
        one: The set.
        read: Its track folder.
        report: Its report.
        seconds: Duration of the diagnosis, s.

    Returns:
        The opened set.

    Raises:
        OptionError: The answers cannot be read.
    """
    accepted = read_accepted_answers(one)
    names = report.candidates[0].group if report.verdict == "group" else report.effects
    closure = report.gap.closure
    return OpenedSet(
        one.name,
        shots=len(read.recordings),
        verdict=report.verdict,
        named=names or (report.verdict,),
        probability=report.probability,
        right=all(answer in accepted for answer in _list_answers(report)),
        first_right=names[0] in frozenset[str]().union(*accepted) if names else None,
        shares={share.effect: share.closed for share in report.per_effect},
        closed=closure.closed if closure.resolved else np.nan,
        before=closure.before,
        after=closure.after,
        floor=closure.floor,
        unit="rad" if report.gap.metric.endswith("rad") else "m",
        seconds=seconds,
    )


def read_accepted_answers(one: RealSet) -> set[frozenset[str]]:
    """Read the sets of effects that are a right answer.

    Args:
        one: The set.

    Returns:
        The accepted sets of effects.

    Raises:
        OptionError: The answers cannot be read.
    """
    return {frozenset(names) for names in _read_answers(one.answers)[one.name].accepted}


def _list_answers(report: DiagnosisReport) -> Iterator[frozenset[str]]:
    """Yield the sets of effects of which a report says that one acts; several for a group."""
    if report.verdict == "group":
        yield from (frozenset({name}) for name in report.candidates[0].group)
    else:
        yield frozenset({"unknown"} if report.verdict == "unknown" else report.effects)


def _read_answers(path: Path) -> dict[str, SealedAnswer]:
    """Read answers.json; raise an OptionError if it is not a table of answers."""
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
        return TypeAdapter(dict[str, SealedAnswer]).validate_python(content)
    except OSError as error:
        raise OptionError(f"{path} cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise OptionError(f"{path} is not JSON: {error}") from error
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in mistake["loc"])
        raise OptionError(
            f'{path}: {place}: {mistake["msg"][:1].lower()}{mistake["msg"][1:]}; each set needs {{"accepted": [[EFFECT,'
            " ...], ...]}"
        ) from error
