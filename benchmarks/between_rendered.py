"""Rendered films for the interpolation benchmark: the true places known, and the same moments filmed a second time.

A sample clip, or one drawn anew from it, is filmed at twice its rate and coded as the sample clips are; every other
picture is withheld. Filmed again with the balls at their true places, other noise and the same coding, the withheld
pictures say how alike two films of one shot can be at best.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from between_truth import LEAST_WAY, Lying, Passing
from rich.progress import Progress
from run_folder import ROOT
from withheld import Withheld, pictures_of, withhold

from video.rendering.scene_renderer import Motion, View, seen_centres

sys.path.insert(0, str(ROOT / "sample_videos"))
import make
import shots

STEP = 2
SECONDS = 2.2
"""Of a film: a second of what happens after the strike is mostly slow rolling."""
MEETINGS = ("strike", "ball", "cushion")
POINTS = 9
"""Places along a ball's way through a gap."""
TURN, FASTER, MOVED = 0.35, (0.8, 1.3), 0.06
"""rad, times and m by which a strike and the balls differ from the sample's in a shot drawn anew."""
LONGEST_EXPOSURE = 0.9
"""Of the step between the pictures of the film."""


@dataclass(frozen=True)
class Film:
    """One rendered film with pictures withheld."""

    held: Withheld
    again: list[np.ndarray]
    """What a second camera of the same kind filmed of the same shot: D pictures."""
    passings: list[Passing]
    lying: Lying


def samples_of(word: str, seeds: int, seed: int) -> Iterator[shots.Sample]:
    """The samples whose name holds the word at twice their rate, and as many as `seeds` drawn anew from each."""
    for k, sample in enumerate(s for s in shots.SAMPLES if word in s.name):
        film = replace(sample, seconds=SECONDS + sample.strike_at, rate=STEP * sample.rate, irregular=False)
        yield film
        for n in range(seeds):
            yield drawn_anew(film, np.random.default_rng((seed, k, n)), n)


def drawn_anew(sample: shots.Sample, rng: np.random.Generator, number: int) -> shots.Sample:
    """Another shot on the same table: other places, strike and exposure, up to the step between two pictures."""
    turn, faster = rng.uniform(-TURN, TURN), rng.uniform(*FASTER)
    vx, vy = (faster * v for v in sample.velocity)
    velocity = (vx * np.cos(turn) - vy * np.sin(turn), vx * np.sin(turn) + vy * np.cos(turn))
    balls = sample.balls
    while True:
        moved = [(b.x + dx, b.y + dy) for b, (dx, dy) in zip(balls, rng.normal(0, MOVED, (len(balls), 2)), strict=True)]
        if _lie_apart(np.array(moved), sample):
            break
    laid = tuple(replace(b, x=float(x), y=float(y)) for b, (x, y) in zip(balls, moved, strict=True))
    exposure = float(rng.uniform(1 / 200, LONGEST_EXPOSURE / float(sample.rate)))
    name, seed = f"{sample.name}_anew{number}", sample.seed + 1000 * (number + 1)
    return replace(sample, name=name, velocity=velocity, balls=laid, exposure=exposure, seed=seed)


def _lie_apart(xy: np.ndarray, sample: shots.Sample) -> bool:
    radius, table = sample.table.ball_radius, sample.table
    apart = np.linalg.norm(xy[:, None] - xy, axis=-1) + np.where(np.eye(len(xy)), np.inf, 0)
    inside = (xy > 2 * radius).all() and (xy < np.array([table.length, table.width]) - 2 * radius).all()
    return bool(apart.min() > 2.2 * radius and inside)


def film_of(sample: shots.Sample, folder: Path) -> Film:
    """Film a shot twice, withhold every other picture of the first film, and tell where the balls truly are."""
    samples, events = make.play(make.shot_of(sample))
    motion, view = make.motion_of(sample, samples), make.view_of(sample)
    paths = [folder / f"{sample.name}_film{k}.mp4" for k in (1, 2)]
    for k, path in enumerate(paths):
        if not path.is_file():
            noise = replace(sample, seed=sample.seed + k)
            bar = Progress(disable=True)
            make.write_clip(path, view, noise, motion, bar, bar.add_task(path.stem))
    held = withhold(paths[0], STEP, folder)
    met = [(sample.strike_at + float(e["t"]), e["a"], e["b"]) for e in events if e["kind"] in MEETINGS]
    passings = list(_passings(held, sample, view, motion, met))
    return Film(held, pictures_of(replace(held, source=paths[1])), passings, _lying_in(held, sample, view, motion))


def _lying_in(held: Withheld, sample: shots.Sample, view: View, motion: Motion) -> Lying:
    """Where balls truly lie."""

    def lying(place: int) -> list[tuple[np.ndarray, float]]:
        t = float(held.t[place])
        seen, xyz = seen_centres(view, motion, t), motion(t).xyz
        known = np.flatnonzero(np.isfinite(seen).all(axis=1))
        return [(seen[k], float(view.camera.radius_px(xyz[k, :2], sample.table.ball_radius))) for k in known]

    return lying


def _passings(
    held: Withheld, sample: shots.Sample, view: View, motion: Motion, met: list[tuple[float, str, str]]
) -> Iterator[Passing]:
    """Every ball that truly moves over a withheld picture, with its true place and way."""
    for place in held.hidden():
        first, last = held.t[place // STEP * STEP], held.t[(place // STEP + 1) * STEP]
        way = np.stack([seen_centres(view, motion, float(t)) for t in np.linspace(first, last, POINTS)])
        centre, xyz = seen_centres(view, motion, float(held.t[place])), motion(float(held.t[place])).xyz
        for k, ball in enumerate(sample.balls):
            extent = float(np.hypot(*np.ptp(way[:, k], axis=0)))
            on_table = xyz[k, 2] > 0.999 * sample.table.ball_radius
            if not (np.isfinite(way[:, k]).all() and on_table and extent > LEAST_WAY):
                continue
            radius = float(view.camera.radius_px(xyz[k, :2], sample.table.ball_radius))
            meets = any(first < t < last and ball.id in balls for t, *balls in met)
            kind = "contact" if meets else ("fast" if extent > radius else "slow")
            yield Passing(place, ball.id, kind, centre[k], (way[0, k], way[-1, k]), way[:, k], radius)
