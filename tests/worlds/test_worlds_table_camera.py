"""The camera of the billiard table: known effects on known positions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from worlds.table_camera import TableCamera

LENGTH, WIDTH = 2.54, 1.27
MIDDLE = np.array([LENGTH, WIDTH]) / 2


def camera(fps: float = 62.5, **effects: dict[str, float]) -> TableCamera:
    return TableCamera(LENGTH, WIDTH, fps, effects)


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 62.5, 120.0])
def test_paths_are_sampled_a_whole_number_of_times_per_frame(fps: float) -> None:
    for one in (camera(fps), camera(fps, rolling_shutter={"readout": 0.01})):
        assert one.rate / fps == round(one.rate / fps)
        assert one.rate >= 1000


def test_a_lens_moves_positions_outwards_with_the_cube_of_their_distance() -> None:
    path = np.array([[[LENGTH, WIDTH / 2], [0.75 * LENGTH, WIDTH / 2], MIDDLE]])
    away = camera(lens_distortion={"k1": 0.02}).film_path(path, np.zeros(1))[0] - path[0]
    assert_allclose(away, LENGTH / 2 * np.array([[0.02, 0], [0.0025, 0], [0, 0]]), atol=1e-12)


def test_lower_rows_are_captured_later() -> None:
    one = camera(rolling_shutter={"readout": 0.01})
    t = np.arange(2000) / one.rate
    path = np.stack([np.stack([2.0 * t, np.full(len(t), y)], axis=1) for y in (0.0, WIDTH / 2, WIDTH)], axis=1)
    observed = one.film_path(path, np.array([0.1]))[0]
    assert_allclose(observed[:, 0], 2.0 * (0.1 + np.array([-0.005, 0.0, 0.005])), atol=2.0 / one.rate)


def test_dropped_frames_shift_every_other_shot_from_its_middle_on() -> None:
    one = camera(dropped_frames={"frames": 2.2})
    assert_allclose(np.diff(one.capture_times(9, 0)) * 62.5, [1, 1, 3, 1, 1, 1, 1, 1])
    assert_allclose(np.diff(one.capture_times(9, 1)) * 62.5, 1)


def test_scale_and_perspective_leave_the_middle_where_it_is() -> None:
    one = camera(scale={"seen": 0.01}, perspective={"p_x": 0.01, "p_y": -0.02})
    path = np.array([[MIDDLE, (LENGTH, WIDTH / 2)]])
    observed = one.film_path(path, np.zeros(1))[0]
    assert_allclose(observed[0], MIDDLE, atol=1e-12)
    assert_allclose(observed[1] - MIDDLE, [LENGTH / 2 * 1.01 / (1 + 0.0101), 0], atol=1e-12)
