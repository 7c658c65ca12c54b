"""Boxes of the people who move: large regions of motion."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d

from detectors.flying.frame_windows import FrameWindow
from detectors.flying.object_size import apparent_size
from models.core.court_camera import CourtScene
from models.core.typing import ByteArray, FloatArray

# Side, working px, of the cells in which motion is noted, and the change that counts as motion, grey levels: above
# coding noise and soft shadows, below the contrast of most clothes.
CELL_PX, MOTION_LEVEL = 8, 16
# Least cells across a moving region: the edge of a board before a turning camera has one or two.
LEAST_CELLS = 3
# s over which the motion before and after counts: a player who waits moves a limb within it.
MEMORY_S = 0.12
# m: least size across and height of a person's moving part, and the gaps within one person that are closed.
LEAST_WIDTH, LEAST_HEIGHT, GAP = 0.35, 0.7, 0.25


@dataclass(slots=True)
class PeopleFinder:
    """Notes motion frame by frame, and finds the boxes of people in the end."""

    scene: CourtScene
    scale: float
    frames: list[int] = field(default_factory=list)
    motion: list[ByteArray] = field(default_factory=list)

    def add_window(self, window: FrameWindow) -> None:
        """Note where a frame moves: the share of each cell that changes."""
        change = cv2.absdiff(window.images[2], window.images[1])
        _, is_moving = cv2.threshold(change, MOTION_LEVEL, 255, cv2.THRESH_BINARY)
        size = (change.shape[1] // CELL_PX, change.shape[0] // CELL_PX)
        self.frames.append(window.frame)
        self.motion.append(np.asarray(cv2.resize(is_moving, size, interpolation=cv2.INTER_AREA), np.uint8))

    def find_people(self, interval: float) -> FloatArray:
        """Find the people in all frames.

        Args:
            interval: s between frames.

        Returns:
            (P, 5) frame, and left, top, right and bottom, px.
        """
        if not self.motion:
            return np.empty((0, 5))
        reach = 2 * round(MEMORY_S / interval) + 1
        lasting = maximum_filter1d(np.stack(self.motion), reach, axis=0)
        boxes = [self._find_boxes(cells, frame) for cells, frame in zip(lasting, self.frames, strict=True)]
        return np.concatenate([np.empty((0, 5)), *boxes])

    def _find_boxes(self, cells: ByteArray, frame: int) -> FloatArray:
        sport, camera = self.scene.sport, self.scene.camera
        middle = np.array([sport.length / 2, sport.width / 2, sport.floor])
        gap = max(3, round(apparent_size(camera, middle, GAP) * self.scale / CELL_PX) * 2 + 1)
        # An eighth of a cell: the outline of a limb.
        is_moving = (cells > 32).astype(np.uint8)
        is_moving = cv2.morphologyEx(is_moving, cv2.MORPH_OPEN, np.ones((LEAST_CELLS, LEAST_CELLS), np.uint8))
        is_moving = cv2.morphologyEx(is_moving, cv2.MORPH_CLOSE, np.ones((gap, gap), np.uint8))
        _, _, stats, _ = cv2.connectedComponentsWithStats(is_moving, connectivity=8)
        boxes = stats[1:, :4] * (CELL_PX / self.scale)
        feet = np.column_stack([boxes[:, 0] + boxes[:, 2] / 2, boxes[:, 1] + boxes[:, 3]])
        places = camera.to_court(feet, sport.floor, frame)
        behind, beside = sport.surroundings
        is_near = np.all(places[:, :2] > [-behind, -beside], axis=1)
        is_near &= np.all(places[:, :2] < [sport.length + behind, sport.width + beside], axis=1)
        metre = np.array([apparent_size(camera, place, 1.0) for place in np.where(is_near[:, None], places, middle)])
        is_person = is_near & (boxes[:, 2] > LEAST_WIDTH * metre) & (boxes[:, 3] > LEAST_HEIGHT * metre)
        boxes = boxes[is_person]
        return np.column_stack([np.full(len(boxes), float(frame)), boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])
