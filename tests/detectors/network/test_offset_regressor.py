"""Offset regressors at run time: geometry of the crops, mirrored forms, and the shipped networks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.rendered_balls import CLOTH, PX_PER_M, RADIUS, Ball, build_test_scene, render_balls

from detectors.measurement.circle_fit import Circles, fit_circles, smooth_image
from detectors.network.ball_model import SHIPPED_BALL_MODEL
from detectors.network.offset_regressor import (
    DISC,
    DISC_RADIUS_PX,
    DISC_SIDE,
    STREAK,
    STREAK_COLUMNS,
    STREAK_MARGIN_RADII,
    STREAK_RADIUS_PX,
    STREAK_ROWS,
    DiscCrop,
    OffsetRegressor,
    OffsetRegressorKind,
    StreakCrop,
    measure_discs,
    measure_streak,
    open_offset_regressor,
)
from detectors.network.outline_fusion import (
    DOUBTFUL_SIGMA_PX,
    REAL_FOOTAGE_SIGMA_FACTOR,
    Surroundings,
    locate_outlines,
    refine_doubtful_discs,
)
from detectors.network.peak_decoding import CandidateDetections
from models.core.errors import ModelError

SIZE_PX = RADIUS * PX_PER_M
WHITE = (235.0, 235.0, 225.0)
MIDDLE = (DISC_SIDE - 1) / 2


def image_of_dot(at: np.ndarray, size: float) -> np.ndarray:
    """An image that is dark but for a soft dot at px (2,)."""
    y, x = np.mgrid[:300, :400]
    level = 250 * np.exp(-0.5 * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / size**2)
    return np.repeat(level[..., None], 3, 2).astype(np.uint8)


def middle_of(crop: np.ndarray) -> np.ndarray:
    weight = crop[..., 0].astype(float)
    y, x = np.mgrid[: crop.shape[0], : crop.shape[1]]
    return np.array([(x * weight).sum(), (y * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("radius", [5.0, 10.0, 31.0])
@pytest.mark.parametrize("roll", [0.0, 0.4, 3.0])
def test_a_place_beside_a_ball_is_at_its_offset_in_the_crop(radius: float, roll: float) -> None:
    ball = DiscCrop(np.array([203.3, 151.8]), radius, roll)
    for beside in ((0.0, 0.0), (0.7, 0.0), (-0.3, 0.5)):
        at = ball.shift(np.array(beside)).centre
        assert ball.offset_to(at) == pytest.approx(beside)
        shown = middle_of(ball.sample(image_of_dot(at, max(radius / 4, 1.5))))
        assert shown == pytest.approx(MIDDLE + DISC_RADIUS_PX * np.array(beside), abs=0.2)


@pytest.mark.parametrize("radius", [5.0, 9.0, 21.0])
@pytest.mark.parametrize("displacement", [(20.0, 0.0), (-13.0, 31.0), (4.0, -40.0)])
def test_the_ends_of_a_streak_are_at_the_ends_of_its_crop(radius: float, displacement: tuple[float, float]) -> None:
    crop = StreakCrop(np.array([203.3, 151.8]), radius, np.array(displacement))
    length = float(np.hypot(*displacement))
    ahead = STREAK_COLUMNS / (length + 2 * STREAK_MARGIN_RADII * radius)
    for end in (-0.5, 0.0, 0.5):
        for beside in (0.0, 0.8):
            at = crop.centre + end * crop.displacement + beside * radius * crop.axes[1]
            shown = middle_of(crop.sample(image_of_dot(at, max(radius / 4, 1.5))))
            middle = np.array([(STREAK_COLUMNS - 1) / 2, (STREAK_ROWS - 1) / 2])
            assert shown == pytest.approx(
                middle + np.array([end * length * ahead, beside * STREAK_RADIUS_PX]), abs=0.35
            )


def test_the_offset_of_a_streak_leads_to_it() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        one, other = (StreakCrop(rng.normal(200, 10, 2), 8.0, rng.normal(0, 20, 2)) for _ in range(2))
        moved = one.shift(one.offset_to(other.centre, other.displacement))
        assert moved.centre == pytest.approx(other.centre)
        assert moved.displacement * np.sign(moved.displacement @ other.displacement) == pytest.approx(
            other.displacement
        )
        assert moved.displacement @ one.displacement > 0 or abs(moved.displacement @ one.displacement) < 1e-9


def flip_of(axes: tuple[int, ...]) -> np.ndarray:
    """Signs (2,) of x and y under a reflection of the axes of stacked crops."""
    return np.array([-1.0 if 2 in axes else 1.0, -1.0 if 1 in axes else 1.0])


def test_the_offset_in_a_mirrored_disc_crop_is_the_same_with_the_other_sign() -> None:
    forms = DISC.list_mirror_forms()
    assert [axes for axes, _ in forms] == [(), (2,)]
    for axes, signs in forms:
        flip = flip_of(axes)
        offset = DiscCrop(np.array([60.0, 50.0]), 8.0).offset_to(np.array([63.0, 48.0]))
        mirrored = DiscCrop(flip * (60.0, 50.0), 8.0).offset_to(flip * (63.0, 48.0))
        assert mirrored == pytest.approx(signs * offset)


def test_the_offset_in_a_mirrored_streak_crop_is_the_same_with_other_signs() -> None:
    """The image is mirrored together with the streak and the truth."""
    centre, truth = np.array([60.0, 50.0]), np.array([63.0, 48.0])
    displacement, true_displacement = np.array([20.0, 0]), np.array([24, 3.0])
    offset = StreakCrop(centre, 8.0, displacement).offset_to(truth, true_displacement)
    forms = STREAK.list_mirror_forms()
    assert [axes for axes, _ in forms] == [(), (2,), (1,), (2, 1)]
    for axes, signs in forms:
        flip = flip_of(axes)
        mirrored = StreakCrop(centre * flip, 8.0, displacement).offset_to(truth * flip, true_displacement * flip)
        assert mirrored == pytest.approx(signs * offset)


def test_a_rendered_ball_is_measured_from_a_rough_centre() -> None:
    rng = np.random.default_rng(1)
    misses, pulls = [], []
    for _ in range(20):
        ball = Ball(*rng.uniform((150, 120), (450, 220)), rng.uniform(60, 250, 3))
        at = np.array([ball.x, ball.y]) + 0.25 * SIZE_PX * rng.normal(size=2)
        regressor, radius = open_offset_regressor(DISC), np.array([SIZE_PX])
        [centre], [sigma] = measure_discs(regressor, render_balls([ball], rng), at[None], radius)
        misses.append(centre - (ball.x, ball.y))
        pulls.append(misses[-1] / sigma)
    assert np.sqrt(np.mean(np.square(misses))) < 0.3
    assert np.abs(pulls).mean() < 2


@pytest.mark.parametrize("streak", [(14.0, 5.0), (-9.0, 22.0), (38.0, -17.0)])
def test_a_rendered_streak_is_measured_from_a_rough_detection(streak: tuple[float, float]) -> None:
    rng = np.random.default_rng(1)
    regressor, misses, pulls = open_offset_regressor(STREAK), [], []
    for _ in range(5):
        ball = Ball(*rng.uniform((150, 120), (450, 220)), WHITE, streak)
        image = render_balls([ball], rng)
        rough = np.array(streak) * rng.uniform(0.85, 1.15) * rng.choice([-1, 1])
        at = np.array([ball.x, ball.y]) + rng.normal(0, 2.0, 2)
        measured = measure_streak(regressor, image, at, SIZE_PX, rough)
        along = np.array(streak) / np.hypot(*streak)
        miss = measured.centre - (ball.x, ball.y)
        misses.append(miss)
        pulls.append([miss @ along / measured.sigma_along, (miss @ [-along[1], along[0]]) / measured.sigma_across])
        oriented = measured.displacement * np.sign(measured.displacement @ rough)
        assert np.linalg.norm(oriented - np.array(streak) * np.sign(rough @ streak)) < 4
    assert np.sqrt(np.mean(np.square(misses))) < 0.7
    assert np.abs(pulls).mean() < 2


def test_an_occluded_ball_is_measured_by_its_visible_part() -> None:
    """The result is its centre, not the middle of the visible part."""
    rng, misses, rests = np.random.default_rng(2), [], []
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        ball = Ball(300.0 + rng.random(), 180.0 + rng.random(), (220.0, 60.0, 50.0))
        over = np.array([ball.x, ball.y]) + 1.4 * SIZE_PX * np.array([np.cos(angle), np.sin(angle)])
        image = render_balls([ball, Ball(*over, WHITE)], rng)
        start = np.array([[ball.x + 1, ball.y - 1]])
        [centre], _ = measure_discs(open_offset_regressor(DISC), image, start, np.array([SIZE_PX]))
        misses.append(centre - (ball.x, ball.y))
        rests.append(np.linalg.norm(over - (ball.x, ball.y)) / 10)
    assert np.sqrt(np.mean(np.square(misses))) < 0.5 * np.mean(rests)


def test_none_and_one_at_the_border_are_measured_without_an_error() -> None:
    image, regressor = render_balls([Ball(3.0, 2.0, WHITE)], np.random.default_rng(2)), open_offset_regressor(DISC)
    centre, sigma = measure_discs(regressor, image, np.empty((0, 2)), np.empty(0))
    assert centre.shape == (0, 2)
    assert sigma.shape == (0,)
    for radius in (SIZE_PX, 6 * SIZE_PX):
        centre, sigma = measure_discs(regressor, image, np.array([[1.0, 1.0]]), np.array([radius]))
        assert np.isfinite(centre).all()
        assert np.isfinite(sigma).all()


def test_a_streak_at_the_border_is_measured_without_an_error() -> None:
    image = render_balls([Ball(4.0, 3.0, WHITE, (20.0, 0.0))], np.random.default_rng(2))
    for radius in (SIZE_PX, 6 * SIZE_PX):
        start, displacement = np.array([1.0, 1.0]), np.array([20.0, 3.0])
        measured = measure_streak(open_offset_regressor(STREAK), image, start, radius, displacement)
        numbers = [*measured.centre, *measured.displacement, measured.sigma_across, measured.sigma_along]
        assert np.isfinite(numbers).all()


@pytest.mark.parametrize("kind", [DISC, STREAK], ids=lambda kind: kind.name)
def test_another_network_is_refused_in_one_sentence(tmp_path: Path, kind: OffsetRegressorKind) -> None:
    with pytest.raises(ModelError, match=kind.subject):
        open_offset_regressor(kind, SHIPPED_BALL_MODEL)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"no network")
    with pytest.raises(ModelError, match="cannot be read"):
        open_offset_regressor(kind, broken)


def candidates_at(places: np.ndarray, sigma: float) -> CandidateDetections:
    """Candidates of a ball network at px (n, 2)."""
    one = np.ones(len(places))
    columns = {
        name: np.zeros((len(places), 4)) if name == "appearance" else one for name in CandidateDetections.__slots__
    }
    columns |= {"centre": places, "streak": np.zeros((len(places), 2)), "radius": SIZE_PX * one}
    return CandidateDetections(**{**columns, "sigma_across": sigma * one, "sigma_along": sigma * one})


def fix_measured_place(monkeypatch: pytest.MonkeyPatch, place: np.ndarray) -> list[np.ndarray]:
    """Let every ball be measured at one place; the rough centres of every call are collected."""
    calls = list[np.ndarray]()

    def measure(
        regressor: OffsetRegressor, rgb: np.ndarray, centre: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        calls.append(centre)
        return np.tile(place, (len(centre), 1)), np.full(len(centre), 0.05)

    monkeypatch.setattr("detectors.network.outline_fusion.measure_discs", measure)
    return calls


def test_only_a_ball_that_its_outline_leaves_in_doubt_is_measured_by_the_regressor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A ball with a clear outline keeps its place; one that the image does not show gets that of the regressor."""
    rng, place = np.random.default_rng(4), np.array([400.0, 201.0])
    image = render_balls([Ball(200.0, 150.0, WHITE)], rng)
    candidates = candidates_at(np.array([[200.0, 150.0], [400.0, 200.0]]), 1.0)
    surroundings = Surroundings(np.full(2, SIZE_PX), np.tile(CLOTH, (2, 1)), np.eye(3), build_test_scene())
    calls, smooth = fix_measured_place(monkeypatch, place), smooth_image(image)
    first, outlines = locate_outlines(image, smooth, candidates, surroundings, 0)
    regressor = open_offset_regressor(DISC)
    refined = refine_doubtful_discs(image, smooth, first, outlines, surroundings, regressor, 0)
    assert [len(centres) for centres in calls] == [1]
    assert refined.centre[0] == pytest.approx([200, 150], abs=0.2)
    assert refined.sigma[0] < DOUBTFUL_SIGMA_PX
    assert refined.centre[1] == pytest.approx(place, abs=0.01)
    assert first.centre[1] == pytest.approx([400, 200])  # there is nothing but the network's position
    assert refined.sigma[1] == pytest.approx(REAL_FOOTAGE_SIGMA_FACTOR * 0.05, rel=0.05)
    assert outlines.support[0] > 0.9
    assert outlines.support[1] == 0


@pytest.mark.parametrize(("off", "times"), [(0.0, 0), (0.2, 1)])
def test_an_outline_is_fitted_again_only_where_the_regressor_moves_the_ball(
    off: float, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = render_balls([Ball(200.0, 150.0, WHITE)], np.random.default_rng(4))
    candidates, smooth = candidates_at(np.array([[201.0, 150.0]]), 1.0), smooth_image(image)
    surroundings = Surroundings(np.full(1, SIZE_PX), np.array([CLOTH]), np.eye(3), build_test_scene())
    first, outlines = locate_outlines(image, smooth, candidates, surroundings, 0)
    doubtful = replace(first, sigma=np.full(1, 2 * DOUBTFUL_SIGMA_PX))
    fits = list[np.ndarray]()

    def count_fits(rgb: np.ndarray, smooth: np.ndarray, centre: np.ndarray, *rest: Any) -> Circles:
        fits.append(centre)
        return fit_circles(rgb, smooth, centre, *rest)

    monkeypatch.setattr("detectors.network.outline_fusion.fit_circles", count_fits)
    fix_measured_place(monkeypatch, np.array([200.0 + off * SIZE_PX, 150.0]))
    regressor = open_offset_regressor(DISC)
    refined = refine_doubtful_discs(image, smooth, doubtful, outlines, surroundings, regressor, 0)
    assert len(fits) == times
    assert refined.centre[0] == pytest.approx([200.0 + 0.5 * off * SIZE_PX, 150.0], abs=0.5 * off * SIZE_PX + 0.2)
