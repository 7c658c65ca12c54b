"""A long recording: each of its shots is run like a clip, and their tables are put together."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from pipeline.chain import Run, digest_of, note_source, refuse_closed, run_clip, unchanging
from pipeline.engine.atomic_write import aside
from pipeline.engine.result_cache import Cache
from pipeline.engine.source_fingerprint import Look
from pipeline.engine.stage_graph import Graph, Watcher, stage_value
from pipeline.options import RunOptions
from pipeline.reporting.text.sentences import one_sentence
from pipeline.stages.read_stage import read_stage
from pipeline.stages.shot_stage import Shot, shots_stage
from video.calibration.shot_cuts import LONG_S, Shots
from video.io.clip import Clip

TABLES = {"tracks.csv": ("frame", "t"), "events.csv": ("frame", "t"), "trajectory.csv": ("t",)}
"""What is put together, and what of it counts from the beginning of a shot."""
DECIMALS = 6

Told = Callable[[int, int], None]
"""Hears which shot of how many begins."""


@dataclass(frozen=True, slots=True)
class Ran:
    """One shot that was run."""

    shot: Shot
    run: Run | None
    sentence: str
    """Why it could not be used, empty else."""


def shots_of(clip: Path, options: RunOptions, cache: Cache, watcher: Watcher, look: Look) -> list[Shot]:
    """The shots of a recording; empty where it is too short for several, or is one."""
    unchanged, digest = unchanging(clip), digest_of(clip)
    check = partial(unchanged, digest)
    read = read_stage(clip, digest, options.read)
    whole: Clip = _value(Graph.of([read], digest), "read", clip, cache, watcher, check, look)
    if whole.t[-1] < LONG_S:
        return []
    found: Shots = _value(Graph.of([read, shots_stage()], digest), "shots", clip, cache, watcher, check, look)
    if len(found) < 2 and not len(found.cuts):
        return []
    spans = zip(found.first.tolist(), found.stop.tolist(), strict=True)
    return [Shot(whole, number, *span, unchanged) for number, span in enumerate(spans)]


def _value(
    graph: Graph, name: str, clip: Path, cache: Cache, watcher: Watcher, check: Callable[[], None], look: Look
) -> Any:
    """What one stage makes of the file that lies at `clip` today."""

    def at(value: Clip) -> Clip:
        return replace(value, path=clip)

    entry = graph.run(cache, watcher, {"read": at}, check, look)[name]
    value = stage_value(next(stage for stage in graph.stages if stage.name == name), entry)
    return at(value) if isinstance(value, Clip) else value


def run_shots(
    clip: Path, shots: Sequence[Shot], folder: Path, options: RunOptions, cache: Cache, watcher: Watcher, look: Look,
    told: Told,
) -> list[Ran]:  # fmt: skip
    """Run every shot into a folder of its own, then put their tables together in `folder`.

    A shot that cannot be used stops no other.
    """
    refuse_closed(folder)
    ran = []
    for shot in shots:
        told(shot.number + 1, len(shots))
        try:
            made = run_clip(clip, folder / shot.name, options, cache, watcher, look=look, shot=shot)
            ran.append(Ran(shot, made, ""))
        except Exception as error:  # whatever is wrong with one shot, the others are not to suffer
            ran.append(Ran(shot, None, one_sentence(error)))
    good = [one for one in ran if one.run is not None]
    if good:
        _put_together(clip, good, folder)
    return ran


def _put_together(clip: Path, ran: Sequence[Ran], folder: Path) -> None:
    """The tables of all shots with pictures and times of the recording, and where each shot is."""
    for name, offset in TABLES.items():
        with aside(folder / name) as path, path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            for k, line in enumerate(_lines(ran, folder, name, offset)):
                if k == 0 or line[0] != "shot":
                    writer.writerow(line)
    scene = json.loads((folder / ran[0].shot.name / "scene.json").read_text(encoding="utf-8"))
    scene["shots"] = [
        {
            "shot": one.shot.number, "folder": one.shot.name, "first": one.shot.first, "stop": one.shot.stop,
            "begins": one.shot.clip.begins, "trust": one.run.trust.light if one.run else "",
        }
        for one in ran
    ]  # fmt: skip
    with aside(folder / "scene.json") as path:
        path.write_text(json.dumps(scene, indent=1, allow_nan=False), encoding="utf-8")
    note_source(clip, folder)


def _lines(ran: Sequence[Ran], folder: Path, name: str, offset: tuple[str, ...]) -> Iterator[list[str]]:
    """The lines of one table of all shots, the head of each among them."""
    for one in ran:
        shift = {"frame": one.shot.first, "t": one.shot.clip.begins}
        with (folder / one.shot.name / name).open(encoding="utf-8", newline="") as file:
            lines = csv.reader(file)
            head = next(lines)
            yield head
            columns = {head.index(column): shift[column] for column in offset}
            at = head.index("shot")
            for line in lines:
                for column, begin in columns.items():
                    line[column] = _later(line[column], begin)
                line[at] = str(one.shot.number)
                yield line


def _later(text: str, begin: float) -> str:
    """A number of a table, counted from the beginning of the recording; an empty cell stays one."""
    if not text:
        return text
    if isinstance(begin, int) and text.isdecimal():
        return str(int(text) + begin)
    return f"{float(text) + begin:.{DECIMALS}f}".rstrip("0").rstrip(".")
