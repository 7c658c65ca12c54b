"""The sample clips: tables, cameras, appearance, and the shots played on them."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.core.scene import Camera, Table
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import BallAppearance, Lamp, SceneAppearance, carom_ball, pool_ball, snooker_ball

# Plain physics: sliding, then rolling; no friction between balls; little friction at cushions.
PLAIN_EFFECTS = {
    "sliding_friction": {"mu": 0.2},
    "rolling_resistance": {"mu": 0.01},
    "spin_decay": {"rate": 10.0},
    "cushion_restitution": {"e": 0.85},
    "cushion_friction": {"mu": 0.05},
    "ball_restitution": {"e": 0.95},
}
# Contact laws of plain physics.
PLAIN_LAWS = {"cushion": "mirror", "ball": "inelastic"}
# Physics with friction between balls and restitution that falls with speed.
FOREIGN_EFFECTS = {
    "sliding_friction": {"mu": 0.21},
    "rolling_resistance": {"mu": 0.009},
    "spin_decay": {"rate": 10.0},
    "cushion_restitution": {"e": 0.97},
    "cushion_restitution_speed": {"slope": 0.04},
    "cushion_friction": {"mu": 0.16},
    "ball_restitution": {"e": 0.94},
}
# Contact laws that differ from those of plain physics.
FOREIGN_LAWS = {"cushion": "mathavan_2010", "ball": "alciatore"}


@dataclass(frozen=True, slots=True)
class Ball:
    """A ball of a shot and its position before the strike."""

    id: str
    appearance: BallAppearance
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class Sample:
    """One clip: the shot, and how it is filmed."""

    name: str
    about: str
    table: Table
    camera: Camera
    appearance: SceneAppearance
    balls: tuple[Ball, ...]
    """The first one is struck."""
    velocity: tuple[float, float]
    """m/s after the strike."""
    spin: tuple[float, float, float]
    """rad/s after the strike."""
    foreign: bool
    rate: Fraction
    seconds: float
    strike_at: float = 0.45
    """s after the first frame."""
    exposure: float = 1 / 120
    readout: float = 0.0
    k1: float = 0.0
    player: bool = False
    irregular: bool = False
    """Frame times jitter and frames are missing, as with phones."""
    scoreboard: tuple[str, ...] = ()
    crf: int = 21
    """x264's constant rate factor: larger is smaller and worse."""
    seed: int = 0


POOL_9FT = Table("pool-9ft", "pool", 2.54, 1.27, 0.028575, 0.170, True)
POOL_8FT = Table("pool-8ft", "pool", 2.34, 1.17, 0.028575, 0.170, True)
POOL_7FT = Table("pool-7ft", "pool", 1.98, 0.99, 0.028575, 0.170, True)
CAROM = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.210, False)
SNOOKER = Table("snooker-12ft", "snooker", 3.569, 1.778, 0.02625, 0.142, True)


def make_overhead_camera(
    table: Table, width_px: int, height_px: int, share: float, offset: tuple[float, float] = (0, 0)
) -> Camera:
    """Make a camera above the centre (moved by `offset` m); the noses fill `share` of the image width."""
    eye = np.array([table.length / 2 + offset[0], table.width / 2 + offset[1], 1.45 * table.length])
    target = np.array([table.length / 2, table.width / 2, 0.0])
    focal = share * width_px / table.length * eye[2]
    return look_at(table, eye, target, focal, width_px, height_px, up=(0.0, -1.0, 0.0))


def make_lamp_row(table: Table, count: int, height: float, radius: float, aside: float = 0.0) -> tuple[Lamp, ...]:
    """Make `count` lamps in a row along the table."""
    return tuple(
        Lamp((table.length * (k + 0.5) / count, table.width / 2 + aside, height), radius) for k in range(count)
    )


def pool_balls(*places: tuple[int, float, float]) -> tuple[Ball, ...]:
    """Make pool balls by number."""
    return tuple(Ball(f"{look.kind}-{number}" if look.kind in ("solid", "stripe") else look.kind, look, x, y)
                 for number, x, y in places for look in (pool_ball(number),))  # fmt: skip


def snooker_balls(*places: tuple[str, float, float]) -> tuple[Ball, ...]:
    """Make snooker balls by colour; reds get numbers."""
    reds = iter(range(1, 16))
    return tuple(
        Ball(f"red-{next(reds)}" if kind == "red" else kind, snooker_ball(kind), x, y) for kind, x, y in places
    )


SAMPLES: tuple[Sample, ...] = (
    Sample(
        "overhead_pool", "9 ft pool from above at 30 fps, a player strikes", POOL_9FT,
        make_overhead_camera(POOL_9FT, 1280, 720, 0.80, (0.03, 0.02)),
        SceneAppearance(cloth=(0.13, 0.47, 0.68), brightness=1.35, lamps=make_lamp_row(POOL_9FT, 3, 1.3, 0.16), seed=1),
        pool_balls((0, 0.62, 0.52), (3, 1.42, 0.74), (11, 1.93, 0.38), (5, 2.2, 0.93), (8, 0.95, 1.02),
                   (14, 1.2, 0.25)),
        (2.571, 0.706), (0.0, 0.0, 0.0), False, Fraction(30), 3.7, k1=0.002, player=True, seed=11,
    ),
    Sample(
        "oblique_pool", "9 ft pool from its end at 60 fps, foreign law", POOL_9FT,
        look_at(POOL_9FT, np.array([3.85, 0.66, 1.75]), np.array([1.42, 0.635, 0.0]), 1010.0, 1280, 720),
        SceneAppearance(cloth=(0.10, 0.50, 0.27), rail=(0.36, 0.22, 0.11), floor=(0.16, 0.16, 0.18), brightness=1.3,
                        lamps=make_lamp_row(POOL_9FT, 2, 1.15, 0.2), noise=1.4, seed=2),
        pool_balls((0, 0.75, 0.72), (1, 1.3, 0.5), (10, 1.75, 0.85), (4, 2.05, 0.4), (8, 1.0, 0.22), (13, 2.3, 1.0),
                   (7, 0.4, 0.95)),
        (2.383, -0.818), (10.0, 29.0, 5.0), True, Fraction(60), 3.0, exposure=1 / 160, k1=0.002, seed=12,
        strike_at=0.3,
    ),
    Sample(
        "carom_match", "three balls from above at 29.97 fps, scoreboard, foreign law", CAROM,
        make_overhead_camera(CAROM, 960, 540, 0.79, (-0.02, 0.03)),
        SceneAppearance(cloth=(0.12, 0.27, 0.78), rail=(0.16, 0.16, 0.17), floor=(0.70, 0.58, 0.38),
                        floor_kind="planks", marks="carom", brightness=1.3,
                        lamps=make_lamp_row(CAROM, 4, 1.2, 0.12), noise=1.6, seed=3),
        (Ball("white", carom_ball("white"), 0.9, 0.45), Ball("yellow", carom_ball("yellow"), 2.1, 0.95),
         Ball("red", carom_ball("red"), 1.9, 0.4)),
        (2.623, 1.199), (-6.1, 13.3, 52.5), True, Fraction(30000, 1001), 5.0, player=True, k1=-0.002, seed=13,
        scoreboard=("HOME  LEGRAND   12", "GUEST KOVACS     9"),
    ),
    Sample(
        "snooker_reds", "a 12 ft snooker table from its side at 25 fps", SNOOKER,
        look_at(SNOOKER, np.array([1.83, 3.9, 3.3]), np.array([1.7845, 0.97, 0.0]), 1275.0, 1280, 720),
        SceneAppearance(cloth=(0.10, 0.44, 0.22), rail=(0.33, 0.15, 0.09), floor=(0.30, 0.09, 0.10), marks="snooker",
                        brightness=1.35, lamps=make_lamp_row(SNOOKER, 3, 1.1, 0.22), seed=4),
        snooker_balls(("cue", 0.9, 0.75), ("red", 2.5, 0.95), ("red", 2.62, 0.80), ("red", 2.95, 1.2),
                      ("red", 2.68, 1.02), ("brown", 0.737, 0.889), ("green", 0.737, 1.18), ("yellow", 0.737, 0.597),
                      ("blue", 1.7845, 0.889), ("pink", 2.677, 0.889), ("black", 3.24, 0.889)),
        (2.606, 0.065), (0.0, 0.0, 0.0), False, Fraction(25), 4.6, exposure=1 / 100, k1=0.001, seed=14,
    ),
    Sample(
        "potted_phone", "8 ft pool from above by a phone of variable rate, a ball is potted, foreign law", POOL_8FT,
        make_overhead_camera(POOL_8FT, 960, 540, 0.77, (0.06, -0.05)),
        SceneAppearance(cloth=(0.55, 0.10, 0.14), rail=(0.20, 0.12, 0.08), floor=(0.32, 0.31, 0.30), brightness=1.4,
                        lamps=(Lamp((0.5, 0.2, 1.7), 0.10), Lamp((1.9, 0.9, 1.7), 0.10)), ambient=0.45, noise=1.8,
                        vignette=0.2, seed=5),
        pool_balls((0, 0.8, 0.62), (9, 1.85, 0.92), (2, 1.4, 0.3), (7, 2.0, 0.35), (12, 0.5, 0.95)),
        (2.304, 0.639), (6.5, -23.4, 4.9), True, Fraction(30), 3.4, exposure=1 / 90, readout=0.004, k1=0.002,
        player=True, irregular=True, seed=15,
    ),
    Sample(
        "many_contacts", "a bar table seen askew from its side at 30 fps, four contacts and five cushions", POOL_7FT,
        look_at(POOL_7FT, np.array([0.75, 2.35, 1.95]), np.array([1.0, 0.52, 0.0]), 1105.0, 1280, 720),
        SceneAppearance(cloth=(0.30, 0.33, 0.36), rail=(0.42, 0.28, 0.16), floor=(0.24, 0.20, 0.17),
                        floor_kind="planks", brightness=1.35, lamps=make_lamp_row(POOL_7FT, 2, 1.2, 0.14), seed=6),
        pool_balls((0, 0.55, 0.4), (1, 1.3, 0.55), (2, 1.42, 0.62), (15, 1.4, 0.45), (8, 1.75, 0.75), (10, 1.8, 0.27),
                   (6, 0.8, 0.8)),
        (2.946, 0.249), (0.0, 0.0, 0.0), False, Fraction(30), 3.6, exposure=1 / 110, k1=0.001, seed=16,
    ),
)  # fmt: skip
