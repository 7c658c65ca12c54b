"""Measure players' numbers of foreign shots, and check whether the stated standard deviations hold.

    python -m benchmarks.fitting.shot_numbers_check [SEEDS] [FIRST] [--quick] [--noise MM] [--out DIR] [--laws]

The truth is worlds/billiards.py, run as a process: three balls, a random table, cue speeds of 1.2 to 3.5 m/s with
arbitrary top and side spin, two cushion models, friction of balls that falls with speed; 60 fps, Gaussian noise per
axis. Every shot is fitted as `trueroll run` fits it. Printed: per number the shots in which it is observable, median
and 95 % quantile of the error, and the share of errors within one and two stated standard deviations (expected: 68 and
95 %). Rows are kept in DIR, so that a second call resumes. Takes about ten seconds per shot.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv

from benchmarks.fitting.prediction_shots import IDS, LAWS, LEAD, film_shot, overhead_scene, simulate_shot
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_statistic, run_quick
from models.core.events import Events
from models.core.options import FitOptions
from models.core.typing import FloatArray
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import CONTACT_NUMBERS, evaluate_contact, measure_shots
from models.estimation.whole_shot.whole_shot_fit import fit_shot_laws
from models.physics.billiards.simulation.parametrised_shot import convert_to_starts

# Of each cushion model.
QUICK_SEEDS = range(30, 34)
# Numbers that nearly every shot determines, and their units.
QUICK_NUMBERS = {
    "cue_speed": "m/s",
    "top_spin_share": "",
    "contact_speed": "m/s",
    "cut_angle": "deg",
    "object_speed": "m/s",
}
# s that are filmed.
SECONDS = 4.0
# Least standard deviation, in the unit of each number: a rolling ball has a spin share of 1 without any error.
RESOLUTION = 1e-3
# s between the true and the measured first contact, at most: farther apart, another contact was measured.
SAME_CONTACT = 0.03
STRIKE_NUMBERS = ("cue_speed", "top_spin", "top_spin_share", "side_spin", "side_spin_share")
STATE_COLUMNS = ("x", "y", "vx", "vy", "wx", "wy", "wz")


def read_truth(folder: Path, until: float) -> dict[str, float]:
    """Read the true numbers of a simulated shot; those of the contact only if it happens within `until` s."""
    rows = pyarrow.csv.read_csv(folder / "trajectory.csv")
    states = np.stack([rows[name].to_numpy() for name in STATE_COLUMNS], axis=1).reshape(-1, len(IDS), 7)
    t = rows["t"].to_numpy().reshape(-1, len(IDS))[:, 0]
    content = json.loads((folder / "shot.json").read_text())
    radius, cue = content["balls"][0]["radius"], states[0, 0]
    speed = float(np.hypot(*cue[2:4]))
    top, side = float(cue[5] * cue[2] - cue[4] * cue[3]) / speed, -float(cue[6])
    truth = dict(zip(STRIKE_NUMBERS, (speed, top, radius * top / speed, side, radius * side / speed), strict=True))
    events = pyarrow.csv.read_csv(folder / "events.csv").to_pylist()
    own = [one for one in events if one["kind"] in ("ball", "cushion") and IDS[0] in (one["a"], one["b"])]
    first = next((k for k, one in enumerate(own) if one["kind"] == "ball"), None)
    if first is None or own[first]["t"] > until:
        return truth
    meeting = own[first]
    other = IDS.index(meeting["b"] if meeting["a"] == IDS[0] else meeting["a"])
    nexts = [one["t"] for one in own[first + 1 :]]
    friction = content["effects"]["sliding_friction"]["mu"]
    contact = _states_around(
        t, convert_to_starts(states, np.full(len(IDS), radius)), meeting["t"], other, nexts, friction
    )
    truth["contact_time"] = LEAD + meeting["t"]
    return truth | dict(zip((name for name, _ in CONTACT_NUMBERS), evaluate_contact(contact).tolist(), strict=True))


def _states_around(
    t: FloatArray, states: FloatArray, at: float, other: int, nexts: list[float], friction: float
) -> FloatArray:
    """Return the states (5, 6) around a contact from samples, continued to the moment of contact."""
    row = int(np.searchsorted(t, at, side="right")) - 1
    before, after = states[row - 1, [0, other], :6].copy(), states[row + 1, [0, other], :6].copy()
    slope = (states[row - 1] - states[row - 2])[[0, other], :6] / (t[1] - t[0])
    before += slope * (at - t[row - 1])
    later = (states[row + 2] - states[row + 1])[[0, other], :6] / (t[1] - t[0])
    after += later * (at - t[row + 1])
    slide = 2 / 7 * float(np.hypot(*after[0, 4:6])) / (friction * 9.81)
    end = min([at + slide, *(one - 2e-3 for one in nexts[:1])])
    return np.vstack([before, after, states[min(int(np.searchsorted(t, end)), len(t) - 1), :1, :6]])


def measure_case(seed: int, law: str, noise: float, folder: Path, options: FitOptions) -> dict[str, Any]:
    """Fit one shot; returns truth, estimate and sigma by number."""
    shot = simulate_shot(seed, law, folder)
    tracks, scene = film_shot(shot, SECONDS, seed, noise), overhead_scene()
    explained = explain(tracks, scene, options)
    fit, solution = view_shot(explained), explained.solution
    fit = replace(fit, laws=fit_shot_laws(fit, tracks, scene.table, options))
    truth = read_truth(folder / f"shot_{seed}_{law}", SECONDS - 0.5)
    row: dict[str, Any] = {"seed": seed, "law": law, "noise": noise, "whole": fit.whole_shot is not None, "numbers": {}}
    shots = () if solution is None else measure_shots(fit, solution, tracks, scene.table)
    row["first_contact"] = [truth.pop("contact_time", None), _find_first_contact(fit.events)]
    for one in shots[0].numbers if shots else ():
        if one.name in truth and one.name not in row["numbers"]:
            row["numbers"][one.name] = [truth[one.name], one.value, one.sigma, one.observable]
    return row


def _find_first_contact(events: Events) -> float | None:
    """Return when the cue ball touches a ball first, s; None if it does not."""
    rows = (k for k in range(len(events)) if events.kind[k] == "ball" and IDS[0] in (events.a[k], events.b[k]))
    return next((float(events.t[k]) for k in rows if events.probability[k] >= 0.5), None)


def run_cases(arguments: argparse.Namespace, path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of all cases; those that are already in the file are not fitted again."""
    cases = [(seed, law) for seed in range(arguments.first, arguments.first + arguments.seeds) for law in LAWS]
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    finished = {(row["seed"], row["law"]): row for row in rows}
    options = FitOptions(laws=True) if arguments.laws else FitOptions()
    for seed, law in cases:
        if (seed, law) not in finished:
            row = measure_case(seed, law, 1e-3 * arguments.noise, arguments.out, options)
            with path.open("a") as file:
                file.write(json.dumps(row) + "\n")
            print(f"{law} {seed}: {'whole shot' if row['whole'] else 'segments'}", file=sys.stderr, flush=True)
            finished[(seed, law)] = row
        yield finished[(seed, law)]


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation; the numbers of one shot err together, so a shot is one case."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [
            measure_case(seed, law, 1e-3, Path(folder), FitOptions()) for seed in QUICK_SEEDS for law in LAWS
        ]  # fmt: skip
    remove_other_contacts(rows)
    figures = [
        estimate_median(f"{name}: error", [abs(one[1] - one[0]) for one in own], unit)
        for name, unit in QUICK_NUMBERS.items()
        if len(own := [row["numbers"][name] for row in rows if row["numbers"].get(name, [False])[-1]]) > 1
    ]
    pulls = [[abs(e - t) / max(s, RESOLUTION) for t, e, s, good in row["numbers"].values() if good] for row in rows]
    for limit in (1, 2):
        counts = np.array([[sum(pull < limit for pull in own), len(own)] for own in pulls], float)
        figures.append(
            estimate_statistic(f"all numbers: within {limit} stated sigma", counts, "%", lambda x: 100 * _ratio(x))
        )
    return figures


def _ratio(counts: FloatArray) -> float:
    return float(counts[:, 0].sum() / counts[:, 1].sum())


def remove_other_contacts(rows: list[dict[str, Any]]) -> int:
    """Remove the numbers of the contact where another first contact was measured; returns in how many shots."""
    missed = [row for row in rows if not _is_same_contact(row)]
    for row in missed:
        row["numbers"] = {name: one for name, one in row["numbers"].items() if name in STRIKE_NUMBERS}
    return len(missed)


def _is_same_contact(row: dict[str, Any]) -> bool:
    true, measured = row["first_contact"]
    if true is None or measured is None:
        return true is measured
    return abs(true - measured) < SAME_CONTACT


def print_table(rows: list[dict[str, Any]]) -> None:
    missed = remove_other_contacts(rows)
    print(
        f"{len(rows)} shots, {sum(row['whole'] for row in rows)} explained whole; in {missed} another first"
        " contact was measured, whose numbers are left out\n"
    )
    print("| number | observable | of | median error | 95 % of errors below | within 1 sigma | within 2 sigma |")
    print("|---|---|---|---|---|---|---|")
    for name in (*STRIKE_NUMBERS, *(name for name, _ in CONTACT_NUMBERS)):
        own = [row["numbers"][name] for row in rows if name in row["numbers"]]
        good = np.array([one[:3] for one in own if one[3]], dtype=float).reshape(-1, 3)
        if not len(good):
            print(f"| {name} | 0 | {len(own)} | | | | |")
            continue
        error = abs(good[:, 1] - good[:, 0])
        pull = error / np.maximum(good[:, 2], RESOLUTION)
        print(
            f"| {name} | {len(good)} | {len(own)} | {np.median(error):.3g} | {np.quantile(error, 0.95):.3g}"
            f" | {np.mean(pull < 1):.0%} | {np.mean(pull < 2):.0%} |"
        )
    speed = [row["numbers"]["cue_speed"] for row in rows if "cue_speed" in row["numbers"]]
    cut = [row["numbers"]["cut_angle"] for row in rows if row["numbers"].get("cut_angle", [0, 0, 0, False])[3]]
    if speed and cut:
        print(
            f"\nspeed within 1 %: {np.mean([abs(e / t - 1) < 0.01 for t, e, *_ in speed]):.0%};"
            f" cut angle within 0.5 deg: {np.mean([abs(e - t) < 0.5 for t, e, *_ in cut]):.0%}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="?", type=int, default=20, help="number of shots per cushion model")
    parser.add_argument("first", nargs="?", type=int, default=0, help="first seed")
    parser.add_argument("--noise", type=float, default=1.0, help="noise of a position per axis, mm")
    parser.add_argument("--laws", action="store_true", help="complete the search for contact models, as run --laws")
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_shot_numbers",
                        help="folder of the simulated shots and the rows")  # fmt: skip
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.quick:
        inputs = f"shots {QUICK_SEEDS[0]} to {QUICK_SEEDS[-1]} of each cushion model, noise of 1 mm; medians"
        run_quick("fitting.shot_numbers_check", measure_figures, inputs)
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = arguments.out / f"rows_{arguments.noise:g}mm{'_laws' if arguments.laws else ''}.jsonl"
    print_table(list(run_cases(arguments, path)))


if __name__ == "__main__":
    main()
