"""What is painted on a ball: how a sighting differs from a ball of one colour in the same light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from video.sprites import Sprite

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]

REACH, PER_PX, SIDES = 1.2, 1.2, (25, 61)
"""Radii (half a side) of the views in which balls are compared, their pixels for one of the picture, and how many."""
RIM_PX, FLAT = 2.5, (0.6, 0.9)
"""px within the rim in which coding mixes the colours of ball and cloth, and radii, at least and at most, beyond which
paint is looked up nowhere: there it is too foreshortened."""
IN_SIGHT = 0.15
"""Cosine to the line of sight over which paint that comes into sight at the rim is trusted more and more."""
FITS, ODD = 5, 10.0
"""Of the colour of a ball under its light: repeats, and levels of 255 beyond which a pixel has another paint."""
LEAST_MARK = 20.0
"""Levels of 255, over a few pixels, from which on another colour is paint, at twice that wholly: less is noise, or
light."""
SHINE_RADII, LEAST_SHINE = 0.45, 8.0
"""Radii below which a bright spot that stays is a reflection, and levels of 255 by which it is brighter."""


@dataclass(frozen=True, slots=True)
class Paint:
    """The marks on a ball as one sighting shows them, in a view (s, s) of `REACH` radii to each side of its centre."""

    marks: Singles
    """(s, s, 3) levels above or below the colour of the ball there; beyond the disc that of its border goes on."""
    seen: Singles
    """(s, s) 0 to 1."""
    radius: float
    """px"""

    @property
    def disc(self) -> tuple[Mask, Singles]:
        """(s, s) where the view shows paint, and (s, s, 3) unit normals."""
        return _disc(flat_of(self.radius), len(self.seen))

    @property
    def share(self) -> float:
        """Of the disc, how much is covered with marks."""
        return float((np.abs(self.marks[self.disc[0]]).max(axis=-1) > LEAST_MARK).mean())

    def at(self, x: Singles, y: Singles) -> Singles:
        """Marks (h, w, 3) at places (h, w) in radii."""
        return _looked_up(self.marks, x, y)

    def seen_at(self, x: Singles, y: Singles) -> Singles:
        """How well those places were seen (h, w)."""
        return _looked_up(self.seen, x, y)


def flat_of(radius: float) -> float:
    """Radii from its centre within which a ball of so many px shows its paint."""
    return float(np.clip(1 - RIM_PX / radius, *FLAT))


def in_sight(cosine: Singles, radius: float) -> Singles:
    """0 to 1 how well a sighting shows paint at a cosine (...) to the line of sight."""
    least = np.float32(np.sqrt(1 - flat_of(radius) ** 2))
    return np.asarray(np.clip((cosine - least) / IN_SIGHT + 0.5, 0, 1), dtype=np.float32)


@lru_cache(maxsize=256)
def _disc(flat: float, side: int) -> tuple[Mask, Singles]:
    axis = np.linspace(-REACH, REACH, side)
    x, y = np.meshgrid(axis, axis)
    rho = np.hypot(x, y)
    inward = np.minimum(flat / np.maximum(rho, 1e-6), 1)
    x, y = x * inward, y * inward
    return rho < flat, np.stack([x, y, np.sqrt(1 - x * x - y * y)], axis=-1).astype(np.float32)


def _looked_up(view: Singles, x: Singles, y: Singles) -> Singles:
    scale, middle = np.float32((len(view) - 1) / (2 * REACH)), np.float32((len(view) - 1) / 2)
    u, v = (np.asarray(a * scale + middle, dtype=np.float32) for a in (x, y))
    looked = cv2.remap(view, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.float32)


def paints_of(first: Sprite, second: Sprite, radius: float) -> tuple[Paint, Paint]:
    """What is painted on a ball of `radius` px in two sightings."""
    flat, side = flat_of(radius), int(np.clip(2 * REACH * PER_PX * radius, *SIDES)) | 1
    disc, normal = _disc(flat, side)
    views = [_view(sprite, normal * np.float32(radius)) for sprite in (first, second)]
    colours = [view[0] for view in views]
    shines = _shines(colours[0], colours[1])
    basis = _basis(normal)
    paints = []
    for (colour, seen), shine in zip(views, shines, strict=True):
        plain = basis @ _usual((colour - shine)[disc], basis[disc])
        odd = colour - shine - plain.astype(np.float32)
        size = cv2.blur(np.abs(odd).max(axis=-1), (3, 3))[..., None]
        marks = odd * np.clip(size / LEAST_MARK - 1, 0, 1)
        paints.append(Paint(np.asarray(marks, dtype=np.float32), seen, radius))
    return paints[0], paints[1]


def without_common(first: Paint, second: Paint) -> tuple[Paint, Paint]:
    """Without the marks that both sightings have in one place: light and shade that the smooth colour does not hold."""
    a, b = first.marks, second.marks
    common = np.where(a * b > 0, np.where(np.abs(a) < np.abs(b), a, b), 0)
    return replace(first, marks=a - common), replace(second, marks=b - common)


def _view(sprite: Sprite, places: Singles) -> tuple[Singles, Singles]:
    """Colours (s, s, 3) and how well they were seen (s, s) at places (s, s, 2 and more) px from the ball's centre."""
    corner = np.array([sprite.x, sprite.y]) + sprite.inset - sprite.centre
    x, y = (np.asarray(places[..., k] - corner[k], dtype=np.float32) for k in (0, 1))
    cover = cv2.remap(sprite.cover, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    seen = cv2.remap(sprite.seen, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cover[..., :3] / np.maximum(cover[..., 3:], 0.3), dtype=np.float32), np.asarray(seen)


def _shines(first: Singles, second: Singles) -> tuple[Singles, Singles]:
    """(s, s, 3) levels of the reflections in two views: small bright spots that both have in one place."""
    size = round(SHINE_RADII * (len(first) - 1) / REACH) | 1
    above = []
    for view in (first, second):
        ground = cv2.medianBlur(np.clip(np.rint(view), 0, 255).astype(np.uint8), size)
        above.append(np.maximum(view - ground, 0))
    spots = (np.minimum(*above).min(axis=-1) > LEAST_SHINE).astype(np.float32)
    spots = cv2.blur(cv2.dilate(spots, np.ones((5, 5))), (3, 3))[..., None]
    return above[0] * spots, above[1] * spots


def _basis(normal: Singles) -> Floats:
    x, y, z = (normal[..., k].astype(np.float64) for k in range(3))
    return np.stack([np.ones_like(x), x, y, z * z, x * y, x * x - y * y], axis=-1)


def _usual(colours: Singles, basis: Floats) -> Floats:
    """(P, 3) how the colour that most of the pixels (n, 3) have changes over the disc (n, P)."""
    least = np.diag([0.0, *[0.02] * (basis.shape[1] - 1)])
    middle = np.median(colours, axis=0)
    found = np.zeros((basis.shape[1], 3))
    found[0] = middle
    for round_ in range(FITS):
        away = np.abs(colours - basis @ found).max(axis=1)
        wide = ODD * 2 ** max(2 - round_, 0)
        weight = 1 / (1 + (away / wide) ** 2) ** 2
        normal = (basis * weight[:, None]).T @ basis + least * weight.sum()
        found = np.linalg.solve(normal, (basis * weight[:, None]).T @ colours)
    return found
