"""A run opens, decodes and hashes its clip once, and estimates once what the images share."""

from __future__ import annotations

import hashlib
import shutil
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import pytest
from support.carom_start import SLOW, Home

from models.core.progress import Progress, ignore_progress
from pipeline.chain import FinishedRun, build_run_graph, run_clip
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.io.run_folder import TABLES
from pipeline.recording_shots import find_recording_shots
from pipeline.run_options import build_options, list_settings
from pipeline.stages.read_stage import open_frame_memory
from video.io import decoder
from video.io.clip import open_clip
from video.io.clip_digest import CLOCK_TICK_NS
from video.io.frame_memory import FrameMemory, frame_memory_budget
from video.matting import ball_timeline, hidden_background

DEFAULTS = {name: setting.default for name, setting in list_settings().items()}
OPTIONS = build_options({**DEFAULTS, "quick": True, "slow": float(SLOW)})
"""Those of the run of the fixture `home`."""
NAME = "start.mp4"


class SilentWatcher:
    def start_stage(self, stage: str) -> Progress:
        return ignore_progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        pass


@pytest.fixture
def clip(home: Home, tmp_path: Path) -> Path:
    """A copy of a clip, old enough for the time of its last change to identify its content."""
    path = Path(shutil.copy(home.clip, tmp_path / NAME))
    time.sleep(2 * CLOCK_TICK_NS / 1e9)
    return path


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often the clip was opened and hashed, its decoded frames, and the estimates behind its images."""
    counter: Counter[str] = Counter()

    def count_calls(owner: Any, name: str, key: str, measure: Callable[[Any, Any], int]) -> None:
        function = getattr(owner, name)

        def call(first: Any, *others: Any, **named: Any) -> Any:
            result = function(first, *others, **named)
            counter[key] += measure(first, result)
            return result

        monkeypatch.setattr(owner, name, call)

    count_calls(av, "open", "opened", lambda path, _: Path(path).name == NAME)
    count_calls(decoder, "_decode_packet", "decoded", lambda _, frames: len(frames))
    count_calls(hashlib, "file_digest", "hashed", lambda file, _: Path(file.name).name == NAME)
    count_calls(ball_timeline, "build_ball_timeline", "timelines", lambda *_: 1)
    count_calls(hidden_background, "estimate_background_plate", "backgrounds", lambda *_: 1)
    return counter


def run(clip: Path, name: str, memory: FrameMemory | None = None) -> FinishedRun:
    """Run a clip into a folder beside it, with a cache of the same name."""
    cache = ResultCache(clip.parent / f"cache-{name}")
    return run_clip(clip, clip.parent / name, OPTIONS, cache, SilentWatcher(), memory=memory)


def test_a_run_decodes_once_and_a_cached_run_not_at_all(clip: Path, counts: Counter[str]) -> None:
    frame_count = open_clip(clip).frame_count
    counts.clear()
    run(clip, "a")
    assert counts["decoded"] == frame_count
    assert counts["opened"] == 2  # once to decode, and once to check whether the viewer can play it
    assert counts["hashed"] == 0  # `open_clip` has done it
    assert counts["timelines"] == counts["backgrounds"] == 1
    counts.clear()
    run(clip, "a")
    assert +counts == Counter()


def test_a_clip_that_does_not_fit_is_decoded_by_each_stage_with_equal_results(
    home: Home, clip: Path, counts: Counter[str]
) -> None:
    memory = FrameMemory(10 * 960 * 540)  # six frames
    finished = run(clip, "small", memory)
    assert counts["decoded"] > 6 * open_clip(clip).frame_count
    assert counts["timelines"] == counts["backgrounds"] == counts["hashed"] == 1
    assert [note for note in finished.notes if "frames take more than 5 MB of memory" in note]
    for name in ("poster.png", "slow.mp4", "report.html", *TABLES):
        assert (finished.folder / name).read_bytes() == (home.out / name).read_bytes(), name


def test_the_run_of_a_batch_uses_the_frames_from_the_search_for_shots(clip: Path, counts: Counter[str]) -> None:
    with open_frame_memory() as memory:
        cache = ResultCache(clip.parent / "cache-batch")
        assert find_recording_shots(clip, OPTIONS, cache, SilentWatcher(), SourceSnapshot(), memory).shots == ()
        frame_count = counts["decoded"]
        build_run_graph(clip, OPTIONS, memory=memory).select("detect").run(cache, SilentWatcher())
    assert counts["decoded"] == frame_count
    assert counts["hashed"] == 1


@pytest.mark.parametrize(("available", "cores", "budget"), [(64e9, 2, 1e9), (8e9, 4, 0.5e9), (16e9, 64, 0.0625e9)])
def test_the_processes_of_all_cores_take_a_quarter_of_the_memory_at_most(
    available: float, cores: int, budget: float
) -> None:
    assert frame_memory_budget(int(available), cores) == budget
