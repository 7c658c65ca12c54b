"""`trueroll train-detector`: train a network of the detector on rendered images and write it as ONNX."""

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
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.engine.extras import name_remedy
from pipeline.terminal import command_line as cli

# Packages of the extra `train`.
REQUIRED_PACKAGES = ("onnx", "onnxscript")
# Time between progress lines where the output is no terminal, s.
PRINT_INTERVAL_S = 30.0


class NetworkPart(StrEnum):
    """Which network is trained."""

    BALLS = "balls"
    STREAKS = "streaks"
    DISCS = "discs"
    FLYING = "flying"


# Default number of training samples per step.
DEFAULT_BATCH = {NetworkPart.BALLS: 16, NetworkPart.STREAKS: 128, NetworkPart.DISCS: 128, NetworkPart.FLYING: 192}


@cli.command("train-detector")
def train_detector(
    part: NetworkPart = NetworkPart.BALLS,
    out: Annotated[Path | None, cli.make_output_option(metavar="FILE.onnx", show_default="PART.onnx")] = None,
    work: Path = Path("training"),
    hours: Annotated[float, typer.Option(min=0.001)] = 3.0,
    steps: Annotated[int, typer.Option(min=1)] = 12000,
    batch: Annotated[int | None, typer.Option(min=1, show_default="16 to 192, by part")] = None,
    files: Annotated[int, typer.Option(min=1)] = 100,
    threads: Annotated[int, typer.Option(min=1)] = 2,
    start: Annotated[Path | None, typer.Option("--from", parser=cli.parse_output_path, metavar="FILE.onnx")] = None,
    seer: Annotated[Path | None, typer.Option("--seen-by", parser=cli.parse_output_path, metavar="FILE.onnx")] = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    as_json: cli.JsonOption = False,
) -> None:
    """Train a network of the detector on rendered images, evaluate it on held-out ones, and write it as ONNX.

    Args:
        part: Network to train: balls detects balls; streaks and discs refine moving balls and balls at rest;
            flying finds the ball or shuttle of a rally.
        out: File of the trained network.
        work: Folder of training images and checkpoints; a second call continues the training.
        hours: Longest training time without interruptions, in h.
        steps: Largest number of training steps.
        batch: Training samples per step.
        files: Number of files of 240 training images each, or for flying of 60 films or 12 clips of rallies, in turn.
        threads: Number of processor threads.
        start: Ball network of trueroll to start from.
        seer: For --part streaks: ball network that detects the streaks. Default: the shipped one.
        seed: Random seed of the initial weights and of the order of samples.
    """
    missing = [name for name in REQUIRED_PACKAGES if find_spec(name) is None]
    if missing:
        raise OptionError(f"Writing ONNX needs {' and '.join(missing)}; {name_remedy('train')}")
    if part is not NetworkPart.BALLS and start is not None:
        raise OptionError(f"--from goes with --part balls; {part.value} are trained from random weights")
    if part is not NetworkPart.STREAKS and seer is not None:
        raise OptionError("--seen-by goes with --part streaks; it names the ball network that detects them")
    if out is None:
        out = Path(f"{part.value}.onnx")
    if out.is_dir():
        raise OptionError(f"-o is the file that is written, such as {part.value}.onnx; {out} is a folder")
    require_writable_folder(out.parent)
    require_writable_folder(work)
    from detectors.network.ball_model import SHIPPED_BALL_MODEL
    from detectors.training.flying_training import train_flying_detector
    from detectors.training.offset_samples import DiscSource, StreakSource
    from detectors.training.train_detector import (  # torch: seconds to import
        CHECKPOINTS,
        train_ball_detector,
        train_offset_regressor,
    )
    from detectors.training.training_loop import TrainOptions, read_step_count

    seer = SHIPPED_BALL_MODEL if seer is None else _require_own_network(seer, "--seen-by")
    start = None if start is None else _require_own_network(start, "--from")
    options = TrainOptions(steps, hours, batch or DEFAULT_BATCH[part], files, threads, seed, start)
    checkpoint = work / CHECKPOINTS[part.value]
    if checkpoint.exists() and (done_before := read_step_count(checkpoint)):
        cli.console.print(f"{work} holds a training, which continues from step {done_before}")
    elif not cli.console.is_terminal:
        cli.console.print(
            f"Rendering images into {work}, then training for {hours:g} h or {steps} steps", soft_wrap=True
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=cli.console, transient=True) as bars:
        bar = bars.add_task("rendering the first training images", total=1.0)
        last_printed = time.monotonic()

        def watch(step: int, done: float, parts: dict[str, float]) -> None:
            nonlocal last_printed
            at = (
                f"step {step}, loss {sum(parts.values()):.2f}"
                if done < 1
                else f"step {step}; evaluating on held-out images"
            )
            bars.update(bar, completed=done, description=at)
            if not cli.console.is_terminal and time.monotonic() - last_printed > PRINT_INTERVAL_S:
                last_printed = time.monotonic()
                cli.console.print(f"{done:.0%}: {at}")

        try:
            if part is NetworkPart.BALLS:
                figures = train_ball_detector(work, options, out, watch)
            elif part is NetworkPart.STREAKS:
                figures = train_offset_regressor(StreakSource(work, seer), work, options, out, watch)
            elif part is NetworkPart.FLYING:
                figures = train_flying_detector(work, options, out, watch)
            else:
                figures = train_offset_regressor(DiscSource(work, seed), work, options, out, watch)
        except KeyboardInterrupt:
            cli.console.print(f"{work} keeps the images and the training so far; the same command continues")
            raise
    if as_json:
        print(json.dumps({"file": str(out), **figures}))
        return
    print(f"{out}: {SUMMARIES[part](figures)}")


def _require_own_network(path: Path, option: str) -> Path:
    """Require a file with a ball network of trueroll, before any image is rendered."""
    from detectors.network.ball_model import CentreModel, open_ball_model

    wanted = f"{option} {path} should be a file with a ball network of trueroll's own"
    if not path.is_file():
        raise OptionError(f"{wanted}; it is {'a folder' if path.is_dir() else 'not there'}")
    try:
        own = isinstance(open_ball_model(path), CentreModel)
    except ModelError as error:
        raise OptionError(f"{wanted}; it cannot be opened as one") from error
    if not own:
        raise OptionError(f"{wanted}; it is a YOLO export, which detects no streaks and cannot be trained further")
    return path


def _summarize_balls(figures: dict[str, float]) -> str:
    if "sharp_rms_px" not in figures:
        return "a network that finds no ball yet; train it longer, the same command with more --hours continues"
    return (
        f"recall {figures['recall']:.1%}, precision {figures['precision']:.1%}, centres "
        f"{figures['sharp_rms_px']:.2f} px RMS per axis on held-out rendered images"
    )


def _summarize_streaks(figures: dict[str, float]) -> str:
    along, across, reference = figures["along"], figures["across"], (figures["shown_along"], figures["shown_across"])
    before = f"by the ball network alone {reference[0]:.2f} and {reference[1]:.2f}"
    longer = (
        "; it is worse than the ball network: train it longer" if along > reference[0] or across > reference[1] else ""
    )
    return (
        f"middles of {figures['streaks']:.0f} streaks in held-out rendered images miss by {along:.2f} ball radii "
        f"RMS along them and {across:.2f} across, {before}{longer}"
    )


def _summarize_discs(figures: dict[str, float]) -> str:
    return (
        f"centres of {figures['discs']:.0f} balls at rest in held-out rendered images miss by "
        f"{figures['right']:.3f} ball radii RMS across and {figures['down']:.3f} down"
    )


def _summarize_flying(figures: dict[str, float]) -> str:
    return (
        f"recall {figures['recall']:.1%}, precision {figures['precision']:.1%} of spots that are the object, centres "
        f"{figures['rms_px']:.2f} px RMS per axis in rendered rallies"
    )


SUMMARIES = {
    NetworkPart.BALLS: _summarize_balls,
    NetworkPart.STREAKS: _summarize_streaks,
    NetworkPart.DISCS: _summarize_discs,
    NetworkPart.FLYING: _summarize_flying,
}
