"""SLEAP analysis tables (Pereira et al. 2022): track, frame_idx, instance.score, and x, y, score of every node."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat, number_unnamed
from pipeline.io.text_table import read_text

# Name of the only node of a body.
_NODE = "centre"


def recognises(path: Path, head: bytes) -> bool:
    """Return whether the header has frame_idx and the x of a node."""
    line = head.split(b"\n", 1)[0]
    return b"frame_idx" in line and b".x" in line


def read(path: Path) -> PointTracks:
    """Read an analysis CSV; a body is a track, of several nodes `track/node`."""
    rows = list(csv.DictReader(read_text(path).splitlines(keepends=True)))
    if torn := next((k for k, row in enumerate(rows) if None in row or None in row.values()), None):
        raise MalformedTracks(f"row {torn + 1} has not as many values as its header has names")
    nodes = [name[:-2] for name in rows[0] if name.endswith(".x")]
    cells = [(row, node) for row in rows for node in nodes if row[f"{node}.x"] and row[f"{node}.y"]]
    frame = np.array([int(float(row["frame_idx"])) for row, _ in cells], np.int64)
    tracks = np.array([row.get("track") or "" for row, _ in cells], np.str_)
    tracks = np.where(tracks == "", number_unnamed(frame), tracks) if len(cells) else tracks
    ids = [f"{name}/{node}" if len(nodes) > 1 else name for name, (_, node) in zip(tracks.tolist(), cells, strict=True)]
    x, y, score = (
        np.array([float(row.get(f"{node}.{key}") or 1.0) for row, node in cells]) for key in ("x", "y", "score")
    )
    return PointTracks({"frame": frame, "id": np.array(ids, np.str_), "x_px": x, "y_px": y, "score": score})


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one row per body and frame, with one node."""
    places = tracks.locate_px()
    score = tracks.columns.get("score", np.ones(len(places))).tolist()
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["track", "frame_idx", "instance.score", *(f"{_NODE}.{key}" for key in ("x", "y", "score"))])
        columns = (tracks.columns["id"].tolist(), tracks.columns["frame"].tolist(), score, *places.T.tolist(), score)
        rows.writerows(zip(*columns, strict=True))


FORMAT = TrackFormat("sleap", "SLEAP analysis table", (".sleap.csv", ".analysis.csv"), recognises, read, write, False)
