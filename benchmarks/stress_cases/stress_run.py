"""Runs of the stress test: every clip and simulated shot, with every damage, to rows of scores."""

from __future__ import annotations

import json
import sys
import time
import traceback
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.stress_cases.ball_matching import match_balls, trace_balls
from benchmarks.stress_cases.case_scores import Case, Crash, Motion, Scores, Sought, Statement, score_case
from benchmarks.stress_cases.detection_damage import DETECTION_DAMAGES, NothingToDamage
from benchmarks.stress_cases.shot_truth import ShotTruth, read_labels, read_rendered_truth
from benchmarks.stress_cases.stress_chain import FittedShot, fit_recording, run_clip_stages
from benchmarks.stress_cases.synthetic_shots import draw_synthetic_shot, film_synthetic_shot, simulate_shots
from benchmarks.stress_cases.video_damage import VIDEO_DAMAGES, write_damaged_clip
from benchmarks.support.run_folder import FOOTAGE, ROOT
from pipeline.engine.result_cache import ResultCache, default_cache_root
from video.io.clip import Clip

SAMPLES = ROOT / "sample_videos"
# Name of the damage that does nothing.
NONE = "none"
DAMAGES = (NONE, *DETECTION_DAMAGES, *VIDEO_DAMAGES)


@dataclass(frozen=True, slots=True)
class Plan:
    """What to run: damages by name, seed, and the folder of damaged clips and simulated shots."""

    damages: tuple[str, ...]
    seed: int
    work: Path


def seeded_rng(seed: int, *words: str) -> np.random.Generator:
    """Return a generator that depends on a seed and on names.

    Args:
        words: Names, such as those of the clip and the damage.

    Returns:
        The generator.
    """
    return np.random.default_rng([seed, *(zlib.crc32(word.encode()) for word in words)])


def run_case(case: Case, score: Callable[[], Scores]) -> Scores:
    """Run one case; a failure becomes a row.

    Args:
        score: Runs and scores it.

    Returns:
        Its rows.
    """
    start = time.perf_counter()
    try:
        scores = score()
    except NothingToDamage as reason:
        scores = Scores(skipped=[f"{case.clip}, {case.damage}: {reason}"])
    except Exception as error:  # a crash is a result here
        place = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
        scores = Scores(cases=[case], crashes=[Crash(case, text)])
    note = " crashed" if scores.crashes else ""
    print(f"{case.group} {case.clip} {case.damage}: {time.perf_counter() - start:.1f} s{note}", file=sys.stderr)
    return scores


def run_clip(clip: Path, groups: tuple[str, ...], plan: Plan) -> Scores:
    """Run a real or a rendered clip, undamaged and with every damage.

    Args:
        groups: Groups that are wanted.
        plan: Damages, seed and folder.

    Returns:
        All rows.
    """
    is_rendered, cache = clip.parent == SAMPLES, ResultCache(default_cache_root())

    def read_truth(fitted: FittedShot, width: int) -> ShotTruth:
        scene = fitted.recording.scene
        if is_rendered:
            return read_rendered_truth(clip, scene.table)
        return read_labels(clip.with_suffix(".events.json"), scene, scene.camera.width_px, width)

    def score_all() -> Scores:
        parsed, shot = run_clip_stages(clip, cache)
        truth = read_truth(shot, parsed.width)
        if truth.paths is None:
            truth = replace(truth, tracked=trace_balls(shot, match_balls(truth, shot)))
        scores = Scores(skipped=[f"doubt: {text}" for text in truth.doubts])
        for damage in plan.damages:
            case = Case(name_group(damage), clip.stem, damage, plan.seed)
            if case.group in groups:
                scores.add(run_case(case, partial(score_damage, case, parsed, shot, truth)))
        return scores

    def score_damage(case: Case, parsed: Clip, shot: FittedShot, truth: ShotTruth) -> Scores:
        rng = seeded_rng(plan.seed, clip.stem, case.damage)
        if case.damage == NONE:
            return score_case(case, shot, truth)
        if case.damage in VIDEO_DAMAGES:
            damaged = write_damaged_clip(case.damage, parsed, shot, plan.work / f"{clip.stem}_{plan.seed}", rng)
            _, fitted = run_clip_stages(damaged, cache)
            return score_case(case, fitted, replace(read_truth(fitted, parsed.width), tracked=truth.tracked))
        part = DETECTION_DAMAGES[case.damage](shot, truth, match_balls(truth, shot), rng)
        return score_case(case, fit_recording(part.recording), truth, part.kept)

    def name_group(damage: str) -> str:
        return "synthetic" if is_rendered else "real" if damage == NONE else "damaged"

    return run_case(Case(name_group(NONE), clip.stem, "all", plan.seed), score_all)


def run_synthetic(number: int, plan: Plan) -> Scores:
    """Run one simulated shot with a random damage of its detections, or none.

    Args:
        number: Number of the shot.
        plan: Damages, seed and folder.

    Returns:
        Its rows.
    """
    shot = draw_synthetic_shot(plan.seed, number)
    rng = seeded_rng(plan.seed, shot.name)
    names = [name for name in plan.damages if name == NONE or name in DETECTION_DAMAGES]
    if not shot.pockets:
        names = [name for name in names if name != "pockets"]
    if not names:
        return Scores(skipped=[f"{shot.name}: none of these damages is for it"])
    damage = names[int(rng.integers(len(names)))]
    case = Case("synthetic", shot.name, damage, plan.seed)

    def score() -> Scores:
        recording, truth = film_synthetic_shot(shot, plan.work / "shots", plan.seed)
        fitted = fit_recording(recording)
        if damage == NONE:
            return score_case(case, fitted, truth)
        part = DETECTION_DAMAGES[damage](fitted, truth, match_balls(truth, fitted), rng)
        return score_case(case, fit_recording(part.recording), truth, part.kept)

    return run_case(case, score)


def list_tasks(groups: tuple[str, ...], word: str, synthetic: int, plan: Plan) -> Iterator[Callable[[], Scores]]:
    """List the clips and simulated shots to run, after simulating the latter.

    Args:
        groups: Groups that are wanted.
        word: Part of the names of the clips and shots that are wanted.
        synthetic: Number of simulated shots.
        plan: Damages, seed and folder.

    Returns:
        Functions that run them.
    """
    clips = sorted(FOOTAGE.glob("*.mp4")) if {"real", "damaged"} & set(groups) else []
    clips += sorted(SAMPLES.glob("*.mp4")) if "synthetic" in groups else []
    yield from (partial(run_clip, clip, groups, plan) for clip in clips if word in clip.stem)
    if "synthetic" in groups:
        shots = [draw_synthetic_shot(plan.seed, number) for number in range(synthetic)]
        simulate_shots([shot for shot in shots if word in shot.name], plan.work / "shots")
        yield from (partial(run_synthetic, k, plan) for k, shot in enumerate(shots) if word in shot.name)


def read_scores(path: Path) -> Scores:
    """Read the rows of an earlier run.

    Args:
        path: The file that `-o` has written.

    Returns:
        The rows.
    """
    content, scores = json.loads(path.read_text()), Scores()
    scores.cases = [Case(**row) for row in content["cases"]]
    scores.skipped = content["skipped"]
    for name, kind in (("statements", Statement), ("sought", Sought), ("motions", Motion), ("crashes", Crash)):
        getattr(scores, name).extend(kind(**{**row, "case": Case(**row["case"])}) for row in content[name])
    return scores
