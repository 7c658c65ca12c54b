"""Truth of a withheld frame: moving balls and their paths, the rest of the frame, and the best possible sprites."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.interpolation.withheld_frames import WithheldClip
from benchmarks.support.run_folder import RunFolder

# Classes of a ball in a gap: it has a contact; it moves further than its radius; it moves less far.
CLASSES = ("contact", "fast", "slow")
# Motion in a gap below which a ball rests, px: measured positions of resting balls vary by nearly as much.
LEAST_PATH = 1.0
# Half widths in ball radii of the path of a ball, and of the area outside which the frame is `elsewhere`.
PATH_RADII, AROUND_RADII = 1.25, 2.2
# Frames for the background plate, and radii around a ball that are excluded in them.
PLATE_FRAMES, UNDER_RADII = 25, 1.5
# Offsets around the observed position at which the oracle tries a ball, px.
SHIFTS = np.mgrid[-1:1.01:0.25, -1:1.01:0.25].reshape(2, -1).T
# Candidate radii of the sprite of the oracle, in ball radii.
CUTS = (1.1, 1.5, 1.9)

# Maps a frame index to the centres (2,) px and radii px of all balls.
BallLocator = Callable[[int], list[tuple[np.ndarray, float]]]


@dataclass(frozen=True)
class Passing:
    """One moving ball in one withheld frame."""

    place: int
    """Index of the frame in `WithheldClip.frames`."""
    ball: str
    kind: str
    """One of `CLASSES`."""
    centre: np.ndarray
    """(2,) px in the withheld real frame."""
    sides: tuple[np.ndarray, np.ndarray]
    """(2,) px in the neighbouring visible frames; NaN where it was not observed."""
    path: np.ndarray
    """(n, 2) px through the gap."""
    radius: float


def find_passings(withheld: WithheldClip, run: RunFolder) -> Iterator[Passing]:
    """Yield every moving ball in a withheld frame, according to a run on the whole clip."""
    for place in withheld.withheld_places():
        row = place // withheld.step
        a, b = row * withheld.step, (row + 1) * withheld.step
        for ball in np.unique(run.tracks["id"]):
            observed = _find_centres(run, str(ball), withheld.frames[a : b + 1])
            centre = observed[place - a]
            if not np.isfinite(centre).all():
                continue
            path = np.concatenate([observed, _extract_path(run, str(ball), *withheld.t[[a, b]])])
            path = path[np.isfinite(path).all(axis=1)]
            extent = float(np.hypot(*np.ptp(path, axis=0)))
            radius = float(np.nanmedian(run.tracks["radius_px"][run.tracks["id"] == ball]))
            if extent < LEAST_PATH:
                continue
            kind = "fast" if extent > radius else "slow"
            if _has_contact(run, str(ball), *withheld.t[[a, b]]):
                kind = "contact"
            yield Passing(place, str(ball), kind, centre, (observed[0], observed[-1]), path, radius)


def _find_centres(run: RunFolder, ball: str, frames: np.ndarray) -> np.ndarray:
    """Return centres (n, 2) px in the frames; NaN where the ball was not observed."""
    c = run.tracks
    px = np.full((len(frames), 2), np.nan)
    for k, frame in enumerate(frames):
        row = np.flatnonzero((c["id"] == ball) & (c["frame"] == frame) & (c["observed"] == 1))
        if len(row):
            px[k] = c["x_px"][row[0]], c["y_px"][row[0]]
    return px


def _extract_path(run: RunFolder, ball: str, first: float, last: float) -> np.ndarray:
    t, px = run.path_of(ball)
    return px[(t > first) & (t < last)]


def _has_contact(run: RunFolder, ball: str, first: float, last: float) -> bool:
    e = run.events
    mine = ((e["a"] == ball) | (e["b"] == ball)) & (e["kind"] != "rest")
    return bool(np.any(mine & (e["t"] > first) & (e["t"] < last)))


def path_masks(balls: list[Passing], shape: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Return masks (H, W) of the paths by class, the more difficult first where they cross, and of `elsewhere`."""
    masks, taken = {}, np.zeros(shape[:2], bool)
    for kind in CLASSES:
        mask = np.zeros(shape[:2], np.uint8)
        for ball in balls:
            if ball.kind == kind:
                _draw_path(mask, ball, PATH_RADII)
        masks[kind] = (mask > 0) & ~taken
        taken |= masks[kind]
    around = np.zeros(shape[:2], np.uint8)
    for ball in balls:
        _draw_path(around, ball, AROUND_RADII)
    return masks | {"elsewhere": around == 0}


def _draw_path(mask: np.ndarray, ball: Passing, radii: float) -> None:
    """Fill everything within `radii` of the path with discs, because paths bend at contacts."""
    for point in ball.path:
        cv2.circle(mask, np.rint(16 * point).astype(int).tolist(), round(16 * radii * ball.radius), 255, -1, 0, 4)


def make_ball_locator(withheld: WithheldClip, run: RunFolder) -> BallLocator:
    """Make a function that returns the ball positions of a frame, from a run on the whole clip."""
    c = run.tracks

    def find_balls(place: int) -> list[tuple[np.ndarray, float]]:
        rows = np.flatnonzero((c["frame"] == withheld.frames[place]) & np.isfinite(c["x_px"]))
        radii = {ball: float(np.nanmedian(c["radius_px"][c["id"] == ball])) for ball in c["id"][rows]}
        return [(np.array([c["x_px"][row], c["y_px"][row]]), radii[c["id"][row]]) for row in rows]

    return find_balls


def estimate_plate(frames: list[np.ndarray], locate_balls: BallLocator) -> np.ndarray:
    """Estimate the background plate: the median over frames in which no ball covers a pixel.

    Pixels that are always covered are inpainted.
    """
    places = np.unique(np.linspace(0, len(frames) - 1, PLATE_FRAMES).round().astype(int))
    stack = np.stack([frames[k] for k in places])
    hidden = np.stack([_ball_mask(locate_balls(int(k)), stack.shape[1:3]) for k in places])
    plate = np.median(stack, axis=0).astype(np.float32)
    some, never = hidden.any(axis=0), hidden.all(axis=0)
    free = np.where(hidden[:, some & ~never, None], np.nan, stack[:, some & ~never].astype(np.float32))
    plate[some & ~never] = np.nanmedian(free, axis=0)
    filled = cv2.inpaint(plate.astype(np.uint8), never.astype(np.uint8), 3, cv2.INPAINT_TELEA)
    return np.where(never[..., None], filled, plate).astype(np.float32)


def _ball_mask(balls: list[tuple[np.ndarray, float]], shape: tuple[int, ...]) -> np.ndarray:
    """Return the mask (H, W) of the balls and their surroundings."""
    mask = np.zeros(shape, np.uint8)
    for centre, radius in balls:
        cv2.circle(mask, np.rint(centre).astype(int).tolist(), int(np.ceil(UNDER_RADII * radius)), 1, -1)
    return mask > 0


def render_oracle(
    balls: list[Passing], real: np.ndarray, around: tuple[np.ndarray, ...], plate: np.ndarray
) -> np.ndarray:
    """Render the best frame of translated sprites: each ball from the better visible frame, at the least error.

    The background is the real frame away from the paths; on the paths it is a visible frame where no ball covers it, or
    the plate. The radius of the sprite (`CUTS`) is optimised too.
    """
    image = np.where(
        path_masks(balls, real.shape)["elsewhere"][..., None], real, _compose_background(balls, around, plate)
    )
    image = image.astype(np.float32)
    for ball in balls:
        best: tuple[float, np.ndarray | None, tuple[slice, slice]] = (np.inf, None, (slice(0), slice(0)))
        for side, centre in zip(around, ball.sides, strict=True):
            for shift in SHIFTS if np.isfinite(centre).all() else ():
                for cut in CUTS:
                    here, patch = _paste_ball(image, side, centre, ball.centre + shift, cut * ball.radius)
                    error = _error_change(image, real, here, patch)
                    best = min(best, (error, patch, here), key=lambda candidate: candidate[0])
        if best[1] is not None:
            image[best[2]] = best[1]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _error_change(image: np.ndarray, real: np.ndarray, here: tuple[slice, slice], patch: np.ndarray) -> float:
    """Return the growth of the squared error where `patch` is pasted into `image`."""
    if not patch.size:
        return np.inf
    return float(((patch - real[here]) ** 2).sum() - ((image[here] - real[here]) ** 2).sum())


def _compose_background(balls: list[Passing], around: tuple[np.ndarray, ...], plate: np.ndarray) -> np.ndarray:
    ground = plate.copy()
    for k, side in enumerate(around):
        free = np.zeros(plate.shape[:2], np.uint8)
        for ball in balls:
            _draw_path(free, ball, AROUND_RADII)
        for ball in balls:
            if np.isfinite(ball.sides[k]).all():
                cv2.circle(free, np.rint(ball.sides[k]).astype(int).tolist(), round(2 * ball.radius), 0, -1)
        ground = np.where(free[..., None] > 0, side, ground)
    return ground


def _paste_ball(
    ground: np.ndarray, source: np.ndarray, start: np.ndarray, end: np.ndarray, radius: float
) -> tuple[tuple[slice, slice], np.ndarray]:
    """Paste the disc of `source` around `start` at `end`; returns the area and its new content."""
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
