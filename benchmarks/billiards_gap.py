"""The diagnosis of foreign billiards: is nothing called nothing, is a missing effect named, how much of the gap closes?

    PYTHONPATH=. python benchmarks/billiards_gap.py [KIND...] [--seeds 1] [--first 0] [--rows F.csv] [--pair] [--show]

The truth is worlds/billiards_table.py, run as a process: twelve shots of two to five balls on a table of its own per
seed, filmed for 2 s each, 62.5 pictures a second, noise of 0.3 px at 350 px to the metre. The simulator that
is diagnosed has rolling resistance, sliding friction, spin decay and the restitution of cushions and balls, but what
the kind withholds. What is weak is as strong as 4 to 6 of the standard deviations that somebody who
knows its name finds it with, all else adjusted. Every case is a row of FILE.csv, and is not tried again where it stands
there already; the table is printed from all rows. With --pair two processes work on each, as they do for the user;
the CPU seconds are then those of one of them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
from billiards_cases import CASES, NEAR, Case, recordings
from billiards_table import Row, told
from foreign_shots import TABLE
from row_files import append, read_rows

from diagnosis.diagnose import diagnose
from diagnosis.verdicts.verdict import Report
from models.estimation.gap_scenes.billiards_scene import billiards_scene
from models.estimation.gap_scenes.gap_scene import GapScene, Recording
from models.numerics.executor import ALONE, Crew
from models.physics.effects.catalogue import BILLIARDS, BILLIARDS_LAWS
from pipeline.engine.helper_process import crew
from pipeline.experiments.gapcheck.billiards_cases import NOT_HELD
from pipeline.experiments.gapcheck.billiards_strengths import Effects
from pipeline.experiments.gapcheck.blind_case import told_apart
from pipeline.experiments.gapcheck.gap_oracle import oracle_of


def scene_of(case: Case, shots: tuple[Recording, ...]) -> GapScene:
    """The simulator that is diagnosed, and the library."""
    return case.kind.simulator(billiards_scene(TABLE, shots, assumed=case.kind.model))


def right(case: Case, shots: tuple[Recording, ...], report: Report) -> bool:
    """Whether the answer is one that the case allows. In a trap the right name is right only if it is no guess."""
    kind, named = case.kind, frozenset(report.effects)
    if not kind.withheld:
        return report.verdict == "none"
    if kind.foreign:
        return report.verdict == "unknown"
    if kind.trap and named:
        return named == kind.withheld and told_apart(kind, scene_of(case, shots), shots)
    return kind.trap or (report.verdict == "effects" and kind.is_named_by(named))


def just_seen(case: Case, seed: int) -> float:
    """How many times its natural strength an effect is NEAR standard deviations: of the same shots without it."""
    absent, _ = recordings(case, seed, 0.0)
    scene = scene_of(case, absent)
    natural = case.kind.acting(case.kind.chance(seed))
    wanted = [
        natural[effect.name][prior.name] for effect in scene.effects if effect.name in case.kind.lacks
        for prior in effect.parameters
    ]  # fmt: skip
    seen = oracle_of(scene, absent).sigmas(case.kind.withheld, np.array(wanted))
    return float(np.random.default_rng([7181, seed, *case.name.encode()]).uniform(*NEAR)) / seen


def row_of(
    case: Case, seed: int, shots: tuple[Recording, ...], report: Report, acted: Effects, took: tuple[float, float]
) -> Row:
    """What one case gave."""
    told, first, named = report.gap.closing, report.candidates[0], " + ".join(report.effects)
    group = " | ".join(first.group) if report.verdict == "group" else ""
    phase = report.where[0].phase if report.where else ""
    strengths = [f"{one.name} {one.value:.3g} +- {one.sigma:.2g}" for one in report.fitted[len(case.kind.model) :]]
    return Row(
        kind=case.name, asked=_asked(case), seed=seed, said=named or group or report.verdict,
        right=int(right(case, shots, report)), grouped=int(any(n in first.group for n in case.kind.lacks)),
        probability=report.probability, p_value=report.p_value, before=told.before, after=told.after,
        floor=told.floor, closed=told.closed if told.resolved else float("nan"), low=told.interval[0],
        high=told.interval[1], phase=phase, phase_right=_acts_in(case, phase), cpu=took[0], wall=took[1],
        truth=", ".join(f"{name}.{p} {v:.3g}" for name in case.kind.lacks for p, v in acted.get(name, {}).items()),
        found=", ".join(strengths),
    )  # fmt: skip


def _asked(case: Case) -> str:
    kind = case.kind
    if kind.trap:
        return "trap"
    if case.harder:
        return case.harder
    if kind.family or kind.base != "mirror":
        return "form"
    if not kind.lacks:
        return "none"
    if kind.foreign:
        return "taken out" if kind.without else "foreign"
    return "pair" if len(kind.lacks) == 2 else "one"


def _acts_in(case: Case, phase: str) -> int:
    """1 where what is missing acts in a phase, 0 where it does not, -1 where nothing is missing."""
    phases = {one.name: one.phases for one in (*BILLIARDS, *BILLIARDS_LAWS)}
    phases |= dict.fromkeys(NOT_HELD, ("free_roll",))
    lacks = case.kind.family or case.kind.withheld
    return int(any(phase in phases[name] for name in lacks)) if lacks else -1


def trial(case: Case, seed: int, workers: Crew = ALONE) -> Row:
    """Play, film, diagnose, judge."""
    shots, acted = recordings(case, seed, just_seen(case, seed) if case.harder == "weak" else 1.0)
    begun = time.process_time(), time.perf_counter()
    report = diagnose(scene_of(case, shots), shots, crew=workers)
    took = time.process_time() - begun[0], time.perf_counter() - begun[1]
    return row_of(case, seed, shots, report, acted, took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"all if none is given: {', '.join(CASES)}")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--rows", type=Path, help="where rows are kept")
    parser.add_argument("--pair", action="store_true", help="let two processes work, as they do for the user")
    parser.add_argument("--show", action="store_true", help="only print the table of the rows there are")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch, crew() if options.pair else nullcontext(ALONE) as workers:
        path = options.rows or Path(scratch) / "rows.csv"
        rows = read_rows(path, Row)
        done = {(row.kind, row.seed) for row in rows}
        for seed in range(options.first, options.first + (0 if options.show else options.seeds)):
            for name in options.kinds or CASES:
                if (name, seed) not in done:
                    rows.append(trial(CASES[name], seed, workers))
                    append(rows[-1], path)
                    print(rows[-1].line(), file=sys.stderr, flush=True)
        print(told(rows))


if __name__ == "__main__":
    main()
