"""The diagnosis of the sim-to-real gap where the cause is known: what it names, misses, and makes up.

    PYTHONPATH=. python benchmarks/gap.py [--asked near none] [--scene slide] [--seeds 5] [--first 0] [--rows FILE.csv]

Worlds that share no code with the diagnosis (worlds/slide.py, flight.py, pendulum.py) play 12 shots at 60 pictures a
second with noise of 0.3 px, strengths drawn anew for every seed from natural ones (pipeline/experiments/gapcheck/case_catalogue.py says
which and why), or so weak that an effect is 4 to 6 standard deviations once everything else is adjusted. Every case is
a row of FILE.csv, and is not tried again where it stands there already; the table is printed from all rows.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

from gap_cases import cases
from gap_table import told
from gap_trial import Row, trial
from row_files import append, read_rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked = list(dict.fromkeys(one.asked for one in cases()))
    parser.add_argument("--asked", nargs="+", default=asked, choices=asked, metavar="WORD", help=", ".join(asked))
    parser.add_argument("--scene", default="", help="slide, flight or pendulum alone")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rows", type=Path, help="where rows are kept")
    parser.add_argument("--show", action="store_true", help="only print the table of the rows there are")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        path = options.rows or Path(scratch) / "rows.csv"
        rows = read_rows(path, Row)
        done = {(row.asked, row.kind, row.seed) for row in rows}
        wanted = [one for one in cases() if one.asked in options.asked and options.scene in one.kind.scene]
        for seed in range(options.first, options.first + (0 if options.show else options.seeds)):
            for case in wanted:
                if (case.asked, case.kind.name, seed) in done:
                    continue
                with tempfile.TemporaryDirectory() as folder:
                    row = trial(case, seed, Path(folder))
                append(row, path)
                rows.append(row)
                print(_line(row), file=sys.stderr, flush=True)
        print(told(rows))


def _line(row: Row) -> str:
    closed = "" if math.isnan(row.closed) else f" closed {row.closed:.3f} ({row.low:.3f} to {row.high:.3f})"
    mark = "" if row.right else " excused" if row.excused else " WRONG"
    return f"{row.asked:9} {row.kind:44} {row.seed:4} {row.said:34} {row.probability:.3f}{closed} {row.cpu:.1f} s{mark}"


if __name__ == "__main__":
    main()
