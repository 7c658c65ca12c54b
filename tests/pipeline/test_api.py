"""The code of docs/tutorials/python.md runs, and its values equal those of the files."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import csv
from support.carom_start import SAMPLE, Home

from models.core.errors import ClipError, OptionError
from pipeline import api
from pipeline.api import Run, run

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = (ROOT / "docs" / "tutorials" / "python.md").read_text(encoding="utf-8")


class FakeViewer:
    """A viewer that opens no window."""

    address = ""

    def __init__(self, recordings: list[Path], web: bool) -> None:
        self.recordings, self.web, self.closed = recordings, web, False

    def close(self) -> None:
        self.closed = True


@pytest.fixture(scope="module")
def names(home: Home, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Run the code of the page on the start of its clip; return the names that it defines."""
    folder = home.copy_to(tmp_path_factory.mktemp("notebook") / "home").folder
    (folder / "sample_videos").mkdir()
    (folder / "sample_videos" / SAMPLE.name).symlink_to(home.clip)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("TRUEROLL_CACHE", str(folder / "cache"))
        patch.setattr(api, "start_viewer", lambda recordings, web: FakeViewer(recordings, web))
        names: dict[str, Any] = {}
        code = "\n".join(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL))
        exec(compile(code, "docs/tutorials/python.md", "exec"), names)  # what a reader would type
        yield names | {"folder": folder}


def test_the_page_shows_the_recording_of_the_run_and_closes_the_viewer(names: dict[str, Any]) -> None:
    viewer = names["viewer"]
    assert [path.name for path in viewer.recordings] == ["recording.rrd"]
    assert viewer.closed


def test_values_are_those_of_the_files(names: dict[str, Any]) -> None:
    shot: Run = names["shot"]
    events = shot.to_arrow("events")
    assert events["kind"].to_pylist() == list(shot.events.kind)
    assert events["t"].to_pylist() == pytest.approx(shot.events.t, abs=1e-6)
    rows = shot.to_arrow("trajectory").to_pylist()[::97]
    state = shot.trajectory.at(np.array([row["t"] for row in rows]))
    of = [shot.trajectory.ids.index(row["id"]) for row in rows]
    fitted = state.xy[np.arange(len(rows)), of]
    assert fitted == pytest.approx(np.array([[row["x"], row["y"]] for row in rows]), abs=1e-6)
    written = csv.read_csv(shot.folder / "tracks.csv")
    assert shot.to_arrow().column_names == written.column_names
    assert shot.to_arrow().num_rows == written.num_rows


def test_the_motion_can_be_evaluated_at_any_time(names: dict[str, Any]) -> None:
    shot: Run = names["shot"]
    assert shot.trajectory.at(1.25).xy.shape == (len(shot.trajectory.ids), 2)


def test_a_table_that_is_not_there_is_refused(names: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="tracks, events, trajectory"):
        names["shot"].to_arrow("balls")


def test_without_pandas_a_frame_is_one_sentence(names: dict[str, Any]) -> None:
    try:
        import pandas  # noqa: F401
    except ImportError:
        with pytest.raises(OptionError, match="pip install pandas"):
            names["shot"].to_pandas()
    else:
        assert names["shot"].to_pandas("events")["kind"].tolist() == list(names["shot"].events.kind)


def test_a_second_run_uses_the_cache_and_reports_progress(names: dict[str, Any]) -> None:
    progress: list[tuple[str, float]] = []
    again = run(
        names["folder"] / "sample_videos" / SAMPLE.name,
        names["folder"] / "again",
        cache=names["folder"] / "cache",
        progress=lambda stage, share: progress.append((stage, share)),
        slow=8,
    )
    assert [share for _, share in progress] == [1.0] * len(progress)
    assert {"read", "calibrate", "detect", "track", "explain", "record", "report"} <= {stage for stage, _ in progress}
    assert again.tracks.ids == names["shot"].tracks.ids


def test_a_setting_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="got speed"):
        run(tmp_path / "shot.mp4", speed=8)


def test_a_clip_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match=r"nowhere\.mp4"):
        run(tmp_path / "nowhere.mp4", tmp_path / "out", cache=tmp_path / "cache")


def test_importing_it_opens_no_window_and_needs_no_pandas() -> None:
    code = "import sys, pipeline.api; sys.exit('pandas' in sys.modules or 'rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
