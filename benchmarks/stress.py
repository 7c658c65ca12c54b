"""Measure how often the program is sure and wrong, on real, damaged and simulated shots.

    python -m benchmarks.stress [--group real|damaged|synthetic] [--only WORD] [--damage NAME ...] [--synthetic N]
        [--seed S] [--quick] [--detections-only] [--jobs N] [--work DIR] [-o FILE.json]
    python -m benchmarks.stress --table FILE.json

Scores events, calls of first contacts, contacts and pockets, and motion without a cause, against events labelled by eye
(footage of ../shared/data), the truth of the sample clips, and the engine of `worlds/`. Prints tables and every
confident error. Damages of detections take a second per case, those of the video 10 to 20 s. `--quick` measures
simulated shots alone.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

limit_library_threads()  # as the program does, before numpy is imported
limit_garbage_collection()

from benchmarks.stress_cases.case_scores import Scores  # noqa: E402
from benchmarks.stress_cases.detection_damage import DETECTION_DAMAGES  # noqa: E402
from benchmarks.stress_cases.stress_run import DAMAGES, NONE, Plan, list_tasks, read_scores, run_synthetic  # noqa: E402
from benchmarks.stress_cases.stress_table import GROUPS, count_shares, format_report  # noqa: E402
from benchmarks.stress_cases.synthetic_shots import draw_synthetic_shot, simulate_shots  # noqa: E402
from benchmarks.stress_cases.video_damage import VIDEO_DAMAGES  # noqa: E402
from benchmarks.support.figures import Figure, add_quick_option, estimate_share, run_quick  # noqa: E402
from benchmarks.support.run_folder import FOOTAGE, ROOT  # noqa: E402

QUICK_SHOTS, QUICK_SEED = 16, 44


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="seed of the damages and of the simulated shots")
    parser.add_argument("--only", default="", help="only clips and shots whose name contains this word")
    parser.add_argument("--damage", nargs="+", choices=DAMAGES, default=DAMAGES, help="only these damages")
    parser.add_argument("--group", action="append", choices=GROUPS, help="only this group; may be repeated")
    parser.add_argument("--synthetic", type=int, default=100, help="number of simulated shots")
    parser.add_argument("--detections-only", action="store_true", help="leave out the damages of the video")
    add_quick_option(parser)
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "stress", help="folder of damaged clips and shots")
    parser.add_argument("-o", "--out", type=Path, help="JSON file of all rows")
    parser.add_argument("--table", type=Path, help="print the tables of this JSON file, and run nothing")
    return parser.parse_args()


def run_tasks(tasks: Sequence[Callable[[], Scores]], jobs: int) -> Iterator[Scores]:
    """Run tasks in this process, or in several ones, and yield their rows in order."""
    if jobs <= 1:
        yield from (task() for task in tasks)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for running in [pool.submit(task) for task in tasks]:
            yield running.result()


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation; a crash has no place in them."""
    scores = Scores()
    with tempfile.TemporaryDirectory() as folder:
        plan = Plan((NONE, *DETECTION_DAMAGES), QUICK_SEED, Path(folder))
        simulate_shots([draw_synthetic_shot(QUICK_SEED, number) for number in range(QUICK_SHOTS)], plan.work / "shots")
        for number in range(QUICK_SHOTS):
            scores.add(run_synthetic(number, plan))
    if scores.crashes:
        raise RuntimeError(scores.crashes[0].text)
    return [estimate_share(name, hits, n) for name, (hits, n) in count_shares(scores).items()]


def main() -> int:
    arguments = parse_arguments()
    if arguments.quick:
        inputs = f"{QUICK_SHOTS} simulated shots, damages of detections, seed {QUICK_SEED}"
        run_quick("stress", measure_figures, inputs)
        return 0
    if arguments.table:
        print(format_report(read_scores(arguments.table)))
        return 0
    damages = tuple(name for name in DAMAGES if name in arguments.damage)
    if arguments.detections_only:
        damages = tuple(name for name in damages if name not in VIDEO_DAMAGES)
    plan, scores = Plan(damages, arguments.seed, arguments.work.absolute()), Scores()
    if not FOOTAGE.is_dir():
        scores.skipped.append(f"real footage is not at {FOOTAGE}")
    tasks = list(list_tasks(tuple(arguments.group or GROUPS), arguments.only, arguments.synthetic, plan))
    for part in run_tasks(tasks, arguments.jobs):
        scores.add(part)
        if arguments.out:  # after every task, so that an interrupted run leaves its rows
            arguments.out.write_text(json.dumps(asdict(scores)) + "\n")
    print(format_report(scores))
    return 0


if __name__ == "__main__":
    sys.exit(main())
