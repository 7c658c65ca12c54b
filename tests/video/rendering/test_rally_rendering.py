"""Rendered rallies: the same by seed, and true to what they state."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from benchmarks.court_cases.court_clips import write_rally_clip
from models.core.court_camera import CourtCamera
from models.core.typing import FloatArray
from models.sports.sport_catalogue import find_sports
from video.rendering import court_renderer, rally_clips
from video.rendering.court_background import paint_lines
from video.rendering.court_scene import RallyPath, sample_camera, sample_look, sample_motion

SIZE = (640, 360)


def make_rally(sport: str) -> RallyPath:
    """Make an object that flies across the court on a parabola; players stand far from it."""
    known = find_sports()[sport]
    t = np.arange(0, 1.0, 1e-3)
    place = np.column_stack([
        known.length * (0.25 + 0.4 * t), known.width * (0.2 + 0.6 * t), known.net.height + 0.4 + 2.0 * t - 3.0 * t**2
    ])  # fmt: skip
    feet = np.zeros((2, 120, 3))
    feet[1, :, 0], feet[:, :, 1] = known.length, -0.5
    truth = {
        "surface": {"badminton": "mat", "tennis": "hard"}.get(sport, "table"),
        "events": [],
        "strokes": [],
        "ending": {},
    }
    return RallyPath(known, t, place, np.broadcast_to([0.3, 0.9, 0.3], place.shape), feet, (), truth)


def find_sprite(renderer: court_renderer.CourtRenderer, k: int) -> tuple[court_renderer.FrameTruth, FloatArray]:
    """Return the truth of a frame, and the centroid (2,) of what is drawn of the object."""
    (px, streak, radius), layer = renderer._draw_object(renderer._rally, k)
    assert layer is not None
    share = layer.rgba[..., 3].astype(np.float64)
    y, x = np.mgrid[: share.shape[0], : share.shape[1]]
    centre = np.array([layer.x + (x * share).sum() / share.sum(), layer.y + (y * share).sum() / share.sum()])
    columns = (px[None], streak[None], np.array([radius]), np.ones(1), np.zeros(1))
    return court_renderer.FrameTruth(*columns, np.empty((0, 4))), centre


@pytest.mark.parametrize("sport", ["badminton", "tennis", "table-tennis"])
@pytest.mark.parametrize("is_moving", [False, True])
def test_the_streak_lies_where_the_truth_says(sport: str, is_moving: bool) -> None:
    rng, rally = np.random.default_rng(2), make_rally(sport)
    look = replace(sample_look(rng, sport, str(rally.truth["surface"]), "broadcast", 25), exposure=1 / 60)
    camera = sample_camera(rng, rally.sport, "broadcast", SIZE)
    t = np.arange(6) / 10 + 0.1
    if is_moving:
        camera = replace(camera, motion=sample_motion(rng, camera, len(t), 25, 0.01, 0.0, 0.02))
    renderer = court_renderer.CourtRenderer(rng, rally, camera, look, "broadcast", t)
    for k in range(len(t)):
        truth, centre = find_sprite(renderer, k)
        assert truth.px.shape == (1, 2)
        frame = k if is_moving else None
        assert np.allclose(truth.px[0], camera.to_pixels(rally.place_at(t[k])[0], frame), atol=1e-6)
        assert np.linalg.norm(centre - truth.px[0]) < 0.3


def test_frames_are_the_same_by_seed() -> None:
    rally = make_rally("tennis")
    images = []
    for _ in range(2):
        renderer, *_ = rally_clips.stage_rally(np.random.default_rng(7), rally, "phone", Fraction(30), SIZE, (0.2, 0.4))
        images.append(renderer.render_frame(2)[0])
    assert np.array_equal(*images)


def test_an_object_behind_a_player_is_hidden() -> None:
    rng, rally = np.random.default_rng(3), make_rally("badminton")
    look = sample_look(rng, "badminton", "mat", "broadcast", 25)
    camera = sample_camera(rng, rally.sport, "broadcast", SIZE)
    t = np.array([0.5])
    place = rally.place_at(t)[0][0]
    ahead = camera.centre + 0.8 * (place - camera.centre)
    feet = rally.feet.copy()
    feet[0, :, :2] = ahead[:2]
    # a tall player stands on the line of sight
    tall = replace(look.outfits[0], size=ahead[2] / 1.2)
    hidden = replace(rally, feet=feet)
    for one, expected in ((rally, True), (hidden, False)):
        renderer = court_renderer.CourtRenderer(
            np.random.default_rng(1), one, camera, replace(look, outfits=(tall, look.outfits[1])), "broadcast", t
        )
        assert (renderer.render_frame(0)[1].shown[0] > 0.5) == expected


def test_painted_lines_cover_their_width() -> None:
    """Straight from above, the paint of a line is as wide and lies where the sport says, to a hundredth of a pixel."""
    sport, scale = find_sports()["tennis"], 20.0
    projection = np.array([[scale, 0, 0, 15.3], [0, scale, 0, 20.7], [0, 0, 0, 1.0]])
    image = np.zeros((260, 520, 3), np.uint8)
    line = next(line for line in sport.lines if line.name == "near service line")
    paint_lines(image, projection, [line], (1.0, 1.0, 1.0))
    row = image[130, :, 0].astype(np.float64) / 255
    assert row.sum() == pytest.approx(line.width * scale, abs=0.01)
    assert (row * np.arange(520)).sum() / row.sum() == pytest.approx(line.start[0] * scale + 15.3, abs=0.01)


def test_a_clip_is_written_with_its_truth(tmp_path: Path) -> None:
    rally = make_rally("table-tennis")
    truth = write_rally_clip(tmp_path, rally, "broadcast", 25, seed=5, size=SIZE, span=(0.1, 0.5))
    assert (tmp_path / "clip.mp4").exists()
    assert len(truth.t) == 10
    with np.load(tmp_path / "truth.npz") as arrays:
        camera = CourtCamera(
            arrays["camera"], np.zeros((8, 8)), *SIZE, False, arrays["motion"] if len(arrays["motion"]) else None
        )
        frame = np.arange(10) if len(arrays["motion"]) else None
        assert np.allclose(camera.to_pixels(arrays["xyz"], frame), arrays["px"], atol=1e-6)
        assert arrays["is_visible"].mean() > 0.5


def test_a_player_beside_or_behind_the_camera_is_no_trouble() -> None:
    rally = make_rally("badminton")
    camera = sample_camera(np.random.default_rng(4), rally.sport, "phone", SIZE)
    for offset in (-3.0, 0.0, 0.4):
        feet = rally.feet.copy()
        feet[0, :, :2] = camera.centre[:2] + np.array([offset, 0.2])
        one = replace(rally, feet=feet)
        look = sample_look(np.random.default_rng(5), "badminton", "mat", "phone", 25)
        renderer = court_renderer.CourtRenderer(np.random.default_rng(6), one, camera, look, "phone", np.array([0.5]))
        assert renderer.render_frame(0)[0].shape == (SIZE[1], SIZE[0], 3)


def test_training_clips_are_decoded_frames_with_their_truth() -> None:
    rallies = [make_rally("tennis")]
    clip = next(rally_clips.generate_rally_clips(np.random.default_rng(8), rallies, seconds=0.3, size=SIZE, others=2))
    truth = clip.truth
    count = int(0.3 * truth.fps + 1e-6)
    assert clip.frames.shape == (count, SIZE[1], SIZE[0], 3)
    assert truth.px.shape == truth.streak.shape == (count, 2)
    # The others fly at another moment of the rally, and are in the picture too.
    assert truth.others.shape == (count, 2, 6)
    assert np.nanmin(np.linalg.norm(truth.others[:, :, :2] - truth.px[:, None], axis=-1)) > 1.0
    assert (truth.others[..., 4] > 0.5).any()
    assert np.all(np.diff(truth.t) > 0)
    assert truth.is_visible.dtype == bool
    assert clip.frames.std() > 5
