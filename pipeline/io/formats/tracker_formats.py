"""Tracker (Open Source Physics): its projects, and the text that it exports."""

from __future__ import annotations

import csv
import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from models.core.typing import FloatArray
from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat
from pipeline.io.text_table import build_row_grid, read_text
from pipeline.io.track_conventions import LENGTH_UNITS

# Projects of Tracker (Open Source Physics): XML with point masses in px, clip and axes; a .trz holds one.
_MEDIA, _TRACKER = "org.opensourcephysics.media.core.", "org.opensourcephysics.cabrillo.tracker."
_POINT, _AXES = f"{_TRACKER}PointMass$FrameData", f"{_MEDIA}ImageCoordSystem$FrameData"
_MS = 1000.0


def _recognises_project(path: Path, head: bytes) -> bool:
    """Return whether it is a project."""
    return b"TrackerPanel" in head or path.suffix.lower() in (".trk", ".trz")


def _read_project(path: Path) -> PointTracks:
    """Read the point masses, in px, and in m where the project has a scale; y of the project points up."""
    root = ElementTree.fromstring(_read_xml(path))
    clip, control = _find_object(root, "VideoClip"), _find_object(root, "ClipControl")
    step = _number(control, "delta_t", np.nan) / _MS if control is not None else np.nan
    start = (
        (_number(clip, "startframe", 0.0), _number(clip, "starttime", 0.0) / _MS) if clip is not None else (0.0, 0.0)
    )
    frames: list[int] = []
    names: list[str] = []
    places: list[tuple[float, float]] = []
    for mass in root.iter("object"):
        if mass.get("class") != f"{_TRACKER}PointMass":
            continue
        name = (mass.findtext("property[@name='name']") or f"mass {len(set(names)) + 1}").strip()
        for entry in mass.findall("property[@name='framedata']/property"):
            point = entry.find("object")
            if point is not None:
                frames.append(int(entry.get("name", "").strip("[]")))
                names.append(name)
                places.append((_number(point, "x", np.nan), _number(point, "y", np.nan)))
    frame, px = np.array(frames, np.int64), np.array(places, np.float64).reshape(-1, 2)
    columns = {"frame": frame, "id": np.array(names, np.str_), "x_px": px[:, 0], "y_px": px[:, 1]}
    if np.isfinite(step) and step > 0:
        columns["t"] = start[1] + (frame - start[0]) * step
    axes = next((one for one in root.iter("object") if one.get("class") == _AXES), None)
    metres = LENGTH_UNITS.get((root.findtext("property[@name='length_unit']") or "m").strip(), 1.0)
    scale = _number(axes, "xscale", 1.0) / metres if axes is not None else 1.0
    if axes is None or scale == 1.0:  # as in a project without a calibration
        return PointTracks(columns, fps=1 / step if step > 0 else None)
    away = (px - [_number(axes, "xorigin", 0.0), _number(axes, "yorigin", 0.0)]) / [scale, -scale]
    turn = np.radians(_number(axes, "angle", 0.0))
    columns["x"] = np.cos(turn) * away[:, 0] + np.sin(turn) * away[:, 1]
    columns["y"] = np.cos(turn) * away[:, 1] - np.sin(turn) * away[:, 0]
    return PointTracks(columns, "m", 1 / step if step > 0 else None, scale)


def _read_xml(path: Path) -> bytes:
    if not zipfile.is_zipfile(path):
        return path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        projects = [name for name in archive.namelist() if name.lower().endswith(".trk")]
        if not projects:
            raise MalformedTracks("it holds no .trk file")
        return archive.read(projects[0])


def _find_object(root: ElementTree.Element, ending: str) -> ElementTree.Element | None:
    return next((one for one in root.iter("object") if one.get("class", "").endswith(ending)), None)


def _number(element: ElementTree.Element, name: str, default: float) -> float:
    text = element.findtext(f"property[@name='{name}']")
    return float(text) if text else default


def _write_project(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write a project without a video, with its scale where it is known; provenance is its description."""
    px, frame = tracks.locate_px(), tracks.columns["frame"]
    panel = ElementTree.Element("object", {"class": f"{_TRACKER}TrackerPanel"})
    words = f"trueroll {provenance['version']} from {provenance['source']}, options {dict(provenance['options'])}"
    _add(panel, "description", "string", words)
    clip = _add_object(_add(panel, "videoclip", "object"), f"{_MEDIA}VideoClip")
    for name, value in (("startframe", 0), ("stepsize", 1), ("stepcount", int(frame.max(initial=0)) + 1)):
        _add(clip, name, "int", str(value))
    fps = tracks.fps
    if not fps and "t" in tracks.columns and np.ptp(frame):
        fps = float(1 / np.polyfit(frame, tracks.columns["t"], 1)[0])
    if fps is not None:
        start = tracks.list_times()[0] - frame[0] / fps
        _add(clip, "starttime", "double", repr(float(start * _MS)))
        control = _add_object(_add(panel, "clipcontrol", "object"), f"{_MEDIA}StepperClipControl")
        _add(control, "delta_t", "double", repr(_MS / fps))
    system = _add_object(_add(panel, "coords", "object"), f"{_MEDIA}ImageCoordSystem")
    origin, scale = _find_origin(tracks, px), tracks.px_per_m or 1.0
    data = _add(system, "framedata", "array", kind=f"[L{_AXES};")
    entry = _add_object(_add(data, "[0]", "object"), _AXES)
    numbers = {"xorigin": origin[0], "yorigin": origin[1], "angle": 0.0, "xscale": scale, "yscale": scale}
    for name, number in numbers.items():
        _add(entry, name, "double", repr(float(number)))
    _add(panel, "length_unit", "string", "m")
    masses = _add(panel, "tracks", "collection", kind="java.util.ArrayList")
    for name in tracks.ids:
        mass = _add_object(_add(masses, "item", "object"), f"{_TRACKER}PointMass")
        _add(mass, "name", "string", name)
        points = _add(mass, "framedata", "array", kind=f"[L{_POINT};")
        for k in np.flatnonzero(tracks.columns["id"] == name).tolist():
            point = _add_object(_add(points, f"[{frame[k]}]", "object"), _POINT)
            for axis, value in zip("xy", px[k].tolist(), strict=True):
                _add(point, axis, "double", repr(value))
    ElementTree.indent(panel, "    ")
    path.write_bytes(ElementTree.tostring(panel, "utf-8", xml_declaration=True))


def _find_origin(tracks: PointTracks, px: FloatArray) -> FloatArray:
    """Return the px of the origin of coordinates whose y points up; that of the image where there are none."""
    if tracks.px_per_m and "x" in tracks.columns and "y" in tracks.columns and "x_px" in tracks.columns:
        away = np.stack([tracks.columns["x"], -tracks.columns["y"]], axis=1) * tracks.px_per_m
        return np.asarray((px - away).mean(axis=0))
    return np.zeros(2)


def _add(
    parent: ElementTree.Element, name: str, type_: str, text: str | None = None, kind: str = ""
) -> ElementTree.Element:
    """Add a property, with text or with the class of what it collects."""
    attributes = {"name": name, "type": type_, **({"class": kind} if kind else {})}
    element = ElementTree.SubElement(parent, "property", attributes)
    element.text = text
    return element


def _add_object(parent: ElementTree.Element, kind: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, "object", {"class": kind})


PROJECT = TrackFormat("tracker", "Tracker project", (".trk",), _recognises_project, _read_project, _write_project, True)


# Text that Tracker exports: a line of track names, a line of columns beginning with t, and a row per frame.
# First line of an export of several tracks.
_MULTIPLE = "#multi:"
_HEADER = re.compile(rb"^[\"']?t[\"']?\s*[,;\t ].*\bx\b", re.MULTILINE)


def _recognises_export(path: Path, head: bytes) -> bool:
    """Return whether a line of names comes before one that begins with t."""
    lines = [line for line in head.splitlines()[:4] if line.strip() and not line.startswith(b"#")]
    return len(lines) > 1 and not _HEADER.match(lines[0]) and bool(_HEADER.match(lines[1]))


def _read_export(path: Path) -> PointTracks:
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


def _write_export(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
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


TRACKER_TEXT = TrackFormat(
    "tracker-text", "Tracker text", (".tracker.txt",), _recognises_export, _read_export, _write_export, False
)
