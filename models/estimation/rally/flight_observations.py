"""What the camera saw of the object, ready for a fit: pixels without distortion, projections and whitening."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.core.court import FlyingObject
from models.core.court_camera import CourtCamera
from models.core.rally import RallyEventKind
from models.core.scene import apply_homography
from models.core.typing import BoolArray, FloatArray, IntArray

# Student-like loss: residuals far beyond this many standard deviations no longer pull. A detector's places have
# tails that are wider than its own sigma says.
ROBUST_SCALE = 3.0
# px that an object at rest seems to move at most to either side, and s that it then stays: one at its apex stays as
# near for 0.29 s, where 60 px show a metre.
REST_PX, _REST_TIME = 3.0, 0.3
# Natural logarithm of the density of clutter per standard deviation of a place: 1/(2 pi sigma^2) against an image. It
# is the price of an observation that no flight explains, within the time of a flight or outside of it.
CLUTTER_COST = 12.0
# Bounded squares at which a flight and clutter explain a place equally well: costs are twice logarithms of evidence.
EVEN_SQUARES = 2 * (CLUTTER_COST - float(np.log(2)))
# Natural logarithm of the evidence of what a person marked: no explanation without it may win.
MARK_EVIDENCE = 1000.0


@dataclass(frozen=True, slots=True)
class EventMark:
    """An event that a person saw, or saw not to happen."""

    kind: RallyEventKind
    t: float
    sigma: float
    tolerance: float
    """s from it within which an event is the marked one."""
    is_there: bool

    def is_near(self, t: FloatArray | float) -> BoolArray:
        """Return whether events at times (...), s, are the marked one."""
        return np.asarray(np.abs(t - self.t) <= self.tolerance)


def weigh_marks(marks: tuple[EventMark, ...], kinds: tuple[RallyEventKind | None, ...], t: FloatArray) -> float:
    """Weigh events of some kinds at times t, s, by the marks, as natural logarithm of evidence."""
    events = list(zip(kinds, t.tolist(), strict=True))
    there = sum(any(mark.kind == kind and mark.is_near(at) for kind, at in events) for mark in marks if mark.is_there)
    denied = [{one.is_there for one in marks if one.kind == kind and one.is_near(at)} for kind, at in events]
    return MARK_EVIDENCE * (there - denied.count({False}))


@dataclass(frozen=True, slots=True)
class FlightObservations:
    """Places in the image at N times, in the order of time."""

    t: FloatArray
    """(N,) s."""
    px: FloatArray
    """(N, 2) px, as a lens without distortion would show them."""
    matrix: FloatArray
    """(N, 3, 4) projections of places in space."""
    whitening: FloatArray
    """(N, 2, 2) from px to standard deviations: across the streak, and along it."""
    is_resting: BoolArray
    """(N,) whether the object lies still, in a hand or on the floor: no flight has to explain it."""
    players: FloatArray = field(default_factory=lambda: np.empty((0, 7)))
    """(P, 7) people on the court: s; left, top, right and bottom, px; x and y of their feet, m."""
    marks: tuple[EventMark, ...] = ()
    placed: FloatArray = field(default_factory=lambda: np.empty(0))
    """(H,) s, times of the places that a person set: they show no other thing."""

    def bound_clutter(self, most: float) -> FloatArray:
        """Bound (N,) what an observation costs as another thing; without bound where a person set the place."""
        return np.where(np.isin(self.t, self.placed), np.inf, most)

    def __len__(self) -> int:
        return len(self.t)

    def select(self, rows: slice | IntArray | BoolArray) -> FlightObservations:
        """Return the observations of some rows."""
        names = ("t", "px", "matrix", "whitening", "is_resting")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def prepare_observations(
    camera: CourtCamera,
    frame: NDArray[np.int64],
    t: FloatArray,
    px: FloatArray,
    streak: FloatArray,
    sigma: FloatArray,
) -> FlightObservations:
    """Prepare the places (N, 2), px, of frames (N,) at times (N,).

    Args:
        frame: (N,) indices in the file.
        t: (N,) s.
        px: (N, 2) seen pixels.
        streak: (N, 2) px; (0, 0) where sharp.
        sigma: (N, 2) px across and along the streak.

    Returns:
        The observations.
    """
    matrix = np.broadcast_to(camera.matrix_of(frame), (len(t), 3, 4))
    length = np.linalg.norm(streak, axis=1)
    along = np.where(length[:, None] > 0, streak / np.where(length, length, 1.0)[:, None], [1.0, 0.0])
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    whitening = np.stack([across / sigma[:, :1], along / sigma[:, 1:]], axis=1)
    flat = camera.undistort(px)
    resting = np.zeros(len(t), np.bool_)
    return FlightObservations(t, flat, np.ascontiguousarray(matrix), whitening, resting)


def find_rests(px: FloatArray, t: FloatArray) -> BoolArray:
    """Find where an object at places (N, 2), px, of an image that stands still, does not move for a while.

    One that is unseen for as long may have flown away and come back.
    """
    resting, first = np.zeros(len(px), np.bool_), 0
    for last in range(len(px)):
        if last and t[last] - t[last - 1] >= _REST_TIME:
            first = last
        while (np.ptp(px[first : last + 1], axis=0) > 2 * REST_PX).any():
            first += 1
        if t[last] - t[first] >= _REST_TIME:
            resting[first : last + 1] = True
    return resting


def stabilize_places(camera: CourtCamera, frame: NDArray[np.int64], px: FloatArray) -> FloatArray:
    """Map seen pixels (N, 2) of frames (N,) into the reference image, in which a camera that turns seems to stand."""
    flat, motion = camera.undistort(px), camera.motion_of(frame)
    return flat if motion is None else apply_homography(np.asarray(np.linalg.inv(motion)), flat)


def compare_places(observed: FlightObservations, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compare places in space (N, 3), m, with what was observed of them.

    Args:
        observed: N observations.
        xyz: (N, 3) m.

    Returns:
        Residuals (N, 2) in standard deviations, and their derivatives (N, 2, 3) by the places. A place behind the
        camera counts as just before it, far from what was seen.
    """
    ahead = np.einsum("nij,nj->ni", observed.matrix[:, :, :3], xyz) + observed.matrix[:, :, 3]
    depth = np.maximum(ahead[:, 2], 0.1)
    px = ahead[:, :2] / depth[:, None]
    by = (observed.matrix[:, :2, :3] - px[:, :, None] * observed.matrix[:, 2:, :3]) / depth[:, None, None]
    residual = np.einsum("nij,nj->ni", observed.whitening, px - observed.px)
    return residual, np.asarray(observed.whitening @ by)


def weigh_by_law(by_place: FloatArray, xyz: FloatArray, item: FlyingObject) -> FloatArray:
    """Compute by how much the errors of the law of flight lower the weight of observations.

    Args:
        by_place: (N, 2, 3) derivatives of residuals by places.
        xyz: (N, 3) m, places of one flight, in the order of time.
        item: The object.

    Returns:
        Factors (N,) on residuals and derivatives.
    """
    error = np.full(len(xyz), item.law_error)
    if item.turn_length > 0:  # after whatever event, its nose points elsewhere than it flies
        steps = np.linalg.norm(np.diff(xyz, axis=0, prepend=xyz[:1]), axis=1)
        error += item.turn_error * np.exp(-np.cumsum(steps) / item.turn_length)
    largest = np.linalg.norm(by_place, axis=2).max(axis=1, initial=0.0)
    return np.asarray(1 / np.sqrt(1 + (error * largest) ** 2))


def bound_residuals(
    residual: FloatArray, scale: float = ROBUST_SCALE, most: FloatArray | float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Bound the pull of outliers.

    Args:
        residual: (N, 2) standard deviations.
        scale: Standard deviations from which they pull less.
        most: (N,) largest loss of evidence, as a natural logarithm, by one place. A place that would lose more shows
            another thing, and does not pull (a mixture of two densities). Its squares reach twice as much.

    Returns:
        Factors (N,) on the residuals, whose squares then add to the robust cost, and factors (N,) on their derivatives.
    """
    square = np.maximum((residual**2).sum(axis=1), 1e-12) / scale**2
    cost = scale**2 * np.log1p(square)
    other = np.logaddexp(0.0, cost / 2 - most)
    cost, share = np.maximum(cost - 2 * (other - np.logaddexp(0.0, -np.asarray(most))), 1e-12), np.exp(-other)
    factor = np.sqrt(cost / square) / scale
    return factor, share / ((1 + square) * factor)
