"""`trueroll detect`: find the balls in still images."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

from detectors.detect import select_model_file
from detectors.still_images import StillDetections, detect_in_still
from models.core.errors import OptionError, TableNotFound
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.image_file import IMAGE_SUFFIXES, UnreadableImage, read_image
from pipeline.settings import DoorOptions, build_door_options, list_door_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings


@dataclass(frozen=True, slots=True)
class DetectedBallRow:
    """A row of the table: one detected ball."""

    image: str
    """Path of the image below the given folder."""
    x_px: float
    y_px: float
    radius_px: float
    kind: str
    score: float
    sigma: float


COLUMNS = tuple(DetectedBallRow.__dataclass_fields__)


@cli.command("detect")
@add_settings(list_door_settings(), build_door_options, ("fps", "sport"))
def detect_balls_in_stills(
    images: Annotated[Path, typer.Argument(metavar="IMAGE|FOLDER")],
    out: Annotated[Path, cli.make_output_option(metavar="FILE.csv")],
    as_json: cli.JsonOption = False,
    *,
    options: DoorOptions,
) -> None:
    """Find the balls in still images: centre, radius, standard deviation (px), kind and score of each.

    Args:
        images: A still image, or a folder of images.
        out: File of the table of balls.
    """
    detect, model = options.detect, options.detect.model
    if model is not None and detect.detector == "hough":
        raise OptionError("--detector hough runs no network, but one was named with --model; leave out one of them")
    if model is not None and not select_model_file(detect).is_file():
        raise OptionError(f"--model is the file of an ONNX ball detector; {model} is not there")
    if out.is_dir():
        raise OptionError(f"-o is the table that is written, such as balls.csv; {out} is a folder")
    paths = _list_images(images)
    require_writable_folder(out.parent)
    rows, failed, makers = [], [], set()
    for name, path in paths:
        try:
            balls = detect_in_still(read_image(path, options.read.aspect), name, detect, options.calibrate)
        except (TableNotFound, UnreadableImage) as error:
            failed.append(str(error))
            cli.print_note(f"trueroll: {error}")
            continue
        if balls.note:
            cli.print_note(f"Note: {balls.note}")
        rows.extend(_build_rows(name, balls))
        makers.add(balls.detector)
    if len(failed) < len(paths):
        with replace_file(out) as target, target.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(COLUMNS)
            table.writerows([getattr(row, name) for name in COLUMNS] for row in rows)
    if as_json:
        print(json.dumps({"file": str(out), "failed": failed, "balls": [asdict(row) for row in rows]}))
    elif len(failed) < len(paths):
        good = len(paths) - len(failed)
        print(f"{len(rows)} balls in {good} of {len(paths)} images: {out} ({'; '.join(sorted(makers))})")
    if failed:
        raise typer.Exit(1)


def _list_images(images: Path) -> list[tuple[str, Path]]:
    """List the images as (name in the table, path)."""
    if images.is_file():
        return [(images.name, images)]
    if not images.exists():
        raise OptionError(f"{images} is not there; an image or a folder of images was expected")
    paths = (
        sorted(p for p in images.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES and p.is_file())
        if images.is_dir()
        else []
    )
    if not paths:
        raise OptionError(
            f"An image or a folder of images ({', '.join(IMAGE_SUFFIXES)}) was expected; {images} holds none"
        )
    return [(path.relative_to(images).as_posix(), path) for path in paths]


def _build_rows(name: str, balls: StillDetections) -> list[DetectedBallRow]:
    columns = zip(balls.centre.tolist(), balls.radius, balls.kind, balls.score, balls.sigma, strict=True)
    return [
        DetectedBallRow(
            name, round(x, 3), round(y, 3), round(float(r), 3), kind, round(float(score), 4), round(float(sigma), 4)
        )
        for (x, y), r, kind, score, sigma in columns
    ]
