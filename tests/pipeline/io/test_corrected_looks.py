"""scene.json states what each ball is called and how it looks, and a run takes corrected values back from it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from support.carom_start import Home
from support.planted_mistakes import SilentWatcher

from models.core.ball_look import BallLook, format_colour
from models.core.errors import OptionError
from models.core.tracks import Tracks
from models.tracking.ball_names import correct_looks
from pipeline.chain import build_run_graph
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.stage_graph import load_stage_output
from pipeline.io.run_folder import read_looks_text
from pipeline.io.saved_shot import read_shot
from pipeline.run_options import build_options

LOOKS = (BallLook("yellow stripe", (250, 192, 47), 0, True), BallLook("red 3", (214, 59, 59), 3))
IDS = ("stripe-1", "solid-1")


def write_scene(folder: Path, *balls: dict[str, object]) -> Path:
    """Write a scene.json with balls."""
    path = folder / "scene.json"
    path.write_text(json.dumps({"scene": "billiards", "balls": balls}), encoding="utf-8")
    return path


def test_values_that_nobody_changed_change_nothing(tmp_path: Path) -> None:
    rows = [
        {"id": ball, "name": look.name, "number": look.number or None, "colour": format_colour(look.colour)}
        for ball, look in zip(IDS, LOOKS, strict=True)
    ]
    corrected = json.loads(read_looks_text(write_scene(tmp_path, *rows, {"id": "solid-9", "number": 2})))
    assert correct_looks(IDS, LOOKS, corrected) == LOOKS


def test_a_number_that_was_changed_gives_the_name_and_the_pattern() -> None:
    changed = {"stripe-1": {"name": "yellow stripe", "number": 1}, "solid-1": {"number": 11}}
    assert correct_looks(IDS, LOOKS, changed) == (
        BallLook("yellow 1", (250, 192, 47), 1, False),
        BallLook("red 11", (214, 59, 59), 11, True),
    )


def test_a_number_that_was_withdrawn_leaves_the_colour_and_the_pattern(tmp_path: Path) -> None:
    looks = (BallLook("blue 10", (40, 51, 130), 10, True), *LOOKS[1:], BallLook("black 8", (40, 40, 40), 8))
    ids = (*IDS, "eight")
    rows = [{"id": ball, "name": look.name, "number": None} for ball, look in zip(ids, looks, strict=True)]
    withdrawn = correct_looks(ids, looks, json.loads(read_looks_text(write_scene(tmp_path, *rows))))
    assert [(look.name, look.number, look.is_striped) for look in withdrawn] == [
        ("blue stripe", 0, True), ("red", 0, False), ("black", 0, False),
    ]  # fmt: skip
    assert correct_looks(ids, looks, json.loads(read_looks_text(write_scene(tmp_path, {"id": "solid-1"})))) == looks
    with pytest.raises(OptionError, match="1 to 15"):
        read_looks_text(write_scene(tmp_path, {"id": "solid-1", "number": 0}))


def test_a_name_and_a_colour_that_were_changed_are_taken_as_they_are() -> None:
    changed = {"solid-1": {"name": "the dented one", "number": 3, "colour": "#ff0000"}}
    assert correct_looks(IDS, LOOKS, changed)[1] == BallLook("the dented one", (255, 0, 0), 3)


@pytest.mark.parametrize(
    ("value", "words"), [({"number": 16}, "1 to 15"), ({"colour": "red"}, "#d63b3b"), ({"name": " "}, "a name")]
)
def test_a_value_that_no_ball_has_is_refused(tmp_path: Path, value: dict[str, object], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        read_looks_text(write_scene(tmp_path, {"id": "solid-1", **value}))


def test_a_run_writes_the_looks_and_takes_corrected_ones_back(own_home: Home, home: Home, tmp_path: Path) -> None:
    scene = tmp_path / "scene.json"
    shutil.copy(home.out / "scene.json", scene)
    document = json.loads(scene.read_text(encoding="utf-8"))
    shot = read_shot(home.out)
    written = {ball["id"]: (ball["name"], ball["number"], ball["colour"]) for ball in document["balls"]}
    assert written == {
        ball: (look.name, None, format_colour(look.colour))
        for ball, look in zip(shot.tracks.ids, shot.tracks.looks, strict=True)
    }
    next(ball for ball in document["balls"] if ball["id"] == "red")["colour"] = "#aa0011"
    scene.write_text(json.dumps(document), encoding="utf-8")
    graph = build_run_graph(own_home.clip, build_options({"looks": str(scene)})).select("track")
    entry = graph.run(ResultCache(own_home.cache), SilentWatcher())["track"]
    stage = next(stage for stage in graph.stages if stage.name == "track")
    tracks: Tracks = load_stage_output(stage, entry)
    assert tracks.looks[tracks.ids.index("red")].colour == (170, 0, 17)
    assert [look.name for look in tracks.looks] == [look.name for look in shot.tracks.looks]
