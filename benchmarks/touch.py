"""Touch or not: calls on passes that are known to the hundredth of a millimetre.

    python benchmarks/touch.py [--seeds N] [--calls N] [--jobs N] [--truth DIR]

Truth: worlds/billiards.py, run as a process. First table: how many calls are right at each overlap and gap, 60 fps,
1 mm noise per axis, 0.5 to 3 m/s. Second: close calls within a millimetre; errors correlated from picture to
picture by 0 to 0.7, 0.7 to 1.3 mm large, pictures for 0.12 to 0.3 s to either side, the second ball at rest or moving.
Reliability in ten bins (with the binomial standard deviation), Brier score, and how many calls are surer than 0.9. The
rival looks at geometry alone: where the paths that are seen before the moment lead, and with which error.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import starmap
from pathlib import Path

import numpy as np
from pairs import LENGTH, WIDTH, Meeting, R, Truth, film, happened
from scipy.stats import norm

from models.core.tracks import Tracks
from models.estimation.contact_test.contact_moment import Encounter, watch
from models.estimation.contact_test.contact_probability import geometry_alone, weigh
from models.estimation.segmentation.track_segmentation import Samples

GAPS_MM = (-1.0, -0.3, -0.1, -0.03, 0.1, 0.3, 1.0)
"""Least distance of the surfaces on free paths, negative for overlaps."""
CLOSE = 1e-3
"""m: close calls miss or overlap by less."""
REACH_SIGMA = 2e-5
"""m: the balls of the world are exact."""
NOISE = 1e-3
HALF = 0.3
RUN = 0.32
"""s that the world runs before and after the moment."""


@dataclass(frozen=True, slots=True)
class Film:
    """How one pass is filmed."""

    half: float = HALF
    noise: float = NOISE
    ar: float = 0.0


@dataclass(frozen=True, slots=True)
class Answer:
    """What was called, and what was so."""

    probability: float
    geometry: float
    touched: bool
    error: float
    """s, of the contact's time, over its sigma; NaN without one."""


def passing(gap: float, rng: np.random.Generator) -> Meeting:
    """Two balls, nearest at the table's middle, `gap` m between their surfaces if neither gave way."""
    heading, second = rng.uniform(-0.25, 0.25), np.zeros(2)
    along = np.array([np.cos(heading), np.sin(heading)])
    side = np.array([-along[1], along[0]]) * rng.choice([-1.0, 1.0])
    relative = rng.uniform(0.5, 3.0) * along
    if rng.random() < 0.5:
        turn = rng.uniform(0, 2 * np.pi)
        second = rng.uniform(0.2, 0.8) * np.array([np.cos(turn), 0.5 * np.sin(turn)])
    v = np.array([relative + second, second])
    slip = np.zeros((2, 2))
    if rng.random() < 0.3:
        slip[0] = rng.uniform(-0.4, 1.2) * v[0]
    middle = np.array([LENGTH / 2, WIDTH / 2])
    x = middle + (R + gap / 2) * np.array([-side, side])
    return Meeting(x, v, slip, rng.uniform(0.16, 0.24), rng.uniform(0.007, 0.013), rng.uniform(0.93, 0.97),
                   before=RUN, after=RUN)  # fmt: skip


def question(tracks: Tracks, moment: float) -> Encounter:
    begin = float(tracks.t[0])
    seen = [Samples(tracks.t, tracks.xy[:, k], tracks.sigma[:, k]) for k in (0, 1)]
    return Encounter(tuple(watch(samples, moment, begin) for samples in seen), 2 * R, REACH_SIGMA)


def answer(seed: int, truth: Truth, shown: Film) -> Answer:
    rng = np.random.default_rng([7, seed])
    tracks = film(truth, 60, rng, shown.half, shown.noise, shown.ar)
    moment = truth.middle + rng.normal(0, 4e-3)  # the umpire asks roughly when
    asked = question(tracks, moment)
    verdict = weigh(asked, moment)
    apart, sigma = geometry_alone(asked, moment)
    touched = bool(np.isfinite(truth.contact))
    error = (verdict.t - truth.contact) / verdict.t_sigma if touched and verdict.probability > 0.9 else np.nan
    return Answer(verdict.probability, float(norm.cdf(-apart / sigma)), touched, error)


def judged(gaps: np.ndarray, films: list[Film], first: int, folder: Path, jobs: int) -> list[Answer]:
    """Calls on passes with these gaps (n,) m."""
    draws = [(gap, np.random.default_rng([first + k, 3])) for k, gap in enumerate(gaps)]
    truths = happened(list(starmap(passing, draws)), folder)
    numbers = range(first, first + len(gaps))
    if jobs == 1:
        return list(map(answer, numbers, truths, films))
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(answer, numbers, truths, films, chunksize=8))


def table_of_gaps(seeds: int, judge: partial[list[Answer]]) -> None:
    print("| gap mm | right | of | geometry alone | RMS time error/sigma |\n|---|---|---|---|---|")
    for row, gap in enumerate(GAPS_MM):
        answers = judge(np.full(seeds, gap * 1e-3), [Film()] * seeds, 10_000 * (row + 1))
        right = np.mean([(a.probability > 0.5) == (gap < 0) for a in answers])
        plain = np.mean([(a.geometry > 0.5) == (gap < 0) for a in answers])
        errors = np.array([a.error for a in answers])
        pull = f"{np.sqrt(np.nanmean(errors**2)):.2f}" if np.isfinite(errors).any() else "-"
        print(f"| {gap:+.2f} | {right:.1%} | {seeds} | {plain:.1%} | {pull} |", flush=True)


def table_of_bins(answers: list[Answer]) -> None:
    p, rival = (np.array([getattr(a, name) for a in answers]) for name in ("probability", "geometry"))
    so = np.array([a.touched for a in answers], float)
    print("\n| called | calls | mean call | touched | off, in binomial sigmas |\n|---|---|---|---|---|")
    for low in np.arange(10) / 10:
        rows = (p >= low) & ((p < low + 0.1) | (low > 0.85))
        if rows.any():
            mean, share = p[rows].mean(), so[rows].mean()
            sigma = np.sqrt(np.sum(p[rows] * (1 - p[rows]))) / rows.sum()
            off = (share - mean) / max(sigma, 1e-9)
            print(f"| {low:.1f} to {low + 0.1:.1f} | {rows.sum()} | {mean:.3f} | {share:.3f} | {off:+.1f} |")
    brier, plain = np.mean((p - so) ** 2), np.mean((rival - so) ** 2)
    sure = np.mean(np.abs(p - 0.5) > 0.4)
    print(f"\nBrier score {brier:.4f}, geometry alone {plain:.4f}: {brier / plain:.2f} of it (goal <= 0.8)")
    print(
        f"surer than 0.9 or 0.1: {sure:.0%} of {len(p)} (goal >= 40 %); geometry {np.mean(abs(rival - 0.5) > 0.4):.0%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100, help="passes per gap")
    parser.add_argument("--calls", type=int, default=1000, help="close calls")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_pairs",
                        help="folder that keeps what the world made")  # fmt: skip
    given = parser.parse_args()
    judge = partial(judged, folder=given.truth, jobs=given.jobs)
    if given.seeds:
        table_of_gaps(given.seeds, judge)
    if given.calls:
        rng = np.random.default_rng(2022)
        gaps = rng.uniform(-CLOSE, CLOSE, given.calls)
        films = [Film(rng.uniform(0.12, HALF), rng.uniform(0.7e-3, 1.3e-3), rng.uniform(0, 0.7)) for _ in gaps]
        table_of_bins(judge(gaps, films, 1_000_000))


if __name__ == "__main__":
    main()
