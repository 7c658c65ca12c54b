"""Points of bodies in images, as networks find them: DeepLabCut and SLEAP."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from models.core.errors import OptionError
from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat, number_unnamed
from pipeline.io.text_table import build_row_grid, read_text

# DeepLabCut tables (Mathis et al. 2018): header rows scorer, (individuals,) bodyparts, coords; a row per frame.
_HEADINGS = ("scorer", "individuals", "bodyparts", "coords")


def _recognises_deeplabcut(path: Path, head: bytes) -> bool:
    """Return whether the first rows are those of a header."""
    return path.suffix.lower() in (".h5", ".hdf5") or head.removeprefix(b"\xef\xbb\xbf").startswith(b"scorer,")


def _read_deeplabcut(path: Path) -> PointTracks:
    """Read predicted or labelled points; a body is a bodypart, of several individuals `individual/bodypart`."""
    if path.suffix.lower() in (".h5", ".hdf5"):
        raise OptionError(f"{path} is HDF5, which is not read; export it from DeepLabCut as CSV")
    rows = [row for row in csv.reader(read_text(path).splitlines(keepends=True)) if row]
    header = {row[0]: row for row in rows[: len(_HEADINGS)] if row[0] in _HEADINGS}
    body = rows[len(header) :]
    individuals, parts, coords = header.get("individuals"), header["bodyparts"], header["coords"]
    for k, row in enumerate(body):
        if len(row) != len(coords):
            raise MalformedTracks(f"row {k + 1} has {len(row)} values for {len(coords)} columns")
    first = next(k for k, name in enumerate(coords) if name == "x")
    frame = np.array([_find_frame(row[:first], k) for k, row in enumerate(body)], np.int64)
    names = [f"{individuals[k]}/{parts[k]}" if individuals else parts[k] for k in range(len(coords))]
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("frame", "id", "x_px", "y_px", "score")}
    for name in dict.fromkeys(names[first:]):
        own = {coords[k]: k for k in range(first, len(coords)) if names[k] == name}
        x, y, score = (
            np.array([float(row[own[key]] or "nan") if key in own else 1.0 for row in body]).reshape(len(body))
            for key in ("x", "y", "likelihood")
        )
        values = (frame, np.full(len(frame), name), x, y, score)
        for column, part in zip(columns.values(), values, strict=True):
            column.append(part[np.isfinite(x) & np.isfinite(y)])
    return PointTracks({name: np.concatenate(parts_) for name, parts_ in columns.items()})


def _find_frame(index: list[str], order: int) -> int:
    """Return the frame of a row: its number, the number of its image, or its place."""
    digits = re.findall(r"\d+", Path(index[-1]).stem)
    return int(digits[-1]) if digits else order


def _write_deeplabcut(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one row per frame, empty where a body was not seen."""
    places, names = tracks.locate_px(), tracks.ids
    score = tracks.columns.get("score", np.ones(len(places)))
    grid = build_row_grid(tracks.columns["frame"], tracks.columns["id"])
    frames, table = tracks.columns["frame"][grid.first], grid.scatter(np.column_stack([places, score]))
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["scorer", *[f"trueroll-{provenance['version']}"] * 3 * len(names)])
        rows.writerow(["bodyparts", *(name for name in names for _ in range(3))])
        rows.writerow(["coords", *["x", "y", "likelihood"] * len(names)])
        for frame, values in zip(frames.tolist(), table.reshape(len(frames), -1).tolist(), strict=True):
            rows.writerow([frame, *("" if np.isnan(value) else repr(value) for value in values)])


DEEPLABCUT = TrackFormat(
    "deeplabcut",
    "DeepLabCut table",
    (".dlc.csv", ".deeplabcut.csv"),
    _recognises_deeplabcut,
    _read_deeplabcut,
    _write_deeplabcut,
    False,
)


# SLEAP analysis tables (Pereira et al. 2022): track, frame_idx, instance.score, and x, y, score of every node.
# Name of the only node of a body.
_NODE = "centre"


def _recognises_sleap(path: Path, head: bytes) -> bool:
    """Return whether the header has frame_idx and the x of a node."""
    line = head.split(b"\n", 1)[0]
    return b"frame_idx" in line and b".x" in line


def _read_sleap(path: Path) -> PointTracks:
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


def _write_sleap(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one row per body and frame, with one node."""
    places = tracks.locate_px()
    score = tracks.columns.get("score", np.ones(len(places))).tolist()
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["track", "frame_idx", "instance.score", *(f"{_NODE}.{key}" for key in ("x", "y", "score"))])
        columns = (tracks.columns["id"].tolist(), tracks.columns["frame"].tolist(), score, *places.T.tolist(), score)
        rows.writerows(zip(*columns, strict=True))


SLEAP = TrackFormat(
    "sleap",
    "SLEAP analysis table",
    (".sleap.csv", ".analysis.csv"),
    _recognises_sleap,
    _read_sleap,
    _write_sleap,
    False,
)
