"""Runs a batch from its clips to its summary."""

from __future__ import annotations

import base64
import csv
import io
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import quote

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from models.core.errors import OptionError
from pipeline.batch.clip_discovery import assign_folders
from pipeline.batch.clip_job import ClipJob, ClipLimits, ClipResult, ClipRunner, JobStream
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.io.strict_json import read_json
from pipeline.reporting.pages.page_template import build_jpeg_uri, render_template
from pipeline.reporting.pages.run_report import SUMMARY_FILE, THUMBNAIL_PX, THUMBNAIL_QUALITY
from pipeline.reporting.text.text_formatting import escape_text
from pipeline.stages.render_stage import SLOW_FILE

# Least time between two summaries while clips run, s.
SUMMARY_INTERVAL_S = 2.0


class BatchFollower(Protocol):
    """Follows a batch: a display, a test."""

    def show_progress(self, clip: str, message: dict[str, Any]) -> None:
        """Show a progress message of a clip; see `clip_runner`."""
        ...

    def show_result(self, row: ClipResult, expected: int) -> None:
        """Show that a clip has ended; `expected` clips have been found so far."""
        ...


@dataclass(slots=True)
class Batch:
    """The clips of a folder and their results."""

    root: Path
    out: Path
    cache: ResultCache
    settings: dict[str, Any]
    limits: ClipLimits
    folders: dict[Path, Path] = field(default_factory=dict)
    names: dict[str, Path] = field(default_factory=dict)
    """Clips by the name under which they are printed."""
    rows: dict[str, ClipResult] = field(default_factory=dict)

    def jobs(self, clips: Iterable[Path | None]) -> JobStream:
        """Yield a job per clip, built when it is needed; None is passed on."""
        for clip in clips:
            if clip is not None and clip not in self.folders:
                self.folders = {**assign_folders([*self.folders, clip], self.root, self.out), **self.folders}
            yield None if clip is None else self._build_job(clip)

    def assign_folders(self, clips: Iterable[Path]) -> None:
        """Assign folders to the clips that are present at the start."""
        self.folders = assign_folders(clips, self.root, self.out)

    def _build_job(self, clip: Path) -> ClipJob:
        folder = str(self.folders[clip].absolute())
        name = escape_text(clip.relative_to(self.root))
        while self.names.setdefault(name, clip) != clip:  # two names that are printed alike
            name += "\N{PRIME}"
        cache = str(self.cache.root.absolute())
        return ClipJob(str(clip.absolute()), name, folder, cache, self.cache.mark, self.settings, self.limits)

    @property
    def results(self) -> list[ClipResult]:
        """Results of the clips that have ended, by name."""
        return sorted(self.rows.values(), key=lambda row: row.clip)

    def store_result(self, row: ClipResult) -> ClipResult:
        """Store the result of a clip, with a folder relative to `out` as the user named it."""
        if row.folder:
            row = replace(row, folder=str(self.out / Path(row.folder).relative_to(self.out.absolute())))
        self.rows[row.clip] = row
        return row


def run_batch(batch: Batch, clips: Iterable[Path | None], runner: ClipRunner, follower: BatchFollower) -> None:
    """Run the clips of a batch and keep its summary on disk up to date.

    Args:
        batch: The batch; it stores the results.
        clips: Clips to run; None means that there is none now.
        runner: Runs the clips.
        follower: Follows the batch.
    """
    written = 0.0
    try:
        for row in runner(batch.jobs(clips), follower.show_progress):
            follower.show_result(batch.store_result(row), len(batch.folders))
            if time.monotonic() - written > SUMMARY_INTERVAL_S:
                write_summary(batch.rows.values(), batch.out, whole=False)
                written = time.monotonic()
    finally:
        if batch.rows:
            write_summary(batch.rows.values(), batch.out)


# Columns that differ from run to run. The csv omits them, so that equal results are equal files.
COST_COLUMNS = ("seconds", "compiling", "peak_mb", "tries", "cached")
# Facts of results for the page, which no summary has: their sentences say the same.
PAGE_FACTS = ("remedy",)


def write_summary(rows: Iterable[ClipResult], out: Path, *, whole: bool = True) -> None:
    """Write the summary of a batch, ordered by clip; each file is replaced in one step.

    Args:
        rows: Results of the clips.
        out: Folder of the results.
        whole: Whether to write the parquet file and the page too, besides the csv.
    """
    ordered = sorted(rows, key=lambda row: row.clip)
    write_text(out / "summary.csv", format_csv(ordered))
    if whole:
        with replace_file(out / "summary.parquet") as fresh:
            pq.write_table(build_table(ordered), fresh)
        write_text(out / "summary.html", render_index_page(ordered, out))


def format_csv(rows: Sequence[ClipResult]) -> str:
    """Format one csv line per clip."""
    names = [field.name for field in fields(ClipResult) if field.name not in COST_COLUMNS + PAGE_FACTS]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_clean_cell(getattr(row, name)) for name in names] for row in rows)
    return text.getvalue()


def build_table(rows: Sequence[ClipResult]) -> pa.Table:
    """Build a table with one row per clip, cost columns included."""
    kinds = {"str": pa.string(), "int": pa.int64(), "float": pa.float64(), "bool": pa.bool_()}
    columns = [field for field in fields(ClipResult) if field.name not in PAGE_FACTS]
    schema = pa.schema([(field.name, kinds.get(str(field.type), pa.string())) for field in columns])
    return pa.Table.from_pylist([{k: _clean_cell(v) for k, v in asdict(row).items()} for row in rows], schema=schema)


def _clean_cell(value: object) -> object:
    """Replace characters of a string that a file cannot hold."""
    return escape_text(value) if isinstance(value, str) else value


# A phone opens a page of 3 MB at once.
MAX_PAGE_BYTES = 2_900_000
# Longest side of an image that shows a table at all.
LEAST_THUMBNAIL_PX = 64


@dataclass(frozen=True, slots=True)
class ShotCard:
    """What the page shows of one shot."""

    name: str
    place: str
    """Its folder relative to the page, quoted."""
    trust: str
    facts: dict[str, Any]
    """Content of its summary.json; empty where it has none."""
    has_video: bool

    @property
    def seconds(self) -> float:
        """Length, s."""
        return float(self.facts.get("ends", 0.0)) - float(self.facts.get("begins", 0.0))

    @property
    def answers(self) -> list[str]:
        """Topics of its calls with their answers, such as `score: yes`."""
        return [f"{call['topic']}: {call['answer']}" for call in self.facts.get("calls", ())]


def render_index_page(rows: Sequence[ClipResult], out: Path) -> str:
    """Render a page with a card per shot.

    Where the page would take more than `MAX_PAGE_BYTES`, its images get smaller, and are left out in the end.

    Args:
        rows: Results of the clips.
        out: Folder of the page, to which its links are relative.

    Returns:
        The page.
    """
    cards = [card for row in rows if row.status == "done" for card in _list_cards(row, out)]
    images = [str(card.facts.get("thumbnail", "")) for card in cards]
    bare = _render(rows, out, cards, [""] * len(cards))
    room = MAX_PAGE_BYTES - len(bare.encode("utf-8"))
    return _render(rows, out, cards, fitted) if any(fitted := _fit_images(images, room)) else bare


def _render(rows: Sequence[ClipResult], out: Path, cards: Sequence[ShotCard], images: Sequence[str]) -> str:
    """Render the page with these images."""
    return render_template(
        "summary.html",
        name=escape_text(out.resolve().name),
        rows=[{**asdict(row), "clip": escape_text(row.clip), "sentence": escape_text(row.sentence)} for row in rows],
        cards=list(zip(cards, images, strict=True)),
        answers=sorted({answer for card in cards for answer in card.answers}),
        done=sum(row.status == "done" for row in rows),
        seconds=sum(row.seconds for row in rows),
    )


def _list_cards(row: ClipResult, out: Path) -> Iterator[ShotCard]:
    """Yield a card for each usable shot of a clip."""
    folder = Path(row.folder)
    shots = _read_json(folder / "scene.json").get("shots", ()) if row.in_shots else ()
    for name in [str(shot["folder"]) for shot in shots] if row.in_shots else [""]:
        facts = _read_json(folder / name / SUMMARY_FILE)
        facts["balls"] = facts.get("balls", [])
        level = facts["trust"]["light"] if "trust" in facts else row.trust
        place = quote(os.fsencode(os.path.relpath(folder / name, out)))
        title = escape_text(f"{row.clip}, {name}" if name else row.clip)
        yield ShotCard(title, place, level, facts, (folder / name / SLOW_FILE).is_file())


def _read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; empty where the file cannot be read."""
    with suppress(OptionError):
        return dict(read_json(path, "a summary was expected"))
    return {}


def _fit_images(images: Sequence[str], room: int) -> list[str]:
    """Shrink images (data URIs) until they take no more than `room` bytes; leave all out where none could be seen."""
    fitted, longest = list(images), float(THUMBNAIL_PX)
    while (total := sum(map(len, fitted))) > room:
        longest *= min(0.95 * float(np.sqrt(max(room, 0) / total)), 0.9)
        if longest < LEAST_THUMBNAIL_PX:
            return [""] * len(images)
        fitted = [_shrink_image(image, round(longest)) if image else "" for image in images]
    return fitted


def _shrink_image(uri: str, longest: int) -> str:
    """Shrink an image (a data URI) to a longest side, px."""
    with Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))) as image:
        return build_jpeg_uri(np.asarray(image.convert("RGB")), longest, THUMBNAIL_QUALITY)
