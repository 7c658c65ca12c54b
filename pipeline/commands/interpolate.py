"""trueroll interpolate: the frames between the frames, without any drawing on them; places between places."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from models.errors import OptionError
from pipeline.command_line import (
    CacheOption,
    DebugOption,
    JsonOption,
    app,
    console,
    named,
    open_cache,
    with_settings,
)
from pipeline.options import RunOptions

MOST = 100
VIDEOS = (".mp4", ".m4v", ".mov")


@app.command("interpolate")
@with_settings
def interpolate(
    source: Annotated[
        Path, typer.Argument(metavar="CLIP|tracks.csv", help="A clip of a shot, or particles: columns id, x, y (z), t.")
    ],
    options: RunOptions,
    factor: Annotated[int, typer.Option("--factor", min=1, max=MOST, help="Steps from picture to picture.")],
    out: Annotated[
        Path,
        typer.Option("-o", "--out", parser=named, metavar="PATH", help="The video or .csv, or a folder for it."),
    ],
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
        from pipeline.particle_interpolation import interpolate_particles

        fps = options.read.fps
        interpolate_particles(source, factor, out, None if fps is None else float(Fraction(fps)), as_json)
        return
    _interpolate_clip(source, _video(source, out, factor), frames, factor, options, cache, as_json)


def _interpolate_clip(
    clip: Path, video: Path, frames: Path | None, factor: int, options: RunOptions, cache: Path | None, as_json: bool
) -> None:
    from pipeline.display import StageDisplay
    from pipeline.interpolate import interpolate_clip
    from pipeline.verdict import trust_facts, trust_line

    with StageDisplay(console, str(clip)) as display:
        made = interpolate_clip(clip, video, frames, factor, options, open_cache(cache), display)
    for note in made.notes:
        console.print(f"Note: {note}", markup=False, soft_wrap=True)
    if as_json:
        trust = trust_facts(made.trust)
        facts = {"pictures": made.pictures, "originals": made.originals, "rate": made.rate, "trust": trust}
        print(json.dumps({"file": str(video), "frames": str(frames) if frames else None, **facts}, allow_nan=False))
        return
    Console(highlight=False).print(trust_line(made.trust))
    print(f"{made.pictures} pictures, {made.originals} of them original, {made.rate:.3f} a second: {video}")


def _video(clip: Path, out: Path, factor: int) -> Path:
    """Where the video goes; OptionError for a name of another kind."""
    if out.is_dir() or not out.suffix:
        return out / f"{clip.stem}-x{factor}.mp4"
    if out.suffix.lower() not in VIDEOS:
        raise OptionError(f"-o is a video ({', '.join(VIDEOS)}) or a folder; got {out}")
    return out
