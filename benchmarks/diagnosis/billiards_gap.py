"""Score the diagnosis on simulated billiards: false alarms, named missing effects, and the closed share of the gap.

    python -m benchmarks.diagnosis.billiards_gap [KIND...] [--quick] [--seeds 1] [--first 0]
        [--rows FILE.csv] [--pair] [--show]

The truth is worlds/billiards_table.py, run as a process: twelve shots of two to five balls on a random table per seed,
2 s each at 62.5 fps, noise of 0.3 px at 350 px per metre. The diagnosed simulator has rolling resistance, sliding
friction, spin decay and the restitution of cushions and balls, except for the effects that the kind withholds. Weak
effects are 4 to 6 of the standard deviations with which an oracle that knows their name estimates them, all else
adjusted. Every case is a row of FILE.csv and is skipped if it is already there; the tables are printed from all rows.
With --pair, two processes work on each case, as they do for users; the CPU seconds are then those of one of them.
Takes half a minute to a few minutes per case; all kinds with one seed take hours.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.billiards_gap_cases import CASES, NEAR, BilliardsGapCase, film_case
from benchmarks.diagnosis.billiards_gap_table import BilliardsGapRow, format_report
from benchmarks.diagnosis.gap_trial import measure_strength
from benchmarks.fitting.foreign_shots import TABLE
from benchmarks.support.figures import Figure, add_quick_option, estimate_share, run_quick
from benchmarks.support.row_files import append_row, read_rows
from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.estimation.gap_scenes.gap_scene import GapScene
from models.numerics.executor import SERIAL, Executor
from models.physics.billiards.simulation.table_physics import BILLIARDS_MODEL_CHOICES
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS
from pipeline.engine.helper_executor import open_executor
from pipeline.experiments.gapcheck.billiards_cases import FOREIGN_EFFECTS, Effects
from pipeline.experiments.gapcheck.blind_case import build_oracle, is_separable


def build_scene(case: BilliardsGapCase, shots: tuple[Recording, ...]) -> GapScene:
    """Build the diagnosed simulator with the library of effects."""
    return case.kind.simulator(build_billiards_scene(TABLE, shots, simulator_effects=case.kind.model))


def is_right(case: BilliardsGapCase, shots: tuple[Recording, ...], report: DiagnosisReport) -> bool:
    """Return whether the case allows the answer; in a trap the right name counts only if an oracle can separate it."""
    kind, named = case.kind, frozenset(report.effects)
    if not kind.withheld:
        return report.verdict == "none"
    if kind.foreign:
        return report.verdict == "unknown"
    if kind.trap and named:
        return named == kind.withheld and is_separable(kind, build_scene(case, shots), shots)
    return kind.trap or (report.verdict == "effects" and kind.is_named_by(named))


def weak_strength(case: BilliardsGapCase, seed: int) -> float:
    """Return the share of its natural strength at which an effect is NEAR standard deviations."""
    absent, _ = film_case(case, seed, 0.0)
    scene = build_scene(case, absent)
    natural = case.kind.draw_effects(case.kind.make_generator(seed))
    wanted = [
        natural[effect.name][prior.name] for effect in scene.effects if effect.name in case.kind.missing
        for prior in effect.parameters
    ]  # fmt: skip
    deviations = measure_strength(build_oracle(scene, absent), case.kind.withheld, np.array(wanted))
    return float(np.random.default_rng([7181, seed, *case.name.encode()]).uniform(*NEAR)) / deviations


def make_row(
    case: BilliardsGapCase,
    seed: int,
    shots: tuple[Recording, ...],
    report: DiagnosisReport,
    acted: Effects,
    seconds: tuple[float, float],
) -> BilliardsGapRow:
    """Make the row of one case."""
    closing, first, named = report.gap.closure, report.candidates[0], " + ".join(report.effects)
    group = " | ".join(first.group) if report.verdict == "group" else ""
    phase = report.where[0].phase if report.where else ""
    strengths = [f"{one.name} {one.value:.3g} +- {one.sigma:.2g}" for one in report.fitted[len(case.kind.model) :]]
    return BilliardsGapRow(
        kind=case.name, question=_classify_question(case), seed=seed, answer=named or group or report.verdict,
        right=int(is_right(case, shots, report)), grouped=int(any(n in first.group for n in case.kind.missing)),
        probability=report.probability, p_value=report.p_value, before=closing.before, after=closing.after,
        floor=closing.floor, closed=closing.closed if closing.resolved else float("nan"), low=closing.interval[0],
        high=closing.interval[1], phase=phase, phase_right=_acts_in(case, phase), cpu=seconds[0], wall=seconds[1],
        truth=", ".join(f"{name}.{p} {v:.3g}" for name in case.kind.missing for p, v in acted.get(name, {}).items()),
        fitted=", ".join(strengths),
    )  # fmt: skip


def _classify_question(case: BilliardsGapCase) -> str:
    kind = case.kind
    if kind.trap:
        return "trap"
    if case.harder:
        return case.harder
    if kind.family or kind.simulator_cushion not in ("mirror", kind.cushion):
        return "form"
    if not kind.missing:
        return "none"
    if kind.foreign:
        return "removed" if kind.removed else "foreign"
    return "pair" if len(kind.missing) == 2 else "one"


def _acts_in(case: BilliardsGapCase, phase: str) -> int:
    """Return 1 where the missing effect acts in a phase, 0 where it does not, -1 where nothing is missing."""
    phases = {one.name: one.phases for one in (*BILLIARDS_EFFECTS, *BILLIARDS_MODEL_CHOICES)}
    phases |= dict.fromkeys(FOREIGN_EFFECTS, ("free_roll",))
    lacks = case.kind.family or case.kind.withheld
    return int(any(phase in phases[name] for name in lacks)) if lacks else -1


def run_trial(case: BilliardsGapCase, seed: int, workers: Executor = SERIAL) -> BilliardsGapRow:
    """Simulate, film, diagnose and score one case."""
    shots, acted = film_case(case, seed, weak_strength(case, seed) if case.harder == "weak" else 1.0)
    begun = time.process_time(), time.perf_counter()
    report = diagnose(build_scene(case, shots), shots, executor=workers)
    seconds = time.process_time() - begun[0], time.perf_counter() - begun[1]
    return make_row(case, seed, shots, report, acted, seconds)


QUICK_CASES, QUICK_SEED = ("slope", "none"), 150


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation; the noise of a closure is half of its stated interval."""
    rows = [run_trial(CASES[name], QUICK_SEED) for name in QUICK_CASES]
    figures = [estimate_share("right answers", sum(row.right for row in rows), len(rows))]
    figures += [
        Figure(f"{row.kind}: share of the gap closed", 100 * row.closed, 50 * (row.high - row.low), "%", 1)
        for row in rows
        if np.isfinite(row.closed)
    ]
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"kinds of cases; default: all of {', '.join(CASES)}")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rows", type=Path, help="CSV file of the rows")
    parser.add_argument("--pair", action="store_true", help="use two processes per case, as for users")
    parser.add_argument("--show", action="store_true", help="only print the tables of the existing rows")
    add_quick_option(parser)
    options = parser.parse_args()
    if options.quick:
        inputs = f"a slope missing and nothing missing, seed {QUICK_SEED}"
        run_quick("diagnosis.billiards_gap", measure_figures, inputs)
        return
    with tempfile.TemporaryDirectory() as scratch, open_executor() if options.pair else nullcontext(SERIAL) as workers:
        path = options.rows or Path(scratch) / "rows.csv"
        rows = read_rows(path, BilliardsGapRow)
        done = {(row.kind, row.seed) for row in rows}
        for seed in range(options.first, options.first + (0 if options.show else options.seeds)):
            for name in options.kinds or CASES:
                if (name, seed) not in done:
                    rows.append(run_trial(CASES[name], seed, workers))
                    append_row(rows[-1], path)
                    print(rows[-1].format_line(), file=sys.stderr, flush=True)
        print(format_report(rows))


if __name__ == "__main__":
    main()
