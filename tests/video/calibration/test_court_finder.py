"""Courts found in drawn pictures and in the shared clips."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.drawn_courts import LOOKS, aim_camera, draw_court
from support.shared_material import find_shared_file
from support.table_images import write_clip

from models.core.court import Sport
from models.core.court_camera import CourtCamera
from models.core.errors import ClipError, OptionError
from models.core.progress import ignore_progress
from models.core.typing import FloatArray, ImageArray
from models.sports.sport_catalogue import find_sports
from video.calibration import court_finder
from video.calibration.court_camera_fit import CourtFit, build_court_camera, fit_court_camera
from video.calibration.court_finder import LocatedCourt, find_court, locate_court
from video.calibration.court_lines import convert_to_brightness
from video.io.clip import open_clip

SPORTS = find_sports()
Place = tuple[float, float, float]
# Sport, place and target of the camera, m, focal length, px, whether it looks from behind an end, k1 and looks.
VIEWS: dict[str, tuple[str, Place, Place, float, bool, float, str]] = {
    "badminton broadcast": ("badminton", (-13, 3.0, 7), (6.0, 3.05, 0), 1650, True, 0.03, "badminton"),
    "badminton phone behind": ("badminton", (-4, 2.2, 1.7), (6.5, 3.05, 0.6), 950, True, -0.02, "badminton"),
    "badminton phone corner": ("badminton", (-3.0, -1.5, 2.4), (5.5, 3.0, 0.3), 900, True, 0.01, "badminton"),
    "badminton side": ("badminton", (6.0, -7, 4.0), (6.7, 3.0, 0), 800, False, 0.0, "badminton"),
    "tennis broadcast": ("tennis", (-21, 5.4, 8.7), (9.5, 5.5, 0), 1840, True, 0.02, "tennis"),
    "tennis clay": ("tennis", (-16, 6.4, 6.0), (10, 5.5, 0), 1250, True, 0.0, "clay"),
    "tennis grass": ("tennis", (-24, 5.0, 10.0), (10, 5.5, 0), 1900, True, 0.0, "grass"),
    "tennis phone fence": ("tennis", (-6, 4.0, 2.4), (12, 5.5, 0.5), 1000, True, -0.02, "tennis"),
    "tennis phone corner": ("tennis", (-5, -2.0, 3.2), (10, 6, 0.0), 1000, True, 0.0, "clay"),
    "table side": ("table-tennis", (1.3, -8, 3.9), (1.4, 0.7, -0.4), 1450, False, 0.03, "table-tennis"),
    "table side phone": ("table-tennis", (1.0, -3.2, 0.9), (1.37, 0.7, 0), 1000, False, 0.0, "blue table"),
    "table oblique": ("table-tennis", (-1.8, -2.2, 1.3), (1.3, 0.7, 0), 1100, True, 0.0, "blue table"),
    "table before a stand": ("table-tennis", (0.72, -5.26, 2.31), (1.3, 0.7, 0.0), 829, False, 0.0, "stand"),
    "table behind": ("table-tennis", (-9, 0.9, 3.5), (1.2, 0.76, -0.2), 2600, True, 0.0, "table-tennis"),
}
# Lines that are too faint to be searched, not to be measured.
FAINT_VIEWS = {
    "bright floor": ("table-tennis", (0.9, -1.8, 0.85), (1.0, 0.7, 0.1), 411.0, False, -0.09, "bright floor")
}
FAST = ("badminton broadcast", "tennis phone corner", "table side")


def aim(view: str) -> tuple[str, CourtCamera, str]:
    name, place, target, focal, is_left_handed, k1, looks = (VIEWS | FAINT_VIEWS)[view]
    return name, aim_camera(place, target, focal, is_left_handed=is_left_handed, k1=k1), looks


def find_in_picture(picture: ImageArray, sports: list[Sport] | None = None) -> LocatedCourt | None:
    return find_court(np.rint(convert_to_brightness(picture)).astype(np.uint8), sports or list(SPORTS.values()))


def measure_line_shift(name: str, truth: CourtCamera, camera: CourtCamera) -> float:
    """Measure the largest shift, px, of points of the lines inside the picture."""
    share = np.linspace(0, 1, 30)[:, None]
    lines = [np.array(one.start) + share * np.subtract(one.end, one.start) for one in SPORTS[name].lines]
    xyz = np.column_stack([np.concatenate(lines), np.zeros(30 * len(lines))])
    px = truth.to_pixels(xyz)
    is_inside = ((px > 0) & (px < [truth.width_px, truth.height_px])).all(1)
    return float(np.linalg.norm(camera.to_pixels(xyz) - px, axis=1)[is_inside].max())


@pytest.mark.parametrize(
    "view", [view if view in FAST else pytest.param(view, marks=pytest.mark.slow) for view in VIEWS]
)
def test_a_court_is_found_with_its_sport_its_side_and_its_lines_within_a_pixel(view: str) -> None:
    name, truth, looks = aim(view)
    located = find_in_picture(draw_court(SPORTS[name], truth, LOOKS[looks], np.random.default_rng(1)))
    assert located is not None
    assert located.sport.name == name
    assert located.fit.camera.is_left_handed == truth.is_left_handed
    assert measure_line_shift(name, truth, located.fit.camera) < 1.0
    assert np.exp(located.fit.camera.parameters[6] - truth.parameters[6]) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_edge_of_a_table_is_seen_before_a_floor_as_bright_as_its_line(seed: int) -> None:
    name, truth, looks = aim("bright floor")
    picture = draw_court(SPORTS[name], truth, LOOKS[looks], np.random.default_rng(seed))
    fit = fit_court_camera(convert_to_brightness(picture), SPORTS[name], truth)
    assert fit.line_shares.min() > 0.5
    assert measure_line_shift(name, truth, fit.camera) < 1.0


def test_a_mat_without_lines_on_a_bright_floor_is_no_table() -> None:
    name, truth, looks = aim("bright floor")
    bare = replace(LOOKS[looks], paint=LOOKS[looks].court)
    picture = draw_court(SPORTS[name], truth, bare, np.random.default_rng(1), has_net=False)
    assert fit_court_camera(convert_to_brightness(picture), SPORTS[name], truth).share < 0.2


def test_rows_of_a_stand_outweigh_no_table() -> None:
    name, truth, looks = aim("table before a stand")
    located = find_in_picture(draw_court(SPORTS[name], truth, LOOKS[looks], np.random.default_rng(2)))
    assert located is not None
    assert measure_line_shift(name, truth, located.fit.camera) < 1.0


@pytest.mark.slow
def test_sigmas_of_the_camera_hold() -> None:
    ratios: list[FloatArray] = []
    for seed, view in enumerate([*VIEWS, *VIEWS]):
        name, truth, looks = aim(view)
        rng = np.random.default_rng(seed)
        picture = draw_court(SPORTS[name], truth, replace(LOOKS[looks], noise=rng.uniform(1, 6)), rng)
        located = find_in_picture(picture, [SPORTS[name]])
        assert located is not None
        camera = located.fit.camera
        ratios.append(
            (camera.parameters - truth.parameters)[[0, 1, 2, 6]] / np.sqrt(np.diag(camera.covariance))[[0, 1, 2, 6]]
        )
    share = float((np.abs(ratios) < 2).mean())
    assert 0.88 <= share <= 1.0
    assert float((np.abs(ratios) < 1).mean()) < 0.95


@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1))])
def test_rectangles_of_bright_lines_are_no_court(seed: int) -> None:
    name, truth, looks = aim(("badminton broadcast", "tennis broadcast", "table side")[seed])
    sport = SPORTS[name]
    # Lines at other places than the rules want, without a net.
    rng = np.random.default_rng(seed)
    moved = tuple(
        replace(line, start=(line.start[0] * 0.7 + s, line.start[1]), end=(line.end[0] * 0.7 + s, line.end[1]))
        for line, s in zip(sport.lines, rng.uniform(0, 0.2 * sport.length, len(sport.lines)), strict=True)
    )
    picture = draw_court(replace(sport, lines=moved), truth, LOOKS[looks], rng, has_net=False)
    assert find_in_picture(picture) is None


def test_a_clip_of_something_else_is_refused_in_one_sentence(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    still = np.full((180, 320, 3), 90, np.uint8)
    cv2.putText(still, "KITCHEN", (30, 60), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (230, 220, 200), 3)
    cv2.rectangle(still, (40, 80), (280, 160), (220, 220, 220), 3)
    images = [np.clip(still + rng.normal(0, 6, still.shape), 0, 255).astype(np.uint8) for _ in range(6)]
    clip = open_clip(write_clip(tmp_path / "kitchen.mp4", images))
    with pytest.raises(ClipError, match=r"kitchen.mp4 shows no court of a known sport .*--corners"):
        locate_court(clip, None, None, ignore_progress)
    with pytest.raises(OptionError, match="--sport is one of badminton, table-tennis, tennis"):
        locate_court(clip, "cricket", None, ignore_progress)


@pytest.mark.parametrize("is_part", [True, False], ids=["service boxes", "beside them"])
def test_lines_of_another_court_are_not_those_of_the_sport_that_was_named(
    is_part: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, truth, looks = aim("tennis broadcast")
    tennis, table = SPORTS[name], SPORTS["table-tennis"]
    ends = np.array([[5.485, 1.37], [18.285, 1.37], [18.285, 9.6], [5.485, 9.6]])
    ends = ends if is_part else ends * 0.7 + 1.3
    px = truth.to_pixels(np.column_stack([ends, np.zeros(4)]))
    own = np.array([[0, 0], [table.length, 0], [table.length, table.width], [0, table.width]])
    matrix = cv2.getPerspectiveTransform(own.astype(np.float32), px.astype(np.float32))
    on_table = build_court_camera(matrix, table, 1280, 720)
    found = {
        sport.name: LocatedCourt(sport, CourtFit(camera, 0.1, 1.0, np.ones(len(sport.lines)), 1.0, seen))
        for sport, camera, seen in ((tennis, truth, 3000.0), (table, on_table, 900.0))
    }
    monkeypatch.setattr(
        court_finder, "find_court", lambda _, sports, *__: found["table-tennis" if sports == [table] else name]
    )
    images = [draw_court(tennis, truth, LOOKS[looks], np.random.default_rng(k)) for k in range(6)]
    clip = open_clip(write_clip(tmp_path / "court.mp4", images))
    if is_part:
        with pytest.raises(ClipError, match=r"shows a court of tennis.*leave --sport out, or name tennis"):
            locate_court(clip, "table-tennis", None, ignore_progress)
    else:
        assert locate_court(clip, "table-tennis", None, ignore_progress).sport.name == "table-tennis"
    assert locate_court(clip, "tennis", None, ignore_progress).sport.name == "tennis"


def test_corners_of_the_user_replace_the_search_and_lines_refine_them(tmp_path: Path) -> None:
    name, truth, looks = aim("tennis broadcast")
    rng = np.random.default_rng(2)
    images = [draw_court(SPORTS[name], truth, LOOKS[looks], rng) for _ in range(6)]
    clip = open_clip(write_clip(tmp_path / "court.mp4", images))
    corners = truth.to_pixels(np.column_stack([SPORTS[name].corners, np.zeros(4)])) + rng.normal(0, 2, (4, 2))
    scene = locate_court(clip, None, ",".join(f"{v:.1f}" for v in corners[[2, 0, 1, 3]].ravel()), ignore_progress)
    assert scene.sport.name == name
    assert measure_line_shift(name, truth, scene.camera) < 1.0


def test_corners_alone_give_a_camera_with_a_larger_error_where_no_line_is_seen(tmp_path: Path) -> None:
    name, truth, looks = aim("badminton broadcast")
    bare = replace(LOOKS[looks], paint=LOOKS[looks].court, tape=LOOKS[looks].court)
    rng = np.random.default_rng(2)
    images = [draw_court(SPORTS[name], truth, bare, rng, has_net=False) for _ in range(6)]
    clip = open_clip(write_clip(tmp_path / "bare.mp4", images))
    corners = truth.to_pixels(np.column_stack([SPORTS[name].corners, np.zeros(4)]))
    text = ",".join(f"{v:.1f}" for v in corners.ravel())
    scene = locate_court(clip, name, text, ignore_progress)
    assert measure_line_shift(name, truth, scene.camera) < 3.0
    assert scene.camera.covariance[0, 0] > 0.05**2
    with pytest.raises(OptionError, match="state --sport"):
        locate_court(clip, None, text, ignore_progress)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "name", "height"),
    [("badminton_1_00_01", "badminton", 6.9), ("tennis_3", "tennis", 8.7), ("table_tennis_00", "table-tennis", 4.4)],
)
def test_courts_of_the_shared_clips_are_found(folder: str, name: str, height: float) -> None:
    clip = open_clip(find_shared_file(f"courts/{folder}/clip.mp4"))
    scene = locate_court(clip, None, None, ignore_progress)
    assert scene.sport.name == name
    assert scene.line_error < 0.5
    assert scene.camera.centre[2] == pytest.approx(height, abs=0.3)
    assert (scene.camera.motion is not None) == (name == "table-tennis")
    assert clip.fps == Fraction(30 if name == "tennis" else 25)
