"""Sets of real shots with sealed answers: each is diagnosed, and only then its answer is opened.

A folder of sets holds one track folder per set, and `answers.json`: for each name of a track folder `accepted`, a list
of the sets of effects that are a right answer. An empty set accepts that nothing is named (`none` or `undecidable`),
`["unknown"]` that verdict. Further keys, such as `source`, are free.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from diagnosis.diagnose import diagnose
from models.core.errors import OptionError, TruerollError
from models.core.typing import FloatArray
from models.numerics.executor import SERIAL, Executor
from pipeline.io.gap_files import write_gap_files
from pipeline.io.strict_json import format_first_error, read_json
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

ANSWERS_FILE = "answers.json"
# Probability that a table of two decimals rounds to 1.
CERTAIN = 0.995
# Closed part of the gap from which `unknown` cannot be certain.
MOST_OF_GAP = 0.9


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
        seed: Random seed of the diagnosis.
        executor: Distributes the fits over processes; it does not change the report.

    Returns:
        The opened set; `unreadable` where it cannot be diagnosed.

    Raises:
        OptionError: The answers cannot be read.
    """
    start = time.perf_counter()
    try:
        read = read_track_folders([one.folder])
        report = diagnose(build_gap_scene(read), read.recordings, seed, executor=executor)
    except TruerollError as error:
        return OpenedSet(one.name, str(error))
    seconds = time.perf_counter() - start
    write_gap_files(report, report_folder)
    accepted = read_accepted_answers(one)
    names, closure = report.effects, report.gap.closure
    # sets of effects of which the report says that one acts; several for a group
    answers = [frozenset({"unknown"} if report.verdict == "unknown" else names)]
    if report.verdict == "group":
        names = report.candidates[0].group
        answers = [frozenset({name}) for name in names]
    return OpenedSet(
        one.name,
        shots=len(read.recordings),
        verdict=report.verdict,
        named=names or (report.verdict,),
        probability=report.probability,
        right=all(answer in accepted for answer in answers),
        first_right=names[0] in frozenset[str]().union(*accepted) if names else None,
        shares={share.effect: share.closed for share in report.per_effect},
        closed=closure.closed if closure.resolved else np.nan,
        before=closure.before,
        after=closure.after,
        floor=closure.floor,
        unit=report.gap.unit,
        seconds=seconds,
    )


def read_accepted_answers(one: RealSet) -> set[frozenset[str]]:
    """Read the sets of effects that are a right answer to a set of shots; only after its report is written."""
    return {frozenset(names) for names in _read_answers(one.answers)[one.name].accepted}


def _read_answers(path: Path) -> dict[str, SealedAnswer]:
    """Read answers.json; raise an OptionError if it is not a table of answers."""
    try:
        return TypeAdapter(dict[str, SealedAnswer]).validate_python(read_json(path, "Real sets have answers"))
    except ValidationError as error:
        remedy = 'each set needs {"accepted": [[EFFECT, ...], ...]}'
        raise OptionError(f"{path}: {format_first_error(error)}; {remedy}") from error


# Frames (T,), times (T,) s, coordinates (T, D).
Shot = tuple[NDArray[np.int64], FloatArray, FloatArray]

# Half of the edge, m; sampling rate, Hz.
CUBE_HALF, CUBE_HZ = 0.0524, 148.0
# Limits where the cube slides: height m, vertical speed m/s, spin rad/s; it moves from the last one on, m/s.
FLAT, CLIMBING, TURNING, MOVING = 0.002, 0.05, 1.0, 0.08
# Frame rate, Hz; resolution, px/m.
SHUTTLE_HZ, SHUTTLE_PX_PER_M = 60.0, 159.0
# Every so many of 200 samples per second are used; duration of a swing, s.
PENDULUM_EVERY, PENDULUM_SECONDS = 4, 2.5
# Least number of frames of a shot; largest number of shots of a set.
MIN_FRAMES, MAX_SHOTS = 20, 24


@dataclass(frozen=True, slots=True)
class MeasuredSet:
    """A set of shots, and the effects that a simulator without any effect may lack there."""

    name: str
    scene: str
    columns: tuple[str, ...]
    accepted: tuple[tuple[str, ...], ...]
    """Sets of effects that are a right answer; an empty one: nothing is named."""
    read: Callable[[Path], list[Shot]]
    facts: Mapping[str, object]


def _read_cube(folder: Path) -> list[Shot]:
    """Read the sliding part of each toss of a cube."""
    shots = []
    with np.load(folder / "contactnets_cube" / "cube_tosses_SI_64.npz", allow_pickle=False) as tosses:
        for name in tosses.files:
            toss = tosses[name]
            if toss.ndim != 2:
                continue
            sliding = (np.abs(toss[:, 2] - CUBE_HALF) < FLAT) & (np.abs(toss[:, 9]) < CLIMBING)
            sliding &= (np.linalg.norm(toss[:, 10:13], axis=1) < TURNING) & (np.hypot(toss[:, 7], toss[:, 8]) > MOVING)
            rows = np.flatnonzero(sliding)
            runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
            longest = max(runs, key=len)
            if len(longest) >= MIN_FRAMES:
                frames = np.arange(len(longest))
                shots.append((frames, frames / CUBE_HZ, toss[longest, :2].astype(np.float64)))
    return shots


def _read_shuttlecocks(folder: Path) -> list[Shot]:
    """Read the flights of shuttlecocks."""
    table = csv.read_csv(folder / "badminton_morishita" / "shuttle_tracks_px.csv")
    session = np.array([str(value) for value in table.column("session").to_pylist()])
    shot, frame, x, y = (table.column(name).to_numpy().astype(np.float64) for name in ("shot", "frame", "x_px", "y_px"))
    shots = []
    for one, number in sorted(set(zip(session.tolist(), shot.tolist(), strict=True))):
        rows = np.flatnonzero((session == one) & (shot == number))
        rows = rows[np.diff(frame[rows], prepend=-1) > 0]
        places = np.stack([x[rows], -y[rows]], axis=1) / SHUTTLE_PX_PER_M
        if places[-1, 0] < places[0, 0]:
            places[:, 0] *= -1
        if len(rows) >= MIN_FRAMES:
            shots.append((frame[rows].astype(np.int64), frame[rows] / SHUTTLE_HZ, places))
    return shots


def _read_pendulum(folder: Path, file: str, columns: tuple[str, ...]) -> list[Shot]:
    """Read a recorded swing, split into shots."""
    with np.load(folder / "multiarm_pendulum" / file, allow_pickle=False) as swing:
        t = np.ravel(swing["t"])[::PENDULUM_EVERY]
        angles = np.stack([np.ravel(swing[name])[::PENDULUM_EVERY] for name in columns], axis=1) - np.pi
    long = round(PENDULUM_SECONDS / float(np.median(np.diff(t))))
    starts = range(0, len(t) - long, long)
    return [(np.arange(long), t[s : s + long] - t[s], angles[s : s + long]) for s in starts]


def _read_drops(folder: Path, wanted: Callable[[str], bool]) -> list[Shot]:
    """Read the drops of the balls whose name is `wanted`."""
    table = csv.read_csv(folder / "falling_balls" / "ball_drops.csv")
    ball = np.array([str(value) for value in table.column("ball").to_pylist()])
    drop, t, height = (table.column(name).to_numpy().astype(np.float64) for name in ("drop", "t", "h"))
    shots = []
    for name, number in sorted(set(zip(ball.tolist(), drop.tolist(), strict=True))):
        rows = np.flatnonzero((ball == name) & (drop == number))
        if wanted(name.lower()) and len(rows):
            shots.append((np.arange(len(rows)), t[rows], height[rows, None]))
    return shots


_DRAG = (("air_drag",), ("viscous_drag", "air_drag"))
_JOINT = (("joint_friction",), ("joint_friction", "gravity_tilt"))
MEASURED_SETS = (
    MeasuredSet(
        "sliding_cube", "slide", ("x", "y"), (("sliding_friction",), ("sliding_friction", "slope")), _read_cube, {}
    ),
    MeasuredSet("shuttlecock", "flight", ("x", "y"), _DRAG, _read_shuttlecocks, {}),
    MeasuredSet(
        "single_pendulum", "pendulum", ("theta1",), (*_JOINT, *((*names, "air_drag") for names in _JOINT)),
        lambda d: _read_pendulum(d, "single_freeswing_200Hz.npz", ("theta",)), {"units": "rad"},
    ),
    MeasuredSet(
        "double_pendulum", "pendulum", ("theta1", "theta2"), _JOINT,
        lambda d: _read_pendulum(d, "double_freeswing_200Hz.npz", ("theta1", "theta2")), {"units": "rad"},
    ),
    # a drag, of either law: v v is expected, yet v fits each of the eight drops twice as well
    MeasuredSet(
        "whiffle_balls", "flight", ("x",), (*_DRAG, ("viscous_drag",)),
        lambda d: _read_drops(d, lambda n: "whiffle" in n), {},
    ),
    MeasuredSet("bowling_ball", "flight", ("x",), ((),), lambda d: _read_drops(d, lambda n: "bowling" in n), {}),
)  # fmt: skip


def write_measured_sets(source: Path, folder: Path) -> dict[str, Any]:
    """Write the sets that a folder of public measurements holds as track folders.

    Args:
        source: Folder of the public measurements.
        folder: Folder of the track folders to write, one per set.

    Returns:
        The answers by name of the set, in the format of answers.json; sets that are not in `source` are left out.
    """
    answers = {}
    for measured in MEASURED_SETS:
        try:
            shots = measured.read(source)
        except FileNotFoundError:
            continue
        _write_measured_set(measured, shots, folder / measured.name)
        answers[measured.name] = {"accepted": [list(names) for names in measured.accepted]}
    return answers


def _write_measured_set(measured: MeasuredSet, shots: list[Shot], folder: Path) -> None:
    """Write the shots of a set, at most `MAX_SHOTS`, as a track folder."""
    shots = shots[:: -(-len(shots) // MAX_SHOTS)]
    count = np.array([len(frames) for frames, _, _ in shots])
    places = np.concatenate([coordinates for _, _, coordinates in shots])
    columns: dict[str, object] = {
        "shot": np.repeat(np.arange(len(shots)), count),
        "frame": np.concatenate([frames for frames, _, _ in shots]),
        "t": np.concatenate([t for _, t, _ in shots]),
        "id": ["body"] * int(count.sum()),
        **{name: places[:, k] for k, name in enumerate(measured.columns)},
    }
    folder.mkdir(parents=True, exist_ok=True)
    csv.write_csv(pa.table(columns), folder / "tracks.csv")
    facts = {"scene": measured.scene, "units": "m", "model": [], **measured.facts}
    (folder / "scene.json").write_text(json.dumps(facts), encoding="utf-8")
