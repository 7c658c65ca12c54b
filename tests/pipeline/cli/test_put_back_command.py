"""`trueroll put-back` on a rendered hall whose balls are known."""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.pseudo_terminal import Terminal, make_terminal
from support.synthetic_run import save_shot

from models.core.number_format import format_measured
from models.core.scene import NOSE_HEIGHT_RADII, Camera, Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.actions import placement_views
from pipeline.actions.placement_views import MAX_DECIMALS_MM
from pipeline.actions.put_back import locate_wanted_places
from pipeline.chain import write_source
from pipeline.io.run_tables import write_scene
from pipeline.io.run_views import read_shot_record
from pipeline.run_options import RunOptions
from pipeline.stages.read_stage import ReadOptions
from video.io.clip import open_clip
from video.io.video_writer import VideoWriter
from video.rendering.pinhole_camera import look_at
from video.rendering.scene_appearance import Lamp, SceneAppearance, pool_ball
from video.rendering.scene_renderer import BallPoses, build_view, render_image

trueroll = pytest.fixture(make_terminal)

TABLE = TABLE_PRESETS["pool-8ft"]
IDS, KINDS = ("cue", "eight", "solid-1", "solid-2"), ("cue", "eight", "solid", "solid")
WANTED = np.array([[0.55, 0.60], [1.30, 0.35], [1.75, 0.80], [0.90, 0.95]])
RATE, FRAMES = 30, 24


def make_camera(tilt: float = 0.0) -> Camera:
    """A camera at 60 degrees; `tilt` m aside."""
    middle = np.array([TABLE.length / 2, TABLE.width / 2, 0.0])
    camera = look_at(TABLE, middle + np.array([0.1, 2.2, 3.8]), middle + np.array([tilt, 0.0, 0.0]), 1750.0, 1280, 720)
    corners = camera.to_pixels(TABLE.corners, NOSE_HEIGHT_RADII * TABLE.ball_radius)
    return replace(camera, corners_px=corners, corner_covariance=0.3 * np.eye(8), plane="noses", height_sigma=0.02)


def render_table(xy: FloatArray, camera: Camera) -> ImageArray:
    lamps = (Lamp((0.6, 0.5, 1.2), 0.25, 1.0), Lamp((1.7, 0.5, 1.2), 0.25, 1.0))
    appearance = SceneAppearance((0.10, 0.42, 0.30), (0.32, 0.2, 0.12), (0.2, 0.2, 0.2), "dark", "none", lamps)
    balls = tuple(pool_ball(number) for number in (0, 8, 3, 2))
    poses = BallPoses(np.column_stack([xy, np.full(4, TABLE.ball_radius)]), np.tile(np.eye(3), (4, 1, 1)))
    view = build_view(TABLE, camera, appearance, balls, samples=1)
    return render_image(view, lambda t: poses, 0.0, np.random.default_rng(3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a clip in which four balls rest until a strike at 0.15 s."""
    place, camera = tmp_path_factory.mktemp("run"), make_camera()
    image = render_table(WANTED, camera)
    with VideoWriter(place / "clip.mp4", 1280, 720, Fraction(RATE)) as writer:
        for _ in range(FRAMES):
            writer.write(image)
    scene = Scene(TABLE, camera, np.array([40.0, -30.0, 10.0]), ())
    xy = np.tile(WANTED, (FRAMES, 1, 1))
    one, t = np.ones((FRAMES, 4)), np.arange(FRAMES) / RATE
    xy[:, 0, 1] -= 0.6 * np.maximum(t - 0.15, 0.0)
    px = camera.to_pixels(xy, TABLE.ball_radius)
    radius = camera.radius_px(xy, TABLE.ball_radius)
    tracks = Tracks(
        np.arange(FRAMES), t, IDS, KINDS, xy, px, 5e-4 * one, 5e-4 * one, np.zeros_like(xy), radius, np.zeros((4, 3))
    )
    shot = explain(tracks, scene)
    save_shot(shot, place)
    write_scene(open_clip(place / "clip.mp4"), scene, tracks, view_shot(shot), place / "scene.json")
    write_source(place / "clip.mp4", place, RunOptions())
    return place


def write_present(path: Path, xy: FloatArray, camera: Camera) -> Path:
    cv2.imwrite(str(path), render_table(xy, camera)[..., ::-1])
    return path


def test_it_writes_where_the_balls_lay_before_the_strike(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    output = trueroll("put-back", folder, "-o", tmp_path, "--json")
    assert output.status == 0
    document = json.loads(output.out)
    assert 0.12 < document["t"] < 0.15
    rows = list(csv.DictReader(io.StringIO((tmp_path / "put_back.csv").read_text())))
    assert list(rows[0])[:7] == ["id", "kind", "x", "y", "sigma", "left_mm", "top_mm"]
    by_id = {row["id"]: row for row in rows}
    for name, (x, y) in zip(IDS, WANTED, strict=True):
        row = by_id[name]
        assert float(row["left_mm"]) == pytest.approx(1e3 * x, abs=0.1)
        assert float(row["bottom_mm"]) == pytest.approx(1e3 * (TABLE.width - y), abs=0.1)
        assert 0.3 < float(row["x_sigma_mm"]) < 3.0  # half a pixel of the corners is a millimetre
    plan, frame = (np.asarray(Image.open(tmp_path / f"put_back_{name}.png")) for name in ("plan", "frame"))
    assert frame.shape == (720, 1280, 3)
    assert plan.shape[1] == 1680


def test_the_frame_before_a_strike_does_not_show_it(folder: Path) -> None:
    record = read_shot_record(folder)
    assert locate_wanted_places(record, None).frame == 4
    late = replace(record, events=replace(record.events, t=record.events.t + 1.4 / RATE))
    assert locate_wanted_places(late, None).frame == 5, "frame 6 is nearer, and shows the moved ball"
    assert locate_wanted_places(late, 5.8 / RATE).frame == 6


def test_distances_have_the_digits_of_their_errors_along_both_axes(
    trueroll: Terminal, folder: Path, tmp_path: Path
) -> None:
    lines = trueroll("put-back", folder, "-o", tmp_path).out.splitlines()
    heading, cue = (next(line for line in lines if line.startswith(word)) for word in ("ball", "cue ball"))
    assert heading.split() == ["ball", "left", "right", "±", "far", "near", "±"]
    left, _, x_sigma, _, _, y_sigma = cue.split()[2:]
    for text in (left, x_sigma, y_sigma):
        assert len(text.partition(".")[2]) <= 1
    wide = {**{f"{side}_mm": 1900.33 for side in ("left", "right", "top", "bottom")}, "x_sigma_mm": 7.9}
    assert format_measured(wide["left_mm"], wide["x_sigma_mm"], MAX_DECIMALS_MM) == ("1900", "8")


@pytest.mark.parametrize(("at", "words"), [("T", "--at is a number; got T"), ("99", "0.000 to 0.767 s; got 99")])
def test_a_time_that_is_none_or_outside_is_refused_in_one_sentence(
    trueroll: Terminal, folder: Path, at: str, words: str
) -> None:
    output = trueroll("put-back", folder, "--at", at)
    assert output.status == 2
    assert words in output.err


def test_the_missing_moves_of_a_present_image_are_stated(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    moved = WANTED + np.array([[0.0, 0.0], [0.012, 0.0], [0.0, -0.008], [0.0, 0.0]])
    present = write_present(tmp_path / "now.png", moved, make_camera())
    output = trueroll("put-back", folder, "--live", present, "-o", tmp_path, "--json")
    state = json.loads(output.out)["live"]
    assert output.status == 0
    assert not state["camera_moved"]
    by_id = {ball["id"]: ball for ball in state["balls"]}
    assert [by_id[name]["placed"] for name in IDS] == [True, False, False, True]
    assert by_id["eight"]["dx_mm"] == pytest.approx(-12.0, abs=1.0)
    assert by_id["solid-1"]["dy_mm"] == pytest.approx(8.0, abs=1.0)
    assert by_id["eight"]["move"].startswith("1")
    assert "mm towards the left short rail" in by_id["eight"]["move"]
    assert json.loads((tmp_path / "live.json").read_text()) == state
    assert (tmp_path / "live.png").stat().st_size > 0


def test_the_pixel_aspect_of_the_run_holds_for_its_clip_and_for_present_images(
    trueroll: Terminal, folder: Path, tmp_path: Path
) -> None:
    run = shutil.copytree(folder, tmp_path / "run")
    squeezed = np.asarray(cv2.resize(render_table(WANTED, make_camera()), (960, 720)), np.uint8)
    with VideoWriter(run / "clip.mp4", 960, 720, Fraction(RATE)) as writer:
        for _ in range(FRAMES):
            writer.write(squeezed)
    write_source(run / "clip.mp4", run, RunOptions(read=ReadOptions(pixel_aspect="4/3")))
    present = tmp_path / "now.png"
    cv2.imwrite(str(present), squeezed[..., ::-1])
    output = trueroll("put-back", run, "--clip", run / "clip.mp4", "--live", present, "-o", tmp_path, "--json")
    assert output.status == 0, output.err
    assert np.asarray(Image.open(tmp_path / "put_back_frame.png")).shape == (720, 1280, 3)
    assert all(ball["placed"] for ball in json.loads(output.out)["live"]["balls"])


def test_a_ball_that_is_not_there_is_missing_and_a_foreign_one_is_to_be_taken_away(
    trueroll: Terminal, folder: Path, tmp_path: Path
) -> None:
    moved = WANTED.copy()
    moved[1] = [0.2, 0.2]  # the eight: 1.1 m from its place, but the only one
    moved[3] = [9.0, 9.0]  # outside the image
    present = write_present(tmp_path / "now.png", moved, make_camera())
    state = json.loads(trueroll("put-back", folder, "--live", present, "-o", tmp_path, "--json").out)["live"]
    by_id = {ball["id"]: ball for ball in state["balls"]}
    assert by_id["solid-2"]["missing_mm"] is None
    assert by_id["solid-2"]["move"] == "not found"
    assert by_id["eight"]["missing_mm"] == pytest.approx(1e3 * np.hypot(1.1, 0.15), abs=3.0)


def test_a_camera_that_moved_is_noticed_and_calibrated_again(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    present = write_present(tmp_path / "now.png", WANTED, make_camera(0.012))
    state = json.loads(trueroll("put-back", folder, "--live", present, "-o", tmp_path, "--json").out)["live"]
    assert state["camera_moved"]
    assert 2.0 < state["camera_shift_px"] < 8.0
    assert max(ball["missing_mm"] for ball in state["balls"]) < 2.5


def test_a_camera_is_followed_image_by_image(
    trueroll: Terminal, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = WANTED + np.array([[0.02, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    images = [
        render_table(first, make_camera()),
        np.zeros((720, 1280, 3), np.uint8),
        render_table(WANTED, make_camera()),
    ]

    class FakeCapture:
        def __init__(self, number: int) -> None:
            self.left: Iterator[ImageArray] = iter(images)

        def isOpened(self) -> bool:
            return True

        def set(self, name: int, value: float) -> bool:
            return True

        def read(self) -> tuple[bool, ImageArray | None]:
            image = next(self.left, None)
            return image is not None, None if image is None else image[..., ::-1]

        def release(self) -> None:
            self.left = iter(())

    monkeypatch.setattr(placement_views.cv2, "VideoCapture", FakeCapture)
    output = trueroll("put-back", folder, "--live", "0", "--updates", 3, "-o", tmp_path, "--json")
    assert output.status == 0
    states = [json.loads(line)["live"] for line in output.out.splitlines()]
    assert [state.get("placed") for state in states] == [3, None, 4]
    assert "the table" in states[1]["note"] or "cloth" in states[1]["note"]
    page = (tmp_path / "live.html").read_text()
    assert 'src="live.png"' in page


def test_without_a_camera_there_is_one_clear_sentence(trueroll: Terminal, folder: Path, tmp_path: Path) -> None:
    output = trueroll("put-back", folder, "--live", "97", "-o", tmp_path)
    assert output.status == 2
    assert output.err.splitlines()[-1].startswith("trueroll: --live 97 needs a camera of this number")
    assert not (tmp_path / "live.html").exists()


@pytest.mark.parametrize(("options", "words"), [(("--at", "9"), "within the shot"), (("--live", "no.png"), "no.png")])
def test_wrong_usage_is_one_sentence(
    trueroll: Terminal, folder: Path, tmp_path: Path, options: tuple[str, ...], words: str
) -> None:
    output = trueroll("put-back", folder, *options, "-o", tmp_path)
    assert output.status == 2
    assert words in output.err
