"""Measure how well shots of a real table are foreseen once other shots have taught the table.

    python -m benchmarks.real_tables [--groups 0 1 2] [--shots N] [--score N] [--laws NAME ...] [--work DIR]

Recorded three-cushion shots (`../shared/data/physics/recorded_carom`): each is cut off at `--at` s, and the places of
its moving balls later are predicted. Every `--folds`th shot is one group, so that no shot teaches its own table. The
rivals are a ball that stays; one that keeps its velocity; no profile; the best published cushion model with learned
parameters but no network, and with the values of the catalogue; a network without physics, trained on the last second.
Then whole shots from the state after a second; sets of contacts on which no network is due, and such of a cushion of no
published form; rest positions of the snooker clips. pooltool is no rival here: see benchmarks/README.md. Fits, lessons
and rows are kept below DIR, so that a second call continues. An hour on one core with the defaults; the model of
Mathavan 2010 (`--laws`) takes half of it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

limit_library_threads()  # as the program does, before numpy is imported
limit_garbage_collection()

import numpy as np  # noqa: E402

from benchmarks.fitting import snooker_physics  # noqa: E402
from benchmarks.support.row_files import append_row, read_rows  # noqa: E402
from benchmarks.support.run_folder import FOOTAGE, ROOT  # noqa: E402
from benchmarks.table_cases.contact_controls import count_false_corrections, measure_foreign_gains  # noqa: E402
from benchmarks.table_cases.recorded_shots import (  # noqa: E402
    SOURCE,
    Shot,
    interpolate_place,
    list_contact_times,
    prepare_folder,
    prepare_shots,
)
from benchmarks.table_cases.rival_predictions import extrapolate_by_network, remove_network, use_catalogue  # noqa: E402
from benchmarks.table_cases.whole_shot_predictions import WholeShotRow, print_whole_shots, score_whole_shot  # noqa: E402
from models.core.errors import TrackError  # noqa: E402
from models.core.scene import Scene, Table  # noqa: E402
from models.core.tracks import Tracks  # noqa: E402
from models.estimation.forecast.ensemble_prediction import forecast_shot  # noqa: E402
from models.estimation.forecast.forecast_check import estimate_state  # noqa: E402
from models.estimation.reconstruction.explain_shot import explain  # noqa: E402
from models.estimation.table_learning.cushion_contacts import CushionContacts, extract_cushion_contacts, join_contacts  # noqa: E402
from models.estimation.table_learning.learn_table import TableLesson, learn_table  # noqa: E402
from models.estimation.table_learning.learned_table import LearnedTable  # noqa: E402
from models.physics.billiards.contact_models import CUSHION_MODELS  # noqa: E402
from pipeline.engine.result_cache import CacheKey, ResultCache  # noqa: E402
from pipeline.engine.source_fingerprint import hash_sources  # noqa: E402
from pipeline.engine.value_files import load_value, save_value  # noqa: E402
from pipeline.io.observed_shot import list_shot_numbers, read_observed_shot  # noqa: E402

# Prediction horizons, s.
AHEAD = (0.5, 1.0, 1.5, 3.0)
# m: error of a recorded place, mostly of the calibration (residuals of long free paths).
MEASUREMENT_SIGMA = 1e-3
# Columns of errors.
RIVALS = ("learned", "published", "catalogue", "default", "network", "stays", "straight")


@dataclass(frozen=True)
class Row:
    """One ball of one shot at one horizon; errors in mm."""

    group: int
    shot: int
    ball: str
    ahead: float
    cushions: int
    """Contacts of the ball with cushions on the way."""
    learned: float
    published: float
    catalogue: float
    default: float
    network: float
    stays: float
    straight: float
    learned_level: float
    published_level: float
    default_level: float


def score_shot(
    group: int, number: int, tracks: Tracks, scene: Scene, tables: tuple[LearnedTable | None, ...],
    arguments: argparse.Namespace, cache: ResultCache,
) -> Iterator[Row]:  # fmt: skip
    """Score all balls that move at the cut, for the tables learned, published, catalogue and none."""
    at, times = arguments.at, arguments.at + np.array([0.0, *AHEAD])
    past = explain(tracks.truncate_after(at), scene)
    states = (estimate_state(tracks, scene, at, table, lambda *_: past) for table in tables)
    predictions = [forecast_shot(state, times, draws=arguments.draws) for state in states]
    state = predictions[0].state
    for ball, name in enumerate(state.ids):
        if not state.moving[ball]:
            continue
        track = tracks.ids.index(name)
        first = state.mean[7 * ball : 7 * ball + 4]
        bounces = np.array(list_contact_times(tracks, scene, cache, track))
        contacts = list_contact_times(tracks, scene, cache, track, ("strike", "ball", "cushion"))
        since = max((t for t in contacts if t < at), default=0.0)
        alone = extrapolate_by_network(tracks, track, since, at, AHEAD, arguments.network_seconds)
        for step, ahead in enumerate(AHEAD, start=1):
            if tracks.t[np.flatnonzero(tracks.is_observed[:, track])[-1]] < at + ahead:
                continue
            true = interpolate_place(tracks, track, at + ahead)
            places = [one.path[step, ball] for one in predictions]
            places += [alone[step - 1], first[:2], first[:2] + ahead * first[2:]]
            noise = np.eye(2) * MEASUREMENT_SIGMA**2
            levels = [predictions[k].level(step, ball, true, noise) for k in (0, 1, 3)]
            yield Row(
                group, number, name, ahead, int(np.sum((bounces > at) & (bounces < at + ahead))),
                *(1e3 * float(np.hypot(*(place - true))) for place in places), *levels,
            )  # fmt: skip


def learn_cached_table(
    shots: list[Shot], numbers: list[int], table: Table, laws: tuple[str, ...], cache: ResultCache
) -> TableLesson:
    """Learn a table, or read what was learned."""
    parts = {"shots": numbers, "laws": list(laws), "source": hash_sources(learn_table.__module__)}

    def build(folder: Path) -> None:
        save_value(learn_table(shots, table, laws), folder)

    return load_value(TableLesson, cache.find_or_build(CacheKey("real-tables-lesson", parts), build).folder)


def print_lesson(group: int, lesson: TableLesson, seconds: float) -> None:
    models = ", ".join(f"{name} {value:.0f}" for name, value in lesson.candidates)
    print(f"group {group}: {lesson.contact_count} contacts, {models}; {seconds:.0f} s")
    for one in lesson.parameters:
        print(f"  {one.name} {one.value:.4g} +- {one.sigma:.2g} {one.unit}{' (prior)' if one.prior_only else ''}")
    offsets = zip(1e3 * lesson.table.noses, 1e3 * lesson.table.nose_sigma, strict=True)
    noses = ", ".join(f"{value:.1f} +- {sigma:.1f}" for value, sigma in offsets)
    print(f"  noses {noses} mm; {lesson.table.scatter}; correction gains {lesson.correction_gain or 0:.0%}", flush=True)


def print_controls(
    learned: LearnedTable, contacts: CushionContacts, table: Table, arguments: argparse.Namespace
) -> None:
    """Print how the network behaves where it is not due, and on a cushion of no published form."""
    if arguments.control:
        wrong = count_false_corrections(learned, contacts, table, arguments.control)
        print(f"  a network is switched on in {wrong} of {arguments.control} sets that obey the model", flush=True)
    for seed in range(arguments.foreign):
        network, oracle = measure_foreign_gains(learned, contacts, table, seed)
        print(
            f"  foreign cushion {seed}: the network removes {network:.0%} of the squared deviation, the true cushion"
            f" {oracle:.0%}: {network / oracle:.0%} of what is possible",
            flush=True,
        )


def print_table(rows: list[Row]) -> None:
    """Print errors by horizon and by the number of cushions on the way, and the coverage of the regions."""
    print(f"\n| ahead | balls | {' | '.join(RIVALS)} | 50 %, 90 % region | published | without a profile |")
    print("|---" * (len(RIVALS) + 5) + "|")
    groups = [(f"{ahead:g} s", [one for one in rows if one.ahead == ahead]) for ahead in AHEAD]
    longest = [one for one in rows if one.ahead == 1.5]
    groups += [(f"1.5 s, {k} cushions", [one for one in longest if one.cushions == k]) for k in range(4)]
    groups += [(f"1.5 s, group {k}", [one for one in longest if one.group == k]) for k in range(3)]
    for name, part in groups:
        if not part:
            continue
        cells = []
        for rival in RIVALS:
            values = np.array([getattr(one, rival) for one in part])
            values = values[np.isfinite(values)]
            cells.append(f"{np.median(values):.0f}, {np.quantile(values, 0.75):.0f}" if len(values) else "-")
        for field in ("learned_level", "published_level", "default_level"):
            levels = np.array([getattr(one, field) for one in part])
            cells.append(f"{np.mean(levels <= 0.5):.0%}, {np.mean(levels <= 0.9):.0%}")
        print(f"| {name} | {len(part)} | {' | '.join(cells)} |")
    print("errors in mm: median, 75 % quantile; regions: share of the places inside")


def score_group(
    group: int, numbers: list[int], arguments: argparse.Namespace, cache: ResultCache, folder: Path
) -> None:
    """Learn the table of one group from the other shots, and append the scores of its own."""
    rows_file, whole_file = arguments.work / "rows.csv", arguments.work / "whole.csv"
    own = [n for k, n in enumerate(numbers) if k % arguments.folds == group]
    done = {one.shot for one in read_rows(whole_file, WholeShotRow)}
    start = time.perf_counter()
    others = [n for k, n in enumerate(numbers) if k % arguments.folds != group]
    shots, table = prepare_shots(others, folder, cache)
    lesson = learn_cached_table(shots, others, table, tuple(arguments.laws), cache)
    print_lesson(group, lesson, time.perf_counter() - start)
    contacts = join_contacts(extract_cushion_contacts(fit, table, k)[0] for k, (fit, _) in enumerate(shots))
    published = remove_network(lesson.table, contacts, table.ball_radius, table.ball_mass)
    tables = lesson.table, published, use_catalogue(lesson.table), None
    for number in own[: arguments.score]:
        if number in done:
            continue
        tracks, scene, _ = read_observed_shot(folder, number)
        try:
            scores = list(score_shot(group, number, tracks, scene, tables, arguments, cache))
            whole = list(score_whole_shot(group, number, tracks, scene, lesson.table, cache))
        except TrackError as refusal:
            print(f"shot {number}: {refusal}", file=sys.stderr)
            continue
        for row in scores:
            append_row(row, rows_file)
        for one in whole:
            append_row(one, whole_file)
    if group == arguments.groups[0]:
        print_controls(published, contacts, table, arguments)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folds", type=int, default=3, help="number of groups of shots")
    parser.add_argument("--groups", type=int, nargs="+", default=[0, 1, 2], help="groups to score")
    parser.add_argument("--shots", type=int, help="only the first shots")
    parser.add_argument("--score", type=int, help="only the first shots of each group")
    parser.add_argument("--at", type=float, default=2.0, help="time of the cut, s")
    parser.add_argument("--laws", nargs="+", choices=CUSHION_MODELS, default=CUSHION_MODELS, help="cushion models")
    parser.add_argument("--draws", type=int, default=256, help="ensemble members")
    parser.add_argument("--network-seconds", type=float, default=3.0, help="CPU time of each network without physics")
    parser.add_argument("--control", type=int, default=20, help="simulated sets in which no correction is due")
    parser.add_argument("--foreign", type=int, default=3, help="simulated sets of a cushion of no published form")
    parser.add_argument("--snooker", type=Path, help="folder of runs of the snooker clips; none: skip them")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "real_tables", help="folder of fits and rows")
    return parser.parse_args()


def main() -> int:
    arguments = parse_arguments()
    if SOURCE.is_file():
        folder, cache = prepare_folder(arguments.work), ResultCache(arguments.work / "cache")
        numbers = list_shot_numbers(folder)[: arguments.shots]
        for group in arguments.groups:
            score_group(group, numbers, arguments, cache, folder)
        print_table(read_rows(arguments.work / "rows.csv", Row))
        print_whole_shots(read_rows(arguments.work / "whole.csv", WholeShotRow))
    else:
        print(f"the recorded shots are not at {SOURCE}", file=sys.stderr)
    if arguments.snooker and FOOTAGE.is_dir():
        shots = list(snooker_physics.read_shots(arguments.snooker, reuse=True))
        snooker_physics.print_rests(shots, snooker_physics.print_friction(shots))
    else:
        print("snooker clips: skipped, without --snooker or footage", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
