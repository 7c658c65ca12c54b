"""Throw a ball into a wall of 5 x 10 boxes (Chen 2022, section 3.2), simulated by pymunk, an independent engine.

    python worlds/boxes.py OUT [--speed 800] [--hz 60] [--seconds 2.5] [--seed 0]

writes the track folder OUT: tracks.csv (shot,frame,t,id,x,y: the centre of the ball and the four corners of every box,
px, y down) and scene.json (units, rate and options). Frame 0 is the moment of the throw.

The thesis leaves these values open: five columns of ten boxes of 24 x 30 px and mass 1 on a floor at y = 330, a ball
of radius 15 and mass 8 at (0, 165), walls at x = -60 and 640, friction 0.5, restitution 0.3. The seed moves every
column by up to 2 px, the ball by up to 10 px, and turns the throw by up to 0.05 rad.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymunk
from filming import write_track_folder
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROWS, COLUMNS = 10, 5
# Size of a box, px.
WIDE, TALL = 24.0, 30.0
# Centre of the first column, and distance between columns, px.
FIRST_COLUMN, PITCH = 200.0, 40.0
# Positions of the boundary, px.
FLOOR, LEFT, RIGHT, TOP = 330.0, -60.0, 640.0, -400.0
BALL = (0.0, 165.0)
BALL_RADIUS, BALL_MASS = 15.0, 8.0
FRICTION, RESTITUTION = 0.5, 0.3
# Steps of the engine: a multiple of 60, 30 and 15 Hz; at 1600 px/s a body moves 0.7 px in one.
STEPS_PER_SECOND = 2400
# Iterations of the engine's solver; with fewer, a column of ten boxes sinks together.
ITERATIONS = 30
# Overlap that the engine allows, px; its default of 0.1 would be visible.
SLOP = 0.01
# Time that the wall stands before the throw, s.
SETTLING = 0.5
# px/s^2, downwards.
GRAVITY = 981.0


@dataclass(frozen=True)
class Throw:
    """Options of a scene."""

    speed: float = 800.0
    """px/s"""
    hz: float = 60.0
    seconds: float = 2.5
    seed: int = 0


def add_boundary(space: pymunk.Space) -> None:
    """Add floor, walls and ceiling, thick enough that nothing passes."""
    thick = 50.0
    for a, b in (
        ((LEFT - 500, FLOOR + thick), (RIGHT + 500, FLOOR + thick)),
        ((LEFT - thick, TOP - 500), (LEFT - thick, FLOOR + 500)),
        ((RIGHT + thick, TOP - 500), (RIGHT + thick, FLOOR + 500)),
        ((LEFT - 500, TOP - thick), (RIGHT + 500, TOP - thick)),
    ):
        shape = pymunk.Segment(space.static_body, a, b, thick)
        shape.friction, shape.elasticity = FRICTION, RESTITUTION
        space.add(shape)


def add_body(space: pymunk.Space, shape: pymunk.Shape, x: float, y: float) -> pymunk.Body:
    shape.friction, shape.elasticity = FRICTION, RESTITUTION
    shape.body.position = (x, y)
    space.add(shape.body, shape)
    return shape.body


def add_wall(space: pymunk.Space, chance: np.random.Generator) -> dict[str, pymunk.Body]:
    """Add fifty boxes, with a small displacement of each column; returns them by name."""
    bodies = {}
    for column in range(COLUMNS):
        x = FIRST_COLUMN + PITCH * column + chance.uniform(-2.0, 2.0)
        for row in range(ROWS):
            box = pymunk.Body(1.0, pymunk.moment_for_box(1.0, (WIDE, TALL)))
            shape = pymunk.Poly.create_box(box, (WIDE, TALL))
            bodies[f"box{column}{row}"] = add_body(space, shape, x, FLOOR - TALL * (row + 0.5))
    return bodies


def throw_ball(space: pymunk.Space, throw: Throw, chance: np.random.Generator) -> pymunk.Body:
    ball = pymunk.Body(BALL_MASS, pymunk.moment_for_circle(BALL_MASS, 0.0, BALL_RADIUS))
    added = add_body(space, pymunk.Circle(ball, BALL_RADIUS), BALL[0], BALL[1] + chance.uniform(-10.0, 10.0))
    angle = chance.uniform(-0.05, 0.05)
    added.velocity = throw.speed * math.cos(angle), throw.speed * math.sin(angle)
    return added


def corner_points(name: str, thing: pymunk.Body) -> dict[str, tuple[float, float]]:
    """Return the tracked points of one body: `ball`, or `box00-a` to `box00-d` in order around the box."""
    if name == "ball":
        return {name: tuple(thing.position)}
    ends = ((-WIDE / 2, -TALL / 2), (WIDE / 2, -TALL / 2), (WIDE / 2, TALL / 2), (-WIDE / 2, TALL / 2))
    return {f"{name}-{letter}": tuple(thing.local_to_world(end)) for letter, end in zip("abcd", ends, strict=True)}


def play(throw: Throw) -> tuple[Floats, list[str], Floats]:
    """Simulate a throw; returns times (T,), names of N points, and positions (T, N, 2) px."""
    chance = np.random.default_rng(throw.seed)
    space = pymunk.Space()
    space.gravity, space.iterations, space.collision_slop = (0.0, GRAVITY), ITERATIONS, SLOP
    add_boundary(space)
    bodies = add_wall(space, chance)
    dt = 1 / STEPS_PER_SECOND
    for _ in range(round(SETTLING * STEPS_PER_SECOND)):
        space.step(dt)
    bodies = {"ball": throw_ball(space, throw, chance), **bodies}
    every = STEPS_PER_SECOND / throw.hz
    if every != int(every):
        raise SystemExit(f"--hz divides {STEPS_PER_SECOND}, the steps of a second; got {throw.hz:g}")
    frames = []
    for step in range(round(throw.seconds * STEPS_PER_SECOND) + 1):
        if step % int(every) == 0:
            frames.append({key: xy for name, thing in bodies.items() for key, xy in corner_points(name, thing).items()})
        space.step(dt)
    names = list(frames[0])
    return np.arange(len(frames)) / throw.hz, names, np.array([[f[n] for n in names] for f in frames])


def write(throw: Throw, out: Path) -> None:
    t, names, places = play(throw)
    rows = (
        (0, frame, f"{moment:.9f}", name, f"{x:.7f}", f"{y:.7f}")
        for frame, moment in enumerate(t)
        for name, (x, y) in zip(names, places[frame], strict=True)
    )
    facts = {
        "scene": "boxes", "units": "px", "fps": throw.hz, "speed": throw.speed, "gravity": GRAVITY, "seed": throw.seed
    }  # fmt: skip
    write_track_folder(out, ("shot", "frame", "t", "id", "x", "y"), rows, facts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    for name in ("speed", "hz", "seconds"):
        parser.add_argument(f"--{name}", type=float, default=getattr(Throw(), name))
    parser.add_argument("--seed", type=int, default=0)
    arguments = vars(parser.parse_args())
    out = arguments.pop("out")
    write(Throw(**arguments), out)


if __name__ == "__main__":
    main()
