"""Measure how often stated events of rallies are right: the shares in `models.estimation.rally.event_chances`.

    python -m benchmarks.calibrate_rallies [--rallies 10] [--seed 5000] [--missing 0.1] [--clutter 3]

A simulated rally is explained from its true places with noise, gaps and clutter, as by `benchmarks.courts
--from-truth`, and every event of the explanation is compared with the truth: it is right where one of its kind happens
within three frames. Shares are means after Jeffreys' prior. Events that break the rules are counted in the truth. The
seed is none of those of `benchmarks.courts` that documents state. The share of the evidence that counts is the one of
least cost. Takes some seconds per rally; the table is printed after each round of sports.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.court_cases.court_answers import Impairment, make_candidates
from benchmarks.court_cases.court_clips import CourtCase, CourtTruth, film_case, read_truth
from benchmarks.court_cases.court_scores import CERTAIN_FRAMES
from benchmarks.courts import SPORTS
from models.core.progress import ignore_progress
from models.core.rally import Rally, RallyEvent
from models.estimation.rally.event_chances import DEPARTURE, EVIDENCE_SHARE, LOW_HIT, SLIP, UNSEEN_START
from models.estimation.rally.explain_rally import combine_explanations, find_explanations
from models.estimation.rally.play_order import advance_play, locate_event, start_play
from models.estimation.rally.rally_building import is_low

# Probability from which nothing speaks against an event.
SURE = 0.99
EVIDENCE_SHARES = (0.1, 0.25, 0.5, 1.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rallies", type=int, default=10, help="per sport")
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--missing", type=float, default=0.1)
    parser.add_argument("--clutter", type=float, default=3.0)
    parser.add_argument("--out", type=Path, default=Path("out/courts"))
    options = parser.parse_args()
    counts = {name: [0, 0] for name in ("unseen start", "low hit", "wrong though sure", "against the rules")}
    costs, console = dict.fromkeys(EVIDENCE_SHARES, 0.0), Console()
    for number in range(options.rallies):
        for sport in SPORTS:
            truth = read_truth(film_case(CourtCase(sport, number, options.seed, (2, 6)), options.out))
            candidates = make_candidates(truth, Impairment(options.missing, options.clutter))
            t = truth.columns["t"]
            explanations = find_explanations(truth.scene, candidates, np.arange(len(t)), t, ignore_progress)
            for name, is_counted in classify_events(truth, combine_explanations(explanations)):
                counts[name][0] += is_counted
                counts[name][1] += 1
            for k, count in enumerate(count_departures(truth)):
                counts["against the rules"][k] += count
            for share in costs:
                costs[share] += weigh_statements(truth, combine_explanations(explanations, share))
        console.print(make_table(counts, costs, 3 * (number + 1)))


def make_table(counts: dict[str, list[int]], costs: dict[float, float], rallies: int) -> Table:
    """Make the table of shares, and of the cost of statements by the share of the evidence that counts."""
    table = Table(f"{rallies} rallies", "counted", "of", "share", "the program's")
    for (name, (part, whole)), value in zip(counts.items(), (UNSEEN_START, LOW_HIT, SLIP, DEPARTURE), strict=True):
        table.add_row(name, str(part), str(whole), f"{(part + 0.5) / (whole + 1):.2g}", f"{value:g}")
    for share, cost in costs.items():
        table.add_row(f"cost of statements, evidence x {share:g}", "", "", f"{cost:.2f}", f"x {EVIDENCE_SHARE:g}")
    return table


def weigh_statements(truth: CourtTruth, rally: Rally) -> float:
    """Return the negative logarithm of the probabilities of what is right of the stated events (lower is better)."""
    stated = [(event.probability, is_right(truth, event)) for event in rally.events if event.kind != "net"]
    return float(sum(-np.log(np.clip(p if right else 1 - p, 1e-6, 1.0)) for p, right in stated))


def classify_events(truth: CourtTruth, rally: Rally) -> list[tuple[str, bool]]:
    """List the classes of the events of an explanation, and whether they are counted there."""
    classes, begins = [], np.array([flight.start for flight in rally.flights])
    for event in rally.events:
        if event.kind == "net":
            continue
        right = is_right(truth, event)
        sigma = float(np.sqrt(event.covariance[2, 2]))
        if event.kind == "hit" and not (np.abs(begins - event.t) < 1e-6).any():
            classes.append(("unseen start", right))
        elif event.kind == "hit" and is_low(event.place, sigma, rally.scene.sport):
            classes.append(("low hit", right))
        elif event.probability >= SURE:
            classes.append(("wrong though sure", not right))
    return classes


def is_right(truth: CourtTruth, event: RallyEvent) -> bool:
    """Check whether an event of its kind happens within some frames of an event."""
    near = [one for one in truth.stated["events"] if abs(one["t"] - event.t) * truth.fps <= CERTAIN_FRAMES]
    return any((one["kind"] == "hit") == (event.kind == "hit") for one in near)


def count_departures(truth: CourtTruth) -> list[int]:
    """Count the events of a simulated rally that break the rules, and all of them."""
    sport = truth.scene.sport
    belief, steps = start_play(sport), list[bool]()
    for event in truth.stated["events"]:
        place = np.array(event["place"])
        is_off = np.array(event["kind"] != "hit" and sport.is_beside_table(place[2]))
        where = locate_event(place[0], np.array(1e-3), is_off, sport)
        belief = advance_play(belief, event["kind"], where, sport)
        steps.append(bool(belief.sum() < 2 * DEPARTURE))
        belief = belief / belief.sum()
    return [sum(steps), len(steps)]


if __name__ == "__main__":
    main()
