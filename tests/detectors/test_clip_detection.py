"""The balls of a clip are the same wherever its parts are searched."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from support.sample_clips import SAMPLES

from detectors import detect
from detectors.detect_options import DetectOptions
from models.core.progress import Progress
from video.calibration.table_finder import calibrate_clip
from video.io.clip import open_clip
from video.io.video_options import CalibrateOptions


class OtherProcess:
    """An executor that runs every task as another process would: on a copy of the subject, the last one first."""

    def __init__(self) -> None:
        self.tasks = 0

    def map_tasks(self, subject: Any, function: Any, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        self.tasks += len(arguments)
        return [function(pickle.loads(pickle.dumps(subject)), *one) for one in reversed(arguments)][::-1]


@pytest.mark.parametrize("detector", ["hough", "onnx"])
def test_parts_that_another_process_searches_give_the_same_balls(
    detector: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = open_clip(SAMPLES / "carom_match.mp4").extract_subclip(10, 40)
    scene = calibrate_clip(clip, CalibrateOptions())
    options = DetectOptions(detector)  # type: ignore[arg-type]
    monkeypatch.setattr(detect, "LEAST_PART_FRAMES", 10)
    shares: list[float] = []
    progress: Progress = shares.append
    here, other = detect.detect_balls(clip, scene, options, progress), OtherProcess()
    there = detect.detect_balls(clip, scene, options, executor=other)
    assert other.tasks == detect.PARTS
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert set(here.frame) == set(range(10, 40)) == set(there.frame)
    for name in ("frame", "centre", "radius", "streak", "score"):
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))
