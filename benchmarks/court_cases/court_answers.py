"""What the program says about a clip: court, candidates, rally and call; stored, so that scores need no rerun."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

from benchmarks.court_cases.court_clips import CourtTruth
from models.core.court_camera import CourtCamera
from models.core.errors import ClipError
from models.core.progress import ignore_progress
from models.core.rally import BallCandidates, Rally
from models.core.typing import FloatArray
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
    from models.estimation.rally.explain_rally import explain_rally
    from models.estimation.rally.landing_judgement import judge_landing
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


def make_candidates(truth: CourtTruth) -> BallCandidates:
    """Make the candidates of a perfect detector with noise: one where the object is visible."""
    rng = np.random.default_rng(0)
    row = np.flatnonzero(truth.columns["is_visible"])
    centre = truth.columns["px"][row] + rng.normal(0, ORACLE_NOISE, (len(row), 2))
    sigma = np.full(len(row), ORACLE_NOISE)
    boxes = truth.columns["players"]
    players = np.concatenate([np.column_stack([np.full(boxes.shape[1], k), boxes[k]]) for k in range(len(boxes))])
    return BallCandidates(row, centre, truth.columns["streak"][row], np.full(len(row), 0.95), sigma, sigma, players)


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
