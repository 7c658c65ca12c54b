"""Rendered clips for the interpolation benchmark, with true positions and a second film of the same moments.

A sample clip, or a new shot on its table, is rendered at twice its rate and encoded like the sample clips; every other
frame is withheld. A second film with the same motion, other noise and the same coding shows how similar two films of
one shot can be at best.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.progress import Progress

from benchmarks.interpolation.withheld_frames import WithheldClip, read_all_frames, withhold
from benchmarks.interpolation.withheld_truth import LEAST_PATH, BallLocator, Passing
from benchmarks.support.run_folder import ROOT
from video.rendering.scene_renderer import Motion, SceneView, project_ball_centres

sys.path.insert(0, str(ROOT / "sample_videos"))
import make
import shots

STEP = 2
# Length of a film after the strike, s; later there is mostly slow rolling.
SECONDS = 2.2
MEETINGS = ("strike", "ball", "cushion")
# Positions along the path of a ball through a gap.
POINTS = 9
# Changes of a new shot: direction (rad) and speed (factor) of the strike, positions of the balls (m).
TURN, FASTER, MOVED = 0.35, (0.8, 1.3), 0.06
# Longest exposure as a share of the frame interval.
LONGEST_EXPOSURE = 0.9


@dataclass(frozen=True)
class RenderedFilm:
    """One rendered film with withheld frames."""

    withheld: WithheldClip
    again: list[np.ndarray] | None
    """D frames of the same shot by a second camera of the same kind, if there is one."""
    passings: list[Passing]
    locate_balls: BallLocator


def generate_samples(word: str, seeds: int, seed: int) -> Iterator[shots.Sample]:
    """Generate the samples whose name contains the word, at twice their rate, and `seeds` new shots from each."""
    for k, sample in enumerate(s for s in shots.SAMPLES if word in s.name):
        film = replace(sample, seconds=SECONDS + sample.strike_at, rate=STEP * sample.rate, irregular=False)
        yield film
        for n in range(seeds):
            yield draw_shot(film, np.random.default_rng((seed, k, n)), n)


def draw_shot(sample: shots.Sample, rng: np.random.Generator, number: int) -> shots.Sample:
    """Draw another shot on the same table, with other positions, strike and exposure."""
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
    name, seed = f"{sample.name}_new{number}", sample.seed + 1000 * (number + 1)
    return replace(sample, name=name, velocity=velocity, balls=laid, exposure=exposure, seed=seed)


def _lie_apart(xy: np.ndarray, sample: shots.Sample) -> bool:
    radius, table = sample.table.ball_radius, sample.table
    apart = np.linalg.norm(xy[:, None] - xy, axis=-1) + np.where(np.eye(len(xy)), np.inf, 0)
    inside = (xy > 2 * radius).all() and (xy < np.array([table.length, table.width]) - 2 * radius).all()
    return bool(apart.min() > 2.2 * radius and inside)


def read_sample_film(name: str, folder: Path) -> RenderedFilm:
    """Withhold every other frame of a sample clip as it is shipped; there is no second film."""
    [sample] = [one for one in shots.SAMPLES if one.name == name]
    return _withhold_film(sample, ROOT / "sample_videos" / f"{name}.mp4", None, folder)


def film_sample(sample: shots.Sample, folder: Path) -> RenderedFilm:
    """Film a shot twice, withhold every other frame of the first film, and return them with the true positions."""
    samples, _ = make.simulate_shot(make.build_world_shot(sample))
    motion, view = make.build_motion(sample, samples), make.build_sample_view(sample)
    paths = [folder / f"{sample.name}_film{k}.mp4" for k in (1, 2)]
    for k, path in enumerate(paths):
        if not path.is_file():
            noise = replace(sample, seed=sample.seed + k)
            bar = Progress(disable=True)
            make.write_clip(path, view, noise, motion, bar, bar.add_task(path.stem))
    return _withhold_film(sample, paths[0], paths[1], folder)


def _withhold_film(sample: shots.Sample, film: Path, second: Path | None, folder: Path) -> RenderedFilm:
    samples, events = make.simulate_shot(make.build_world_shot(sample))
    motion, view = make.build_motion(sample, samples), make.build_sample_view(sample)
    withheld = withhold(film, STEP, folder)
    contacts = [(sample.strike_at + float(e["t"]), e["a"], e["b"]) for e in events if e["kind"] in MEETINGS]
    return RenderedFilm(
        withheld,
        read_all_frames(replace(withheld, source=second)) if second else None,
        list(_find_passings(withheld, sample, view, motion, contacts)),
        _make_ball_locator(withheld, sample, view, motion),
    )


def _make_ball_locator(withheld: WithheldClip, sample: shots.Sample, view: SceneView, motion: Motion) -> BallLocator:
    """Make a function that returns the true ball positions of a frame."""

    def locate_balls(place: int) -> list[tuple[np.ndarray, float]]:
        t = float(withheld.t[place])
        centres, xyz = project_ball_centres(view, motion, t), motion(t).xyz
        visible = np.flatnonzero(np.isfinite(centres).all(axis=1))
        return [(centres[k], float(view.camera.radius_px(xyz[k, :2], sample.table.ball_radius))) for k in visible]

    return locate_balls


def _find_passings(
    withheld: WithheldClip,
    sample: shots.Sample,
    view: SceneView,
    motion: Motion,
    contacts: list[tuple[float, str, str]],
) -> Iterator[Passing]:
    """Yield every ball that moves in a withheld frame, with its true position and path."""
    for place in withheld.withheld_places():
        first, last = withheld.t[place // STEP * STEP], withheld.t[(place // STEP + 1) * STEP]
        path = np.stack([project_ball_centres(view, motion, float(t)) for t in np.linspace(first, last, POINTS)])
        centre, xyz = project_ball_centres(view, motion, float(withheld.t[place])), motion(float(withheld.t[place])).xyz
        for k, ball in enumerate(sample.balls):
            extent = float(np.hypot(*np.ptp(path[:, k], axis=0)))
            on_table = xyz[k, 2] > 0.999 * sample.table.ball_radius
            if not (np.isfinite(path[:, k]).all() and on_table and extent > LEAST_PATH):
                continue
            radius = float(view.camera.radius_px(xyz[k, :2], sample.table.ball_radius))
            meets = any(first < t < last and ball.id in balls for t, *balls in contacts)
            kind = "contact" if meets else ("fast" if extent > radius else "slow")
            yield Passing(place, ball.id, kind, centre[k], (path[0, k], path[-1, k]), path[:, k], radius)
