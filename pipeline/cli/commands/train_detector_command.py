"""trueroll train-detector: train the networks of the detector on drawn halls and write them as ONNX."""

from __future__ import annotations

import json
import time
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from models.core.errors import ModelError, OptionError
from pipeline.chain import refuse_closed
from pipeline.terminal.command_line import DebugOption, JsonOption, app, console, named

NEEDED = ("onnx", "onnxscript")
"""Packages of the extra `train`."""
TOLD_EVERY_S = 30.0
"""How often a file or a pipe is told how far the training is."""


class Part(StrEnum):
    """Which network is trained."""

    BALLS = "balls"
    STREAKS = "streaks"
    DISCS = "discs"


AT_ONCE = {Part.BALLS: 16, Part.STREAKS: 128, Part.DISCS: 128}
"""Pictures per step, where none are asked for."""


@app.command("train-detector")
def train_detector(
    part: Annotated[
        Part,
        typer.Option("--part", help="What finds balls, or what measures closer the streaks or balls at rest it finds."),
    ] = Part.BALLS,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            parser=named,
            metavar="FILE.onnx",
            help="The trained network.",
            show_default="PART.onnx",
        ),
    ] = None,
    work: Annotated[
        Path, typer.Option("--work", help="Folder of drawn pictures and checkpoints; run again, it goes on from there.")
    ] = Path("training"),
    hours: Annotated[float, typer.Option(min=0.001, help="Longest time to train, interruptions not counted.")] = 3.0,
    steps: Annotated[int, typer.Option(min=1, help="Most steps to train.")] = 12000,
    batch: Annotated[
        int | None, typer.Option(min=1, help="Pictures per step.", show_default="16, or 128 streaks or discs")
    ] = None,
    files: Annotated[int, typer.Option(min=1, help="Files of 240 drawn pictures to train on.")] = 100,
    threads: Annotated[int, typer.Option(min=1, help="Threads of the processor to use.")] = 2,
    start: Annotated[
        Path | None,
        typer.Option("--from", parser=named, metavar="FILE.onnx", help="Ball network of trueroll's own to go on from."),
    ] = None,
    seer: Annotated[
        Path | None,
        typer.Option(
            "--seen-by", parser=named, metavar="FILE.onnx", help="Of --part streaks: what sees them, else the shipped."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights and the order of pictures.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Train a network of the detector on drawn halls, check it on halls it never saw, and write it as ONNX."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise OptionError(
            f"Writing ONNX needs {' and '.join(missing)}; install trueroll with the extra train: "
            "python -m pip install -e .[train]"
        )
    if part is not Part.BALLS and start is not None:
        raise OptionError(f"--from goes with --part balls; {part.value} are learnt from nothing")
    if part is not Part.STREAKS and seer is not None:
        raise OptionError("--seen-by goes with --part streaks; it names the ball network that sees them")
    if out is None:
        out = Path(f"{part.value}.onnx")
    if out.is_dir():
        raise OptionError(f"-o is the file that is written, such as {part.value}.onnx; {out} is a folder")
    refuse_closed(out.parent)
    refuse_closed(work)
    from detectors.network.network_file import SHIPPED
    from detectors.training.train_detector import (  # torch: seconds to import
        CHECKPOINTS,
        make_detector,
        make_discs,
        make_streaks,
    )
    from detectors.training.training_loop import TrainOptions, steps_done

    seer = SHIPPED if seer is None else _own_network(seer, "--seen-by")
    start = None if start is None else _own_network(start, "--from")
    options = TrainOptions(steps, hours, batch or AT_ONCE[part], files, threads, seed, start)
    kept = work / CHECKPOINTS[part.value]
    if kept.exists() and (done_before := steps_done(kept)):
        console.print(f"{work} holds a training: it goes on from step {done_before}")
    elif not console.is_terminal:
        console.print(f"Drawing pictures into {work}, then training for {hours:g} h or {steps} steps", soft_wrap=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        bar = bars.add_task("drawing the first pictures to train on", total=1.0)
        told = time.monotonic()

        def watch(step: int, done: float, parts: dict[str, float]) -> None:
            nonlocal told
            at = f"step {step}, loss {sum(parts.values()):.2f}" if done < 1 else f"step {step}; checking on other halls"
            bars.update(bar, completed=done, description=at)
            if not console.is_terminal and time.monotonic() - told > TOLD_EVERY_S:
                told = time.monotonic()
                console.print(f"{done:.0%}: {at}")

        try:
            if part is Part.STREAKS:
                figures = make_streaks(work, seer, options, out, watch)
            else:
                figures = (make_detector if part is Part.BALLS else make_discs)(work, options, out, watch)
        except KeyboardInterrupt:
            console.print(f"{work} keeps pictures and the training so far; the same command goes on from there")
            raise
    if as_json:
        print(json.dumps({"file": str(out), **figures}))
        return
    print(f"{out}: {TOLD[part](figures)}")


def _own_network(path: Path, option: str) -> Path:
    """A file that holds a ball network of the project's own; OptionError for any other, before anything is drawn."""
    from detectors.network.network_file import CentreModel, open_model

    wanted = f"{option} {path} should be a file with a ball network of trueroll's own"
    if not path.is_file():
        raise OptionError(f"{wanted}; it is {'a folder' if path.is_dir() else 'not there'}")
    try:
        own = isinstance(open_model(path), CentreModel)
    except ModelError as error:
        raise OptionError(f"{wanted}; it cannot be opened as one") from error
    if not own:
        raise OptionError(f"{wanted}; it is a YOLO export, which sees no streaks and cannot be trained on")
    return path


def _balls_told(figures: dict[str, float]) -> str:
    if "sharp_rms_px" not in figures:
        return "a network that finds no ball yet; train it longer, the same command with more --hours goes on"
    return (
        f"recall {figures['recall']:.1%}, precision {figures['precision']:.1%}, centres "
        f"{figures['sharp_rms_px']:.2f} px RMS per axis on drawn halls that it never saw"
    )


def _streaks_told(figures: dict[str, float]) -> str:
    along, across, told = figures["along"], figures["across"], (figures["shown_along"], figures["shown_across"])
    before = f"by the ball network's word alone {told[0]:.2f} and {told[1]:.2f}"
    longer = "; it is worse than that word: train it longer" if along > told[0] or across > told[1] else ""
    return (
        f"middles of {figures['streaks']:.0f} streaks in drawn halls that it never saw miss by {along:.2f} ball radii "
        f"RMS along them and {across:.2f} across, {before}{longer}"
    )


def _discs_told(figures: dict[str, float]) -> str:
    return (
        f"centres of {figures['discs']:.0f} balls at rest in drawn halls that it never saw miss by "
        f"{figures['right']:.3f} ball radii RMS across and {figures['down']:.3f} down"
    )


TOLD = {Part.BALLS: _balls_told, Part.STREAKS: _streaks_told, Part.DISCS: _discs_told}
