"""A ball that rolls on the table: the end of a rally, which no flight explains.

A ball that hits the net and drops, or that is not returned, rolls along the table and off it. Its places follow a
straight and even path on the playing surface, where gravity would bend a flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.corrections import BallMark
from models.core.rally import BallCandidates, Flight, LandingHypothesis, Rally
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.event_chances import SLIP
from models.estimation.rally.event_evidence import HIT_RATE
from models.estimation.rally.flight_observations import REST_PX, EventMark
from models.estimation.rally.rally_building import CAMERA_STEPS, find_last_player, weigh_looks
from models.estimation.rally.rally_marks import FALSE_REACH_PX
from models.estimation.rally.rally_views import evaluate_rally, is_on_surface

# px by which gravity would at least bend a flight as long as a roll, so that it cannot be one: twice the width of the
# band in which a roll stays.
_LEAST_BEND = 4 * REST_PX
# m/s above which a ball on a table bounces, and m, five diameters, which no mark of a table moves. Guesses.
_FASTEST, _LEAST_WAY = 3.0, 0.2
# Frames in which a ball that rolls may be hidden, one after the other: nothing flies past it for longer. Guess.
_MOST_MISSED = 2
# s, longest roll: what takes longer over the length of a table than at 0.4 m/s lies, or creeps.
_LONGEST = 7.0
# Probability from which a roll ends a rally: what is less probable than not did not happen.
_LEAST_CHANCE = 0.5


def find_last_roll(rally: Rally) -> IntArray | None:
    """Find the frames (N,) that show the last roll of a ball on a table; None without one, or without a table.

    What moves evenly through the net is no ball on the table, and then no part of its path is a roll.
    """
    rows, sport = np.flatnonzero(np.isfinite(rally.px[:, 0])), rally.scene.sport
    if sport.floor == 0 or not len(rows):
        return None
    places = rally.scene.camera.to_court(rally.px[rows], sport.object.radius, rally.frame[rows])
    is_on = np.array([is_on_surface(place[:2], sport) for place in places])
    is_linked = (np.diff(rows) <= 1 + _MOST_MISSED) & is_on[1:] & is_on[:-1]
    first = len(rows) - 1
    for last in range(len(rows) - 1, 0, -1):
        # a part of an even path is even: paths that end earlier begin no later, and every place is added once
        first = min(first, last)
        while first > 0 and is_linked[first - 1] and rally.t[rows[last]] - rally.t[rows[first - 1]] <= _LONGEST:
            if not _is_even(rally, rows[first - 1 : last + 1], places[first - 1 : last + 1]):
                break
            first -= 1
        own = slice(first, last + 1)
        if _is_roll(rally, rows[own], places[own]):
            beyond = places[own, 0] - sport.length / 2
            is_through = beyond.min() < -sport.object.radius and beyond.max() > sport.object.radius
            return None if is_through else rows[own]
    return None


def _is_even(rally: Rally, rows: IntArray, places: FloatArray) -> bool:
    """Return whether places (N, 3), m, of frames (N,) lie on a straight path of even speed, within a band of px."""
    t = rally.t[rows] - rally.t[rows].mean()
    slope = t @ places / max(float(t @ t), 1e-12)
    line = places.mean(axis=0) + np.outer(t, slope)
    off = rally.scene.camera.to_pixels(line, rally.frame[rows]) - rally.px[rows]
    return bool((off**2).sum(axis=1).max() < REST_PX**2)


def _is_roll(rally: Rally, rows: IntArray, places: FloatArray) -> bool:
    """Return whether an even path is of a ball that rolls: slow, and seen for longer than a flight stays straight."""
    duration = float(rally.t[rows[-1]] - rally.t[rows[0]])
    way = float(np.linalg.norm(places[-1] - places[0]))
    bend = GRAVITY * _scale_at(rally, int(rows[0]), places[0]) * duration**2 / 8
    return bend >= _LEAST_BEND and _LEAST_WAY <= way <= _FASTEST * duration


def _locate(rally: Rally, row: int) -> tuple[FloatArray, FloatArray]:
    """Locate what a frame shows on the table: place (3,), m, and covariance (3, 3), m^2, the camera's included."""
    camera, frame, radius = rally.scene.camera, rally.frame[[row]], rally.scene.sport.object.radius
    place = camera.to_court(rally.px[[row]], radius, frame)[0]
    sigma = float(rally.px_sigma[row].max())
    by = [(camera.to_court(rally.px[[row]] + step, radius, frame)[0] - place) * sigma for step in np.eye(2)]
    moved = camera.parameters + np.diag(CAMERA_STEPS)
    changes = [camera.replace_parameters(one).to_court(rally.px[[row]], radius, frame)[0] - place for one in moved]
    by_camera = np.array(changes) / CAMERA_STEPS[:, None]
    return place, np.transpose(by) @ by + by_camera.T @ camera.covariance @ by_camera + np.eye(3) * 1e-8


def end_at_roll(
    rally: Rally, candidates: BallCandidates, places: Sequence[BallMark] = (), marks: Sequence[EventMark] = ()
) -> Rally:
    """End a rally where the ball begins to roll on the table after its last flight: nobody returns such a ball.

    Flights from there on and hits that begin them are left out, and the roll is the landing: the ball touches the table
    there, or before. Somebody may have hit the ball unseen before it rolls, or rolled another one: the probability
    falls with the time without sight as that of no hit in it.

    Args:
        rally: The rally.
        candidates: What was decided between in every frame.
        places: Places that a person corrected; one that is no ball is no part of a roll.
        marks: Events that a person marked, which come before a roll.
    """
    rows = find_last_roll(rally)
    if rows is None or _is_denied(rally, rows, places, marks):
        return rally
    begin, interval = float(rally.t[rows[0]]), float(np.median(np.diff(rally.t)))
    earlier = tuple(replace(one, end=min(one.end, begin)) for one in rally.flights if _is_before(rally, one, begin))
    last_hit = earlier[-1].start if earlier else begin  # a hit begins a flight
    events = tuple(one for one in rally.events if one.t < (last_hit if one.kind == "hit" else begin) + interval / 2)
    place, covariance = _locate(rally, int(rows[0]))
    speed = float(np.linalg.norm(_locate(rally, int(rows[-1]))[0] - place)) / float(rally.t[rows[-1]] - begin)
    if (
        not earlier
        or not any(one.kind == "hit" for one in events)  # it may roll before the service, too
        or any(one.kind == "hit" and one.t > rally.t[rows[-1]] for one in rally.events)
        or np.exp(-HIT_RATE * (begin - earlier[-1].end)) < _LEAST_CHANCE  # it was picked up, or is another one
        or not _leads_to(replace(rally, flights=earlier), int(rows[0]), speed)
    ):
        return rally
    chance = (1 - SLIP) * weigh_looks(_find_scores(rally, candidates, rows))
    chance *= float(np.exp(-HIT_RATE * _sum_unseen(rally, earlier[-1].end, begin)))
    if chance < _LEAST_CHANCE:
        return rally
    rolling = LandingHypothesis(chance, begin, interval, place, covariance, is_seen=True, is_rolling=True)
    is_cut = sum(one.kind == "hit" for one in events) < sum(one.kind == "hit" for one in rally.events)
    return replace(
        rally,
        flights=earlier,
        events=events,
        landings=(rolling,),
        no_landing=1 - chance,
        last_player=find_last_player(list(events)) if is_cut else rally.last_player,
    )


def _is_denied(rally: Rally, rows: IntArray, places: Sequence[BallMark], marks: Sequence[EventMark]) -> bool:
    """Return whether a person marked an event in or after a roll, or a place on its path as no ball."""
    begin, frame = float(rally.t[rows[0]]), rally.frame[rows]
    if any(mark.is_there and mark.t > begin - mark.tolerance for mark in marks):
        return True
    for one in places:
        path = [np.interp(one.ball.frame, frame, rally.px[rows, axis]) for axis in (0, 1)]
        off = np.hypot(path[0] - one.ball.x_px, path[1] - one.ball.y_px)
        if one.kind == "false" and frame[0] <= one.ball.frame <= frame[-1] and off < FALSE_REACH_PX:
            return True
    return False


def _leads_to(rally: Rally, row: int, speed: float) -> bool:
    """Return whether the last flight ends, in the frames, as near as the ball can come to where a roll begins.

    In between the ball goes no faster than it flew or rolls, and than it falls meanwhile. Its depth may be poorly known
    where a flight is short, and does not count.
    """
    end, begin = rally.flights[-1].end, float(rally.t[row])
    path, gap = evaluate_rally(rally, np.array([end])), max(begin - end, 0.0)
    reach = (max(float(np.linalg.norm(path.v[0])), speed) + GRAVITY * gap / 2) * gap
    place = _locate(rally, row)[0]
    off = rally.scene.camera.to_pixels(path.xyz, rally.frame[[row]])[0] - rally.px[row]
    return float(np.linalg.norm(off)) < reach * _scale_at(rally, row, place) + 2 * REST_PX


def _scale_at(rally: Rally, row: int, place: FloatArray) -> float:
    """Measure the px that a metre upwards takes in a frame at a place (3,), m."""
    above = place + np.array([0.0, 0.0, 0.1])
    upright = rally.scene.camera.to_pixels(np.stack([place, above]), rally.frame[[row, row]])
    return float(np.linalg.norm(upright[1] - upright[0])) / 0.1


def _sum_unseen(rally: Rally, end: float, begin: float) -> float:
    """Sum the time, s, between the end of a flight and the begin of a roll in which frames do not show the ball."""
    t, interval = rally.t[np.isfinite(rally.px[:, 0])], float(np.median(np.diff(rally.t)))
    t = np.concatenate([[end], t[(t > end) & (t < begin)], [begin]])
    return float(np.maximum(np.diff(t) - 1.5 * interval, 0.0).sum()) if begin > end else 0.0


def _is_before(rally: Rally, flight: Flight, t: float) -> bool:
    """Return whether a flight is seen in more frames before a time, s, than after it."""
    rows = np.isfinite(rally.px[:, 0]) & (rally.t >= flight.start) & (rally.t <= flight.end)
    return flight.start < t and 2 * int((rows & (rally.t < t)).sum()) > int(rows.sum())


def _find_scores(rally: Rally, candidates: BallCandidates, rows: IntArray) -> FloatArray:
    """Find the scores (N,) of the candidates to which frames (N,) of a rally were decided."""
    own = np.isin(candidates.frame, rally.frame[rows])
    row = np.searchsorted(rally.frame, candidates.frame[own])
    return np.asarray(candidates.score[own][(candidates.centre[own] == rally.px[row]).all(axis=1)])
