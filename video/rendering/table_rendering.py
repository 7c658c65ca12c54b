"""The empty table in its room: cloth, cushions, rails, pockets and floor, met by one ray per sample.

The scene is a few level planes: cushion tops and rails at the height of the noses, the cloth at 0, the floor. A ray
that misses the nose rectangle on the way to the cloth ends on a cushion's face.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table
from models.core.typing import BoolArray, Float32Array, FloatArray
from video.rendering.ball_shading import Light, irradiance, linear, singles
from video.rendering.pinhole_camera import Lens, rays_of
from video.rendering.scene_appearance import Look

CUSHION_WIDTH, RAIL_WIDTH = 0.050, 0.125
"""m: cloth-covered top of the cushion, and wood behind it."""
FLOOR_DEPTH, APRON = 0.80, 0.16
"""m below the cloth: the floor; the lower edge of the wood around the table."""
HOLE_RADIUS, HOLE_BACK_CORNER, HOLE_BACK_SIDE = 0.060, 0.020, 0.042
"""m: radius of a pocket's hole, and how far its middle lies behind the noses (corner: along both axes)."""
RIM = 0.012
"""m of leather around a hole."""
JAW_CORNER, JAW_SIDE, JAW_TAPER = 0.080, 0.064, 0.75
"""m from a pocket along the rail where the nose begins; how fast the mouth narrows backwards."""
TEXTURE = 1024
"""px of a square texture tile."""


@dataclass(frozen=True, slots=True)
class EmptyTable:
    """The still part of a scene, per pixel (H, W)."""

    picture: Float32Array
    """(H, W, 3) linear."""
    rays: Float32Array
    """(H, W, 3) unit vectors from the eye."""
    depth: Float32Array
    """(H, W) m from the eye; far in the holes."""
    point: Float32Array
    """(H, W, 3) m, what the pixel's middle sees."""
    share: Float32Array
    """(H, W, L + 1) share of its light from each lamp and from everywhere."""


@dataclass(frozen=True, slots=True)
class Hits:
    """What R rays meet: places, unit normals, linear colours, share of the ambient light let through."""

    point: Float32Array
    normal: Float32Array
    colour: Float32Array
    open: Float32Array
    hole: BoolArray


def make_light(table: Table, look: Look) -> Light:
    """Lamps scaled to light a level paper at the table's centre with 1 in all."""
    position = np.array([lamp.position for lamp in look.lamps])
    way = position - np.array([table.length / 2, table.width / 2, 0.0])
    distance = np.linalg.norm(way, axis=1)
    strength = np.array([lamp.strength for lamp in look.lamps])
    received = strength * way[:, 2] / distance
    strength = strength * (1 - look.ambient) / received.sum()
    radius = np.array([lamp.radius for lamp in look.lamps])
    return Light(position, radius, strength, distance, look.ambient, linear(look.cloth))


def make_empty_table(table: Table, camera: Camera, lens: Lens, look: Look, light: Light, samples: int) -> EmptyTable:
    """Render the table without balls, `samples` squared rays a pixel."""
    tiles = textures(look.seed)
    height, width = camera.height_px, camera.width_px
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    picture = np.zeros((height, width, 3), np.float32)
    offsets = (np.arange(samples) - (samples - 1) / 2) / samples
    for dy in offsets:
        for dx in offsets:
            rays = rays_of(camera, lens, np.stack([columns + dx, rows + dy], axis=-1))
            hits = meet(table, look, camera.eye, rays.reshape(-1, 3), tiles)
            picture += shade(light, hits)[0].reshape(picture.shape) / samples**2
    rays = rays_of(camera, lens, np.stack([columns, rows], axis=-1))
    hits = meet(table, look, camera.eye, rays.reshape(-1, 3), tiles)
    depth = singles(np.linalg.norm(hits.point - camera.eye, axis=1))
    depth[hits.hole] = 1e3
    share = shade(light, hits)[1].reshape(height, width, -1)
    shape = (height, width)
    point = hits.point.reshape(*shape, 3)
    return EmptyTable(picture, singles(rays), depth.reshape(shape), point, share)


def shade(light: Light, hits: Hits) -> tuple[Float32Array, Float32Array]:
    """Linear colour (R, 3) of what rays met, and the share (R, L + 1) of its light by source."""
    parts = [irradiance(light, lamp, hits.point, hits.normal) * hits.open for lamp in range(len(light.radius))]
    parts.append(np.full(len(hits.open), light.ambient, np.float32) * hits.open)
    received = np.stack(parts, axis=-1)
    total = received.sum(axis=-1, keepdims=True)
    return hits.colour * total, received / np.maximum(total, 1e-6)


def meet(table: Table, look: Look, eye: FloatArray, rays: FloatArray, tiles: dict[str, Float32Array]) -> Hits:
    """What rays (R, 3) meet."""
    nose = NOSE_HEIGHT_RADII * table.ball_radius
    top = plane(eye, rays, nose)
    cloth = plane(eye, rays, 0.0)
    outside = off_table(table, top)
    over = outside > RAIL_WIDTH + CUSHION_WIDTH
    mouth, hole, rim = pocket_regions(table, top)
    above = (outside > 0) & ~over & ~mouth & ~hole
    below = off_table(table, cloth)
    _, cloth_hole, _ = pocket_regions(table, cloth)
    hole = ~over & ~above & (hole | cloth_hole)
    face = ~over & ~above & ~hole & ~mouth & (below > 0)
    point = np.where(above[:, None], top, cloth)
    point = np.where(
        face[:, None],
        np.column_stack(
            [np.clip(cloth[:, 0], 0, table.length), np.clip(cloth[:, 1], 0, table.width), np.full(len(cloth), nose / 2)]
        ),
        point,
    )
    floor = plane(eye, rays, -FLOOR_DEPTH)
    point = np.where(over[:, None], floor, point)
    colour = cloth_colour(table, look, point, tiles)
    colour[face] *= 0.55
    normal = np.zeros_like(point)
    normal[:, 2] = 1
    light_open = 1 - 0.40 * np.exp(np.minimum(below, 0) / 0.018)
    rail = above & (outside > CUSHION_WIDTH)
    cushion = above & ~rail
    light_open[above] = 1
    light_open[cushion] = 0.92
    tilt(table, point, normal, cushion)
    colour[rail] = rail_colour(table, look, point[rail], tiles)
    colour[above & rim] = linear((0.10, 0.09, 0.08))
    colour[hole] = 0.004
    colour[over] = floor_colour(look, point[over], off_table(table, point[over]), tiles)
    light_open[over] = 0.8
    depth = apron_depth(table, eye, rays)
    apron = over & (depth > -APRON)
    colour[apron] = linear(look.rail) * (0.35 + 1.2 * (depth[apron] + APRON))[:, None]
    return Hits(
        point.astype(np.float32),
        normal.astype(np.float32),
        colour.astype(np.float32),
        light_open.astype(np.float32),
        hole,
    )


def plane(eye: FloatArray, rays: FloatArray, z: float) -> FloatArray:
    """Where rays (R, 3) cross height z, (R, 3); far away for rays that never come down."""
    down = np.minimum(rays[:, 2], -1e-3)
    crossing: FloatArray = eye + rays * ((z - eye[2]) / down)[:, None]
    return crossing


def off_table(table: Table, point: FloatArray) -> FloatArray:
    """How far points (R, 3) lie outside the nose rectangle (largest axis), negative inside."""
    x = np.abs(point[:, 0] - table.length / 2) - table.length / 2
    y = np.abs(point[:, 1] - table.width / 2) - table.width / 2
    return np.maximum(x, y)


def pocket_regions(table: Table, point: FloatArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Which points (R, 3) lie in a pocket's mouth (no cushion there), its hole, its rim."""
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
    return (in_corner | in_side) & near, away < HOLE_RADIUS, away < HOLE_RADIUS + RIM


def tilt(table: Table, point: FloatArray, normal: FloatArray, cushion: BoolArray) -> None:
    """Lean the normals of cushion tops by 12 degrees over the table, in place."""
    lean = np.sin(np.radians(12))
    x, y = point[:, 0], point[:, 1]
    lean_x = np.where(x < 0, lean, np.where(x > table.length, -lean, 0))
    lean_y = np.where(y < 0, lean, np.where(y > table.width, -lean, 0))
    normal[cushion, 0], normal[cushion, 1] = lean_x[cushion], lean_y[cushion]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)


@lru_cache(maxsize=8)
def textures(seed: int) -> dict[str, Float32Array]:
    """Tiles (S, S) of mean 0 and deviation 1: fine fibres, broad patches, wood grain."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((TEXTURE, TEXTURE)).astype(np.float32)
    tiles = {
        "fibre": cv2.GaussianBlur(white, (0, 0), 1.2),
        "patch": cv2.resize(
            rng.standard_normal((12, 12)).astype(np.float32), (TEXTURE, TEXTURE), interpolation=cv2.INTER_CUBIC
        ),
        "grain": cv2.GaussianBlur(white, (0, 0), sigmaX=60, sigmaY=2.0),
    }
    return {name: ((tile - tile.mean()) / tile.std()).astype(np.float32) for name, tile in tiles.items()}


def sample(tile: Float32Array, u: FloatArray, v: FloatArray) -> Float32Array:
    """Values (R,) of a tile at R places, in tiles; repeats mirrored."""
    columns = np.abs(((u + 1) % 2) - 1) * (TEXTURE - 1)
    rows = np.abs(((v + 1) % 2) - 1) * (TEXTURE - 1)
    values: Float32Array = tile[rows.astype(np.int32), columns.astype(np.int32)]
    return values


def cloth_colour(table: Table, look: Look, point: FloatArray, tiles: dict[str, Float32Array]) -> FloatArray:
    """Linear colour (R, 3) of the cloth at points, with wear and the marks of the game."""
    x, y = point[:, 0], point[:, 1]
    wear = 1 + look.wear * (0.05 * sample(tiles["fibre"], x, y) + 0.025 * sample(tiles["patch"], x / 3, y / 3))
    colour = linear(look.cloth)[None, :] * wear[:, None]
    ink, paper = linear((0.85, 0.85, 0.82)), linear((0.05, 0.05, 0.05))
    on = off_table(table, point) < -0.002
    if look.marks == "snooker":
        line = table.length * 0.2065
        d = 0.0821 * table.length
        arc = np.hypot(x - line, y - table.width / 2)
        lined = (np.abs(x - line) < 0.0022) | ((np.abs(arc - d) < 0.0022) & (x < line))
        colour[on & lined] = 0.6 * ink
        spots = [(s * table.length, table.width / 2) for s in (0.5, 0.75, 0.909)]
    elif look.marks in ("pool", "carom"):
        spots = [(0.25 * table.length, table.width / 2), (0.75 * table.length, table.width / 2)]
    else:
        spots = []
    for sx, sy in spots:
        colour[on & (np.hypot(x - sx, y - sy) < 0.006)] = 0.5 * ink if look.marks == "pool" else paper
    return colour


def rail_colour(table: Table, look: Look, point: FloatArray, tiles: dict[str, Float32Array]) -> FloatArray:
    """Linear colour (R, 3) of the rails: wood along each rail, diamonds at the eighths."""
    x, y = point[:, 0], point[:, 1]
    ends = (x < -CUSHION_WIDTH) | (x > table.length + CUSHION_WIDTH)
    grain = np.where(ends, sample(tiles["grain"], y / 1.3, x / 0.9), sample(tiles["grain"], x / 1.3, y / 0.9))
    colour = linear(look.rail)[None, :] * (1 + 0.22 * grain)[:, None].clip(0.3, 2)
    step = table.length / 8
    middle = CUSHION_WIDTH + RAIL_WIDTH * 0.45
    for along, across, far in ((x, y, table.width), (y, x, table.length)):
        near = np.abs(along / step - np.round(along / step)) * step
        off = np.minimum(np.abs(across + middle), np.abs(across - far - middle))
        colour[(near + off < 0.011) & (off_table(table, point) < RAIL_WIDTH)] = linear((0.9, 0.88, 0.8))
    return np.asarray(colour)


def apron_depth(table: Table, eye: FloatArray, rays: FloatArray) -> FloatArray:
    """Height z (R,) at which rays meet the table's outer sides that face the eye; -inf where they pass."""
    edge = RAIL_WIDTH + CUSHION_WIDTH
    depth = np.full(len(rays), -np.inf)
    for axis, size in ((0, table.length), (1, table.width)):
        near = size + edge if eye[axis] > size / 2 else -edge
        slope = np.where(np.abs(rays[:, axis]) < 1e-9, 1e-9, rays[:, axis])
        reach = (near - eye[axis]) / slope
        half = (table.length, table.width)[1 - axis] / 2
        across = np.abs(eye[1 - axis] + reach * rays[:, 1 - axis] - half)
        outside = (eye[axis] - near) * (near - size / 2) > 0
        hit = (reach > 0) & (across <= half + edge) & outside
        depth = np.where(hit, eye[2] + reach * rays[:, 2], depth)
    met: FloatArray = np.where(depth < NOSE_HEIGHT_RADII * table.ball_radius, depth, -np.inf)
    return met


def floor_colour(look: Look, point: FloatArray, away: FloatArray, tiles: dict[str, Float32Array]) -> FloatArray:
    """Linear colour (R, 3) of the floor, darker near the table."""
    x, y = point[:, 0], point[:, 1]
    base = linear(look.floor)[None, :]
    if look.floor_kind == "planks":
        plank = np.floor(y / 0.14)
        shift = np.modf(np.sin(plank * 12.9898) * 43758.5453)[0]
        tone = 1 + 0.18 * shift + 0.12 * sample(tiles["grain"], x / 1.5 + shift, y / 1.1)
        tone = np.where(np.abs(y / 0.14 - np.round(y / 0.14)) < 0.02, 0.5 * tone, tone)
    else:
        tone = 1 + 0.12 * sample(tiles["patch"], x / 5, y / 5) + 0.10 * sample(tiles["fibre"], x * 0.6, y * 0.6)
    lit = 0.20 + 0.80 * np.clip((away + 0.2) / 0.8, 0, 1)
    return np.asarray(base * (np.clip(tone, 0.1, 2) * lit)[:, None])
