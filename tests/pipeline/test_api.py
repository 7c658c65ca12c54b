"""The code of docs/tutorials/python.md runs, and its values equal those of the files."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
import pytest
import typer.main
from pyarrow import csv
from support.carom_start import SAMPLE, Home

import trueroll
from models.core.answer import Answer
from models.core.errors import ClipError, OptionError
from pipeline import api
from pipeline.api import Run, run
from pipeline.cli.commands import load_command
from pipeline.cli.execute import execute_command_line
from pipeline.io.strict_json import format_strict_json
from pipeline.run_options import RunSettings, list_settings
from pipeline.terminal.command_line import app

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = (ROOT / "docs" / "tutorials" / "python.md").read_text(encoding="utf-8")


def run_command(*words: object) -> str:
    """Run `trueroll WORDS...`, and return what it prints."""
    with redirect_stdout(StringIO()) as out:
        assert execute_command_line([str(word) for word in words]) == 0
    return out.getvalue()


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
        run(tmp_path / "shot.mp4", speed=8)  # type: ignore[call-arg]


def test_a_clip_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ClipError, match=r"nowhere\.mp4"):
        run(tmp_path / "nowhere.mp4", tmp_path / "out", cache=tmp_path / "cache")


def test_importing_it_opens_no_window_and_needs_no_pandas() -> None:
    code = "import sys, pipeline.api; sys.exit('pandas' in sys.modules or 'rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_the_typed_settings_of_a_run_are_the_options_of_its_command() -> None:
    assert get_type_hints(RunSettings) == {name: setting.type for name, setting in list_settings().items()}


def test_every_public_name_is_there() -> None:
    assert re.fullmatch(r"\d+\.\d+.*", trueroll.__version__)
    assert all(getattr(trueroll, name) for name in trueroll.__all__)
    with pytest.raises(AttributeError, match="no attribute 'guess'"):
        _ = trueroll.guess


@pytest.mark.parametrize("name", ["call", "certify", "compare", "fit-table", "predict", "put-back", "what-if"])
def test_a_question_of_python_takes_the_options_of_its_command(name: str) -> None:
    load_command(name)
    group = typer.main.get_command(app)
    options = {one.name for one in getattr(group, "commands", {}).get(name, group).params}
    function = getattr(trueroll, name.replace("-", "_"))
    hooks = {"on_activity", "on_answer"}
    assert options - {"help"} == (inspect.signature(function).parameters.keys() - hooks) | {"as_json", "debug"}
    assert "Args:\n    " in function.__doc__


def test_a_question_of_python_has_the_answer_of_the_command(home: Home, tmp_path: Path) -> None:
    loaded = trueroll.load(home.out)
    answer = trueroll.call(loaded, "contact white yellow", out=tmp_path / "python")
    home_words = ("call", home.out, "contact", "white", "yellow", "-o", tmp_path / "python", "--json")
    assert json.loads(run_command(*home_words)) == json.loads(format_strict_json(answer.document))
    assert run_command(*home_words[:-1]).splitlines()[0] == answer.sentences[0]
    places = trueroll.put_back(loaded, out=tmp_path / "places")
    assert places["x", "yellow"].sigma > 0
    assert [row[0] for row in places.rows[1:]] == [look.name for look in loaded.tracks.looks]
    assert trueroll.compare(loaded, out=tmp_path / "session").rows[0][0] == "number"


def test_results_show_one_line_in_a_script_and_a_table_in_a_notebook(home: Home, tmp_path: Path) -> None:
    loaded = trueroll.load(home.out)
    answer = trueroll.call(loaded, "first white", out=tmp_path)
    values = (loaded, loaded.shot, loaded.tracks, answer, loaded.events)
    for value in values:
        assert "\n" not in repr(value)
        assert "array" not in repr(value)
        assert len(repr(value)) < 300
    for value in values[:-1]:
        assert "<table>" in value._repr_html_() or isinstance(value, Answer)
    assert "touched the yellow first" in repr(answer) or "yellow (" in repr(answer)
    assert "data:image/png" in answer._repr_html_()
