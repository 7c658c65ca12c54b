"""Boxes in images, as trackers and people annotate them: MOTChallenge, COCO and Label Studio."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from pipeline.io.formats.track_format import (
    PIXEL_CORNER,
    MalformedTracks,
    PointTracks,
    Provenance,
    TrackFormat,
    boxes_to_columns,
    number_unnamed,
    read_document,
    write_document,
)
from pipeline.io.text_table import read_text

# MOTChallenge text (Milan et al. 2016, arXiv:1603.00831): frame from 1, id, box, confidence, without a header.
_ROW = re.compile(rb"\s*-?[\d.]+([,\s]+-?[\d.eE+-]+){5,9}\s*")
# Id of detections.
_NO_IDENTITY = -1


def _recognises_mot(path: Path, head: bytes) -> bool:
    """Return whether every line is a row of numbers: frame, id and box at least."""
    lines = [line for line in head.splitlines()[:20] if line.strip()]
    return path.suffix.lower() in (".txt", ".csv") and bool(lines) and all(_ROW.fullmatch(line) for line in lines[:-1]
                                                                           or lines)  # fmt: skip


def _read_mot(path: Path) -> PointTracks:
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


def _write_mot(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
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


MOT = TrackFormat(
    "mot", "MOTChallenge text", ("gt.txt", "det.txt", ".mot.txt", ".mot"), _recognises_mot, _read_mot, _write_mot, False
)


# COCO annotations (Lin et al. 2014, arXiv:1405.0312) with `track_id`, as video tools add it.
_FRAME_KEYS = ("frame_id", "frame_index", "frame_number", "frame")


def _recognises_coco(path: Path, head: bytes) -> bool:
    """Return whether it is an object with images or annotations."""
    return (
        head.lstrip().startswith(b"{") and b'"result"' not in head and (b'"annotations"' in head or b'"images"' in head)
    )


def _read_coco(path: Path) -> PointTracks:
    """Read the annotations of one video, or of stills in their order."""
    document = read_document(path)
    images = document["images"]
    frames = {image["id"]: _find_frame(image, k) for k, image in enumerate(images)}
    kinds = {category["id"]: str(category["name"]) for category in document.get("categories", [])}
    rows = document["annotations"]
    frame = np.array([frames[row["image_id"]] for row in rows], np.int64)
    names = [_find_identity(row) for row in rows]
    boxes = np.array([row["bbox"] for row in rows], np.float64).reshape(-1, 4)
    numbered = number_unnamed(frame).tolist() if rows else []
    columns = {
        "frame": frame, "id": np.array([name or other for name, other in zip(names, numbered, strict=True)], np.str_),
        "kind": np.array([kinds.get(row.get("category_id"), "ball") for row in rows], np.str_),
        "score": np.array([row.get("score", 1.0) for row in rows], np.float64), **boxes_to_columns(boxes),
    }  # fmt: skip
    times = {image["id"]: image["t"] for image in images if "t" in image}
    if len(times) == len(images):
        columns["t"] = np.array([times[row["image_id"]] for row in rows], np.float64)
    notes = () if all(names) else (f"{path} has annotations without track_id; they are numbered in each image",)
    first = images[0] if images else {}
    size = (float(first["width"]), float(first["height"])) if {"width", "height"} <= first.keys() else None
    fps = document.get("info", {}).get("fps")
    return PointTracks(columns, fps=fps, image=size, notes=notes)


def _find_frame(image: dict[str, Any], order: int) -> int:
    """Return the frame of an image: stated, the last number of the file's name, or its place in the list."""
    stated = [image[key] for key in _FRAME_KEYS if key in image]
    digits = re.findall(r"\d+", Path(str(image.get("file_name", ""))).stem)
    return int(stated[0] if stated else digits[-1] if digits else order)


def _find_identity(row: dict[str, Any]) -> str:
    attributes = row.get("attributes") or {}
    names = (attributes.get("id"), row.get("track_id"), row.get("instance_id"), attributes.get("track_id"))
    return str(next((name for name in names if name is not None), ""))


def _write_coco(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
    """Write one image per frame and one annotation per row."""
    columns, boxes = tracks.columns, tracks.locate_boxes()
    wide, tall = tracks.image or np.ceil((boxes[:, :2] + boxes[:, 2:]).max(axis=0) + 2 * PIXEL_CORNER).tolist()
    kinds = columns.get("kind", np.full(len(boxes), "ball")).tolist()
    categories = {name: k + 1 for k, name in enumerate(dict.fromkeys(kinds))}
    numbers = {name: k + 1 for k, name in enumerate(tracks.ids)}
    frames, first = np.unique(columns["frame"], return_index=True)
    images = [
        {"id": frame + 1, "frame_id": frame, "file_name": f"{frame:06d}.png", "width": int(wide), "height": int(tall),
         **({"t": float(columns["t"][row])} if "t" in columns else {})}
        for frame, row in zip(frames.tolist(), first.tolist(), strict=True)
    ]  # fmt: skip
    score = columns.get("score", np.ones(len(boxes))).tolist()
    annotations = [
        {"id": k + 1, "image_id": frame + 1, "category_id": categories[kind], "track_id": numbers[name],
         "bbox": box, "area": box[2] * box[3], "iscrowd": 0, "score": value, "attributes": {"id": name}}
        for k, (frame, name, kind, box, value) in enumerate(
            zip(columns["frame"].tolist(), columns["id"].tolist(), kinds, boxes.tolist(), score, strict=True))
    ]  # fmt: skip
    info = {"description": f"tracks from {provenance['source']}", "version": provenance["version"], "fps": tracks.fps,
            "trueroll": dict(provenance)}  # fmt: skip
    write_document(
        {"info": info, "images": images, "annotations": annotations,
         "categories": [{"id": number, "name": name} for name, number in categories.items()]}, path,
    )  # fmt: skip


COCO = TrackFormat("coco", "COCO annotations", (".coco.json",), _recognises_coco, _read_coco, _write_coco, True)


# Tasks of Label Studio: boxes in a video (`videorectangle`), frames from 1, in per cent of the image.
_BOX = ("x", "y", "width", "height")


def _recognises_label_studio(path: Path, head: bytes) -> bool:
    """Return whether it is a list of tasks, or a task."""
    return head.lstrip().startswith((b"[", b"{")) and b'"result"' in head


def _read_label_studio(path: Path) -> PointTracks:
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


def _write_label_studio(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
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
LABEL_STUDIO = TrackFormat(
    "label-studio",
    "Label Studio tasks",
    _ENDINGS,
    _recognises_label_studio,
    _read_label_studio,
    _write_label_studio,
    True,
)
