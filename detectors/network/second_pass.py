"""A second look, closer, where balls crowd.

On the map of a small picture two balls that cover each other are one peak, and a ball beside another may be none at
all. So the parts where peaks stand close together, or where what is no cloth goes on beside one, are shown to the
network again, larger and by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.cloth_background import Cloth, disc_kernel
from detectors.measurement.frame_change import around, windows
from detectors.measurement.working_view import View, pixel_at, value_at
from detectors.network.network_file import BallModel
from detectors.network.peak_decoding import Centres, chained
from models.core.typing import BoolArray, ByteArray

CROWDED_RADII = 2.4
"""Two balls whose centres are seen nearer than this crowd each other: they touch, or one covers the other."""
LEAST_SCORE = 0.2
"""Probability from which something counts as a ball that crowds."""
CLOSE_RADIUS_PX, MOST_CLOSER = 10.5, 2.0
"""Radius of a ball in the closer picture, within what the network is made for, and how much closer at the most."""
LEAST_CLOSER = 0.9
"""Balls that would be seen smaller than this times as large are not looked at again; those that are as large as before
are: the network sees them at other places of its grid, and without what else the picture shows."""
REACH_RADII = 1.3
"""How far about such balls the closer look replaces the first."""
BESIDE_RADII, COVERED_RADII = 2.0, 1.2
"""How far about a ball another is suspected, and how far it explains itself what is no cloth."""
LEAST_UNLIKE = 0.35
"""Difference from the cloth, over that of the balls that were seen, of what may be another: most shade differs less."""
LEAST_HALF_RADII, LEAST_AREA = 0.3, 0.2
"""Half width, ball radii, and area, in balls, that it must have."""
CONTEXT_PX = 16
"""Px of the closer picture around such a part and its surroundings that the network is shown with it."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A picture in which balls are looked for."""

    rgb: ByteArray
    """(H, W, 3) all of it."""
    working: ByteArray
    """(h, w, 3) as the network was shown it first."""
    touched: BoolArray
    """(h, w) where it looked."""
    frame: int


def looked_closer(shown: Shown, view: View, cloth: Cloth, model: BallModel, seen: Centres) -> Centres:
    """What the network saw, px of the working picture, and in the place of what crowds there what it sees closer."""
    seen_well = seen.take((seen.score > LEAST_SCORE) & value_at(view.centres, seen.centre))
    again = _discs(seen_well.take(_crowded(seen_well)), REACH_RADII, view)
    odd = _unexplained(shown, view, cloth, seen_well)
    if odd.any():
        again |= around(odd, view.typical)
    if not again.any():
        return seen
    parts, looked = [], np.zeros_like(again)
    for part in windows(again, view):
        factor = min(CLOSE_RADIUS_PX / float(view.radius[part][again[part]].max()), MOST_CLOSER)
        if factor >= LEAST_CLOSER:
            parts.append(_closer(shown, view, model, part, factor))
            looked[part] |= again[part]
    closer = chained(parts)
    return chained([seen.take(~value_at(looked, seen.centre)), closer.take(value_at(looked, closer.centre))])


def _crowded(seen: Centres) -> BoolArray:
    """Which balls (K,) have another so near that the two may be more, or lie elsewhere."""
    apart = np.linalg.norm(seen.centre[:, None] - seen.centre[None], axis=-1)
    near = apart < CROWDED_RADII * seen.radius
    np.fill_diagonal(near, False)
    return np.asarray(near.any(axis=1))


def _unexplained(shown: Shown, view: View, cloth: Cloth, seen: Centres) -> BoolArray:
    """Where (h, w) beside balls something is as unlike the cloth as they are, and as large as a part of one more."""
    beside = view.centres & shown.touched & _discs(seen, BESIDE_RADII, view) & ~_discs(seen, COVERED_RADII, view)
    row, column = np.nonzero(beside)
    found = np.zeros(beside.shape, dtype=bool)
    if not len(row):
        return found
    balls = cloth.unlike(shown.working, *pixel_at(beside.shape, seen.centre))
    unlike = cloth.unlike(shown.working, row, column) > max(cloth.threshold, LEAST_UNLIKE * float(np.median(balls)))
    if np.count_nonzero(unlike) < LEAST_AREA * np.pi * view.typical**2:
        return found
    found[row[unlike], column[unlike]] = True
    # Only the part of the picture in which there is any: it is small.
    x, y, w, h = cv2.boundingRect(found.view(np.uint8))
    part = slice(y, y + h), slice(x, x + w)
    kernel = disc_kernel(LEAST_HALF_RADII * view.typical)
    thick = cv2.morphologyEx(found[part].view(np.uint8), cv2.MORPH_OPEN, kernel)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(thick)
    large = stats[:, cv2.CC_STAT_AREA] > LEAST_AREA * np.pi * view.typical**2
    large[0] = False
    found[part] = large[labels]
    return found


def _closer(shown: Shown, view: View, model: BallModel, part: tuple[slice, slice], factor: float) -> Centres:
    """Balls in a part of the working picture, seen about `factor` times as large."""
    context = int(np.ceil(CONTEXT_PX / factor))
    h, w = view.radius.shape
    top, left = max(part[0].start - context, 0), max(part[1].start - context, 0)
    bottom, right = min(part[0].stop + context, h), min(part[1].stop + context, w)
    picture = view.enlarged(shown.rgb, shown.frame, (slice(top, bottom), slice(left, right)), factor)
    grown = np.array(picture.shape[1::-1]) / (right - left, bottom - top)
    seen = model.see(picture, view.typical * factor)
    return seen.placed(lambda px: (px + 0.5) / grown - 0.5 + (left, top), 1 / factor)


def _discs(seen: Centres, radii: float, view: View) -> BoolArray:
    """Places (h, w) within so many radii of balls."""
    drawn = np.zeros(view.radius.shape, np.uint8)
    for (x, y), radius in zip(np.rint(seen.centre).astype(int).tolist(), seen.radius.tolist(), strict=True):
        cv2.circle(drawn, (x, y), int(np.ceil(radii * radius)), 1, -1)
    return drawn.view(np.bool_)
