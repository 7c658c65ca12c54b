"""Find the table in a clip: its noses, its preset, and the camera that sees it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.errors import OptionError, TableNotFound
from models.core.progress import Progress, silent
from models.core.scene import Camera, Scene, Table
from models.core.typing import FloatArray, ImageArray
from models.physics.billiards.tables import PRESETS, parse_table, with_ball_radius
from video.calibration.ball_size import ball_sizes
from video.calibration.camera_model import View, camera_from_corners, orient
from video.calibration.camera_motion import camera_moves, follow_camera, reference_of
from video.calibration.cloth_region import find_cloths, intersections, line_through
from video.calibration.cushion_noses import Noses, find_noses
from video.calibration.table_classifier import guess_table, has_snooker_d, pocket_share
from video.io.clip import Clip, read_frames
from video.io.options import CalibrateOptions

GLANCES = 9
"""Pictures spread over the clip whose median is the table without what moves."""
ASPECTS = (1.9, 2.1)
"""Length over width that is still taken for a billiard table."""
LEAST_SUPPORT = 0.6
"""Share of the cloth's sides that must end in a straight line."""
MOST_MISFIT = 40.0
"""Squared standard deviations of shape, cushions and missing lines beyond which a table is not believed."""
GOOD_MISFIT = 8.0
"""With less than that other regions need not be tried."""
UNSUPPORTED_COST = 20.0
"""Squared standard deviations that a cloth whose sides do not end in straight lines costs against another."""
MOST_LOST = 0.1
"""Share of pictures in which a moving camera may be lost."""
MARKED_CORNER_SIGMA = 2.0
"""px, of corners that a user gives."""


@dataclass(frozen=True, slots=True)
class FoundTable:
    """A table in a picture: corners of the noses, in the order of `Table.corners`, and what was met on the way."""

    corners: FloatArray
    covariance: FloatArray
    view: View
    cloth: FloatArray
    outer: FloatArray | None
    notes: tuple[str, ...]
    given: bool = False
    """Whether the user gave the corners."""


def find_scene(clip: Clip, options: CalibrateOptions, progress: Progress = silent) -> Scene:
    """Find table and camera in a clip; the reference picture of a moving camera is the first one.

    TableNotFound, one sentence, where there is none that can be trusted; OptionError where an option makes no sense.
    """
    asked = parse_table(options.table) if options.table is not None else None
    frames = _glance_frames(clip)
    pictures = [picture for _, picture in read_frames(clip, indices=frames)]
    progress(0.3)
    found, background = _look(clip, pictures, options.corners)
    motion, lost = _follow(clip, pictures, found)
    progress(0.7)
    if motion is not None:
        # What stood still in the room is sharp again when every glance is laid over the first one.
        pictures = [_laid_over(picture, motion[frame]) for picture, frame in zip(pictures, frames, strict=True)]
        background = median_picture(pictures)
        found = _found_in(background, clip, options.corners)
    table, named, doubts = _name(found, background, pictures, asked)
    if options.ball_radius is not None:
        table = with_ball_radius(table, options.ball_radius)
    camera = _camera(found, background, table)
    progress(1.0)
    notes = (*found.notes, *named, _height_note(camera, found.view), *_motion_notes(motion, lost))
    return Scene(table, replace(camera, motion=motion), _lab(found.cloth), notes, doubts)


def scene_in_picture(picture: ImageArray, options: CalibrateOptions, name: str = "the picture") -> Scene:
    """Table and camera in one still picture (H, W, 3), as `find_scene` finds them in a clip."""
    asked = parse_table(options.table) if options.table is not None else None
    corners = options.corners
    found = search_picture(picture, name) if corners is None else _from_user(corners, picture)
    table, named, doubts = _name(found, picture, [picture], asked)
    if options.ball_radius is not None:
        table = with_ball_radius(table, options.ball_radius)
    camera = _camera(found, picture, table)
    return Scene(table, camera, _lab(found.cloth), (*found.notes, *named, _height_note(camera, found.view)), doubts)


def _found_in(picture: ImageArray, clip: Clip, corners: str | None) -> FoundTable:
    return search_picture(picture, clip.path.name) if corners is None else _from_user(corners, picture)


def _look(clip: Clip, pictures: list[ImageArray], corners: str | None) -> tuple[FoundTable, ImageArray]:
    """The table in the median of all glances, or in the first one where the camera has moved too much for that."""
    background = median_picture(pictures)
    if corners is not None:
        return _from_user(corners, background), background
    try:
        return search_picture(background, clip.path.name), background
    except TableNotFound:
        return search_picture(pictures[0], clip.path.name), pictures[0]


def _follow(clip: Clip, pictures: list[ImageArray], found: FoundTable) -> tuple[FloatArray | None, int]:
    """Motion of the camera (T, 3, 3), or None where it stands, and the number of pictures that were interpolated."""
    greys = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in pictures]
    reference = reference_of(greys[0], found.corners)
    moves = camera_moves(reference, greys[1:])
    if moves is None:
        raise TableNotFound(
            f"{clip.path.name} does not show one view of the table throughout (a cut, a zoom or somebody in front); "
            "trim it to one shot from one camera"
        )
    if not moves:
        return None, 0
    if not found.given:
        reference = reference_of(greys[0], search_picture(pictures[0], clip.path.name).corners)
    everything = read_frames(clip, indices=np.arange(clip.frame_count), grey=True)
    motion, lost = follow_camera(reference, everything, clip.frame_count)
    if lost > MOST_LOST * clip.frame_count:
        raise TableNotFound(
            f"{clip.path.name} was filmed by a camera that moves and could not be followed in {lost} of "
            f"{clip.frame_count} pictures; film from a fixed place, or trim it"
        )
    return motion, lost


def _laid_over(picture: ImageArray, motion: FloatArray) -> ImageArray:
    """A picture (H, W, 3) as the reference camera would have seen it."""
    height, width = picture.shape[:2]
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpPerspective(picture, motion, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def _motion_notes(motion: FloatArray | None, lost: int) -> tuple[str, ...]:
    if motion is None:
        return ()
    gaps = f"; {lost} pictures between were interpolated" if lost else ""
    return (f"the camera moves and was followed by the rails of the table{gaps}",)


def median_picture(pictures: list[ImageArray]) -> ImageArray:
    """Median (H, W, 3) of pictures: what stood still most of the time."""
    stack = np.stack(pictures)
    half = len(pictures) // 2
    return np.ascontiguousarray(np.partition(stack, half, axis=0)[half])


def _glance_frames(clip: Clip) -> NDArray[np.int64]:
    spread = np.unique(np.linspace(0, len(clip.distinct) - 1, GLANCES).round().astype(int))
    return np.asarray(clip.distinct[spread], np.int64)


def search_picture(picture: ImageArray, name: str = "the picture") -> FoundTable:
    """Find the table in one RGB picture; TableNotFound, a sentence that starts with `name`, where there is none."""
    cloths = [cloth for cloth in find_cloths(picture) if cloth.support > LEAST_SUPPORT]
    if not cloths:
        raise TableNotFound(
            f"{name} shows no cloth with four straight sides; give the corners of the playing surface "
            "with --corners x,y,x,y,x,y,x,y"
        )
    height, width = picture.shape[:2]
    attempts = []
    for cloth in cloths:
        outer, _ = orient(cloth.corners, width, height, 3.0)
        noses = find_noses(picture, outer)
        if noses is not None:
            attempts.append((noses.misfit + UNSUPPORTED_COST * (1 - cloth.support), outer, noses, cloth))
            if attempts[-1][0] < GOOD_MISFIT:
                break
    if not attempts:
        raise TableNotFound(
            f"{name} shows a cloth but not where its cushions end; give the corners of the playing surface "
            "with --corners x,y,x,y,x,y,x,y"
        )
    misfit, outer, noses, cloth = min(attempts, key=lambda attempt: attempt[0])
    if misfit > MOST_MISFIT:
        raise TableNotFound(
            f"{name} shows a cloth whose sides do not look like four equal cushions; give the corners of "
            "the playing surface with --corners x,y,x,y,x,y,x,y"
        )
    corners, view = orient(noses.corners, width, height, _mean_sigma(noses.covariance))
    if not ASPECTS[0] < view.aspect < ASPECTS[1]:
        raise TableNotFound(
            f"{name} shows a cloth {view.aspect:.2f} times as long as wide, and tables are 2; "
            "give the corners of the playing surface with --corners x,y,x,y,x,y,x,y"
        )
    return FoundTable(*_ordered(corners, noses), view, cloth.colour, _like(outer, corners), _edge_notes(noses))


def _ordered(corners: FloatArray, noses: Noses) -> tuple[FloatArray, FloatArray]:
    """Oriented corners with the covariance rolled alike."""
    shift = int(np.argmin(np.linalg.norm(noses.corners - corners[0], axis=1)))
    order = np.roll(np.arange(8).reshape(4, 2), -shift, axis=0).ravel()
    return corners, noses.covariance[np.ix_(order, order)]


def _like(outer: FloatArray, corners: FloatArray) -> FloatArray:
    """Outer corners in the order of the nose corners."""
    return np.roll(outer, -int(np.argmin(np.linalg.norm(outer - corners[0], axis=1))), axis=0)


def _mean_sigma(covariance: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.diag(covariance))))


def _edge_notes(noses: Noses) -> tuple[str, ...]:
    notes = [f"table found by its cloth; corners known to {_mean_sigma(noses.covariance):.1f} px"]
    hidden = 4 - sum(noses.seen)
    if hidden:
        notes.append(f"{hidden} of 4 cushion noses could not be seen and were put where the others say")
    if noses.straightness > 1:
        notes.append(f"cushion noses bend by up to {noses.straightness:.1f} px: the lens distorts, which is left out")
    return tuple(notes)


def _from_user(text: str, background: ImageArray) -> FoundTable:
    height, width = background.shape[:2]
    corners, view = orient(parse_corners(text, width, height), width, height, MARKED_CORNER_SIGMA)
    if not 1.5 < view.aspect < 2.6:
        raise OptionError(
            f"--corners must be those of a table about twice as long as wide; these are {view.aspect:.2f} times"
        )
    inside = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(inside, np.rint(corners).astype(np.int32), 1)
    colour = np.median(background[inside > 0], axis=0).astype(np.float64)
    return FoundTable(
        corners, np.eye(8) * MARKED_CORNER_SIGMA**2, view, colour, None, ("corners were given with --corners",), True
    )


def parse_corners(text: str, width: int, height: int) -> FloatArray:
    """Four corners (4, 2) px, clockwise in the picture, from eight numbers in any order of corners."""
    try:
        numbers = [float(number) for number in text.replace(";", ",").replace(" ", ",").split(",") if number]
    except ValueError:
        numbers = []
    if len(numbers) != 8 or not np.all(np.isfinite(numbers)):
        raise OptionError(f"--corners are eight numbers x,y,x,y,x,y,x,y in px; got {text!r}")
    points = np.array(numbers).reshape(4, 2)
    margin = 0.5 * np.array([width, height])
    if np.any(points < -margin) or np.any(points > np.array([width, height]) + margin):
        raise OptionError(f"--corners must lie in or near the picture of {width} x {height} px; got {text!r}")
    offset = points - points.mean(axis=0)
    ordered = points[np.argsort(np.arctan2(offset[:, 1], offset[:, 0]))]
    edges = np.roll(ordered, -1, axis=0) - ordered
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    # Corners that coincide have no line through them: the turns tell first.
    if np.any(turns < 1.0) or not _meet(ordered):
        raise OptionError(f"--corners must be the four corners of a convex quadrangle; got {text!r}")
    return ordered


def _meet(corners: FloatArray) -> bool:
    """Whether the sides of a quadrangle (4, 2) meet, as lines, in its corners."""
    return intersections([line_through(corners[i], corners[(i + 1) % 4]) for i in range(4)]) is not None


def _name(
    found: FoundTable, background: ImageArray, pictures: list[ImageArray], asked: Table | None
) -> tuple[Table, tuple[str, ...], tuple[str, ...]]:
    """The table's preset (or what was asked for), notes on it, and what else it could be."""
    if asked is not None:
        return asked, ("table size was given with --table",), ()
    trial = PRESETS["pool-9ft"]
    sizes = ball_sizes(pictures, background, _camera(found, background, trial), trial)
    pockets = found.outer is None or pocket_share(background, found.outer, found.corners, found.cloth) > 0.3
    guess = guess_table(sizes, pockets, has_snooker_d(background, found.corners))
    return guess.table, (guess.note, *guess.doubts), guess.doubts


def _camera(found: FoundTable, background: ImageArray, table: Table) -> Camera:
    height, width = background.shape[:2]
    return camera_from_corners(found.corners, found.covariance, table, found.view, width, height)


def _height_note(camera: Camera, view: View) -> str:
    how = "from the perspective" if view.focal_sigma < 0.15 else "assumed, the perspective does not tell"
    return f"camera {camera.height:.2f} +- {camera.height_sigma:.2f} m above the table ({how})"


def _lab(rgb: FloatArray) -> FloatArray:
    pixel = (rgb / 255).astype(np.float32).reshape(1, 1, 3)
    lab: FloatArray = cv2.cvtColor(pixel, cv2.COLOR_RGB2LAB)[0, 0].astype(np.float64)
    return lab
