"""Diagnose recorded three-cushion shots: what a simulator with a given cushion model lacks, and what that costs.

    python -m benchmarks.diagnosis.carom_gap [MODEL...] [--groups 0 12 24] [--rows FILE.csv] [--serial] [--show]

The shots are those of ../shared/data/physics/recorded_carom/shots.csv (shot, t, id, x, y; m on a table of 2.84 m by
1.42 m, 61.5 mm balls), which cannot be shipped. A group is `--shots` shots from its number on: half of them fit, a
quarter confirms effects, a quarter reports. MODEL is the cushion model of the user's simulator (default: all three),
which also has rolling resistance, sliding friction, spin decay, the restitution of cushions and balls and, with a
published cushion model, its friction. Every case is a row of FILE.csv and is skipped if it is already there; the table
is printed from all rows. Two processes work on each case, as they do for users, unless --serial is given. Takes
one to a few minutes per case.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
import time
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import psutil

from benchmarks.support.row_files import append_row, read_rows
from benchmarks.support.run_folder import ROOT
from diagnosis.diagnose import diagnose
from diagnosis.selection.hypotheses import SearchOutlook
from diagnosis.verdicts.verdict import DiagnosisReport
from models.estimation.gap_scenes.billiards_scene import DEFAULT_EFFECTS
from models.numerics.executor import SERIAL, Executor
from pipeline.engine.helper_executor import HelperExecutor, open_executor
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

SOURCE = ROOT.parent / "shared/data/physics/recorded_carom/shots.csv"
MODELS = ("mirror", "han_2005", "mathavan_2010")
FPS = 50
SCENE = {
    "scene": "billiards", "units": "m", "fps": FPS, "ball_radius": 0.03075,
    "table": {"length": 2.84, "width": 1.42, "pockets": False, "name": "carom", "game": "carom"},
}  # fmt: skip


@dataclass(frozen=True)
class CaromGapRow:
    """Result of one group of shots for one simulator."""

    model: str
    group: int
    shots: int
    answer: str
    """Named effects, joined by +, or the verdict."""
    forms: str
    """Contact models that the answer states."""
    probability: float
    p_value: float
    """p-value of the hypothesis that the residual of the simulator is noise."""
    before: float
    """Prediction error on reporting shots, m, like the next two."""
    after: float
    floor: float
    closed: float
    """Closed share of the gap; NaN where it is not resolved."""
    low: float
    high: float
    reporting: int
    """Number of reporting shots that could be predicted."""
    where: str
    """Phases of the gap and their shares."""
    rest: float
    """Share of the gap that remains."""
    first: float
    """s until there was a first hypothesis to show."""
    steps: int
    cpu: float
    """CPU seconds of all processes."""
    wall: float

    def format_line(self) -> str:
        return (
            f"{self.model:14} {self.group:5} {self.answer:36} {self.forms:26} {self.probability:5.2f}"
            f" {1e3 * self.before:7.1f} {1e3 * self.after:7.1f} {1e3 * self.floor:6.1f}"
            f" {self.closed:6.2f} ({self.low:5.2f} to {self.high:4.2f}) {self.reporting:4}"
            f" {self.first:5.0f} {self.steps:5} {self.cpu:6.0f} {self.wall:6.0f}  {self.where}"
        )


HEADER = (
    f"{'simulator':14} {'group':>5} {'lacks':36} {'contact models':26} {'prob.':>5}"
    f" {'before':>7} {'after':>7} {'floor':>6} {'closed':>6} {'(95 %)':15} {'shots':>4}"
    f" {'first':>5} {'steps':>5} {'CPU s':>6} {'s':>6}  where (errors in mm)"
)


def write_group(folder: Path, source: Path, first: int, count: int, model: str) -> Path:
    """Write a track folder of `count` shots from number `first` on; return it."""
    with source.open(newline="") as shots, (folder / "tracks.csv").open("w", newline="") as tracks:
        writer = csv.writer(tracks, lineterminator="\n")
        writer.writerow(("shot", "frame", "t", "id", "x", "y"))
        for row in csv.DictReader(shots):
            if first <= int(row["shot"]) < first + count:
                frame = round(float(row["t"]) * FPS)
                writer.writerow((row["shot"], frame, row["t"], row["id"], row["x"], row["y"]))
    more = {} if model == "mirror" else {"model": [*DEFAULT_EFFECTS, "cushion_friction"], "laws": {"cushion": model}}
    (folder / "scene.json").write_text(json.dumps({**SCENE, "model": list(DEFAULT_EFFECTS), **more}))
    return folder


def run_case(source: Path, model: str, group: int, count: int, workers: Executor = SERIAL) -> CaromGapRow:
    """Diagnose one group of shots for one simulator."""
    firsts, steps = list[float](), list[int]()

    def note(doing: str, names: tuple[str, ...], outlook: SearchOutlook) -> None:
        steps.append(outlook.steps_done)
        best = "+".join(outlook.best or ())
        print(
            f"{time.perf_counter() - begun[1]:6.0f} s  {doing} {'+'.join(names)}  [{best}]", file=sys.stderr, flush=True
        )
        if outlook.best is not None:
            firsts.append(time.perf_counter() - begun[1])

    with tempfile.TemporaryDirectory() as scratch:
        read = read_track_folders([write_group(Path(scratch), source, group, count, model)])
    begun = _measure_cpu(), time.perf_counter()
    report = diagnose(build_gap_scene(read), read.recordings, on_progress=note, executor=workers)
    seconds = _measure_cpu() - begun[0], time.perf_counter() - begun[1]
    return _make_row(model, group, count, report, (firsts[0] if firsts else seconds[1], max(steps, default=0)), seconds)


def _measure_cpu() -> float:
    """Measure the CPU seconds of this process and its helper so far."""
    own = psutil.Process()
    return float(sum(one.cpu_times().user + one.cpu_times().system for one in (own, *own.children())))


def _make_row(
    model: str, group: int, count: int, report: DiagnosisReport, search: tuple[float, int], seconds: tuple[float, float]
) -> CaromGapRow:
    closing = report.gap.closure
    where = ", ".join(f"{one.phase} {one.share:.2f}" for one in report.where if one.share >= 0.01)
    return CaromGapRow(
        model=model, group=group, shots=count, answer=" + ".join(report.effects) or report.verdict,
        forms=" ".join(report.forms), probability=report.probability, p_value=report.p_value, before=closing.before,
        after=closing.after, floor=closing.floor, closed=closing.closed if closing.resolved else float("nan"),
        low=closing.interval[0], high=closing.interval[1], reporting=len({w.segment.shot for w in report.gap.windows}),
        where=where, rest=report.unexplained.share, first=search[0], steps=search[1], cpu=seconds[0], wall=seconds[1],
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"cushion models; default: {', '.join(MODELS)}")
    parser.add_argument("--groups", type=int, nargs="+", default=[0, 12, 24], help="first shot of each group")
    parser.add_argument("--shots", type=int, default=12, help="number of shots of a group")
    parser.add_argument("--source", type=Path, default=SOURCE, help="CSV file of the shots")
    parser.add_argument("--rows", type=Path, help="CSV file of the rows")
    parser.add_argument("--serial", action="store_true", help="use one process")
    parser.add_argument("--show", action="store_true", help="only print the table of the existing rows")
    options = parser.parse_args()
    if not options.show and not options.source.exists():
        parser.exit(message=f"the recorded shots are not there: {options.source}; name a file with --source\n")
    rows = read_rows(options.rows, CaromGapRow)
    done = {(row.model, row.group, row.shots) for row in rows}
    with nullcontext(SERIAL) if options.serial else open_executor() as workers:
        if isinstance(workers, HelperExecutor):
            workers.wait_until_ready()
        for group in () if options.show else options.groups:
            for model in options.models or MODELS:
                if (model, group, options.shots) not in done:
                    rows.append(run_case(options.source, model, group, options.shots, workers))
                    append_row(rows[-1], options.rows)
                    print(rows[-1].format_line(), flush=True)
    print(HEADER, *(row.format_line() for row in rows), sep="\n")


if __name__ == "__main__":
    main()
