"""Rendered tables with known ball centres: shaded discs, shadows, motion blur, noise, on unevenly lit cloth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.detections import Detections
from models.core.scene import Camera, Scene, Table
from models.core.typing import ByteArray, FloatArray

WIDTH, HEIGHT = 640, 360
PX_PER_M = 220.0
CORNER = (40.0, 40.0)
RADIUS = 0.0365
"""m: 8 px in the image."""
CLOTH = (40.0, 120.0, 170.0)


@dataclass(frozen=True)
class Ball:
    """A ball at mid-exposure, px; `streak` px travelled during the exposure."""

    x: float
    y: float
    colour: tuple[float, float, float] = (230.0, 230.0, 220.0)
    streak: tuple[float, float] = (0.0, 0.0)


def build_test_scene() -> Scene:
    """A 2.54 m x 1.27 m table seen from straight above, far away, 220 px/m."""
    table = Table("drawn", "pool", 2.54, 1.27, RADIUS, 0.17, pockets=False)
    x0, y0 = CORNER
    # A camera far above: z barely matters, yet the eye stands somewhere.
    eye = 1000.0
    middle = (1.27, 0.635)
    matrix = np.array(
        [
            [PX_PER_M, 0.0, -(x0 + PX_PER_M * middle[0]) / eye, x0],
            [0.0, PX_PER_M, -(y0 + PX_PER_M * middle[1]) / eye, y0],
            [0.0, 0.0, -1.0 / eye, 1.0],
        ]
    )
    corners = np.array(CORNER) + PX_PER_M * table.corners
    lab = cv2.cvtColor(np.array([[CLOTH]], dtype=np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)[0, 0].astype(
        np.float64
    )
    return Scene(table, Camera(matrix, WIDTH, HEIGHT, corners, np.eye(8), "cloth", eye, 1.0), lab, ())


def render_balls(balls: list[Ball], rng: np.random.Generator, noise: float = 2.0) -> ByteArray:
    """Render an image (H, W, 3) of balls on the table."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    light = 1.0 + 0.15 * np.cos((x - 250) / 260) * np.cos((y - 150) / 200)
    image = np.full((HEIGHT, WIDTH, 3), (70.0, 45.0, 30.0))
    on_cloth = (np.abs(x - 319.4) < 279.4 + 8) & (np.abs(y - 179.7) < 139.7 + 8)
    image[on_cloth] = (np.array(CLOTH) * light[..., None])[on_cloth]
    for ball in balls:
        _add_ball(image, ball, x, y)
    return np.clip(cv2.GaussianBlur(image, (0, 0), 0.6) + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def _add_ball(image: FloatArray, ball: Ball, x: FloatArray, y: FloatArray) -> None:
    radius = RADIUS * PX_PER_M
    steps = np.linspace(-0.5, 0.5, 1 if ball.streak == (0.0, 0.0) else 41)
    shares, colours = np.zeros(x.shape), np.zeros((*x.shape, 3))
    shade = np.zeros(x.shape)
    for step in steps:
        dx, dy = x - ball.x - step * ball.streak[0], y - ball.y - step * ball.streak[1]
        share = np.clip(radius + 0.5 - np.hypot(dx, dy), 0, 1)
        bright = 0.75 + 0.25 * np.sqrt(np.clip(1 - (dx**2 + dy**2) / radius**2, 0, 1))
        shares += share / len(steps)
        mirrored = 90 * np.exp(-((dx + 2) ** 2 + (dy + 3) ** 2) / 2)  # a lamp
        colours += (share / len(steps))[..., None] * (bright[..., None] * np.array(ball.colour) + mirrored[..., None])
        shade += 0.3 * np.exp(-((dx - 3) ** 2 + (dy - 4) ** 2) / (2 * (0.8 * radius) ** 2)) / len(steps)
    image *= (1 - shade * (1 - shares))[..., None]
    image *= (1 - shares)[..., None]
    image += colours


def spread_balls(
    rng: np.random.Generator, colours: Sequence[tuple[float, float, float]], number: int = 12
) -> list[Ball]:
    """Balls on a jittered grid, none nearer than three radii to another."""
    places = [(100 + 85 * (k % 6), 90 + 120 * (k // 6)) for k in range(number)]
    return [
        Ball(x + rng.uniform(-20, 20), y + rng.uniform(-20, 20), colours[k % len(colours)])
        for k, (x, y) in enumerate(places)
    ]


def nearest_errors(detections: Detections, balls: list[Ball]) -> np.ndarray:
    """Offset (n, 2) px of the nearest detection from every ball."""
    truth = np.array([[ball.x, ball.y] for ball in balls])
    nearest = np.argmin(np.linalg.norm(detections.centre[None] - truth[:, None], axis=-1), axis=1)
    offset: np.ndarray = detections.centre[nearest] - truth
    return offset
