"""Runs each shot of a long recording like a clip, and merges their tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.chain import FinishedRun, run_clip, write_source
from pipeline.engine.atomic_write import replace_file, require_writable_folder, write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage_graph import RunWatcher
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import RunOptions
from pipeline.stages.shot_stages import ClipShot

MERGED_TABLES = ("tracks.csv", "events.csv", "trajectory.csv")

# Called with the number of the shot that begins, from 1, the number of shots, and the share of their frames before.
ShotListener = Callable[[int, int, float], None]


@dataclass(frozen=True, slots=True)
class ShotOutcome:
    """A shot and its run."""

    shot: ClipShot
    run: FinishedRun | None
    sentence: str
    """Why the shot failed; empty if it did not."""


def run_shots(
    clip: Path,
    shots: Sequence[ClipShot],
    folder: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    snapshot: SourceSnapshot,
    listener: ShotListener,
) -> list[ShotOutcome]:
    """Run every shot into a folder of its own, then merge their tables in `folder`.

    A shot that fails does not stop the others.

    Args:
        clip: The recording.
        shots: Its shots.
        folder: Folder of the results.
        options: Options of all stages.
        watcher: Follows each run.
        snapshot: The project's code when this process started.
        listener: Called when a shot begins.

    Returns:
        The outcome of every shot.
    """
    require_writable_folder(folder)
    ran, done, frames = [], 0, sum(shot.frame_count for shot in shots)
    for shot in shots:
        listener(shot.number + 1, len(shots), done / frames)
        done += shot.frame_count
        try:
            run = run_clip(clip, folder / shot.name, options, cache, watcher, snapshot=snapshot, shot=shot)
            ran.append(ShotOutcome(shot, run, ""))
        except Exception as error:  # no error of one shot may stop the others
            ran.append(ShotOutcome(shot, None, format_error(error)))
    good = [one for one in ran if one.run is not None]
    if good:
        _merge_tables(clip, good, folder, options)
    return ran


def _merge_tables(clip: Path, ran: Sequence[ShotOutcome], folder: Path, options: RunOptions) -> None:
    """Write the merged tables, and a scene.json that lists the shots."""
    for name in MERGED_TABLES:
        with replace_file(folder / name) as path, path.open("w", encoding="utf-8", newline="") as file:
            file.writelines(_read_lines_of_shots(ran, folder, name))
    scene = json.loads((folder / ran[0].shot.name / "scene.json").read_text(encoding="utf-8"))
    scene["shots"] = [
        {
            "shot": one.shot.number, "folder": one.shot.name, "first": one.shot.first, "stop": one.shot.stop,
            "begins": float(one.shot.clip.t[0]), "trust": one.run.fit.trust.level if one.run else "",
        }
        for one in ran
    ]  # fmt: skip
    write_text(folder / "scene.json", json.dumps(scene, indent=1, allow_nan=False))
    write_source(clip, folder, options)


def _read_lines_of_shots(ran: Sequence[ShotOutcome], folder: Path, name: str) -> Iterator[str]:
    """Yield one header and the lines of one table of all shots, with the number of the shot in the first column."""
    for k, one in enumerate(ran):
        with (folder / one.shot.name / name).open(encoding="utf-8", newline="") as file:
            head = next(file)
            if k == 0:
                yield head
            for line in file:
                yield f"{one.shot.number},{line.partition(',')[2]}"
