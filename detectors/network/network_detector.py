"""Balls by a network, on the table that the calibration found.

The network looks where something changed, and again where balls crowd; what it saw is judged by the whole picture.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from detectors.measurement.cloth_background import Cloth, learn_cloth
from detectors.measurement.frame_change import CHANGED_SHARE, REACH_RADII, RENEWED_PICTURES, around, windows
from detectors.measurement.working_view import View, value_at, view_of
from detectors.network.disc_regressor import open_disc_model
from detectors.network.network_file import BallModel, CentreModel
from detectors.network.peak_decoding import COARSE_STRIDE, Centres, chained, not_echoes
from detectors.network.postprocessing import CLEAR_SCORE, Judge, streaked
from detectors.network.second_pass import Shown, looked_closer
from detectors.network.streak_regressor import open_streak_model
from models.core.detections import Detections
from models.core.scene import Scene, apply_homography
from models.core.typing import BoolArray, ByteArray, FloatArray

SIZE_PICTURES, SIZE_TURNS, LEAST_SIZED = 3, 2, 3
"""How the size of the balls is checked: in so many pictures, so many times, by so many balls that are sure."""
AGREED = 0.1
"""Relative difference of seen and predicted radius up to which the prediction is taken."""
CONTEXT_PX = 16
"""Working px around a part of the picture that the network is shown with it."""


@dataclass(frozen=True, slots=True)
class Glimpse:
    """What is known from the pictures before."""

    searched: ByteArray
    """(h, w, 3) working picture as it was when the network looked at each place last."""
    seen: Centres
    """What it saw there, working px, less what the picture refuted."""
    unclear: FloatArray
    """(n, 2) working px of the balls that have no clear outline."""
    age: int
    """Pictures since the network looked at all of it."""


@dataclass(frozen=True, slots=True)
class NetworkFinder:
    """Finds the balls of one scene by a network, picture by picture."""

    view: View
    cloth: Cloth
    model: BallModel

    @property
    def judge(self) -> Judge:
        """Of what the network sees."""
        return Judge(self.view, self.cloth, open_streak_model(), open_disc_model())

    def look(self, rgb: ByteArray, frame: int = 0) -> Detections:
        """The balls in a picture (H, W, 3)."""
        return self.follow(rgb, frame, None)[0]

    def follow(self, rgb: ByteArray, frame: int, memory: Glimpse | None) -> tuple[Detections, Glimpse]:
        """The same for one picture of a clip after another: the network looks only where something changed.

        Every centre is measured afresh all the same; a ball whose outline is not clear is looked at again.
        """
        working = self.view.picture(rgb, frame)
        touched = self._touched(working, memory)
        seen = self._seen(rgb, working, touched, memory, frame)
        judged = self.judge.measured(rgb, seen, frame)
        searched = working if memory is None else cv2.copyTo(working, touched.view(np.uint8), memory.searched.copy())
        age = 0 if touched.all() or memory is None else memory.age + 1
        return judged.balls, Glimpse(searched, seen.take(~judged.refuted), judged.unclear, age)

    def _touched(self, working: ByteArray, memory: Glimpse | None) -> BoolArray:
        """Where (h, w) the network has to look at a working picture."""
        if memory is None or memory.age >= RENEWED_PICTURES:
            return np.ones(working.shape[:2], dtype=bool)
        red, green, blue = cv2.split(cv2.absdiff(working, memory.searched))
        level = CHANGED_SHARE * self.cloth.threshold
        changed = (cv2.blur(cv2.max(cv2.max(red, green), blue), (3, 3)) > level) & self.view.area
        for x, y in np.rint(memory.unclear).astype(int):
            cv2.circle(changed.view(np.uint8), (int(x), int(y)), 1, 1, -1)
        return around(changed, REACH_RADII * self.view.typical)

    def sizes(self, rgb: ByteArray, frame: int) -> FloatArray:
        """Seen over predicted radius (n,) of the clear sharp balls in a picture (H, W, 3)."""
        working = self.view.picture(rgb, frame)
        seen = self._seen(rgb, working, self._touched(working, None), None, frame)
        clear = self.judge.sure(seen) & (seen.score > CLEAR_SCORE) & ~streaked(seen)
        return np.asarray(seen.radius[clear] / value_at(self.view.radius, seen.centre[clear]), dtype=np.float64)

    def _seen(
        self, rgb: ByteArray, working: ByteArray, touched: BoolArray, memory: Glimpse | None, frame: int
    ) -> Centres:
        """What the network sees on the table, px of the working picture; elsewhere what it saw before."""
        if not isinstance(self.model, CentreModel):
            return memory.seen if memory is not None and not touched.any() else self._on_table(self._boxed(rgb, frame))
        parts = [self._glance(working, part) for part in windows(touched, self.view)]
        seen = chained([part.take(value_at(touched, part.centre)) for part in parts])
        seen = looked_closer(Shown(rgb, working, touched, frame), self.view, self.cloth, self.model, seen)
        if memory is not None:
            seen = chained([seen, memory.seen.take(~value_at(touched, memory.seen.centre))])
        return self._on_table(seen)

    def _glance(self, working: ByteArray, part: tuple[slice, slice]) -> Centres:
        """Balls in a part of the working picture, seen with some of what is around it."""
        h, w = working.shape[:2]
        # On the grid of the whole picture's cells, so that a part says what the whole would.
        top, left = (max(s.start - CONTEXT_PX, 0) // COARSE_STRIDE * COARSE_STRIDE for s in part)
        bottom, right = min(part[0].stop + CONTEXT_PX, h), min(part[1].stop + CONTEXT_PX, w)
        window = working[top:bottom, left:right]
        return self.model.see(window, self.view.typical).scaled(1.0, (float(left), float(top)))

    def _boxed(self, rgb: ByteArray, frame: int) -> Centres:
        """What a network for whole pictures sees in the table's part of one, px of the working picture."""
        x0, y0, x1, y1 = self.view.box if self.view.scene.camera.motion is None else (0, 0, rgb.shape[1], rgb.shape[0])
        seen = self.model.see(rgb[y0:y1, x0:x1], self.view.typical / self.view.scale)
        return seen.scaled(1.0, (float(x0), float(y0))).placed(lambda px: self._home(px, frame), self.view.scale)

    def _home(self, px: FloatArray, frame: int) -> FloatArray:
        """Px (n, 2) of a frame to working px."""
        motion = self.view.scene.camera.motion
        reference = px if motion is None else apply_homography(np.linalg.inv(motion[frame]), px)
        return self.view.to_working(reference)

    def _on_table(self, seen: Centres) -> Centres:
        """What may be a ball and lies on the table; what is sure first, best first, without echoes."""
        seen = seen.take(self.judge.likely(seen) & value_at(self.view.centres, seen.centre))
        seen = seen.take(np.lexsort((-seen.score, ~self.judge.sure(seen))))
        return seen.take(not_echoes(seen))


def network_finder(scene: Scene, pictures: Iterable[tuple[int, ByteArray]], model: BallModel) -> NetworkFinder:
    """A finder for a scene that learns the cloth and the size of the balls from (frame, picture (H, W, 3))."""
    held = list(pictures)
    scene = _with_seen_size(scene, held[:: max(1, len(held) // SIZE_PICTURES)], model)
    view = view_of(scene)
    pictures = iter(held)
    return NetworkFinder(view, learn_cloth([view.picture(rgb, frame) for frame, rgb in pictures], view), model)


def _with_seen_size(scene: Scene, pictures: list[tuple[int, ByteArray]], model: BallModel) -> Scene:
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
