"""Find patches that no library holds, and compare place, size and strength with the truth.

    python -m benchmarks.diagnosis.patch_check [slide|billiards ...] [--quick] [--seeds 5] [--first 0]
        [--rows FILE.csv] [--show] [--locate]

The truth is worlds/slide.py and worlds/billiards_table.py, run as processes: twelve shots over a disc of 0.3 m radius
with more friction at a random place. The diagnosed simulator has every other effect that acts. Printed: how often the
patch is found, the overlap of the discs (area of both over area of either), how often both coordinates of the centre
are within two of their standard deviations, the error of the strength, and the largest error of another parameter of
the simulator in its standard deviations. With --locate, no effects are searched: the simulator is fitted, and a patch
located in its residuals, as a diagnosis does where it names nothing. Every table is a row of FILE.csv and is skipped if
it is already there. Takes ten seconds (slide) to two minutes (billiards) per table, five seconds with --locate.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.billiards_gap import build_scene
from benchmarks.diagnosis.billiards_gap_cases import CASES, film_case
from benchmarks.diagnosis.gap_cases import generate_cases
from benchmarks.diagnosis.gap_trial import play_case
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_share, run_quick
from benchmarks.support.row_files import append_row, read_rows
from diagnosis.diagnose import diagnose
from diagnosis.fitting.diagnosis_windows import fit_adaptively
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from diagnosis.fitting.shot_preparation import apply_noise_estimate, estimate_noise, split_shots
from diagnosis.unexplained.local_patch import LocalPatch, find_local_patch
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene
from pipeline.experiments.gapcheck.billiards_cases import Effects
from pipeline.experiments.gapcheck.blind_case import Proportion
from pipeline.io.track_folder_scene import build_gap_scene

SCENES = ("slide", "billiards")
# m, of every patch.
RADIUS = 0.3
QUICK_SEEDS = range(720, 723)
# m/s^2.
GRAVITY = 9.81
GOAL_OVERLAP, GOAL_PULL, GOAL_STRENGTH, GOAL_BIAS = 0.5, 2.0, 0.2, 1.0


@dataclass(frozen=True)
class PatchRow:
    """One table, a row of the CSV file; NaN where no patch was found."""

    scene: str
    seed: int
    verdict: str
    found: int
    x: float
    """m, true centre."""
    y: float
    distance: float
    """m between the centres."""
    pull: float
    """Larger error of a coordinate of the centre, in its standard deviations."""
    radius: float
    """m."""
    overlap: float
    strength: float
    """Over the true one."""
    bias: float
    """Largest error of another parameter, in its standard deviations."""


def measure_overlap(distance: float, one: float, other: float) -> float:
    """Return the area that two discs share over the area that either covers."""
    side = np.linspace(-2.0, 2.0, 801)
    x, y = np.meshgrid(side, side)
    first, second = np.hypot(x, y) < one, np.hypot(x - distance, y) < other
    return float((first & second).sum() / (first | second).sum())


def score_report(scene: str, seed: int, report: DiagnosisReport, effects: Effects) -> PatchRow:
    """Compare a report with the acting effects."""
    errors = [
        abs(one.value - effects[name][parameter]) / one.sigma
        for one in report.fitted
        for name, parameter in (one.name.split("."),)
        if parameter in effects.get(name, {}) and not one.prior_only
    ]
    return score_patch(
        scene, seed, report.verdict, report.unexplained.patch, effects, max(errors, default=float("nan"))
    )


def score_patch(
    scene: str, seed: int, verdict: str, patch: LocalPatch | None, effects: Effects, bias: float
) -> PatchRow:
    """Compare a patch with the true one."""
    truth = effects["sticky_patch"]
    centre: FloatArray = np.array([truth["x"], truth["y"]])
    if patch is None:
        nan = float("nan")
        return PatchRow(scene, seed, verdict, 0, truth["x"], truth["y"], nan, nan, nan, nan, nan, bias)
    distance = float(np.hypot(*(patch.centre - centre)))
    pull = float((np.abs(patch.centre - centre) / patch.centre_sigma).max())
    return PatchRow(
        scene, seed, verdict, 1, truth["x"], truth["y"], distance, pull, patch.radius,
        measure_overlap(distance, patch.radius, RADIUS), -patch.strength / (truth["mu"] * GRAVITY), bias,
    )  # fmt: skip


def film_table(scene: str, seed: int) -> tuple[GapScene, tuple[Recording, ...], Effects]:
    """Simulate and film one table: the scene of the diagnosed simulator, the shots, and the acting effects."""
    if scene == "billiards":
        case = CASES["sticky patch"]
        shots, effects = film_case(case, seed)
        return build_scene(case, shots), shots, effects
    slide = next(one for one in generate_cases() if one.kind.name == "slide, sticky patch")
    drawn = slide.kind.draw_experiment(seed, slide.shots, slide.fps)
    with tempfile.TemporaryDirectory() as folder:
        read = play_case(slide, drawn, Path(folder) / "case")
    return build_gap_scene(read), read.recordings, drawn["effects"]


def run_table(scene: str, seed: int, only_locates: bool = False) -> PatchRow:
    """Simulate, film, diagnose and score one table."""
    gap_scene, shots, effects = film_table(scene, seed)
    if not only_locates:
        return score_report(scene, seed, diagnose(gap_scene, shots, seed), effects)
    split = split_shots(shots)
    used = (*split.fitting, *split.selection)
    noise = estimate_noise(used)
    problem = build_diagnosis_problem(gap_scene, noise)
    fitted = fit_adaptively(problem, tuple(apply_noise_estimate(used, noise)))
    patch = find_local_patch(problem, fitted, np.random.default_rng(seed))
    return score_patch(scene, seed, "", patch, effects, float("nan"))


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    rows = [run_table("billiards", seed, only_locates=True) for seed in QUICK_SEEDS]
    found = [row for row in rows if row.found]
    return [
        estimate_share("patches found", len(found), len(rows)),
        estimate_median("overlap with the true disc", [row.overlap for row in found], ""),
        estimate_share("true centre within two sigma", sum(row.pull <= GOAL_PULL for row in found), len(found)),
        estimate_median("strength over the true one", [row.strength for row in found], ""),
    ]


def print_table(rows: list[PatchRow]) -> None:
    """Print one line per scene."""
    print(
        "| scene | tables | found | overlap >= 0.5 | centre within 2 sigma | strength within 20 %"
        " | others within 1 sigma | medians |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for scene in SCENES:
        own = [row for row in rows if row.scene == scene]
        good = [row for row in own if row.found]
        if not own:
            continue
        shares = (
            Proportion(len(good), len(own)),
            Proportion(sum(row.overlap >= GOAL_OVERLAP for row in good), len(good)),
            Proportion(sum(row.pull <= GOAL_PULL for row in good), len(good)),
            Proportion(sum(abs(row.strength - 1) <= GOAL_STRENGTH for row in good), len(good)),
            Proportion(sum(row.bias <= GOAL_BIAS for row in own), len(own)),
        )
        middle = [float(np.median([getattr(row, name) for row in good or own])) for name in ("overlap", "strength")]
        bias = float(np.median([row.bias for row in own]))
        print(
            f"| {scene} | {len(own)} | {' | '.join(map(str, shares))} | overlap {middle[0]:.2f}, strength"
            f" {middle[1]:.2f}, bias {bias:.1f} sigma |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="slide, billiards; default: both")
    parser.add_argument("--seeds", type=int, default=5, help="number of tables per scene")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rows", type=Path, help="CSV file of the rows")
    parser.add_argument("--locate", action="store_true", help="locate patches without a search of effects")
    parser.add_argument("--show", action="store_true", help="only print the table of the existing rows")
    add_quick_option(parser)
    options = parser.parse_args()
    if options.quick:
        run_quick(
            "diagnosis.patch_check",
            measure_figures,
            f"billiard tables, located without a search of effects, seeds {QUICK_SEEDS[0]} to {QUICK_SEEDS[-1]}",
        )
        return
    with tempfile.TemporaryDirectory() as scratch:
        path = options.rows or Path(scratch) / "rows.csv"
        rows = read_rows(path, PatchRow)
        done = {(row.scene, row.seed) for row in rows}
        for seed in range(options.first, options.first + (0 if options.show else options.seeds)):
            for scene in options.scenes or SCENES:
                if (scene, seed) not in done:
                    rows.append(run_table(scene, seed, options.locate))
                    append_row(rows[-1], path)
                    print(rows[-1], file=sys.stderr, flush=True)
        print_table(rows)


if __name__ == "__main__":
    main()
