"""Corrections by hand of tracks: false balls, merged, split and exchanged tracks, names and ball classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.corrections import PLACE_RADII, BallMark, BallPlace, TrackEdit
from models.core.detections import Detections
from models.core.scene import Game
from models.core.typing import FloatArray, IntArray
from models.tracking.ball_classes import SNOOKER_COLOURS
from models.tracking.table_detections import TableDetections
from models.tracking.tracklet_linking import Tracklet, make_tracklet

# Frames before the first and after the last detection of a ball in which a place still names it.
END_FRAMES = 5
# Ball classes of which a game has one ball.
SINGLE_CLASSES = {
    "pool": {"cue", "eight"},
    "snooker": set(SNOOKER_COLOURS) - {"red"},
    "carom": {"white", "yellow", "red"},
}


@dataclass(frozen=True, slots=True)
class EditedBall:
    """A ball with what was set by hand."""

    tracklet: Tracklet
    name: str = ""
    """Id that was set by hand; empty for none."""
    kind: str = ""
    """Ball class that was set by hand; empty for none."""
    former: str = ""
    """Id that the ball had before the corrections; empty for a new one."""


@dataclass(frozen=True, slots=True)
class TrackPixels:
    """What is needed to find the balls that places name."""

    table_detections: TableDetections
    detections: Detections
    frame: IntArray
    """(T,) numbers of the distinct frames."""
    t: FloatArray
    """(T,) s."""


def find_ball(balls: Sequence[Tracklet], place: BallPlace, pixels: TrackPixels) -> int | None:
    """Find the ball that a place names.

    Args:
        balls: The tracks.
        place: A place in the image.
        pixels: Detections and frames of the tracks.

    Returns:
        Number of the nearest ball; None if none is within `PLACE_RADII`.
    """
    if not balls:
        return None
    at = int(np.searchsorted(pixels.frame, place.frame, side="right")) - 1
    distances = [_measure_distance(ball, at, place, pixels) for ball in balls]
    nearest = int(np.argmin(distances))
    return nearest if distances[nearest] <= PLACE_RADII else None


def _measure_distance(ball: Tracklet, at: int, place: BallPlace, pixels: TrackPixels) -> float:
    """Return the distance of a ball from a place at frame index `at`, in ball radii; infinite far outside its track."""
    if not ball.frame_index[0] - END_FRAMES <= at <= ball.frame_index[-1] + END_FRAMES:
        return np.inf
    rows = pixels.table_detections.row[ball.row]
    return place.measure_distance(at, ball.frame_index, pixels.detections.centre[rows], pixels.detections.radius[rows])


def find_false_detections(
    balls: Sequence[Tracklet], marks: Sequence[BallMark], pixels: TrackPixels
) -> NDArray[np.bool_]:
    """Find the detections of the tracks that a person marked as false balls.

    Args:
        balls: The tracks.
        marks: Marks of false balls.
        pixels: Detections and frames of the tracks.

    Returns:
        Mask (K,) of rows of the detections.
    """
    is_false = np.zeros(len(pixels.detections), bool)
    for mark in marks:
        number = find_ball(balls, mark.ball, pixels)
        if number is not None:
            within = _is_in_span(balls[number], mark.first, mark.last, pixels)
            is_false[pixels.table_detections.row[balls[number].row[within]]] = True
    return is_false


def keep_placed_balls(balls: list[Tracklet], mark: IntArray, pixels: TrackPixels) -> list[Tracklet]:
    """Add the balls that a person placed and that no track contains.

    Args:
        balls: The tracks.
        mark: (K,) number of the mark that placed a detection; -1 for none.
        pixels: Detections and frames of the tracks.

    Returns:
        The tracks, then one per further mark, of its detections that no track has.
    """
    own = mark[pixels.table_detections.row]
    is_used = np.zeros(len(own), bool)
    for ball in balls:
        is_used[ball.row] = True
    added = []
    for number in np.unique(own[own >= 0]):
        rows = np.flatnonzero(own == number)
        if not is_used[rows].any():
            added.append(_make_tracklet(rows, pixels))
    return [*balls, *added]


def edit_tracks(
    balls: Sequence[Tracklet], edits: Sequence[TrackEdit], pixels: TrackPixels, ids: Sequence[str]
) -> list[EditedBall]:
    """Apply edits to tracks in their order; an edit that names no ball changes nothing.

    Args:
        balls: The tracks.
        pixels: Detections and frames of the tracks.
        ids: Ids of the balls before the corrections.

    Returns:
        The edited tracks.
    """
    edited = [EditedBall(ball, former=former) for ball, former in zip(balls, ids, strict=True)]
    for edit in edits:
        tracklets = [one.tracklet for one in edited]
        one = find_ball(tracklets, edit.ball, pixels)
        two = None if edit.other is None else find_ball(tracklets, edit.other, pixels)
        if one is None or (edit.other is not None and (two is None or two == one)):
            continue
        if edit.kind == "rename":
            edited = [replace(ball, name="") if ball.name == edit.name else ball for ball in edited]
            edited[one] = replace(edited[one], name=edit.name)
        elif edit.kind == "class":
            edited[one] = replace(edited[one], kind=edit.name)
        elif edit.kind == "split":
            edited += _split_ball(edited, one, edit, pixels)
        elif two is not None and edit.kind == "merge":
            edited[one] = replace(edited[one], tracklet=_merge_tracklets(tracklets[one], tracklets[two], pixels))
            del edited[two]
        elif two is not None:
            swapped = _swap_span(tracklets[one], tracklets[two], edit, pixels)
            if swapped is not None:
                for number, tracklet in zip((one, two), swapped, strict=True):
                    edited[number] = replace(edited[number], tracklet=tracklet)
    return edited


def set_classes(kinds: tuple[str, ...], balls: Sequence[EditedBall], game: Game) -> tuple[str, ...]:
    """Set the ball classes that were chosen by hand.

    Args:
        kinds: Classes (N,) by appearance.
        balls: The N balls.
        game: Game that the table is for.

    Returns:
        The classes. Where a game has one ball of a class, the ball that seemed to be it gets the class that the chosen
        ball had.
    """
    chosen = list(kinds)
    for number, ball in enumerate(balls):
        if not ball.kind:
            continue
        if ball.kind in SINGLE_CLASSES[game]:
            for other, kind in enumerate(chosen):
                if other != number and kind == ball.kind and not balls[other].kind:
                    chosen[other] = kinds[number] if kinds[number] != ball.kind else "ball"
        chosen[number] = ball.kind
    return tuple(chosen)


def set_names(ids: tuple[str, ...], balls: Sequence[EditedBall]) -> tuple[str, ...]:
    """Set the ids that were chosen by hand.

    Args:
        ids: Unique ids (N,).
        balls: The N balls.

    Returns:
        Unique ids; a ball whose id was given to another one gets the free id of that one.
    """
    chosen = list(ids)
    for number, ball in enumerate(balls):
        if ball.name and ball.name != chosen[number]:
            if ball.name in chosen:
                chosen[chosen.index(ball.name)] = chosen[number]
            chosen[number] = ball.name
    return tuple(chosen)


def _is_in_span(ball: Tracklet, first: int | None, last: int | None, pixels: TrackPixels) -> NDArray[np.bool_]:
    """Return which detections of a ball are in frames `first` to `last`."""
    frames = pixels.frame[ball.frame_index]
    is_inside = np.ones(len(frames), bool)
    if first is not None:
        is_inside &= frames >= first
    if last is not None:
        is_inside &= frames <= last
    return is_inside


def _make_tracklet(rows: IntArray, pixels: TrackPixels) -> Tracklet:
    """Make a tracklet of rows of the detections on the table, in any order."""
    rows = np.sort(rows)
    frame_index = np.searchsorted(pixels.table_detections.first, rows, side="right") - 1
    return make_tracklet(frame_index, rows, pixels.table_detections, pixels.t)


def _split_ball(edited: list[EditedBall], one: int, edit: TrackEdit, pixels: TrackPixels) -> list[EditedBall]:
    """Cut a track in place at the first frame of its second ball, and return that one."""
    ball = edited[one].tracklet
    is_later = _is_in_span(ball, edit.first, None, pixels)
    if is_later.all() or not is_later.any():
        return []
    edited[one] = replace(edited[one], tracklet=_make_tracklet(ball.row[~is_later], pixels))
    return [EditedBall(_make_tracklet(ball.row[is_later], pixels))]


def _merge_tracklets(ball: Tracklet, other: Tracklet, pixels: TrackPixels) -> Tracklet:
    """Join two tracks; where both have a detection, the first one's counts."""
    is_free = ~np.isin(other.frame_index, ball.frame_index)
    return _make_tracklet(np.concatenate([ball.row, other.row[is_free]]), pixels)


def _swap_span(
    ball: Tracklet, other: Tracklet, edit: TrackEdit, pixels: TrackPixels
) -> tuple[Tracklet, Tracklet] | None:
    """Exchange the detections of two balls in a span of frames; None if nothing of one of them would remain."""
    inside, other_inside = (_is_in_span(one, edit.first, edit.last, pixels) for one in (ball, other))
    mine = np.concatenate([ball.row[~inside], other.row[other_inside]])
    theirs = np.concatenate([other.row[~other_inside], ball.row[inside]])
    if not (inside.any() or other_inside.any()) or not len(mine) or not len(theirs):
        return None
    return _make_tracklet(mine, pixels), _make_tracklet(theirs, pixels)
