"""A fast ball as the camera adds it up: the share of the exposure for which a moving disc covers each pixel.

A pixel that the disc covers for a share a of the exposure shows (1 - a) of the cloth and a of the ball. For a disc of
the predicted size that goes from one place to another this share is known in closed form, ends included; place, way and
the two colours follow by least squares (variable projection: Golub and Pereyra 1973, doi:10.1137/0710036).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np

from detectors.measurement.circle_fit import weighed
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

WAYS_RADII = np.array([0.0, 0.8, 1.6, 2.6, 3.8, 5.2, 6.8])
"""Lengths that are tried, ball radii."""
DIRECTIONS_TRIED = 12
ALONG_TRIED = np.array([-0.45, -0.22, 0.0, 0.22, 0.45])
"""Where on its streak a ball may have been seen, share of the length from the middle."""
BESIDE_TRIED = np.array([-0.35, 0.0, 0.35])
"""The same across it, ball radii."""
REACH_RADII = 6.0
"""How far from where a ball was seen its streak is looked for."""
COARSE_RADII = 0.3
"""Spacing of the pixels that are looked at first, ball radii."""
FINE_RADII = 0.12
"""The same for those that the streak is fitted to, where it is more than one px."""
MARGIN_RADII = 1.0
"""Cloth that is looked at about a streak, ball radii."""
KEPT_OFF_RADII = 1.15
"""About other balls the picture is left out."""
SOFTENED, BLUR_PX = np.array([-1.0, 0.0, 1.0]), 0.75
"""Radii that are averaged, from the ball's, in units of the blur of lens and coding."""
LEAST_PIXELS = 60
LEAST_GAIN = 1.1
"""Contrast that a way must explain, over what a ball at rest does, for it to be looked at closely."""
TURNS = 10
HUBER = 2.0
"""Root mean square misses from which a pixel counts less."""
HOPELESS_LEFT = 0.5
"""Share of the contrast left by the rough streak from which it is not looked at closely."""
MOST_LEFT, MOST_OF_REST = 0.15, 0.5
"""Share of the contrast that a streak may leave, of all and of what a ball at rest leaves."""
WAY_BAND = (0.8, 7.5)
"""Ways, ball radii, that are believed."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """A streak in the picture, px."""

    centre: FloatArray
    """(2,) of the ball at mid-exposure."""
    way: FloatArray
    """(2,) travelled during the exposure, sign unknown."""
    left: float
    """Squared miss of the picture, over that of bare cloth."""
    left_at_rest: float
    """The same for a ball at rest."""

    def believed(self, radius: float) -> bool:
        """Whether a ball of a radius, px, that moves explains the picture, and one at rest does not."""
        way = float(np.linalg.norm(self.way)) / radius
        clear = self.left < MOST_LEFT and self.left < MOST_OF_REST * self.left_at_rest
        return clear and WAY_BAND[0] < way < WAY_BAND[1]


def share_covered(
    at: FloatArray, centre: FloatArray, way: FloatArray, radius: float, blur: float = BLUR_PX
) -> FloatArray:
    """Share (...) of the exposure for which a disc, its rim as soft as `blur`, covers places (..., 2)."""
    length = max(float(np.linalg.norm(way)), 1e-6)
    unit = way / length
    off = at - centre
    ahead = off @ unit
    beside = off[..., 1] * unit[0] - off[..., 0] * unit[1]
    total = np.zeros(ahead.shape)
    for soft in SOFTENED:
        chord = np.sqrt(np.maximum((radius + soft * blur) ** 2 - beside**2, 0))
        low = np.maximum(ahead - chord, -length / 2)
        high = np.minimum(ahead + chord, length / 2)
        total += np.clip(high - low, 0, None) / length
    return np.asarray(total / len(SOFTENED))


def fitted_sweep(
    rgb: ByteArray,
    seen: FloatArray,
    radius: float,
    others: FloatArray,
    other_radii: FloatArray,
    basis: FloatArray,
    way: FloatArray | None = None,
) -> Sweep | None:
    """The streak about a place (2,) px where a ball was seen; None where there is too little picture.

    Other balls, centres (n, 2) and radii (n,) px, are left out. Many ways are tried unless one, (2,) px, is given.
    """
    rough = _rough(rgb, seen, radius, others, other_radii, basis) if way is None else (seen, way, seen)
    if rough is None:
        return None
    centre, way, rest = rough
    reach = np.abs(way) / 2 + (1 + MARGIN_RADII) * radius
    at = _grid(rgb, centre - reach, centre + reach, max(1.0, FINE_RADII * radius))
    at = at[_near(at, centre, way, (1 + MARGIN_RADII) * radius)]
    at = at[_bare(at, others, other_radii)]
    if len(at) < LEAST_PIXELS:
        return None
    colours = _colours(rgb, at, basis)
    place = np.concatenate([centre, way])
    damping, best = 1e-2, np.inf
    miss = _miss(place, at, colours, radius)
    bare = max(float(((colours - np.median(colours, axis=0)) ** 2).sum()), 1e-9)
    if (miss**2).sum() > HOPELESS_LEFT * bare:
        return None
    for _ in range(TURNS):
        size = np.linalg.norm(miss, axis=1)
        weights = np.minimum(1.0, HUBER * np.sqrt((size**2).mean()) / np.maximum(size, 1e-9))
        best = float((weights[:, None] * miss**2).sum())
        slopes = _slopes(place, at, colours, radius, miss)
        normal = np.einsum("n,nci,ncj->ij", weights, slopes, slopes)
        right = -np.einsum("n,nci,nc->i", weights, slopes, miss)
        for _ in range(5):
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), right)
            trial = place + np.clip(step, -radius, radius)
            other = _miss(trial, at, colours, radius)
            if float((weights[:, None] * other**2).sum()) < best:
                place, miss, damping = trial, other, damping / 3
                break
            damping *= 4
        else:
            break
        if np.abs(step).max() < 0.01:
            break
    resting = _miss(np.append(rest, [1e-3, 0.0]), at, colours, radius)
    left = float((miss**2).sum()) / bare
    return Sweep(place[:2], place[2:], left, float((resting**2).sum()) / bare)


def _rough(
    rgb: ByteArray, seen: FloatArray, radius: float, others: FloatArray, other_radii: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Best of many places and ways, and the best place of a ball at rest; None where no way explains much more."""
    lattice, tried, shares, squares = _templates()
    at = seen + radius * lattice
    inside = ((at >= 0) & (at <= np.array(rgb.shape[1::-1]) - 1)).all(axis=1)
    free = inside & _bare(at, others, other_radii)
    if free.sum() < LEAST_PIXELS:
        return None
    colours = _colours(rgb, at, basis)
    away = np.where(free[:, None], colours - np.median(colours[free], axis=0), 0.0).astype(np.float32)
    covered = squares @ free.astype(np.float32)
    gained = ((shares @ away) ** 2).sum(axis=1) / np.maximum(covered, 1.0)
    resting = np.linalg.norm(tried[:, 2:], axis=1) < 1e-3
    best, rest = int(np.argmax(gained)), int(np.argmax(np.where(resting, gained, 0.0)))
    if gained[best] < LEAST_GAIN * gained[rest]:
        return None
    return seen + radius * tried[best, :2], radius * tried[best, 2:], seen + radius * tried[rest, :2]


@lru_cache(maxsize=1)
def _templates() -> tuple[FloatArray, FloatArray, Float32Array, Float32Array]:
    """Pixels (n, 2), places and ways (m, 4), in ball radii about where a ball was seen; shares (m, n), and squared."""
    side = np.arange(-REACH_RADII, REACH_RADII + 1e-9, COARSE_RADII)
    lattice = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    lattice = lattice[np.linalg.norm(lattice, axis=1) <= REACH_RADII]
    angles = np.arange(DIRECTIONS_TRIED) * np.pi / DIRECTIONS_TRIED
    rows = [
        _tried(np.array([np.cos(angle), np.sin(angle)]), length, along, beside)
        for angle, length, along, beside in product(angles, WAYS_RADII, ALONG_TRIED, BESIDE_TRIED)
    ]
    tried = np.array(rows)
    shares = np.array([share_covered(lattice, row[:2], row[2:], 1.0, 0.1) for row in tried], dtype=np.float32)
    return lattice, tried, shares, shares**2


def _tried(unit: FloatArray, length: float, along: float, beside: float) -> FloatArray:
    """Place and way (4,), ball radii, of a streak in a direction (2,)."""
    side = np.array([-unit[1], unit[0]])
    return np.concatenate([along * max(length, 1.0) * unit + beside * side, max(length, 1e-4) * unit])


def _miss(place: FloatArray, at: FloatArray, colours: FloatArray, radius: float) -> FloatArray:
    """What (n, 3) the best colours of cloth and ball leave of the picture."""
    share = share_covered(at, place[:2], place[2:], radius)
    unit = place[2:] / max(float(np.linalg.norm(place[2:])), 1e-9)
    off = at - place[:2]
    beside = (off[:, 1] * unit[0] - off[:, 0] * unit[1]) / radius
    # Cloth, ball, and a ball that is lighter on one side.
    design = np.column_stack([np.ones(len(at)), share, share * beside])
    answer = np.linalg.solve(design.T @ design + 1e-6 * np.eye(3), design.T @ colours)
    return np.asarray(colours - design @ answer)


def _slopes(place: FloatArray, at: FloatArray, colours: FloatArray, radius: float, miss: FloatArray) -> FloatArray:
    """Change (n, 3, 4) of the misses with place and way."""
    step = 0.25
    return np.stack([(_miss(place + step * e, at, colours, radius) - miss) / step for e in np.eye(4)], axis=2)


def _grid(rgb: ByteArray, low: FloatArray, high: FloatArray, step: float) -> FloatArray:
    """Px (n, 2) of the picture between two corners."""
    limit = np.array(rgb.shape[1::-1]) - 1.0
    low, high = np.clip(low, 0, limit), np.clip(high, 0, limit)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1e-9, step), np.arange(low[1], high[1] + 1e-9, step))
    return np.column_stack([x.ravel(), y.ravel()])


def _near(at: FloatArray, centre: FloatArray, way: FloatArray, reach: float) -> BoolArray:
    """Which px (n, 2) lie within a reach of a streak."""
    share = np.clip((at - centre) @ way / max(float(way @ way), 1e-9), -0.5, 0.5)
    return np.asarray(np.linalg.norm(at - centre - share[:, None] * way, axis=1) <= reach)


def _bare(at: FloatArray, others: FloatArray, radii: FloatArray) -> BoolArray:
    """Which px (n, 2) lie off other balls."""
    if not len(others):
        return np.ones(len(at), dtype=bool)
    apart = np.linalg.norm(at[:, None] - others[None], axis=-1)
    return np.asarray((apart > KEPT_OFF_RADII * radii).all(axis=1))


def _colours(rgb: ByteArray, at: FloatArray, basis: FloatArray) -> FloatArray:
    """Colours (n, 3) at px (n, 2), in the cloth's basis with brightness weighed down."""
    place = at[None].astype(np.float32)
    seen = cv2.remap(rgb, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.transform(seen.astype(np.float32), weighed(basis))[0], dtype=np.float64)
