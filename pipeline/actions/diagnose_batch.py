"""The gap diagnosis over a batch: all shots of one table together, because they share its cloth, cushions and slope."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import Report
from models.core.typing import FloatArray
from models.numerics.executor import Crew
from pipeline.batch.clip_job import Row
from pipeline.engine.helper_process import crew
from pipeline.io.gap_files import write_gap
from pipeline.io.profile_export import write_cure
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import open_scene, table_of
from pipeline.reporting.pages.gap_page import write_gap_page
from pipeline.reporting.text.gap_sentences import gap_sentence
from pipeline.reporting.text.sentences import one_sentence
from pipeline.terminal.search_display import search_display

SAME_CLOTH = 15.0
"""CIE 1976 colour difference below which two cloths are taken for one: half of what parts green from blue cloth, and
more than a lamp and an afternoon change."""

Size = tuple[str, float, float, float]
"""Name, length, width and ball radius (m) of a table."""


@dataclass(frozen=True, slots=True)
class TableShots:
    """The run folders of one table."""

    name: str
    folders: tuple[Path, ...]


def tables_of(rows: Iterable[Row]) -> list[TableShots]:
    """The runs of a batch by table: of one size, and with a cloth of one colour; runs that are not to be trusted left
    out."""
    found: list[tuple[Size, FloatArray, list[Path]]] = []
    for folder, light in _runs(rows):
        size, colour = _table(folder)
        for other, seen, folders in found:
            if light != "red" and other == size and not np.linalg.norm(seen - colour) > SAME_CLOTH:
                folders.append(folder)
                break
        else:
            if light != "red":
                found.append((size, colour, [folder]))
    names = [re.sub(r"[^\w-]", "_", size[0]) or f"{size[1]:g}x{size[2]:g}".replace(".", "_") for size, _, _ in found]
    return [
        TableShots(f"table-{k + 1:02d}-{name}", tuple(folders))
        for k, (name, (_, _, folders)) in enumerate(zip(names, found, strict=True))
    ]


def diagnose_tables(tables: Iterable[TableShots], out: Path, console: Console) -> Iterator[tuple[TableShots, str]]:
    """Write OUT/gap/TABLE/gap.json, gap.html, gap_predictions.csv and the table's profile; what each says,
    or why it says nothing. What is being tried shows on the console."""
    found = list(tables)
    if not found:
        return
    with crew() as workers:
        for table in found:
            try:
                report = _diagnose(table, out / "gap" / table.name, console, workers)
            except Exception as error:  # whatever is wrong with one table, the others are not to suffer
                yield table, one_sentence(error)
            else:
                yield table, gap_sentence(report)


def _diagnose(table: TableShots, folder: Path, console: Console, workers: Crew) -> Report:
    """Diagnose one table, and write all of its files."""
    read = read_track_folders(table.folders)
    scene = open_scene(read)
    with search_display(console, table.name) as watch:
        report = diagnose(scene, read.recordings, watch=watch, crew=workers)
    report = replace(report, notes=(*report.notes, *read.notes))
    write_gap(report, folder)
    if (played_on := table_of(scene)) is not None:
        write_cure(report, played_on, folder)
    write_gap_page(report, table.name, folder / "gap.html", played_on, read.origins)
    return report


def _runs(rows: Iterable[Row]) -> Iterator[tuple[Path, str]]:
    """The folder of every shot, and its light."""
    for row in rows:
        folder = Path(row.folder)
        if row.status == "done" and row.in_shots:
            shots = _scene(folder).get("shots", [])
            yield from ((folder / shot["folder"], shot["trust"]) for shot in shots)
        elif row.status == "done":
            yield folder, row.trust


def _table(folder: Path) -> tuple[Size, FloatArray]:
    scene = _scene(folder)
    table = scene.get("table") or {}
    size = (str(table.get("name") or ""), float(table["length"]), float(table["width"]), float(scene["ball_radius"]))
    return size, np.array(table.get("cloth_lab") or [np.nan] * 3, dtype=np.float64)


def _scene(folder: Path) -> dict[str, Any]:
    scene: dict[str, Any] = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    return scene
