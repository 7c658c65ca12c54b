"""The empty table in its room: cloth, cushions, rails, pockets and floor, found with one ray per sample.

The scene consists of level planes: cushion tops and rails at nose height, the cloth at 0, and the floor. A ray that
misses the nose rectangle on the way to the cloth ends on the face of a cushion.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table
from models.core.typing import BoolArray, Float32Array, FloatArray
from video.rendering.ball_shading import Illumination, lamp_irradiance, srgb_to_linear, to_float32
from video.rendering.pinhole_camera import Lens, pixel_rays
from video.rendering.scene_appearance import SceneAppearance

# m, cloth-covered top of the cushion, and wood behind it.
CUSHION_WIDTH, RAIL_WIDTH = 0.050, 0.125
# m below the cloth: the floor, and the lower edge of the wood around the table.
FLOOR_DEPTH, APRON_HEIGHT = 0.80, 0.16
# m, radius of a pocket's hole, and distance of its centre behind the noses (corner: along both axes).
HOLE_RADIUS, HOLE_BACK_CORNER, HOLE_BACK_SIDE = 0.060, 0.020, 0.042
# m of leather around a hole.
RIM_WIDTH = 0.012
# m from a pocket along the rail to the start of the nose; how fast the mouth narrows backwards.
JAW_CORNER, JAW_SIDE, JAW_TAPER = 0.080, 0.064, 0.75
# px, side of a texture tile.
TEXTURE_PX = 1024


@dataclass(frozen=True, slots=True)
class EmptyTable:
    """The static part of a scene, per pixel (H, W)."""

    image: Float32Array
    """(H, W, 3) linear."""
    rays: Float32Array
    """(H, W, 3) unit vectors from the eye."""
    depth: Float32Array
    """(H, W) m from the eye; large in the holes."""
    point: Float32Array
    """(H, W, 3) m, the point at the pixel's centre."""
    light_share: Float32Array
    """(H, W, L + 1) share of the light from each lamp; the last is ambient."""


@dataclass(frozen=True, slots=True)
class RayHits:
    """Intersections of R rays: points, unit normals, linear colours, share of unobstructed ambient light."""

    point: Float32Array
    normal: Float32Array
    colour: Float32Array
    open_share: Float32Array
    is_hole: BoolArray


def build_illumination(table: Table, appearance: SceneAppearance) -> Illumination:
    """Build lamps scaled to give a level sheet of paper at the centre of the table 1 in total."""
    position = np.array([lamp.position for lamp in appearance.lamps])
    to_lamp = position - np.array([table.length / 2, table.width / 2, 0.0])
    distance = np.linalg.norm(to_lamp, axis=1)
    strength = np.array([lamp.strength for lamp in appearance.lamps])
    received = strength * to_lamp[:, 2] / distance
    strength = strength * (1 - appearance.ambient) / received.sum()
    radius = np.array([lamp.radius for lamp in appearance.lamps])
    return Illumination(position, radius, strength, distance, appearance.ambient, srgb_to_linear(appearance.cloth))


def render_empty_table(
    table: Table, camera: Camera, lens: Lens, appearance: SceneAppearance, illumination: Illumination, samples: int
) -> EmptyTable:
    """Render the table without balls, with `samples` squared rays per pixel."""
    tiles = make_textures(appearance.seed)
    height, width = camera.height_px, camera.width_px
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    image = np.zeros((height, width, 3), np.float32)
    offsets = (np.arange(samples) - (samples - 1) / 2) / samples
    for dy in offsets:
        for dx in offsets:
            rays = pixel_rays(camera, lens, np.stack([columns + dx, rows + dy], axis=-1))
            hits = intersect_scene(table, appearance, camera.position, rays.reshape(-1, 3), tiles)
            image += shade_hits(illumination, hits)[0].reshape(image.shape) / samples**2
    rays = pixel_rays(camera, lens, np.stack([columns, rows], axis=-1))
    hits = intersect_scene(table, appearance, camera.position, rays.reshape(-1, 3), tiles)
    depth = to_float32(np.linalg.norm(hits.point - camera.position, axis=1))
    depth[hits.is_hole] = 1e3
    share = shade_hits(illumination, hits)[1].reshape(height, width, -1)
    shape = (height, width)
    point = hits.point.reshape(*shape, 3)
    return EmptyTable(image, to_float32(rays), depth.reshape(shape), point, share)


def shade_hits(illumination: Illumination, hits: RayHits) -> tuple[Float32Array, Float32Array]:
    """Return the linear colour (R, 3) at the intersections, and the share (R, L + 1) of its light by source."""
    parts = [
        lamp_irradiance(illumination, lamp, hits.point, hits.normal) * hits.open_share
        for lamp in range(len(illumination.radius))
    ]
    parts.append(np.full(len(hits.open_share), illumination.ambient, np.float32) * hits.open_share)
    received = np.stack(parts, axis=-1)
    total = received.sum(axis=-1, keepdims=True)
    return hits.colour * total, received / np.maximum(total, 1e-6)


def intersect_scene(
    table: Table, appearance: SceneAppearance, eye: FloatArray, rays: FloatArray, tiles: dict[str, Float32Array]
) -> RayHits:
    """Intersect rays (R, 3) with the table and the floor."""
    nose = NOSE_HEIGHT_RADII * table.ball_radius
    top = intersect_plane(eye, rays, nose)
    cloth = intersect_plane(eye, rays, 0.0)
    outside = distance_outside_table(table, top)
    is_floor = outside > RAIL_WIDTH + CUSHION_WIDTH
    is_mouth, is_hole, is_rim = pocket_regions(table, top)
    is_top = (outside > 0) & ~is_floor & ~is_mouth & ~is_hole
    outside_on_cloth = distance_outside_table(table, cloth)
    _, cloth_hole, _ = pocket_regions(table, cloth)
    is_hole = ~is_floor & ~is_top & (is_hole | cloth_hole)
    is_face = ~is_floor & ~is_top & ~is_hole & ~is_mouth & (outside_on_cloth > 0)
    point = np.where(is_top[:, None], top, cloth)
    point = np.where(
        is_face[:, None],
        np.column_stack(
            [np.clip(cloth[:, 0], 0, table.length), np.clip(cloth[:, 1], 0, table.width), np.full(len(cloth), nose / 2)]
        ),
        point,
    )
    floor = intersect_plane(eye, rays, -FLOOR_DEPTH)
    point = np.where(is_floor[:, None], floor, point)
    colour = cloth_colour(table, appearance, point, tiles)
    colour[is_face] *= 0.55
    normal = np.zeros_like(point)
    normal[:, 2] = 1
    open_share = 1 - 0.40 * np.exp(np.minimum(outside_on_cloth, 0) / 0.018)
    is_rail = is_top & (outside > CUSHION_WIDTH)
    is_cushion = is_top & ~is_rail
    open_share[is_top] = 1
    open_share[is_cushion] = 0.92
    tilt_cushion_normals(table, point, normal, is_cushion)
    colour[is_rail] = rail_colour(table, appearance, point[is_rail], tiles)
    colour[is_top & is_rim] = srgb_to_linear((0.10, 0.09, 0.08))
    colour[is_hole] = 0.004
    colour[is_floor] = floor_colour(appearance, point[is_floor], distance_outside_table(table, point[is_floor]), tiles)
    open_share[is_floor] = 0.8
    height = apron_height(table, eye, rays)
    is_apron = is_floor & (height > -APRON_HEIGHT)
    colour[is_apron] = srgb_to_linear(appearance.rail) * (0.35 + 1.2 * (height[is_apron] + APRON_HEIGHT))[:, None]
    return RayHits(
        point.astype(np.float32),
        normal.astype(np.float32),
        colour.astype(np.float32),
        open_share.astype(np.float32),
        is_hole,
    )


def intersect_plane(eye: FloatArray, rays: FloatArray, z: float) -> FloatArray:
    """Return the points (R, 3) where rays reach height z; far away for rays that do not descend."""
    down = np.minimum(rays[:, 2], -1e-3)
    crossing: FloatArray = eye + rays * ((z - eye[2]) / down)[:, None]
    return crossing


def distance_outside_table(table: Table, point: FloatArray) -> FloatArray:
    """Return the distance of points outside the nose rectangle along the larger axis.

    Args:
        point: (R, 3) m.

    Returns:
        (R,) m, negative inside.
    """
    x = np.abs(point[:, 0] - table.length / 2) - table.length / 2
    y = np.abs(point[:, 1] - table.width / 2) - table.width / 2
    return np.maximum(x, y)


def pocket_regions(table: Table, point: FloatArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Mark the points (R, 3) in a pocket's mouth (without cushion), in its hole, and on its rim."""
    nothing = np.zeros(len(point), bool)
    if not table.pockets:
        return nothing, nothing, nothing
    # fold to one quarter: a from the nearest end, b from the nearest long cushion
    a = table.length / 2 - np.abs(point[:, 0] - table.length / 2)
    b = table.width / 2 - np.abs(point[:, 1] - table.width / 2)
    side = np.abs(point[:, 0] - table.length / 2)
    corner = np.hypot(a + HOLE_BACK_CORNER, b + HOLE_BACK_CORNER)
    middle = np.hypot(side, b + HOLE_BACK_SIDE)
    away = np.minimum(corner, middle)
    back = np.maximum(-np.minimum(a, b), 0)
    # corner mouth: between the two jaws, which run outwards at an angle
    in_corner = (np.abs(a - b) < JAW_CORNER + 0.004) & (np.maximum(a, b) < JAW_CORNER - 0.2 * back) & (back > 0)
    in_side = (side < JAW_SIDE - 0.35 * back) & (b < 0)
    near = back < CUSHION_WIDTH
    return (in_corner | in_side) & near, away < HOLE_RADIUS, away < HOLE_RADIUS + RIM_WIDTH


def tilt_cushion_normals(table: Table, point: FloatArray, normal: FloatArray, cushion: BoolArray) -> None:
    """Tilt the normals of cushion tops by 12 degrees towards the table, in place."""
    lean = np.sin(np.radians(12))
    x, y = point[:, 0], point[:, 1]
    lean_x = np.where(x < 0, lean, np.where(x > table.length, -lean, 0))
    lean_y = np.where(y < 0, lean, np.where(y > table.width, -lean, 0))
    normal[cushion, 0], normal[cushion, 1] = lean_x[cushion], lean_y[cushion]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)


@lru_cache(maxsize=8)
def make_textures(seed: int) -> dict[str, Float32Array]:
    """Make tiles (S, S) of mean 0 and standard deviation 1: fine fibres, broad patches, wood grain."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX)).astype(np.float32)
    tiles = {
        "fibre": cv2.GaussianBlur(white, (0, 0), 1.2),
        "patch": cv2.resize(
            rng.standard_normal((12, 12)).astype(np.float32), (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC
        ),
        "grain": cv2.GaussianBlur(white, (0, 0), sigmaX=60, sigmaY=2.0),
    }
    return {name: ((tile - tile.mean()) / tile.std()).astype(np.float32) for name, tile in tiles.items()}


def sample_texture(tile: Float32Array, u: FloatArray, v: FloatArray) -> Float32Array:
    """Sample a tile at R positions in units of tiles, mirrored at its borders."""
    columns = np.abs(((u + 1) % 2) - 1) * (TEXTURE_PX - 1)
    rows = np.abs(((v + 1) % 2) - 1) * (TEXTURE_PX - 1)
    values: Float32Array = tile[rows.astype(np.int32), columns.astype(np.int32)]
    return values


def cloth_colour(
    table: Table, appearance: SceneAppearance, point: FloatArray, tiles: dict[str, Float32Array]
) -> FloatArray:
    """Compute the linear colour (R, 3) of the cloth at points, with wear and the marks of the game."""
    x, y = point[:, 0], point[:, 1]
    wear = 1 + appearance.wear * (
        0.05 * sample_texture(tiles["fibre"], x, y) + 0.025 * sample_texture(tiles["patch"], x / 3, y / 3)
    )
    colour = srgb_to_linear(appearance.cloth)[None, :] * wear[:, None]
    ink, paper = srgb_to_linear((0.85, 0.85, 0.82)), srgb_to_linear((0.05, 0.05, 0.05))
    is_inside = distance_outside_table(table, point) < -0.002
    if appearance.marks == "snooker":
        line = table.length * 0.2065
        d = 0.0821 * table.length
        arc = np.hypot(x - line, y - table.width / 2)
        is_line = (np.abs(x - line) < 0.0022) | ((np.abs(arc - d) < 0.0022) & (x < line))
        colour[is_inside & is_line] = 0.6 * ink
        spots = [(s * table.length, table.width / 2) for s in (0.5, 0.75, 0.909)]
    elif appearance.marks in ("pool", "carom"):
        spots = [(0.25 * table.length, table.width / 2), (0.75 * table.length, table.width / 2)]
    else:
        spots = []
    for sx, sy in spots:
        colour[is_inside & (np.hypot(x - sx, y - sy) < 0.006)] = 0.5 * ink if appearance.marks == "pool" else paper
    return colour


def rail_colour(
    table: Table, appearance: SceneAppearance, point: FloatArray, tiles: dict[str, Float32Array]
) -> FloatArray:
    """Compute the linear colour (R, 3) of the rails: wood grain along each rail, diamonds at the eighths."""
    x, y = point[:, 0], point[:, 1]
    ends = (x < -CUSHION_WIDTH) | (x > table.length + CUSHION_WIDTH)
    grain = np.where(
        ends, sample_texture(tiles["grain"], y / 1.3, x / 0.9), sample_texture(tiles["grain"], x / 1.3, y / 0.9)
    )
    colour = srgb_to_linear(appearance.rail)[None, :] * (1 + 0.22 * grain)[:, None].clip(0.3, 2)
    step = table.length / 8
    middle = CUSHION_WIDTH + RAIL_WIDTH * 0.45
    for along, across, far in ((x, y, table.width), (y, x, table.length)):
        near = np.abs(along / step - np.round(along / step)) * step
        off = np.minimum(np.abs(across + middle), np.abs(across - far - middle))
        colour[(near + off < 0.011) & (distance_outside_table(table, point) < RAIL_WIDTH)] = srgb_to_linear(
            (0.9, 0.88, 0.8)
        )
    return np.asarray(colour)


def apron_height(table: Table, eye: FloatArray, rays: FloatArray) -> FloatArray:
    """Return the height z (R,) at which rays hit the table's outer sides facing the eye; -inf where they miss."""
    edge = RAIL_WIDTH + CUSHION_WIDTH
    height = np.full(len(rays), -np.inf)
    for axis, size in ((0, table.length), (1, table.width)):
        near = size + edge if eye[axis] > size / 2 else -edge
        slope = np.where(np.abs(rays[:, axis]) < 1e-9, 1e-9, rays[:, axis])
        reach = (near - eye[axis]) / slope
        half = (table.length, table.width)[1 - axis] / 2
        across = np.abs(eye[1 - axis] + reach * rays[:, 1 - axis] - half)
        outside = (eye[axis] - near) * (near - size / 2) > 0
        hit = (reach > 0) & (across <= half + edge) & outside
        height = np.where(hit, eye[2] + reach * rays[:, 2], height)
    height_below_nose: FloatArray = np.where(height < NOSE_HEIGHT_RADII * table.ball_radius, height, -np.inf)
    return height_below_nose


def floor_colour(
    appearance: SceneAppearance, point: FloatArray, away: FloatArray, tiles: dict[str, Float32Array]
) -> FloatArray:
    """Compute the linear colour (R, 3) of the floor, darker near the table."""
    x, y = point[:, 0], point[:, 1]
    base = srgb_to_linear(appearance.floor)[None, :]
    if appearance.floor_kind == "planks":
        plank = np.floor(y / 0.14)
        shift = np.modf(np.sin(plank * 12.9898) * 43758.5453)[0]
        tone = 1 + 0.18 * shift + 0.12 * sample_texture(tiles["grain"], x / 1.5 + shift, y / 1.1)
        tone = np.where(np.abs(y / 0.14 - np.round(y / 0.14)) < 0.02, 0.5 * tone, tone)
    else:
        tone = (
            1
            + 0.12 * sample_texture(tiles["patch"], x / 5, y / 5)
            + 0.10 * sample_texture(tiles["fibre"], x * 0.6, y * 0.6)
        )
    lit = 0.20 + 0.80 * np.clip((away + 0.2) / 0.8, 0, 1)
    return np.asarray(base * (np.clip(tone, 0.1, 2) * lit)[:, None])
