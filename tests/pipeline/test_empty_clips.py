"""Clips in which little or nothing happens: one true sentence and a status, from `check` and `run` alike."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from support.pseudo_terminal import Terminal, make_terminal

from models.physics.billiards.tables import TABLE_PRESETS
from video.io.video_writer import VideoWriter
from video.rendering.pinhole_camera import look_at
from video.rendering.player_props import make_hand_rods
from video.rendering.scene_appearance import Lamp, SceneAppearance, pool_ball
from video.rendering.scene_renderer import BallPoses, build_view, render_image

trueroll = pytest.fixture(make_terminal)

TABLE = TABLE_PRESETS["pool-8ft"]
WIDTH, HEIGHT, RATE, FRAMES = 640, 360, 25, 14
MIDDLE = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
LAMPS = tuple(Lamp((x, 0.6, 1.3), 0.2, 1.0) for x in (0.5, 1.2, 1.9))
APPEARANCE = SceneAppearance(
    (0.13, 0.47, 0.68), (0.32, 0.2, 0.12), (0.2, 0.2, 0.2), "dark", "none", LAMPS, brightness=1.3
)
PLACES, NUMBERS = np.array([[0.5, 0.6], [1.4, 0.4], [1.9, 0.8]]), (0, 3, 8)
OPTIONS = ("--table", "pool-8ft")


@dataclass(frozen=True)
class FilmedBalls:
    """Balls that roll straight, and what else is in view."""

    count: int = 3
    speed: tuple[float, float] = (0.0, 0.0)
    """m/s of all balls."""
    frames: int = FRAMES
    is_noisy: bool = True
    has_hand: bool = False


def film(path: Path, filmed: FilmedBalls) -> Path:
    """Render a clip from above."""
    eye = MIDDLE + np.array([0.0, 0.0, 1.45 * TABLE.length])
    camera = look_at(TABLE, eye, MIDDLE, 0.8 * WIDTH / TABLE.length * eye[2], WIDTH, HEIGHT, up=(0.0, -1.0, 0.0))
    view = build_view(TABLE, camera, APPEARANCE, tuple(map(pool_ball, NUMBERS[: filmed.count])), samples=1)

    def motion(t: float) -> BallPoses:
        xy = PLACES[: filmed.count] + t * np.array(filmed.speed)
        hand = make_hand_rods(np.array([0.3 + t, 0.25, 0.03]), np.array([0.0, -1.0])) if filmed.has_hand else ()
        height = np.full((filmed.count, 1), TABLE.ball_radius)
        return BallPoses(np.hstack([xy, height]), np.tile(np.eye(3), (filmed.count, 1, 1)), hand)

    with VideoWriter(path, WIDTH, HEIGHT, Fraction(RATE)) as writer:
        for k in range(filmed.frames):
            seed = k if filmed.is_noisy else 0
            writer.write(render_image(view, motion, k / RATE, np.random.default_rng(seed)))
    return path


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("filmed", [FilmedBalls(count=1), FilmedBalls(is_noisy=False), FilmedBalls(has_hand=True)],
                         ids=["one ball", "equal frames", "a hand"])  # fmt: skip
def test_where_no_ball_moves_the_report_says_so_and_shows_where_they_lie(
    trueroll: Terminal, tmp_path: Path, filmed: FilmedBalls
) -> None:
    clip, folder = film(tmp_path / "clip.mp4", filmed), tmp_path / "run"
    done = trueroll("run", clip, "-o", folder, "--no-video", *OPTIONS)
    assert done.status == 0, done.err
    assert "No ball moves in this clip." in done.out
    assert "No ball moves in this clip." in (folder / "report.html").read_text(encoding="utf-8")
    assert read_rows(folder / "events.csv") == []
    rows = read_rows(folder / "tracks.csv")
    assert len({row["id"] for row in rows}) == filmed.count
    near = [np.hypot(*(PLACES - (float(row["x"]), float(row["y"]))).T).min() for row in rows]
    assert max(near) < 0.01
    assert trueroll("check", clip, *OPTIONS).status == 0


def test_questions_about_a_clip_without_a_stroke_have_true_answers(trueroll: Terminal, tmp_path: Path) -> None:
    """What can be said of resting balls is said; what needs a stroke fails for that reason, and is no wrong usage."""
    folder, out = tmp_path / "run", tmp_path / "answers"
    clip = film(tmp_path / "clip.mp4", FilmedBalls(is_noisy=False))
    assert trueroll("run", clip, "-o", folder, "--no-video", *OPTIONS).status == 0
    for question, words in (
        (("first", "cue"), "the cue ball touched no ball"),
        (("contact", "cue", "eight"), "the cue ball missed black 8"),
        (("pocket", "cue", "top-left"), "the cue ball stayed on the table"),
        (("line", "x=1.0", "cue"), "did not cross the line x = 1 m"),
    ):
        answer = trueroll("call", folder, *question, "-o", out)
        assert (answer.status, words in answer.out) == (0, True), answer
        assert answer.out.startswith("No")
    stroke = "no ball moves in this clip, so there is no stroke; choose a clip with a strike"
    for command, *options in (("call", "score"), ("call", "foul"), ("call", "foul", "--on", "solids"), ("what-if",)):
        answer = trueroll(command, folder, *options, "-o", out)
        assert (answer.status, answer.err.strip().splitlines()[-1]) == (1, f"trueroll: {stroke}"), answer
    for command, words in (
        ("compare", "no stroke here is at least 50 % probable; give runs of clips that begin before the stroke"),
        ("certify", "0 cushion contacts are too few to learn a table from; at least 8 are needed"),
    ):
        answer = trueroll(command, folder, "-o", out)
        assert (answer.status, words in answer.err) == (1, True), answer
    predicted = trueroll("predict", folder, "-o", out)
    assert predicted.status == 0
    assert predicted.out.count("stays at rest") == len(PLACES)
    assert trueroll("put-back", folder, "-o", out).status == 0


def test_balls_that_all_move_throughout_are_not_said_to_rest(trueroll: Terminal, tmp_path: Path) -> None:
    clip, folder = film(tmp_path / "clip.mp4", FilmedBalls(speed=(-0.5, 0.2))), tmp_path / "run"
    done = trueroll("run", clip, "-o", folder, "--no-video", *OPTIONS)
    assert done.status == 0, done.err
    assert "No ball moves" not in done.out
    assert "move; no strike, contact, pot or rest is seen." in done.out
    assert "when it moves already" in done.out


def test_a_table_without_balls_is_refused_by_check_and_by_run_for_one_reason(
    trueroll: Terminal, tmp_path: Path
) -> None:
    clip = film(tmp_path / "clip.mp4", FilmedBalls(count=0))
    checked, done = trueroll("check", clip, "--json", *OPTIONS), trueroll("run", clip, "-o", tmp_path / "run", *OPTIONS)
    assert (checked.status, done.status) == (1, 1)
    refusal = json.loads(checked.out)["refusal"]
    assert refusal.startswith("no ball is detected on the table; film it with balls on it")
    assert refusal in done.err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_few_frames_are_refused_by_check_and_by_run_for_one_reason(
    trueroll: Terminal, tmp_path: Path, frames: int
) -> None:
    clip = film(tmp_path / "clip.mp4", FilmedBalls(frames=frames))
    checked, done = trueroll("check", clip), trueroll("run", clip, "-o", tmp_path / "run")
    assert (checked.status, done.status) == (1, 1)
    assert f"clip.mp4 has {frames} distinct frame{'s' * (frames > 1)}; tracking needs at least 5" in done.err
    assert checked.err == done.err


def test_a_clip_that_is_long_enough_for_a_run_is_long_enough_for_a_check(trueroll: Terminal, tmp_path: Path) -> None:
    clip = film(tmp_path / "clip.mp4", FilmedBalls(frames=6))
    checked = trueroll("check", clip, "--json", *OPTIONS)
    assert checked.status == 0, checked.out
    document = json.loads(checked.out)
    assert document["balls"] == 3
    assert {one["code"]: one["level"] for one in document["measurements"]}["flicker"] == "unknown"


@pytest.mark.parametrize("colour", [(0, 0, 0), (20, 110, 60)], ids=["black", "green"])
def test_a_single_colour_is_no_table(trueroll: Terminal, tmp_path: Path, colour: tuple[int, int, int]) -> None:
    clip = tmp_path / "clip.mp4"
    with VideoWriter(clip, WIDTH, HEIGHT, Fraction(RATE)) as writer:
        for _ in range(FRAMES):
            writer.write(np.full((HEIGHT, WIDTH, 3), colour, np.uint8))
    checked, done = trueroll("check", clip, "--json"), trueroll("run", clip, "-o", tmp_path / "run")
    assert (checked.status, done.status) == (1, 1)
    assert json.loads(checked.out)["refusal"] in done.err
    assert "film" in done.err
    assert "--corners" in done.err
    assert done.err.strip().count("\n") == 0
