"""Tracks from detections, through contacts, gaps and pockets.

Tracking works in metres on the table: a ball at rest stays, a free ball goes straight, and whatever changes a velocity
is near. `models.tracking.track_hypotheses` decides identities.

Balls that look alike may be switched in a gap. In a break, one frame interval holds several contacts of a ball, and no
prediction reaches the next detection. Afterwards the paths are known: one that comes straight from where a ball lay is
that ball's, not its neighbour's. Switches in track folders under diagnosis are corrected in
`diagnosis.diagnose`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.detections import Detections, MarkedDetections
from models.core.errors import NO_BALLS, TrackError
from models.core.options import TrackOptions
from models.core.progress import Progress, ignore_progress
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.tracking.ball_classes import assign_ids, classify_balls, find_struck_ball, summarize_appearance
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
from models.tracking.table_detections import TableDetections, project_detections
from models.tracking.track_completion import complete_tracks
from models.tracking.track_hypotheses import track_balls
from models.tracking.tracklet_linking import (
    Tracklet,
    cut_tracklets,
    drop_unconfirmed_departures,
    link_tracklets,
    make_tracklet,
)

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
    marked = detections
    if isinstance(marked, Detections):
        marked = MarkedDetections(marked, np.full(len(marked), -1, np.int64))
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


def _find_balls(
    marked: MarkedDetections, frame: IntArray, t: FloatArray, scene: Scene, options: TrackOptions, progress: Progress
) -> tuple[list[Tracklet], TrackPixels]:
    """Find the tracks of all balls; those that a person placed need not look or move like one."""
    detections = marked.detections
    if not len(detections):
        raise TrackError(NO_BALLS, remedy="balls")
    table_detections = project_detections(detections, frame, scene)
    pixels = TrackPixels(table_detections, detections, frame, t)
    is_marked = marked.mark[table_detections.row] >= 0

    def is_placed(tracklet: Tracklet) -> bool:
        return bool(is_marked[tracklet.row].any())

    clutter: list[Tracklet] = []

    def select_balls(tracklets: list[Tracklet], others: list[Tracklet]) -> list[Tracklet]:
        """Select what moves like a ball; velocities change near the `others` that share no detection with it."""
        balls: list[Tracklet] = []
        for one in tracklets:
            apart = [other for other in others if not np.isin(one.row, other.row).any()]
            is_like_ball = is_placed(one) or moves_like_ball(one, apart, table_detections, t, scene.table)
            (balls if is_like_ball else clutter).append(one)
        return balls

    def link_likely(parts: list[Tracklet]) -> list[Tracklet]:
        linked = link_tracklets(parts, table_detections, t, scene.table)
        return [one for one in linked if is_placed(one) or is_ball(one, table_detections, t, scene)]

    chains = track_balls(table_detections, t, scene.table, options.breadth, options.patience, progress)
    parts = [
        tracklet
        for tracklet in cut_tracklets(chains, table_detections, t)
        if is_placed(tracklet) or looks_like_ball(tracklet, table_detections, t, scene)
    ]
    # a hand that a ball's track continues would pass with it: every part has to move like a ball on its own
    likely = link_likely(select_balls(parts, link_likely(parts)))
    balls = select_balls(likely, likely)
    if not scene.table.pockets:
        balls = _select_lasting_balls(balls, len(t))
    if options.balls:
        balls = sorted(balls, key=lambda tracklet: -len(tracklet.frame_index))[: options.balls]
    balls = keep_placed_balls(balls, marked.mark, pixels)
    if not balls:
        raise TrackError(
            f"Tracking needs balls that are detected in several frames; {len(detections)} detections contain none",
            remedy="balls",
        )
    balls = complete_tracks(balls, clutter, table_detections, t, scene.table)
    balls = drop_unconfirmed_departures(balls, table_detections, t, scene.table)
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


# Standard deviations of colour by which confusable balls may differ.
MAX_COLOUR_SIGMAS = 3.0
# Ball radii by which the paths before and after a gap miss each other, for a possible switch.
MIN_MISFIT_RADII = 1.0
# Largest share of this misfit that remains after the switch is undone.
MAX_REMAINING_SHARE = 0.5
# Most frames between the detections that give a velocity.
MAX_VELOCITY_FRAMES = 3
# Most corrected switches in one clip.
MAX_SWAPS = 20


class _TrackGap(NamedTuple):
    """The gap after detection `row` of a ball: place (2,) m, velocity (2,) m/s and time s on either side."""

    ball: int
    row: int
    x0: FloatArray
    v0: FloatArray
    t0: float
    x1: FloatArray
    v1: FloatArray
    t1: float


def correct_identity_switches(
    balls: list[Tracklet], detections: TableDetections, t: FloatArray, radius: float
) -> list[Tracklet]:
    """Swap what follows a gap between two balls where that makes their paths straighter by a ball's radius, m."""
    for _ in range(MAX_SWAPS):
        gaps = [gap for k, ball in enumerate(balls) for gap in _list_gaps(k, ball, detections, t)]
        suspicious = [gap for gap in gaps if _path_distance(gap, gap) > MIN_MISFIT_RADII * radius]
        candidates = [
            (gain, one, two)
            for one in suspicious
            for two in gaps
            if one.ball != two.ball
            and (gain := _swap_gain(one, two)) > MIN_MISFIT_RADII * radius
            and _have_similar_colour(balls, one.ball, two.ball)
        ]
        if not candidates:
            break
        _, one, two = max(candidates, key=lambda each: each[0])
        balls = _swap_after_gap(balls, one, two, detections, t)
    return balls


def _list_gaps(number: int, ball: Tracklet, detections: TableDetections, t: FloatArray) -> list[_TrackGap]:
    """List the gaps with two detections on either side, near enough in time to give velocities."""
    times, x = t[ball.frame_index], detections.xy[ball.row]
    v = np.diff(x, axis=0) / np.diff(times)[:, None]
    near = np.diff(ball.frame_index) <= MAX_VELOCITY_FRAMES
    return [
        _TrackGap(number, i, x[i], v[i - 1], float(times[i]), x[i + 1], v[i + 1], float(times[i + 1]))
        for i in range(1, len(times) - 2)
        if near[i - 1] and near[i + 1]
    ]


def _path_distance(one: _TrackGap, two: _TrackGap) -> float:
    """Return the distance by which the path into a gap misses the path out of another, m.

    The ball may turn once between them.
    """
    lasts = two.t1 - one.t0
    apart, turn = one.x0 - two.x1 + lasts * two.v1, one.v0 - two.v1
    s = float(np.clip(-(apart @ turn) / max(float(turn @ turn), 1e-12), 0.0, lasts))
    return float(np.hypot(*(apart + s * turn)))


def _swap_gain(one: _TrackGap, two: _TrackGap) -> float:
    """Return the misfit that a swap of two balls removes, m; 0 where they cannot have been switched."""
    if not (one.t0 < two.t1 and two.t0 < one.t1):
        return 0.0
    straight, swapped = (
        _path_distance(one, one) + _path_distance(two, two),
        _path_distance(one, two) + _path_distance(two, one),
    )
    return straight - swapped if swapped < MAX_REMAINING_SHARE * straight else 0.0


def _have_similar_colour(balls: list[Tracklet], i: int, j: int) -> bool:
    difference = float(np.hypot.reduce(balls[i].colour - balls[j].colour))
    return difference < MAX_COLOUR_SIGMAS * float(np.hypot(balls[i].spread, balls[j].spread))


def _swap_after_gap(
    balls: list[Tracklet], one: _TrackGap, two: _TrackGap, detections: TableDetections, t: FloatArray
) -> list[Tracklet]:
    """Give each ball the other's detections after its gap."""
    swapped = list(balls)
    for mine, other in ((one, two), (two, one)):
        head, tail = balls[mine.ball], balls[other.ball]
        frame_index, row = (
            np.concatenate([before[: mine.row + 1], after[other.row + 1 :]])
            for before, after in ((head.frame_index, tail.frame_index), (head.row, tail.row))
        )
        swapped[mine.ball] = make_tracklet(frame_index, row, detections, t)
    return swapped
