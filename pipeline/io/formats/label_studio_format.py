"""Tasks of Label Studio: boxes in a video (`videorectangle`), frames from 1, in per cent of the image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pipeline.io.formats.track_format import (
    MalformedTracks,
    PointTracks,
    Provenance,
    TrackFormat,
    boxes_to_columns,
    read_document,
    write_document,
)

_BOX = ("x", "y", "width", "height")


def recognises(path: Path, head: bytes) -> bool:
    """Return whether it is a list of tasks, or a task."""
    return head.lstrip().startswith((b"[", b"{")) and b'"result"' in head


def read(path: Path) -> PointTracks:
    """Read the keyframes of all tasks; places between them that Label Studio interpolates are no observations."""
    document = read_document(path)
    rows: list[tuple[int, int, str, str, float]] = []
    boxes: list[list[float]] = []
    size: tuple[float, float] | None = None
    for shot, task in enumerate(document if isinstance(document, list) else [document]):
        data = task.get("data", {})
        for answer in (task.get("annotations") or task.get("predictions") or [])[:1]:
            for region in answer["result"]:
                if "sequence" not in region.get("value", {}):
                    continue
                size = _find_size(region, data) or size
                if size is None:
                    raise MalformedTracks("it states no width and height of the image; add them to `data` of each task")
                value = region["value"]
                name = str((region.get("meta", {}).get("text") or [region["id"]])[0])
                kind = str((value.get("labels") or ["ball"])[0])
                for key in value["sequence"]:
                    rows.append((shot, int(key["frame"]) - 1, name, kind, float(key.get("time", np.nan))))
                    boxes.append([key[one] / 100 * size[k % 2] for k, one in enumerate(_BOX)])
    if not rows:
        raise MalformedTracks("it has no positions")
    shots, frames, names, kinds, times = zip(*rows, strict=True)
    columns = {
        "shot": np.array(shots), "frame": np.array(frames, np.int64), "id": np.array(names), "kind": np.array(kinds),
        **boxes_to_columns(np.array(boxes)),
    }  # fmt: skip
    if np.isfinite(times).all():
        columns["t"] = np.array(times)
    return PointTracks(columns, image=size)


def _find_size(region: dict[str, Any], data: dict[str, Any]) -> tuple[float, float] | None:
    for place, names in ((region, ("original_width", "original_height")), (data, ("width", "height"))):
        if all(name in place for name in names):
            return float(place[names[0]]), float(place[names[1]])
    return None


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one task per shot with one region per body."""
    boxes = tracks.locate_boxes()
    wide, tall = tracks.image or (boxes[:, :2] + boxes[:, 2:]).max(axis=0).tolist()
    per_cent = boxes * 100 / np.array([wide, tall, wide, tall])
    shots = tracks.columns.get("shot", np.zeros(len(boxes), np.int64))
    tasks = []
    for shot in np.unique(shots).tolist():
        results = [
            _build_region(
                tracks, per_cent, np.flatnonzero((tracks.columns["id"] == name) & (shots == shot)), (wide, tall)
            )
            for name in tracks.ids
        ]
        data = {"video": str(provenance["source"]), "width": wide, "height": tall, "trueroll": dict(provenance)}
        tasks.append({"data": data, "annotations": [{"result": [one for one in results if one]}]})
    write_document(tasks, path)


def _build_region(
    tracks: PointTracks, per_cent: np.ndarray, rows: np.ndarray, size: tuple[float, float]
) -> dict[str, Any]:
    if not len(rows):
        return {}
    columns = tracks.columns
    sequence = [
        {"frame": int(columns["frame"][k]) + 1, "enabled": True, "rotation": 0,
         **dict(zip(_BOX, per_cent[k].tolist(), strict=True)),
         **({"time": float(columns["t"][k])} if "t" in columns else {})}
        for k in rows.tolist()
    ]  # fmt: skip
    name = str(columns["id"][rows[0]])
    kind = str(columns["kind"][rows[0]]) if "kind" in columns else "ball"
    value = {"framesCount": int(columns["frame"].max()) + 1, "sequence": sequence, "labels": [kind]}
    return {"id": name, "type": "videorectangle", "from_name": "box", "to_name": "video", "meta": {"text": [name]},
            "original_width": size[0], "original_height": size[1], "value": value}  # fmt: skip


_ENDINGS = (".labelstudio.json", ".label-studio.json")
FORMAT = TrackFormat("label-studio", "Label Studio tasks", _ENDINGS, recognises, read, write, True)
