"""trueroll train-detector: train the ball network on drawn halls and write it as ONNX."""

from __future__ import annotations

import json
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from models.errors import OptionError
from pipeline.chain import refuse_closed
from pipeline.command_line import DebugOption, JsonOption, app, console, named

NEEDED = ("onnx", "onnxscript")
"""Packages of the extra `train`."""


TOLD_EVERY_S = 30.0
"""How often a file or a pipe is told how far the training is."""


@app.command("train-detector")
def train_detector(
    out: Annotated[
        Path, typer.Option("-o", "--out", parser=named, metavar="FILE.onnx", help="The trained detector.")
    ] = Path("balls.onnx"),
    work: Annotated[
        Path, typer.Option("--work", help="Folder of drawn pictures and checkpoints; run again, it goes on from there.")
    ] = Path("training"),
    hours: Annotated[float, typer.Option(min=0.001, help="Longest time to train, interruptions not counted.")] = 3.0,
    steps: Annotated[int, typer.Option(min=1, help="Most steps to train.")] = 12000,
    batch: Annotated[int, typer.Option(min=1, help="Pictures per step.")] = 16,
    files: Annotated[int, typer.Option(min=1, help="Files of 240 drawn pictures to train on.")] = 100,
    threads: Annotated[int, typer.Option(min=1, help="Threads of the processor to use.")] = 2,
    start: Annotated[
        Path | None,
        typer.Option("--from", parser=named, metavar="FILE.onnx", help="A network of trueroll's own to go on from."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the first weights and the order of pictures.")] = 0,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """Train the ball detector on drawn halls, check it on halls it never saw, and write it as ONNX."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise OptionError(
            f"Writing ONNX needs {' and '.join(missing)}; install trueroll with the extra train: .[train]"
        )
    refuse_closed(out.parent)
    refuse_closed(work)
    from detectors.recipe import make_detector  # torch, which takes seconds to import
    from detectors.training import CHECKPOINT, TrainOptions, steps_done

    options = TrainOptions(steps=steps, hours=hours, batch=batch, files=files, threads=threads, seed=seed, start=start)
    if (work / CHECKPOINT).exists():
        console.print(f"{work} holds a training: it goes on from step {steps_done(work)}")
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
            figures = make_detector(work, options, out, watch)
        except KeyboardInterrupt:
            console.print(f"{work} keeps pictures and the training so far; the same command goes on from there")
            raise
    if as_json:
        print(json.dumps({"file": str(out), **figures}))
        return
    if "sharp_rms_px" not in figures:
        print(f"{out}: a network that finds no ball yet; train it longer, the same command with more --hours goes on")
        return
    print(
        f"{out}: recall {figures['recall']:.1%}, precision {figures['precision']:.1%}, centres "
        f"{figures['sharp_rms_px']:.2f} px RMS per axis on drawn halls that it never saw"
    )
