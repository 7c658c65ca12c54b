"""MOTChallenge text (Milan et al. 2016, arXiv:1603.00831): frame from 1, id, box, confidence, without a header."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from models.core.typing import FloatArray
from pipeline.io.formats.track_format import (
    MalformedTracks,
    PointTracks,
    Provenance,
    TrackFormat,
    boxes_to_columns,
    number_unnamed,
)
from pipeline.io.text_table import read_text

_ROW = re.compile(rb"\s*-?[\d.]+([,\s]+-?[\d.eE+-]+){5,9}\s*")
# Id of detections.
_NO_IDENTITY = -1


def recognises(path: Path, head: bytes) -> bool:
    """Return whether every line is a row of numbers: frame, id and box at least."""
    lines = [line for line in head.splitlines()[:20] if line.strip()]
    return path.suffix.lower() in (".txt", ".csv") and bool(lines) and all(_ROW.fullmatch(line) for line in lines[:-1]
                                                                           or lines)  # fmt: skip


def read(path: Path) -> PointTracks:
    """Read a gt.txt, det.txt or a result of a tracker."""
    rows: list[list[float]] = []
    for line in read_text(path).splitlines():
        if line.strip():
            rows.append([float(cell) for cell in re.split(r"[,\s]+", line.strip(" \t,"))][:7])
            if len(rows[-1]) < 6:
                raise MalformedTracks(
                    f"line {len(rows)} has {len(rows[-1])} values; a row has frame, id and a box at least"
                )
    table: FloatArray = np.array([row + [1.0] * (7 - len(row)) for row in rows])
    frame = table[:, 0].astype(np.int64) - 1
    is_named = table[:, 1] != _NO_IDENTITY
    ids = np.where(is_named, [f"{value:g}" for value in table[:, 1]], number_unnamed(frame))
    notes = () if is_named.all() else (f"{path} has detections without identities; they are numbered in each frame",)
    return PointTracks(
        {"frame": frame, "id": ids, **boxes_to_columns(table[:, 2:6]), "score": table[:, 6]}, notes=notes
    )


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a result file; names that are no numbers become numbers, which the file beside it explains."""
    names = tracks.ids
    numbers = {name: int(name) if all(one.isdecimal() for one in names) else k + 1 for k, name in enumerate(names)}
    score = tracks.columns.get("score", np.ones(len(tracks.columns["id"])))
    lines = [
        f"{frame + 1},{numbers[name]},{','.join(f'{value:.6g}' for value in box)},{confidence:.6g},-1,-1,-1\n"
        for frame, name, box, confidence in zip(
            tracks.columns["frame"].tolist(), tracks.columns["id"].tolist(), tracks.locate_boxes().tolist(),
            score.tolist(), strict=True,
        )
    ]  # fmt: skip
    path.write_text("".join(lines), encoding="utf-8")


FORMAT = TrackFormat(
    "mot", "MOTChallenge text", ("gt.txt", "det.txt", ".mot.txt", ".mot"), recognises, read, write, False
)
