"""What the program says about a clip: court, candidates, rally and call; stored, so that scores need no rerun."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.court_cases.court_clips import CourtTruth
from models.core.court_camera import CourtCamera, CourtScene
from models.core.errors import ClipError
from models.core.progress import ignore_progress
from models.core.rally import BallCandidates, Rally
from models.core.typing import BoolArray, FloatArray
from models.estimation.rally.explain_rally import explain_rally
from models.estimation.rally.landing_judgement import judge_landing
from video.io.clip import open_clip

# px, noise of candidates that are made from the truth.
ORACLE_NOISE = 0.7


def answer_case(truth: CourtTruth, oracles: frozenset[str], refresh: bool = False) -> dict[str, Any]:
    """Run the program on a clip, unless its answer is stored.

    Args:
        oracles: parts that the truth replaces: `camera`, `candidates`.
    """
    path = truth.folder / f"answer{''.join(f'_{name}' for name in sorted(oracles))}.json"
    if path.exists() and not refresh:
        return dict(json.loads(path.read_text()))
    try:
        answer = _run_program(truth, oracles)
    except ClipError as error:
        answer = {"error": str(error)}
    path.write_text(json.dumps(answer))
    return answer


def _run_program(truth: CourtTruth, oracles: frozenset[str]) -> dict[str, Any]:
    from detectors.flying.find_candidates import find_candidates
    from video.calibration.court_finder import locate_court

    clip = open_clip(truth.folder / "clip.mp4")
    start, cpu, seconds = time.perf_counter(), time.process_time(), {}
    scene = truth.scene if "camera" in oracles else locate_court(clip, None, None, ignore_progress)
    seconds["court"] = time.process_time() - cpu
    if scene.sport.name != truth.stated["sport"]:
        return {"error": f"taken for {scene.sport.name}"}
    found = make_candidates(truth) if "candidates" in oracles else find_candidates(clip, scene, ignore_progress)
    seconds["candidates"] = time.process_time() - cpu - seconds["court"]
    frame = clip.distinct_frames
    rally = explain_rally(scene, found, frame, clip.times_of(frame), ignore_progress)
    seconds["rally"] = time.process_time() - cpu - seconds["court"] - seconds["candidates"]
    seconds["wall"] = time.perf_counter() - start
    return _describe_answer(truth, scene, found, rally, seconds)


def _describe_answer(
    truth: CourtTruth, scene: CourtScene, found: BallCandidates, rally: Rally, seconds: dict[str, float]
) -> dict[str, Any]:
    """Return what the program states about a clip, for JSON."""
    call = judge_landing(rally)
    return {
        "error": "", "seconds": seconds, "line_error": compare_lines(truth, scene.camera),
        "candidates": {
            "frame": found.frame.tolist(), "px": found.centre.round(2).tolist(), "score": found.score.round(4).tolist(),
        },
        "call": {
            "in": call.probability, "out": call.out_probability, "distance": call.distance,
            "sigma": call.distance_sigma,
        },
        **describe_rally(rally),
    }  # fmt: skip


def describe_rally(rally: Rally) -> dict[str, Any]:
    """Return what a rally states, for JSON."""
    events = [
        {"kind": e.kind, "t": e.t, "t_sigma": e.t_sigma, "place": e.place.tolist(), "probability": e.probability,
         "speed": e.speed, "speed_sigma": e.speed_sigma, "player": e.player}
        for e in rally.events
    ]  # fmt: skip
    landings = [
        {"weight": h.weight, "t": h.t, "t_sigma": h.t_sigma, "place": h.place.tolist(),
         "covariance": h.covariance.tolist(), "is_seen": h.is_seen}
        for h in rally.landings
    ]  # fmt: skip
    return {"frame": rally.frame.tolist(), "px": rally.px.round(3).tolist(), "events": events, "landings": landings}


@dataclass(frozen=True, slots=True)
class Impairment:
    """What a detector that knows the truth does wrong."""

    missing: float = 0.0
    """Share of the frames that show the object in which it is missed."""
    clutter: float = 0.0
    """Mean number of false candidates per frame: half of them on players, half anywhere."""
    run: float = 0.0
    """Mean number of frames that it misses in a row; 0: each by itself."""

    def __post_init__(self) -> None:
        if self.run and (self.run < 1 or self.missing > self.run / (1 + self.run)):
            raise ValueError(f"{self.missing:.0%} of the frames cannot be missed in runs of {self.run:g} on average")


def draw_losses(count: int, impairment: Impairment, rng: np.random.Generator) -> BoolArray:
    """Draw in which of T frames the object is missed: a Markov chain where losses come in runs."""
    chance = rng.random(count)
    if not impairment.run:
        return np.asarray(chance < impairment.missing)
    stays = 1 - 1 / impairment.run
    falls = impairment.missing / (1 - impairment.missing) / impairment.run
    lost = np.empty(count, np.bool_)
    for k in range(count):
        lost[k] = chance[k] < (impairment.missing if k == 0 else stays if lost[k - 1] else falls)
    return lost


def make_candidates(truth: CourtTruth, impairment: Impairment = Impairment()) -> BallCandidates:
    """Make the candidates of a detector with noise that knows where the object is visible."""
    rng = np.random.default_rng(0)
    columns, camera = truth.columns, truth.scene.camera
    row = np.flatnonzero(columns["is_visible"] & ~draw_losses(len(columns["t"]), impairment, rng))
    centre = columns["px"][row] + rng.normal(0, ORACLE_NOISE, (len(row), 2))
    streak, score = columns["streak"][row], np.full(len(row), 0.95)
    boxes = columns["players"]
    players = np.concatenate([np.column_stack([np.full(boxes.shape[1], k), boxes[k]]) for k in range(len(boxes))])
    if impairment.clutter:
        where = np.repeat(np.arange(len(boxes)), rng.poisson(impairment.clutter, len(boxes)))
        # a limb or a racket is seen at the same share of its player's box for a while
        spots = np.cumsum(rng.normal(0, 0.05, (len(boxes), 2)), axis=0) + rng.random(2)
        box = boxes[where, rng.integers(boxes.shape[1], size=len(where))]
        share = np.where(rng.random((len(where), 1)) < 0.5, spots[where] % 1, rng.random((len(where), 2)))
        on_body = box[:, :2] + share * (box[:, 2:] - box[:, :2])
        anywhere = rng.random((len(where), 2)) * [camera.width_px, camera.height_px]
        false = np.where(rng.random((len(where), 1)) < 0.5, on_body, anywhere)
        row, centre = np.append(row, where), np.concatenate([centre, false])
        streak = np.concatenate([streak, rng.normal(0, 3, (len(where), 2))])
        score = np.append(score, rng.beta(1, 4, len(where)))
    order = np.argsort(row, kind="stable")
    sigma = np.full(len(row), ORACLE_NOISE)
    return BallCandidates(row[order], centre[order], streak[order], score[order], sigma, sigma, players)


def answer_truth(truth: CourtTruth, impairment: Impairment) -> dict[str, Any]:
    """Explain the candidates of a detector that knows the truth, under the true camera."""
    cpu, frame = time.process_time(), np.arange(len(truth.columns["t"]))
    found = make_candidates(truth, impairment)
    rally = explain_rally(truth.scene, found, frame, truth.columns["t"], ignore_progress)
    return _describe_answer(truth, truth.scene, found, rally, {"rally": time.process_time() - cpu})


def compare_lines(truth: CourtTruth, camera: CourtCamera) -> float:
    """Return the root mean square distance (px) of the painted lines from where a camera puts them, in 3 frames."""
    points = np.concatenate([np.linspace(line.start, line.end, 40) for line in truth.scene.sport.lines])
    places = np.column_stack([points, np.zeros(len(points))])
    size = np.array([camera.width_px, camera.height_px])
    gaps: list[FloatArray] = []
    for k in (0, len(truth.columns["t"]) // 2, len(truth.columns["t"]) - 1):
        true = truth.scene.camera.to_pixels(places, k)
        inside = np.all((true > 0) & (true < size - 1), axis=1)
        gaps.append(np.linalg.norm(camera.to_pixels(places[inside], k) - true[inside], axis=1))
    return float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))
