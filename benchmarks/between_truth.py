"""What a withheld picture shows: which balls move how, where their paths lie, and what is elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from run_folder import RunFolder
from withheld import Withheld

CLASSES = ("contact", "fast", "slow")
"""Of a ball in a gap: it meets something; it goes further than its radius; it goes less far."""
LEAST_WAY = 1.0
"""px within a gap below which a ball rests: the measured places of resting balls wander by nearly as much."""
PATH_RADII, AROUND_RADII = 1.25, 2.2
"""Radii around its way that are a ball's path, and beyond which the picture is `elsewhere`."""
PLATE_PICTURES, UNDER_RADII = 25, 1.5
"""Pictures that the empty table is learnt from, and radii around a ball in which they do not show it."""
SHIFTS = np.mgrid[-1:1.01:0.25, -1:1.01:0.25].reshape(2, -1).T
"""px around the seen place at which the oracle tries a ball."""
CUTS = (1.1, 1.5, 1.9)
"""Radii of the disc that it takes along."""

Lying = Callable[[int], list[tuple[np.ndarray, float]]]
"""Centres (2,) px and radii px of all balls on the picture of a place."""


@dataclass(frozen=True)
class Passing:
    """One moving ball on one withheld picture."""

    place: int
    """Of the picture in `Withheld.frames`."""
    ball: str
    kind: str
    """One of CLASSES."""
    centre: np.ndarray
    """(2,) px on the withheld real picture."""
    sides: tuple[np.ndarray, np.ndarray]
    """(2,) px on the visible pictures around; NaN where it was not seen."""
    way: np.ndarray
    """(n, 2) px over the gap."""
    radius: float


def passings(held: Withheld, run: RunFolder) -> Iterator[Passing]:
    """Every moving ball that was seen on a withheld picture, by the run of the whole clip."""
    for place in held.hidden():
        row = place // held.step
        a, b = row * held.step, (row + 1) * held.step
        for ball in np.unique(run.tracks["id"]):
            seen = _seen(run, str(ball), held.frames[a : b + 1])
            centre = seen[place - a]
            if not np.isfinite(centre).all():
                continue
            way = np.concatenate([seen, _fitted_way(run, str(ball), *held.t[[a, b]])])
            way = way[np.isfinite(way).all(axis=1)]
            extent = float(np.hypot(*np.ptp(way, axis=0)))
            radius = float(np.nanmedian(run.tracks["radius_px"][run.tracks["id"] == ball]))
            if extent < LEAST_WAY:
                continue
            kind = "contact" if _meets(run, str(ball), *held.t[[a, b]]) else ("fast" if extent > radius else "slow")
            yield Passing(place, str(ball), kind, centre, (seen[0], seen[-1]), way, radius)


def _seen(run: RunFolder, ball: str, frames: np.ndarray) -> np.ndarray:
    """(n, 2) px at frames; NaN where the ball was not observed."""
    c = run.tracks
    px = np.full((len(frames), 2), np.nan)
    for k, frame in enumerate(frames):
        row = np.flatnonzero((c["id"] == ball) & (c["frame"] == frame) & (c["observed"] == 1))
        if len(row):
            px[k] = c["x_px"][row[0]], c["y_px"][row[0]]
    return px


def _fitted_way(run: RunFolder, ball: str, first: float, last: float) -> np.ndarray:
    t, px = run.path_of(ball)
    return px[(t > first) & (t < last)]


def _meets(run: RunFolder, ball: str, first: float, last: float) -> bool:
    e = run.events
    mine = ((e["a"] == ball) | (e["b"] == ball)) & (e["kind"] != "rest")
    return bool(np.any(mine & (e["t"] > first) & (e["t"] < last)))


def path_masks(balls: list[Passing], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """(H, W) of the paths by class, the more difficult first where they cross; and of what is `elsewhere`."""
    masks, taken = {}, np.zeros(shape[:2], bool)
    for kind in CLASSES:
        mask = np.zeros(shape[:2], np.uint8)
        for ball in balls:
            if ball.kind == kind:
                _stroke(mask, ball, PATH_RADII)
        masks[kind] = (mask > 0) & ~taken
        taken |= masks[kind]
    around = np.zeros(shape[:2], np.uint8)
    for ball in balls:
        _stroke(around, ball, AROUND_RADII)
    return masks | {"elsewhere": around == 0}


def _stroke(mask: np.ndarray, ball: Passing, radii: float) -> None:
    """All within `radii` of the ball's way, drawn as discs: ways of contacts bend."""
    for point in ball.way:
        cv2.circle(mask, np.rint(16 * point).astype(int).tolist(), round(16 * radii * ball.radius), 255, -1, 0, 4)


def lying_in(held: Withheld, run: RunFolder) -> Lying:
    """Where balls lie, by the run of the whole clip, seen or filled in."""
    c = run.tracks

    def lying(place: int) -> list[tuple[np.ndarray, float]]:
        rows = np.flatnonzero((c["frame"] == held.frames[place]) & np.isfinite(c["x_px"]))
        radii = {ball: float(np.nanmedian(c["radius_px"][c["id"] == ball])) for ball in c["id"][rows]}
        return [(np.array([c["x_px"][row], c["y_px"][row]]), radii[c["id"][row]]) for row in rows]

    return lying


def plate_of(pictures: list[np.ndarray], lying: Lying) -> np.ndarray:
    """The table without balls: the median over pictures spread over the clip, of those in which none lies there.

    Where one always lies, what is around it goes on.
    """
    places = np.unique(np.linspace(0, len(pictures) - 1, PLATE_PICTURES).round().astype(int))
    stack = np.stack([pictures[k] for k in places])
    hidden = np.stack([_under(lying(int(k)), stack.shape[1:3]) for k in places])
    plate = np.median(stack, axis=0).astype(np.float32)
    some, never = hidden.any(axis=0), hidden.all(axis=0)
    free = np.where(hidden[:, some & ~never, None], np.nan, stack[:, some & ~never].astype(np.float32))
    plate[some & ~never] = np.nanmedian(free, axis=0)
    filled = cv2.inpaint(plate.astype(np.uint8), never.astype(np.uint8), 3, cv2.INPAINT_TELEA)
    return np.where(never[..., None], filled, plate).astype(np.float32)


def _under(balls: list[tuple[np.ndarray, float]], shape: tuple[int, ...]) -> np.ndarray:
    """(H, W) what lies under balls, or beside them."""
    mask = np.zeros(shape, np.uint8)
    for centre, radius in balls:
        cv2.circle(mask, np.rint(centre).astype(int).tolist(), int(np.ceil(UNDER_RADII * radius)), 1, -1)
    return mask > 0


def oracle_picture(
    balls: list[Passing], real: np.ndarray, around: tuple[np.ndarray, ...], plate: np.ndarray
) -> np.ndarray:
    """The best that cut and pasted balls can do: each from the better visible picture, at the place of least error.

    The ground is the real picture away from the paths, there a visible one where no ball lies on it, or the plate. How
    much of its surroundings a ball takes along (`CUTS`) is chosen as well.
    """
    made = np.where(path_masks(balls, real.shape)["elsewhere"][..., None], real, _ground(balls, around, plate))
    made = made.astype(np.float32)
    for ball in balls:
        best: tuple[float, np.ndarray | None, tuple[slice, slice]] = (np.inf, None, (slice(0), slice(0)))
        for side, centre in zip(around, ball.sides, strict=True):
            for shift in SHIFTS if np.isfinite(centre).all() else ():
                for cut in CUTS:
                    here, patch = _pasted(made, side, centre, ball.centre + shift, cut * ball.radius)
                    error = _error(made, real, here, patch)
                    best = min(best, (error, patch, here), key=lambda found: found[0])
        if best[1] is not None:
            made[best[2]] = best[1]
    return np.clip(np.rint(made), 0, 255).astype(np.uint8)


def _error(made: np.ndarray, real: np.ndarray, here: tuple[slice, slice], patch: np.ndarray) -> float:
    """By how much the sum of squares grows where `patch` is laid over `made`."""
    if not patch.size:
        return np.inf
    return float(((patch - real[here]) ** 2).sum() - ((made[here] - real[here]) ** 2).sum())


def _ground(balls: list[Passing], around: tuple[np.ndarray, ...], plate: np.ndarray) -> np.ndarray:
    ground = plate.copy()
    for k, side in enumerate(around):
        free = np.zeros(plate.shape[:2], np.uint8)
        for ball in balls:
            _stroke(free, ball, AROUND_RADII)
        for ball in balls:
            if np.isfinite(ball.sides[k]).all():
                cv2.circle(free, np.rint(ball.sides[k]).astype(int).tolist(), round(2 * ball.radius), 0, -1)
        ground = np.where(free[..., None] > 0, side, ground)
    return ground


def _pasted(
    ground: np.ndarray, source: np.ndarray, start: np.ndarray, end: np.ndarray, radius: float
) -> tuple[tuple[slice, slice], np.ndarray]:
    """Where, and how `ground` looks there with the disc of `source` around `start` moved to `end`."""
    low = np.maximum(np.floor(end - radius - 2), 0).astype(int)
    high = np.minimum(np.ceil(end + radius + 3), ground.shape[1::-1]).astype(int)
    here = (slice(low[1], high[1]), slice(low[0], high[0]))
    size = tuple(int(v) for v in high - low)
    if min(size) <= 0:
        return here, np.empty(0)
    shift = np.array([[1.0, 0.0, (end - start - low)[0]], [0.0, 1.0, (end - start - low)[1]]])
    moved = cv2.warpAffine(source, shift, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    mask = np.clip(radius - np.hypot(x - end[0], y - end[1]) + 0.5, 0, 1)[..., None]
    return here, ground[here] * (1 - mask) + moved * mask
