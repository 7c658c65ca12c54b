"""Clutter in training images: marks, logos, chalk and light spots beneath the balls; players and captions above them.

Everything is painted onto linear light (H, W, 3), in place. Shapes on the table are foreshortened like the cloth. None
of it is a ball, and some of it resembles one.
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
from video.rendering.ball_shading import Illumination, srgb_to_linear, to_float32
from video.rendering.pinhole_camera import make_lens
from video.rendering.player_props import Rod, draw_rods, make_cue_rods, make_hand_rods
from video.rendering.random_scene import RandomScene, sample_colour

# Fractional bits of pixel coordinates in OpenCV's drawing functions.
SHIFT = 4


def paint_backdrop(rng: np.random.Generator, image: Float32Array, scene: RandomScene, outside_m: Float32Array) -> None:
    """Paint marks on the cloth and spectators beside the table, in place.

    Args:
        rng: source of randomness.
        image: (H, W, 3) linear light.
        outside_m: (H, W) m, distance of each pixel outside the noses.
    """
    is_surroundings = outside_m > 0.18
    if is_surroundings.mean() > 0.02 and rng.random() < 0.7:
        surroundings = image.copy()
        for _ in range(int(rng.integers(3, 25))):
            _paint_blob(rng, surroundings, _sample_pixel(rng, surroundings), rng.uniform(3, 40))
        image[is_surroundings] = surroundings[is_surroundings]
    for painter, share, largest_count in _CLOTH_MARKS:
        for _ in range(int(rng.integers(1, largest_count + 1)) if rng.random() < share else 0):
            painter(rng, image, scene)


def paint_players(rng: np.random.Generator, image: Float32Array, scene: RandomScene, light: Illumination) -> None:
    """Paint cues, hands, arms, bodies and racks over the balls, in place."""
    for painter, share in ((_paint_cue, 0.22), (_paint_arm, 0.15), (_paint_body, 0.10), (_paint_rack, 0.06)):
        if rng.random() < share:
            painter(rng, image, scene, light)


def paint_caption(rng: np.random.Generator, image: NDArray[np.uint8]) -> None:
    """Paint a scoreboard or the name of a channel over the finished image (H, W, 3), in place."""
    height, width = image.shape[:2]
    h, w = int(height * rng.uniform(0.06, 0.2)), int(width * rng.uniform(0.2, 0.9))
    x, y = int(rng.integers(0, width - w + 1)), int(rng.choice([0, height - h]))
    colour = [int(c) for c in rng.integers(0, 256, 3)]
    alpha = rng.uniform(0.5, 1.0)
    image[y : y + h, x : x + w] = image[y : y + h, x : x + w] * (1 - alpha) + alpha * np.array(colour)
    word, ink, place = _sample_word(rng, 12), rng.integers(0, 256, 3).tolist(), (x + 2, y + h - 3)
    cv2.putText(image, word, place, cv2.FONT_HERSHEY_SIMPLEX, max(h / 30, 0.25), ink, 1, cv2.LINE_AA)


def _sample_pixel(rng: np.random.Generator, image: Float32Array) -> FloatArray:
    """Sample a pixel position (2,)."""
    return rng.uniform(0, 1, 2) * image.shape[1::-1]


def _sample_cloth_pixel(
    rng: np.random.Generator, scene: RandomScene, image: Float32Array
) -> tuple[FloatArray, FloatArray, float]:
    """Sample a pixel (2,); also return d(px)/d(ball radius) (2, 2) of the cloth there, and the ball radius in px."""
    px = _sample_pixel(rng, image)
    camera, r = scene.camera, scene.table.ball_radius
    xy = camera.to_table(px, 0.0)
    tilt = np.linalg.inv(camera.metres_per_pixel(xy, 0.0)) * r
    return px, np.asarray(tilt, dtype=np.float64), float(camera.radius_px(xy, r))


def _sample_light_colour(rng: np.random.Generator, image: Float32Array) -> FloatArray:
    """Sample a linear colour about as bright as the image."""
    level = float(np.median(image[::8, ::8])) + 0.1
    bright = level * rng.uniform(0.4, 4.0)
    return np.asarray(srgb_to_linear(sample_colour(rng, (0.0, 1.0), (0.1, 1.0))) * bright, dtype=np.float64)


def _fill_polygon(image: Float32Array, points: FloatArray, colour: FloatArray, alpha: float, soft: float = 0.0) -> None:
    """Fill a polygon with points (n, 2) px; its border is `soft` px wide."""
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(points * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    _paint_through_mask(image, mask, colour, alpha, soft)


def _paint_through_mask(
    image: Float32Array, mask: NDArray[np.uint8], colour: FloatArray, alpha: float, soft: float = 0.0
) -> None:
    share = mask.astype(np.float32) / 255
    if soft > 0.3:
        share = cv2.GaussianBlur(share, (0, 0), soft)
    image += (to_float32(colour) - image) * to_float32(alpha * share)[..., None]


def _circle_outline(tilt: FloatArray, centre: FloatArray, radius: float, count: int = 40) -> FloatArray:
    """Return points (n, 2) px of a circle on the cloth, `radius` in ball radii."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.asarray(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]) @ tilt.T)


def _paint_spot(rng: np.random.Generator, image: Float32Array, scene: RandomScene) -> None:
    """Paint a flat round object: a sticker, a coin, a spot, a worn area."""
    px, tilt, radius = _sample_cloth_pixel(rng, scene, image)
    size = float(np.exp(rng.uniform(np.log(0.1), np.log(3.0))))
    soft = float(rng.choice([0.0, 0.0, 0.4])) * size * radius
    _fill_polygon(image, _circle_outline(tilt, px, size), _sample_light_colour(rng, image), rng.uniform(0.3, 1.0), soft)


def _paint_line(rng: np.random.Generator, image: Float32Array, scene: RandomScene) -> None:
    """Paint a line or a circle, drawn or projected."""
    px, tilt, radius = _sample_cloth_pixel(rng, scene, image)
    mask = np.zeros(image.shape[:2], np.uint8)
    if rng.random() < 0.5:
        points = _circle_outline(tilt, px, float(rng.choice([1.15, 1.5, 2.0, 6.0])) * rng.uniform(0.8, 1.3))
    else:
        points = px + np.array([[-60.0], [60.0]]) * (tilt @ rng.normal(size=2))
    closed = len(points) > 2
    thick = max(1, round(float(rng.uniform(0.03, 0.3)) * radius))
    cv2.polylines(mask, [np.rint(points * 2**SHIFT).astype(np.int32)], closed, 255, thick, cv2.LINE_AA, SHIFT)
    _paint_through_mask(image, mask, _sample_light_colour(rng, image), rng.uniform(0.2, 1.0))


def paint_halos(rng: np.random.Generator, image: Float32Array, scene: RandomScene, positions: FloatArray) -> None:
    """Paint rings of light around balls at positions (n, 2) m, as projectors draw them."""
    for position in positions:
        camera, r = scene.camera, scene.table.ball_radius
        tilt = np.asarray(np.linalg.inv(camera.metres_per_pixel(position, 0.0)) * r, dtype=np.float64)
        outline = _circle_outline(tilt, camera.to_pixels(position, 0.0), float(rng.uniform(1.05, 2.2)))
        mask = np.zeros(image.shape[:2], np.uint8)
        thick = max(1, round(float(rng.uniform(0.05, 0.35)) * float(camera.radius_px(position, r))))
        cv2.polylines(mask, [np.rint(outline * 2**SHIFT).astype(np.int32)], True, 255, thick, cv2.LINE_AA, SHIFT)
        _paint_through_mask(image, mask, _sample_light_colour(rng, image), rng.uniform(0.2, 1.0))


def _paint_logo(rng: np.random.Generator, image: Float32Array, scene: RandomScene) -> None:
    """Paint letters on the cloth."""
    px, tilt, _ = _sample_cloth_pixel(rng, scene, image)
    size = 96
    flat = np.zeros((size, 2 * size), np.uint8)
    cv2.putText(
        flat, _sample_word(rng, 6), (4, 70), int(rng.integers(0, 8)), 2.0, 255, int(rng.integers(2, 9)), cv2.LINE_AA
    )
    angle = rng.uniform(0, 2 * np.pi)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = tilt @ rotation * rng.uniform(1.0, 8.0) / size
    matrix = np.column_stack([affine, px - affine @ [size, size / 2]])
    height, width = image.shape[:2]
    mask = np.asarray(cv2.warpAffine(flat, matrix, (width, height), flags=cv2.INTER_LINEAR), dtype=np.uint8)
    _paint_through_mask(image, mask, _sample_light_colour(rng, image), rng.uniform(0.2, 0.9))


def _paint_chalk(rng: np.random.Generator, image: Float32Array, scene: RandomScene) -> None:
    """Paint a cube of chalk with its shadow."""
    px, tilt, radius = _sample_cloth_pixel(rng, scene, image)
    turn, half = rng.uniform(0, np.pi), rng.uniform(0.3, 0.45)
    angle = turn + np.pi / 4 + np.arange(4) * np.pi / 2
    foot = px + np.sqrt(2) * half * np.column_stack([np.cos(angle), np.sin(angle)]) @ tilt.T
    colour = _sample_light_colour(rng, image)
    _fill_polygon(image, foot + rng.normal(0, 0.3, 2) * radius, np.zeros(3), 0.5, 0.2 * radius)
    top = foot - (0, radius * 0.5 * np.sqrt(max(1 - np.linalg.det(tilt) / radius**2, 0.0)))
    _fill_polygon(image, foot, 0.6 * colour, 1.0)
    _fill_polygon(image, top, colour, 1.0)


def _paint_smear(rng: np.random.Generator, image: Float32Array, scene: RandomScene) -> None:
    """Paint a soft, large patch: chalk, wear, light, or the shadow of a person."""
    px, tilt, radius = _sample_cloth_pixel(rng, scene, image)
    size = rng.uniform(0.5, 10.0)
    mask = np.zeros(image.shape[:2], np.uint8)
    outline = _circle_outline(tilt @ np.diag([1.0, rng.uniform(0.2, 1.0)]), px, size)
    cv2.fillPoly(mask, [np.rint(outline * 2**SHIFT).astype(np.int32)], 255, cv2.LINE_AA, SHIFT)
    share = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), max(0.4 * size * radius, 0.8))
    image *= to_float32(np.exp(rng.normal(0, 0.5) * share))[..., None]


# Painters of marks, the share of images with each, and its largest count.
_CLOTH_MARKS: tuple[tuple[Callable[[np.random.Generator, Float32Array, RandomScene], None], float, int], ...] = (
    (_paint_smear, 0.5, 4),
    (_paint_spot, 0.4, 4),
    (_paint_line, 0.4, 3),
    (_paint_logo, 0.3, 2),
    (_paint_chalk, 0.2, 2),
)


def _paint_blob(rng: np.random.Generator, image: Float32Array, px: FloatArray, size: float) -> None:
    """Paint an ellipse or a polygon: a spectator, a chair, a poster."""
    colour = _sample_light_colour(rng, image)
    if rng.random() < 0.5:
        turn = rng.normal(size=(2, 2))
        _fill_polygon(image, _circle_outline(turn, px, size), colour, 1.0, float(rng.uniform(0, 2)))
    else:
        _fill_polygon(image, px + size * rng.normal(size=(int(rng.integers(3, 6)), 2)), colour, 1.0)


def _sample_direction(rng: np.random.Generator) -> FloatArray:
    """Sample a unit vector (2,)."""
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _paint_cue(rng: np.random.Generator, image: Float32Array, scene: RandomScene, light: Illumination) -> None:
    position = np.append(scene.camera.to_table(_sample_pixel(rng, image), 0.03), rng.uniform(0.02, 0.06))
    rods = make_cue_rods(position, _sample_direction(rng), float(rng.uniform(0.02, 0.3)))
    _paint_rods(rng, image, scene, light, rods, keep_colour_share=0.5)


def _paint_arm(rng: np.random.Generator, image: Float32Array, scene: RandomScene, light: Illumination) -> None:
    """Paint a bridge hand with its arm, sometimes under a cue."""
    direction = _sample_direction(rng)
    position = np.append(scene.camera.to_table(_sample_pixel(rng, image), 0.0), rng.uniform(0.0, 0.04))
    rods = make_hand_rods(position, direction, sample_colour(rng, (0.0, 0.9), (0.03, 1.0)))
    skin = np.clip(np.array(rods[-1].colour) * rng.uniform(0.3, 1.15) + rng.normal(0, 0.03, 3), 0, 1).tolist()
    tinted = tuple(replace(rod, colour=tuple(skin)) if rod.colour == rods[-1].colour else rod for rod in rods)
    if rng.random() < 0.5:
        tinted = (*tinted, *make_cue_rods(position + np.append(0.25 * direction, 0.03), direction))
    _paint_rods(rng, image, scene, light, tinted, keep_colour_share=1.0)


def _paint_rack(rng: np.random.Generator, image: Float32Array, scene: RandomScene, light: Illumination) -> None:
    """Paint the triangular rack for the balls."""
    r = scene.table.ball_radius
    middle = np.append(scene.camera.to_table(_sample_pixel(rng, image), r), r)
    angle = rng.uniform(0, 2 * np.pi) + np.arange(3) * 2 * np.pi / 3
    corners = middle + rng.uniform(7.0, 11.5) * r * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    colour = sample_colour(rng, (0.0, 0.9), (0.05, 0.9))
    rods = tuple(Rod(corners[i], corners[(i + 1) % 3], 0.3 * r, 0.3 * r, colour) for i in range(3))
    _paint_rods(rng, image, scene, light, rods, keep_colour_share=1.0)


def _paint_rods(
    rng: np.random.Generator,
    image: Float32Array,
    scene: RandomScene,
    light: Illumination,
    rods: tuple[Rod, ...],
    keep_colour_share: float,
) -> None:
    """Paint rods that are below the camera and in view; their colours are sometimes random."""
    camera: Camera = scene.camera
    ends = np.array([end for rod in rods for end in (rod.a, rod.b)])
    below_eye = ends[:, 2].max() < 0.8 * camera.position[2] and ends[:, 2].max() < 0.8 * light.position[:, 2].min()
    depth = np.column_stack([ends, np.ones(len(ends))]) @ camera.matrix[2]
    if not below_eye or depth.min() < 0.2 * float(np.median(np.abs(depth))):
        return
    if rng.random() > keep_colour_share:
        rods = tuple(replace(rod, colour=sample_colour(rng, (0.0, 0.9), (0.05, 1.0))) for rod in rods)
    draw_rods(image, camera, make_lens(camera, 0.0), light, rods)


def _paint_body(rng: np.random.Generator, image: Float32Array, scene: RandomScene, light: Illumination) -> None:
    """Paint a player who stands before the table: large, soft, from a border of the image."""
    height, width = image.shape[:2]
    side = rng.integers(4)
    base = np.array([[0.5, -0.1], [1.1, 0.5], [0.5, 1.1], [-0.1, 0.5]])[side] * (width, height)
    base = base + rng.normal(0, 0.25, 2) * (width, height) * (np.abs(base / (width, height) - 0.5) < 0.2)
    _fill_polygon(
        image,
        _circle_outline(rng.normal(size=(2, 2)), base, 0.22 * width),
        _sample_light_colour(rng, image),
        1.0,
        float(rng.uniform(0, 3)),
    )


def _sample_word(rng: np.random.Generator, max_length: int) -> str:
    letters = list(string.ascii_letters + string.digits + " &")
    return "".join(rng.choice(letters, int(rng.integers(1, max_length + 1))))
