"""A run opens, decodes and hashes its clip once, and computes what the images share once."""

from __future__ import annotations

import hashlib
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import av
import pytest
from support.carom_start import Home

import video.io.decoder as decoder
import video.matting.ball_timeline as ball_timeline
import video.matting.hidden_background as hidden_background
from pipeline.chain import run_clip
from pipeline.engine.result_cache import ResultCache
from pipeline.run_options import RunOptions
from video.io.video_options import RenderOptions

OPTIONS = RunOptions(render=RenderOptions(slow=4.0, quick=True))


class SilentWatcher:
    def start_stage(self, stage: str) -> Any:
        return lambda share: None

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        pass


@pytest.fixture
def counts(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often a clip named start.mp4 was opened and hashed, its decoded frames, and the estimates for its images."""
    count: Counter[str] = Counter()

    def counting(owner: Any, name: str, what: str, is_counted: Any = lambda *given: True) -> None:
        function = getattr(owner, name)

        def call(*given: Any, **named: Any) -> Any:
            result = function(*given, **named)
            if is_counted(*given):
                count[what] += len(result) if what == "decoded" else 1
            return result

        monkeypatch.setattr(owner, name, call)

    counting(av, "open", "opened", lambda path, *rest: Path(path).name == "start.mp4" and "w" not in rest)
    counting(decoder, "_decode_packet", "decoded")
    counting(hashlib, "file_digest", "hashed", lambda file, *rest: Path(file.name).name == "start.mp4")
    counting(ball_timeline, "build_ball_timeline", "timelines")
    counting(hidden_background, "estimate_background_plate", "backgrounds")
    return count


def test_print(home: Home, tmp_path: Path, counts: Counter[str]) -> None:
    clip = shutil.copy(home.clip, tmp_path)
    run_clip(Path(clip), tmp_path / "out", OPTIONS, ResultCache(tmp_path / "cache"), SilentWatcher())
    print(dict(counts))
    counts.clear()
    run_clip(Path(clip), tmp_path / "again", OPTIONS, ResultCache(tmp_path / "cache"), SilentWatcher())
    print(dict(counts))
