"""Random halls for training pictures: a table, its colours and lamps, a set of balls, a camera close to some of it.

A band of cloth hues, of camera heights and of lamp places, and one set of balls, are kept out of training: pictures
with them tell how well a detector does in a hall that nobody showed it. `HELD_OUT` draws such halls.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import Camera, Table
from models.physics.billiards.tables import PRESETS
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import (
    CAROM_COLOURS,
    POOL_COLOURS,
    SNOOKER_COLOURS,
    BallLook,
    Colour,
    Floor,
    Lamp,
    Look,
    Marks,
    carom_ball,
    pool_ball,
    snooker_ball,
)

HELD_OUT_HUES = (0.72, 0.93)
"""Cloth: violet to purple."""
HELD_OUT_ELEVATION = (38.0, 47.0)
"""Camera over the horizon, degrees."""
HELD_OUT_LAMPS, HELD_OUT_LAMP_HEIGHT = 5, (0.66, 0.82)
"""A row of small lamps, m above the table: more and lower than in training."""
PASTEL_COLOURS: tuple[Colour, ...] = (
    (0.95, 0.86, 0.45), (0.35, 0.62, 0.85), (0.93, 0.45, 0.50), (0.75, 0.52, 0.85), (0.98, 0.66, 0.42),
    (0.42, 0.78, 0.58), (0.62, 0.40, 0.32), (0.10, 0.10, 0.11),
)  # fmt: skip
"""The held-out set of pool balls."""
LOW_ELEVATION, OVERHEAD_ELEVATION = (17.0, 30.0), (75.0, 89.7)
"""Cameras that films take most; any between them too."""
LOW_SHARE, OVERHEAD_SHARE = 0.25, 0.35
DARK_SHARE, DARKENED = 0.12, (0.25, 0.7)
"""Share of the balls, white ones apart, that reflect only so much of their colour's light."""
NEAREST_M, FARTHEST_M = 1.6, 7.0
"""From the camera to the middle of what it sees."""
LEAST_RADIUS_PX, MOST_RADIUS_PX = 3.7, 12.5
"""Of a ball in the middle of the picture, at the scale that the detector works at."""


@dataclass(frozen=True, slots=True)
class Hall:
    """All that stays the same between pictures of one camera."""

    table: Table
    camera: Camera
    look: Look
    balls: tuple[BallLook, ...]


def random_hall(rng: np.random.Generator, size: int, magnify: int = 1, held_out: bool = False) -> Hall:
    """A hall seen in a picture of `size` px a side, balls `magnify` times as large as the detector wants them."""
    table = _table(rng)
    radius = magnify * float(np.exp(rng.uniform(np.log(LEAST_RADIUS_PX), np.log(MOST_RADIUS_PX))))
    camera = _camera(rng, table, radius, size * magnify, held_out)
    return Hall(table, camera, _look(rng, table, held_out), _balls(rng, table, held_out))


def _table(rng: np.random.Generator) -> Table:
    table = list(PRESETS.values())[rng.integers(len(PRESETS))]
    return replace(table, ball_radius=table.ball_radius * rng.uniform(0.93, 1.07))


def _camera(rng: np.random.Generator, table: Table, radius_px: float, size: int, held_out: bool) -> Camera:
    target = np.append(rng.uniform(-0.02, 1.02, 2) * (table.length, table.width), 0.0)
    elevation = np.radians(_elevation(rng, held_out))
    azimuth = rng.uniform(0, 2 * np.pi)
    distance = float(np.exp(rng.uniform(np.log(NEAREST_M), np.log(FARTHEST_M))))
    ahead = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    eye = target + distance * (np.cos(elevation) * ahead + np.sin(elevation) * np.array([0, 0, 1.0]))
    roll = rng.normal(0, 0.04, 3)
    # Seen from nearly above, what is up in the picture lies along the table.
    up = np.array([0.0, 0.0, 1.0]) + roll if np.degrees(elevation) < 70 else -ahead + roll
    focal = radius_px * distance / table.ball_radius
    return look_at(table, eye, target, focal, size, size, (float(up[0]), float(up[1]), float(up[2])))


def _elevation(rng: np.random.Generator, held_out: bool) -> float:
    """Degrees over the horizon."""
    if held_out:
        return float(rng.uniform(*HELD_OUT_ELEVATION))
    while True:
        chance = rng.random()
        if chance < OVERHEAD_SHARE:
            drawn = rng.uniform(*OVERHEAD_ELEVATION)
        elif chance < OVERHEAD_SHARE + LOW_SHARE:
            drawn = rng.uniform(*LOW_ELEVATION)
        else:
            drawn = rng.uniform(LOW_ELEVATION[0], OVERHEAD_ELEVATION[0])
        if not HELD_OUT_ELEVATION[0] < drawn < HELD_OUT_ELEVATION[1]:
            return float(drawn)


def random_colour(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> Colour:
    """A colour of any hue."""
    return colorsys.hsv_to_rgb(float(rng.random()), float(rng.uniform(*saturation)), float(rng.uniform(*value)))


def _cloth(rng: np.random.Generator, held_out: bool) -> Colour:
    """Mostly green and blue, as cloths are; any other hue and grey too."""
    if held_out:
        hue = rng.uniform(*HELD_OUT_HUES)
    elif rng.random() < 0.6:
        hue = np.clip(rng.choice([0.36, 0.42, 0.53, 0.57, 0.60]) + rng.normal(0, 0.03), 0, HELD_OUT_HUES[0])
    else:
        hue = (HELD_OUT_HUES[1] + rng.random() * (1 - HELD_OUT_HUES[1] + HELD_OUT_HUES[0])) % 1
    saturation = rng.uniform(0.0, 0.4) if rng.random() < 0.12 else rng.uniform(0.35, 0.95)
    return colorsys.hsv_to_rgb(float(hue), float(saturation), float(rng.uniform(0.18, 0.85)))


def _lamps(rng: np.random.Generator, table: Table, held_out: bool) -> tuple[Lamp, ...]:
    if held_out:
        height = float(rng.uniform(*HELD_OUT_LAMP_HEIGHT))
        places = (np.arange(HELD_OUT_LAMPS) + 0.5) / HELD_OUT_LAMPS * table.length
        return tuple(Lamp((float(x), table.width / 2, height), 0.09, 1.0) for x in places)
    count = int(rng.integers(1, 4))
    reach = rng.choice([0.3, 1.5])  # over the table, or anywhere in the hall
    low, high = 0.5 - 0.5 * reach, 0.5 + 0.5 * reach
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


def _look(rng: np.random.Generator, table: Table, held_out: bool) -> Look:
    wood = random_colour(rng, (0.0, 0.8), (0.03, 0.9)) if rng.random() < 0.4 else _brown(rng)
    floors: tuple[Floor, ...] = ("carpet", "planks", "dark")
    marks: tuple[Marks, ...] = ("none", "pool", "snooker", "carom")
    return Look(
        cloth=_cloth(rng, held_out),
        rail=wood,
        floor=random_colour(rng, (0.0, 0.5), (0.02, 0.8)),
        floor_kind=floors[rng.integers(len(floors))],
        marks=marks[rng.integers(len(marks))],
        lamps=_lamps(rng, table, held_out),
        ambient=float(rng.uniform(0.12, 0.8)),
        brightness=float(np.exp(rng.normal(0.0, 0.35))),
        gloss=float(rng.uniform(0.0, 1.5)),
        wear=float(rng.uniform(0.2, 3.0)),
        blur_px=float(rng.uniform(0.35, 1.3)),
        noise=float(rng.choice([0.7, 2.0, 5.0])) * float(rng.uniform(0.4, 1.6)),
        seed=int(rng.integers(8)),
    )


def _brown(rng: np.random.Generator) -> Colour:
    return colorsys.hsv_to_rgb(
        float(rng.uniform(0.02, 0.1)), float(rng.uniform(0.3, 0.9)), float(rng.uniform(0.08, 0.7))
    )


def _balls(rng: np.random.Generator, table: Table, held_out: bool) -> tuple[BallLook, ...]:
    """The set of the table's game, or sometimes another, each ball's colour a little off."""
    if held_out:
        looks = [_recoloured(pool_ball(n), PASTEL_COLOURS[(n - 1) % 8]) if n else pool_ball(0) for n in range(16)]
    else:
        looks = _set(rng, table.game if rng.random() < 0.7 else str(rng.choice(["pool", "snooker", "carom", "free"])))
    return tuple(_recoloured(ball, _jittered(rng, _darkened(rng, ball))) for ball in looks)


def _set(rng: np.random.Generator, game: str) -> list[BallLook]:
    if game == "pool":
        return [pool_ball(number) for number in range(16)]
    if game == "snooker":
        return [snooker_ball(kind) for kind in SNOOKER_COLOURS] + [snooker_ball("red")] * 6
    if game == "carom":
        plain = [_recoloured(BallLook(kind, colour), colour) for kind, colour in CAROM_COLOURS.items()]
        return plain if rng.random() < 0.5 else [carom_ball(kind) for kind in CAROM_COLOURS]
    free = [
        BallLook("solid", random_colour(rng, (0.0, 1.0), (0.05, 1.0)), "solid", int(rng.integers(1, 8)))
        for _ in range(6)
    ]
    striped = [
        BallLook("stripe", random_colour(rng, (0.3, 1.0), (0.1, 1.0)), "stripe", int(rng.integers(9, 16)))
        for _ in range(4)
    ]
    return [BallLook("cue", (0.95, 0.94, 0.90)), BallLook("eight", POOL_COLOURS[7], "solid", 8), *free, *striped]


def _recoloured(ball: BallLook, colour: Colour) -> BallLook:
    return replace(ball, colour=colour)


def _darkened(rng: np.random.Generator, ball: BallLook) -> Colour:
    """The ball's colour, sometimes as dark as lamps leave it at the far end of a hall."""
    share = rng.uniform(*DARKENED) if rng.random() < DARK_SHARE and ball.kind not in ("cue", "white") else 1.0
    red, green, blue = ball.colour
    return share * red, share * green, share * blue


def _jittered(rng: np.random.Generator, colour: Colour) -> Colour:
    red, green, blue = np.clip(np.array(colour) * rng.uniform(0.85, 1.1) + rng.normal(0, 0.03, 3), 0.01, 1.0)
    return float(red), float(green), float(blue)
