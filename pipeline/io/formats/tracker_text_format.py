"""Text that Tracker exports: a line of track names, a line of columns beginning with t, and a row per frame."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from pipeline.io.formats.track_format import PointTracks, Provenance, TrackFormat
from pipeline.io.row_grid import build_row_grid
from pipeline.io.text_table import read_text

# First line of an export of several tracks.
_MULTIPLE = "#multi:"
_HEADER = re.compile(rb"^[\"']?t[\"']?\s*[,;\t ].*\bx\b", re.MULTILINE)


def recognises(path: Path, head: bytes) -> bool:
    """Return whether a line of names comes before one that begins with t."""
    lines = [line for line in head.splitlines()[:4] if line.strip() and not line.startswith(b"#")]
    return len(lines) > 1 and not _HEADER.match(lines[0]) and bool(_HEADER.match(lines[1]))


def read(path: Path) -> PointTracks:
    """Read one track or several; positions are in m, y up, or in px where only those were exported."""
    lines = [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
    delimiter = re.sub(r"[\"']", "", lines[1]).strip()[1]
    names, header = (
        [re.sub("^'(.*)'$", r"\1", cell.strip()) for cell in row] for row in csv.reader(lines[:2], delimiter=delimiter)
    )
    owners: list[str] = []
    for k, _ in enumerate(header):
        called = names[k] if k < len(names) else ""
        owners.append(called or (owners[-1] if owners else ""))
    rows = [line.split(delimiter) for line in lines[2:]]
    t = np.array([float(row[0].replace(",", ".")) for row in rows])
    parts = []
    for name in dict.fromkeys(one for one in owners[1:] if one):
        own = {header[k]: k for k in range(1, len(header)) if owners[k] == name and header[k]}
        axes = ("x", "y") if {"x", "y"} <= own.keys() else ("pixelx", "pixely")
        values = [[_parse_cell(row, own[axis]) for axis in axes] for row in rows]
        parts.append((name, axes[0] == "x", np.array(values).reshape(-1, 2)))
    use = [np.isfinite(places).all(axis=1) for _, _, places in parts]
    times = np.concatenate([t[one] for one in use])
    columns = {
        "frame": np.searchsorted(np.unique(t), times), "t": times,
        "id": np.concatenate([np.full(one.sum(), name) for (name, _, _), one in zip(parts, use, strict=True)]),
    }  # fmt: skip
    x, y = np.concatenate([places[one] for (_, _, places), one in zip(parts, use, strict=True)]).T
    is_metres = all(one for _, one, _ in parts)
    return PointTracks(
        {**columns, **({"x": x, "y": y} if is_metres else {"x_px": x, "y_px": y})}, "m" if is_metres else ""
    )


def _parse_cell(row: list[str], place: int) -> float:
    text = row[place].strip() if place < len(row) else ""
    return float(text.replace(",", ".")) if text else float("nan")


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a table separated by tabs, in m where those are known, else in px."""
    is_px = "x" not in tracks.columns and not tracks.px_per_m
    places, times, names = tracks.locate_px() if is_px else tracks.locate_metres(), tracks.list_times(), tracks.ids
    grid = build_row_grid(times, tracks.columns["id"])
    t, table = times[grid.first], grid.scatter(places)
    axes = "pixelx\tpixely" if is_px else "x\ty"
    lines = [_MULTIPLE] if len(names) > 1 else []
    plain = [" ".join(name.split()).replace('"', "'") for name in names]  # Tracker knows no quotes
    lines += ["\t" + "\t\t".join(plain), "\t".join(["t", *[axes] * len(names)])]
    for time, values in zip(t.tolist(), table.reshape(len(t), -1).tolist(), strict=True):
        lines.append("\t".join([repr(time), *("" if np.isnan(value) else repr(value) for value in values)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


FORMAT = TrackFormat("tracker-text", "Tracker text", (".tracker.txt",), recognises, read, write, False)
