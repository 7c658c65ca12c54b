"""trueroll interpolate: the frames between the frames, without any drawing on them; places between places."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from models.core.errors import OptionError
from pipeline.options import RunOptions
from pipeline.terminal.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    app,
    console,
    named,
    open_cache,
    standard_output,
    with_settings_but,
)

if TYPE_CHECKING:
    from pipeline.actions.interpolate_clip import InterpolateOptions

MOST = 100
VIDEOS = (".mp4", ".m4v", ".mov")
DRAWN = ("slow", "trim_still", "style")
"""Settings of the annotated slow motion."""


@app.command("interpolate")
@with_settings_but(DRAWN)
def interpolate(
    source: Annotated[
        Path, typer.Argument(metavar="CLIP|tracks.csv", help="A clip of a shot, or particles: columns id, x, y (z), t.")
    ],
    options: RunOptions,
    out: Annotated[
        Path,
        typer.Option("-o", "--out", parser=named, metavar="PATH", help="The video or .csv, or a folder for it."),
    ],
    factor: Annotated[
        int | None, typer.Option("--factor", min=1, max=MOST, help="Steps from picture to picture.")
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            "--rate", help="Pictures per second of the video, 24 to 240, such as 60 or 60000/1001; no factor."
        ),
    ] = None,
    slow: Annotated[
        float, typer.Option("--slow", min=1, max=MOST, help="Times slower than the clip; 1: in its own time.")
    ] = 1.0,
    shutter: Annotated[
        float | None,
        typer.Option(
            "--shutter", help="Motion blur: degrees, 0 to 360, of the step between pictures. Default: as it was filmed."
        ),
    ] = None,
    upright: Annotated[bool, typer.Option("--upright", help="A window of 9:16 that follows the action.")] = False,
    elsewhere: Annotated[
        str,
        typer.Option("--elsewhere", help="Where no ball is: flow, blend, or an ONNX network for frame interpolation."),
    ] = "flow",
    frames: Annotated[
        Path | None, typer.Option("--frames", help="A new folder for every picture as 000000.png and so on.")
    ] = None,
    cache: CacheOption = None,
    as_json: JsonOption = False,
    debug: DebugOption = False,
) -> None:
    """The frames between the frames, balls where the physics puts them; the originals stay as they are.

    Given a tracks.csv of any particles: their motion between their samples.
    """
    if source.suffix.lower() == ".csv" or (source / "tracks.csv").is_file():
        from pipeline.actions.interpolate_particles import interpolate_particles

        if factor is None:
            raise OptionError("--factor says how many steps lie between two samples; give it")
        fps = options.read.fps
        interpolate_particles(source, factor, out, None if fps is None else float(Fraction(fps)), as_json)
        return
    from pipeline.actions.interpolate_clip import InterpolateOptions

    wanted = InterpolateOptions(factor, None if rate is None else _rate(rate), slow, shutter, upright, elsewhere)
    _interpolate_clip(source, _video(source, out, wanted), frames, wanted, options, cache, as_json)


def _rate(text: str) -> Fraction:
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError) as error:
        raise OptionError(f"--rate is a number such as 60, 59.94 or 60000/1001; got {text}") from error


def _interpolate_clip(
    clip: Path,
    video: Path,
    frames: Path | None,
    wanted: InterpolateOptions,
    options: RunOptions,
    cache: Path | None,
    as_json: bool,
) -> None:
    from pipeline.actions.interpolate_clip import interpolate_clip
    from pipeline.reporting.text.run_trust import trust_facts, trust_line
    from pipeline.terminal.progress_display import StageDisplay

    with StageDisplay(console, str(clip)) as display:
        made = interpolate_clip(clip, video, frames, wanted, options, open_cache(cache), display)
    for note in made.notes:
        console.print(f"Note: {note}", markup=False, soft_wrap=True)
    if as_json:
        trust = trust_facts(made.trust)
        facts = {"pictures": made.pictures, "originals": made.originals, "rate": made.rate, "trust": trust}
        print(json.dumps({"file": str(video), "frames": str(frames) if frames else None, **facts}, allow_nan=False))
        return
    standard_output().print(trust_line(made.trust))
    print(f"{made.pictures} pictures, {made.originals} of them original, {made.rate:.3f} a second: {video}")


def _video(clip: Path, out: Path, wanted: InterpolateOptions) -> Path:
    """Where the video goes; OptionError for a name of another kind."""
    if out.is_dir() or not out.suffix:
        ending = f"x{wanted.factor}" if wanted.factor is not None else f"{float(wanted.rate or 0):g}fps"
        return out / f"{clip.stem}-{ending}.mp4"
    if out.suffix.lower() not in VIDEOS:
        raise OptionError(f"-o is a video ({', '.join(VIDEOS)}) or a folder; got {out}")
    return out
