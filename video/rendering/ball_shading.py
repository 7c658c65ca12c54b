"""Light on spheres: the disc of a ball in the picture, its paint, and the shadow that it throws.

Window arrays are (h, w); rays are unit vectors from the eye (h, w, 3); colours are linear RGB, 1 a white paper in full
light. The table's frame is left-handed (x right, y down, z up); a painted number is mirrored to read right in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from models.core.typing import Float32Array, FloatArray
from video.rendering.scene_appearance import IVORY, BallLook, Colour

CLOTH_BOUNCE = 0.55
"""Share of the cloth's light that reaches the lower half of a ball."""
SPOT_COS, DISC_COS, STRIPE_HALF = 0.972, 0.895, 0.56
"""Cosines of the angular radii of a dot and of a number's disc; half height of a stripe in ball radii."""
NUMBER_SIZE = 64
"""px of the bitmap of a painted number."""


@dataclass(frozen=True, slots=True)
class Light:
    """Lamps as arrays, scaled so that a level paper at the table's centre receives 1 in all."""

    position: FloatArray
    """(L, 3) m."""
    radius: FloatArray
    """(L,) m."""
    strength: FloatArray
    """(L,) light on a surface that faces the lamp at `reference` metres."""
    reference: FloatArray
    """(L,) m."""
    ambient: float
    cloth: Float32Array
    """(3,) linear colour of the cloth, thrown back to balls."""


def singles(values: ArrayLike) -> Float32Array:
    """Values in float32."""
    return np.asarray(values, dtype=np.float32)


def linear(colour: Colour) -> Float32Array:
    """sRGB in [0, 1] to linear light (3,)."""
    c = np.asarray(colour, dtype=np.float64)
    return singles(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def irradiance(light: Light, lamp: int, point: Float32Array, normal: Float32Array) -> Float32Array:
    """Light (...) of one lamp on a surface at points (..., 3) with unit normals broadcast against them."""
    way = light.position[lamp].astype(np.float32) - point
    distance = np.sqrt(np.einsum("...i,...i", way, way))
    facing = np.maximum(np.einsum("...i,...i", way, normal), 0) / distance
    return singles(light.strength[lamp] * facing * (light.reference[lamp] / distance) ** 2)


@lru_cache(maxsize=32)
def number_bitmap(number: int) -> Float32Array:
    """A number in black on white (S, S), 0 ink, 1 paper."""
    text, size = str(number), NUMBER_SIZE
    big = np.full((4 * size, 4 * size), 255, np.uint8)
    scale = 4.6 if len(text) == 1 else 3.6
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 22)
    cv2.putText(big, text, (2 * size - w // 2, 2 * size + h // 2), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, 22, cv2.LINE_AA)
    small = cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA)
    return singles(small / np.float32(255))


def paint(ball: BallLook, body: Float32Array, softness: float) -> Float32Array:
    """Linear colour (h, w, 3) at unit vectors (h, w, 3) of the ball's own frame; `softness` px in ball radii."""
    base, ivory = linear(ball.colour), linear(IVORY)
    colour = np.broadcast_to(base, body.shape)
    if ball.style == "spotted":
        cos = np.abs(body).max(axis=-1)
        # match balls carry red dots on white and yellow, dark ones on red
        dots = linear((0.70, 0.10, 0.10) if ball.colour[1] > 0.4 else (0.1, 0.1, 0.1))
        return mix(colour, dots, soft_step(singles(cos - SPOT_COS), softness * 0.35))
    if ball.style == "stripe":
        colour = mix(colour, ivory, soft_step(singles(np.abs(body[..., 2]) - STRIPE_HALF), softness))
    if ball.number is None or ball.style == "plain":
        return colour
    disc = soft_step(singles(np.abs(body[..., 0]) - DISC_COS), softness * 0.5)
    if not disc.any():
        return colour
    half = np.sqrt(1 - DISC_COS**2)
    side = np.sign(body[..., 0])
    columns = (-side * body[..., 1] / half * 0.55 + 0.5) * (NUMBER_SIZE - 1)
    rows = (-body[..., 2] / half * 0.55 + 0.5) * (NUMBER_SIZE - 1)
    ink = cv2.remap(number_bitmap(ball.number), columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR,
                    borderMode=cv2.BORDER_CONSTANT, borderValue=1.0)  # fmt: skip
    return mix(colour, ivory * (0.03 + 0.97 * ink[..., None]), disc)


def mix(a: Float32Array, b: Float32Array, share: Float32Array) -> Float32Array:
    """a where share (h, w) is 0, b where it is 1."""
    return singles(a + (b - a) * share[..., None])


def soft_step(x: Float32Array, width: float) -> Float32Array:
    """0 below, 1 above x = 0, over `width`."""
    return singles(np.clip(x / max(width, 1e-6) + 0.5, 0, 1))


@dataclass(frozen=True, slots=True)
class Sprite:
    """A ball in a window of the picture."""

    colour: Float32Array
    """(h, w, 3) linear."""
    alpha: Float32Array
    """(h, w) share of the pixel that it covers."""


def ball_sprite(
    ball: BallLook, light: Light, rays: Float32Array, eye: FloatArray, depth: Float32Array, centre: FloatArray, radius: float,
    rotation: FloatArray, pixel: float, gloss: float,
) -> Sprite:  # fmt: skip
    """A ball seen along rays (h, w, 3).

    `centre` is (3,), or (h, 1, 3) where every row looks at its own time; `rotation` (3, 3) takes the ball's frame to
    the table's; `depth` (h, w) m is how far the scene behind is; `pixel` m is the side of a pixel at the ball.
    """
    to_ball = (np.asarray(centre) - eye).astype(np.float32)
    along = np.einsum("...i,...i", rays, to_ball)
    foot = rays * along[..., None] - to_ball
    miss = np.sqrt(np.einsum("...i,...i", foot, foot))
    reach = np.sqrt(np.maximum(radius**2 - miss**2, 0))
    normal = foot - rays * reach[..., None]
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    alpha = np.clip((radius - miss) / pixel + 0.5, 0, 1) * (along - reach < depth + radius * 0.02)
    body = normal @ rotation.astype(np.float32)
    middle = np.asarray(centre).reshape(-1, 3).mean(axis=0)
    colour = lit(paint(ball, body, 1.2 * pixel / radius), light, normal, rays, middle, gloss)
    return Sprite(colour, alpha.astype(np.float32))


def lit(
    colour: Float32Array, light: Light, normal: Float32Array, rays: Float32Array, centre: FloatArray, gloss: float
) -> Float32Array:
    """Paint (h, w, 3) of a ball at `centre` under all lamps, with their reflections."""
    up = 0.5 + 0.5 * normal[..., 2:]
    total = light.ambient * up + (CLOTH_BOUNCE * (1 - up)) * light.cloth
    facing = np.einsum("...i,...i", rays, normal)
    mirrored = rays - 2 * facing[..., None] * normal
    shine = np.zeros(facing.shape, np.float32)
    for lamp in range(len(light.radius)):
        total = total + irradiance(light, lamp, centre.astype(np.float32), normal)[..., None]
        way = (light.position[lamp] - centre).astype(np.float32)
        distance = float(np.linalg.norm(way))
        angle = np.arccos(np.clip(mirrored @ (way / distance), -1, 1))
        size = max(light.radius[lamp] / distance, 0.05)
        shine += (1 - np.clip((angle - 0.8 * size) / (0.6 * size), 0, 1)) * 0.9
        shine += 0.10 * np.exp(-((angle / 0.35) ** 2))
    fresnel = 0.04 + 0.30 * np.clip(1 + facing, 0, 1) ** 4
    return singles(colour * total + gloss * (shine + fresnel * light.ambient)[..., None])


def shadow(light: Light, share: Float32Array, point: Float32Array, centre: FloatArray, radius: float) -> Float32Array:
    """Factor (h, w) by which a ball dims the scene at points (h, w, 3).

    `share` (h, w, L + 1) says how much of the light there comes from each lamp, the last from everywhere.
    """
    way = centre.astype(np.float32) - point
    distance = np.sqrt(np.einsum("...i,...i", way, way))
    size = np.arcsin(np.minimum(radius / np.maximum(distance, 1e-6), 1))
    near = np.clip(2 - np.hypot(way[..., 0], way[..., 1]) / (SHADOW_REACH / 2 * radius), 0, 1)
    lost = share[..., -1] * np.minimum(np.maximum(way[..., 2], 0) / distance * (radius / distance) ** 2, 1)
    for lamp in range(len(light.radius)):
        beam = light.position[lamp].astype(np.float32) - point
        length = np.sqrt(np.einsum("...i,...i", beam, beam))
        angle = np.arccos(np.clip(np.einsum("...i,...i", beam, way) / (length * distance), -1, 1))
        disc = (light.radius[lamp] / length).astype(np.float32)
        covered = np.clip((size + disc - angle) / (2 * np.minimum(size, disc)), 0, 1)
        covered = covered * covered * (3 - 2 * covered) * np.minimum((size / disc) ** 2, 1)
        lost = lost + share[..., lamp] * covered
    return singles(1 - np.clip(lost, 0, 1) * near)


SHADOW_REACH = 5.0
"""Ball radii from the centre beyond which a ball throws no shadow."""
