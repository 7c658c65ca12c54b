"""Whole shots as windows: derivatives against differences, true parameters within their errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.simulated_shots import filmed, numbers, shots, unknown

from models.physics.billiards.simulation.parametrised_shot import (
    SHOT_PARAMETERS,
    ImagePlacement,
    distort_places,
    pack_start,
)

ODD = {
    "slope__slope_x": 1.5, "slope__slope_y": -0.8, "air_drag__k": 0.02, "viscous_drag__k": 0.03, "nap__mu": 0.001,
    "cushion_restitution_speed__slope": 0.02, "unequal_mass__ratio": 1.03, "unequal_radius__ratio": 0.99,
    "collision_radius__factor": 1.004, "nose__left": 0.001, "lens_distortion__k1": 0.01, "perspective__p_x": 0.004,
    "perspective__p_y": -0.006, "scale__seen": 1.01, "rolling_shutter__readout": 0.01, "dropped_frames__frames": 1.0,
}  # fmt: skip

CURVING = ("slope.", "air_drag.", "viscous_drag.", "cloth_force.")
"""Their paths have an integration error of 3e-10 m, so that finite differences need large steps."""


@pytest.mark.parametrize("odd", [False, True])
def test_jacobians_equal_differences_of_residuals(odd: bool) -> None:
    values = numbers(**ODD) if odd else numbers()
    segment = filmed(np.random.default_rng(4), values, seconds=1.2)
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(SHOT_PARAMETERS, values, strict=True))
    model = shots((segment,), unknowns, values)
    start = pack_start(segment.start, segment.moving)
    flow = model.linearize(0, start, values)
    step = 1e-7
    for k in range(len(start)):
        sides = [model.linearize(0, start + sign * step * np.eye(len(start))[k], values) for sign in (1, -1)]
        slope = (sides[0].residual - sides[1].residual) / (2 * step)
        assert np.percentile(np.abs(slope - flow.start_jacobian[..., k]), 97) < 1e-3 * (1 + np.abs(slope).max())
    for k, name in enumerate(SHOT_PARAMETERS):
        step = 1e-4 if name.startswith(CURVING) else 1e-7
        sides = [model.linearize(0, start, values + sign * step * np.eye(len(values))[k]) for sign in (1, -1)]
        slope = (sides[0].residual - sides[1].residual) / (2 * step)
        error = np.percentile(np.abs(slope - flow.shared_jacobian[..., k]), 97)
        assert error < 1e-3 * (1 + np.abs(slope).max()), name


def test_the_handover_of_a_window_depends_on_its_start_and_the_parameters() -> None:
    values = numbers(collision_radius__factor=1.01, unequal_radius__ratio=0.98)
    first = filmed(np.random.default_rng(4), values, seconds=1.2)
    second = replace(first, begin=1.0, moving=np.array([True, True, False]), continues_previous=True)
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(SHOT_PARAMETERS, values, strict=True))
    model = shots((first, second), unknowns, values)
    start = pack_start(first.start, first.moving)
    flow = model.linearize(0, start, values)
    assert flow.end.shape == model.windows[1].start.shape
    step = 1e-7
    for k in range(len(start)):
        sides = [model.linearize(0, start + sign * step * np.eye(len(start))[k], values).end for sign in (1, -1)]
        np.testing.assert_allclose(
            flow.end_start_jacobian[:, k], (sides[0] - sides[1]) / (2 * step), rtol=1e-4, atol=1e-4
        )
    for k, name in enumerate(SHOT_PARAMETERS):
        step = 1e-4 if name.startswith(CURVING) else 1e-7
        sides = [model.linearize(0, start, values + sign * step * np.eye(len(values))[k]).end for sign in (1, -1)]
        slope = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(flow.end_shared_jacobian[:, k], slope, rtol=1e-4, atol=1e-4, err_msg=name)


@pytest.mark.parametrize("pockets", [False, True])
def test_a_window_is_simulated_as_any_other_shot(pockets: bool) -> None:
    values = numbers(slope__slope_x=1.5, nose__left=0.001, lens_distortion__k1=0.01)
    segment = filmed(np.random.default_rng(4), values, seconds=1.2)
    model = shots((segment,), (), values)
    model = replace(model, table=replace(model.table, pockets=pockets))
    start, none = pack_start(segment.start, segment.moving), np.empty(0)
    expected = model.predict_observed_path(0, start, none)[segment.observation_indices] - segment.observations
    expected = (segment.observation_whitening @ expected[..., None])[..., 0]
    np.testing.assert_allclose(model.simulate(0, start, none).residual, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(model.linearize(0, start, none).residual, model.simulate(0, start, none).residual)
    run = model.simulate_possible_run(0, start, none)
    assert run is not None
    assert len(run.contacts) * 3 * 8 == len(model.simulate(0, start, none).event_order)


def test_absent_sliding_friction_has_a_secant_as_derivative() -> None:
    values = numbers(sliding_friction__mu=0.0)
    segment = filmed(np.random.default_rng(4), values, seconds=0.3)
    model = shots((segment,), (unknown("sliding_friction.mu", 0.0, 0.1),), values)
    start = pack_start(segment.start, segment.moving)
    flow, with_friction = model.linearize(0, start, np.zeros(1)), model.linearize(0, start, np.array([0.2]))
    np.testing.assert_allclose(flow.residual + 0.2 * flow.shared_jacobian[..., 0], with_friction.residual, atol=1e-9)


def test_unphysical_parameters_have_infinite_cost() -> None:
    values = numbers(nap__mu=0.02)
    segment = filmed(np.random.default_rng(4), numbers(), seconds=0.3)
    flow = shots((segment,), (), values).linearize(0, pack_start(segment.start, segment.moving), np.zeros(0))
    assert np.all(np.isinf(flow.residual))


def test_an_unknown_without_effect_on_shots_is_refused() -> None:
    with pytest.raises(ValueError, match=r"got glue\.mu"):
        shots((), (unknown("glue.mu", 0.0, 1.0),), numbers())


def test_lens_distortion_acts_about_the_image_centre() -> None:
    view = ImagePlacement(np.array([1.0, 0.5]), 1.0)
    shown = distort_places(view, np.array([[1.0, 0.5], [2.0, 0.5]]), np.array([0.1, 0.0, 0.0, 1.0, 0.0]))[0]
    np.testing.assert_allclose(shown, [[1.0, 0.5], [2.1, 0.5]])
    shown = distort_places(view, np.array([[1.5, 0.5]]), np.array([0.1, 0.0, 0.0, 1.0, -0.4]))[0]
    np.testing.assert_allclose(shown, [[1.5, 0.5]])
    shown = distort_places(view, np.array([[2.0, 0.5]]), np.array([0.0, 0.25, 0.0, 1.0, 0.0]))[0]
    np.testing.assert_allclose(shown, [[1.8, 0.5]])


def test_a_predicted_path_passes_through_its_observations() -> None:
    """Rolling shutter, dropped frames, lens and perspective: consistent with the residuals."""
    values = numbers(**ODD)
    segment = filmed(np.random.default_rng(4), values, seconds=1.2)
    view = ImagePlacement(np.array([1.2, 0.6]), 1.3, 1.4)
    segment = replace(
        segment, image_row=view.image_rows(segment.xy), dropped_frame_delay=np.where(segment.t > 0.5, 1 / 60, 0.0)
    )
    unknowns = tuple(unknown(name, value, 1.0) for name, value in zip(SHOT_PARAMETERS, values, strict=True))
    model = replace(shots((segment,), unknowns, values), view=view)
    start = pack_start(segment.start, segment.moving)
    shown = model.predict_observed_path(0, start, values)
    again = replace(segment, xy=shown, image_row=view.image_rows(shown))
    misfit = replace(model, segments=(again,)).linearize(0, start, values).residual
    assert np.abs(model.linearize(0, start, values).residual).max() > 5
    assert np.abs(misfit).max() < 0.1
