"""Detections to tracks: which detection is which ball, through contacts, gaps and pockets.

Works in metres on the table, where balls obey what clips of pedestrians do not: a ball at rest stays, a free ball
goes straight, and what changes a velocity is near. See `models.tracking.track_hypotheses` for how identity is decided.
"""

from __future__ import annotations

import numpy as np

from models.core.detections import Detections
from models.core.errors import TrackError
from models.core.options import TrackOptions
from models.core.progress import Progress, silent
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.tracking.appearance import look_of
from models.tracking.ball_classes import name_ids, name_kinds
from models.tracking.clutter_filter import is_ball, looks_like_ball, moves_like_ball
from models.tracking.cue_ball import struck_ball
from models.tracking.identity_switches import uncrossed
from models.tracking.table_detections import Sightings, sight
from models.tracking.track_hypotheses import follow
from models.tracking.tracklet_linking import Tracklet, cut, stitch

CAROM_BALLS = 3
FEWEST_PICTURES = 5


def associate(
    detections: Detections,
    frame: IntArray,
    t: FloatArray,
    scene: Scene,
    options: TrackOptions = TrackOptions(),
    progress: Progress = silent,
) -> Tracks:
    """Tracks of all balls at the distinct pictures `frame` (T,), shown at `t` (T,) s.

    Raises TrackError where too little was seen. Every detection belongs to one ball at most.
    """
    if len(frame) != len(t):
        raise ValueError(f"one time per picture is needed; got {len(t)} times for {len(frame)} pictures")
    if len(frame) < FEWEST_PICTURES:
        raise TrackError(
            f"Following balls needs at least {FEWEST_PICTURES} distinct pictures; the clip has {len(frame)}."
        )
    sightings = sight(detections, frame, scene)
    chains = follow(sightings, t, scene.table, options.breadth, options.patience, progress)
    pieces = [piece for piece in cut(chains, sightings, t) if looks_like_ball(piece, sightings, t, scene)]
    joined = stitch(pieces, sightings, t, scene.table)
    likely = [piece for piece in joined if is_ball(piece, sightings, t, scene)]
    balls = [
        piece for piece in likely
        if moves_like_ball(piece, [other for other in likely if other is not piece], sightings, t, scene.table)
    ]  # fmt: skip
    if not scene.table.pockets:
        balls = _that_stay(balls, len(t))
    if options.balls:
        balls = sorted(balls, key=lambda piece: -len(piece.picture))[: options.balls]
    if not balls:
        raise TrackError(
            f"Following balls needs some that are seen in several pictures; {len(detections)} detections held none: "
            "check the table that was found, or give --corners and --ball-radius."
        )
    balls = uncrossed(balls, sightings, t, scene.table.ball_radius)
    return _gather(balls, sightings, detections, frame, t, scene)


def _that_stay(balls: list[Tracklet], pictures: int) -> list[Tracklet]:
    """On a table without pockets no ball leaves: beyond the three of carom, only what is there most of the time."""
    ranked = sorted(balls, key=lambda piece: -len(piece.picture))
    kept = [piece for k, piece in enumerate(ranked) if k < CAROM_BALLS or len(piece.picture) > pictures / 2]
    return [piece for piece in balls if any(piece is other for other in kept)]


def _gather(
    balls: list[Tracklet], sightings: Sightings, detections: Detections, frame: IntArray, t: FloatArray, scene: Scene
) -> Tracks:
    """Columns of `Tracks`, balls ordered by kind name and place."""
    rows = [sightings.row[ball.row] for ball in balls]
    look = look_of([ball.colour for ball in balls], rows, detections)
    struck = struck_ball([(ball.picture, sightings.xy[ball.row]) for ball in balls], scene.table.ball_radius)
    kinds = name_kinds(look, scene.table.game, struck)
    ids = name_ids(kinds, np.array([sightings.xy[ball.row[0]] for ball in balls]))
    order = sorted(range(len(balls)), key=lambda i: (kinds[i], len(ids[i]), ids[i]))
    shape = (len(frame), len(balls))
    xy, px, streak = (np.full((*shape, 2), np.nan) for _ in range(3))
    sigma, along, radius = (np.full(shape, np.nan) for _ in range(3))
    lay = np.full((*shape, 2, 2), np.nan)
    for column, i in enumerate(order):
        picture, row, source = balls[i].picture, balls[i].row, rows[i]
        xy[picture, column], streak[picture, column] = sightings.xy[row], sightings.streak[row]
        px[picture, column], radius[picture, column] = detections.centre[source], detections.radius[source]
        scale, lay[picture, column] = sightings.scale[row], sightings.lay[row]
        sigma[picture, column] = detections.sigma[source] * scale
        along[picture, column] = detections.sigma_along[source] * scale
    return Tracks(
        frame, t, tuple(ids[i] for i in order), tuple(kinds[i] for i in order), xy, px, sigma, along, streak, radius,
        look.colour[order], lay,
    )  # fmt: skip
