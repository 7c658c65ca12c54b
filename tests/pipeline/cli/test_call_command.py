"""`trueroll call` on a folder whose every number is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support import synthetic_run as shot
from support.pseudo_terminal import Terminal, make_terminal

from models.core.scene import Game, Scene
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.actions.answer_call import open_run_clip
from pipeline.io.run_tables import write_scene

trueroll = pytest.fixture(make_terminal)


def from_above(scene: Scene) -> Scene:
    """The scene under a camera 3 m above its middle, which sees the cloth as the made-up one does."""
    height, (x, y) = 3.0, scene.table.corners.mean(axis=0)
    f, u, v = shot.PX_PER_M * height, 20 + shot.PX_PER_M * x, 20 + shot.PX_PER_M * y
    matrix = np.array([[f, 0, -u, height * u - f * x], [0, f, -v, height * v - f * y], [0, 0, -1, height]])
    return replace(scene, camera=replace(scene.camera, matrix=matrix))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A white ball at 1 m/s from x = 0.2 m, a red one at rest; the clip beside it."""
    return run_shot(tmp_path_factory.mktemp("run"), "carom")


def run_shot(place: Path, game: Game) -> Path:
    clip, scene = shot.write_clip(place / "clip.mp4"), from_above(shot.make_scene())
    scene = replace(scene, table=replace(scene.table, game=game))
    explained = explain(shot.make_tracks(clip, scene), scene)
    shot.save_shot(explained, place)
    write_scene(clip, scene, explained.tracks, view_shot(explained), place / "scene.json")
    return place


@pytest.mark.parametrize(("edge", "at"), [(False, 0.435), (True, 0.405)])
def test_a_line_is_crossed_when_the_centre_or_the_edge_reaches_it(
    trueroll: Terminal, folder: Path, tmp_path: Path, edge: bool, at: float
) -> None:
    output = trueroll("call", folder, "line", "x=0.635", "white", *["--edge"] * edge, "--json", "-o", tmp_path)
    answer = json.loads(output.out)
    assert output.status == 0
    assert answer["verdict"] == "yes"
    assert answer["t"] == pytest.approx(at, abs=1.5e-3)
    assert answer["frame"] == pytest.approx(30 * at, abs=0.05)
    assert 2e-3 < answer["t_sigma"] < 2.1e-3  # the calibration has 2 mm, the path much less, at a metre per second
    beyond = 0.2 + shot.SPEED * (shot.FRAMES - 1) / shot.RATE - 0.635 + (0.03 if edge else 0.0)
    assert answer["margin_mm"] == pytest.approx(-1e3 * beyond, abs=1.5)
    assert answer["moved"] == ["white"]


def test_balls_far_apart_did_not_touch_and_the_margin_is_their_gap(
    trueroll: Terminal, folder: Path, tmp_path: Path
) -> None:
    answer = json.loads(trueroll("call", folder, "contact", "red", "white", "--json", "-o", tmp_path).out)
    end = 0.2 + shot.SPEED * (shot.FRAMES - 1) / shot.RATE
    assert answer["verdict"] == "no"
    assert answer["margin_mm"] == pytest.approx(1e3 * (np.hypot(1.5 - end, 0.2) - 0.06), abs=2.0)
    text = trueroll("call", folder, "contact", "red", "white", "-o", tmp_path).out
    assert "When the clip ends, the white still moves: what comes later is not judged." in text
    first = json.loads(trueroll("call", folder, "first", "red", "--json", "-o", tmp_path).out)
    none, unknown = first["alternatives"]
    assert none["answer"] == "none"
    assert 0 < none["probability"] < 1.0
    assert (unknown["answer"], unknown["probability"]) == ("unknown", pytest.approx(1 - none["probability"]))


def test_a_rail_that_was_not_hit_is_as_far_as_the_ball_stayed(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    answer = json.loads(trueroll("call", folder, "rail", "white", "right", "--json", "-o", tmp_path).out)
    end = 0.2 + shot.SPEED * (shot.FRAMES - 1) / shot.RATE
    assert (answer["verdict"], answer["asked"]) == ("no", "Did the white hit the right short cushion?")
    assert answer["margin_mm"] == pytest.approx(1e3 * (2.0 - end - 0.03), abs=2.0)
    text = trueroll("call", folder, "rail", "white", "right", "-o", tmp_path).out
    assert "the white did not hit the right short cushion; 100" in text
    assert "mm short of it at " in text
    assert "When the clip ends, the white still moves: what comes later is not judged." in text


def test_close_ups_show_the_moment_if_the_clip_is_known(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    question = ("call", folder, "line", "x=0.635", "white", "--json", "-o", tmp_path)
    without = json.loads(trueroll(*question).out)
    assert without["pictures"] == []
    assert "--clip" in without["no_picture"]
    named = json.loads(trueroll(*question, "--clip", folder / "clip.mp4").out)
    close, strip = (np.asarray(Image.open(path)) for path in named["pictures"])
    assert close.shape[0] > 720, "the answer stands below the close-up"
    assert close.shape[1:] == (960, 3)
    assert strip.shape[1] > 4 * strip.shape[0]
    assert close[330:390, 450:510].mean() > 170, "the white ball fills the middle"
    (folder / "source.json").write_text(json.dumps({"path": str(folder / "clip.mp4")}))
    noted = json.loads(trueroll(*question).out)
    assert len(noted["pictures"]) == 2
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (("contact", "white", "blue"), "no ball of this clip is 'blue'"), (("contact", "white", "white"), "twice"),
        (("contact", "white"), "contact needs two balls"), (("rail", "white"), "rail needs a ball and a rail"),
        (("rail", "white", "red"), "a rail is one of left short cushion (left)"),
        (("contact", "white", "near"), "'near' is a cushion, not a ball"),
        (("touch", "white"), "contact A B"), (("line", "z=1", "white"), "in metres"),
        (("pocket", "white", "top"), "no pockets"), (("first", "white", "--edge"), "--edge belongs to line"),
        (("score",), "three balls; this clip has 2"),
        (("foul",), "foul is a question of pool and snooker"),
        (("first", "white", "--on", "red"), "--on belongs to foul"),
    ],
)  # fmt: skip
def test_questions_that_make_no_sense_are_one_line_and_status_2(
    trueroll: Terminal, folder: Path, words: tuple[str, ...], wanted: str
) -> None:
    output = trueroll("call", folder, *words)
    assert output.status == 2
    assert output.err.count("\n") == 1
    assert wanted in output.err


def test_a_folder_without_a_saved_shot_is_one_line(trueroll: Terminal, tmp_path: Path) -> None:
    output = trueroll("call", tmp_path, "first", "white")
    assert output.status == 2
    assert "holds no saved shot" in output.err


def test_a_foul_is_named_with_each_fact_and_what_is_not_told(trueroll: Terminal, tmp_path: Path) -> None:
    folder = run_shot(tmp_path, "pool")
    question = ("call", folder, "foul", "-o", tmp_path)
    answer = json.loads(trueroll(*question, "--json", "--clip", folder / "clip.mp4").out)
    assert (answer["code"], answer["verdict"], answer["likely"]) == ("yes", "no ball hit", "no ball hit")
    assert answer["probability"] > 0.99
    assert answer["sentence"].startswith("No ball hit (99.")
    (missed,) = answer["parts"]
    end = 0.2 + shot.SPEED * (shot.FRAMES - 1) / shot.RATE
    assert (missed["kind"], missed["verdict"]) == ("no-contact", "yes")
    assert missed["margin_mm"] == pytest.approx(1e3 * (np.hypot(1.5 - end, 0.2) - 0.06), abs=2.0)
    assert len(answer["pictures"]) == 2
    text = trueroll(*question).out
    assert "No ball hit (WPA 6.3)?" in text
    assert "name the ball on, such as solids or stripes or eight." in text
    assert trueroll(*question, "--on", "blue").err.startswith("trueroll: no ball of this clip is 'blue'")
    on = json.loads(trueroll(*question, "--on", "red", "--json", "--clip", folder / "clip.mp4").out)
    assert on["asked"] == "Does the clip show a foul (on: the red)?"
    assert not set(on["pictures"]) & set(answer["pictures"]), "each question has its own images"
    assert "A push, a double hit, or a ball that leaves the table cannot be told" in text
    first = json.loads(trueroll("call", folder, "first", "white", "--json", "-o", tmp_path).out)
    assert first["verdict"] == "no ball"
    assert first["margin_mm"] == pytest.approx(missed["margin_mm"]), "what touched nothing has its nearest pass"
    assert "touched no ball, and came nearest to the red; " in first["sentence"]


def test_the_clip_of_a_run_may_be_a_folder_of_numbered_images(tmp_path: Path) -> None:
    images, run = tmp_path / "row", tmp_path / "run"
    images.mkdir()
    run.mkdir()
    for number in range(7):
        Image.new("RGB", (64, 48), (20 * number, 80, 60)).save(images / f"{number:03d}.png")
    (run / "source.json").write_text(json.dumps({"path": str(images)}))
    (run / "scene.json").write_text("{}")
    footage, why_not = open_run_clip(run, None)
    assert (why_not, footage is not None and footage.frame_count) == ("", 7)
