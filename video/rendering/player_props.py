"""Players in rendered images: cue and bridge hand, modelled as tapered rods with round ends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from models.core.scene import Camera
from models.core.typing import Float32Array, FloatArray
from video.rendering.ball_shading import Illumination, srgb_to_linear
from video.rendering.pinhole_camera import Lens, project_points
from video.rendering.scene_appearance import Colour

# Colour of hands.
SKIN: Colour = (0.80, 0.58, 0.46)
# m.
CUE_LENGTH_M = 1.45


@dataclass(frozen=True, slots=True)
class Rod:
    """A tapered rod from a to b (3,), m, with its radii (m) and colour."""

    a: FloatArray
    b: FloatArray
    radius_a: float
    radius_b: float
    colour: Colour


def make_cue_rods(tip: FloatArray, direction: FloatArray, elevation: float = 0.06) -> tuple[Rod, ...]:
    """Make a cue with its tip at `tip` (3,), m, along `direction` (2,); the butt is raised by `elevation` rad."""
    axis = np.append(np.asarray(direction) / np.linalg.norm(direction) * np.cos(elevation), -np.sin(elevation))
    # distance from the tip, radius there, colour of the section up to the next
    sections = (
        (0.0, 0.0062, (0.16, 0.32, 0.50)),
        (0.010, 0.0063, (0.93, 0.92, 0.88)),
        (0.035, 0.0064, (0.84, 0.68, 0.46)),
        (0.72, 0.0105, (0.10, 0.07, 0.06)),
        (1.05, 0.0125, (0.30, 0.09, 0.07)),
        (CUE_LENGTH_M, 0.0145, (0.05, 0.05, 0.05)),
    )
    return tuple(
        Rod(tip - axis * near, tip - axis * far, thin, thick, colour)
        for (near, thin, colour), (far, thick, _) in pairwise(sections)
    )


def make_hand_rods(bridge: FloatArray, direction: FloatArray, sleeve: Colour = (0.06, 0.06, 0.08)) -> tuple[Rod, ...]:
    """Make a bridge hand under a cue along `direction` (2,): fingers on the cloth at `bridge` (3,), m, and the arm."""
    forward = np.append(np.asarray(direction) / np.linalg.norm(direction), 0.0)
    sideways = np.array([-forward[1], forward[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    palm = bridge - 0.075 * forward + 0.030 * sideways + 0.025 * up
    wrist = palm - 0.085 * forward + 0.035 * sideways + 0.02 * up
    elbow = wrist - 0.27 * forward + 0.11 * sideways + 0.06 * up
    tips = [(0.035, 0.075), (0.042, 0.045), (0.036, 0.015), (0.012, -0.022)]
    knuckles = [palm + 0.02 * (0.6 - i * 0.4) * sideways for i in range(len(tips))]
    fingers = [
        Rod(knuckle, bridge + a * forward + s * sideways + 0.006 * up, 0.011, 0.007, SKIN)
        for knuckle, (a, s) in zip(knuckles, tips, strict=True)
    ]
    thumb = Rod(palm - 0.02 * sideways, bridge - 0.005 * forward - 0.012 * sideways + 0.016 * up, 0.012, 0.008, SKIN)
    shoulder = elbow - 0.95 * forward + 0.10 * sideways + 0.30 * up
    return (
        Rod(shoulder, elbow, 0.060, 0.048, sleeve),
        Rod(elbow, wrist + (elbow - wrist) * 0.25, 0.048, 0.038, sleeve),
        Rod(wrist + (elbow - wrist) * 0.25, palm, 0.030, 0.026, SKIN),
        Rod(palm - 0.02 * sideways, palm + 0.025 * sideways, 0.028, 0.026, SKIN),
        *fingers,
        thumb,
    )


def draw_rods(image: Float32Array, camera: Camera, lens: Lens, light: Illumination, rods: tuple[Rod, ...]) -> None:
    """Draw rods with their shadows over a linear image (H, W, 3), in place."""
    for rod in rods:
        _cast_shadow(image, camera, lens, light, rod)
    for rod in rods:
        window, near, across, alpha = _rod_coverage(image.shape, camera, lens, rod)
        if alpha.size == 0:
            continue
        bulge = np.sqrt(np.maximum(1 - near**2, 0))
        shade = 0.30 + 0.70 * bulge - 0.12 * across + 0.10 * np.clip(bulge, 0, 1) ** 12
        colour = srgb_to_linear(rod.colour)[None, None, :] * shade[..., None]
        patch = image[window]
        patch += (colour - patch) * alpha[..., None]


def _cast_shadow(image: Float32Array, camera: Camera, lens: Lens, light: Illumination, rod: Rod) -> None:
    for lamp in range(len(light.radius)):
        source = light.position[lamp]
        ends = [end + (end - source) * (end[2] / (source[2] - end[2])) for end in (rod.a, rod.b)]
        soft = float(light.radius[lamp]) * max(rod.a[2], rod.b[2]) / source[2]
        shadow = Rod(ends[0], ends[1], rod.radius_a + soft, rod.radius_b + soft, rod.colour)
        window, near, _, alpha = _rod_coverage(image.shape, camera, lens, shadow)
        if alpha.size:
            dark = (
                0.55
                * rod.radius_b
                / (rod.radius_b + soft)
                / len(light.radius)
                * (1 + np.cos(np.pi * np.clip(near, 0, 1)))
                / 2
            )
            image[window] *= (1 - dark)[..., None]


def _rod_coverage(
    shape: tuple[int, ...], camera: Camera, lens: Lens, rod: Rod
) -> tuple[tuple[slice, slice], Float32Array, Float32Array, Float32Array]:
    """Return the window of a rod; in it the distance from its axis (radii), the signed side, the coverage (h, w)."""
    ends = project_points(camera, lens, np.stack([rod.a, rod.b]))
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
