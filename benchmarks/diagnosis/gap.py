"""Score the diagnosis of the sim-to-real gap on simulated bodies with a known cause.

    python -m benchmarks.diagnosis.gap [--quick] [--questions near none] [--scene slide] [--seeds 5] [--first 0]
        [--rows FILE.csv] [--show]

Simulators that share no code with the diagnosis (worlds/slide.py, flight.py, pendulum.py) play 12 shots at 60 fps with
noise of 0.3 px. Strengths are drawn per seed from natural ones (see
pipeline/experiments/gapcheck/billiards_cases.py), or so weak that an effect is 4 to 6 standard deviations once
everything else is adjusted. Every case is a row of FILE.csv and is skipped if it is already there; the tables are
printed from all rows. Takes seconds per case; all questions with five seeds take hours.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

from benchmarks.diagnosis.gap_cases import generate_cases
from benchmarks.diagnosis.gap_table import format_report
from benchmarks.diagnosis.gap_trial import GapRow, run_trial
from benchmarks.support.figures import Figure, add_quick_option, estimate_share, run_quick
from benchmarks.support.row_files import append_row, read_rows

QUICK_SEED = 810
QUICK_CASES = (
    "natural: slide, friction",
    "natural: flight, air drag",
    "natural: pendulum, joint friction",
    "pair: flight, air drag and lift by spin",
    "foreign: slide, curl",
    "none: flight, nothing missing",
)


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    cases, rows = {case.name: case for case in generate_cases()}, []
    for name in QUICK_CASES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(run_trial(cases[name], QUICK_SEED, Path(folder), compares_closure=False))
    missing = [row for row in rows if row.question in ("natural", "pair")]
    return [
        estimate_share("right answers", sum(row.right for row in rows), len(rows)),
        estimate_share("missing effects named, and nothing else", sum(row.right for row in missing), len(missing)),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    questions = list(dict.fromkeys(one.question for one in generate_cases()))
    parser.add_argument(
        "--questions", nargs="+", default=questions, choices=questions, metavar="WORD", help=", ".join(questions)
    )
    parser.add_argument("--scene", default="", help="slide, flight or pendulum; default: all")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rows", type=Path, help="CSV file of the rows")
    parser.add_argument("--show", action="store_true", help="only print the tables of the existing rows")
    add_quick_option(parser)
    options = parser.parse_args()
    if options.quick:
        run_quick("diagnosis.gap", measure_figures, f"{'; '.join(QUICK_CASES)}; seed {QUICK_SEED}")
        return
    with tempfile.TemporaryDirectory() as scratch:
        path = options.rows or Path(scratch) / "rows.csv"
        rows = read_rows(path, GapRow)
        done = {(row.question, row.kind, row.seed) for row in rows}
        wanted = [
            one for one in generate_cases() if one.question in options.questions and options.scene in one.kind.scene
        ]
        for seed in range(options.first, options.first + (0 if options.show else options.seeds)):
            for case in wanted:
                if (case.question, case.kind.name, seed) in done:
                    continue
                with tempfile.TemporaryDirectory() as folder:
                    row = run_trial(case, seed, Path(folder))
                append_row(row, path)
                rows.append(row)
                print(_format_row(row), file=sys.stderr, flush=True)
        print(format_report(rows))


def _format_row(row: GapRow) -> str:
    closed = "" if math.isnan(row.closed) else f" closed {row.closed:.3f} ({row.low:.3f} to {row.high:.3f})"
    mark = "" if row.right else " excused" if row.excused else " WRONG"
    case = f"{row.question:9} {row.kind:44} {row.seed:4}"
    return f"{case} {row.answer:34} {row.probability:.3f}{closed} {row.cpu:.1f} s{mark}"


if __name__ == "__main__":
    main()
