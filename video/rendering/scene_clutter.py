"""What else is in a picture of a table: marks, logos, chalk, light spots beneath the balls; players above them.

All of it is painted onto linear light (H, W, 3), in place. Shapes are drawn in px with the table's tilt where they lie
on it. None of it is a ball, and some of it nearly looks like one.
"""

from __future__ import annotations

import string
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Camera
from models.core.typing import Float32Array, FloatArray
from video.rendering.ball_shading import Light, linear, singles
from video.rendering.pinhole_camera import lens_of
from video.rendering.player_props import Rod, cue_rods, draw_rods, hand_rods
from video.rendering.random_hall import Hall, random_colour
from video.rendering.scene_appearance import Colour

SHIFT = 4
"""Bits of a pixel's fraction in cv2's drawing."""


def paint_backdrop(rng: np.random.Generator, picture: Float32Array, hall: Hall, off_table: Float32Array) -> None:
    """Marks on the cloth and a crowd beside the table; `off_table` (H, W) m outside the noses."""
    crowd = off_table > 0.18
    if crowd.mean() > 0.02 and rng.random() < 0.7:
        busy = picture.copy()
        for _ in range(int(rng.integers(3, 25))):
            _blob(rng, busy, _anywhere(rng, busy), rng.uniform(3, 40))
        picture[crowd] = busy[crowd]
    for painter, share, most in _CLOTH_MARKS:
        for _ in range(int(rng.integers(1, most + 1)) if rng.random() < share else 0):
            painter(rng, picture, hall)


def paint_players(rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light) -> None:
    """Cues, hands, arms, bodies and racks over the balls."""
    for painter, share in ((_cue, 0.22), (_arm, 0.15), (_body, 0.10), (_frame, 0.06)):
        if rng.random() < share:
            painter(rng, picture, hall, light)


def paint_caption(rng: np.random.Generator, picture: NDArray[np.uint8]) -> None:
    """A scoreboard or a channel's name over the finished picture (H, W, 3)."""
    height, width = picture.shape[:2]
    h, w = int(height * rng.uniform(0.06, 0.2)), int(width * rng.uniform(0.2, 0.9))
    x, y = int(rng.integers(0, width - w + 1)), int(rng.choice([0, height - h]))
    colour = [int(c) for c in rng.integers(0, 256, 3)]
    alpha = rng.uniform(0.5, 1.0)
    picture[y : y + h, x : x + w] = picture[y : y + h, x : x + w] * (1 - alpha) + alpha * np.array(colour)
    _write(picture, _word(rng, 12), (x + 2, y + h - 3), h / 30, [int(c) for c in rng.integers(0, 256, 3)])


def _anywhere(rng: np.random.Generator, picture: Float32Array) -> FloatArray:
    return rng.uniform(0, 1, 2) * picture.shape[1::-1]


def _on_cloth(rng: np.random.Generator, hall: Hall, picture: Float32Array) -> tuple[FloatArray, FloatArray, float]:
    """A px (2,) of the picture, d(px)/d(ball radius) (2, 2) of the cloth there, a ball's radius in px."""
    px = _anywhere(rng, picture)
    camera, r = hall.camera, hall.table.ball_radius
    xy = camera.to_table(px, 0.0)
    tilt = np.linalg.inv(camera.metres_per_pixel(xy, 0.0)) * r
    return px, np.asarray(tilt, dtype=np.float64), float(camera.radius_px(xy, r))


def _shine(rng: np.random.Generator, picture: Float32Array) -> FloatArray:
    """A colour as bright as the picture is."""
    level = float(np.median(picture[::8, ::8])) + 0.1
    bright = level * rng.uniform(0.4, 4.0)
    return np.asarray(linear(random_colour(rng, (0.0, 1.0), (0.1, 1.0))) * bright, dtype=np.float64)


def _polygon(picture: Float32Array, points: FloatArray, colour: FloatArray, alpha: float, soft: float = 0.0) -> None:
    """Fill points (n, 2) px, with soft borders of `soft` px."""
    mask = np.zeros(picture.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(points * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    _through(picture, mask, colour, alpha, soft)


def _through(
    picture: Float32Array, mask: NDArray[np.uint8], colour: FloatArray, alpha: float, soft: float = 0.0
) -> None:
    share = mask.astype(np.float32) / 255
    if soft > 0.3:
        share = cv2.GaussianBlur(share, (0, 0), soft)
    picture += (singles(colour) - picture) * singles(alpha * share)[..., None]


def _ring(tilt: FloatArray, centre: FloatArray, radius: float, count: int = 40) -> FloatArray:
    """Points (n, 2) px of a circle on the cloth, `radius` in ball radii."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.asarray(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]) @ tilt.T)


def _spot(rng: np.random.Generator, picture: Float32Array, hall: Hall) -> None:
    """A sticker, a coin, a spot, a worn place: flat and round."""
    px, tilt, radius = _on_cloth(rng, hall, picture)
    size = float(np.exp(rng.uniform(np.log(0.1), np.log(3.0))))
    soft = float(rng.choice([0.0, 0.0, 0.4])) * size * radius
    _polygon(picture, _ring(tilt, px, size), _shine(rng, picture), rng.uniform(0.3, 1.0), soft)


def _line(rng: np.random.Generator, picture: Float32Array, hall: Hall) -> None:
    """A line or a circle, painted or projected."""
    px, tilt, radius = _on_cloth(rng, hall, picture)
    mask = np.zeros(picture.shape[:2], np.uint8)
    if rng.random() < 0.5:
        points = _ring(tilt, px, float(rng.choice([1.15, 1.5, 2.0, 6.0])) * rng.uniform(0.8, 1.3))
    else:
        points = px + np.array([[-60.0], [60.0]]) * (tilt @ rng.normal(size=2))
    closed = len(points) > 2
    thick = max(1, round(float(rng.uniform(0.03, 0.3)) * radius))
    cv2.polylines(mask, [np.rint(points * 2**SHIFT).astype(np.int32)], closed, 255, thick, cv2.LINE_AA, SHIFT)
    _through(picture, mask, _shine(rng, picture), rng.uniform(0.2, 1.0))


def paint_halos(rng: np.random.Generator, picture: Float32Array, hall: Hall, places: FloatArray) -> None:
    """Rings of light about balls at places (n, 2) m, as projectors draw them."""
    for place in places:
        camera, r = hall.camera, hall.table.ball_radius
        tilt = np.asarray(np.linalg.inv(camera.metres_per_pixel(place, 0.0)) * r, dtype=np.float64)
        outline = _ring(tilt, camera.to_pixels(place, 0.0), float(rng.uniform(1.05, 2.2)))
        mask = np.zeros(picture.shape[:2], np.uint8)
        thick = max(1, round(float(rng.uniform(0.05, 0.35)) * float(camera.radius_px(place, r))))
        cv2.polylines(mask, [np.rint(outline * 2**SHIFT).astype(np.int32)], True, 255, thick, cv2.LINE_AA, SHIFT)
        _through(picture, mask, _shine(rng, picture), rng.uniform(0.2, 1.0))


def _logo(rng: np.random.Generator, picture: Float32Array, hall: Hall) -> None:
    """Letters on the cloth."""
    px, tilt, _ = _on_cloth(rng, hall, picture)
    size = 96
    flat = np.zeros((size, 2 * size), np.uint8)
    cv2.putText(flat, _word(rng, 6), (4, 70), int(rng.integers(0, 8)), 2.0, 255, int(rng.integers(2, 9)), cv2.LINE_AA)
    turn = rng.uniform(0, 2 * np.pi)
    spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    affine = tilt @ spin * rng.uniform(1.0, 8.0) / size
    matrix = np.column_stack([affine, px - affine @ [size, size / 2]])
    height, width = picture.shape[:2]
    mask = np.asarray(cv2.warpAffine(flat, matrix, (width, height), flags=cv2.INTER_LINEAR), dtype=np.uint8)
    _through(picture, mask, _shine(rng, picture), rng.uniform(0.2, 0.9))


def _chalk(rng: np.random.Generator, picture: Float32Array, hall: Hall) -> None:
    """A cube of chalk with its shadow."""
    px, tilt, radius = _on_cloth(rng, hall, picture)
    turn, half = rng.uniform(0, np.pi), rng.uniform(0.3, 0.45)
    angle = turn + np.pi / 4 + np.arange(4) * np.pi / 2
    foot = px + np.sqrt(2) * half * np.column_stack([np.cos(angle), np.sin(angle)]) @ tilt.T
    colour = _shine(rng, picture)
    _polygon(picture, foot + rng.normal(0, 0.3, 2) * radius, np.zeros(3), 0.5, 0.2 * radius)
    top = foot - (0, radius * 0.5 * np.sqrt(max(1 - np.linalg.det(tilt) / radius**2, 0.0)))
    _polygon(picture, foot, 0.6 * colour, 1.0)
    _polygon(picture, top, colour, 1.0)


def _dust(rng: np.random.Generator, picture: Float32Array, hall: Hall) -> None:
    """A smear of chalk or wear, a patch of light, a shadow of somebody: soft and large."""
    px, tilt, radius = _on_cloth(rng, hall, picture)
    size = rng.uniform(0.5, 10.0)
    mask = np.zeros(picture.shape[:2], np.uint8)
    outline = _ring(tilt @ np.diag([1.0, rng.uniform(0.2, 1.0)]), px, size)
    cv2.fillPoly(mask, [np.rint(outline * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    share = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), max(0.4 * size * radius, 0.8))
    picture *= singles(np.exp(rng.normal(0, 0.5) * share))[..., None]


_CLOTH_MARKS: tuple[tuple[Callable[[np.random.Generator, Float32Array, Hall], None], float, int], ...] = (
    (_dust, 0.5, 4),
    (_spot, 0.4, 4),
    (_line, 0.4, 3),
    (_logo, 0.3, 2),
    (_chalk, 0.2, 2),
)
"""Painters, in which share of pictures, and how many at the most."""


def _blob(rng: np.random.Generator, picture: Float32Array, px: FloatArray, size: float) -> None:
    """An ellipse or a polygon of a spectator, a chair, a poster."""
    colour = _shine(rng, picture)
    if rng.random() < 0.5:
        turn = rng.normal(size=(2, 2))
        _polygon(picture, _ring(turn, px, size), colour, 1.0, float(rng.uniform(0, 2)))
    else:
        _polygon(picture, px + size * rng.normal(size=(int(rng.integers(3, 6)), 2)), colour, 1.0)


def _heading(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _cue(rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light) -> None:
    place = np.append(hall.camera.to_table(_anywhere(rng, picture), 0.03), rng.uniform(0.02, 0.06))
    rods = cue_rods(place, _heading(rng), float(rng.uniform(0.02, 0.3)))
    _rods(rng, picture, hall, light, rods, keep=0.5)


def _arm(rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light) -> None:
    """A bridge hand with its arm, sometimes under a cue."""
    ahead = _heading(rng)
    place = np.append(hall.camera.to_table(_anywhere(rng, picture), 0.0), rng.uniform(0.0, 0.04))
    rods = hand_rods(place, ahead, random_colour(rng, (0.0, 0.9), (0.03, 1.0)))
    skin = np.clip(np.array(rods[-1].colour) * rng.uniform(0.3, 1.15) + rng.normal(0, 0.03, 3), 0, 1)
    tinted = tuple(replace(rod, colour=_three(skin)) if rod.colour == rods[-1].colour else rod for rod in rods)
    if rng.random() < 0.5:
        tinted = (*tinted, *cue_rods(place + np.append(0.25 * ahead, 0.03), ahead))
    _rods(rng, picture, hall, light, tinted, keep=1.0)


def _three(values: FloatArray) -> Colour:
    return float(values[0]), float(values[1]), float(values[2])


def _frame(rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light) -> None:
    """The triangle that racks the balls."""
    r = hall.table.ball_radius
    middle = np.append(hall.camera.to_table(_anywhere(rng, picture), r), r)
    turn = rng.uniform(0, 2 * np.pi) + np.arange(3) * 2 * np.pi / 3
    tips = middle + rng.uniform(7.0, 11.5) * r * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    colour = random_colour(rng, (0.0, 0.9), (0.05, 0.9))
    rods = tuple(Rod(tips[i], tips[(i + 1) % 3], 0.3 * r, 0.3 * r, colour) for i in range(3))
    _rods(rng, picture, hall, light, rods, keep=1.0)


def _rods(
    rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light, rods: tuple[Rod, ...], keep: float
) -> None:
    """Rods in front of the camera, blurred along a random way in some pictures."""
    camera: Camera = hall.camera
    ends = np.array([end for rod in rods for end in (rod.a, rod.b)])
    below_eye = ends[:, 2].max() < 0.8 * camera.eye[2] and ends[:, 2].max() < 0.8 * light.position[:, 2].min()
    depth = np.column_stack([ends, np.ones(len(ends))]) @ camera.matrix[2]
    if not below_eye or depth.min() < 0.2 * float(np.median(np.abs(depth))):
        return
    if rng.random() > keep:
        rods = tuple(replace(rod, colour=random_colour(rng, (0.0, 0.9), (0.05, 1.0))) for rod in rods)
    draw_rods(picture, camera, lens_of(camera, 0.0), light, rods)


def _body(rng: np.random.Generator, picture: Float32Array, hall: Hall, light: Light) -> None:
    """A player who stands before the table: large, soft, from a border of the picture."""
    height, width = picture.shape[:2]
    side = rng.integers(4)
    base = np.array([[0.5, -0.1], [1.1, 0.5], [0.5, 1.1], [-0.1, 0.5]])[side] * (width, height)
    base = base + rng.normal(0, 0.25, 2) * (width, height) * (np.abs(base / (width, height) - 0.5) < 0.2)
    _polygon(
        picture, _ring(rng.normal(size=(2, 2)), base, 0.22 * width), _shine(rng, picture), 1.0, float(rng.uniform(0, 3))
    )


def _word(rng: np.random.Generator, longest: int) -> str:
    letters = list(string.ascii_letters + string.digits + " &")
    return "".join(rng.choice(letters, int(rng.integers(1, longest + 1))))


def _write(picture: NDArray[np.uint8], text: str, at: tuple[int, int], scale: float, colour: list[int]) -> None:
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, max(scale, 0.25), colour, 1, cv2.LINE_AA)
