"""A ball that rolls on the table: the end of a rally, which no flight explains.

A ball that hits the net and drops, or that is not returned, rolls along the table and off it. Its places follow a
straight and even path on the playing surface, where gravity would bend a flight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.rally import BallCandidates, Flight, LandingHypothesis, Rally
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.event_chances import SLIP
from models.estimation.rally.flight_observations import REST_PX
from models.estimation.rally.rally_building import weigh_looks
from models.estimation.rally.rally_views import is_on_surface

# px by which gravity would at least bend a flight as long as a roll, so that it cannot be one: twice the width of the
# band in which a roll stays.
_LEAST_BEND = 4 * REST_PX
# m/s, m and frames: a ball that is left on a table is slow, what does not move may be a mark of the table, and a roll
# is seen nearly always.
_FASTEST, _LEAST_WAY, _MOST_MISSED = 3.0, 0.2, 2


def find_last_roll(rally: Rally) -> IntArray | None:
    """Find the frames (N,) that show the last roll of a ball on a table; None without one, or without a table."""
    rows, sport = np.flatnonzero(np.isfinite(rally.px[:, 0])), rally.scene.sport
    if sport.floor == 0 or not len(rows):
        return None
    places = rally.scene.camera.to_court(rally.px[rows], sport.object.radius, rally.frame[rows])
    is_on = np.array([is_on_surface(place[:2], sport) for place in places])
    is_linked = np.diff(rows) <= 1 + _MOST_MISSED
    for last in range(len(rows) - 1, 0, -1):
        first = last
        while first > 0 and is_on[first - 1 : last + 1].all() and is_linked[first - 1]:
            if not _is_even(rally, rows[first - 1 : last + 1], places[first - 1 : last + 1]):
                break
            first -= 1
        own = slice(first, last + 1)
        if _is_roll(rally, rows[own], places[own]):
            return rows[own]
    return None


def _is_even(rally: Rally, rows: IntArray, places: FloatArray) -> bool:
    """Return whether places (N, 3), m, of frames (N,) lie on a straight path of even speed, within a band of px."""
    t = rally.t[rows] - rally.t[rows[0]]
    basis = np.stack([np.ones(len(t)), t], axis=1)
    line = basis @ np.linalg.lstsq(basis, places, rcond=None)[0]
    off = rally.scene.camera.to_pixels(line, rally.frame[rows]) - rally.px[rows]
    return bool(np.linalg.norm(off, axis=1).max() < REST_PX)


def _is_roll(rally: Rally, rows: IntArray, places: FloatArray) -> bool:
    """Return whether an even path is of a ball that rolls: slow, and seen for longer than a flight stays straight."""
    duration = float(rally.t[rows[-1]] - rally.t[rows[0]])
    way, camera = float(np.linalg.norm(places[-1] - places[0])), rally.scene.camera
    upright = camera.to_pixels(places[[0, 0]] + [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]], rally.frame[rows[[0, 0]]])
    bend = GRAVITY * float(np.linalg.norm(upright[1] - upright[0])) / 0.1 * duration**2 / 8
    return bend >= _LEAST_BEND and _LEAST_WAY <= way <= _FASTEST * duration


def _locate(rally: Rally, row: int) -> tuple[FloatArray, FloatArray]:
    """Locate what a frame shows on the table: its place (3,), m, and the covariance (3, 3), m^2."""
    pixels = rally.px[row] + np.array([[0, 0], [1, 0], [0, 1]]) * float(rally.px_sigma[row].max())
    places = rally.scene.camera.to_court(pixels, rally.scene.sport.object.radius, rally.frame[[row] * 3])
    by = places[1:] - places[0]
    return places[0], np.asarray(by.T @ by + np.eye(3) * 1e-8)


def end_at_roll(rally: Rally, candidates: BallCandidates) -> Rally:
    """End a rally where the ball begins to roll on the table after its last hit: nobody returns such a ball.

    Flights and events from there on are left out, and the roll is the landing: it touches the table there, or before.
    """
    rows, hits = find_last_roll(rally), [one.t for one in rally.events if one.kind == "hit"]
    if rows is None or not hits or max(hits) > rally.t[rows[-1]]:  # it may roll before the service, too
        return rally
    begin, interval = float(rally.t[rows[0]]), float(np.median(np.diff(rally.t)))
    chance = (1 - SLIP) * weigh_looks(_find_scores(rally, candidates, rows))
    rolling = LandingHypothesis(chance, begin, interval, *_locate(rally, int(rows[0])), is_seen=True, is_rolling=True)
    flights = tuple(replace(one, end=min(one.end, begin)) for one in rally.flights if _is_before(rally, one, begin))
    stop = flights[-1].end if flights else begin
    return replace(
        rally,
        flights=flights,
        events=tuple(one for one in rally.events if one.t < min(begin, stop) - interval / 2),
        landings=(rolling,),
        no_landing=1 - chance,
    )


def _is_before(rally: Rally, flight: Flight, t: float) -> bool:
    """Return whether a flight is seen in more frames before a time, s, than after it."""
    rows = np.isfinite(rally.px[:, 0]) & (rally.t >= flight.start) & (rally.t <= flight.end)
    return flight.start < t and 2 * int((rows & (rally.t < t)).sum()) > int(rows.sum())


def _find_scores(rally: Rally, candidates: BallCandidates, rows: IntArray) -> FloatArray:
    """Find the scores (N,) of the candidates to which frames (N,) of a rally were decided."""
    own = np.isin(candidates.frame, rally.frame[rows])
    row = np.searchsorted(rally.frame, candidates.frame[own])
    return np.asarray(candidates.score[own][(candidates.centre[own] == rally.px[row]).all(axis=1)])
