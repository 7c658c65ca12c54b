"""`trueroll interpolate`: in-between frames of a clip with nothing drawn on them, or positions of particles."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from models.core.errors import OptionError
from pipeline.engine.result_cache import open_cache
from pipeline.run_options import RunOptions, build_options, list_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings

if TYPE_CHECKING:
    from pipeline.actions.interpolate_clip import InterpolateOptions

MAX_FACTOR = 100
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov")
# Settings of the annotated slow motion and of the report, which do not apply here.
OVERLAY_SETTINGS = ("slow", "trim_still", "style", "quick", "no_video", "laws")


@cli.command("interpolate")
@add_settings(list_settings(), build_options, OVERLAY_SETTINGS)
def interpolate(
    source: Annotated[Path, typer.Argument(metavar="CLIP|tracks.csv")],
    options: RunOptions,
    out: Annotated[Path, cli.OUT],
    factor: Annotated[int | None, typer.Option(min=1, max=MAX_FACTOR)] = None,
    rate: str | None = None,
    slow: Annotated[float, typer.Option(min=1, max=MAX_FACTOR)] = 1.0,
    shutter: float | None = None,
    upright: bool = False,
    frames: Path | None = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Compute in-between frames, with balls where the fitted motion puts them; original frames are unchanged.

    For a tracks.csv of any particles, compute positions between the samples.

    Args:
        source: A clip of a shot, or particles: columns id, x, y (z), t.
        out: The video or .csv file, or a folder for it.
        factor: Number of steps from frame to frame.
        rate: Frame rate of the video instead of --factor, 24 to 240 frames per second, such as 60 or 60000/1001.
        slow: Slow-down factor relative to the clip; 1: original speed.
        shutter: Shutter angle of the motion blur, 0 to 360 degrees of the time between frames. Default: as filmed.
        upright: Write a 9:16 window that follows the action.
        frames: New folder for all frames as 000000.png and so on.
    """
    if source.suffix.lower() == ".csv" or (source / "tracks.csv").is_file():
        from pipeline.actions.particle_motion import interpolate_particles
        from pipeline.terminal.progress_display import show_activity  # numba is slow to import

        if factor is None:
            raise OptionError("--factor is missing: the number of steps from sample to sample")
        if out.suffix.lower() in VIDEO_SUFFIXES:
            raise OptionError(f"-o is a folder where the input is tracks; got {out}. Name the clip to make a video")
        fps = None if options.read.fps is None else float(Fraction(options.read.fps))
        with show_activity(cli.console) as on_activity:
            answer = interpolate_particles(source, factor, out, fps, on_activity)
        cli.print_answer(answer, as_json)
        return
    from pipeline.actions.interpolate_clip import InterpolateOptions, interpolate_clip
    from pipeline.chain import explain_clip
    from pipeline.reporting.text.text_formatting import format_trust_line, summarize_trust
    from pipeline.stages.read_stage import open_frame_memory
    from pipeline.terminal.progress_display import StageDisplay

    try:
        wanted = InterpolateOptions(factor, None if rate is None else Fraction(rate), slow, shutter, upright)
    except (ValueError, ZeroDivisionError) as error:
        raise OptionError(f"--rate is a number such as 60, 59.94 or 60000/1001; got {rate}") from error
    video = _choose_video_path(source, out, wanted)
    with StageDisplay(cli.console, str(source)) as display:
        store = open_cache(cache)
        result = interpolate_clip(
            source, video, frames, wanted,
            lambda: explain_clip(source, options, store, display, open_frame_memory()),
            display, with_sound=options.read.fps is None,  # --fps overrides the times that the sound follows
        )  # fmt: skip
    for note in result.notes:
        cli.print_note(f"Note: {note}")
    if as_json:
        places = {"file": str(video), "frames": str(frames) if frames else None}
        counts = {"pictures": result.frame_count, "originals": result.original_count, "rate": result.rate}
        print(json.dumps({**places, **counts, "trust": summarize_trust(result.trust)}, allow_nan=False))
        return
    cli.make_output_console().print(format_trust_line(result.trust))
    print(
        f"{result.frame_count} frames, {result.original_count} of them original, {result.rate:.3f} per second: {video}"
    )


def _choose_video_path(clip: Path, out: Path, wanted: InterpolateOptions) -> Path:
    """Return the path of the video; raises OptionError for another kind of file."""
    if out.is_dir() or not out.suffix:
        ending = f"x{wanted.factor}" if wanted.factor is not None else f"{float(wanted.rate or 0):g}fps"
        return out / f"{clip.stem}-{ending}.mp4"
    if out.suffix.lower() not in VIDEO_SUFFIXES:
        raise OptionError(f"-o is a video ({', '.join(VIDEO_SUFFIXES)}) or a folder; got {out}")
    return out
