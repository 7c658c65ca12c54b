"""Score calls of touch or miss on passes whose gap is known to a hundredth of a millimetre.

    python -m benchmarks.fitting.touch_or_miss [--quick] [--seeds N] [--calls N] [--jobs N] [--truth DIR]

Truth: worlds/billiards.py, run as a process. First table: share of right calls at each overlap and gap, 60 fps, 1 mm
noise per axis, 0.5 to 3 m/s. Second table: close calls within a millimetre; errors of 0.7 to 1.3 mm, correlated between
frames by 0 to 0.7, frames for 0.12 to 0.3 s on either side, the second ball at rest or moving. Reliability in ten bins
(with the binomial standard deviation), Brier score, and the share of calls above 0.9 or below 0.1. The rival uses
geometry alone: the extrapolated paths before the moment, and their errors. `--quick` takes a quarter of a minute.
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
from scipy.stats import norm

from benchmarks.fitting.ball_pairs import LENGTH, WIDTH, Meeting, R, Truth, film_pair, simulate_meetings
from benchmarks.support.figures import Figure, add_quick_option, estimate_mean, estimate_share, run_quick
from models.core.tracks import Tracks
from models.estimation.contact_test.contact_motion import PossibleContact, make_ball_window
from models.estimation.contact_test.contact_probability import evaluate_contact, predict_gap
from models.estimation.segmentation.track_segmentation import BallSamples

# Least distance of the surfaces on contact-free paths, negative for overlaps, mm.
GAPS_MM = (-1.0, -0.3, -0.1, -0.03, 0.1, 0.3, 1.0)
# Largest gap or overlap of close calls, m.
CLOSE_GAP = 1e-3
# Uncertainty of the sum of the radii, m: the simulated balls are exact.
REACH_SIGMA = 2e-5
NOISE = 1e-3
HALF_WINDOW = 0.3
# Overlap and gap, passes of each, and close calls of `--quick`.
QUICK_GAP_MM, QUICK_SEEDS, QUICK_CALLS = 0.1, 15, 60
# Seconds simulated before and after the moment.
WORLD_SECONDS = 0.32


@dataclass(frozen=True, slots=True)
class FilmSettings:
    """Observation of one pass: half window in s, noise in m, autocorrelation."""

    half: float = HALF_WINDOW
    noise: float = NOISE
    ar: float = 0.0


@dataclass(frozen=True, slots=True)
class ContactCall:
    """Call of one pass, and the truth."""

    probability: float
    geometry: float
    touched: bool
    error: float
    """Error of the contact time over its sigma; NaN without a contact."""


def draw_pass(gap: float, rng: np.random.Generator) -> Meeting:
    """Draw two balls that are closest in the middle of the table, with `gap` m between their surfaces on free paths."""
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
                   before=WORLD_SECONDS, after=WORLD_SECONDS)  # fmt: skip


def build_contact(tracks: Tracks, moment: float) -> PossibleContact:
    begin = float(tracks.t[0])
    balls = [BallSamples(tracks.t, tracks.xy[:, k], tracks.sigma[:, k]) for k in (0, 1)]
    return PossibleContact(tuple(make_ball_window(samples, moment, begin) for samples in balls), 2 * R, REACH_SIGMA)


def score_pass(seed: int, truth: Truth, settings: FilmSettings) -> ContactCall:
    rng = np.random.default_rng([7, seed])
    tracks = film_pair(truth, 60, rng, settings.half, settings.noise, settings.ar)
    moment = truth.middle + rng.normal(0, 4e-3)  # the moment is only roughly known
    contact = build_contact(tracks, moment)
    verdict = evaluate_contact(contact, moment)
    apart, sigma = predict_gap(contact, moment)
    touched = bool(np.isfinite(truth.contact))
    error = (verdict.t - truth.contact) / verdict.t_sigma if touched and verdict.probability > 0.9 else np.nan
    return ContactCall(verdict.probability, float(norm.cdf(-apart / sigma)), touched, error)


def score_passes(gaps: np.ndarray, films: list[FilmSettings], first: int, folder: Path, jobs: int) -> list[ContactCall]:
    """Score calls on passes with these gaps (n,) m."""
    draws = [(gap, np.random.default_rng([first + k, 3])) for k, gap in enumerate(gaps)]
    truths = simulate_meetings(list(starmap(draw_pass, draws)), folder)
    numbers = range(first, first + len(gaps))
    if jobs == 1:
        return list(map(score_pass, numbers, truths, films))
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(score_pass, numbers, truths, films, chunksize=8))


def print_gaps(seeds: int, score: partial[list[ContactCall]]) -> None:
    print("| gap mm | right | of | geometry alone | RMS time error/sigma |\n|---|---|---|---|---|")
    for row, gap in enumerate(GAPS_MM):
        answers = score(np.full(seeds, gap * 1e-3), [FilmSettings()] * seeds, 10_000 * (row + 1))
        right = np.mean([(a.probability > 0.5) == (gap < 0) for a in answers])
        plain = np.mean([(a.geometry > 0.5) == (gap < 0) for a in answers])
        errors = np.array([a.error for a in answers])
        pull = f"{np.sqrt(np.nanmean(errors**2)):.2f}" if np.isfinite(errors).any() else "-"
        print(f"| {gap:+.2f} | {right:.1%} | {seeds} | {plain:.1%} | {pull} |", flush=True)


def draw_close_calls(count: int) -> tuple[np.ndarray, list[FilmSettings]]:
    """Draw gaps within `CLOSE_GAP`, and how the passes are observed."""
    rng = np.random.default_rng(2022)
    gaps = rng.uniform(-CLOSE_GAP, CLOSE_GAP, count)
    return gaps, [
        FilmSettings(rng.uniform(0.12, HALF_WINDOW), rng.uniform(0.7e-3, 1.3e-3), rng.uniform(0, 0.7)) for _ in gaps
    ]


def measure_figures(folder: Path) -> list[Figure]:
    """Measure the figures of the documentation."""
    figures = []
    for row, gap in enumerate((-QUICK_GAP_MM, QUICK_GAP_MM)):
        films = [FilmSettings()] * QUICK_SEEDS
        answers = score_passes(np.full(QUICK_SEEDS, gap * 1e-3), films, 10_000 * (row + 1), folder, 1)
        for name, calls in (
            ("", [a.probability for a in answers]),
            (", geometry alone", [a.geometry for a in answers]),
        ):
            right = sum((call > 0.5) == (gap < 0) for call in calls)
            words = f"{abs(gap):g} mm {'overlap' if gap < 0 else 'gap'}: right{name}"
            figures.append(estimate_share(words, right, QUICK_SEEDS))
    gaps, films = draw_close_calls(QUICK_CALLS)
    answers = score_passes(gaps, films, 1_000_000, folder, 1)
    touched = np.array([a.touched for a in answers], float)
    for name, p in (
        ("close calls", np.array([a.probability for a in answers])),
        ("close calls, geometry alone", np.array([a.geometry for a in answers])),
    ):
        figures += [
            estimate_mean(f"{name}: Brier score", (p - touched) ** 2, ""),
            estimate_share(f"{name}: above 0.9 or below 0.1", int(np.sum(abs(p - 0.5) > 0.4)), len(p)),
        ]
    return figures


def print_calibration(answers: list[ContactCall]) -> None:
    p, rival = (np.array([getattr(a, name) for a in answers]) for name in ("probability", "geometry"))
    touched = np.array([a.touched for a in answers], float)
    print("\n| called | calls | mean call | touched | deviation in binomial sigmas |\n|---|---|---|---|---|")
    for low in np.arange(10) / 10:
        rows = (p >= low) & ((p < low + 0.1) | (low > 0.85))
        if rows.any():
            mean, share = p[rows].mean(), touched[rows].mean()
            sigma = np.sqrt(np.sum(p[rows] * (1 - p[rows]))) / rows.sum()
            off = (share - mean) / max(sigma, 1e-9)
            print(f"| {low:.1f} to {low + 0.1:.1f} | {rows.sum()} | {mean:.3f} | {share:.3f} | {off:+.1f} |")
    brier, plain = np.mean((p - touched) ** 2), np.mean((rival - touched) ** 2)
    sure = np.mean(np.abs(p - 0.5) > 0.4)
    print(f"\nBrier score {brier:.4f}, geometry alone {plain:.4f}: {brier / plain:.2f} of it (goal <= 0.8)")
    print(
        f"above 0.9 or below 0.1: {sure:.0%} of {len(p)} (goal >= 40 %); geometry {np.mean(abs(rival - 0.5) > 0.4):.0%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100, help="passes per gap")
    parser.add_argument("--calls", type=int, default=1000, help="close calls")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="number of processes")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_pairs",
                        help="folder in which simulated shots are kept")  # fmt: skip
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"gaps and overlaps of {QUICK_GAP_MM:g} mm, seeds 0 to {QUICK_SEEDS - 1}; {QUICK_CALLS} close calls"
        with tempfile.TemporaryDirectory() as fresh:
            run_quick("fitting.touch_or_miss", lambda: measure_figures(Path(fresh)), inputs)
        return
    score = partial(score_passes, folder=arguments.truth, jobs=arguments.jobs)
    if arguments.seeds:
        print_gaps(arguments.seeds, score)
    if arguments.calls:
        print_calibration(score(*draw_close_calls(arguments.calls), 1_000_000))


if __name__ == "__main__":
    main()
