"""`trueroll put-back`: where the balls of a shot lay, to lay them there again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.core.answer import Answer
from models.core.errors import TableNotFound
from pipeline.actions.placement_views import read_camera, write_live_page, write_state, write_wanted_places
from pipeline.actions.put_back import PlacementGuide, WantedPlaces, locate_wanted_places, read_wanted_frame
from pipeline.engine.atomic_write import parse_output_path, require_writable_folder
from pipeline.io.image_file import read_image
from pipeline.io.run_folder import read_scene_document
from pipeline.io.run_views import read_shot_record
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore


@answer_command("put-back")
def put_back(
    folder: Annotated[cli.AnyPath, typer.Argument(metavar="DIR")],
    *,
    at: Annotated[float | None, typer.Option(metavar="T")] = None,
    out: cli.OutBesideOption = None,
    live: Annotated[cli.AnyPath | int | None, typer.Option(metavar="CAMERA|IMAGE")] = None,
    updates: Annotated[int | None, typer.Option(min=1)] = None,
    clip: cli.AnyPath | None = None,
    on_answer: Callable[[Answer], None] = ignore,
) -> Answer:
    """Show where every ball lay at a time, with its distances to the cushions, to lay the balls there again.

    With `--live` the balls of a present image are matched with these places: rings mark them, with the millimetres and
    the direction that are missing; within 2 mm a ring is green.

    Args:
        folder: Folder of a run.
        at: Time of the places, in s. Default: just before the strike.
        live: Number of a camera (0 is the first), or a present image of the same view: the moves still missing.
        updates: Number of images of a camera. Default: until interrupted.
        clip: Video of the shot. Default: the one that the run noted.
    """
    place = Path(folder)
    target = place if out is None else parse_output_path(out)
    require_writable_folder(target)
    wanted = locate_wanted_places(read_shot_record(place), at)
    wanted = read_wanted_frame(wanted, place, None if clip is None else Path(clip))
    answer = write_wanted_places(wanted, target)
    answers = iter([answer]) if live is None else _follow_live(wanted, place, str(live), updates, target, answer)
    for answer in answers:
        on_answer(answer)
    return answer


def _follow_live(
    wanted: WantedPlaces, folder: Path, live: str, updates: int | None, target: Path, first: Answer
) -> Iterator[Answer]:
    """Compare a present image, or those of a camera, with the wanted places."""
    image = None if live.isdecimal() else read_image(Path(live))  # before the models are loaded
    cloth = read_scene_document(folder / "scene.json")["table"].get("cloth_lab")
    guide = PlacementGuide.prepare(wanted, np.array(cloth if cloth else [40.0, -30.0, 10.0], float))
    if image is not None:
        yield write_state(wanted, guide.compare_image(image), target, first)
        return
    images = read_camera(int(live), guide.camera.width_px, guide.camera.height_px)
    images = chain([next(images)], images)  # an error of the camera comes before the page
    cli.console.print(f"Open {write_live_page(target, folder.name)}; Ctrl-C ends it", markup=False)
    for present in islice(images, updates):
        try:
            yield write_state(wanted, guide.compare_image(present), target, first)
        except TableNotFound as error:  # such as a hand before the lens
            sentence = str(error)
            yield replace(first, sentences=(sentence,), document={**first.document, "live": {"note": sentence}})
