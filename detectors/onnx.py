"""Balls by a network, on the table that the calibration found; centres refined by the same circle fit as without one.

The network says what is a ball, roughly where, and how sure it is of that; edges in the whole picture say it finer
where they are clear. Both errors are known, so the centre is their weighted mean.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.centres import COARSE_STRIDE, Centres, chained, not_echoes
from detectors.cloth import Cloth, learn_cloth
from detectors.colour import ball_coats
from detectors.found import NO_BALLS, Found, inside, without_overlaps
from detectors.found import chained as found_chained
from detectors.memory import CHANGED_SHARE, REACH_RADII, RENEWED_PICTURES, around, windows
from detectors.onnx_model import BallModel, CentreModel
from detectors.outlines import CLEAR_SUPPORT, LEAST_SUPPORT, WHOLE_SUPPORT, Surroundings, outlined
from detectors.sweep import fitted_sweep
from detectors.view import View, view_of
from models.detections import Detections
from models.scene import Scene, apply_homography

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

LEAST_SCORE = 0.42
"""Probability from which a ball is reported."""
SIZE_BAND = (0.7, 1.4)
"""Seen over predicted radius of what can be a ball of this table."""
DOUBTFUL_SCORE, DOUBTFUL_BAND = 0.3, (0.5, 1.6)
"""The same for what is a ball only if its outline is whole: what the network half sees, or sees in the wrong size."""
STREAK_RADII = 1.0
"""Way during the exposure, ball radii, from which a ball that the network sees move counts as a streak: the outline of
one that moved less is nearly a circle, and places it better than the network does."""
SIZE_PICTURES, SIZE_TURNS, CLEAR_SCORE, LEAST_SIZED = 3, 2, 0.7, 3
"""How the size of the balls is checked: in so many pictures, so many times, by balls of such a score, by so many."""
AGREED = 0.1
"""Relative difference of seen and predicted radius up to which the prediction is taken."""
CONTEXT_PX = 16
"""Working px around a part of the picture that the network is shown with it."""


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What is known from the pictures before."""

    searched: Bytes
    """(h, w, 3) working picture as it was when the network looked at each place last."""
    seen: Centres
    """What it saw there, working px."""
    unclear: Floats
    """(n, 2) working px of the balls that have no clear outline."""
    age: int
    """Pictures since the network looked at all of it."""


@dataclass(frozen=True, slots=True)
class NetworkFinder:
    """Finds the balls of one scene by a network, picture by picture."""

    view: View
    cloth: Cloth
    model: BallModel

    def look(self, rgb: Bytes, frame: int = 0) -> Detections:
        """The balls in a picture (H, W, 3)."""
        return self.follow(rgb, frame, None)[0]

    def follow(self, rgb: Bytes, frame: int, memory: Glimpse | None) -> tuple[Detections, Glimpse]:
        """The same for one picture of a clip after another: the network looks only where something changed.

        Every centre is measured afresh all the same; a ball whose outline is not clear is looked at again.
        """
        working = self.view.picture(rgb, frame)
        touched = self._touched(working, memory)
        seen = self._seen(rgb, working, touched, memory, frame)
        found, own = self._measured(rgb, seen, frame)
        searched = working if memory is None else np.where(touched[..., None], working, memory.searched)
        age = 0 if touched.all() or memory is None else memory.age + 1
        return found, Glimpse(searched, seen, own, age)

    def _touched(self, working: Bytes, memory: Glimpse | None) -> Bools:
        """Where (h, w) the network has to look at a working picture."""
        if memory is None or memory.age >= RENEWED_PICTURES:
            return np.ones(working.shape[:2], dtype=bool)
        red, green, blue = cv2.split(cv2.absdiff(working, memory.searched))
        level = CHANGED_SHARE * self.cloth.threshold
        changed = (cv2.blur(cv2.max(cv2.max(red, green), blue), (3, 3)) > level) & self.view.area
        for x, y in np.rint(memory.unclear).astype(int):
            cv2.circle(changed.view(np.uint8), (int(x), int(y)), 1, 1, -1)
        return around(changed, REACH_RADII * self.view.typical)

    def sizes(self, rgb: Bytes, frame: int) -> Floats:
        """Seen over predicted radius (n,) of the clear sharp balls in a picture (H, W, 3)."""
        seen = self.follow(rgb, frame, None)[1].seen
        clear = (
            self._sure(seen)
            & (seen.score > CLEAR_SCORE)
            & (np.linalg.norm(seen.streak, axis=1) < STREAK_RADII * seen.radius)
        )
        return np.asarray(seen.radius[clear] / _at(self.view.radius, seen.centre[clear]), dtype=np.float64)

    def _seen(self, rgb: Bytes, working: Bytes, touched: Bools, memory: Glimpse | None, frame: int) -> Centres:
        """What the network sees on the table, px of the working picture; elsewhere what it saw before."""
        if not isinstance(self.model, CentreModel):
            return memory.seen if memory is not None and not touched.any() else self._on_table(self._boxed(rgb, frame))
        parts = [self._glance(working, part) for part in windows(touched, self.view)]
        seen = chained([part.take(_at(touched, part.centre)) for part in parts])
        if memory is not None:
            seen = chained([seen, memory.seen.take(~_at(touched, memory.seen.centre))])
        return self._on_table(seen)

    def _glance(self, working: Bytes, part: tuple[slice, slice]) -> Centres:
        """Balls in a part of the working picture, seen with some of what is around it."""
        h, w = working.shape[:2]
        # On the grid of the whole picture's cells, so that a part says what the whole would.
        top, left = (max(s.start - CONTEXT_PX, 0) // COARSE_STRIDE * COARSE_STRIDE for s in part)
        bottom, right = min(part[0].stop + CONTEXT_PX, h), min(part[1].stop + CONTEXT_PX, w)
        window = working[top:bottom, left:right]
        return self.model.see(window, self.view.typical).scaled(1.0, (float(left), float(top)))

    def _boxed(self, rgb: Bytes, frame: int) -> Centres:
        """What a network for whole pictures sees in the table's part of one, px of the working picture."""
        x0, y0, x1, y1 = self.view.box if self.view.scene.camera.motion is None else (0, 0, rgb.shape[1], rgb.shape[0])
        seen = self.model.see(rgb[y0:y1, x0:x1], self.view.typical / self.view.scale)
        return seen.scaled(1.0, (float(x0), float(y0))).placed(lambda px: self._home(px, frame), self.view.scale)

    def _home(self, px: Floats, frame: int) -> Floats:
        """Px (n, 2) of a frame to working px."""
        motion = self.view.scene.camera.motion
        reference = px if motion is None else apply_homography(np.linalg.inv(motion[frame]), px)
        return self.view.to_working(reference)

    def _there(self, home: Floats, frame: int) -> Floats:
        """Working px (n, 2) to px of a frame."""
        motion, reference = self.view.scene.camera.motion, self.view.to_picture(home)
        return reference if motion is None else apply_homography(motion[frame], reference)

    def _on_table(self, seen: Centres) -> Centres:
        """What may be a ball and lies on the table; what is sure first, best first, without echoes."""
        seen = seen.take(self._likely(seen, DOUBTFUL_SCORE, DOUBTFUL_BAND) & _at(self.view.centres, seen.centre))
        seen = seen.take(np.lexsort((-seen.score, ~self._sure(seen))))
        return seen.take(not_echoes(seen))

    def _sure(self, seen: Centres) -> Bools:
        """What is a ball by the network's word alone."""
        return self._likely(seen, LEAST_SCORE, SIZE_BAND)

    def _likely(self, seen: Centres, score: float, band: tuple[float, float]) -> Bools:
        ratio = seen.radius / _at(self.view.radius, seen.centre)
        return np.asarray((seen.score > score) & (ratio > band[0]) & (ratio < band[1]))

    def _measured(self, rgb: Bytes, seen: Centres, frame: int) -> tuple[Detections, Floats]:
        """Balls, and where (n, 2), working px, the network's word alone counts."""
        streaked = np.linalg.norm(seen.streak, axis=1) > STREAK_RADII * seen.radius
        moving, resting = seen.take(streaked & self._sure(seen)), seen.take(~streaked)
        sharp, support = self._outlined(rgb, resting, frame)
        believed = self._sure(resting) | (support > WHOLE_SUPPORT)
        resting, sharp, support = resting.take(believed), sharp.take(believed), support[believed]
        by_light, moves = self._swept_by_light(rgb, resting, sharp, support)
        at_rest = sharp.take((support > CLEAR_SUPPORT) & ~moves)
        swept = found_chained(self._swept_as_seen(rgb, moving, at_rest, frame), by_light)
        kept = ~moves & ((support > CLEAR_SUPPORT) | ~inside(sharp.centre, swept).any(axis=0))
        found = without_overlaps(found_chained(swept, sharp.take(kept)), self.view.scene, frame)
        coats = ball_coats(rgb, found.centre, found.radius)
        frames = np.full(len(found.score), frame, dtype=np.int64)
        unclear = np.concatenate([moving.centre, resting.centre[support <= LEAST_SUPPORT]])
        return Detections(
            frames, found.centre, found.radius, found.streak, coats.colour, coats.white, coats.white_rim, coats.value,
            found.score, found.sigma, found.sigma_along,
        ), unclear  # fmt: skip

    def _swept_by_light(self, rgb: Bytes, home: Centres, sharp: Found, support: Floats) -> tuple[Found, Bools]:
        """Streaks among balls without a whole outline, by what an exposure adds up to; which (n,) of them are some."""
        radius = _at(self.view.radius, home.centre).astype(np.float64) / self.view.scale
        moves, found = np.zeros(len(support), dtype=bool), NO_BALLS
        for row in np.flatnonzero(support < CLEAR_SUPPORT):
            clear = support > CLEAR_SUPPORT
            clear[row] = False
            others, size = sharp.take(clear), float(radius[row])
            sweep = fitted_sweep(rgb, sharp.centre[row], size, others.centre, others.radius, self.cloth.basis)
            if sweep is not None and sweep.believed(size):
                moves[row] = True
                place, way = sweep.centre[None], sweep.way[None]
                errors = np.array([sweep.across]), np.array([sweep.along])
                found = found_chained(found, Found(place, radius[[row]], way, sharp.score[[row]], *errors))
        return found, moves

    def _swept_as_seen(self, rgb: Bytes, home: Centres, at_rest: Found, frame: int) -> Found:
        """Streaks that the network sees: what an exposure that goes its way adds up to, else its word."""
        radius = _at(self.view.radius, home.centre).astype(np.float64) / self.view.scale
        told = _swept(self._placed(home, frame))
        others = at_rest.take(~np.asarray(inside(at_rest.centre, told).any(axis=0)))
        for row, size in enumerate(radius.tolist()):
            centre, way = told.centre[row], told.streak[row]
            sweep = fitted_sweep(rgb, centre, size, others.centre, others.radius, self.cloth.basis, way)
            if sweep is not None and sweep.believed(size):
                told.centre[row], told.streak[row] = sweep.centre, sweep.way
                told.sigma[row], told.sigma_along[row] = sweep.across, sweep.along
        return told

    def _outlined(self, rgb: Bytes, seen: Centres, frame: int) -> tuple[Found, Floats]:
        """Balls at rest where their outlines are, and the support of these."""
        expected = _at(self.view.radius, seen.centre).astype(np.float64) / self.view.scale
        beneath = np.asarray(_at(self.cloth.colour, seen.centre), dtype=np.float64)
        around = Surroundings(expected, beneath, self.cloth.basis, self.view.scene)
        found, support = outlined(rgb, self._placed(seen, frame), around, frame)
        # What only its outline makes a ball is as likely one as the least that is reported.
        return replace(found, score=np.maximum(found.score, LEAST_SCORE)), support

    def _placed(self, seen: Centres, frame: int) -> Centres:
        """What was seen in the working picture, in px of the frame."""
        return seen.placed(lambda px: self._there(px, frame), 1 / self.view.scale)


def _swept(seen: Centres) -> Found:
    """Streaks, as the network sees them."""
    columns = seen.centre, seen.radius, seen.streak, seen.score, seen.across, np.maximum(seen.along, seen.across)
    return Found(*(column.copy() for column in columns))


def network_finder(scene: Scene, pictures: Iterable[tuple[int, Bytes]], model: BallModel) -> NetworkFinder:
    """A finder for a scene that learns the cloth and the size of the balls from (frame, picture (H, W, 3))."""
    held = list(pictures)
    scene = _with_seen_size(scene, held[:: max(1, len(held) // SIZE_PICTURES)], model)
    view = view_of(scene)
    pictures = iter(held)
    return NetworkFinder(view, learn_cloth([view.picture(rgb, frame) for frame, rgb in pictures], view), model)


def _with_seen_size(scene: Scene, pictures: list[tuple[int, Bytes]], model: BallModel) -> Scene:
    """The scene with the ball radius that the network sees; unchanged where no two balls are clear."""
    for _ in range(SIZE_TURNS):
        view = view_of(scene)
        finder = NetworkFinder(view, learn_cloth([view.picture(rgb, frame) for frame, rgb in pictures], view), model)
        ratios = np.concatenate([finder.sizes(rgb, frame) for frame, rgb in pictures])
        factor = float(np.median(ratios)) if len(ratios) >= LEAST_SIZED else 1.0
        if abs(factor - 1) <= AGREED:
            return scene
        scene = replace(scene, table=replace(scene.table, ball_radius=scene.table.ball_radius * factor))
    return scene


def _at(mask: NDArray[Any], working: Floats) -> NDArray[Any]:
    """Values (n,) of a picture at working px (n, 2)."""
    h, w = mask.shape[:2]
    u = np.clip(np.rint(working[..., 0]).astype(int), 0, w - 1)
    v = np.clip(np.rint(working[..., 1]).astype(int), 0, h - 1)
    return np.asarray(mask[v, u])
