"""trueroll detect: the balls in still pictures."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from detectors.detect import model_file
from detectors.options import DetectOptions
from detectors.still_images import StillBalls, balls_in_still
from models.core.errors import OptionError, TableNotFound
from pipeline.chain import refuse_closed
from pipeline.engine.atomic_write import aside
from pipeline.terminal.command_line import DebugOption, JsonOption, app, console, named
from video.io.options import CalibrateOptions

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, slots=True)
class Row:
    """A line of the table."""

    image: str
    """Path below the folder that was given."""
    x_px: float
    y_px: float
    radius_px: float
    kind: str
    score: float
    sigma: float


COLUMNS = tuple(Row.__dataclass_fields__)


@app.command("detect")
def detect(
    images: Annotated[Path, typer.Argument(metavar="IMAGE|FOLDER", help="A still picture, or a folder of them.")],
    out: Annotated[Path, typer.Option("-o", "--out", parser=named, metavar="FILE.csv", help="The table of balls.")],
    detector: Annotated[
        Literal["auto", "hough", "onnx"], typer.Option(help="Which detector: auto takes the network in still pictures.")
    ] = "auto",
    model: Annotated[Path | None, typer.Option(help="File of an ONNX ball detector.")] = None,
    corners: Annotated[str | None, typer.Option(help="Corners of the playing surface: x,y,x,y,x,y,x,y in px.")] = None,
    table: Annotated[str | None, typer.Option(help="Playing surface, such as 2.54x1.27 (m) or pool-9ft.")] = None,
    ball_radius: Annotated[float | None, typer.Option("--ball-radius", help="Radius of the balls in m.")] = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Balls in still pictures: centre, radius, kind, score and error of each, in px."""
    options = DetectOptions(detector, None if model is None else str(model))
    if model is not None and detector == "hough":
        raise OptionError("--detector hough runs no network, but one was named with --model; leave out one of them")
    if model is not None and not model_file(options).is_file():
        raise OptionError(f"--model is the file of an ONNX ball detector; {model} is not there")
    if out.is_dir():
        raise OptionError(f"-o is the table that is written, such as balls.csv; {out} is a folder")
    pictures = _pictures(images)
    refuse_closed(out.parent)
    calibrate = CalibrateOptions(corners, table, ball_radius)
    rows, failed, makers = [], [], set()
    for name, path in pictures:
        try:
            found = balls_in_still(_read(path), name, options, calibrate)
        except (TableNotFound, UnreadablePicture) as error:
            failed.append(str(error))
            console.print(f"trueroll: {error}", markup=False, soft_wrap=True)
            continue
        if found.note:
            console.print(f"Note: {found.note}", markup=False, soft_wrap=True)
        rows.extend(_rows(name, found))
        makers.add(found.made_by)
    out.parent.mkdir(parents=True, exist_ok=True)
    if len(failed) < len(pictures):
        with aside(out) as target:
            _write(rows, target)
    if as_json:
        print(json.dumps({"file": str(out), "failed": failed, "balls": [asdict(row) for row in rows]}))
    elif len(failed) < len(pictures):
        good = len(pictures) - len(failed)
        print(f"{len(rows)} balls in {good} of {len(pictures)} pictures: {out} ({'; '.join(sorted(makers))})")
    if failed:
        raise typer.Exit(1)


class UnreadablePicture(OptionError):
    """A file that is no picture."""


def _pictures(images: Path) -> list[tuple[str, Path]]:
    """Names for the table, and files."""
    if images.is_file():
        return [(images.name, images)]
    if not images.exists():
        raise OptionError(f"{images} is not there; a picture or a folder of pictures was expected")
    found = (
        sorted(p for p in images.rglob("*") if p.suffix.lower() in SUFFIXES and p.is_file()) if images.is_dir() else []
    )
    if not found:
        raise OptionError(
            f"A picture or a folder of pictures ({', '.join(SUFFIXES)}) was expected; {images} holds none"
        )
    return [(path.relative_to(images).as_posix(), path) for path in found]


def _read(path: Path) -> NDArray[np.uint8]:
    """The upright picture (H, W, 3) RGB."""
    read = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_COLOR) if path.stat().st_size else None
    if read is None:
        raise UnreadablePicture(f"{path.name} is no picture that can be read ({', '.join(SUFFIXES)} are)")
    return np.asarray(cv2.cvtColor(read, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _rows(name: str, found: StillBalls) -> list[Row]:
    columns = zip(found.centre.tolist(), found.radius, found.kind, found.score, found.sigma, strict=True)
    return [
        Row(name, round(x, 3), round(y, 3), round(float(r), 3), kind, round(float(score), 4), round(float(sigma), 4))
        for (x, y), r, kind, score, sigma in columns
    ]


def _write(rows: list[Row], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        table.writerows([getattr(row, name) for name in COLUMNS] for row in rows)
