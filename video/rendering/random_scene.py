"""Random scenes for training images: a table, its colours and lamps, a set of balls, and a camera near part of it.

A band of cloth hues, camera elevations and lamp heights, and one set of balls, are excluded from training. Images with
them form the hold-out set, which measures the performance of a detector in rooms unlike those of its training.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.scene import Camera, Table
from models.core.typing import FloatArray
from models.physics.billiards.tables import TABLE_PRESETS
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import (
    CAROM_COLOURS,
    POOL_COLOURS,
    SNOOKER_COLOURS,
    BallAppearance,
    ClothMarks,
    Colour,
    FloorKind,
    Lamp,
    SceneAppearance,
    carom_ball,
    pool_ball,
    snooker_ball,
)
from video.rendering.scene_renderer import BallPoses

# Cloth hues of hold-out scenes: violet to purple.
HOLD_OUT_HUES = (0.72, 0.93)
# Elevation of the camera above the horizon in hold-out scenes, degrees.
HOLD_OUT_ELEVATION = (38.0, 47.0)
# Number of small lamps in a row, and their height above the table, m: more and lower than in training.
HOLD_OUT_LAMPS, HOLD_OUT_LAMP_HEIGHT = 5, (0.66, 0.82)
# Colours of the hold-out set of pool balls.
PASTEL_COLOURS: tuple[Colour, ...] = (
    (0.95, 0.86, 0.45), (0.35, 0.62, 0.85), (0.93, 0.45, 0.50), (0.75, 0.52, 0.85), (0.98, 0.66, 0.42),
    (0.42, 0.78, 0.58), (0.62, 0.40, 0.32), (0.10, 0.10, 0.11),
)  # fmt: skip
# Degrees; most frequent camera elevations in videos. Intermediate ones occur too.
LOW_ELEVATION, OVERHEAD_ELEVATION = (17.0, 30.0), (75.0, 89.7)
# Shares of scenes with low and with overhead cameras.
LOW_SHARE, OVERHEAD_SHARE = 0.25, 0.35
# Share of darkened balls (never white ones), and the range of the factor on their colour.
DARK_SHARE, DARK_FACTOR_RANGE = 0.12, (0.25, 0.7)
# m: the balls of shorter tables look the same at the scale of the detector.
MIN_LENGTH_M = 1.5
# m, range of distances from the camera to the point it looks at.
MIN_DISTANCE_M, MAX_DISTANCE_M = 1.6, 7.0
# px, range of ball radii in the middle of the image, at the detector's working scale.
MIN_RADIUS_PX, MAX_RADIUS_PX = 3.7, 12.5


@dataclass(frozen=True, slots=True)
class RandomScene:
    """Everything that is constant between the images of one camera."""

    table: Table
    camera: Camera
    appearance: SceneAppearance
    balls: tuple[BallAppearance, ...]


def generate_scene(rng: np.random.Generator, size: int, magnify: int = 1, hold_out: bool = False) -> RandomScene:
    """Generate a random scene.

    Args:
        rng: source of randomness.
        size: px, side of the square image.
        magnify: factor by which balls are larger than the detector needs them.
        hold_out: generate a scene of the kind that is excluded from training.

    Returns:
        Table, camera, appearance and balls.
    """
    table = _sample_table(rng)
    radius = magnify * float(np.exp(rng.uniform(np.log(MIN_RADIUS_PX), np.log(MAX_RADIUS_PX))))
    camera = _sample_camera(rng, table, radius, size * magnify, hold_out)
    return RandomScene(table, camera, _sample_appearance(rng, table, hold_out), _sample_balls(rng, table, hold_out))


def _sample_table(rng: np.random.Generator) -> Table:
    tables = [table for table in TABLE_PRESETS.values() if table.length > MIN_LENGTH_M]
    table = tables[rng.integers(len(tables))]
    return replace(table, ball_radius=table.ball_radius * rng.uniform(0.93, 1.07))


def _sample_camera(rng: np.random.Generator, table: Table, radius_px: float, size: int, hold_out: bool) -> Camera:
    target = np.append(rng.uniform(-0.02, 1.02, 2) * (table.length, table.width), 0.0)
    elevation = np.radians(_sample_elevation(rng, hold_out))
    azimuth = rng.uniform(0, 2 * np.pi)
    distance = float(np.exp(rng.uniform(np.log(MIN_DISTANCE_M), np.log(MAX_DISTANCE_M))))
    horizontal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    eye = target + distance * (np.cos(elevation) * horizontal + np.sin(elevation) * np.array([0, 0, 1.0]))
    roll = rng.normal(0, 0.04, 3)
    # In a view from nearly above, the up direction of the image is along the table.
    up = np.array([0.0, 0.0, 1.0]) + roll if np.degrees(elevation) < 70 else -horizontal + roll
    focal = radius_px * distance / table.ball_radius
    return look_at(table, eye, target, focal, size, size, (float(up[0]), float(up[1]), float(up[2])))


def _sample_elevation(rng: np.random.Generator, hold_out: bool) -> float:
    """Sample the elevation of the camera above the horizon, degrees."""
    if hold_out:
        return float(rng.uniform(*HOLD_OUT_ELEVATION))
    while True:
        chance = rng.random()
        if chance < OVERHEAD_SHARE:
            elevation = rng.uniform(*OVERHEAD_ELEVATION)
        elif chance < OVERHEAD_SHARE + LOW_SHARE:
            elevation = rng.uniform(*LOW_ELEVATION)
        else:
            elevation = rng.uniform(LOW_ELEVATION[0], OVERHEAD_ELEVATION[0])
        if not HOLD_OUT_ELEVATION[0] < elevation < HOLD_OUT_ELEVATION[1]:
            return float(elevation)


def sample_colour(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> Colour:
    """Sample a colour of any hue within ranges of saturation and value."""
    return colorsys.hsv_to_rgb(float(rng.random()), float(rng.uniform(*saturation)), float(rng.uniform(*value)))


def _sample_cloth_colour(rng: np.random.Generator, hold_out: bool) -> Colour:
    """Sample a cloth colour: mostly green and blue, also other hues and grey."""
    if hold_out:
        hue = rng.uniform(*HOLD_OUT_HUES)
    elif rng.random() < 0.6:
        hue = np.clip(rng.choice([0.36, 0.42, 0.53, 0.57, 0.60]) + rng.normal(0, 0.03), 0, HOLD_OUT_HUES[0])
    else:
        hue = (HOLD_OUT_HUES[1] + rng.random() * (1 - HOLD_OUT_HUES[1] + HOLD_OUT_HUES[0])) % 1
    saturation = rng.uniform(0.0, 0.4) if rng.random() < 0.12 else rng.uniform(0.35, 0.95)
    return colorsys.hsv_to_rgb(float(hue), float(saturation), float(rng.uniform(0.18, 0.85)))


def _sample_lamps(rng: np.random.Generator, table: Table, hold_out: bool) -> tuple[Lamp, ...]:
    if hold_out:
        height = float(rng.uniform(*HOLD_OUT_LAMP_HEIGHT))
        positions = (np.arange(HOLD_OUT_LAMPS) + 0.5) / HOLD_OUT_LAMPS * table.length
        return tuple(Lamp((float(x), table.width / 2, height), 0.09, 1.0) for x in positions)
    count = int(rng.integers(1, 4))
    extent = rng.choice([0.3, 1.5])  # over the table, or anywhere in the room
    low, high = 0.5 - 0.5 * extent, 0.5 + 0.5 * extent
    lamps = []
    for _ in range(count):
        x, y = rng.uniform(low, high, 2) * (table.length, table.width)
        lamps.append(
            Lamp(
                (float(x), float(y), float(rng.uniform(0.85, 3.0))),
                float(rng.uniform(0.03, 0.5)),
                float(rng.random()) + 0.2,
            )
        )
    return tuple(lamps)


def _sample_appearance(rng: np.random.Generator, table: Table, hold_out: bool) -> SceneAppearance:
    rail = sample_colour(rng, (0.0, 0.8), (0.03, 0.9)) if rng.random() < 0.4 else _sample_wood_colour(rng)
    floors: tuple[FloorKind, ...] = ("carpet", "planks", "dark")
    marks: tuple[ClothMarks, ...] = ("none", "pool", "snooker", "carom")
    return SceneAppearance(
        cloth=_sample_cloth_colour(rng, hold_out),
        rail=rail,
        floor=sample_colour(rng, (0.0, 0.5), (0.02, 0.8)),
        floor_kind=floors[rng.integers(len(floors))],
        marks=marks[rng.integers(len(marks))],
        lamps=_sample_lamps(rng, table, hold_out),
        ambient=float(rng.uniform(0.12, 0.8)),
        brightness=float(np.exp(rng.normal(0.0, 0.35))),
        gloss=float(rng.uniform(0.0, 1.5)),
        wear=float(rng.uniform(0.2, 3.0)),
        blur_px=float(rng.uniform(0.35, 1.3)),
        noise=float(rng.choice([0.7, 2.0, 5.0])) * float(rng.uniform(0.4, 1.6)),
        seed=int(rng.integers(8)),
    )


def _sample_wood_colour(rng: np.random.Generator) -> Colour:
    return colorsys.hsv_to_rgb(
        float(rng.uniform(0.02, 0.1)), float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.08, 0.7))
    )


def _sample_balls(rng: np.random.Generator, table: Table, hold_out: bool) -> tuple[BallAppearance, ...]:
    """Sample a set of balls, usually of the table's game; each colour is perturbed a little."""
    if hold_out:
        appearances = [
            replace(pool_ball(n), colour=PASTEL_COLOURS[(n - 1) % 8]) if n else pool_ball(0) for n in range(16)
        ]
    else:
        appearances = _choose_ball_set(
            rng, table.game if rng.random() < 0.7 else str(rng.choice(["pool", "snooker", "carom", "free"]))
        )
    return tuple(replace(ball, colour=_vary_colour(rng, ball)) for ball in appearances)


def _choose_ball_set(rng: np.random.Generator, game: str) -> list[BallAppearance]:
    if game == "pool":
        return [pool_ball(number) for number in range(16)]
    if game == "snooker":
        return [snooker_ball(kind) for kind in SNOOKER_COLOURS] + [snooker_ball("red")] * 6
    if game == "carom":
        plain = [BallAppearance(kind, colour) for kind, colour in CAROM_COLOURS.items()]
        return plain if rng.random() < 0.5 else [carom_ball(kind) for kind in CAROM_COLOURS]
    free = [
        BallAppearance("solid", sample_colour(rng, (0.0, 1.0), (0.05, 1.0)), "solid", int(rng.integers(1, 8)))
        for _ in range(6)
    ]
    striped = [
        BallAppearance("stripe", sample_colour(rng, (0.3, 1.0), (0.1, 1.0)), "stripe", int(rng.integers(9, 16)))
        for _ in range(4)
    ]
    return [
        BallAppearance("cue", (0.95, 0.94, 0.90)),
        BallAppearance("eight", POOL_COLOURS[7], "solid", 8),
        *free,
        *striped,
    ]


def _vary_colour(rng: np.random.Generator, ball: BallAppearance) -> Colour:
    """Vary the ball's colour a little; sometimes it is as dark as in dim light at the far end of a room."""
    factor = rng.uniform(*DARK_FACTOR_RANGE) if rng.random() < DARK_SHARE and ball.kind not in ("cue", "white") else 1.0
    varied = factor * np.array(ball.colour) * rng.uniform(0.85, 1.1) + rng.normal(0, 0.03, 3)
    red, green, blue = np.clip(varied, 0.01, 1.0).tolist()
    return red, green, blue


# Largest number of balls in an image.
MAX_BALLS = 22
# Largest displacement during the exposure, in ball radii, and in px at the detector's scale.
MAX_STREAK_RADII, MAX_STREAK_PX = 7.0, 62.0
# Share of images with a triangle of touching balls, and share with moving balls.
RACK_SHARE, MOVING_SHARE = 0.15, 0.6
# Share of balls that touch the previously placed ball, and share on its line of sight: one then covers the other.
TOUCHING_SHARE, COVERED_SHARE = 0.2, 0.2
# Largest distance between the apparent centres of such a pair, along the line of sight and across it, in radii.
MAX_COVERING_RADII, MAX_BESIDE_RADII = 1.9, 1.2
# Mean number of moving balls in an image with motion: far more than in clips, where streaks are too rare to learn.
MEAN_MOVING_BALLS = 3.0
# Share of moving balls that roll; the others slide without rotating.
ROLLING_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class BallArrangement:
    """N balls in one image; the exposure lasts from t = -1/2 to 1/2."""

    look_index: NDArray[np.int64]
    """(N,) index into the scene's ball appearances."""
    position: FloatArray
    """(N, 2) m at mid-exposure."""
    displacement: FloatArray
    """(N, 2) m during the exposure."""
    rotation: FloatArray
    """(N, 3, 3) at mid-exposure."""
    is_rolling: NDArray[np.bool_]
    """(N,) True where the ball rolls."""
    radius: float
    """m."""

    def poses_at(self, t: float) -> BallPoses:
        """Return the poses at a time of the exposure."""
        xyz = np.column_stack([self.position + t * self.displacement, np.full(len(self.position), self.radius)])
        rotation = np.array(
            [
                r if not m or not w.any() else _rolling_rotation(t * w / self.radius) @ r
                for r, w, m in zip(self.rotation, self.displacement, self.is_rolling, strict=True)
            ]
        )
        return BallPoses(xyz, rotation.reshape(-1, 3, 3))


def _rolling_rotation(angle: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of a ball that rolled by (x, y) radii."""
    size = float(np.linalg.norm(angle))
    # wx = -vy / R, wy = vx / R
    x, y, _ = axis = np.array([-angle[1], angle[0], 0.0]) / max(size, 1e-12)
    cross = np.array([[0, 0, y], [0, 0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.cos(size) * np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * np.outer(axis, axis)
    return rotation


def arrange_balls(rng: np.random.Generator, scene: RandomScene, magnify: int = 1) -> BallArrangement:
    """Arrange balls at random on the visible part of the table; some touch, some move.

    Args:
        rng: source of randomness.
        scene: table, camera and balls.
        magnify: factor by which the rendered image is later scaled down.

    Returns:
        The arrangement.
    """
    wanted = int(rng.integers(0, 3)) if rng.random() < 0.15 else int(rng.integers(2, MAX_BALLS))
    start = _place_rack(rng, scene) if rng.random() < RACK_SHARE else np.empty((0, 2))
    positions = _place_balls(rng, scene, start, max(wanted, len(start)))[:MAX_BALLS]
    n = len(positions)
    moving_share = MEAN_MOVING_BALLS / max(n, 1) if rng.random() < MOVING_SHARE else 0.0
    moving = np.flatnonzero(rng.random(n) < moving_share)
    displacement = np.zeros((n, 2))
    for ball in moving:
        displacement[ball] = _sample_displacement(rng, scene, positions[ball], magnify)
    rotation = np.array([_sample_rotation(rng) for _ in range(n)]).reshape(-1, 3, 3)
    return BallArrangement(
        rng.integers(0, len(scene.balls), n),
        positions,
        displacement,
        rotation,
        rng.random(n) < ROLLING_SHARE,
        scene.table.ball_radius,
    )


def _sample_visible_positions(rng: np.random.Generator, scene: RandomScene, count: int) -> FloatArray:
    """Sample positions (n, 2) m on the table whose ball is visible, up to half a radius beyond the image border."""
    camera, table = scene.camera, scene.table
    r = table.ball_radius
    px = rng.uniform(-0.03, 1.03, (count, 2)) * (camera.width_px, camera.height_px)
    xy = camera.to_table(px, r)
    inside = (xy >= r).all(axis=1) & (xy[:, 0] <= table.length - r) & (xy[:, 1] <= table.width - r)
    # Rays near the horizon intersect the plane behind the camera.
    ahead = (np.column_stack([xy, np.full(count, r), np.ones(count)]) @ scene.camera.matrix[2]) > 0
    return np.asarray(xy[inside & ahead])


def _place_balls(rng: np.random.Generator, scene: RandomScene, start: FloatArray, wanted: int) -> FloatArray:
    """Return positions (n, 2) m, `start` first, of balls that do not overlap."""
    radius = scene.table.ball_radius
    positions = list(start)
    for candidate in _sample_visible_positions(rng, scene, 12 * wanted + 20):
        if len(positions) >= wanted:
            break
        position = candidate
        chance = rng.random() if positions else 1.0
        if chance < TOUCHING_SHARE:
            angle = rng.uniform(0, 2 * np.pi)
            position = positions[-1] + 2.003 * radius * np.array([np.cos(angle), np.sin(angle)])
        elif chance < TOUCHING_SHARE + COVERED_SHARE:
            position = _sample_position_in_sight_line(rng, scene, positions[-1])
        if _is_free(position, positions, radius) and _is_on_table(scene, position):
            positions.append(position)
    return np.array(positions).reshape(-1, 2)


def _sample_position_in_sight_line(rng: np.random.Generator, scene: RandomScene, other: FloatArray) -> FloatArray:
    """Sample a position (2,) m on the line of sight to another ball; lower cameras give larger distances."""
    radius = scene.table.ball_radius
    sight = np.append(other, radius) - scene.camera.position
    away = sight[:2] / max(float(np.linalg.norm(sight[:2])), 1e-9)
    across = np.array([-away[1], away[0]])
    farthest = MAX_COVERING_RADII * float(np.linalg.norm(sight)) / max(-float(sight[2]), radius)
    ahead = rng.uniform(2.003, max(farthest, 2.1)) * float(rng.choice([-1.0, 1.0]))
    return np.asarray(other + radius * (ahead * away + rng.uniform(-MAX_BESIDE_RADII, MAX_BESIDE_RADII) * across))


def _is_free(position: FloatArray, positions: list[FloatArray], radius: float) -> bool:
    return not positions or bool((np.linalg.norm(np.array(positions) - position, axis=1) >= 2 * radius).all())


def _is_on_table(scene: RandomScene, position: FloatArray) -> bool:
    r, table = scene.table.ball_radius, scene.table
    inside = bool(
        (position >= 0.99 * r).all()
        and position[0] <= table.length - 0.99 * r
        and position[1] <= table.width - 0.99 * r
    )
    clear = not len(table.pocket_centres) or np.linalg.norm(table.pocket_centres - position, axis=1).min() > 1.5 * r
    return inside and bool(clear)


def _place_rack(rng: np.random.Generator, scene: RandomScene) -> FloatArray:
    """Place a triangle of touching balls; return the positions (n, 2) m that are on the table."""
    apexes = _sample_visible_positions(rng, scene, 8)
    if not len(apexes):
        return np.empty((0, 2))
    step, turn = 2.002 * scene.table.ball_radius, rng.uniform(0, 2 * np.pi)
    rows = int(rng.integers(2, 6))
    local = np.array(
        [[row * step * np.sqrt(0.75), (i - row / 2) * step] for row in range(rows) for i in range(row + 1)]
    )
    cos, sin = np.cos(turn), np.sin(turn)
    positions = apexes[0] + local @ np.array([[cos, sin], [-sin, cos]])
    return np.asarray(positions[[_is_on_table(scene, position) for position in positions]], dtype=np.float64)


def _sample_displacement(
    rng: np.random.Generator, scene: RandomScene, position: FloatArray, magnify: int
) -> FloatArray:
    """Sample a displacement (2,) m during the exposure; short ones are more frequent."""
    radius_px = float(scene.camera.radius_px(position, scene.table.ball_radius))
    longest = min(MAX_STREAK_RADII * radius_px, MAX_STREAK_PX * magnify)
    px = longest * rng.random() ** 1.5
    angle = rng.uniform(0, 2 * np.pi)
    heading = np.array([np.cos(angle), np.sin(angle)])
    jacobian = np.linalg.inv(scene.camera.metres_per_pixel(position, scene.table.ball_radius))
    return np.asarray(heading * px / max(float(np.linalg.norm(jacobian @ heading)), 1e-9))


def _sample_rotation(rng: np.random.Generator) -> FloatArray:
    """Sample a uniform rotation (3, 3): QR of a normal matrix with determinant 1."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))
