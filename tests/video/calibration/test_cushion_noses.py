"""Maxima of a profile, compared with SciPy's; lines through steps, also at the ends of the profile."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import find_peaks

from video.calibration.cushion_noses import DEPTHS, POSITIONS, SideProfiles, find_profile_peaks, fit_side_line


@pytest.mark.parametrize("seed", range(40))
def test_maxima_and_their_prominence_are_those_of_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    levels = np.convolve(rng.normal(size=300), np.ones(seed % 5 + 1), "same")
    levels = np.round(levels, 1) if seed % 2 else levels  # with plateaus
    index, prominence = find_profile_peaks(levels, 0.4, 0.2)
    expected, properties = find_peaks(levels, height=0.4, prominence=0.2)
    assert len(expected) > 5
    np.testing.assert_array_equal(index, expected)
    np.testing.assert_allclose(prominence, properties["prominences"])


@pytest.mark.parametrize("levels", [[1.0], [1.0, 1.0], [0.0, 1.0], [3.0, 2.0, 3.0], [2.0] * 9])
def test_a_profile_without_an_inner_maximum_gives_none(levels: list[float]) -> None:
    index, prominence = find_profile_peaks(np.array(levels), 0.0, 0.0)
    assert len(index) == len(prominence) == 0


def _make_side_with_step(at: int) -> SideProfiles:
    """Profiles across a horizontal side, a pixel apart, whose brightness changes around one depth."""
    rows, depths = np.arange(len(POSITIONS)), np.arange(len(DEPTHS))
    pixels = np.stack(np.broadcast_arrays(2.0 * rows[:, None], 1.0 * depths[None]), axis=-1)
    strength = 10 * np.exp(-0.5 * ((depths - at) / 1.5) ** 2)
    gradient = np.broadcast_to(strength[None, :, None], (*pixels.shape[:2], 3)).copy()
    return SideProfiles(pixels, gradient, strength, 1.0)


@pytest.mark.parametrize("at", [0, 1, 80, len(DEPTHS) - 2, len(DEPTHS) - 1])
def test_a_line_is_found_where_its_step_is_also_at_the_ends_of_the_profiles(at: int) -> None:
    line = fit_side_line(_make_side_with_step(at), float(DEPTHS[at]), 0.021)
    depth = -line.coefficients[2] / line.coefficients[1]
    assert abs(depth - at) < 1.6
