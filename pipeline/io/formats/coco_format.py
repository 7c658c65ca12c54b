"""COCO annotations (Lin et al. 2014, arXiv:1405.0312) with `track_id`, as video tools add it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.io.formats.track_format import (
    PIXEL_CORNER,
    PointTracks,
    Provenance,
    TrackFormat,
    boxes_to_columns,
    number_unnamed,
    read_document,
    write_document,
)

_FRAME_KEYS = ("frame_id", "frame_index", "frame_number", "frame")


def recognises(path: Path, head: bytes) -> bool:
    """Return whether it is an object with images or annotations."""
    return (
        head.lstrip().startswith(b"{") and b'"result"' not in head and (b'"annotations"' in head or b'"images"' in head)
    )


def read(path: Path) -> PointTracks:
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


def write(tracks: PointTracks, path: Path, provenance: Provenance) -> None:
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


FORMAT = TrackFormat("coco", "COCO annotations", (".coco.json",), recognises, read, write, True)
