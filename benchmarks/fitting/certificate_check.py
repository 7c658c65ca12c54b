"""Measure whether certificates of equal tables agree, and whether those of different tables are told apart.

    python -m benchmarks.fitting.certificate_check [--quick] [--trials 12] [--shots 6] [--rows FILE.csv]

Each trial is a table of the independent simulator with unknown friction, slope and cushions. Two sessions are played on
it, and a third one on the same table with 1 mm/m more slope along its length and 2 % less restitution. Shots have one
spinning ball, 6 s long, filmed at 50 Hz with 0.5 mm of noise. Every session gets a certificate; `trueroll certify
--compare` decides. Interrupted runs continue from --rows. Takes a minute or more per trial.
"""

from __future__ import annotations

import argparse
import copy
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.support.figures import Figure, add_quick_option, estimate_share, run_quick
from benchmarks.support.row_files import append_row, read_rows
from benchmarks.table_cases.session_shots import Effects, draw_table, play_session
from models.core.errors import TrackError
from models.estimation.table_learning.learn_table import learn_table
from models.estimation.table_learning.table_measurements import compute_roll_out, measure_table
from pipeline.actions.fit_table import prepare_shot
from pipeline.engine.result_cache import ResultCache
from pipeline.io.certificate_files import compare_certificates, describe_certificate
from pipeline.io.kept_values import explain_tracks

# mm/m, and factor, of the other table.
MORE_SLOPE, LESS_RESTITUTION = 1.0, 0.98
# Cushion models that are compared: fewer than in `certify`, to save time.
LAWS = ("mirror", "mathavan_2010")
# Trials of `--quick`, and shots of a session.
QUICK_TRIALS, QUICK_SHOTS = (20,), 6
# Numbers that are checked.
CHECKED = ("slope_x", "slope_y", "roll_out", "restitution", "sliding_friction", "length", "width")


@dataclass(frozen=True)
class CertificateRow:
    """One number of two sessions."""

    trial: int
    pair: str
    """`same` or `other`."""
    name: str
    truth: float
    """Of the first session; NaN where the simulator has no such number."""
    first: float
    second: float
    first_sigma: float
    sigma: float
    """Of the difference."""
    differs: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=12, help="tables (default 12)")
    parser.add_argument("--shots", type=int, default=6, help="shots of a session (default 6)")
    parser.add_argument("--rows", type=Path, default=None, help="CSV file of the rows, from which a run continues")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        trials = ", ".join(map(str, QUICK_TRIALS))
        inputs = f"numbers of table {trials}, three sessions of {QUICK_SHOTS} shots"
        run_quick("fitting.certificate_check", measure_figures, inputs)
        return
    rows = read_rows(arguments.rows, CertificateRow)
    done = {row.trial for row in rows}
    for trial in range(arguments.trials):
        if trial in done:
            continue
        with tempfile.TemporaryDirectory() as place:
            fresh = play_trial(trial, arguments.shots, Path(place))
        for row in fresh:
            append_row(row, arguments.rows)
        rows += fresh
        print(f"trial {trial}: {format_trial(fresh)}", flush=True)
    print_summary(rows)


def play_trial(trial: int, shots: int, place: Path) -> list[CertificateRow]:
    """Play three sessions, certify them, and compare."""
    rng = np.random.default_rng([36, trial])
    effects, law = draw_table(rng)
    other = copy.deepcopy(effects)
    other["slope"]["slope_x"] += MORE_SLOPE
    other["cushion_restitution"]["e"] *= LESS_RESTITUTION
    documents = []
    for name, own in (("first", effects), ("second", effects), ("other", other)):
        try:
            documents.append(certify_session(rng, own, law, shots, place / name))
        except TrackError as error:
            print(f"trial {trial}: {error}")
            return []
    truth = describe_truth(effects)
    rows = []
    for pair, second in (("same", documents[1]), ("other", documents[2])):
        for one in compare_certificates(documents[0], second):
            if one.name in CHECKED:
                sigma = float(documents[0]["numbers"][one.name]["sigma"])  # type: ignore[index]
                true = truth.get(one.name, float("nan"))
                rows.append(
                    CertificateRow(
                        trial, pair, one.name, true, one.first, one.second, sigma, one.sigma, int(one.differs)
                    )
                )  # fmt: skip
    return rows


def certify_session(rng: np.random.Generator, effects: Effects, law: str, shots: int, place: Path) -> dict[str, object]:
    """Play a session and certify its table."""
    session, cache = play_session(rng, effects, law, place, shots), ResultCache(place / "cache")
    fits = []
    for tracks, scene in session:
        try:
            fits.append(prepare_shot(explain_tracks(tracks, scene, cache)))
        except TrackError:
            continue
    table = session[0][1].table
    measured = measure_table(learn_table(fits, table, LAWS), fits, table)
    return describe_certificate(table, measured, (), len(fits), (), 0)


def describe_truth(effects: Effects) -> dict[str, float]:
    """Return the true numbers that the simulator defines."""
    return {
        "slope_x": effects["slope"]["slope_x"],
        "slope_y": effects["slope"]["slope_y"],
        "roll_out": compute_roll_out(effects["rolling_resistance"]["mu"], 0.0, 2.0),
        "sliding_friction": effects["sliding_friction"]["mu"],
        "length": 2.54,
        "width": 1.27,
    }


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation."""
    rows: list[CertificateRow] = []
    for trial in QUICK_TRIALS:
        with tempfile.TemporaryDirectory() as place:
            rows += play_trial(trial, QUICK_SHOTS, Path(place))
    same, other = ([row for row in rows if row.pair == pair] for pair in ("same", "other"))
    changed = [row for row in other if row.name in ("slope_x", "restitution")]
    known = [row for row in same if np.isfinite(row.truth)]
    return [
        estimate_share("same table: not called different", sum(not row.differs for row in same), len(same)),
        estimate_share(
            "same table: within 2 sigma of each other",
            sum(abs(row.second - row.first) <= 2 * row.sigma for row in same), len(same),
        ),
        estimate_share(
            "within 2 sigma of the truth",
            sum(abs(row.first - row.truth) <= 2 * row.first_sigma for row in known), len(known),
        ),
        estimate_share("changed slope or restitution: told apart", sum(row.differs for row in changed), len(changed)),
    ]  # fmt: skip


def format_trial(rows: list[CertificateRow]) -> str:
    """Format which numbers differed."""
    return "; ".join(
        f"{pair}: {', '.join(row.name for row in rows if row.pair == pair and row.differs) or 'nothing'} differs"
        for pair in ("same", "other")
    )


def print_summary(rows: list[CertificateRow]) -> None:
    """Print agreement, power and calibration per number."""
    trials = sorted({row.trial for row in rows})
    alarmed = {row.trial for row in rows if row.pair == "same" and row.differs}
    print(f"{len(trials)} tables; no number of the same table differs: {len(trials) - len(alarmed)}")
    print(f"{'number':18s}{'same: within 2 sigma':>22s}{'called different':>18s}{'sigma':>10s}{'z of truth':>12s}"
          f"{'other table: told apart':>26s}")  # fmt: skip
    for name in CHECKED:
        same = [row for row in rows if row.name == name and row.pair == "same"]
        other = [row for row in rows if row.name == name and row.pair == "other"]
        if not same:
            continue
        within = sum(abs(row.second - row.first) <= 2 * row.sigma for row in same)
        z = np.array([(row.first - row.truth) / row.first_sigma for row in same])
        spread = f"{np.sqrt(np.nanmean(z**2)):.2f}" if np.isfinite(z).any() else "-"
        apart = f"{sum(row.differs for row in other)}/{len(other)}" if name in ("slope_x", "restitution") else "-"
        print(f"{name:18s}{within:>16d}/{len(same):<5d}{sum(r.differs for r in same):>18d}"
              f"{np.median([row.sigma for row in same]):10.4f}{spread:>12s}{apart:>26s}")  # fmt: skip


if __name__ == "__main__":
    main()
