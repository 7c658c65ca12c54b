"""Learn the probability of an event from its evidence, on shots of another engine with damaged detections.

    python -m benchmarks.calibrate_events [--shots N] [--seed S] [--jobs N] [--work DIR] [--write]

Simulates and films random shots (`worlds/billiards.py`), damages their detections, fits them, and compares every
hypothesis with the truth. A logistic model with a Gaussian prior on its weights is fitted to the evidence; half of the
shots are held out for the printed reliability. `--write` replaces the coefficients of the program. The seed is none of
those of `benchmarks.stress`. Takes two seconds per shot.

`--premises` gives every shot objects that are no balls, joined tracks or a wrong calibration, and fits the weights of
the evidence against premises beside the other coefficients of the program.
"""

from __future__ import annotations

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import get_args

from pipeline.engine.process_setup import limit_library_threads

limit_library_threads()

import numpy as np  # noqa: E402
from scipy.optimize import minimize, minimize_scalar  # noqa: E402
from scipy.special import expit  # noqa: E402

from benchmarks.stress_cases.ball_matching import BallMatch, match_balls, match_events  # noqa: E402
from benchmarks.stress_cases.case_scores import judge_call  # noqa: E402
from benchmarks.stress_cases.detection_damage import DETECTION_DAMAGES, NothingToDamage  # noqa: E402
from benchmarks.stress_cases.false_premises import FALSE_PREMISES  # noqa: E402
from benchmarks.stress_cases.shot_truth import ShotTruth  # noqa: E402
from benchmarks.stress_cases.stress_chain import Call, FittedShot, Recording, fit_recording  # noqa: E402
from benchmarks.stress_cases.synthetic_shots import (  # noqa: E402
    DrawnShot,
    draw_synthetic_shot,
    film_synthetic_shot,
    simulate_shots,
)
from benchmarks.support.run_folder import ROOT  # noqa: E402
from models.core.events import Events  # noqa: E402
from models.core.options import FitOptions  # noqa: E402
from models.core.typing import FloatArray, IntArray  # noqa: E402
from models.estimation.contact_test.call_answers import PairClass, classify_pair  # noqa: E402
from models.estimation.contact_test.shot_record import find_ball_candidates, make_shot_record  # noqa: E402
from models.estimation.reconstruction.explain_shot import explain  # noqa: E402
from models.estimation.reconstruction.shot_views import view_shot  # noqa: E402
from models.estimation.shot_hypotheses import event_probability  # noqa: E402
from models.estimation.shot_hypotheses.event_probability import (  # noqa: E402
    CATEGORIES,
    EVIDENCE_NAMES,
    PREMISE_EVIDENCE_NAMES,
    EventEvidence,
    estimate_event_probability,
)

# Standard deviations of the Gaussian priors on the weights and on the biases.
WEIGHT_SIGMA, BIAS_SIGMA = 2.0, 3.0
# Frames within which a true rest makes a reported one true.
REST_FRAMES = 15.0
# Frames before the end of the clip from which the truth does not show whether a ball rests.
LAST_REST_FRAMES = 5.0
# Share of the shots that are not damaged.
UNDAMAGED_SHARE = 0.25
# Share of clips with tracks or a calibration that are wrong: five of the 52 clips of others that were tried.
FALSE_PREMISE_SHARE = 0.1
# s of a shot that are fitted with false premises: most contacts are in them, and fits of long shots take longest.
PREMISE_SECONDS = 2.0
# Fits of a shot with a false premise, beside the one without.
FALSIFIED_FITS = 3


@dataclass(frozen=True)
class LabelledHypothesis:
    """One hypothesis of a fit, and whether it is true."""

    category: str
    evidence: tuple[float, ...]
    is_true: bool
    shot: int
    damage: str = ""
    premises: tuple[tuple[float, ...], ...] = ()
    """Evidence against the premises of each of its balls."""


@dataclass(frozen=True)
class LabelledPair:
    """Two balls of which no contact is listed: their class, and whether they touched."""

    kind: str
    is_true: bool


def label_shot(number: int, seed: int, work: Path) -> tuple[list[LabelledHypothesis], list[LabelledPair]]:
    """Fit a simulated shot and compare its hypotheses with the truth.

    Args:
        number: Number of the shot.
        seed: Seed of all shots.
        work: Folder of the simulated shots.

    Returns:
        All hypotheses and pairs of balls of which the truth is known.
    """
    shot = draw_synthetic_shot(seed, number)
    rng = np.random.default_rng([seed, number, 2])
    try:
        recording, truth = film_synthetic_shot(shot, work / "shots", seed)
        fitted, kept = fit_recording(recording), None
        if rng.random() > UNDAMAGED_SHARE:
            damage = DETECTION_DAMAGES[_draw_damage(shot, rng)]
            part = damage(fitted, truth, match_balls(truth, fitted), rng)
            fitted, kept = fit_recording(part.recording), part.kept
    except (NothingToDamage, ValueError, ArithmeticError) as reason:
        print(f"{shot.name}: {reason}", file=sys.stderr)
        return [], []
    print(shot.name, file=sys.stderr)
    match = match_balls(truth, fitted)
    return label_hypotheses(fitted, truth, match, kept, number), label_pairs(fitted, truth, match, kept)


def label_premises(number: int, seed: int, work: Path) -> tuple[list[LabelledHypothesis], list[LabelledPair]]:
    """Fit a simulated shot as it is, with a covered ball, and with false premises, and compare with the truth.

    Args:
        number: Number of the shot.
        seed: Seed of all shots.
        work: Folder of the simulated shots.

    Returns:
        All hypotheses of which the truth is known, and no pairs.
    """
    shot = draw_synthetic_shot(seed, number)
    rng = np.random.default_rng([seed, number, 3])
    recording, truth = film_synthetic_shot(shot, work / "shots", seed)
    begins = recording.t < PREMISE_SECONDS
    recording = replace(
        recording, frame=recording.frame[begins], t=recording.t[begins],
        detections=recording.detections.select_rows(recording.detections.frame <= recording.frame[begins][-1]),
    )  # fmt: skip
    fitted = fit_recording(recording)
    labelled = []
    for true in (fitted, fit_recording(cover_ball(fitted, rng))):
        labelled += label_hypotheses(true, truth, match_balls(truth, true), None, number)
    for name in rng.choice(list(FALSE_PREMISES), FALSIFIED_FITS, replace=False):
        try:
            falsified, changed = FALSE_PREMISES[name](fitted, truth, rng)
        except NothingToDamage as reason:
            print(f"{shot.name}: {reason}", file=sys.stderr)
            continue
        explained = view_shot(explain(falsified.tracks, recording.scene, FitOptions()))
        falsified = replace(falsified, fit=explained)
        rows = label_hypotheses(falsified, changed, match_balls(changed, falsified), None, number)
        labelled += [replace(row, damage=str(name)) for row in rows]
    print(shot.name, file=sys.stderr)
    return labelled, []


def cover_ball(fitted: FittedShot, rng: np.random.Generator) -> Recording:
    """Remove all detections of one ball before, or after, a random frame: a person stands before it, as balls are."""
    tracks, recording = fitted.tracks, fitted.recording
    ball, frame = int(rng.integers(len(tracks.ids))), rng.choice(recording.frame)
    side = 1 if rng.random() < 0.5 else -1
    gap = np.linalg.norm(
        recording.detections.centre - tracks.px[np.searchsorted(tracks.frame, recording.detections.frame), ball], axis=1
    )
    is_covered = (gap < 1e-6) & (side * (recording.detections.frame - frame) > 0)  # NaN compares false
    return replace(recording, detections=recording.detections.select_rows(~is_covered))


def label_pairs(fitted: FittedShot, truth: ShotTruth, match: BallMatch, kept: IntArray | None) -> list[LabelledPair]:
    """Compare the pairs of balls without a listed contact with the truth.

    Args:
        fitted: The fit.
        truth: True events.
        match: Tracks of the true balls.
        kept: Frames that are left; None for all.

    Returns:
        The pairs with a ball that moves, and of which the truth is known.
    """
    fit, scene = fitted.fit, fitted.recording.scene
    record = make_shot_record(fitted.tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
    start = -np.inf if kept is None else float(kept[0])
    labelled = []
    for one, two in combinations(range(len(record.ids)), 2):
        if find_ball_candidates(record, one, two) or not fit.moving[:, [one, two]].any():
            continue
        call = Call("contact", (record.ids[one], record.ids[two]), "yes", 0.0, False)
        is_true, _ = judge_call(call, truth, match, start)
        if is_true is not None:
            labelled.append(LabelledPair(classify_pair(record, one, two), is_true))
    return labelled


def _draw_damage(shot: DrawnShot, rng: np.random.Generator) -> str:
    names = [name for name in DETECTION_DAMAGES if shot.pockets or name != "pockets"]
    return names[int(rng.integers(len(names)))]


def label_hypotheses(
    fitted: FittedShot, truth: ShotTruth, match: BallMatch, kept: IntArray | None, number: int
) -> list[LabelledHypothesis]:
    """Compare the hypotheses of a fit with the truth.

    Args:
        fitted: The fit.
        truth: True events.
        match: Tracks of the true balls.
        kept: Frames that are left; None for all.
        number: Number of the shot.

    Returns:
        The hypotheses whose truth is known.
    """
    pairs = [(moment, one) for moment in fitted.fit.explanation.moments for one in moment.hypotheses if one.evidence]
    pairs.sort(key=lambda pair: pair[0].t)
    t = np.array([moment.t for moment, _ in pairs])
    nan = np.full(len(pairs), np.nan)
    events = Events(
        tuple(one.cause for _, one in pairs), t, np.array([max(moment.t_sigma, 1e-6) for moment, _ in pairs]),
        fitted.tracks.frame_at(t), tuple(moment.ball for moment, _ in pairs), tuple(one.other for _, one in pairs),
        np.array([moment.xy for moment, _ in pairs]).reshape(-1, 2), np.ones(len(pairs)), nan, nan, nan,
    )  # fmt: skip
    frame_s = float(np.median(np.diff(fitted.tracks.t) / np.diff(fitted.tracks.frame)))
    matched = match_events(events, truth, match, kept, frame_s, fitted.recording.scene.table.ball_radius)
    labelled = []
    for (moment, one), event, at in zip(pairs, matched, fitted.tracks.frame_at(t), strict=True):
        if one.category == "rest" and at > truth.paths.frame[-1] - LAST_REST_FRAMES:
            continue  # the truth does not show whether the ball stays
        if one.category == "rest":  # its time has an error of its own; here it counts that the ball rests about then
            is_true = any(
                other.kind == "rest" and moment.ball in match.ids_of(other.a) and abs(other.hi - at) < REST_FRAMES
                for other in truth.events
            )
        elif event is None or truth.events[event].certainty == "sure":
            is_true = event is not None
        else:
            continue
        by_ball = fitted.fit.explanation.premises
        premises = tuple(by_ball[ball].evidence for ball in (moment.ball, one.other) if ball in by_ball)
        labelled.append(LabelledHypothesis(one.category, one.evidence, is_true, number, premises=premises))
    return labelled


def design_matrix(rows: list[LabelledHypothesis]) -> tuple[FloatArray, FloatArray]:
    """Build the design matrix (R, C + F) of categories and evidence, and the labels (R,).

    Args:
        rows: Labelled hypotheses.

    Returns:
        Design matrix and labels.
    """
    one_hot = np.array([[row.category == name for name in CATEGORIES] for row in rows], dtype=float)
    evidence = np.array([row.evidence for row in rows]).reshape(len(rows), -1)
    return np.hstack([one_hot, evidence]), np.array([row.is_true for row in rows], dtype=float)


def fit_logistic(design: FloatArray, label: FloatArray) -> FloatArray:
    """Fit a logistic model by maximum posterior probability.

    Args:
        design: (R, P).
        label: (R,) 0 or 1.

    Returns:
        (P,) coefficients.
    """
    sigma = np.full(design.shape[1], WEIGHT_SIGMA)
    sigma[: len(CATEGORIES)] = BIAS_SIGMA

    def cost(beta: FloatArray) -> tuple[float, FloatArray]:
        z = design @ beta
        loss = float(np.logaddexp(0, z).sum() - label @ z + 0.5 * ((beta / sigma) ** 2).sum())
        return loss, design.T @ (expit(z) - label) + beta / sigma**2

    return np.asarray(minimize(cost, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B").x)


def compute_premises(beta: FloatArray, rows: list[LabelledHypothesis]) -> FloatArray:
    """Compute the probability (R,) that the premises of each hypothesis hold.

    Args:
        beta: (1 + F,) bias and weights.
        rows: Labelled hypotheses.

    Returns:
        The probabilities, of the ball with the weakest premise.
    """
    one, two = (np.array([row.premises[k] for row in rows]) for k in (0, -1))
    return np.asarray(expit(beta[0] - np.maximum(one @ beta[1:], two @ beta[1:])))


def weigh_fits(rows: list[LabelledHypothesis]) -> FloatArray:
    """Weigh hypotheses (R,) so that fits with a false premise have their share of real clips; the mean weight is 1."""
    is_false = np.array([row.damage != "" for row in rows])
    clean, falsified = (
        len({(row.shot, row.damage) for row in rows if bool(row.damage) == own}) for own in (False, True)
    )
    odds = FALSE_PREMISE_SHARE / (1 - FALSE_PREMISE_SHARE) * clean / max(falsified, 1)
    weight = np.where(is_false, odds, 1.0)
    return np.asarray(weight / weight.mean())


def fit_premises(rows: list[LabelledHypothesis], p: FloatArray) -> FloatArray:
    """Fit bias and weights of the evidence against premises; no weight is negative.

    Args:
        rows: Labelled hypotheses.
        p: (R,) their probabilities given that their premises hold.

    Returns:
        (1 + F,) coefficients.
    """
    label, weight = np.array([row.is_true for row in rows]), weigh_fits(rows)
    sigma = np.array([BIAS_SIGMA, *[WEIGHT_SIGMA] * len(PREMISE_EVIDENCE_NAMES)])

    def cost(beta: FloatArray) -> float:
        joint = np.clip(p * compute_premises(beta, rows), 1e-9, 1 - 1e-9)
        return float(-weight @ np.log(np.where(label, joint, 1 - joint)) + 0.5 * ((beta / sigma) ** 2).sum())

    bounds = [(None, None), *[(0.0, None)] * len(PREMISE_EVIDENCE_NAMES)]
    return np.asarray(minimize(cost, np.ones(len(sigma)), bounds=bounds, method="L-BFGS-B").x)


def run_premises(rows: list[LabelledHypothesis], settings: str, write: bool) -> None:
    """Fit the evidence against premises, and print how reliable the joint probabilities are.

    Args:
        rows: Labelled hypotheses.
        settings: Shots and seed that they are from.
        write: Whether to replace the coefficients of the program.
    """
    p = np.array([estimate_event_probability(row.category, EventEvidence(*row.evidence)) for row in rows])
    label, damage = np.array([row.is_true for row in rows], float), np.array([row.damage for row in rows])
    held_out = np.array([row.shot % 2 == 1 for row in rows])
    beta = fit_premises([row for row in rows if row.shot % 2 == 0], p[~held_out])
    joint = p * compute_premises(beta, rows)
    for name, inside in (("premises taken for granted", p), ("with the probability of premises", joint)):
        print(f"\n{name}, on the half of the shots that is held out:\n")
        print_reliability(inside[held_out], label[held_out])
    print("\n| false premise | n | false at >= 0.9 before | after | true at >= 0.9 before | after |")
    print("|---|---|---|---|---|---|")
    for name in ("", *FALSE_PREMISES):
        own = held_out & (damage == name)
        cells = [int(((one >= 0.9) & own & (label == is_true)).sum()) for is_true in (0, 1) for one in (p, joint)]
        print(f"| {name or 'none'} | {int(own.sum())} | {' | '.join(map(str, cells))} |")
    beta = np.round(fit_premises(rows, p), 3)
    weight = dict(zip(PREMISE_EVIDENCE_NAMES, beta[1:].tolist(), strict=True))
    source = f"benchmarks/calibrate_events.py --premises {settings}"
    premises = {"source": source, "count": len(rows), "bias": float(beta[0]), "weight": weight}
    print(json.dumps(premises, indent=1))
    if write:
        path = Path(event_probability.__file__).with_name(event_probability.COEFFICIENTS)
        path.write_text(json.dumps(json.loads(path.read_text()) | {"premises": premises}, indent=1) + "\n")


def write_bias(category: str, rows: list[LabelledHypothesis], settings: str) -> None:
    """Fit the bias of one category beside the weights of the program, print its reliability, and write it.

    Args:
        category: One of `CATEGORIES`.
        rows: Labelled hypotheses.
        settings: Shots and seed that they are from.
    """
    path = Path(event_probability.__file__).with_name(event_probability.COEFFICIENTS)
    content = json.loads(path.read_text())
    weight = np.array([content["weight"][name] for name in EVIDENCE_NAMES])
    own = [row for row in rows if row.category == category]
    evidence, label = np.array([row.evidence for row in own]) @ weight, np.array([row.is_true for row in own], float)
    bias = float(minimize_scalar(lambda b: np.logaddexp(0, b + evidence).sum() - label @ (b + evidence)
                                 + 0.5 * (b / BIAS_SIGMA) ** 2).x)  # fmt: skip
    print_reliability(expit(bias + evidence), label)
    content["bias"][category], content["count"][category] = round(bias, 3), float(len(own))
    content[f"source_{category}"] = f"benchmarks/calibrate_events.py {settings} --only {category}"
    path.write_text(json.dumps(content, indent=1) + "\n")


def _share(pairs: list[LabelledPair], kind: str) -> float:
    """Return the share of pairs that touched, by Laplace's rule of succession."""
    own = [pair.is_true for pair in pairs if pair.kind == kind]
    return (sum(own) + 1) / (len(own) + 2)


def print_reliability(p: FloatArray, label: FloatArray) -> None:
    """Print stated and observed shares in bins of probability."""
    edges = np.array([0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 0.99, 1.0])
    print("| stated | observed | n | binomial sd |\n|---|---|---|---|")
    for low, high in pairwise(edges.tolist()):
        inside = (p >= low) & (p < high)
        if n := int(inside.sum()):
            mean = float(p[inside].mean())
            print(f"| {mean:.3f} | {label[inside].mean():.3f} | {n} | {np.sqrt(mean * (1 - mean) / n):.3f} |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shots", type=int, default=400, help="number of simulated shots")
    parser.add_argument("--most-fps", type=float, default=np.inf, help="leave out shots of higher frame rates")
    parser.add_argument("--seed", type=int, default=1001, help="seed of the shots")
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "stress", help="folder of simulated shots")
    parser.add_argument("--rows", type=Path, help="JSON file: read the labelled hypotheses if it exists, else write it")
    parser.add_argument("--only", choices=CATEGORIES, help="replace the bias of this category, and nothing else")
    parser.add_argument("--premises", action="store_true", help="fit the evidence against premises, and nothing else")
    parser.add_argument("--write", action="store_true", help="replace the coefficients of the program")
    arguments = parser.parse_args()
    work = arguments.work.absolute()
    settings = f"--shots {arguments.shots} --seed {arguments.seed}"
    settings += f" --most-fps {arguments.most_fps:g}" if np.isfinite(arguments.most_fps) else ""
    if arguments.rows and arguments.rows.is_file():
        content = json.loads(arguments.rows.read_text())
        rows = [LabelledHypothesis(**row) for row in content["hypotheses"]]
        pairs = [LabelledPair(**row) for row in content["pairs"]]
    else:
        shots = [draw_synthetic_shot(arguments.seed, k) for k in range(arguments.shots)]
        numbers = [k for k, shot in enumerate(shots) if shot.fps <= arguments.most_fps]
        simulate_shots([shots[k] for k in numbers], work / "shots")
        label = partial(label_premises if arguments.premises else label_shot, seed=arguments.seed, work=work)
        if arguments.jobs > 1:
            with ProcessPoolExecutor(arguments.jobs) as pool:
                parts = list(pool.map(label, numbers))
        else:
            parts = [label(k) for k in numbers]
        rows, pairs = ([row for part in parts for row in part[k]] for k in (0, 1))
        if arguments.rows:
            content = {"hypotheses": [vars(row) for row in rows], "pairs": [vars(row) for row in pairs]}
            arguments.rows.write_text(json.dumps(content))
    if arguments.premises:
        run_premises(rows, settings, arguments.write)
        return 0
    design, truth = design_matrix(rows)
    held_out = np.array([row.shot % 2 == 1 for row in rows])
    beta = fit_logistic(design[~held_out], truth[~held_out])
    print(f"{len(rows)} hypotheses; reliability on the half of the shots that is held out:\n")
    print_reliability(expit(design[held_out] @ beta), truth[held_out])
    beta = fit_logistic(design, truth)
    if arguments.only:
        write_bias(arguments.only, rows, settings)
        return 0
    content = {
        "source": f"benchmarks/calibrate_events.py {settings}",
        "bias": dict(zip(CATEGORIES, np.round(beta[: len(CATEGORIES)], 3).tolist(), strict=True)),
        "weight": dict(zip(EVIDENCE_NAMES, np.round(beta[len(CATEGORIES) :], 3).tolist(), strict=True)),
        "count": {name: float(sum(row.category == name for row in rows)) for name in CATEGORIES},
        "unlisted_contact": {kind: round(_share(pairs, kind), 5) for kind in get_args(PairClass)},
        "unlisted_count": {kind: sum(pair.kind == kind for pair in pairs) for kind in get_args(PairClass)},
    }
    print(json.dumps(content, indent=1))
    if arguments.write:
        path = Path(event_probability.__file__).with_name(event_probability.COEFFICIENTS)
        path.write_text(json.dumps(content, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
