"""Samples of the flying-object network."""

from __future__ import annotations

import numpy as np

from detectors.flying.frame_windows import MIDDLE_IMAGE
from detectors.flying.spot_patches import LAYERS, LUMA_LAYERS, PATCH_PX
from detectors.training.flying_samples import LARGEST_OFF_PX, cut_film_samples, judge_spots, split_planes
from detectors.training.flying_scenes import FRAMES, OBJECTS, draw_film
from detectors.training.flying_training import FlyingNetwork, flying_loss, vary_samples


def test_a_film_shows_its_objects_where_its_truth_says() -> None:
    film = draw_film(np.random.default_rng(4))
    assert film.luma.shape[0] == FRAMES
    assert film.centre.shape == (FRAMES, OBJECTS, 2)
    samples = cut_film_samples(np.random.default_rng(0), film)
    own = samples.truth[:, 0] > 0
    assert own.any()
    assert (~own).any()
    # The place of the greatest change about a spot of the object lies along its streak.
    for patch, truth in zip(samples.patches[own], samples.truth[own], strict=True):
        assert np.abs(truth[1:3]).max() <= LARGEST_OFF_PX
        assert patch.shape == (LAYERS, PATCH_PX, PATCH_PX)


def test_the_same_seed_draws_the_same_film() -> None:
    first, second = (draw_film(np.random.default_rng(9)) for _ in range(2))
    assert np.array_equal(first.luma, second.luma)


def test_varied_samples_keep_the_truth() -> None:
    rng = np.random.default_rng(0)
    x, y, streak = 4.0, -3.0, (6.0, 2.0)
    patches = np.full((64, LAYERS, PATCH_PX, PATCH_PX), 20, np.uint8)
    rows, columns = np.mgrid[:PATCH_PX, :PATCH_PX] - PATCH_PX // 2
    for share in np.linspace(-0.5, 0.5, 9):
        patches[:, MIDDLE_IMAGE, np.hypot(columns - x - share * streak[0], rows - y - share * streak[1]) < 1.6] = 220
    truth = np.tile(np.array([1, x, y, *streak], np.float32), (64, 1))
    varied, truths = vary_samples(rng, patches, truth)
    for patch, true in zip(varied, truths, strict=True):
        weight = np.clip(patch[MIDDLE_IMAGE] - patch[MIDDLE_IMAGE].max() / 2, 0, None)
        centre = np.array([(weight * columns).sum(), (weight * rows).sum()]) / weight.sum()
        assert np.abs(centre - true[1:3]).max() < 0.35
        off = np.stack([columns, rows], axis=-1) - centre
        spread = np.einsum("ij,ijk,ijl->kl", weight, off, off) / weight.sum()
        axis = np.linalg.eigh(spread)[1][:, 1]
        assert abs(axis @ true[3:]) > 0.97 * np.linalg.norm(true[3:])
    assert len(np.unique(truths[:, 1:], axis=0)) > 4


def test_samples_that_are_reversed_in_time_keep_colours_apart() -> None:
    patches = np.full((64, LAYERS, PATCH_PX, PATCH_PX), 100, np.uint8)
    # Blue differences rise with time, and red ones are lower.
    patches[:, LUMA_LAYERS:] = np.array([120, 60, 140, 60, 160, 60])[:, None, None]
    varied, _ = vary_samples(np.random.default_rng(0), patches, np.zeros((64, 5), np.float32))
    level = varied[:, LUMA_LAYERS:].mean(axis=(2, 3)).reshape(64, 3, 2)
    assert np.all(level[:, :, 0] > 1.5 * level[:, :, 1])
    rising = level[:, 2, 0] > level[:, 0, 0]
    assert 10 < rising.sum() < 54
    assert np.all(np.abs(level[:, 1, 0] / level[:, :, 0].mean(axis=1) - 1) < 0.05)


def test_planes_of_a_frame_keep_brightness_and_colour_apart() -> None:
    frame = np.full((8, 12, 3), 90, np.uint8)
    frame[:4, :6] = [30, 60, 220]
    planes = split_planes(frame)
    assert planes.luma.shape == (8, 12)
    assert planes.chroma.shape == (4, 6, 2)
    assert planes.chroma[0, 0, 0] > 180
    assert planes.chroma[0, 0, 1] < 120
    assert np.abs(planes.chroma[3, 5].astype(int) - 128).max() <= 1


def test_a_spot_beside_the_object_is_neither() -> None:
    place = np.array([[100, 100], [106, 107], [150, 100]])
    own, clear = judge_spots(place, np.array([101.0, 101.0]), np.array([4.0, 0.0]), 1.0)
    assert own.tolist() == [True, False, False]
    assert clear.tolist() == [True, False, True]
    own, clear = judge_spots(place, np.array([101.0, 101.0]), np.array([4.0, 0.0]), 0.0)
    assert not own.any()
    assert clear.all()


def test_an_end_of_a_long_streak_shows_its_middle_only_within_the_patch() -> None:
    place = np.array([[100, 100], [120, 100], [140, 100]])
    own, clear = judge_spots(place, np.array([100.0, 100.0]), np.array([90.0, 0.0]), 1.0)
    assert own.tolist() == [True, True, False]
    assert clear.all()


def test_the_loss_is_least_at_the_truth() -> None:
    import torch

    truth = torch.tensor([[1.0, 2.0, -1.0, 0.0, 8.0], [0.0, 0.0, 0.0, 0.0, 0.0]])
    right = torch.tensor([[9.0, 2.0, -1.0, -8.0, 0.0, 0.0, 0.0], [-9.0, 0, 0, 0, 0, 0, 0]])
    best, _ = flying_loss(right, truth)
    for column in range(5):
        wrong = right.clone()
        wrong[0, column] -= 3.0
        assert flying_loss(wrong, truth)[0] > best
    assert FlyingNetwork()(torch.zeros(2, LAYERS, PATCH_PX, PATCH_PX)).shape == (2, 7)
