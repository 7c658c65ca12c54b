"""Films of staged rallies: a textured hall with painted lines, a white disc that flies, and a person who walks."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from support.staged_rally import FPS, stage_rally

from models.core.rally import Rally
from models.core.typing import FloatArray, ImageArray
from models.sports.sport_catalogue import find_sports
from video.drawing.court_plan import outline_line
from video.io.clip import Clip, open_clip
from video.io.video_writer import VideoWriter

DISC_PX = 6.0
WHITE = (245, 245, 240)
SCORE_BOX = (40, 40, 240, 92)


def paint_hall(rally: Rally) -> ImageArray:
    """Paint the hall without disc and person (H, W, 3), as the reference image shows it."""
    camera = rally.scene.camera
    coarse = np.random.default_rng(3).uniform(60, 130, (camera.height_px // 8, camera.width_px // 8, 3))
    hall = cv2.resize(coarse, (camera.width_px, camera.height_px), interpolation=cv2.INTER_CUBIC).astype(np.uint8)
    for line in rally.scene.sport.lines:
        corners = np.column_stack([outline_line(line.start, line.end, line.width), np.zeros(4)])
        cv2.fillPoly(hall, [np.rint(16 * camera.to_pixels(corners)).astype(np.int32)], WHITE, cv2.LINE_AA, 4)
    return hall


def person_box(row: int) -> tuple[int, int, int, int]:
    """Return the box of the person in a frame: left, top, right, bottom."""
    return 200 + 3 * row, 400, 240 + 3 * row, 500


def draw_frame(rally: Rally, hall: ImageArray, row: int, disc: FloatArray) -> ImageArray:
    """Draw a frame with the disc at (2,) px, which may be NaN."""
    camera = rally.scene.camera
    image = hall.copy()
    if camera.motion is not None:
        image = cv2.warpPerspective(hall, camera.motion[row], hall.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    left, top, right, bottom = person_box(row)
    cv2.rectangle(image, (left, top), (right, bottom), (160, 60, 50), -1)
    if camera.motion is not None:  # the score is part of the image, not of the hall
        cv2.rectangle(image, SCORE_BOX[:2], SCORE_BOX[2:], (10, 10, 14), -1)
        cv2.putText(image, "LIN 2 : 3", (50, 78), cv2.FONT_HERSHEY_SIMPLEX, 1.1, WHITE, 2, cv2.LINE_AA)
    if np.isfinite(disc).all():
        cv2.circle(image, np.rint(16 * disc).astype(int).tolist(), round(16 * DISC_PX), WHITE, -1, cv2.LINE_AA, 4)
    return np.asarray(image)


def film_rally(path: Path, motion: FloatArray | None = None, sport: str = "badminton") -> tuple[Clip, Rally]:
    """Film a rally of one stroke over the net that lands 10 cm inside a side line; return the clip and the rally."""
    court = find_sports()[sport]
    target = (0.75 * court.length, court.areas["singles"][1][1] + 0.10)
    rally = stage_rally(court, target, climb=5.0 if court.floor == 0 else 2.0)
    if motion is not None:
        camera = replace(rally.scene.camera, motion=motion[: len(rally.t)])
        rally = replace(rally, scene=replace(rally.scene, camera=camera))
        middle = rally.px.copy()
        for row, matrix in enumerate(camera.motion):
            moved = matrix @ [*middle[row], 1.0]
            rally.px[row] = moved[:2] / moved[2]
    hall = paint_hall(rally)
    with VideoWriter(path, hall.shape[1], hall.shape[0], Fraction(int(FPS)), crf=8) as writer:
        for row, disc in enumerate(rally.px):
            writer.write(draw_frame(rally, hall, row, disc))
    return open_clip(path), rally
