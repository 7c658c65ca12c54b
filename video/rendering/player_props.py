"""A player in the picture: a cue and a bridge hand, made of tapered rods with round ends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from models.core.scene import Camera
from models.core.typing import Float32Array, FloatArray
from video.rendering.ball_shading import Light, linear
from video.rendering.pinhole_camera import Lens, project
from video.rendering.scene_appearance import Colour

SKIN: Colour = (0.80, 0.58, 0.46)
CUE_LENGTH = 1.45
"""m."""


@dataclass(frozen=True, slots=True)
class Rod:
    """A tapered rod from a to b (3,), m, with its radii and colour."""

    a: FloatArray
    b: FloatArray
    radius_a: float
    radius_b: float
    colour: Colour


def cue_rods(tip: FloatArray, direction: FloatArray, elevation: float = 0.06) -> tuple[Rod, ...]:
    """A cue whose tip is at `tip` (3,), m, and which points along `direction` (2,); its butt is raised."""
    way = np.append(np.asarray(direction) / np.linalg.norm(direction) * np.cos(elevation), -np.sin(elevation))
    # lengths from the tip, radius there, colour of the stretch up to the next
    stretches = (
        (0.0, 0.0062, (0.16, 0.32, 0.50)),
        (0.010, 0.0063, (0.93, 0.92, 0.88)),
        (0.035, 0.0064, (0.84, 0.68, 0.46)),
        (0.72, 0.0105, (0.10, 0.07, 0.06)),
        (1.05, 0.0125, (0.30, 0.09, 0.07)),
        (CUE_LENGTH, 0.0145, (0.05, 0.05, 0.05)),
    )
    return tuple(
        Rod(tip - way * near, tip - way * far, thin, thick, colour)
        for (near, thin, colour), (far, thick, _) in pairwise(stretches)
    )


def hand_rods(bridge: FloatArray, direction: FloatArray, sleeve: Colour = (0.06, 0.06, 0.08)) -> tuple[Rod, ...]:
    """A bridge hand under a cue along `direction` (2,): fingers on the cloth at `bridge` (3,), the arm behind."""
    ahead = np.append(np.asarray(direction) / np.linalg.norm(direction), 0.0)
    aside = np.array([-ahead[1], ahead[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    palm = bridge - 0.075 * ahead + 0.030 * aside + 0.025 * up
    wrist = palm - 0.085 * ahead + 0.035 * aside + 0.02 * up
    elbow = wrist - 0.27 * ahead + 0.11 * aside + 0.06 * up
    tips = [(0.035, 0.075), (0.042, 0.045), (0.036, 0.015), (0.012, -0.022)]
    knuckles = [palm + 0.02 * (0.6 - i * 0.4) * aside for i in range(len(tips))]
    fingers = [
        Rod(knuckle, bridge + a * ahead + s * aside + 0.006 * up, 0.011, 0.007, SKIN)
        for knuckle, (a, s) in zip(knuckles, tips, strict=True)
    ]
    thumb = Rod(palm - 0.02 * aside, bridge - 0.005 * ahead - 0.012 * aside + 0.016 * up, 0.012, 0.008, SKIN)
    shoulder = elbow - 0.95 * ahead + 0.10 * aside + 0.30 * up
    return (
        Rod(shoulder, elbow, 0.060, 0.048, sleeve),
        Rod(elbow, wrist + (elbow - wrist) * 0.25, 0.048, 0.038, sleeve),
        Rod(wrist + (elbow - wrist) * 0.25, palm, 0.030, 0.026, SKIN),
        Rod(palm - 0.02 * aside, palm + 0.025 * aside, 0.028, 0.026, SKIN),
        *fingers,
        thumb,
    )


def draw_rods(picture: Float32Array, camera: Camera, lens: Lens, light: Light, rods: tuple[Rod, ...]) -> None:
    """Lay rods over a linear picture (H, W, 3), in place, with their shadows."""
    for rod in rods:
        _throw_shadow(picture, camera, lens, light, rod)
    for rod in rods:
        window, near, across, alpha = _cover(picture.shape, camera, lens, rod)
        if alpha.size == 0:
            continue
        bulge = np.sqrt(np.maximum(1 - near**2, 0))
        shade = 0.30 + 0.70 * bulge - 0.12 * across + 0.10 * np.clip(bulge, 0, 1) ** 12
        colour = linear(rod.colour)[None, None, :] * shade[..., None]
        patch = picture[window]
        patch += (colour - patch) * alpha[..., None]


def _throw_shadow(picture: Float32Array, camera: Camera, lens: Lens, light: Light, rod: Rod) -> None:
    for lamp in range(len(light.radius)):
        source = light.position[lamp]
        ends = [end + (end - source) * (end[2] / (source[2] - end[2])) for end in (rod.a, rod.b)]
        soft = float(light.radius[lamp]) * max(rod.a[2], rod.b[2]) / source[2]
        fallen = Rod(ends[0], ends[1], rod.radius_a + soft, rod.radius_b + soft, rod.colour)
        window, near, _, alpha = _cover(picture.shape, camera, lens, fallen)
        if alpha.size:
            dark = (
                0.55
                * rod.radius_b
                / (rod.radius_b + soft)
                / len(light.radius)
                * (1 + np.cos(np.pi * np.clip(near, 0, 1)))
                / 2
            )
            picture[window] *= (1 - dark)[..., None]


def _cover(
    shape: tuple[int, ...], camera: Camera, lens: Lens, rod: Rod
) -> tuple[tuple[slice, slice], Float32Array, Float32Array, Float32Array]:
    """Window of a rod; there distance from its axis in radii, signed side, and covered share (h, w)."""
    ends = project(camera, lens, np.stack([rod.a, rod.b]))
    homogeneous = np.stack([rod.a, rod.b]) @ camera.matrix[2, :3] + camera.matrix[2, 3]
    # homogeneous depth is in metres only for a matrix scaled like K [R | t]; a focal length follows from its rows
    focal = (
        np.linalg.norm(np.cross(camera.matrix[2, :3], camera.matrix[0, :3])) / np.linalg.norm(camera.matrix[2, :3]) ** 2
    )
    radii = np.array([rod.radius_a, rod.radius_b]) * focal / (homogeneous / np.linalg.norm(camera.matrix[2, :3]))
    margin = radii.max() + 2
    low = np.floor(ends.min(axis=0) - margin).astype(int)
    high = np.ceil(ends.max(axis=0) + margin).astype(int) + 1
    x0, y0 = np.maximum(low, 0)
    x1, y1 = np.minimum(high, [shape[1], shape[0]])
    window = (slice(y0, max(y1, y0)), slice(x0, max(x1, x0)))
    y, x = np.mgrid[window].astype(np.float32)
    axis = ends[1] - ends[0]
    length2 = max(float(axis @ axis), 1e-9)
    off_x, off_y = x - np.float32(ends[0, 0]), y - np.float32(ends[0, 1])
    along = np.clip((off_x * axis[0] + off_y * axis[1]) / length2, 0, 1).astype(np.float32)
    dx, dy = off_x - along * np.float32(axis[0]), off_y - along * np.float32(axis[1])
    radius = radii[0] + along * np.float32(radii[1] - radii[0])
    distance = np.hypot(dx, dy)
    alpha = np.clip(radius - distance + 0.5, 0, 1) * np.clip(2 * radius, 0, 1)
    return (
        window,
        (distance / radius).astype(np.float32),
        ((dx + dy) / (1.414 * radius)).astype(np.float32),
        alpha.astype(np.float32),
    )
