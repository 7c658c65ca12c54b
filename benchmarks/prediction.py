"""How far the rest of a shot can be predicted, and whether the promised regions hold what happens.

    python benchmarks/prediction.py [--seeds N] [--truth DIR] [--runs DIR]

Foreign shots: three balls of worlds/billiards.py, run as a process, under two cushion laws; 60 pictures a second, 1 mm
of noise per axis, predicted from a moment between 0.3 and 1.5 s after the strike. Real shots: the clips of DIR (run
folders of the footage), each from several moments; what was seen later is the truth there. Nothing seen after the
moment of the prediction is used. Beside it a ball that does not move, and one that keeps its last velocity.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from prediction_shots import LAWS, LEAD, film, happened, scene
from run_folder import ROOT

from models.core.errors import TrackError
from models.estimation.forecast.current_state import outlook_at
from models.estimation.forecast.ensemble_prediction import Prediction, predict
from models.estimation.forecast.forecast_check import hindsight
from models.estimation.forecast.state_estimate import Outlook
from pipeline.io.observed_shot import read_seen_shot

AHEAD = (0.25, 0.5, 1.0, 2.0, 3.0)
"""s"""
MOVES = 5e-3
"""m: balls that go less far in truth, and are promised to, are no test of a prediction."""
MOMENTS = (0.25, 0.4, 0.55, 0.7)
"""of a real clip, from which it is predicted."""


@dataclass(frozen=True)
class Case:
    """One ball of one shot, some time ahead."""

    group: str
    ahead: float
    ensemble: bool
    error: float
    """mm, as the next ones."""
    stays: float
    straight: float
    sigma: float
    level: float


def foreign(seeds: int, folder: Path) -> Iterator[Case]:
    for seed in range(seeds):
        for law in LAWS:
            shot = happened(seed, law, folder)
            at = LEAD + float(np.random.default_rng([3, seed]).uniform(0.3, 1.5))
            look = outlook_at(film(shot, at, seed), scene(), at)
            found = predict(look, at + np.array([0.0, *AHEAD]), seed)
            for row, ahead in enumerate(AHEAD, start=1):
                true = shot.xy[round((at + ahead) * 1000)]
                for ball in range(len(look.ids)):
                    case = judged(law, found, row, ball, true[ball], found.level(row, ball, true[ball]), ahead)
                    if case is not None:
                        yield case


def real(folder: Path) -> Iterator[Case]:
    """Every run of a clip, from several moments; each ball where it was seen nearest to the times asked for."""
    for run in sorted(path for path in folder.iterdir() if (path / "tracks.csv").is_file()):
        tracks, place, _ = read_seen_shot(run)
        for share in MOMENTS:
            row = int(share * (len(tracks.t) - 1))
            at = float(tracks.t[row])
            try:
                look = outlook_at(tracks, place, at)
            except TrackError as refusal:
                print(f"{run.name} at {at:.2f} s: {refusal}", file=sys.stderr)
                continue
            later = tracks.t[(tracks.t > at) & (tracks.t <= at + max(AHEAD) + 0.1)]
            if not look.moving.any() or not len(later):
                continue
            chosen = {float(later[np.argmin(abs(later - at - ahead))]): ahead for ahead in AHEAD}
            found = predict(look, np.array([at, *chosen]))
            seen = hindsight(found, tracks)
            for ball, t, level in zip(seen.ball, seen.t, seen.level, strict=True):
                ahead = chosen[float(t)]
                if abs(t - at - ahead) < 0.1:
                    true = tracks.xy[np.searchsorted(tracks.t, t - 1e-9), tracks.ids.index(look.ids[ball])]
                    when = int(np.searchsorted(found.t, t - 1e-9))
                    case = judged(run.name.split("_")[0], found, when, int(ball), true, float(level), ahead)
                    if case is not None:
                        yield case


def judged(
    group: str, found: Prediction, row: int, ball: int, true: np.ndarray, level: float, ahead: float
) -> Case | None:
    """One ball against what happened; None where it lies and is promised to."""
    look: Outlook = found.outlook
    state = look.mean[7 * ball : 7 * ball + 4]
    moved = float(np.hypot(*(true - state[:2])))
    if max(moved, float(np.hypot(*(found.path[row, ball] - state[:2])))) < MOVES or not np.isfinite(level):
        return None
    straight = state[:2] + state[2:] * (found.t[row] - look.t)
    return Case(
        group, ahead, bool(found.ensemble[row]), 1e3 * float(np.hypot(*(true - found.path[row, ball]))), 1e3 * moved,
        1e3 * float(np.hypot(*(true - straight))), 1e3 * float(found.sigma[row, ball]), level,
    )  # fmt: skip


def tell(title: str, cases: list[Case]) -> None:
    if not cases:
        return
    print(f"\n## {title}\n")
    print("| ahead s | by | balls | does not move mm | keeps its velocity mm | predicted mm (median) "
          "| promised sigma mm | in the 50 % region | in the 90 % region |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    for ahead in AHEAD:
        for ensemble in (False, True):
            own = [case for case in cases if case.ahead == ahead and case.ensemble == ensemble]
            if own:
                middle = [f"{np.median([getattr(case, name) for case in own]):.1f}"
                          for name in ("stays", "straight", "error", "sigma")]  # fmt: skip
                print(f"| {ahead:g} | {'ensemble' if ensemble else 'derivatives'} | {len(own)} | {' | '.join(middle)} "
                      f"| {held(own, 0.5)} | {held(own, 0.9)} |")  # fmt: skip
    print(f"\nall {len(cases)}: in the 50 % region {held(cases, 0.5)}, in the 90 % region {held(cases, 0.9)}")


def held(cases: list[Case], share: float) -> str:
    return f"{np.mean([case.level <= share for case in cases]):.0%}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="foreign shots per cushion law")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_predictions",
                        help="folder that keeps what the world made")  # fmt: skip
    parser.add_argument("--runs", type=Path, default=ROOT / "out" / "real_clips", help="run folders of real clips")
    arguments = parser.parse_args()
    cases = list(foreign(arguments.seeds, arguments.truth))
    for law in LAWS:
        tell(f"Foreign shots, cushion law {law}", [case for case in cases if case.group == law])
    if not arguments.runs.is_dir():
        print(f"\nreal clips are not at {arguments.runs}: make them with benchmarks/real_clips.py", file=sys.stderr)
        return 0
    filmed = list(real(arguments.runs))
    for group in sorted({case.group for case in filmed}):
        tell(f"Real clips, {group}", [case for case in filmed if case.group == group])
    return 0


if __name__ == "__main__":
    sys.exit(main())
