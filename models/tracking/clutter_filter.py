"""Rejection of tracklets that are no balls.

Hands, cues, chalk, shadows and projected lines come, go, jitter or look like cloth. What the tracker followed is a ball
if it passes these tests, which `build_tracks._find_balls` applies in this order:

1. `looks_like_ball` to every part, before parts of one track are linked: colour and streaks;
2. `moves_like_ball` to every part: changes of its velocity;
3. `is_ball` to every linked track: length, look, and where and how often it is not detected;
4. `moves_like_ball` to every linked track as a whole.

A track with a detection that a person placed passes without a test. Then the number is limited: on a table without
pockets, tracks beyond the three longest are balls only if they have a detection in more than half of the frames; and
`options.balls`, unless it is 0, keeps the longest tracks. Balls that a person placed are kept beyond these limits.
Where a person marked a ball as false, its detections are removed and everything is repeated
(`build_tracks.build_tracks`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Scene, Table
from models.core.typing import FloatArray
from models.tracking.assignment_cost import CLOTH_COLOUR_DISTANCE
from models.tracking.table_detections import TableDetections
from models.tracking.tracklet_linking import MAX_DECELERATION, REST_SPEED, Tracklet, ends_in_pocket

# Least number of detections of a ball.
MIN_DETECTIONS = 5
# Least share of the frames with a detection, of a ball that does not fall into a pocket.
MIN_FRAME_SHARE = 0.08
# Error of a frame's time over the interval of its neighbours: containers round, and duplicate frames come irregularly.
TIME_JITTER = 0.07
# Standard deviations from between its neighbours above which a detection is erratic: the velocity changed.
ERRATIC_DEPARTURE = 4.0
# Share of moving detections that are erratic without a ball nearby: 0 to 0.1 for balls, 0.25 to 0.5 for hands.
ERRATIC_BALL, ERRATIC_CLUTTER = 0.05, 0.35
# Share of the other detections, where nothing moves.
STILL_BALL, STILL_CLUTTER = 0.9, 0.7
# Prior log odds of a ball among tracklets that last and look like one.
PRIOR_LOG_ODDS = 2.0
# Radii from another ball's centre within which a velocity may change.
EXCUSE_RADII = 3.5
# Longest time before and after a change of velocity in which it is measured, s, and the fewest detections there.
TURN_SECONDS, TURN_DETECTIONS = 0.25, 3
# Share of the speed, and standard deviations, by which such a change exceeds that of friction: the scale of a view
# changes along a path.
TURN_SHARE, TURN_SIGMAS = 0.1, 5.0
# Changes of a ball's velocity far from any cushion and other ball: one may be a ball that is not detected. Of 15 balls
# that move in real clips none has one; what is drawn or projected turns and stops anywhere.
MAX_OPEN_TURNS = 1
# Largest share of missed frames of a ball that moves, or before it vanishes in the open.
MAX_MISSED_SHARE = 0.15
# Radii by which a streak exceeds the distance to either neighbour, which neither an exposure nor two touching balls
# cause; and the largest share of such detections. The edge of a sleeve, a cue or a line looks like a streak that goes
# nowhere.
STREAK_EXCESS_RADII, MAX_IMPOSSIBLE_SHARE = 2.2, 0.3
# Radii from a pocket's centre: where balls may hang in the jaws, and the end of its lining; and from a nose: a resting
# object nearer than that, beside the jaws, is the lining.
JAW_RADII, LINING_RADII, NOSE_DISTANCE_RADII = 2.2, 4.0, 0.93
# Share of the frames in which a cloth-coloured ball stays at one place, and the size of that place in radii.
STEADY_SHARE, STEADY_RADII = 0.8, 0.1
# s and frames from the ends of the clip: a track that begins later has appeared, one that ends earlier has vanished.
VANISH_TIME, VANISH_FRAMES = 0.3, 5
# Gaps per detection above which an object flickers, and the least share of the frames with a detection of a ball that
# does: of 170 balls in 16 real clips one has more gaps than 0.03, crowded by others, with 0.32 and 0.6; parts of nets,
# lines and rings have 0.14 to 0.36 and, at pockets, 0.25 to 0.3.
MAX_GAP_SHARE, MIN_FLICKER_SHARE = 0.14, 0.5
# Median confidence of an object that appears or vanishes in the open, or flickers, and still is a ball, hidden by a
# player or by other balls.
VANISH_SCORE = 0.85
# m from a pocket's centre within which a ball may vanish between two frames.
POCKET_REACH = 0.2


def looks_like_ball(tracklet: Tracklet, detections: TableDetections, t: FloatArray, scene: Scene) -> bool:
    """Return whether a tracklet may be a ball by colour and streaks."""
    is_cloth_like = float(np.hypot.reduce(tracklet.colour - scene.cloth_lab)) < CLOTH_COLOUR_DISTANCE
    if is_cloth_like and not (
        len(tracklet.frame_index) > STEADY_SHARE * len(t)
        and _is_resting(tracklet, detections, STEADY_RADII * scene.table.ball_radius)
    ):
        return False
    return _impossible_streak_share(tracklet, detections, scene.table) <= MAX_IMPOSSIBLE_SHARE


def is_ball(tracklet: Tracklet, detections: TableDetections, t: FloatArray, scene: Scene) -> bool:
    """Return whether a linked tracklet lasts and looks like a ball, and comes and goes only as one does."""
    count = len(tracklet.frame_index)
    lasting = count >= MIN_FRAME_SHARE * len(t) or ends_in_pocket(tracklet, scene.table)
    if count < MIN_DETECTIONS or not lasting:
        return False
    if not looks_like_ball(tracklet, detections, t, scene) or _is_pocket_lining(tracklet, detections, scene.table):
        return False
    if _share_of_missed_frames(tracklet, detections, scene.table) > MAX_MISSED_SHARE:
        return False
    flickers = int((np.diff(tracklet.frame_index) > 1).sum()) > MAX_GAP_SHARE * count
    comes_or_goes = _appears_late(tracklet, t) or _vanishes_in_open(tracklet, t, scene.table)
    if not flickers and not comes_or_goes:
        return True
    share = count / (tracklet.frame_index[-1] - tracklet.frame_index[0] + 1)
    is_detected = share > (1 - MAX_MISSED_SHARE if comes_or_goes else MIN_FLICKER_SHARE)
    return bool(is_detected and float(np.median(detections.score[tracklet.row])) >= VANISH_SCORE)


def _is_resting(tracklet: Tracklet, detections: TableDetections, reach: float) -> bool:
    """Return whether nine detections in ten are within `reach` m of the median place."""
    xy = detections.xy[tracklet.row]
    return float(np.percentile(np.hypot(*(xy - np.median(xy, axis=0)).T), 90)) < reach


def _is_pocket_lining(tracklet: Tracklet, detections: TableDetections, table: Table) -> bool:
    """Return whether a tracklet rests beside a pocket's mouth, over the nose line, where no ball can be."""
    if not table.pockets or not _is_resting(tracklet, detections, table.ball_radius / 2):
        return False
    place = np.median(detections.xy[tracklet.row], axis=0)
    gap = float(np.hypot(*(table.pocket_centres - place).T).min())
    inside = float(min(place.min(), table.length - place[0], table.width - place[1]))
    r = table.ball_radius
    return JAW_RADII * r < gap < LINING_RADII * r and inside < NOSE_DISTANCE_RADII * r


def _impossible_streak_share(tracklet: Tracklet, detections: TableDetections, table: Table) -> float:
    """Return the share of detections whose streak exceeds the distance to either neighbour.

    No exposure outlasts a frame.
    """
    xy, length = detections.xy[tracklet.row], np.hypot(*detections.streak[tracklet.row].T)
    step = np.hypot(*np.diff(xy, axis=0).T)
    longest = np.maximum(np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]]))
    return float(np.mean(length > longest + STREAK_EXCESS_RADII * table.ball_radius))


def moves_like_ball(
    tracklet: Tracklet, others: list[Tracklet], detections: TableDetections, t: FloatArray, table: Table
) -> bool:
    """Return whether the motion is more probable for a ball than for a hand, which turns and halts again and again.

    A ball's velocity changes at contacts only: those with `others` are excused, those with cushions are few.
    """
    if len(tracklet.frame_index) < 3:
        return True
    off, chord = _chord_departures(tracklet, detections, t)
    excused = _is_near_other_ball(tracklet, others, detections, EXCUSE_RADII * table.ball_radius)[1:-1]
    erratic = (off > ERRATIC_DEPARTURE) & ~excused
    moving = (chord > ERRATIC_DEPARTURE) & ~erratic
    still = (chord <= ERRATIC_DEPARTURE) & (off <= ERRATIC_DEPARTURE)
    odds = PRIOR_LOG_ODDS + float(np.sum(erratic)) * np.log(ERRATIC_BALL / ERRATIC_CLUTTER)
    odds += float(np.sum(moving)) * np.log((1 - ERRATIC_BALL) / (1 - ERRATIC_CLUTTER))
    odds += float(np.sum(still)) * np.log(STILL_BALL / STILL_CLUTTER)
    return bool(odds > 0) and not _turns_in_open(tracklet, others, detections, t, table)


def _turns_in_open(
    tracklet: Tracklet, others: list[Tracklet], detections: TableDetections, t: FloatArray, table: Table
) -> bool:
    """Return whether its velocity changes in the open again and again, where nothing can stop or turn a ball.

    Friction changes it slowly; a cue does where a ball rests.
    """
    times, xy, sigma = t[tracklet.frame_index], detections.xy[tracklet.row], detections.sigma_along[tracklet.row]
    is_near = _is_near_other_ball(tracklet, others, detections, EXCUSE_RADII * table.ball_radius)
    turns: list[int] = []
    for k in range(TURN_DETECTIONS - 1, len(times) - TURN_DETECTIONS + 1):
        before = np.flatnonzero((times <= times[k]) & (times > times[k] - TURN_SECONDS))[-TURN_DETECTIONS - 1 :]
        after = np.flatnonzero((times >= times[k]) & (times < times[k] + TURN_SECONDS))[: TURN_DETECTIONS + 1]
        if min(len(before), len(after)) < TURN_DETECTIONS or is_near[before[0] : after[-1] + 1].any():
            continue
        (v, v_sigma), (w, w_sigma) = (_fit_velocity(times[part], xy[part], sigma[part]) for part in (before, after))
        speed = float(max(np.hypot(*v), np.hypot(*w)))
        margin = 2 * table.ball_radius + speed * float(np.diff(times[before[0] : after[-1] + 1]).max())
        path = xy[before[0] : after[-1] + 1]
        is_at_cushion = min(path.min(), float(([table.length, table.width] - path).min())) < margin
        steps = np.hypot(*np.diff(xy[before], axis=0).T) / np.diff(times[before])
        is_strike = np.hypot(*w) > np.hypot(*v) and float(steps.min()) < REST_SPEED
        slack = MAX_DECELERATION * (times[after].mean() - times[before].mean()) + TURN_SHARE * speed
        is_turn = np.hypot(*(w - v)) > slack + TURN_SIGMAS * np.hypot(v_sigma, w_sigma)
        if is_turn and not is_at_cushion and not is_strike and (not turns or k > turns[-1] + TURN_DETECTIONS + 1):
            turns.append(k)
    return len(turns) > MAX_OPEN_TURNS


def _fit_velocity(t: FloatArray, xy: FloatArray, sigma: FloatArray) -> tuple[FloatArray, float]:
    """Fit the velocity (2,) of a few detections, and its standard deviation."""
    tau = t - t.mean()
    spread = float(tau @ tau)
    return tau @ xy / spread, float(np.sqrt((sigma**2).mean() / spread))


def _is_near_other_ball(
    tracklet: Tracklet, others: list[Tracklet], detections: TableDetections, reach: float
) -> NDArray[np.bool_]:
    """Mark the detections (M,) at which the latest place of another ball is within `reach` m."""
    is_near = np.zeros(len(tracklet.frame_index), bool)
    for other in others:
        latest = np.searchsorted(other.frame_index, tracklet.frame_index, side="right") - 1
        gap = np.hypot(*(detections.xy[tracklet.row] - detections.xy[other.row[np.maximum(latest, 0)]]).T)
        is_near |= (latest >= 0) & (gap < reach)
    return is_near


def _share_of_missed_frames(tracklet: Tracklet, detections: TableDetections, table: Table) -> float:
    """Return the share of frames in which it moved undetected; resting behind a hand does not count."""
    step = np.hypot(*np.diff(detections.xy[tracklet.row], axis=0).T)
    gap_frames = np.diff(tracklet.frame_index) - 1
    missed = int(gap_frames[step > table.ball_radius].sum())
    return missed / (missed + len(tracklet.frame_index))


def _chord_departures(tracklet: Tracklet, detections: TableDetections, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the departure (M - 2,) of each detection from between its neighbours, and their distance, in sigma."""
    times, xy, sigma = t[tracklet.frame_index], detections.xy[tracklet.row], detections.sigma_along[tracklet.row]
    share = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
    chord = xy[2:] - xy[:-2]
    off = xy[1:-1] - xy[:-2] - share * chord
    length = np.hypot(*chord.T)
    along = (off * chord).sum(axis=1) / np.maximum(length, 1e-9)
    across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0))
    curvature = 2.0 * (times[2:] - times[:-2]) ** 2 / 8  # m: bend of a path by sliding friction
    spread = np.hypot(1.2 * sigma[1:-1], curvature)
    off_sigma: FloatArray = np.hypot(along / np.hypot(spread, TIME_JITTER * length), across / spread)
    return off_sigma, length / (1.5 * sigma[1:-1])


def _appears_late(tracklet: Tracklet, t: FloatArray) -> bool:
    """Return whether a tracklet begins after the clip does."""
    first = int(tracklet.frame_index[0])
    return bool(t[first] - t[0] >= VANISH_TIME and first >= VANISH_FRAMES)


def _vanishes_in_open(tracklet: Tracklet, t: FloatArray, table: Table) -> bool:
    """Return whether a tracklet ends before the clip does, away from the pockets."""
    last = int(tracklet.frame_index[-1])
    if t[-1] - t[last] < VANISH_TIME or len(t) - 1 - last < VANISH_FRAMES:
        return False
    if not table.pockets:
        return True
    gap = float(np.hypot(*(table.pocket_centres - tracklet.end[:2]).T).min())
    return gap > POCKET_REACH + VANISH_TIME * float(np.hypot(*tracklet.end[2:]))
