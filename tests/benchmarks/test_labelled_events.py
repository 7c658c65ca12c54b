"""Events that were labelled by eye are matched by kind, time and place, and what is unsure counts neither way."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.clips.mark_scores import score_labelled_events
from benchmarks.support.run_folder import RunFolder


def make_run(rows: list[tuple[str, float, float, float]]) -> RunFolder:
    """Make a run of (kind, frame, x, probability) whose pixels are 100 per metre."""
    kind, frame, x, p = zip(*rows, strict=True)
    events = {
        "kind": np.array(kind), "frame": np.array(frame), "x": np.array(x), "y": np.zeros(len(rows)),
        "probability": np.array(p), "a": np.array(["cue"] * len(rows)), "b": np.array([""] * len(rows)),
    }  # fmt: skip
    matrix = [[100.0, 0, 0, 0], [0, 100.0, 0, 0], [0, 0, 0, 1]]
    return RunFolder(Path("run"), {}, events, {}, {"calibration": {"matrix": matrix}, "ball_radius": 0.03})


def make_label(kind: str, low: float, high: float, x_px: float, certainty: str = "sure") -> dict[str, object]:
    return {
        "kind": kind,
        "a": "white",
        "b": None,
        "lo": low,
        "hi": high,
        "x_px": x_px,
        "y_px": 0,
        "certainty": certainty,
    }


def test_labels_are_found_missed_or_left_out_and_false_events_are_sure_ones() -> None:
    run = make_run([
        ("strike", 9.1, 0.0, 0.6), ("ball", 24.5, 1.0, 0.95), ("ball", 30.0, 5.0, 0.95), ("cushion", 40.0, 1.0, 0.4),
        ("rest", 50.0, 2.0, 0.97), ("rest", 80.0, 2.0, 0.97), ("ball", 90.0, 1.0, 0.85),
    ])  # fmt: skip
    labels = [
        make_label("strike", 10, 12, 0), make_label("ball", 20, 22, 100), make_label("ball", 29, 31, 100),
        make_label("cushion", 39, 41, 100), make_label("rest", 51, 53, 200, "unsure"),
    ]  # fmt: skip
    score = score_labelled_events("clip", run, {"events": labels, "incomplete_spans": [[75, 85]]})
    assert score.samples == {"hits": [1], "labels": [4], "false": [2]}, "late, elsewhere and improbable; two are false"
