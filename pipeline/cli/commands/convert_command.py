"""`trueroll convert`: tracks between the formats of other programs and ours."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.core.errors import OptionError
from pipeline.engine.atomic_write import parse_output_path
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command


@answer_command("convert")
def convert(
    source: Annotated[cli.AnyPath, typer.Argument(metavar="INPUT")],
    *,
    out: Annotated[cli.AnyPath, cli.OUT],
    read_as: Annotated[str | None, typer.Option("--from")] = None,
    write_as: Annotated[str | None, typer.Option("--to")] = None,
    fps: float | None = None,
    px_per_m: float | None = None,
    size: float | None = None,
    scene: str | None = None,
) -> Answer:
    """Convert tracks: Tracker, MOT, COCO, Label Studio, DeepLabCut, SLEAP, pooltool, Parquet, MCAP, track folders.

    Args:
        source: A file of tracks, a track folder, or the folder of a run.
        out: The file to write, whose ending names the format, such as .trk, .coco.json or .parquet; a folder for a
            track folder.
        read_as: Format of INPUT. Default: recognised by its content.
        write_as: Format of the output. Default: that of its ending.
        fps: Frame rate of tracks without times, in frames per second.
        px_per_m: Scale of the image, for formats in px or in m, in px per m.
        size: Diameter of bodies whose boxes are not known, in px.
        scene: Scene of the track folder: billiards, flight, pendulum, slide or particles.
    """
    from pipeline.actions.convert_tracks import ConvertOptions, convert_tracks  # slow to import

    for name, value in (("--fps", fps), ("--px-per-m", px_per_m), ("--size", size)):
        if value is not None and not 0 < value < 1e9:
            raise OptionError(f"{name} is above 0; got {value:g}")
    target = parse_output_path(out)
    options = ConvertOptions(fps, px_per_m, size, scene)
    tracks, origin, output = convert_tracks(Path(source), target, options, read_as, write_as)
    count, bodies = len(tracks.columns["id"]), len(tracks.ids)
    return Answer(
        f"What is in {Path(source).name}?",
        (f"{count} positions of {bodies} {'body' if bodies == 1 else 'bodies'}: {origin.title} to {output.title}.",),
        notes=tuple(f"Note: {note}." for note in tracks.notes),
        document={"file": str(target), "from": origin.name, "to": output.name, "positions": count,
                  "bodies": tracks.ids, "notes": list(tracks.notes)},
        figures=(str(target),),
    )  # fmt: skip
