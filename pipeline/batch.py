"""A folder of clips, one after the other: one bad clip stops nothing, and a second run resumes."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import av
import numpy as np

from pipeline.cache import Cache
from pipeline.chain import FILES, SOURCE, run_clip
from pipeline.graph import Watcher
from pipeline.options import RunOptions
from pipeline.publish import aside
from pipeline.sentences import one_sentence

RESULTS = frozenset(name for names in FILES.values() for name in names)
"""Names of the files of a run."""


@dataclass(frozen=True, slots=True)
class Row:
    """How one clip of a batch went."""

    clip: str
    """Path below the folder."""
    status: str
    """done or failed"""
    trust: str
    contacts: int
    seconds_in: float
    """s of the clip with its last event; 0 where nothing happened"""
    folder: str
    sentence: str
    """Why it failed, empty else."""


def find_clips(folder: Path) -> Iterator[Path]:
    """Every file below `folder` that is a film by name or by content; hidden files, links and results are left out.

    A film by name that cannot be opened is among them: whoever gave it wants to know.
    """
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if hidden or not path.is_file() or path.is_symlink() or _is_result(path):
            continue
        if _is_named_film(path) or _has_pictures(path):
            yield path


def _is_result(path: Path) -> bool:
    """Whether a run wrote it: its folder notes which clip it was made of."""
    return path.name in RESULTS and path.with_name(SOURCE).is_file()


def _is_named_film(path: Path) -> bool:
    return path.suffix.lower() in (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".ts", ".mpg")


def _has_pictures(path: Path) -> bool:
    """Whether a demuxer for films takes the file and finds a video stream of more than one still."""
    if path.suffix.lower() in (".py", ".md", ".txt", ".json", ".csv", ".html", ".rrd", ".png", ".jpg", ".jpeg"):
        return False
    try:
        with av.open(str(path)) as container:
            return bool(container.streams.video) and not container.format.name.endswith("_pipe")
    except (av.FFmpegError, OSError, ValueError):
        return False


def run_batch(
    clips: list[Path], root: Path, out: Path, options: RunOptions, cache: Cache, watch: Callable[[Path], Watcher]
) -> list[Row]:
    """Run every clip into a folder of its own below `out`; rewrite summary.csv after each."""
    rows = []
    folders = folders_of(clips, root, out)
    for clip in clips:
        rows.append(_run_one(clip, root, folders[clip], options, cache, watch(clip)))
        write_summary(rows, out / "summary.csv")
    return rows


def folders_of(clips: list[Path], root: Path, out: Path) -> dict[Path, Path]:
    """A folder per clip that mirrors the batch: by the stem, with the suffix where two clips would meet (a.mp4, a.mov).

    Names that differ in case only meet on some file systems.
    """
    places = {clip: out / clip.relative_to(root).with_suffix("") for clip in clips}
    shared = Counter(str(place).lower() for place in places.values())
    return {
        clip: place if shared[str(place).lower()] == 1 else place.with_name(clip.name.replace(".", "_"))
        for clip, place in places.items()
    }


def _run_one(clip: Path, root: Path, folder: Path, options: RunOptions, cache: Cache, watcher: Watcher) -> Row:
    name = str(clip.relative_to(root))
    try:
        run = run_clip(clip, folder, options, cache, watcher)
    except Exception as error:  # whatever is wrong with one clip, the others are not to suffer
        return Row(name, "failed", "", 0, 0.0, "", one_sentence(error))
    contacts = sum(kind in ("ball", "cushion") for kind in run.events.kind)
    last = float(np.max(run.events.t, initial=0.0))
    return Row(name, "done", run.trust.light, contacts, round(last, 3), str(folder), "")


def write_summary(rows: list[Row], path: Path) -> None:
    """summary.csv, replaced in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [field.name for field in fields(Row)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([getattr(row, name) for name in names] for row in rows)
    with aside(path) as fresh:
        fresh.write_text(text.getvalue(), encoding="utf-8")
