"""Tracks whose premises are false: objects that are no balls, two balls in one track, wrong or moving calibrations.

They are added after tracking, so that they do not depend on what the tracker rejects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.stress_cases.detection_damage import NothingToDamage
from benchmarks.stress_cases.shot_truth import ShotTruth
from benchmarks.stress_cases.stress_chain import FittedShot
from models.core.scene import apply_homography
from models.core.tracks import Tracks
from models.core.typing import FloatArray

# Most objects that are added to a shot.
MAX_OBJECTS = 6
# Largest shift of a calibrated corner, in lengths of the table: a corner taken for the next ball of the rail, or a
# table of the wrong proportions.
MAX_CORNER_SHIFT = 0.04
# m/s of hands, cursors and lights on the cloth.
OBJECT_SPEED = (0.1, 2.0)
# m: largest distance of a reflection, or a shadow, from its ball.
REFLECTION_SHIFT = 0.25
# Ball radii that a knock moves the image by: 1 to 15 px where a ball is 40 px wide.
KNOCK_RADII = (0.05, 0.8)

FalsePremise = Callable[[FittedShot, ShotTruth, np.random.Generator], tuple[FittedShot, ShotTruth]]


def add_still_objects(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Add objects that lie still, such as nets and marks, where balls pass."""
    xy = shot.tracks.xy[np.isfinite(shot.tracks.xy).all(axis=2)]
    count = int(rng.integers(1, MAX_OBJECTS + 1))
    places = xy[rng.integers(len(xy), size=count)] + rng.normal(0, REFLECTION_SHIFT / 2, (count, 2))
    return _add(shot, np.repeat(places[None], len(shot.tracks.t), axis=0), rng), truth


def add_hands(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Add objects that move as a hand does: their velocity changes smoothly and at random, and they halt."""
    t = shot.tracks.t
    paths = []
    for _ in range(int(rng.integers(1, 4))):
        seconds = rng.uniform(0.1, 0.6)
        decay = np.exp(-np.diff(t, prepend=t[0]) / seconds)
        velocity, v = np.zeros((len(t), 2)), np.zeros(2)
        speed = rng.uniform(*OBJECT_SPEED)
        for k, keep in enumerate(decay):
            v = keep * v + np.sqrt(1 - keep**2) * speed * rng.normal(size=2)
            velocity[k] = v
        paths.append(_place(shot, velocity, rng))
    return _add(shot, np.stack(paths, axis=1), rng), truth


def add_lights(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Add objects that move evenly along lines and arcs, such as projected rings and cursors, and turn at will."""
    t = shot.tracks.t
    paths = []
    for _ in range(int(rng.integers(1, 3))):
        turns = np.sort(rng.uniform(t[0], t[-1], int(rng.integers(0, 5))))
        part = np.searchsorted(turns, t)
        heading, rate = rng.uniform(0, 2 * np.pi, len(turns) + 1), rng.normal(0, 1.5, len(turns) + 1)
        speed = rng.uniform(*OBJECT_SPEED, len(turns) + 1) * (rng.random(len(turns) + 1) > 0.3)
        angle = heading[part] + rate[part] * t
        paths.append(_place(shot, speed[part, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), rng))
    return _add(shot, np.stack(paths, axis=1), rng), truth


def add_reflections(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Add reflections and shadows of balls, which move with them, shifted, scaled and mirrored."""
    moving = np.flatnonzero(shot.fit.moving.any(axis=0))
    if not len(moving):
        raise NothingToDamage("nothing moves")
    paths = []
    for ball in rng.choice(moving, min(len(moving), int(rng.integers(1, 3))), replace=False):
        xy = shot.tracks.xy[:, ball]
        centre, factor = np.nanmean(xy, axis=0), rng.uniform(0.6, 1.1) * rng.choice([1, 1, -1], 2)
        paths.append(centre + factor * (xy - centre) + rng.uniform(-REFLECTION_SHIFT, REFLECTION_SHIFT, 2))
    return _add(shot, np.stack(paths, axis=1), rng), truth


def join_two_balls(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Continue the track of one ball by another one from a random frame on, and end that of the other there."""
    tracks = shot.tracks
    if len(tracks.ids) < 2 or not shot.fit.moving.any():
        raise NothingToDamage("no two balls")
    frames, balls = np.nonzero(shot.fit.moving)
    at = int(rng.integers(len(frames)))
    row, mover = int(frames[at]), int(balls[at])
    other = int(rng.choice([k for k in range(len(tracks.ids)) if k != mover]))
    joined = {}
    names = ("xy", "px", "sigma", "sigma_along", "streak", "radius_px", "image_jacobian")
    for name, values in ((name, getattr(tracks, name)) for name in names):
        if values is None:
            continue
        values = values.copy()
        values[row:, other] = values[row:, mover]
        values[row:, mover] = np.nan
        joined[name] = values
    return replace(shot, tracks=replace(tracks, **joined)), truth


def shift_corners(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Map all places by the homography of a calibration whose corners are wrong."""
    table = shot.recording.scene.table
    shift = rng.uniform(-1, 1, (4, 2)) * rng.uniform(0, MAX_CORNER_SHIFT) * table.length
    rows = [
        row
        for (x, y), (u, v) in zip(table.corners, table.corners + shift, strict=True)
        for row in ([x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    ]
    warp = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    assert truth.paths is not None
    paths = replace(truth.paths, xy=apply_homography(warp, truth.paths.xy))
    events = tuple(replace(event, xy=apply_homography(warp, event.xy)) for event in truth.events)
    tracks = replace(shot.tracks, xy=apply_homography(warp, shot.tracks.xy))
    return replace(shot, tracks=tracks), replace(truth, events=events, paths=paths)


def knock_camera(shot: FittedShot, truth: ShotTruth, rng: np.random.Generator) -> tuple[FittedShot, ShotTruth]:
    """Knock the camera at a random time: all places swing about their own, and stay a little off."""
    t, r = shot.tracks.t, shot.recording.scene.table.ball_radius
    at, decay, hz = rng.uniform(t[0], t[-1]), rng.uniform(0.05, 0.4), rng.uniform(1.0, 8.0)
    later = np.maximum(t - at, 0.0)
    swing = np.where(t > at, np.sin(2 * np.pi * hz * later) * np.exp(-later / decay), 0.0)
    away = rng.normal(0, rng.uniform(*KNOCK_RADII) * r, (2, 2))
    shift = swing[:, None] * away[0] + (t > at)[:, None] * away[1] / 4
    return replace(shot, tracks=replace(shot.tracks, xy=shot.tracks.xy + shift[:, None])), truth


# By the name of the option.
FALSE_PREMISES: dict[str, FalsePremise] = {
    "still-objects": add_still_objects,
    "hands": add_hands,
    "lights": add_lights,
    "reflections": add_reflections,
    "joined-balls": join_two_balls,
    "wrong-corners": shift_corners,
    "knocked-camera": knock_camera,
}


def _place(shot: FittedShot, velocity: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the path (T, 2) m of an object with a velocity (T, 2), reflected at the edges of the table."""
    table, t = shot.recording.scene.table, shot.tracks.t
    size = np.array([table.length, table.width])
    path = rng.uniform(0, size) + np.cumsum(velocity * np.diff(t, prepend=t[0])[:, None], axis=0)
    return np.asarray(size - np.abs(np.mod(path, 2 * size) - size))


def _add(shot: FittedShot, xy: FloatArray, rng: np.random.Generator) -> FittedShot:
    """Add objects at (T, M, 2) m that are tracked for a random span, with the errors of the usual ball."""
    tracks, count = shot.tracks, xy.shape[1]
    xy = xy + rng.normal(0, np.nanmedian(tracks.sigma), xy.shape)
    for k in range(count):
        first, last = np.sort(rng.integers(len(tracks.t), size=2)) if rng.random() < 0.5 else (0, len(tracks.t))
        xy[:first, k] = xy[last:, k] = np.nan
    is_shown = np.isfinite(xy[..., 0])
    fill = {
        name: np.where(is_shown, np.nanmedian(getattr(tracks, name)), np.nan)
        for name in ("sigma", "sigma_along", "radius_px")
    }
    return replace(shot, tracks=_concatenate(tracks, xy, is_shown, fill))


def _concatenate(tracks: Tracks, xy: FloatArray, is_shown: FloatArray, fill: dict[str, FloatArray]) -> Tracks:
    """Add objects to tracks."""
    count = xy.shape[1]
    still = np.where(is_shown[..., None], [0.0, 0.0], np.nan)
    jacobian = tracks.image_jacobian
    if jacobian is not None:
        added = np.where(is_shown[..., None, None], np.nanmedian(jacobian, axis=(0, 1)), np.nan)
        jacobian = np.concatenate([jacobian, added], axis=1)
    return replace(
        tracks, ids=(*tracks.ids, *(f"object-{k}" for k in range(count))), kinds=(*tracks.kinds, *("ball",) * count),
        xy=np.concatenate([tracks.xy, xy], axis=1), px=np.concatenate([tracks.px, xy], axis=1),
        streak=np.concatenate([tracks.streak, still], axis=1),
        colour=np.concatenate([tracks.colour, np.repeat(tracks.colour[:1], count, axis=0)]),
        image_jacobian=jacobian, looks=(),
        **{name: np.concatenate([getattr(tracks, name), values], axis=1) for name, values in fill.items()},
    )  # fmt: skip
