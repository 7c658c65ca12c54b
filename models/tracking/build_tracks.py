"""Tracks from detections, through contacts, gaps and pockets.

Tracking works in metres on the table: a ball at rest stays, a free ball goes straight, and whatever changes a velocity
is near. `models.tracking.track_hypotheses` decides identities.
"""

from __future__ import annotations

import numpy as np

from models.core.detections import Detections
from models.core.errors import TrackError
from models.core.options import TrackOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.tracking.appearance import summarize_appearance
from models.tracking.ball_classes import assign_ids, classify_balls
from models.tracking.clutter_filter import is_ball, looks_like_ball, moves_like_ball
from models.tracking.cue_ball import find_struck_ball
from models.tracking.identity_switches import correct_identity_switches
from models.tracking.table_detections import TableDetections, project_detections
from models.tracking.track_completion import complete_tracks
from models.tracking.track_hypotheses import track_balls
from models.tracking.tracklet_linking import Tracklet, cut_tracklets, link_tracklets

CAROM_BALLS = 3
MIN_FRAMES = 5


def build_tracks(
    detections: Detections,
    frame: IntArray,
    t: FloatArray,
    scene: Scene,
    options: TrackOptions = TrackOptions(),
    progress: Progress = ignore_progress,
) -> Tracks:
    """Build the tracks of all balls from detections.

    Args:
        detections: Detections of all frames, px.
        frame: (T,) numbers of the distinct frames.
        t: (T,) presentation times of these frames, s.
        scene: Table, camera and cloth colour.
        options: Breadth, patience and number of balls.
        progress: Called with the finished share of the work.

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
    table_detections = project_detections(detections, frame, scene)
    chains = track_balls(table_detections, t, scene.table, options.breadth, options.patience, progress)
    tracklets = [
        tracklet
        for tracklet in cut_tracklets(chains, table_detections, t)
        if looks_like_ball(tracklet, table_detections, t, scene)
    ]
    linked = link_tracklets(tracklets, table_detections, t, scene.table)
    likely = [tracklet for tracklet in linked if is_ball(tracklet, table_detections, t, scene)]
    balls = [
        tracklet
        for tracklet in likely
        if moves_like_ball(
            tracklet, [other for other in likely if other is not tracklet], table_detections, t, scene.table
        )
    ]
    if not scene.table.pockets:
        balls = _select_lasting_balls(balls, len(t))
    if options.balls:
        balls = sorted(balls, key=lambda tracklet: -len(tracklet.frame_index))[: options.balls]
    if not balls:
        raise TrackError(
            f"Tracking needs balls that are detected in several frames; {len(detections)} detections contain none: "
            "check the calibration of the table, or give --corners and --ball-radius."
        )
    balls = complete_tracks(balls, table_detections, t, scene.table)
    balls = correct_identity_switches(balls, table_detections, t, scene.table.ball_radius)
    return _make_tracks(balls, table_detections, detections, frame, t, scene)


def _select_lasting_balls(balls: list[Tracklet], frame_count: int) -> list[Tracklet]:
    """Select the tracklets of a table without pockets: beyond the three of carom, only those present in most frames."""
    ranked = sorted(balls, key=lambda tracklet: -len(tracklet.frame_index))
    lasting = [
        tracklet for k, tracklet in enumerate(ranked) if k < CAROM_BALLS or len(tracklet.frame_index) > frame_count / 2
    ]
    return [tracklet for tracklet in balls if any(tracklet is other for other in lasting)]


def _make_tracks(
    balls: list[Tracklet],
    table_detections: TableDetections,
    detections: Detections,
    frame: IntArray,
    t: FloatArray,
    scene: Scene,
) -> Tracks:
    """Make the columns of `Tracks`; balls are ordered by class and id."""
    rows = [table_detections.row[ball.row] for ball in balls]
    appearance = summarize_appearance([ball.colour for ball in balls], rows, detections)
    struck_ball = find_struck_ball(
        [(ball.frame_index, table_detections.xy[ball.row]) for ball in balls], scene.table.ball_radius
    )
    kinds = classify_balls(appearance, scene.table.game, struck_ball)
    ids = assign_ids(kinds, np.array([table_detections.xy[ball.row[0]] for ball in balls]))
    order = sorted(range(len(balls)), key=lambda i: (kinds[i], len(ids[i]), ids[i]))
    shape = (len(frame), len(balls))
    xy, px, streak = (np.full((*shape, 2), np.nan) for _ in range(3))
    sigma, along, radius = (np.full(shape, np.nan) for _ in range(3))
    lay = np.full((*shape, 2, 2), np.nan)
    for column, i in enumerate(order):
        index, row, source = balls[i].frame_index, balls[i].row, rows[i]
        xy[index, column], streak[index, column] = table_detections.xy[row], table_detections.streak[row]
        px[index, column], radius[index, column] = detections.centre[source], detections.radius[source]
        scale, lay[index, column] = table_detections.scale[row], table_detections.lay[row]
        sigma[index, column] = detections.sigma[source] * scale
        along[index, column] = detections.sigma_along[source] * scale
    return Tracks(
        frame, t, tuple(ids[i] for i in order), tuple(kinds[i] for i in order), xy, px, sigma, along, streak, radius,
        appearance.colour[order], lay,
    )  # fmt: skip
