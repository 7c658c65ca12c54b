"""Files, drawings and pages of `trueroll put-back`, and the loop over a live camera."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from models.core.answer import Answer, Quantity
from models.core.errors import OptionError
from models.core.naming import Naming
from models.core.number_format import format_measured, format_moment, format_speed, format_with_sigma
from models.core.scene import CUSHIONS, NOSE_HEIGHT_RADII, Table
from models.core.typing import FloatArray, ImageArray
from models.estimation.ball_places import BallPlaces, find_nearest_cushions, measure_cushion_distances
from pipeline.actions.put_back import PLACED_M, PlacementState, WantedPlaces
from pipeline.engine.atomic_write import replace_file, write_text
from pipeline.io.image_file import write_image
from pipeline.io.strict_json import write_json
from pipeline.reporting.pages.page_template import render_template
from video.drawing.palette import WHITE, Colour
from video.overlay.placement_overlay import (
    MISPLACED_COLOUR,
    MISSING_COLOUR,
    NOTE_COLOUR,
    PLACED_COLOUR,
    WANTED_COLOUR,
    PlacedRing,
    draw_placement_plan,
    draw_places,
)

FRAME_IMAGE, PLAN_IMAGE = "put_back_frame.png", "put_back_plan.png"
LIVE_IMAGE, LIVE_TABLE, LIVE_PAGE = "live.png", "live.json", "live.html"
# Decimals of a distance: nobody places a ball to a hundredth of a millimetre.
MAX_DECIMALS_MM = 1


def write_wanted_places(wanted: WantedPlaces, folder: Path) -> Answer:
    """Write the tables, the plan and the frame of the wanted places.

    Args:
        wanted: The places.
        folder: Folder of the files; created if it does not exist.

    Returns:
        Where every ball lay.
    """
    answer = state_wanted_places(wanted)
    write_places({name: value for name, value in answer.document.items() if name != "no_frame"}, folder)
    figures = [folder / PLAN_IMAGE]
    write_image(_draw_wanted_plan(wanted), figures[0])
    drawn = _draw_wanted_frame(wanted)
    if drawn is not None:
        figures.append(folder / FRAME_IMAGE)
        write_image(drawn, figures[1])
    return replace(answer, figures=tuple(map(str, figures)))


def state_wanted_places(wanted: WantedPlaces) -> Answer:
    """State where every ball lay in words and numbers, without images."""
    places, naming = wanted.places, wanted.naming
    document = describe_places(places, wanted.place_sigma, wanted.table, wanted.frame)
    document["no_frame"] = wanted.no_image or None
    absent = f"Not on the table: {', '.join(map(naming.name_ball, places.absent))}." if places.absent else ""
    left, right, top, bottom = map(naming.view.name_rail, CUSHIONS)
    return Answer(
        f"Where did the balls lie at {format_moment(places.t)}?",
        (f"Where the balls lay at {format_moment(places.t)}, in mm from the centre of each ball to the noses of the"
         f" {naming.rail_word}s, ± standard deviation:",),
        quantities=tuple(
            Quantity(axis, float(xy[k]), float(sigma[k]), "m", ball, naming.name_ball(ball))
            for ball, xy, sigma in zip(places.ids, places.xy, wanted.place_sigma, strict=True)
            for k, axis in enumerate("xy")
        ),
        rows=(
            ("ball", left, right, "±", top, bottom, "±", ""),
            *(_list_place_cells(ball, naming) for ball in document["balls"]),
        ),
        notes=tuple(filter(None, (absent, wanted.no_image and f"No image of the clip: {wanted.no_image}"))),
        document=document,
    )  # fmt: skip


def format_nearest_cushions(wanted: WantedPlaces, ball: int) -> str:
    """Format the distances of a ball (its index) to the two nearest cushions in mm, such as `left 512, far 300`."""
    own = 1e3 * measure_cushion_distances(wanted.table, wanted.places.xy[ball : ball + 1])[0]
    return ", ".join(f"{wanted.naming.view.name_rail(CUSHIONS[k])} {own[k]:.0f}" for k in find_nearest_cushions(own))


def format_place_from_rails(wanted: WantedPlaces, ball: int) -> str:
    """Format where a ball (its index) lay, such as `512.0 ± 0.8 mm from the left short rail, 300 ± 1 mm from ...`."""
    own, sigma = measure_cushion_distances(wanted.table, wanted.places.xy[ball : ball + 1])[0], wanted.place_sigma[ball]
    return ", ".join(
        f"{format_with_sigma(1e3 * float(own[k]), 1e3 * float(sigma[k // 2]), MAX_DECIMALS_MM)} mm from the"
        f" {wanted.naming.name_rail(CUSHIONS[k])}"
        for k in find_nearest_cushions(own)
    )


def _list_place_cells(ball: dict[str, Any], naming: Naming) -> tuple[str, ...]:
    """List the cells of a ball in the table of places."""
    cells = [naming.name_ball(ball["id"])]
    for axis, sides in (("x", CUSHIONS[:2]), ("y", CUSHIONS[2:])):
        texts = [format_measured(ball[f"{side}_mm"], ball[f"{axis}_sigma_mm"], MAX_DECIMALS_MM) for side in sides]
        cells += [*(value for value, _ in texts), texts[0][1]]
    return *cells, f"moves at {format_speed(ball['speed'])}" if ball["speed"] else ""


def _draw_wanted_plan(wanted: WantedPlaces) -> ImageArray:
    """Draw the plan of the wanted places."""
    places, table = wanted.places, wanted.table
    title = (
        f"{format_moment(places.t)}: mm from the centre of each ball to the noses of its two nearest"
        f" {wanted.naming.rail_word}s; the gap at the nose is {1e3 * table.ball_radius:.1f} mm less"
    )
    distances = measure_cushion_distances(table, places.xy)
    return draw_placement_plan(table, wanted.naming, places.ids, places.xy, distances, title)


def _draw_wanted_frame(wanted: WantedPlaces) -> ImageArray | None:
    """Draw the wanted places on their frame of the clip; None without a frame or a calibration."""
    if wanted.image is None or wanted.camera is None:
        return None
    view = wanted.naming.view
    rings = [
        PlacedRing(xy, WANTED_COLOUR, f"{wanted.naming.name_ball(name)}: {format_nearest_cushions(wanted, k)}")
        for k, (name, xy) in enumerate(zip(wanted.places.ids, wanted.places.xy, strict=True))
    ]
    note = f"mm from the centre to the nearest {wanted.naming.rail_word}s"
    header: list[tuple[str, Colour]] = [(format_moment(wanted.places.t), WHITE), (note, NOTE_COLOUR)]
    middles = (
        wanted.table.corners[[0, 1, 0, 3]] / 2 + wanted.table.corners[[3, 2, 1, 2]] / 2
    )  # in the order of CUSHIONS
    marks = wanted.camera.to_pixels(middles, NOSE_HEIGHT_RADII * wanted.table.ball_radius)
    names = list(zip(map(view.name_rail, CUSHIONS), marks, strict=True))
    return draw_places(wanted.image, wanted.camera, rings, wanted.table.ball_radius, header, names)


def draw_live_image(wanted: WantedPlaces, state: PlacementState) -> ImageArray:
    """Draw the wanted places and the missing moves on a present image.

    Args:
        wanted: The places.
        state: The present balls.

    Returns:
        Image (H, W, 3).
    """
    moves = state.list_missing_moves(wanted.places)
    rings = []
    names = map(wanted.naming.name_ball, wanted.places.ids)
    for name, xy, move, present in zip(names, wanted.places.xy, moves, state.present, strict=True):
        distance = float(np.hypot(*move))
        if np.isnan(distance):
            rings.append(PlacedRing(xy, MISSING_COLOUR, f"{name} here"))
        elif distance <= PLACED_M:
            rings.append(PlacedRing(xy, PLACED_COLOUR, name))
        else:
            rings.append(PlacedRing(xy, MISPLACED_COLOUR, f"{name} {_format_mm(distance)} mm", present))
    placed = int(np.sum(np.hypot(*moves.T) <= PLACED_M))
    header: list[tuple[str, Colour]] = [
        (
            f"{placed} of {len(rings)} balls lie within {1e3 * PLACED_M:g} mm",
            PLACED_COLOUR if placed == len(rings) else WHITE,
        )
    ]
    if state.note:
        header.append((state.note, MISPLACED_COLOUR))
    if state.extra:
        header.append((f"to be taken away: {', '.join(state.extra)}", MISPLACED_COLOUR))
    return draw_places(state.image, state.camera, rings, wanted.table.ball_radius, header)


def _format_mm(metres: float) -> str:
    """Format a distance in mm: tenths below a hand's breadth, whole ones above."""
    return f"{1e3 * metres:.1f}" if metres < 0.1 else f"{1e3 * metres:.0f}"


def describe_state(wanted: WantedPlaces, state: PlacementState) -> dict[str, Any]:
    """Describe the missing moves as the content of live.json.

    Args:
        wanted: The places.
        state: The present balls.

    Returns:
        The content; `missing_mm` is null for a ball that was not found.
    """
    balls = []
    for name, kind, move in zip(
        wanted.places.ids, wanted.places.kinds, state.list_missing_moves(wanted.places), strict=True
    ):
        distance = 1e3 * float(np.hypot(*move))
        is_found = not np.isnan(distance)
        balls.append(
            {
                "id": name, "kind": kind, "missing_mm": round(distance, 2) if is_found else None,
                "dx_mm": round(1e3 * float(move[0]), 2) if is_found else None,
                "dy_mm": round(1e3 * float(move[1]), 2) if is_found else None,
                "placed": is_found and distance <= 1e3 * PLACED_M, "move": format_move(move, wanted.naming),
            }
        )  # fmt: skip
    return {
        "t": round(wanted.places.t, 6),
        "placed": sum(ball["placed"] for ball in balls),
        "balls": balls,
        "extra": list(state.extra),
        "camera_moved": bool(state.note),
        "camera_shift_px": round(state.shift_px, 2),
        "note": state.note,
    }


def format_move(move: FloatArray, naming: Naming) -> str:
    """Format a move (2,) m, such as `12.0 mm to the right, 3.5 mm to the far rail`."""
    if np.isnan(move).any():
        return "not found"
    parts = [
        f"{_format_mm(abs(float(step)))} mm towards the {naming.name_rail(names[int(step > 0)])}"
        for step, names in zip(move, (("left", "right"), ("top", "bottom")), strict=True)
        if abs(step) >= 5e-5
    ]
    return ", ".join(parts) or "in place"


def write_state(wanted: WantedPlaces, state: PlacementState, folder: Path, first: Answer) -> Answer:
    """Write live.png and live.json, each in one step.

    Args:
        wanted: The places.
        state: The present balls.
        folder: Folder of the files.
        first: Where every ball lay.

    Returns:
        The moves that are missing.
    """
    document, naming = describe_state(wanted, state), wanted.naming
    write_image(draw_live_image(wanted, state), folder / LIVE_IMAGE)
    write_json(document, folder / LIVE_TABLE)
    missing = "; ".join(
        f"{naming.name_ball(ball['id'])} {ball['move']}" for ball in document["balls"] if not ball["placed"]
    )
    count = f"{document['placed']} of {len(document['balls'])} balls are in place"
    extra = f"To be taken away: {', '.join(state.extra)}." if state.extra else ""
    return Answer(
        "Which balls do not lie where they lay?", (f"{count}{missing and f'; {missing}'}.",),
        notes=tuple(filter(None, (state.note, extra))), document={**first.document, "live": document},
        figures=(str(folder / LIVE_IMAGE),),
    )  # fmt: skip


def write_live_page(folder: Path, name: str) -> Path:
    """Write the page that shows live.png and reloads it.

    Args:
        folder: Folder of the files.
        name: Heading of the page.

    Returns:
        Path of the page.
    """
    write_text(folder / LIVE_PAGE, render_template("live.html", name=name, image=LIVE_IMAGE))
    return folder / LIVE_PAGE


def read_camera(number: int, width_px: int, height_px: int) -> Iterator[ImageArray]:
    """Read images from a camera of this computer.

    Args:
        number: Number of the camera, from 0.
        width_px: Width of the images that is asked for.
        height_px: Height of the images that is asked for.

    Yields:
        Images (H, W, 3) RGB, always the newest.

    Raises:
        OptionError: There is no such camera, or it stops.
    """
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # a missing camera is reported below
    capture = cv2.VideoCapture(number)
    try:
        if not capture.isOpened():
            raise OptionError(
                f"--live {number} needs a camera of this number; none could be opened: connect one, or name an image"
            )
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width_px)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height_px)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        while True:
            is_read, bgr = capture.read()
            if not is_read:
                raise OptionError(f"--live {number}: the camera sends no more images; connect it again")
            yield np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
    finally:
        capture.release()


SCHEMA = "trueroll.put-back/1"
COLUMNS = (
    "id", "kind", "x", "y", "sigma", "left_mm", "top_mm", "right_mm", "bottom_mm", "x_sigma_mm", "y_sigma_mm", "speed",
)  # fmt: skip


def describe_places(places: BallPlaces, place_sigma: FloatArray, table: Table, frame: float) -> dict[str, Any]:
    """Describe places as the content of put_back.json.

    Args:
        places: The N balls.
        place_sigma: Standard deviations (N, 2) of x and y relative to the noses, m, calibration included.
        frame: Number of the frame.

    Returns:
        The content; distances are those of the centres of the balls.
    """
    distances = 1e3 * measure_cushion_distances(table, places.xy)
    balls = []  # places to a hundredth of a millimetre
    for k, (name, kind) in enumerate(zip(places.ids, places.kinds, strict=True)):
        own = dict(zip(CUSHIONS, distances[k], strict=True))
        balls.append(
            {
                "id": name, "kind": kind, "x": round(float(places.xy[k, 0]), 5), "y": round(float(places.xy[k, 1]), 5),
                "sigma": round(float(places.sigma[k]), 5),
                **{f"{side}_mm": round(float(own[side]), 2) for side in ("left", "top", "right", "bottom")},
                "x_sigma_mm": round(1e3 * float(place_sigma[k, 0]), 2),
                "y_sigma_mm": round(1e3 * float(place_sigma[k, 1]), 2),
                "speed": None if np.isnan(places.speed[k]) else round(float(places.speed[k]), 4),
            }
        )  # fmt: skip
    return {
        "schema": SCHEMA,
        "t": round(places.t, 6),
        "frame": round(frame, 3),
        "table": {"length": table.length, "width": table.width},
        "ball_radius": table.ball_radius,
        "balls": balls,
        "absent": list(places.absent),
    }


def write_places(document: dict[str, Any], folder: Path) -> None:
    """Write put_back.csv and put_back.json, each in one step.

    Args:
        document: Content of `describe_places`.
        folder: Folder of the files.
    """
    with replace_file(folder / "put_back.csv") as path, path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        rows.writeheader()
        rows.writerows(document["balls"])
    write_json(document, folder / "put_back.json")
