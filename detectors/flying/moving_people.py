"""Boxes of the people who move: large regions of motion."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d

from detectors.flying.frame_windows import MIDDLE_IMAGE, FrameWindow
from detectors.flying.object_size import apparent_size
from models.core.court_camera import CourtScene
from models.core.typing import ByteArray, FloatArray

# Side, working px, of the cells in which motion is noted, and the change that counts as motion, grey levels: above
# coding noise and soft shadows, below the contrast of most clothes.
CELL_PX, MOTION_LEVEL = 8, 16
# Least cells across a moving region: the edge of a board before a turning camera has one. A region that is larger than
# a person is tried again with more, up to the other number.
LEAST_CELLS, MOST_CELLS = 2, 5
# s over which the motion before and after counts: a player who waits moves a limb within it.
MEMORY_S = 0.2
# m: least size across and height of a person's moving part, and the gaps within one person that are closed.
LEAST_WIDTH, LEAST_HEIGHT, GAP = 0.35, 0.7, 0.25
# m, at the middle of the court: a person who runs and reaches, twice as large near the camera.
LARGEST = 4.0


@dataclass(slots=True)
class PeopleFinder:
    """Notes motion frame by frame, and finds the boxes of people in the end."""

    scene: CourtScene
    scale: float
    frames: list[int] = field(default_factory=list)
    motion: list[ByteArray] = field(default_factory=list)

    def add_window(self, window: FrameWindow) -> None:
        """Note where a frame moves: the share of each cell that changes."""
        change = cv2.absdiff(window.images[MIDDLE_IMAGE].luma, window.images[MIDDLE_IMAGE - 1].luma)
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
        # An eighth of a cell: the outline of a limb.
        boxes = self._split_regions((cells > 32).astype(np.uint8), LEAST_CELLS) * (CELL_PX / self.scale)
        feet = np.column_stack([boxes[:, 0] + boxes[:, 2] / 2, boxes[:, 1] + boxes[:, 3]])
        places = camera.to_court(feet, sport.floor, frame)
        behind, beside = sport.surroundings
        is_near = np.all(places[:, :2] > [-behind, -beside], axis=1)
        is_near &= np.all(places[:, :2] < [sport.length + behind, sport.width + beside], axis=1)
        middle = np.array([sport.length / 2, sport.width / 2, sport.floor])
        metre = np.array([apparent_size(camera, place, 1.0) for place in np.where(is_near[:, None], places, middle)])
        is_person = is_near & (boxes[:, 2] > LEAST_WIDTH * metre) & (boxes[:, 3] > LEAST_HEIGHT * metre)
        boxes = boxes[is_person]
        return np.column_stack([np.full(len(boxes), float(frame)), boxes[:, :2], boxes[:, :2] + boxes[:, 2:]])

    def _split_regions(self, is_moving: ByteArray, least: int) -> FloatArray:
        """Find regions of cells, (R, 4) left, top, width and height; those too large for a person lose thin parts."""
        cell = self._metre * self.scale / CELL_PX
        gap = max(3, 2 * round(GAP * cell) + 1)
        lone = cv2.morphologyEx(is_moving, cv2.MORPH_OPEN, np.ones((least, least), np.uint8))
        lone = cv2.morphologyEx(lone, cv2.MORPH_CLOSE, np.ones((gap, gap), np.uint8))
        _, labels, stats, _ = cv2.connectedComponentsWithStats(lone, connectivity=8)
        regions = [np.empty((0, 4))]
        for label, box in enumerate(stats[1:, :4], start=1):
            if box[2:].max() > LARGEST * cell and least < MOST_CELLS:
                regions.append(self._split_regions(is_moving * (labels == label).astype(np.uint8), least + 1))
            else:
                regions.append(box[None].astype(np.float64))
        return np.concatenate(regions)

    @property
    def _metre(self) -> float:
        """Return the px of a metre in the middle of the court."""
        sport = self.scene.sport
        return apparent_size(self.scene.camera, np.array([sport.length / 2, sport.width / 2, sport.floor]), 1.0)
