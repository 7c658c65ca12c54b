"""The program answers wrong usage and files that are no clips with one line and the right status."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from support import synthetic_run as shot
from support.pseudo_terminal import Terminal, make_terminal

from pipeline.batch.clip_discovery import assign_folders, survey_folder
from pipeline.cli.commands import COMMAND_NAMES, load_command, read_summary
from pipeline.engine.process_setup import limit_library_threads
from pipeline.run_options import build_options, list_settings
from pipeline.settings import DoorOptions, collect_settings
from pipeline.terminal.command_line import app
from video.io.video_writer import VideoWriter

trueroll = pytest.fixture(make_terminal)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to an empty folder with its own cache and room for long lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


def write_noise(path: Path, count: int) -> None:
    """Write a video of noise, which shows no table."""
    chance = np.random.default_rng(5)
    with VideoWriter(path, 320, 180, Fraction(30)) as writer:
        for _ in range(count):
            writer.write(chance.integers(0, 255, (180, 320, 3), dtype=np.uint8))


def write_sound(path: Path) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=44100, layout="mono")
        for k in range(20):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
            frame.sample_rate, frame.pts = 44100, 1024 * k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def write_truncated(path: Path) -> None:
    """Write a video that is cut off within its index."""
    write_noise(path, 20)
    path.write_bytes(path.read_bytes()[:400])


BAD = {
    "missing": (lambda path: None, "does not exist"),
    "folder": (Path.mkdir, "is a folder"),
    "empty": (Path.touch, "empty"),
    "text": (lambda path: path.write_text("This is a list of things to buy.\n" * 50), "not a (readable )?video"),
    "truncated": (write_truncated, "truncated"),
    "sound": (write_sound, "audio but no video"),
    "single": (lambda path: write_noise(path, 1), "1 distinct frame"),
    "snow": (lambda path: write_noise(path, 20), "cloth|table"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_clip_is_one_line_and_leaves_nothing(trueroll: Terminal, name: str) -> None:
    make, wanted = BAD[name]
    clip = Path(f"{name}.mp4")
    make(clip)
    result = trueroll("run", clip, "-o", "out")
    assert result.status == 1
    assert result.out == ""
    assert re.fullmatch(rf"trueroll: [^\n]*({wanted})[^\n]*\n", result.err), result.err
    assert "Traceback" not in result.err
    assert "unforeseen" not in result.err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("arguments", "wanted"),
    [
        (("run",), "clip"),
        (("run", "--nope", "x.mp4"), "--nope"),
        (("walk",), "walk"),
        (("run", "x.mp4", "--slow", "much"), "--slow"),
        (("run", "x.mp4", "--slow", "0"), "1 to 100 "),
        (("run", "x.mp4", "--fps", "fast"), "30000/1001"),
        (("run", "x.mp4", "--fps", "1/0"), "30000/1001"),
        (("run", "x.mp4", "--fps", "-25"), "1 to 1000 "),
        (("run", "x.mp4", "--fps", "1e5"), "1 to 1000 "),
        (("run", "x.mp4", "--pixel-aspect", "16x9"), "64/45"),
        (("run", "x.mp4", "--slow", "nan"), "1 to 100 "),
        (("run", "x.mp4", "--breadth", "0"), "1 or more"),
        (("run", "x.mp4", "--patience", "inf"), "more than 0"),
        (("run", "x.mp4", "--balls", "-1"), "0 or more"),
        (("run", "x.mp4", "--break-price", "nan"), "0 or more"),
        (("run", "x.mp4", "--free-price", "-1"), "0 or more"),
        (("run", "x.mp4", "--moving-speed", "0"), "at most 1 m/s"),
        (("detect", "nowhere", "-o", "balls.csv"), "nowhere is not there"),
        (("detect", ".", "-o", "."), "is a folder"),
        (("detect", ".", "--detector", "hough", "--model", "balls.onnx", "-o", "balls.csv"), "leave out one of them"),
        (("train-detector", "--hours", "0"), "--hours"),
        (("train-detector", "-o", "."), "is a folder"),
        (("train-detector", "--part", "balls", "--seen-by", "balls.onnx"), "--part streaks"),
        (("train-detector", "--part", "streaks", "--from", "balls.onnx"), "--part balls"),
        (("train-detector", "--part", "streaks", "--seen-by", "nowhere.onnx"), "not there"),
        (("train-detector", "--part", "discs", "--seen-by", "balls.onnx"), "--part streaks"),
        (("train-detector", "--part", "discs", "--from", "balls.onnx"), "--part balls"),
        (("train-detector", "--from", "nowhere.onnx"), "not there"),
        (("train-detector", "--from", "."), "a folder"),
        (("run", "x.mp4", "-o", ""), "--out"),
        (("run", "x.mp4", "--detector", "magic"), "--detector"),
        (("batch", "nowhere"), "nowhere"),
        (("batch", "."), "holds none"),
        (("view", "."), "contains none"),
        (("view", "missing.rrd"), "missing.rrd"),
        (("graph", "-o", "graph.gif"), "svg"),
        (("cache", "--prune"), "--older-than"),
        (("cache", "--prune", "--max-size", "-5"), "0 or more"),
        (("cache", "--prune", "--older-than", "nan"), "0 or more"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(trueroll: Terminal, arguments: tuple[str, ...], wanted: str) -> None:
    result = trueroll(*arguments)
    assert result.status == 2
    assert re.fullmatch(rf"trueroll: [^\n]*{re.escape(wanted)}[^\n]*\n", result.err), result.err


@pytest.mark.parametrize(
    ("option", "wanted"),
    [("--corners=1,2,3", "eight numbers"), ("--table=huge", "huge"), ("--model=no", "no")],
)
def test_an_option_that_makes_no_sense_for_a_clip_is_wrong_usage(trueroll: Terminal, option: str, wanted: str) -> None:
    shot.write_clip(Path("clip.mp4"))
    result = trueroll("run", "clip.mp4", option)
    assert result.status == 2
    assert re.fullmatch(rf"trueroll: [^\n]*{wanted}[^\n]*\n", result.err), result.err


def test_results_that_cannot_be_written_are_known_before_the_work(trueroll: Terminal) -> None:
    shot.write_clip(Path("clip.mp4"))
    result = trueroll("run", "clip.mp4", "-o", "clip.mp4/out")
    assert result.status == 2
    assert result.err.count("\n") == 1
    assert "-o" in result.err


def test_a_clip_is_never_overwritten_by_its_own_results(trueroll: Terminal) -> None:
    Path("ow").mkdir()
    shot.write_clip(Path("ow/slow.mp4"))
    before = Path("ow/slow.mp4").read_bytes()
    result = trueroll("run", "ow/slow.mp4", "-o", "ow")
    assert result.status == 2
    assert "overwrite" in result.err
    assert Path("ow/slow.mp4").read_bytes() == before


def test_clips_of_a_batch_get_folders_of_their_own() -> None:
    clips = [Path("in") / name for name in ("a.mp4", "b.mp4", "b.mov", "deeper/a.mp4")]
    folders = assign_folders(clips, Path("in"), Path("out"))
    assert [str(folders[clip]) for clip in clips] == ["out/a", "out/b_mp4", "out/b_mov", "out/deeper/a"]


def test_what_an_earlier_run_made_is_no_clip() -> None:
    for name in ("in/a.mp4", "in/done/slow.mp4", "in/done/source.json", "in/mine/slow.mp4"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    assert [str(path) for path in survey_folder(Path("in")).clips] == ["in/a.mp4", "in/mine/slow.mp4"]


def test_a_broken_film_is_a_failed_row_and_other_files_are_none(trueroll: Terminal) -> None:
    Path("in").mkdir()
    Path("in/broken.mp4").write_text("no film")
    Path("in/notes.doc").write_text("no film")
    result = trueroll("batch", "in", "-o", "many", "--json")
    assert result.status == 1
    (row,) = json.loads(result.out)
    assert (row["clip"], row["status"]) == ("broken.mp4", "failed")
    assert "not a readable video" in row["sentence"]


def test_debug_shows_where_an_error_comes_from(trueroll: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    logger = logging.getLogger("trueroll")
    monkeypatch.setattr(logger, "handlers", [])  # the handler of this run keeps its standard error
    monkeypatch.setattr(logger, "level", logger.level)
    result = trueroll("run", "missing.mp4", "--debug")
    assert result.status == 1
    assert "Traceback" in result.err
    assert result.err.splitlines()[-1].startswith("trueroll: ")


def test_what_nobody_foresaw_is_one_line_too(trueroll: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a sum\nof nothing")

    monkeypatch.setattr("pipeline.cli.commands.run_command.run_chosen_shot", fail)
    result = trueroll("run", "x.mp4")
    assert result.status == 1
    assert result.err.count("\n") == 1
    assert "ZeroDivisionError: a sum of nothing" in result.err


def test_an_interrupted_run_says_so(trueroll: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pipeline.cli.commands.run_command.run_chosen_shot", stop)
    result = trueroll("run", "x.mp4")
    assert result.status == 130
    assert result.err == "trueroll: interrupted; nothing half-written is left\n"


INTERRUPTED_AT = """
import atexit, signal, sys
import pipeline.cli.main

class WhileLoading:
    def find_spec(self, name, path, target=None):
        if name == "pipeline.cli.execute":
            signal.raise_signal(signal.SIGINT)

{moment}
pipeline.cli.main.main()
"""


@pytest.mark.parametrize(
    "moment",
    ["sys.meta_path.insert(0, WhileLoading())", "atexit.register(signal.raise_signal, signal.SIGINT)"],
    ids=["loading", "leaving"],
)
def test_an_interrupt_while_the_program_is_loading_or_leaving_is_one_line(moment: str) -> None:
    code = INTERRUPTED_AT.format(moment=moment)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert (result.returncode, result.stderr) == (130, "trueroll: interrupted; nothing half-written is left\n")


@pytest.mark.parametrize(("swallowed", "status"), [(KeyboardInterrupt(), 130), (SystemExit(143), 143)])
def test_an_interrupt_that_a_finaliser_swallows_is_raised_again(
    trueroll: Terminal, monkeypatch: pytest.MonkeyPatch, swallowed: BaseException, status: int
) -> None:
    class Swallows:
        def __del__(self) -> None:
            raise swallowed

    def work(*_: object, **__: object) -> None:
        Swallows()
        time.sleep(20)

    monkeypatch.setattr("pipeline.cli.commands.run_command.run_chosen_shot", work)
    assert trueroll("run", "x.mp4").status == status


def test_help_holds_every_option_with_its_meaning(trueroll: Terminal) -> None:
    result = trueroll("run", "--help")
    assert result.status == 0
    words = re.sub(r"[\s│]+", " ", result.out)
    for setting in list_settings().values():
        assert setting.help, f"{setting.flag} does not say what it means"
        assert setting.flag in words
        assert setting.help in words
        if setting.default not in (None, False, ""):
            assert f"default: {setting.default}" in words


@pytest.mark.parametrize(("command", "left_out"), [("check", ()), ("batch", ()), ("detect", ("fps", "sport"))])
def test_the_door_has_the_same_options_for_every_command(
    trueroll: Terminal, command: str, left_out: tuple[str, ...]
) -> None:
    words = re.sub(r"[\s│]+", " ", trueroll(command, "--help").out)
    door = collect_settings(DoorOptions(), DoorOptions.__slots__)
    for name in sorted({*door} - {"profile", *left_out}):
        assert door[name].flag in words
        assert door[name].help in words


def test_help_names_every_command_and_so_does_no_argument(trueroll: Terminal) -> None:
    result = trueroll("--help")
    assert result.status == 0
    assert all(re.search(rf"\b{name}\b", result.out) for name in COMMAND_NAMES)
    assert trueroll().out == result.out
    assert trueroll("--help", "run").out == result.out


def test_help_of_the_program_waits_for_nothing_heavy() -> None:
    code = (
        "import sys; from pipeline.cli.execute import execute_command_line; execute_command_line(['--help']);"
        "print(sorted({'numpy', 'av', 'cv2', 'scipy', 'torch', 'numba', 'rerun', 'plotly'} & sys.modules.keys()))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True)
    assert result.stdout.splitlines()[-1] == "[]"


def test_the_sentence_in_the_list_is_that_of_the_command_itself() -> None:
    for name in COMMAND_NAMES:
        load_command(name)
    docstrings = {
        command.name: command.callback.__doc__ or "" for command in app.registered_commands if command.callback
    }
    assert {name: read_summary(name) for name in COMMAND_NAMES} == {
        n: d.partition("\n\n")[0] for n, d in docstrings.items()
    }


def test_the_version_is_printed(trueroll: Terminal) -> None:
    assert re.fullmatch(r"trueroll \d+\.\d+\.\d+\n", trueroll("--version").out)


def test_the_graph_of_a_clip_says_what_would_run(trueroll: Terminal) -> None:
    shot.write_clip(Path("clip.mp4"))
    views = {view["stage"]: view for view in json.loads(trueroll("graph", "clip.mp4", "--json").out)}
    assert views["read"]["state"] == "stale"
    assert views["explain"]["state"] == "waiting"
    assert "read" in trueroll("graph", "clip.mp4", "-o", "graph.svg").out
    assert Path("graph.svg").read_text().startswith("<svg")


def test_another_network_under_the_same_name_is_another_detector(trueroll: Terminal) -> None:
    from pipeline.chain import build_run_graph
    from pipeline.run_options import RunOptions, build_options

    shot.write_clip(Path("clip.mp4"))
    plain = {name: setting.default for name, setting in list_settings().items()}
    facts = []
    for content in ("one", "two"):
        Path("net.onnx").write_text(content)
        stages = build_run_graph(Path("clip.mp4"), build_options(plain | {"model": "net.onnx"})).stages
        facts.append(next(stage.facts for stage in stages if stage.name == "detect"))
    assert facts[0] != facts[1]
    assert build_options(plain) == RunOptions()


def test_the_cache_is_listed_and_pruned(trueroll: Terminal) -> None:
    assert json.loads(trueroll("cache", "--json").out) == []
    assert trueroll("cache", "--prune", "--max-size", "0").status == 0


def test_algebra_runs_on_one_thread_unless_the_user_set_another_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    monkeypatch.delenv("OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER", raising=False)
    limit_library_threads()
    assert os.environ["OMP_NUM_THREADS"] == "1"
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
    assert os.environ["OPENCV_THREAD_POOL_ACTIVE_WAIT_WORKER"] == "0"


def test_a_whole_number_and_the_same_decimal_number_are_one_value_with_one_cache_entry() -> None:
    for name in ("slow", "ball_radius"):
        assert repr(build_options({name: 8})) == repr(build_options({name: 8.0}))
    assert repr(build_options({"no_video": True})) != repr(build_options({"no_video": False}))
