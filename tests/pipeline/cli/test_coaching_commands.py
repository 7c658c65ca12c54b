"""`trueroll compare` and `trueroll what-if` write their files, and refuse bad input in one line."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from support.filmed_pot import R, film_pot

import trueroll
from models.core.errors import OptionError
from models.core.fit_result import ShotNumber, ShotNumbers
from models.estimation.shot_numbers.session_statistics import SeriesSummary, summarize_series
from pipeline.actions.compare_session import read_shots
from pipeline.cli.execute import execute_command_line
from pipeline.io.run_tables import describe_shot_numbers
from pipeline.reporting.text.number_sentences import (
    format_level,
    format_number,
    format_own_spread,
    format_spread,
    format_trend,
)

TABLE = {"length": 2.54, "width": 1.27, "pockets": True}


def make_shot(speed: float, direction: float, observable: bool = True) -> ShotNumbers:
    numbers = (
        ShotNumber("cue_speed", speed, 0.01, "m/s", True, "cue"),
        ShotNumber("direction", direction, 0.05, "deg", True, "cue"),
        ShotNumber("side_spin_share", 0.1 if observable else float("nan"), 0.05, "", observable, "cue"),
        ShotNumber("top_spin_share", 0.6, 0.05, "", True, "cue"),
        ShotNumber("pocket_offset", -12.0, 1.0, "mm", True, "red", "top-left"),
    )
    return ShotNumbers(0.2, "cue", "red", "follow", (0.0, 0.1, 0.9, 0.0), ("red",), ("top-left",), numbers)


def write_run(folder: Path, shot: ShotNumbers | None) -> Path:
    folder.mkdir(parents=True)
    scene: dict[str, Any] = {"scene": "billiards", "table": TABLE, "ball_radius": R}
    if shot is not None:
        scene["shot_numbers"] = describe_shot_numbers([shot])
    (folder / "scene.json").write_text(json.dumps(scene, allow_nan=False), encoding="utf-8")
    return folder


def write_session(folder: Path, count: int = 6) -> Path:
    for k in range(count):
        write_run(folder / f"shot, {k}", make_shot(2.0 + 0.1 * k, 30.0 + 0.2 * (k % 2), observable=k > 0))
    return folder


def test_numbers_survive_a_scene_file(tmp_path: Path) -> None:
    one, two = make_shot(2.0, 30.0), make_shot(2.0, 30.0, observable=False)
    assert [shot.shot for shot in read_shots(write_run(tmp_path / "one", one))] == [one]
    (read,) = (shot.shot for shot in read_shots(write_run(tmp_path / "two", two)))
    assert read.spin_state == "follow"
    assert not read.numbers[2].observable


def test_a_session_is_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = write_session(tmp_path / "session"), tmp_path / "out"
    assert execute_command_line(["compare", str(folder), "-o", str(out), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    speed = next(one for one in answer["groups"]["all"] if one["name"] == "cue_speed")
    assert speed["slope"] == pytest.approx(0.1)
    assert speed["has_trend"]
    side = next(one for one in answer["groups"]["all"] if one["name"] == "side_spin_share")
    assert side["count"] == 5
    with (out / "session.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["number"] for row in rows] == list("123456")
    assert rows[0]["side_spin_share"] == ""
    assert rows[0]["folder"].endswith("shot, 0")
    assert pq.read_table(out / "session.parquet").num_rows == 6
    assert "Speed after the strike" in (out / "session.html").read_text(encoding="utf-8")


def test_balls_and_pockets_are_called_what_a_viewer_calls_them(tmp_path: Path) -> None:
    """Two clips give the red 3 different ids; both show the table from its end, with `top` on the right."""
    for ball, place in (("solid-1", "one"), ("solid-2", "two")):
        shot = make_shot(2.0, 30.0)
        pot = replace(shot.numbers[-1], ball=ball)
        shot = replace(shot, first=ball, potted=(ball,), numbers=(*shot.numbers[:-1], pot))
        path = write_run(tmp_path / "session" / place, shot) / "scene.json"
        scene = json.loads(path.read_text(encoding="utf-8"))
        scene["balls"] = [{"id": "cue", "name": "cue ball"}, {"id": ball, "name": "red 3", "number": 3}]
        f, (u, v) = 300.0, (100.0, 50.0)  # x runs down, y to the left
        corners = [[u + f * (1.27 - y), v + f * x] for x, y in ((0, 0), (2.54, 0), (2.54, 1.27), (0, 1.27))]
        scene["image"] = {"width_px": 600, "height_px": 900}
        scene["calibration"] = {
            "matrix": [[0, -f, 0, u + 1.27 * f], [f, 0, 0, v], [0, 0, 0.1, 1]], "corners_px": corners,
            "corner_covariance_px2": np.eye(8).tolist(), "plane": "noses", "camera_height": 3, "camera_height_sigma": 1,
        }  # fmt: skip
        path.write_text(json.dumps(scene), encoding="utf-8")
    for group, name in (("ball", "red 3"), ("pocket", "far-right pocket")):
        answer = trueroll.compare(tmp_path / "session", out=tmp_path / group, group=group)
        assert list(answer.document["groups"]) == ["all", name]
        assert "NaN" not in json.dumps(answer.document), "as in session.json"
    page = (tmp_path / "ball" / "session.html").read_text(encoding="utf-8")
    assert '<td data-label="first ball">red 3</td>' in page
    assert '<td data-label="potted">red 3 far-right pocket</td>' in page
    assert "solid-" not in page
    with (tmp_path / "ball" / "session.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["first"], row["first_name"]) for row in rows] == [("solid-1", "red 3"), ("solid-2", "red 3")]


@pytest.mark.parametrize("function", [trueroll.call, trueroll.compare, trueroll.put_back, trueroll.run])
@pytest.mark.parametrize("out", ["", " "])
def test_an_empty_out_is_refused_and_nothing_is_written(
    function: Callable[..., object], out: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An empty path would mean the current folder."""
    monkeypatch.chdir(tmp_path)
    folder = write_session(tmp_path / "session", 2)
    with pytest.raises(OptionError, match="needs a name; an empty one was given"):
        function(folder, out=out)
    assert list(tmp_path.iterdir()) == [folder]


def make_summary(name: str, unit: str, values: list[float], sigma: float) -> SeriesSummary:
    count = len(values)
    return summarize_series(name, unit, np.arange(count, dtype=float), np.array(values), np.full(count, sigma))


def test_a_session_is_printed_with_the_digits_of_its_errors() -> None:
    few = make_summary("cue_speed", "m/s", [2.8813, 2.8814], 0.0025)
    level = format_level(few), format_own_spread(few), format_trend(few)
    assert level == ("2.88 m/s (10.4 km/h)", "below 0.01", "needs 4 shots")
    assert format_spread(make_summary("cushions", "", [2.99, 2.99 + 4e-6], 0.09)) == "0"
    spin = make_summary("top_spin_share", "", [0.10, 0.20, 0.31, 0.40, 0.52], 0.01)
    assert "e-" not in format_trend(spin)
    assert format_trend(spin).startswith("0.10")
    assert float(format_own_spread(spin)) > 0.1
    around = make_summary("direction", "deg", [179.0, -179.0, 179.5, -179.5], 0.07)
    assert format_level(around, ["to the long rails"] * 4) == "0° to the long rails"
    assert format_level(around, ["towards the left rail", "towards the right rail"]) == "of several directions"
    assert float(format_spread(around)) < 2, "179 and -179 degrees are neighbours"
    direction = make_summary("direction", "deg", [-34.42, 15.38], 0.07)
    assert (format_spread(direction), format_own_spread(direction)) == ("36.9", "36.9"), "as in the report of a shot"
    assert format_level(make_summary("cushions", "", [2.99, 2.99], 0.05)) == "3"


def test_a_session_words_a_number_as_the_report_of_its_shot_does() -> None:
    for name, unit, value, sigma, words in (
        ("cut_angle", "deg", -30.54, 0.34, "30.5 ± 0.3° left"),
        ("throw", "deg", 0.19, 0.3, "may be zero (0.2 ± 0.3°)"),
        ("top_spin_share", "", 0.44, 0.17, "0.44 ± 0.17 top"),
        ("contact_speed", "m/s", 2.0, 0.5, "2.0 ± 0.5 m/s (7.2 km/h)"),
        ("pocket_offset", "mm", -9.57, 0.31, "9.6 ± 0.3 mm left"), ("object_length", "m", 1.51, 0.01, "1.51 ± 0.01 m"),
        ("object_cushions", "", 1.0, 0.0, "1"), ("cushions", "", 4.96, 0.3, "5"),
    ):  # fmt: skip
        assert format_number(ShotNumber(name, value, sigma, unit, True)) == words
        level = "may be zero" if name == "throw" else re.sub(r" ± [\d.]+", "", words)
        assert format_level(make_summary(name, unit, [value], sigma)) == level


def test_runs_of_one_clip_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [write_run(tmp_path / name, make_shot(2.0, 30.0)) for name in ("good", "fixed")]
    for folder in folders:
        scene = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        (folder / "scene.json").write_text(json.dumps({**scene, "clip": {"sha256": "a"}}), encoding="utf-8")
    assert execute_command_line(["compare", *map(str, folders), "-o", str(tmp_path / "out")]) == 0
    assert "fixed is a run of the same clip as" in capsys.readouterr().out
    assert "its shots count twice" in (tmp_path / "out" / "session.html").read_text(encoding="utf-8")


def test_the_folders_of_a_batch_are_compared_without_its_table_and_several_games_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_session(tmp_path / "batch", 3)
    (folder / "summary.csv").touch()
    assert execute_command_line(["compare", *map(str, folder.iterdir()), "-o", str(tmp_path / "out")]) == 0
    assert "3 shots of" in capsys.readouterr().out
    scene = json.loads((folder / "shot, 0" / "scene.json").read_text(encoding="utf-8"))
    scene["table"] |= {"game": "carom", "pockets": False}
    (folder / "shot, 0" / "scene.json").write_text(json.dumps(scene), encoding="utf-8")
    assert execute_command_line(["compare", str(folder), "-o", str(tmp_path / "out")]) == 2
    assert "one game are compared at a time; these are of 2 (carom: shot, 0; pool: " in capsys.readouterr().err


def test_shots_are_grouped_by_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two = write_session(tmp_path / "monday", 4), write_session(tmp_path / "friday", 5)
    assert execute_command_line(["compare", str(one), str(two), "-o", str(tmp_path / "out"), "--json"]) == 0
    groups = json.loads(capsys.readouterr().out)["groups"]
    assert [rows[0]["count"] for rows in groups.values()] == [9, 4, 5]


def test_a_folder_without_numbers_is_named_and_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_session(tmp_path / "session", 2)
    write_run(folder / "older", None)
    assert execute_command_line(["compare", str(folder), "-o", str(tmp_path / "out")]) == 1
    assert "older was written by a version without shot numbers" in capsys.readouterr().err.replace("\n", "")
    assert (tmp_path / "out" / "session.html").is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["compare", "nothing"], "nothing holds no scene.json"),
        (["compare", "nothing", "--group", "mood"], "--group is one of"),
        (["what-if", "nothing", "--speed", "fast"], "--speed is a number"),
        (["what-if", "nothing", "--speed", "99"], "up to 15 m/s"),
        (["what-if", "nothing", "--speed=-5"], "write -5% to change it by 5 %, or 5 to play at 5 m/s"),
        (["what-if", "nothing", "--draws", "few"], "--draws is a whole number; got few"),
        (["what-if", "nothing", "--side", "+300%"], "--side is at most"),
        (["what-if", "nothing", "--spread", "much"], "--spread is a share of the speed and degrees"),
        (["what-if", "nothing", "--spread", "3%,0.4", "--session", "x"], "give one of them"),
        (["what-if", "nothing", "--game", "chess"], "--game is one of"),
    ],
)
def test_bad_words_are_refused_in_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert execute_command_line(words) == 2
    assert sentence in capsys.readouterr().err.replace("\n", " ")
    assert not list(tmp_path.iterdir())


def write_pot(folder: Path) -> Path:
    folder.mkdir()
    tracks = film_pot(3)
    with (folder / "tracks.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(["shot", "frame", "t", "id", "kind", "x", "y", "sigma"])
        for frame, t, places in zip(tracks.frame, tracks.t, tracks.xy, strict=True):
            for ball, (x, y) in zip(tracks.ids, places.tolist(), strict=True):
                if x == x:
                    rows.writerow([0, frame, t, ball, ball, x, y, 3e-4])
    scene = {"scene": "billiards", "units": "m", "fps": 60, "table": TABLE, "ball_radius": R}
    (folder / "scene.json").write_text(json.dumps(scene), encoding="utf-8")
    return folder


@pytest.mark.slow
def test_a_shot_is_played_otherwise(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_pot(tmp_path / "pot")
    words = ["what-if", str(folder), "--draws", "60", "--cache", str(tmp_path / "cache"), "--json"]
    answers = {}
    for name, change in (("same", []), ("aside", ["--angle", "-3deg"]), ("again", ["--angle", "-3deg"])):
        assert execute_command_line([*words, "-o", str(tmp_path / name), *change]) == 0
        answers[name] = json.loads(capsys.readouterr().out)
    assert answers["same"]["real"]["scored"]
    assert answers["same"]["changed"]["probability"] > 0.6
    assert answers["aside"]["changed"]["probability"] < 0.2
    assert answers["aside"]["real"] == answers["same"]["real"]
    for name in ("what_if.json", "what_if.csv", "what_if.png"):
        assert (tmp_path / "aside" / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    with Image.open(tmp_path / "aside" / "what_if.png") as plan:
        assert plan.size[0] == 1280
    assert execute_command_line([*words[:2], "--game", "carom"]) == 2
    assert "needs three balls" in capsys.readouterr().err
    assert execute_command_line([*words[:2], "--pocket", "left"]) == 2
    assert "--pocket is one of" in capsys.readouterr().err
