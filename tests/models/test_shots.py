"""Whole shots as windows: derivatives hold, what is true is found again within its errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import filmed, numbers, shots, unknown

from models.physics.billiards.calibration_errors import View, seen
from models.physics.billiards.simulation.parametrised_shot import NUMBERS, packed

ODD = {
    "slope__slope_x": 1.5, "slope__slope_y": -0.8, "air_drag__k": 0.02, "viscous_drag__k": 0.03, "nap__mu": 0.001,
    "cushion_restitution_speed__slope": 0.02, "unequal_mass__ratio": 1.03, "unequal_radius__ratio": 0.99,
    "collision_radius__factor": 1.004, "nose__left": 0.001, "lens_distortion__k1": 0.01, "perspective__p_x": 0.004,
    "perspective__p_y": -0.006, "scale__seen": 1.01, "rolling_shutter__readout": 0.01, "dropped_frames__frames": 1.0,
}  # fmt: skip

CURVING = ("slope.", "air_drag.", "viscous_drag.")
"""Their paths are integrated with an error of 3e-10 m, which differences must not divide by too little."""


@pytest.mark.parametrize("odd", [False, True])
def test_slopes_of_a_flow_are_its_differences(odd: bool) -> None:
    values = numbers(**ODD) if odd else numbers()
    stretch = filmed(np.random.default_rng(4), values, seconds=1.2)
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(NUMBERS, values, strict=True))
    model = shots((stretch,), unknowns, values)
    start = packed(stretch.start, stretch.moving)
    flow = model.flow(0, start, values)
    step = 1e-7
    for k in range(len(start)):
        sides = [model.flow(0, start + sign * step * np.eye(len(start))[k], values) for sign in (1, -1)]
        slope = (sides[0].misfit - sides[1].misfit) / (2 * step)
        assert np.percentile(np.abs(slope - flow.by_start[..., k]), 97) < 1e-3 * (1 + np.abs(slope).max())
    for k, name in enumerate(NUMBERS):
        step = 1e-4 if name.startswith(CURVING) else 1e-7
        sides = [model.flow(0, start, values + sign * step * np.eye(len(values))[k]) for sign in (1, -1)]
        slope = (sides[0].misfit - sides[1].misfit) / (2 * step)
        error = np.percentile(np.abs(slope - flow.by_shared[..., k]), 97)
        assert error < 1e-3 * (1 + np.abs(slope).max()), name


def test_what_a_window_hands_over_follows_its_start_and_the_numbers() -> None:
    values = numbers(collision_radius__factor=1.01, unequal_radius__ratio=0.98)
    first = filmed(np.random.default_rng(4), values, seconds=1.2)
    second = replace(first, begin=1.0, moving=np.array([True, True, False]), follows=True)
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(NUMBERS, values, strict=True))
    model = shots((first, second), unknowns, values)
    start = packed(first.start, first.moving)
    flow = model.flow(0, start, values)
    assert flow.end.shape == model.windows[1].start.shape
    step = 1e-7
    for k in range(len(start)):
        sides = [model.flow(0, start + sign * step * np.eye(len(start))[k], values).end for sign in (1, -1)]
        np.testing.assert_allclose(flow.end_by_start[:, k], (sides[0] - sides[1]) / (2 * step), rtol=1e-4, atol=1e-4)
    for k, name in enumerate(NUMBERS):
        step = 1e-4 if name.startswith(CURVING) else 1e-7
        sides = [model.flow(0, start, values + sign * step * np.eye(len(values))[k]).end for sign in (1, -1)]
        slope = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(flow.end_by_shared[:, k], slope, rtol=1e-4, atol=1e-4, err_msg=name)


def test_sliding_that_is_absent_has_the_slope_of_a_secant() -> None:
    values = numbers(sliding_friction__mu=0.0)
    stretch = filmed(np.random.default_rng(4), values, seconds=0.3)
    model = shots((stretch,), (unknown("sliding_friction.mu", 0.0, 0.1),), values)
    start = packed(stretch.start, stretch.moving)
    flow, with_friction = model.flow(0, start, np.zeros(1)), model.flow(0, start, np.array([0.2]))
    np.testing.assert_allclose(flow.misfit + 0.2 * flow.by_shared[..., 0], with_friction.misfit, atol=1e-9)


def test_numbers_that_nature_does_not_allow_cost_infinitely_much() -> None:
    values = numbers(nap__mu=0.02)
    stretch = filmed(np.random.default_rng(4), numbers(), seconds=0.3)
    flow = shots((stretch,), (), values).flow(0, packed(stretch.start, stretch.moving), np.zeros(0))
    assert np.all(np.isinf(flow.misfit))


def test_an_unknown_that_shots_do_not_hang_on_is_refused() -> None:
    with pytest.raises(ValueError, match=r"got glue\.mu"):
        shots((), (unknown("glue.mu", 0.0, 1.0),), numbers())


def test_a_view_bends_places_about_its_middle() -> None:
    view = View(np.array([1.0, 0.5]), 1.0)
    shown = seen(view, np.array([[1.0, 0.5], [2.0, 0.5]]), np.array([0.1, 0.0, 0.0, 1.0, 0.0]))[0]
    np.testing.assert_allclose(shown, [[1.0, 0.5], [2.1, 0.5]])
    shown = seen(view, np.array([[1.5, 0.5]]), np.array([0.1, 0.0, 0.0, 1.0, -0.4]))[0]
    np.testing.assert_allclose(shown, [[1.5, 0.5]])
    shown = seen(view, np.array([[2.0, 0.5]]), np.array([0.0, 0.25, 0.0, 1.0, 0.0]))[0]
    np.testing.assert_allclose(shown, [[1.8, 0.5]])


def test_a_path_is_shown_where_its_observations_are() -> None:
    """Rows taken at times of their own, pictures missing, lens and perspective: as misfits have it."""
    values = numbers(**ODD)
    stretch = filmed(np.random.default_rng(4), values, seconds=1.2)
    view = View(np.array([1.2, 0.6]), 1.3, 1.4)
    stretch = replace(stretch, row=view.rows(stretch.xy), late=np.where(stretch.t > 0.5, 1 / 60, 0.0))
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(NUMBERS, values, strict=True))
    model = replace(shots((stretch,), unknowns, values), view=view)
    start = packed(stretch.start, stretch.moving)
    shown = model.path_seen(0, start, values)
    again = replace(stretch, xy=shown, row=view.rows(shown))
    misfit = replace(model, stretches=(again,)).flow(0, start, values).misfit
    assert np.abs(model.flow(0, start, values).misfit).max() > 5
    assert np.abs(misfit).max() < 0.1
