"""Measure how far the rest of a shot can be predicted, and whether the prediction regions have their nominal coverage.

    python -m benchmarks.fitting.prediction [--quick] [--seeds N] [--truth DIR] [--runs DIR]

Simulated shots: three balls of worlds/billiards.py, run as a process, with two cushion models; 60 fps, 1 mm of noise
per axis, predicted from a moment between 0.3 and 1.5 s after the strike. Real shots: the run folders in DIR (written by
benchmarks.clips.real_clips), each from several moments; later observations are the truth there. A prediction uses
nothing observed after its moment. Rivals: a ball that does not move, and one that keeps its last velocity. Takes some
minutes; the real part is skipped where DIR does not exist, and by `--quick`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.fitting.prediction_shots import LAWS, LEAD, film_shot, overhead_scene, simulate_shot
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_statistic, run_quick
from benchmarks.support.run_folder import ROOT
from models.core.errors import TrackError
from models.estimation.forecast.ensemble_prediction import ShotPrediction, forecast_shot
from models.estimation.forecast.forecast_check import check_prediction, estimate_state
from models.estimation.forecast.state_estimate import StateEstimate
from pipeline.io.observed_shot import read_observed_shot

# Prediction horizons, s.
AHEAD = (0.25, 0.5, 1.0, 2.0, 3.0)
# Shots per cushion model of `--quick`, and its horizon, s.
QUICK_SEEDS, QUICK_AHEAD = 6, 1.0
# Motion below which a ball, observed and predicted, is no test of a prediction, m.
LEAST_MOTION = 5e-3
# Moments of a real clip from which it is predicted, as shares of its frames.
MOMENTS = (0.25, 0.4, 0.55, 0.7)


@dataclass(frozen=True)
class PredictedBall:
    """Prediction of one ball of one shot at one horizon."""

    group: str
    ahead: float
    ensemble: bool
    error: float
    """mm, like the next three."""
    stays: float
    straight: float
    sigma: float
    level: float


def score_simulated_shots(seeds: int, folder: Path) -> Iterator[PredictedBall]:
    for seed in range(seeds):
        for law in LAWS:
            yield from score_simulated_shot(seed, law, folder)


def score_simulated_shot(seed: int, law: str, folder: Path) -> list[PredictedBall]:
    cases = []
    shot = simulate_shot(seed, law, folder)
    at = LEAD + float(np.random.default_rng([3, seed]).uniform(0.3, 1.5))
    estimate = estimate_state(film_shot(shot, at, seed), overhead_scene(), at)
    prediction = forecast_shot(estimate, at + np.array([0.0, *AHEAD]), seed)
    for row, ahead in enumerate(AHEAD, start=1):
        true = shot.xy[round((at + ahead) * 1000)]
        for ball in range(len(estimate.ids)):
            case = score_ball(law, prediction, row, ball, true[ball], prediction.level(row, ball, true[ball]), ahead)
            if case is not None:
                cases.append(case)
    return cases


def measure_figures(folder: Path) -> list[Figure]:
    """Measure the figures of the documentation. The balls and horizons of one shot err together: it is one case."""
    figures = []
    for law in LAWS:
        shots = [score_simulated_shot(seed, law, folder) for seed in range(QUICK_SEEDS)]
        sums = np.array([
            [len(cases), sum(c.level <= 0.5 for c in cases), sum(c.level <= 0.9 for c in cases)] for cases in shots
        ])  # fmt: skip
        figures += [
            estimate_statistic(f"{law}: in the {share} % region", sums, "%", partial(_ratio_of_sums, column))
            for column, share in ((1, 50), (2, 90))
        ]
        at_one = [[c for c in cases if c.ahead == QUICK_AHEAD] for cases in shots]
        for name, field in (("predicted", "error"), ("keeps its velocity", "straight"), ("does not move", "stays")):
            errors = [float(np.mean([getattr(c, field) for c in cases])) for cases in at_one if cases]
            figures.append(estimate_median(f"{law}: error {QUICK_AHEAD:g} s ahead, {name}", errors, "mm"))
    return figures


def _ratio_of_sums(column: int, sums: np.ndarray) -> float:
    return 100 * float(sums[:, column].sum() / sums[:, 0].sum())


def score_real_clips(folder: Path) -> Iterator[PredictedBall]:
    """Score every run of a clip from several moments, each ball at the observations nearest to the horizons."""
    for run in sorted(path for path in folder.iterdir() if (path / "tracks.csv").is_file()):
        tracks, place, _ = read_observed_shot(run)
        for share in MOMENTS:
            row = int(share * (len(tracks.t) - 1))
            at = float(tracks.t[row])
            try:
                estimate = estimate_state(tracks, place, at)
            except TrackError as refusal:
                print(f"{run.name} at {at:.2f} s: {refusal}", file=sys.stderr)
                continue
            later = tracks.t[(tracks.t > at) & (tracks.t <= at + max(AHEAD) + 0.1)]
            if not estimate.moving.any() or not len(later):
                continue
            chosen = {float(later[np.argmin(abs(later - at - ahead))]): ahead for ahead in AHEAD}
            prediction = forecast_shot(estimate, np.array([at, *chosen]))
            check = check_prediction(prediction, tracks)
            for ball, t, level in zip(check.ball, check.t, check.level, strict=True):
                ahead = chosen[float(t)]
                if abs(t - at - ahead) < 0.1:
                    true = tracks.xy[np.searchsorted(tracks.t, t - 1e-9), tracks.ids.index(estimate.ids[ball])]
                    when = int(np.searchsorted(prediction.t, t - 1e-9))
                    case = score_ball(run.name.split("_")[0], prediction, when, int(ball), true, float(level), ahead)
                    if case is not None:
                        yield case


def score_ball(
    group: str, prediction: ShotPrediction, row: int, ball: int, true: np.ndarray, level: float, ahead: float
) -> PredictedBall | None:
    """Score the prediction of one ball; None where it rests and is predicted to rest."""
    estimate: StateEstimate = prediction.state
    state = estimate.mean[7 * ball : 7 * ball + 4]
    moved = float(np.hypot(*(true - state[:2])))
    if max(moved, float(np.hypot(*(prediction.path[row, ball] - state[:2])))) < LEAST_MOTION or not np.isfinite(level):
        return None
    straight = state[:2] + state[2:] * (prediction.t[row] - estimate.t)
    return PredictedBall(
        group, ahead, bool(prediction.is_ensemble[row]),
        1e3 * float(np.hypot(*(true - prediction.path[row, ball]))), 1e3 * moved,
        1e3 * float(np.hypot(*(true - straight))), 1e3 * float(prediction.sigma[row, ball]), level,
    )  # fmt: skip


def print_table(title: str, cases: list[PredictedBall]) -> None:
    if not cases:
        return
    print(f"\n## {title}\n")
    print("| ahead s | by | balls | does not move mm | keeps its velocity mm | predicted mm (median) "
          "| predicted sigma mm | in the 50 % region | in the 90 % region |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    for ahead in AHEAD:
        for ensemble in (False, True):
            own = [case for case in cases if case.ahead == ahead and case.ensemble == ensemble]
            if own:
                middle = [f"{np.median([getattr(case, name) for case in own]):.1f}"
                          for name in ("stays", "straight", "error", "sigma")]  # fmt: skip
                print(f"| {ahead:g} | {'ensemble' if ensemble else 'derivatives'} | {len(own)} | {' | '.join(middle)} "
                      f"| {format_coverage(own, 0.5)} | {format_coverage(own, 0.9)} |")  # fmt: skip
    print(f"\nall {len(cases)}: in the 50 % region {format_coverage(cases, 0.5)}, "
          f"in the 90 % region {format_coverage(cases, 0.9)}")  # fmt: skip


def format_coverage(cases: list[PredictedBall], share: float) -> str:
    return f"{np.mean([case.level <= share for case in cases]):.0%}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="simulated shots per cushion model")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_predictions",
                        help="folder in which simulated shots are kept")  # fmt: skip
    parser.add_argument("--runs", type=Path, default=ROOT / "out" / "real_clips", help="run folders of real clips")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = (
            f"seeds 0 to {QUICK_SEEDS - 1} per cushion model, each shot a case, all moving balls and horizons of it"
        )
        with tempfile.TemporaryDirectory() as fresh:
            run_quick("fitting.prediction", lambda: measure_figures(Path(fresh)), inputs)
        return 0
    cases = list(score_simulated_shots(arguments.seeds, arguments.truth))
    for law in LAWS:
        print_table(f"Simulated shots, cushion model {law}", [case for case in cases if case.group == law])
    if not arguments.runs.is_dir():
        print(
            f"\nthere are no run folders in {arguments.runs}: write them with python -m benchmarks.clips.real_clips",
            file=sys.stderr,
        )
        return 0
    filmed = list(score_real_clips(arguments.runs))
    for group in sorted({case.group for case in filmed}):
        print_table(f"Real clips, {group}", [case for case in filmed if case.group == group])
    return 0


if __name__ == "__main__":
    sys.exit(main())
