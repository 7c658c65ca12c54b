"""Shading of spheres: the disc of a ball in the image, its paint, and its shadow.

Window arrays are (h, w); rays are unit vectors from the eye (h, w, 3); colours are linear RGB, where 1 is white paper
in full light. The table's frame is left-handed (x right, y down, z up); a painted number is mirrored to be readable in
it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike

from models.core.srgb import decode_srgb
from models.core.typing import Float32Array, FloatArray
from video.rendering.scene_appearance import IVORY, BallAppearance, Colour

# Share of the cloth's reflected light that reaches the lower half of a ball.
CLOTH_BOUNCE_SHARE = 0.55
# Cosines of the angular radii of a dot and of a number's disc; half height of a stripe in ball radii.
DOT_COSINE, DISC_COSINE, STRIPE_HALF_HEIGHT = 0.972, 0.895, 0.56
# px, side of the bitmap of a number.
NUMBER_SIZE_PX = 64


@dataclass(frozen=True, slots=True)
class Illumination:
    """Lamps as arrays, scaled so that a level sheet of paper at the centre of the table receives 1 in total."""

    position: FloatArray
    """(L, 3) m."""
    radius: FloatArray
    """(L,) m."""
    strength: FloatArray
    """(L,) irradiance of a surface that faces the lamp at `reference` metres."""
    reference: FloatArray
    """(L,) m."""
    ambient: float
    cloth_colour: Float32Array
    """(3,) linear colour of the cloth, reflected to balls."""


def to_float32(values: ArrayLike) -> Float32Array:
    """Convert values to float32."""
    return np.asarray(values, dtype=np.float32)


def srgb_to_linear(colour: Colour) -> Float32Array:
    """Convert sRGB in [0, 1] to linear light (3,)."""
    return to_float32(decode_srgb(np.asarray(colour, dtype=np.float64)))


def lamp_irradiance(light: Illumination, lamp: int, point: Float32Array, normal: Float32Array) -> Float32Array:
    """Compute the irradiance (...) from one lamp at points (..., 3) with unit normals broadcast against them."""
    to_lamp = light.position[lamp].astype(np.float32) - point
    distance = np.sqrt(np.einsum("...i,...i", to_lamp, to_lamp))
    facing = np.maximum(np.einsum("...i,...i", to_lamp, normal), 0) / distance
    return to_float32(light.strength[lamp] * facing * (light.reference[lamp] / distance) ** 2)


@lru_cache(maxsize=32)
def render_number(number: int) -> Float32Array:
    """Render a number in black on white (S, S): 0 ink, 1 paper."""
    text, size = str(number), NUMBER_SIZE_PX
    big = np.full((4 * size, 4 * size), 255, np.uint8)
    scale = 4.6 if len(text) == 1 else 3.6
    (w, h), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 22)
    cv2.putText(big, text, (2 * size - w // 2, 2 * size + h // 2), cv2.FONT_HERSHEY_SIMPLEX, scale, 0, 22, cv2.LINE_AA)
    small = cv2.resize(big, (size, size), interpolation=cv2.INTER_AREA)
    return to_float32(small / np.float32(255))


def paint_ball(appearance: BallAppearance, body: Float32Array, softness: float) -> Float32Array:
    """Compute linear colours (h, w, 3) at unit vectors (h, w, 3) of the ball's frame; `softness` is in radii."""
    base, ivory = srgb_to_linear(appearance.colour), srgb_to_linear(IVORY)
    colour = np.broadcast_to(base, body.shape)
    if appearance.style == "spotted":
        cos = np.abs(body).max(axis=-1)
        # match balls carry red dots on white and yellow, dark ones on red
        dots = srgb_to_linear((0.70, 0.10, 0.10) if appearance.colour[1] > 0.4 else (0.1, 0.1, 0.1))
        return blend_by_share(colour, dots, soft_step(to_float32(cos - DOT_COSINE), softness * 0.35))
    if appearance.style == "stripe":
        colour = blend_by_share(
            colour, ivory, soft_step(to_float32(np.abs(body[..., 2]) - STRIPE_HALF_HEIGHT), softness)
        )
    if appearance.number is None or appearance.style == "plain":
        return colour
    disc = soft_step(to_float32(np.abs(body[..., 0]) - DISC_COSINE), softness * 0.5)
    if not disc.any():
        return colour
    half = np.sqrt(1 - DISC_COSINE**2)
    side = np.sign(body[..., 0])
    columns = (-side * body[..., 1] / half * 0.55 + 0.5) * (NUMBER_SIZE_PX - 1)
    rows = (-body[..., 2] / half * 0.55 + 0.5) * (NUMBER_SIZE_PX - 1)
    ink = cv2.remap(
        render_number(appearance.number), columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=1.0,
    )  # fmt: skip
    return blend_by_share(colour, ivory * (0.03 + 0.97 * ink[..., None]), disc)


def blend_by_share(a: Float32Array, b: Float32Array, share: Float32Array) -> Float32Array:
    """Blend linearly: a where share (h, w) is 0, b where it is 1."""
    return to_float32(a + (b - a) * share[..., None])


def soft_step(x: Float32Array, width: float) -> Float32Array:
    """Step from 0 (x < 0) to 1 (x > 0), linear over `width`."""
    return to_float32(np.clip(x / max(width, 1e-6) + 0.5, 0, 1))


@dataclass(frozen=True, slots=True)
class RenderedBall:
    """A ball rendered in a window of the image."""

    colour: Float32Array
    """(h, w, 3) linear."""
    alpha: Float32Array
    """(h, w) share of the pixel that it covers."""


def render_ball(
    appearance: BallAppearance, light: Illumination, rays: Float32Array, eye: FloatArray, depth: Float32Array,
    centre: FloatArray, radius: float, rotation: FloatArray, pixel_size: float, gloss: float,
) -> RenderedBall:  # fmt: skip
    """Render a ball along rays.

    Args:
        appearance: colours and pattern of the ball.
        light: lamps.
        rays: (h, w, 3) unit vectors from the eye.
        eye: (3,) m, camera position.
        depth: (h, w) m, distance of the scene behind.
        centre: (3,) m, or (h, 1, 3) where every row is exposed at its own time.
        radius: m.
        rotation: (3, 3) from the ball's frame to the table's.
        pixel_size: m, side of a pixel at the ball.
        gloss: strength of reflections.

    Returns:
        Colour and coverage in the window.
    """
    to_ball = (np.asarray(centre) - eye).astype(np.float32)
    along = np.einsum("...i,...i", rays, to_ball)
    foot = rays * along[..., None] - to_ball
    offset = np.sqrt(np.einsum("...i,...i", foot, foot))
    reach = np.sqrt(np.maximum(radius**2 - offset**2, 0))
    normal = foot - rays * reach[..., None]
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    alpha = np.clip((radius - offset) / pixel_size + 0.5, 0, 1) * (along - reach < depth + radius * 0.02)
    body = normal @ rotation.astype(np.float32)
    middle = np.asarray(centre).reshape(-1, 3).mean(axis=0)
    colour = shade_ball(paint_ball(appearance, body, 1.2 * pixel_size / radius), light, normal, rays, middle, gloss)
    return RenderedBall(colour, alpha.astype(np.float32))


def shade_ball(
    colour: Float32Array,
    light: Illumination,
    normal: Float32Array,
    rays: Float32Array,
    centre: FloatArray,
    gloss: float,
) -> Float32Array:
    """Shade the paint (h, w, 3) of a ball at `centre` under all lamps, with their reflections."""
    up = 0.5 + 0.5 * normal[..., 2:]
    total = light.ambient * up + (CLOTH_BOUNCE_SHARE * (1 - up)) * light.cloth_colour
    facing = np.einsum("...i,...i", rays, normal)
    mirrored = rays - 2 * facing[..., None] * normal
    shine = np.zeros(facing.shape, np.float32)
    for lamp in range(len(light.radius)):
        total = total + lamp_irradiance(light, lamp, centre.astype(np.float32), normal)[..., None]
        to_lamp = (light.position[lamp] - centre).astype(np.float32)
        distance = float(np.linalg.norm(to_lamp))
        angle = np.arccos(np.clip(mirrored @ (to_lamp / distance), -1, 1))
        size = max(light.radius[lamp] / distance, 0.05)
        shine += (1 - np.clip((angle - 0.8 * size) / (0.6 * size), 0, 1)) * 0.9
        shine += 0.10 * np.exp(-((angle / 0.35) ** 2))
    fresnel = 0.04 + 0.30 * np.clip(1 + facing, 0, 1) ** 4
    return to_float32(colour * total + gloss * (shine + fresnel * light.ambient)[..., None])


def shadow_factor(
    light: Illumination, share: Float32Array, point: Float32Array, centre: FloatArray, radius: float
) -> Float32Array:
    """Compute the factor (h, w) by which a ball dims the scene at points (h, w, 3).

    `share` (h, w, L + 1) is the share of the light from each lamp; the last is ambient.
    """
    to_ball = centre.astype(np.float32) - point
    distance = np.sqrt(np.einsum("...i,...i", to_ball, to_ball))
    size = np.arcsin(np.minimum(radius / np.maximum(distance, 1e-6), 1))
    near = np.clip(2 - np.hypot(to_ball[..., 0], to_ball[..., 1]) / (SHADOW_REACH_RADII / 2 * radius), 0, 1)
    blocked = share[..., -1] * np.minimum(np.maximum(to_ball[..., 2], 0) / distance * (radius / distance) ** 2, 1)
    for lamp in range(len(light.radius)):
        beam = light.position[lamp].astype(np.float32) - point
        length = np.sqrt(np.einsum("...i,...i", beam, beam))
        angle = np.arccos(np.clip(np.einsum("...i,...i", beam, to_ball) / (length * distance), -1, 1))
        disc = (light.radius[lamp] / length).astype(np.float32)
        covered = np.clip((size + disc - angle) / (2 * np.minimum(size, disc)), 0, 1)
        covered = covered * covered * (3 - 2 * covered) * np.minimum((size / disc) ** 2, 1)
        blocked = blocked + share[..., lamp] * covered
    return to_float32(1 - np.clip(blocked, 0, 1) * near)


# Ball radii from the centre beyond which a ball casts no shadow.
SHADOW_REACH_RADII = 5.0
