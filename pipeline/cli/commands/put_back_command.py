"""`trueroll put-back`: where the balls of a shot lay, to lay them there again."""

from __future__ import annotations

import json
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table as Grid

from pipeline.actions.placement_views import (
    FRAME_IMAGE,
    LIVE_IMAGE,
    PLAN_IMAGE,
    draw_wanted_frame,
    draw_wanted_plan,
    follow_images,
    read_camera,
    write_live_page,
)
from pipeline.actions.put_back import PlacementGuide, WantedPlaces, locate_wanted_places
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.image_file import read_image, write_image
from pipeline.io.placement_files import describe_places, write_places
from pipeline.io.run_folder import read_scene_document
from pipeline.io.run_record import read_shot_record
from pipeline.reporting.text.number_format import format_measured
from pipeline.terminal import command_line as cli

MAX_DECIMALS_MM = 1
"""Decimals of a distance: nobody places a ball to a hundredth of a millimetre."""


@cli.app.command("put-back")
def put_back(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    at: Annotated[
        float | None,
        typer.Option("--at", metavar="T", help="Time of the places, in s. Default: just before the strike."),
    ] = None,
    out: cli.OutBesideOption = None,
    live: Annotated[
        str | None,
        typer.Option(
            "--live",
            metavar="CAMERA|IMAGE",
            help="Number of a camera (0 is the first), or a present image of the same view: the moves still missing.",
        ),
    ] = None,
    updates: Annotated[
        int | None, typer.Option("--updates", min=1, help="Number of images of a camera. Default: until interrupted.")
    ] = None,
    clip: Annotated[
        Path | None, typer.Option("--clip", help="Video of the shot. Default: the one that the run noted.")
    ] = None,
    shot: Annotated[int, typer.Option("--shot", help="Number of the shot in the folder.")] = 0,
    as_json: cli.JsonOption = False,
    debug: cli.DebugOption = False,
) -> None:
    """Show where every ball lay at a time, with its distances to the cushions, to lay the balls there again.

    With `--live` the balls of a present image are matched with these places: rings mark them, with the millimetres and
    the direction that are missing; within 2 mm a ring is green.
    """
    record = read_shot_record(folder, shot)
    target = folder if out is None else out
    require_writable_folder(target)
    wanted = locate_wanted_places(record, folder, at, clip)
    target.mkdir(parents=True, exist_ok=True)
    document = describe_places(wanted.places, wanted.place_sigma, wanted.table, wanted.frame)
    write_places(document, target)
    write_image(draw_wanted_plan(wanted), target / PLAN_IMAGE)
    drawn = draw_wanted_frame(wanted)
    if drawn is not None:
        write_image(drawn, target / FRAME_IMAGE)
    document["no_frame"] = wanted.no_image or None
    if live is None:
        print(json.dumps(document)) if as_json else _print_places(document, target)
        return
    _follow_live(wanted, folder, live, updates, target, document if as_json else None)


def _follow_live(
    wanted: WantedPlaces, folder: Path, live: str, updates: int | None, target: Path, document: dict[str, Any] | None
) -> None:
    """Compare a present image, or those of a camera, with the wanted places; print JSON if `document` is given."""
    is_camera = live.isdecimal()
    image = None if is_camera else read_image(Path(live))  # before the models are loaded
    cloth = read_scene_document(folder / "scene.json")["table"].get("cloth_lab")
    guide = PlacementGuide.prepare(wanted, np.array(cloth if cloth else [40.0, -30.0, 10.0], float))
    images = (
        iter([image]) if image is not None else read_camera(int(live), guide.camera.width_px, guide.camera.height_px)
    )
    if is_camera:
        images = chain([next(images)], images)  # an error of the camera comes before the page
        cli.console.print(f"Open {write_live_page(target, folder.name)}; Ctrl-C ends it", markup=False)
    for state in follow_images(guide, images, target, updates):
        if "balls" not in state and not is_camera:
            cli.console.print(f"trueroll: {state['note']}", markup=False, soft_wrap=True)
            raise typer.Exit(1)
        if document is not None:
            print(json.dumps({**document, "live": state}), flush=True)
        else:
            _print_state(state, target)


def _print_places(document: dict[str, Any], target: Path) -> None:
    screen = cli.make_output_console()
    grid = Grid("ball", "left", "right", "± (x)", "top", "bottom", "± (y)", "", box=None, pad_edge=False)
    for ball in document["balls"]:
        cells = []
        for axis, sides in (("x", ("left", "right")), ("y", ("top", "bottom"))):
            texts = [format_measured(ball[f"{side}_mm"], ball[f"{axis}_sigma_mm"], MAX_DECIMALS_MM) for side in sides]
            cells += [*(value for value, _ in texts), texts[0][1]]
        moving = f"moves at {ball['speed']:.2f} m/s" if ball["speed"] else ""
        grid.add_row(escape(ball["id"]), *cells, moving)
    screen.print(f"{document['t']:.3f} s, mm from the centre of each ball to the noses, ± standard deviation:")
    screen.print(grid)
    if document["absent"]:
        screen.print(escape(f"Not on the table: {', '.join(document['absent'])}"))
    print(f"Look at {target / PLAN_IMAGE}" + (f" and {target / FRAME_IMAGE}" if document["no_frame"] is None else ""))
    if document["no_frame"] is not None:
        print(f"No overlay: {document['no_frame']}")


def _print_state(state: dict[str, Any], target: Path) -> None:
    screen = cli.make_output_console()
    if "balls" not in state:
        screen.print(escape(state["note"]))
        return
    missing = [f"{ball['id']} {ball['move']}" for ball in state["balls"] if not ball["placed"]]
    screen.print(
        escape(f"{state['placed']} of {len(state['balls'])} in place" + "".join(f"; {one}" for one in missing))
    )
    if state["note"]:
        screen.print(escape(state["note"]))
    if state["extra"]:
        screen.print(escape(f"To be taken away: {', '.join(state['extra'])}"))
    screen.print(escape(f"Look at {target / LIVE_IMAGE}"))
