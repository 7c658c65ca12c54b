"""The diagnosis of foreign billiards: is nothing called nothing, is a missing effect named, how much of the gap closes?

    PYTHONPATH=. python benchmarks/billiards_gap.py [SEEDS] [FIRST] [CASE...]

The truth is worlds/billiards.py, run as a process, filmed as `billiards_cases.py` says: twelve shots of two to five
balls on a table of its own per seed, 2 s each, 62.5 pictures a second, noise of 0.3 px at 350 px to the metre. The
simulator that is diagnosed has rolling resistance, sliding friction, spin decay and the restitution of cushions and
balls, but what the case withholds. Printed per seed: whether the answer is right, the verdict, the effects or the
group named, the p-value of what the simulator leaves, what acted, the strengths found, errors before and after with
the floor, the closed part with its interval, CPU seconds; then how many are right per case. A group counts as right
where the missing effect is in it, and is printed as a group.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

from billiards_cases import CASES, IN_WORLD, Case, recordings
from foreign_shots import TABLE

from diagnosis.diagnose import diagnose
from diagnosis.verdict import Report
from models.billiards.gap import BilliardsScene, billiards_scene
from models.gap_scene import Recording


def scene_of(case: Case, shots: tuple[Recording, ...]) -> BilliardsScene:
    """The simulator that is diagnosed, and the library."""
    scene = billiards_scene(TABLE, shots, assumed=case.model)
    return replace(scene, effects=tuple(one for one in scene.effects if one.name not in case.without))


def right(case: Case, report: Report) -> bool:
    """Whether the answer is one that the case allows."""
    if report.verdict == "group":
        return len(case.lacks) == 1 and case.lacks[0] in report.candidates[0].group
    wanted = set(case.lacks)
    if not wanted:
        return report.verdict == "none"
    if case.without or wanted & {*IN_WORLD, "ageing"}:
        return report.verdict == "unknown"
    if case.along:
        return report.verdict in ("none", "unknown") and not report.effects
    return report.verdict == "effects" and (
        set(report.effects) == wanted or (len(report.effects) == 1 and report.effects[0] in case.twins)
    )


def run(case: Case, seed: int) -> bool:
    """Whether the answer is right; prints it."""
    shots, acted = recordings(case, seed)
    begun = time.process_time()
    report = diagnose(scene_of(case, shots), shots)
    cost = time.process_time() - begun
    good, gap = right(case, report), report.gap.closing
    named = " ".join(report.effects) or (", ".join(report.candidates[0].group) if report.verdict == "group" else "")
    strengths = [f"{one.name} {one.value:.3g} +- {one.sigma:.2g}" for one in report.fitted[len(case.model) :]]
    truth = [f"{p} {v:.3g}" for name in case.lacks for p, v in acted.get(name, {}).items()]
    print(
        f"{'right' if good else 'WRONG'} {case.name:34} seed {seed:2} {report.verdict:8} {named:26}"
        f" p {report.p_value:.2g}"
        f" [{', '.join(truth)}] [{', '.join(strengths)}] {1e3 * gap.before:.2f} to {1e3 * gap.after:.2f} of"
        f" {1e3 * gap.floor:.2f} mm, closed {gap.closed:.2f} ({gap.interval[0]:.2f} to {gap.interval[1]:.2f})"
        f" {cost:.0f} CPU s",
        flush=True,
    )
    return good


def main(seeds: int = 1, first: int = 0, *names: str) -> None:
    for name in names or tuple(CASES):
        good = sum(run(CASES[name], seed) for seed in range(first, first + seeds))
        print(f"{name}: right {good} of {seeds}")


if __name__ == "__main__":
    asked = [int(word) for word in sys.argv[1:3]]
    main(asked[0] if asked else 1, asked[1] if len(asked) > 1 else 0, *sys.argv[3:])
