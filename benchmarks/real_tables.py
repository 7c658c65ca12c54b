"""Measure how well shots of a real table are foreseen once other shots have taught the table.

    python -m benchmarks.real_tables [--folds 3] [--shots N] [--at 2.0] [--laws NAME ...] [--work DIR] [-o rows.csv]

Recorded three-cushion shots (`../shared/data/physics/recorded_carom`): each is cut off at `--at` s, and the places of
its moving balls later are predicted, without a profile and with the profile that the shots of the other groups taught.
Every `--folds`th shot is one group, so that no shot teaches its own table. Rivals: a ball that stays, and one that
keeps its velocity. Fits are kept below DIR, so that a second call continues. Half an hour on one core, most of it for
the first fits and for the cushion model of Mathavan 2010.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.engine.process_setup import limit_garbage_collection, limit_library_threads

limit_library_threads()  # as the program does, before numpy is imported
limit_garbage_collection()

import numpy as np  # noqa: E402

from benchmarks.support.row_files import append_row, read_rows  # noqa: E402
from benchmarks.support.run_folder import ROOT  # noqa: E402
from models.core.errors import TrackError  # noqa: E402
from models.core.scene import Scene, Table  # noqa: E402
from models.core.tracks import Tracks  # noqa: E402
from models.estimation.forecast.current_state import estimate_state  # noqa: E402
from models.estimation.forecast.ensemble_prediction import ShotPrediction, forecast_shot  # noqa: E402
from models.estimation.joint_fit.fit_solution import JointSolution  # noqa: E402
from models.estimation.table_learning.correction_training import train_correction  # noqa: E402
from models.estimation.table_learning.cushion_contacts import (  # noqa: E402
    CushionContacts,
    extract_cushion_contacts,
    join_contacts,
)
from models.estimation.table_learning.learn_table import TableLesson, learn_table  # noqa: E402
from models.estimation.table_learning.learned_table import LearnedTable  # noqa: E402
from models.estimation.table_learning.side_spin import MIN_CONTACT_SPEED  # noqa: E402
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODELS  # noqa: E402
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION  # noqa: E402
from models.physics.billiards.parameter_vector import SPIN_DECAY  # noqa: E402
from models.physics.billiards.simulation.contact_resolution import rebound_with_slip  # noqa: E402
from pipeline.actions.fit_table import fit_cached_shot, prepare_shot  # noqa: E402
from pipeline.engine.result_cache import ResultCache  # noqa: E402
from pipeline.io.observed_shot import list_shot_numbers, read_observed_shot  # noqa: E402

SOURCE = ROOT.parent / "shared" / "data" / "physics" / "recorded_carom" / "shots.csv"
SCENE = {
    "scene": "billiards", "units": "m", "fps": 50, "ball_radius": 0.03075,
    "table": {"length": 2.84, "width": 1.42, "pockets": False, "name": "carom", "game": "carom"},
}  # fmt: skip
AHEAD = (0.5, 1.0, 1.5, 3.0)
"""Prediction horizons, s."""
MEASUREMENT_SIGMA = 1e-3
"""m: error of a recorded place, mostly of the calibration (residuals of long free paths)."""
Shot = tuple[JointSolution, Tracks]
"""Joint fit, and tracks with realistic sigmas."""


@dataclass(frozen=True)
class Row:
    """One ball of one shot at one horizon; errors in mm."""

    shot: int
    ball: str
    ahead: float
    cushions: int
    """Contacts of the ball with cushions on the way."""
    learned: float
    default: float
    stays: float
    straight: float
    learned_level: float
    default_level: float


def prepare_folder(work: Path) -> Path:
    """Write the recorded shots as a track folder."""
    folder = work / "tracks"
    folder.mkdir(parents=True, exist_ok=True)
    with SOURCE.open(newline="") as source, (folder / "tracks.csv").open("w", newline="") as target:
        rows = csv.writer(target, lineterminator="\n")
        rows.writerow(("shot", "frame", "t", "id", "x", "y"))
        for row in csv.DictReader(source):
            frame = round(float(row["t"]) * SCENE["fps"])  # type: ignore[operator]
            rows.writerow((row["shot"], frame, row["t"], row["id"], row["x"], row["y"]))
    (folder / "scene.json").write_text(json.dumps(SCENE) + "\n")
    return folder


def predict_both(
    tracks: Tracks, scene: Scene, at: float, learned: LearnedTable
) -> tuple[ShotPrediction, ShotPrediction]:
    """Predict with the learned table and without."""
    times = at + np.array([0.0, *AHEAD])
    with_table, without = (estimate_state(tracks, scene, at, one) for one in (learned, None))
    return forecast_shot(with_table, times), forecast_shot(without, times)


def score_shot(
    number: int, tracks: Tracks, scene: Scene, at: float, learned: LearnedTable, cache: ResultCache
) -> Iterator[Row]:
    """Score all balls that move at the cut."""
    with_table, without = predict_both(tracks, scene, at, learned)
    state, whole = with_table.state, fit_cached_shot(tracks, scene, cache)
    for ball, name in enumerate(state.ids):
        if not state.moving[ball]:
            continue
        track = tracks.ids.index(name)
        rows = np.flatnonzero(tracks.is_observed[:, track])
        first = state.mean[7 * ball : 7 * ball + 4]
        for step, ahead in enumerate(AHEAD, start=1):
            if tracks.t[rows[-1]] < at + ahead:
                continue
            true = np.array([np.interp(at + ahead, tracks.t[rows], tracks.xy[rows, track, k]) for k in (0, 1)])
            bounces = [
                one.t
                for one in (whole.graph.contacts if whole is not None else ())
                if one.kind == "cushion" and track in whole.graph.balls_at(one)  # type: ignore[union-attr]
            ]
            errors = [1e3 * float(np.hypot(*(one.path[step, ball] - true))) for one in (with_table, without)]
            noise = np.eye(2) * MEASUREMENT_SIGMA**2
            yield Row(
                number, name, ahead, sum(at < t < at + ahead for t in bounces), *errors,
                1e3 * float(np.hypot(*(true - first[:2]))),
                1e3 * float(np.hypot(*(true - first[:2] - ahead * first[2:]))),
                *(one.level(step, ball, true, noise) for one in (with_table, without)),
            )  # fmt: skip


def prepare_shots(numbers: Iterable[int], folder: Path, cache: ResultCache) -> tuple[list[Shot], Table]:
    """Fit some shots; also return their table."""
    read = [read_observed_shot(folder, number)[:2] for number in numbers]
    fits = (prepare_shot(tracks, scene, cache) for tracks, scene in read)
    return [fit for fit in fits if fit is not None], read[0][1].table


def count_false_corrections(lesson: TableLesson, contacts: CushionContacts, table: Table, count: int) -> int:
    """Count how often a network is switched on where the contacts obey the learned model and scatter about it."""
    learned, switched_on = replace(lesson.table, correction=NO_CORRECTION), 0
    for seed in range(count):
        simulated = simulate_contacts(contacts, learned, table, np.random.default_rng([34, seed]))
        trained = train_correction(
            simulated, learned.law_code, learned.physics, table.ball_radius, table.ball_mass, learned.scatter, seed
        )
        switched_on += trained is not None and trained.is_worthwhile
    return switched_on


def simulate_contacts(
    contacts: CushionContacts, learned: LearnedTable, table: Table, rng: np.random.Generator
) -> CushionContacts:
    """Replace the states after all contacts by those of the model, with its scatter and the errors of the fit."""
    radius, after, spin = table.ball_radius, np.empty_like(contacts.after), 0.0
    left = np.empty(5)
    for k in range(len(after)):
        changed = contacts.spin_sigma[k] * rng.standard_normal()
        spin = changed if contacts.begins[k] else spin + changed
        loss = learned.physics[SPIN_DECAY] * radius * contacts.elapsed[k]
        spin = float(np.sign(spin) * max(abs(spin) - loss, 0.0))
        before = np.append(contacts.before[k], spin)
        rebound_with_slip(learned.law_code, before, radius, table.ball_mass, learned.physics, left)
        left += max(contacts.speed[k], MIN_CONTACT_SPEED) * learned.scatter.draw(rng, ())
        after[k] = left[:4] + rng.multivariate_normal(np.zeros(4), contacts.covariance[k, 4:, 4:], method="eigh")
        spin = float(left[4])
    return replace(contacts, after=after)


def print_table(rows: list[Row]) -> None:
    """Print errors by horizon and by the number of cushions on the way, and the coverage of the regions."""
    print("\n| ahead | balls | learned: median, 75 % | without | stays | straight on | in 50 % | in 90 % | without |")
    print("|---|---|---|---|---|---|---|---|---|")
    groups = [(f"{ahead:g} s", [one for one in rows if one.ahead == ahead]) for ahead in AHEAD]
    longest = [one for one in rows if one.ahead == 1.5]
    groups += [(f"1.5 s, {k} cushions", [one for one in longest if one.cushions == k]) for k in range(4)]
    for name, part in groups:
        if not part:
            continue
        spread = [
            f"{np.median(v):.0f}, {np.quantile(v, 0.75):.0f} mm"
            for v in ([getattr(one, field) for one in part] for field in ("learned", "default", "stays", "straight"))
        ]
        share = [
            f"{np.mean([getattr(one, field) <= level for one in part]):.0%}"
            for field, level in (("learned_level", 0.5), ("learned_level", 0.9), ("default_level", 0.9))
        ]
        print(f"| {name} | {len(part)} | {' | '.join(spread)} | {' | '.join(share)} |")


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folds", type=int, default=3, help="number of groups of shots")
    parser.add_argument("--shots", type=int, help="only the first shots")
    parser.add_argument("--at", type=float, default=2.0, help="time of the cut, s")
    parser.add_argument("--laws", nargs="+", choices=CUSHION_MODELS, default=CUSHION_MODELS, help="cushion models")
    parser.add_argument("--control", type=int, default=20, help="simulated sets in which no correction is due")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "real_tables", help="folder of fits")
    parser.add_argument("-o", "--out", type=Path, help="CSV file of all rows, which a second call continues")
    return parser.parse_args()


def main() -> int:
    arguments = parse_arguments()
    if not SOURCE.is_file():
        print(f"the recorded shots are not at {SOURCE}", file=sys.stderr)
        return 0
    folder = prepare_folder(arguments.work)
    cache = ResultCache(arguments.work / "cache")
    numbers = list_shot_numbers(folder)[: arguments.shots]
    rows = read_rows(arguments.out, Row) if arguments.out else []
    for fold in range(arguments.folds):
        own = [n for k, n in enumerate(numbers) if k % arguments.folds == fold]
        own = [n for n in own if n not in {one.shot for one in rows}]
        if not own:
            continue
        start = time.perf_counter()
        others = [n for k, n in enumerate(numbers) if k % arguments.folds != fold]
        shots, table = prepare_shots(others, folder, cache)
        lesson = learn_table(shots, table, tuple(arguments.laws))
        models = ", ".join(f"{name} {value:.0f}" for name, value in lesson.candidates)
        print(f"group {fold}: {lesson.contact_count} contacts, {models}; {time.perf_counter() - start:.0f} s")
        for one in lesson.parameters:
            print(f"  {one.name} {one.value:.4g} +- {one.sigma:.2g} {one.unit}{' (prior)' if one.prior_only else ''}")
        print(f"  {lesson.table.scatter}; correction gains {lesson.correction_gain or 0:.0%}", flush=True)
        if fold == 0 and arguments.control:
            contacts = join_contacts(extract_cushion_contacts(fit, k)[0] for k, (fit, _) in enumerate(shots))
            wrong = count_false_corrections(lesson, contacts, table, arguments.control)
            print(f"  a network is switched on in {wrong} of {arguments.control} sets that obey the model", flush=True)
        for number in own:
            tracks, scene, _ = read_observed_shot(folder, number)
            try:
                scored = list(score_shot(number, tracks, scene, arguments.at, lesson.table, cache))
            except TrackError as refusal:
                print(f"shot {number}: {refusal}", file=sys.stderr)
                continue
            rows += scored
            for row in scored if arguments.out else ():
                append_row(row, arguments.out)
    print_table(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
