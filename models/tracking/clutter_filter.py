"""Which tracklets are balls: hands, cues, chalk, shadows and projected lines come, go, jitter or look like cloth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Scene, Table
from models.core.typing import FloatArray
from models.tracking.assignment_cost import CLOTH_LIKE
from models.tracking.table_detections import Sightings
from models.tracking.tracklet_linking import Tracklet, fell

LEAST_SEEN = 5
"""sightings: fewer are no ball."""
LEAST_SHARE = 0.08
"""of the pictures: a ball that does not fall into a pocket is seen at least this often."""
JITTER = 6.0
"""standard deviations: what a hand departs from between its neighbours in most pictures, a ball only at contacts."""
TIME_JITTER = 0.07
"""Error of a picture's time, in the interval of its neighbours: containers round, and repeat pictures irregularly."""
ERRATIC = 4.0
"""Standard deviations from between its neighbours above which a sighting is erratic: the velocity changed."""
ERRATIC_BALL, ERRATIC_CLUTTER = 0.05, 0.35
"""Share of the sightings in motion that are erratic without a ball near: 0 to 0.1 of balls, 0.25 to 0.5 of hands."""
STILL_BALL, STILL_CLUTTER = 0.9, 0.7
"""Share of the others, where nothing moves."""
PRIOR = 2.0
"""Log odds of a ball among what lasts and looks like one."""
EXCUSE = 3.5
"""Radii from another ball's centre within which a velocity may change."""
MOST_LOST = 0.15
"""Share of its pictures in which a ball may go unseen while it moves, or before it vanishes in the open."""
STREAKED, MOST_IMPOSSIBLE = 2.2, 0.3
"""Radii by which a streak is longer than the way to either neighbour, which no exposure makes nor two balls that touch;
and in how many of the pictures: an edge of a sleeve, a cue or a line looks like a streak that goes nowhere."""
JAWS, TIPS, OVER_NOSE = 2.2, 4.0, 0.93
"""Radii from a pocket's centre: to where balls may hang in the jaws, and to where its lining reaches; and from a nose:
what lies nearer throughout, beside the jaws, is that lining."""
STEADY, STEADY_RADII = 0.8, 0.1
"""Share of the pictures in which a ball of the cloth's colour is seen at one place, and how near to it."""
VANISH_TIME, VANISH_PICTURES = 0.3, 5
"""s and pictures before the end: what is no longer seen there has vanished."""
VANISH_SCORE = 0.85
"""Median score of what appears or vanishes in the open and is a ball behind a player all the same."""
POCKET_REACH = 0.2
"""m from a pocket's centre within which a ball may vanish between two pictures."""


def looks_like_ball(piece: Tracklet, sightings: Sightings, t: FloatArray, scene: Scene) -> bool:
    """Whether the pictures of a tracklet may be those of a ball, before its pieces are joined."""
    clothy = float(np.hypot.reduce(piece.colour - scene.cloth_lab)) < CLOTH_LIKE
    if clothy and not (
        len(piece.picture) > STEADY * len(t) and _rests(piece, sightings, STEADY_RADII * scene.table.ball_radius)
    ):
        return False
    return _impossible_streaks(piece, sightings, scene.table) <= MOST_IMPOSSIBLE


def is_ball(piece: Tracklet, sightings: Sightings, t: FloatArray, scene: Scene) -> bool:
    """Whether a tracklet lasts, looks and moves as a ball."""
    seen = len(piece.picture)
    lasting = seen >= LEAST_SHARE * len(t) or fell(piece, scene.table)
    if seen < LEAST_SEEN or not lasting:
        return False
    if not looks_like_ball(piece, sightings, t, scene) or _lines_pocket(piece, sightings, scene.table):
        return False
    if _lost_share(piece, sightings, scene.table) > MOST_LOST or _jitter(piece, sightings, t) > JITTER:
        return False
    if not _vanishes(piece, t, scene.table):
        return True
    steady = seen > (1 - MOST_LOST) * (piece.picture[-1] - piece.picture[0] + 1)
    return steady and float(np.median(sightings.score[piece.row])) >= VANISH_SCORE


def _rests(piece: Tracklet, sightings: Sightings, reach: float) -> bool:
    """Whether nine sightings in ten are within reach (m) of the middle one."""
    xy = sightings.xy[piece.row]
    return float(np.percentile(np.hypot(*(xy - np.median(xy, axis=0)).T), 90)) < reach


def _lines_pocket(piece: Tracklet, sightings: Sightings, table: Table) -> bool:
    """Whether it lies beside the mouth of a pocket and over the line of the noses, where no ball can be."""
    if not table.pockets or not _rests(piece, sightings, table.ball_radius / 2):
        return False
    place = np.median(sightings.xy[piece.row], axis=0)
    gap = float(np.hypot(*(table.pocket_centres - place).T).min())
    inside = float(min(place.min(), table.length - place[0], table.width - place[1]))
    r = table.ball_radius
    return JAWS * r < gap < TIPS * r and inside < OVER_NOSE * r


def _impossible_streaks(piece: Tracklet, sightings: Sightings, table: Table) -> float:
    """Share of the sightings with a streak longer than the way to either neighbour: no exposure outlasts a picture."""
    xy, length = sightings.xy[piece.row], np.hypot(*sightings.streak[piece.row].T)
    way = np.hypot(*np.diff(xy, axis=0).T)
    longest = np.maximum(np.concatenate([way[:1], way]), np.concatenate([way, way[-1:]]))
    return float(np.mean(length > longest + STREAKED * table.ball_radius))


def moves_like_ball(piece: Tracklet, others: list[Tracklet], sightings: Sightings, t: FloatArray, table: Table) -> bool:
    """Whether its motion is likelier that of a ball than of a hand, which turns and halts again and again.

    A ball's velocity changes at contacts only: those with `others` are excused, those with cushions are few.
    """
    if len(piece.picture) < 3:
        return True
    off, chord = _departures(piece, sightings, t)
    excused = _near(piece, others, sightings, EXCUSE * table.ball_radius)[1:-1]
    erratic = (off > ERRATIC) & ~excused
    moving = (chord > ERRATIC) & ~erratic
    still = (chord <= ERRATIC) & (off <= ERRATIC)
    odds = PRIOR + float(np.sum(erratic)) * np.log(ERRATIC_BALL / ERRATIC_CLUTTER)
    odds += float(np.sum(moving)) * np.log((1 - ERRATIC_BALL) / (1 - ERRATIC_CLUTTER))
    odds += float(np.sum(still)) * np.log(STILL_BALL / STILL_CLUTTER)
    return bool(odds > 0)


def _near(piece: Tracklet, others: list[Tracklet], sightings: Sightings, reach: float) -> NDArray[np.bool_]:
    """At which sightings (M,) another ball, where it was seen last, is within reach (m)."""
    near = np.zeros(len(piece.picture), bool)
    for other in others:
        latest = np.searchsorted(other.picture, piece.picture, side="right") - 1
        gap = np.hypot(*(sightings.xy[piece.row] - sightings.xy[other.row[np.maximum(latest, 0)]]).T)
        near |= (latest >= 0) & (gap < reach)
    return near


def _lost_share(piece: Tracklet, sightings: Sightings, table: Table) -> float:
    """Share of the pictures from first to last in which it moved unseen; resting behind a hand does not count."""
    way = np.hypot(*np.diff(sightings.xy[piece.row], axis=0).T)
    unseen = np.diff(piece.picture) - 1
    lost = int(unseen[way > table.ball_radius].sum())
    return lost / (lost + len(piece.picture))


def _jitter(piece: Tracklet, sightings: Sightings, t: FloatArray) -> float:
    """Median departure of each sighting from between its neighbours, in standard deviations."""
    return float(np.median(_departures(piece, sightings, t)[0])) if len(piece.picture) > 2 else 0.0


def _departures(piece: Tracklet, sightings: Sightings, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far each sighting (M - 2,) is from between its neighbours, and they from each other, in sigma."""
    times, xy, sigma = t[piece.picture], sightings.xy[piece.row], sightings.sigma_along[piece.row]
    share = ((times[1:-1] - times[:-2]) / (times[2:] - times[:-2]))[:, None]
    chord = xy[2:] - xy[:-2]
    off = xy[1:-1] - xy[:-2] - share * chord
    length = np.hypot(*chord.T)
    along = (off * chord).sum(axis=1) / np.maximum(length, 1e-9)
    across = np.sqrt(np.maximum((off**2).sum(axis=1) - along**2, 0.0))
    push = 2.0 * (times[2:] - times[:-2]) ** 2 / 8  # m: what sliding friction bends a path by
    spread = np.hypot(1.2 * sigma[1:-1], push)
    off_sigma: FloatArray = np.hypot(along / np.hypot(spread, TIME_JITTER * length), across / spread)
    return off_sigma, length / (1.5 * sigma[1:-1])


def _vanishes(piece: Tracklet, t: FloatArray, table: Table) -> bool:
    """Whether it ends before the clip does, away from the pockets."""
    last = int(piece.picture[-1])
    if t[-1] - t[last] < VANISH_TIME or len(t) - 1 - last < VANISH_PICTURES:
        return False
    if not table.pockets:
        return True
    gap = float(np.hypot(*(table.pocket_centres - piece.end[:2]).T).min())
    return gap > POCKET_REACH + VANISH_TIME * float(np.hypot(*piece.end[2:]))
