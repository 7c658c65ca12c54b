"""Rendered rallies of an independent simulator: what of them is found, and how sure and true the answers are.

    python -m benchmarks.courts [--rallies 12] [--seed 1] [--sport tennis] [--oracle camera] [--out out/courts]
    python -m benchmarks.courts --from-truth [--missing 0.1] [--run 4] [--clutter 3] [--rallies 30]

Clips are rendered once per seed, and answers are stored beside them: `--refresh` runs the program again. `--oracle`
replaces parts by the truth (camera, candidates), which separates their errors. Every third clip is a phone's, rates go
from 25 to 60 fps, every fifth is 1080p. Goals are those of the issue on courts.

`--from-truth` renders nothing and takes some seconds per rally: the inference is given the true camera and a detector
that knows where the object is visible, with a noise of 0.7 px. It may miss a share of the frames, one by one or
in runs, and add false candidates.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.court_cases.court_answers import Impairment, answer_case, answer_truth
from benchmarks.court_cases.court_clips import CourtCase, film_case, read_truth, render_case
from benchmarks.court_cases.court_scores import RallyScore, join_scores, score_answer, upper_bound

SPORTS = ("badminton", "tennis", "table-tennis")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rallies", type=int, default=12, help="per sport")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sport", action="append", choices=SPORTS)
    parser.add_argument("--oracle", action="append", choices=("camera", "candidates"), default=[])
    parser.add_argument("--from-truth", action="store_true", help="detector and camera that know the truth, no clip")
    parser.add_argument("--missing", type=float, default=0.0, help="share of frames in which that detector misses")
    parser.add_argument("--run", type=float, default=0.0, help="mean number of frames that it misses in a row")
    parser.add_argument("--clutter", type=float, default=0.0, help="mean number of its false candidates per frame")
    parser.add_argument("--strokes", type=int, nargs=2, default=(2, 6), help="least and largest number of a rally")
    parser.add_argument("--out", type=Path, default=Path("out/courts"))
    parser.add_argument("--refresh", action="store_true", help="run the program again")
    parser.add_argument("--render-only", action="store_true")
    parser.add_argument("--each", action="store_true", help="print a line per clip")
    options = parser.parse_args()
    console, columns = Console(width=160), {}
    for sport in options.sport or SPORTS:
        scores = []
        for number in range(options.rallies):
            case = CourtCase(sport, number, options.seed, tuple(options.strokes))
            if options.from_truth:
                truth = read_truth(film_case(case, options.out))
                answer = answer_truth(truth, Impairment(options.missing, options.clutter, options.run))
            else:
                truth = read_truth(render_case(case, options.out))
                if options.render_only:
                    continue
                answer = answer_case(truth, frozenset(options.oracle), options.refresh)
            scores.append(score_answer(truth, answer))
            if options.each:
                console.print(f"{case.name} {case.view} {case.fps}: {answer['error'] or summarize_clip(scores[-1])}")
        columns[sport] = join_scores(scores)
    if not options.render_only:
        console.print(make_table({**columns, "all": join_scores(list(columns.values()))}))


def summarize_clip(score: RallyScore) -> str:
    """Return a line on one clip."""
    landing = f"{100 * score.landing[0]:.1f} cm" if score.landing else "none"
    return (
        f"found {score.found}/{score.visible} (candidates {score.candidate}), false {score.false}, "
        f"events {score.events_found}/{score.events} + {score.events_extra}, "
        f"landing {landing} (view {100 * np.median(score.bound or [np.nan]):.1f}), lines {np.mean(score.line):.2f} px"
    )


def make_table(columns: dict[str, RallyScore]) -> Table:
    """Make the table of the scores of each sport."""
    table = Table("", "goal", *columns)
    for label, goal, write in ROWS:
        table.add_row(label, goal, *(write(score) for score in columns.values()))
    return table


def _share(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"


def _quantiles(values: list[float], factor: float, shares: tuple[float, ...] = (0.5, 0.9)) -> str:
    return " / ".join(f"{factor * q:.1f}" for q in np.quantile(values, shares)) if values else "-"


def _reliability(stated: list[float], is_own: list[bool]) -> str:
    """Return the mean probabilities of candidates in three ranges, and how many of them are the object, %."""
    level, own = np.array(stated), np.array(is_own)
    parts = [(level >= low) & (level < high) for low, high in ((0.1, 0.3), (0.3, 0.7), (0.7, 1.01))]
    return ", ".join(f"{100 * level[p].mean():.0f}: {100 * own[p].mean():.0f}" for p in parts if p.any())


def _within(z: list[float]) -> str:
    size = np.abs(z)
    return f"{100 * np.mean(size < 1):.0f} / {100 * np.mean(size < 2):.0f} %" if len(z) else "-"


ROWS = (
    ("clips / refused", "0", lambda s: f"{s.clips} / {s.refused}"),
    ("object found where visible", ">= 95 %", lambda s: _share(s.found, s.visible)),
    ("  a candidate there", "", lambda s: _share(s.candidate, s.visible)),
    ("  stated at 0.1-0.3, 0.3-0.7, 0.7-1: right", "as stated", lambda s: _reliability(s.stated, s.is_own)),
    ("false per frame", "<= 1 %", lambda s: _share(s.false, s.frames)),
    ("its place, px rms", "<= 1", lambda s: f"{np.sqrt(np.mean(np.square(s.off_px))):.2f}" if s.off_px else "-"),
    ("hits and bounces within a frame", ">= 95 %", lambda s: _share(s.events_found, s.events)),
    ("  extra", "<= 5 %", lambda s: _share(s.events_extra, s.events)),
    ("touches of the net found / false", "", lambda s: f"{s.nets_found} of {s.nets} / {s.nets_false}"),
    ("landing error, median / 90 %, cm", "<= 5 / 15", lambda s: _quantiles(s.landing, 100)),
    ("  of the view", "x 1.3", lambda s: _quantiles(s.bound, 100)),
    ("  none stated", "", lambda s: str(s.landings_missed)),
    ("in or out within 10 cm, right", ">= 97 %", lambda s: _share(s.close_right, s.close_right + s.close_wrong)),
    ("  undecided", "<= 30 %", lambda s: _share(s.close_open, s.close_right + s.close_wrong + s.close_open)),
    ("statements at 0.99", ">= 400", lambda s: str(s.certain)),
    (
        "  false, and upper bound",
        "0, 1 %",
        lambda s: f"{s.certain_false}, {100 * upper_bound(s.certain_false, s.certain):.1f} %",
    ),
    ("landing within 1 / 2 sigma", "60-76 / 90-98", lambda s: _within(s.z)),
    ("speed at the racket, median / 90 %, %", "<= 3", lambda s: _quantiles(s.speed, 100)),
    ("  within 1 / 2 sigma", "60-76 / 90-98", lambda s: _within(s.speed_z)),
    ("lines, px rms, median / worst", "<= 1", lambda s: _quantiles(s.line, 1, (0.5, 1.0))),
    ("CPU ms per frame", "", lambda s: f"{1000 * np.mean(s.seconds):.0f}" if s.seconds else "-"),
)


if __name__ == "__main__":
    main()
