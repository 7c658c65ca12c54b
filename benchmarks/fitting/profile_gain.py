"""Measure how much better a fourth shot is predicted with the profile of three earlier ones.

    python -m benchmarks.fitting.profile_gain [--quick] [--sets 20] [--rows FILE.csv]

Each set is a table of the independent simulator with unknown friction, slope and cushions. Three shots of one spinning
ball teach a profile, as `trueroll fit-table` does; a fourth one, slow enough to come to rest, is predicted from half a
second after its strike until then, with the profile and without. Interrupted runs continue from --rows. Takes half a
minute or more per set.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_statistic, run_quick
from benchmarks.support.row_files import append_row, read_rows
from benchmarks.table_cases.session_shots import LEAD_S, draw_table, play_session
from models.core.errors import TrackError
from models.estimation.forecast.ensemble_prediction import forecast_shot
from models.estimation.forecast.forecast_check import estimate_state
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.table_learning.learn_table import learn_table
from pipeline.actions.fit_table import prepare_shot, write_learned_profile
from pipeline.engine.result_cache import ResultCache
from pipeline.io.kept_values import explain_tracks
from pipeline.io.table_profile import parse_learned_table, read_profile_text

# s from the strike to the prediction, and from the strike to its end.
AHEAD_S, PREDICTED_S = 0.5, 14.0
# m/s after the strike of the fourth shot.
SLOW_SPEEDS = (0.7, 1.4)
QUICK_SETS = range(40, 43)
# Ensemble members.
DRAWS = 128
# Cushion models that are compared: fewer than in `fit-table`, to save time.
LAWS = ("mirror", "mathavan_2010")


@dataclass(frozen=True)
class GainRow:
    """Errors of one set, mm at the last frame; NaN where three shots taught too little."""

    number: int
    contacts: int
    with_profile: float
    without: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=20, help="tables (default 20)")
    parser.add_argument("--rows", type=Path, default=None, help="CSV file of the rows, from which a run continues")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        run_quick("fitting.profile_gain", measure_figures, f"tables {QUICK_SETS[0]} to {QUICK_SETS[-1]}")
        return
    rows = read_rows(arguments.rows, GainRow)
    done = {row.number for row in rows}
    for number in range(arguments.sets):
        if number in done:
            continue
        with tempfile.TemporaryDirectory() as place:
            row = play_set(number, Path(place))
        append_row(row, arguments.rows)
        rows.append(row)
        print(f"set {number}: {row.contacts} contacts, {row.with_profile:.0f} mm with the profile,"
              f" {row.without:.0f} mm without", flush=True)  # fmt: skip
    pairs = np.array([(row.with_profile, row.without) for row in rows if np.isfinite(row.with_profile)])
    if len(pairs):
        ratio = pairs[:, 0] / pairs[:, 1]
        print(f"{len(pairs)} of {len(rows)} sets: rest positions {np.median(pairs[:, 0]):.1f} mm off with the profile,"
              f" {np.median(pairs[:, 1]):.1f} mm without; better in {int((ratio < 1).sum())};"
              f" geometric mean of the ratios {np.exp(np.mean(np.log(ratio))):.2f}")  # fmt: skip


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    errors = []
    for number in QUICK_SETS:
        with tempfile.TemporaryDirectory() as place:
            row = play_set(number, Path(place))
        if np.isfinite(row.with_profile):
            errors.append((row.with_profile, row.without))
    pairs = np.array(errors)
    return [
        estimate_median("rest position with the profile: error", pairs[:, 0], "mm"),
        estimate_median("rest position without: error", pairs[:, 1], "mm"),
        estimate_statistic(
            "error with over without, geometric mean", pairs, "",
            lambda x: float(np.exp(np.mean(np.log(x[:, 0] / x[:, 1])))),
        ),
    ]  # fmt: skip


def play_set(number: int, place: Path) -> GainRow:
    """Teach a profile by three shots, and predict a fourth."""
    rng = np.random.default_rng([63, number])
    effects, law = draw_table(rng)
    teaching = play_session(rng, effects, law, place / "teaching", 3, seconds=6.0)
    [(tracks, scene)] = play_session(rng, effects, law, place / "tested", 1, SLOW_SPEEDS, PREDICTED_S)
    cache = ResultCache(place / "cache")
    fits = [prepare_shot(explain_tracks(one, own, cache)) for one, own in teaching]
    try:
        lesson = learn_table(fits, scene.table, LAWS)
    except TrackError as error:
        print(f"set {number}: {error}")
        return GainRow(number, 0, float("nan"), float("nan"))
    write_learned_profile(lesson, scene.table, 3, place / "profile.json")
    learned = parse_learned_table(read_profile_text(place / "profile.json"))
    times = tracks.t[tracks.t > LEAD_S + AHEAD_S]
    errors = []
    past = explain(tracks.truncate_after(float(times[0])), scene)
    for table in (learned, None):
        state = estimate_state(tracks, scene, float(times[0]), table, lambda *_: past)
        prediction = forecast_shot(state, times[[0, -1]], 0, DRAWS)
        errors.append(1e3 * float(np.linalg.norm(prediction.path[-1, 0] - tracks.xy[-1, 0])))
    return GainRow(number, lesson.contact_count, *errors)


if __name__ == "__main__":
    main()
