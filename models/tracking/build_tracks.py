"""Tracks from detections, through contacts, gaps and pockets.

Tracking works in metres on the table: a ball at rest stays, a free ball goes straight, and whatever changes a velocity
is near. `models.tracking.track_hypotheses` decides identities.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.detections import Detections, MarkedDetections
from models.core.errors import TrackError
from models.core.options import TrackOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.tracking.appearance import summarize_appearance
from models.tracking.ball_classes import assign_ids, classify_balls, find_struck_ball
from models.tracking.clutter_filter import is_ball, looks_like_ball, moves_like_ball
from models.tracking.hand_edits import (
    EditedBall,
    TrackPixels,
    edit_tracks,
    find_false_detections,
    keep_placed_balls,
    set_classes,
    set_names,
)
from models.tracking.identity_switches import correct_identity_switches
from models.tracking.table_detections import project_detections
from models.tracking.track_completion import complete_tracks
from models.tracking.track_hypotheses import track_balls
from models.tracking.tracklet_linking import Tracklet, cut_tracklets, link_tracklets

CAROM_BALLS = 3
MIN_FRAMES = 5


def build_tracks(
    detections: Detections | MarkedDetections,
    frame: IntArray,
    t: FloatArray,
    scene: Scene,
    options: TrackOptions = TrackOptions(),
    progress: Progress = ignore_progress,
    corrections: Corrections = NO_CORRECTIONS,
) -> Tracks:
    """Build the tracks of all balls from detections.

    Args:
        detections: Detections of all frames, px, with those that a person placed.
        frame: (T,) numbers of the distinct frames.
        t: (T,) presentation times of these frames, s.
        scene: Table, camera and cloth colour.
        options: Breadth, patience and number of balls.
        progress: Called with the finished share of the work.
        corrections: What a person corrected: false balls and edits of tracks.

    Returns:
        Tracks of N balls over T frames. Every detection belongs to at most one ball.

    Raises:
        TrackError: If the clip has too few frames, or no track looks like a ball.
        ValueError: If `frame` and `t` differ in length.
    """
    if len(frame) != len(t):
        raise ValueError(f"one time per frame is needed; got {len(t)} times for {len(frame)} frames")
    if len(frame) < MIN_FRAMES:
        raise TrackError(f"Tracking needs at least {MIN_FRAMES} distinct frames; the clip has {len(frame)}.")
    marked = detections if isinstance(detections, MarkedDetections) else _mark_none(detections)
    balls, pixels = _find_balls(marked, frame, t, scene, options, progress)
    first = [pixels.table_detections.row[ball.row] for ball in balls]  # rows of the detections
    used = former = _assign_first_ids(balls, pixels, marked.mark, scene)
    is_false = find_false_detections(balls, [one for one in corrections.balls if one.kind == "false"], pixels)
    if is_false.any():  # again without them: they took part in the assignment
        marked = MarkedDetections(marked.detections.select_rows(~is_false), marked.mark[~is_false])
        balls, pixels = _find_balls(marked, frame, t, scene, options, progress)
        now = [np.flatnonzero(~is_false)[pixels.table_detections.row[ball.row]] for ball in balls]
        shared = np.array([[len(np.intersect1d(one, two)) for two in first] for one in now])
        pairs = zip(*linear_sum_assignment(-shared), strict=True)
        same = {one: used[two] for one, two in pairs if shared[one, two]}
        former = tuple(same.get(number, "") for number in range(len(balls)))
    return _make_tracks(edit_tracks(balls, corrections.tracks, pixels, former), pixels, scene, used)


def _assign_first_ids(balls: Sequence[Tracklet], pixels: TrackPixels, mark: IntArray, scene: Scene) -> tuple[str, ...]:
    """Assign the ids before a correction, last to the balls that a person placed: these rename no other."""
    xy, kinds = _classify(balls, pixels, scene)[:2]
    is_placed = [np.mean(mark[pixels.table_detections.row[ball.row]] >= 0) > 0.5 for ball in balls]
    return assign_ids(kinds, np.where(np.array(is_placed)[:, None], np.inf, xy))


def _classify(
    balls: Sequence[Tracklet], pixels: TrackPixels, scene: Scene
) -> tuple[FloatArray, tuple[str, ...], FloatArray]:
    """Return the first places (N, 2), the classes and the colours (N, 3) of balls."""
    table_detections = pixels.table_detections
    rows = [table_detections.row[ball.row] for ball in balls]
    appearance = summarize_appearance([ball.colour for ball in balls], rows, pixels.detections)
    struck_ball = find_struck_ball(
        [(ball.frame_index, table_detections.xy[ball.row]) for ball in balls], scene.table.ball_radius
    )
    kinds = classify_balls(appearance, scene.table.game, struck_ball)
    return np.array([table_detections.xy[ball.row[0]] for ball in balls]), kinds, appearance.colour


def _mark_none(detections: Detections) -> MarkedDetections:
    return MarkedDetections(detections, np.full(len(detections), -1, np.int64))


def _find_balls(
    marked: MarkedDetections, frame: IntArray, t: FloatArray, scene: Scene, options: TrackOptions, progress: Progress
) -> tuple[list[Tracklet], TrackPixels]:
    """Find the tracks of all balls; those that a person placed need not look or move like one."""
    detections = marked.detections
    table_detections = project_detections(detections, frame, scene)
    pixels = TrackPixels(table_detections, detections, frame, t)
    is_marked = marked.mark[table_detections.row] >= 0

    def is_placed(tracklet: Tracklet) -> bool:
        return bool(is_marked[tracklet.row].any())

    chains = track_balls(table_detections, t, scene.table, options.breadth, options.patience, progress)
    tracklets = [
        tracklet
        for tracklet in cut_tracklets(chains, table_detections, t)
        if is_placed(tracklet) or looks_like_ball(tracklet, table_detections, t, scene)
    ]
    linked = link_tracklets(tracklets, table_detections, t, scene.table)
    likely = [tracklet for tracklet in linked if is_placed(tracklet) or is_ball(tracklet, table_detections, t, scene)]
    balls = [
        tracklet
        for tracklet in likely
        if is_placed(tracklet)
        or moves_like_ball(
            tracklet, [other for other in likely if other is not tracklet], table_detections, t, scene.table
        )
    ]
    if not scene.table.pockets:
        balls = _select_lasting_balls(balls, len(t))
    if options.balls:
        balls = sorted(balls, key=lambda tracklet: -len(tracklet.frame_index))[: options.balls]
    balls = keep_placed_balls(balls, marked.mark, pixels)
    if not balls:
        raise TrackError(
            f"Tracking needs balls that are detected in several frames; {len(detections)} detections contain none: "
            "check the calibration of the table, or give --corners and --ball-radius."
        )
    balls = complete_tracks(balls, table_detections, t, scene.table)
    return correct_identity_switches(balls, table_detections, t, scene.table.ball_radius), pixels


def _select_lasting_balls(balls: list[Tracklet], frame_count: int) -> list[Tracklet]:
    """Select the tracklets of a table without pockets: beyond the three of carom, only those present in most frames."""
    ranked = sorted(balls, key=lambda tracklet: -len(tracklet.frame_index))
    lasting = [
        tracklet for k, tracklet in enumerate(ranked) if k < CAROM_BALLS or len(tracklet.frame_index) > frame_count / 2
    ]
    return [tracklet for tracklet in balls if any(tracklet is other for other in lasting)]


def _make_tracks(edited: list[EditedBall], pixels: TrackPixels, scene: Scene, used: Sequence[str]) -> Tracks:
    """Make the columns of `Tracks`; balls are ordered by class and id."""
    balls = [one.tracklet for one in edited]
    table_detections, detections, frame, t = pixels.table_detections, pixels.detections, pixels.frame, pixels.t
    places, seen_kinds, colour = _classify(balls, pixels, scene)
    kinds = set_classes(seen_kinds, edited, scene.table.game)
    ids = set_names(assign_ids(kinds, places, [one.former for one in edited], used), edited)
    order = sorted(range(len(balls)), key=lambda i: (kinds[i], len(ids[i]), ids[i]))
    shape = (len(frame), len(balls))
    xy, px, streak = (np.full((*shape, 2), np.nan) for _ in range(3))
    sigma, along, radius = (np.full(shape, np.nan) for _ in range(3))
    lay = np.full((*shape, 2, 2), np.nan)
    for column, i in enumerate(order):
        index, row = balls[i].frame_index, balls[i].row
        source = table_detections.row[row]
        xy[index, column], streak[index, column] = table_detections.xy[row], table_detections.streak[row]
        px[index, column], radius[index, column] = detections.centre[source], detections.radius[source]
        scale, lay[index, column] = table_detections.scale[row], table_detections.lay[row]
        sigma[index, column] = detections.sigma[source] * scale
        along[index, column] = detections.sigma_along[source] * scale
    return Tracks(
        frame, t, tuple(ids[i] for i in order), tuple(kinds[i] for i in order), xy, px, sigma, along, streak, radius,
        colour[order], lay,
    )  # fmt: skip
