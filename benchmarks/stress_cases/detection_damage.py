"""Damage to the detections of a shot, before tracking."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.stress_cases.ball_matching import BallMatch
from benchmarks.stress_cases.shot_truth import ShotTruth
from benchmarks.stress_cases.stress_chain import FittedShot, Recording
from models.core.detections import Detections
from models.core.typing import IntArray

# Length and number of the gaps of one ball.
GAP_FRAMES, GAPS = 3, 3
# Distance from a pocket within which detections are removed, in ball radii.
POCKET_RADII = 4.0
# Number of false detections over that of true ones.
FALSE_SHARE = 0.05
# Streak up to which a detection is sharp.
SHARP_PX = 1.0


class NothingToDamage(Exception):
    """The shot has nothing that this damage could act on."""


@dataclass(frozen=True, slots=True)
class Damaged:
    """A damaged recording; `kept` are the frames that are left, None where none was removed."""

    recording: Recording
    kept: IntArray | None = None


DetectionDamage = Callable[[FittedShot, ShotTruth, BallMatch, np.random.Generator], Damaged]


def remove_every_second_frame(
    shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator
) -> Damaged:
    """Remove every second distinct frame, from a random one of the first two."""
    return _keep_frames(shot.recording, shot.recording.frame[int(rng.integers(2)) :: 2])


def cut_start(shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator) -> Damaged:
    """Cut the frames before a random one from just after the strike to just after the first contact."""
    strike = next((event for event in truth.events if event.kind == "strike"), None)
    if strike is None:
        raise NothingToDamage("no strike")
    contacts = [e for e in truth.events if e.kind in ("ball", "cushion", "pocket") and e.hi > strike.hi]
    begin, stop = int(np.ceil(strike.hi)), int(np.ceil(contacts[0].hi)) + 1 if contacts else int(strike.hi) + 11
    first = int(rng.integers(begin, max(stop, begin + 1) + 1))
    damaged = _keep_frames(shot.recording, shot.recording.frame[shot.recording.frame >= first])
    recording = damaged.recording
    if len(recording.t) < 5:
        raise NothingToDamage("too few frames remain")
    return Damaged(replace(recording, t=recording.t - recording.t[0]), damaged.kept)


def hide_contacts(shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator) -> Damaged:
    """Remove the detections of both balls within one distinct frame of half of the contacts."""
    contacts = [e for e, event in enumerate(truth.events) if event.kind in ("ball", "cushion") and match.a[e]]
    if not contacts:
        raise NothingToDamage("no contact")
    frame, remove = shot.recording.frame, np.zeros(len(shot.recording.detections), dtype=bool)
    owner = _find_owners(shot)
    for e in rng.choice(contacts, (len(contacts) + 1) // 2, replace=False):
        event = truth.events[e]
        first, last = np.searchsorted(frame, event.lo, "right") - 1, np.searchsorted(frame, event.hi)
        near = frame[max(first, 0) : last + 1]
        remove |= np.isin(owner, list(match.a[e] | match.b[e])) & np.isin(shot.recording.detections.frame, near)
    return _drop(shot.recording, remove)


def hide_ball(shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator) -> Damaged:
    """Remove three successive detections of one moving ball at random places."""
    moving = {name: np.flatnonzero(shot.fit.moving[:, k]) for k, name in enumerate(shot.tracks.ids)}
    names = [name for name, rows in moving.items() if len(rows) > GAP_FRAMES]
    if not names:
        raise NothingToDamage("nothing moves")
    name = names[int(rng.integers(len(names)))]
    hidden = [shot.tracks.frame[row : row + GAP_FRAMES] for row in rng.choice(moving[name], GAPS)]
    is_hidden = np.isin(shot.recording.detections.frame, np.concatenate(hidden))
    return _drop(shot.recording, (_find_owners(shot) == name) & is_hidden)


def hide_pockets(shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator) -> Damaged:
    """Remove all detections near pockets."""
    detections, scene = shot.recording.detections, shot.recording.scene
    if not scene.table.pockets:
        raise NothingToDamage("no pockets")
    xy = scene.camera.to_table(detections.centre, scene.table.ball_radius, detections.frame)
    away = np.linalg.norm(xy[:, None] - scene.table.pocket_centres, axis=2).min(axis=1)
    return _drop(shot.recording, away < POCKET_RADII * scene.table.ball_radius)


def add_false_detections(shot: FittedShot, truth: ShotTruth, match: BallMatch, rng: np.random.Generator) -> Damaged:
    """Add copies of sharp detections at random places of the table in random frames, with the radius of that place."""
    recording, table, camera = shot.recording, shot.recording.scene.table, shot.recording.scene.camera
    detections, r = recording.detections, recording.scene.table.ball_radius
    sharp = np.flatnonzero(np.linalg.norm(detections.streak, axis=1) < SHARP_PX)
    if not len(sharp):
        raise NothingToDamage("no sharp detection")
    count = max(1, round(FALSE_SHARE * len(detections)))
    copied, frame = rng.choice(sharp, count), rng.choice(recording.frame, count)
    xy = rng.uniform([r, r], [table.length - r, table.width - r], (count, 2))
    old = camera.to_table(detections.centre[copied], r, detections.frame[copied])
    new = {
        "frame": frame,
        "centre": camera.to_pixels(xy, r, frame),
        "radius": detections.radius[copied] * camera.radius_px(xy, r) / camera.radius_px(old, r),
    }
    order = np.argsort(np.concatenate([detections.frame, frame]), kind="stable")
    columns = {name: getattr(detections, name) for name in (one.name for one in fields(Detections))}
    both = {name: np.concatenate([old, new.get(name, old[copied])])[order] for name, old in columns.items()}
    return Damaged(replace(recording, detections=Detections(**both)))


def _find_owners(shot: FittedShot) -> NDArray[np.str_]:
    """Return the id (K,) of the track that has each detection; empty where none has it."""
    detections, tracks = shot.recording.detections, shot.tracks
    owner = np.full(len(detections), "", dtype=f"<U{max(map(len, tracks.ids))}")
    row = np.searchsorted(tracks.frame, detections.frame)
    inside = np.flatnonzero(np.isin(detections.frame, tracks.frame))
    for k, name in enumerate(tracks.ids):
        away = np.abs(tracks.px[row[inside], k] - detections.centre[inside]).max(axis=1)
        owner[inside[away < 1e-6]] = name  # NaN compares false
    return owner


def _keep_frames(recording: Recording, kept: IntArray) -> Damaged:
    rows = np.isin(recording.frame, kept)
    detections = recording.detections.select_rows(np.isin(recording.detections.frame, kept))
    return Damaged(Recording(detections, recording.frame[rows], recording.t[rows], recording.scene), kept)


def _drop(recording: Recording, remove: NDArray[np.bool_]) -> Damaged:
    if not remove.any():
        raise NothingToDamage("no detection to remove")
    return Damaged(replace(recording, detections=recording.detections.select_rows(~remove)))


# Damages by the name of the option.
DETECTION_DAMAGES: dict[str, DetectionDamage] = {
    "second-frames": remove_every_second_frame,
    "contacts": hide_contacts,
    "ball-gaps": hide_ball,
    "pockets": hide_pockets,
    "false-balls": add_false_detections,
    "late-start": cut_start,
}
