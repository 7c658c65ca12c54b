"""Windows whose numbers overflow end themselves, not the fit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from support.bouncing_ball import Bounces, filmed

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import fit_windows
from models.estimation.multiple_shooting.shooting_problem import build_problem
from models.estimation.multiple_shooting.shooting_windows import (
    LOST_RESIDUAL,
    LinearizedWindow,
    is_lost,
    linearize_window,
    simulate_window,
)

TRUTH = np.array([9.81, 0.8])
LATE = slice(30, None)


@dataclass(frozen=True)
class Overflowing:
    """Bounces of which the second window has impossible numbers from row 30 on."""

    bounces: Bounces
    number: float
    field: str = "residual"

    @property
    def unknowns(self):
        return self.bounces.unknowns

    @property
    def windows(self):
        return self.bounces.windows

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        flow = self.bounces.linearize(window, start, shared)
        if window == 1:
            values = getattr(flow, self.field).copy()
            values[LATE] = self.number
            flow = replace(flow, **{self.field: values})
        return flow


def film_three(seed: int = 3) -> Bounces:
    return filmed(np.random.default_rng(seed), 3, 0.002)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_observations_that_overflow_cost_a_fixed_price(number: float) -> None:
    model = Overflowing(film_three(), number)
    window = simulate_window(model, 1, model.windows[1].start, TRUTH)
    np.testing.assert_array_equal(np.flatnonzero(is_lost(window.residual)), np.arange(30, 45))
    np.testing.assert_array_equal(window.residual[LATE], LOST_RESIDUAL)
    assert np.isfinite(window.residual).all()


@pytest.mark.parametrize("field", ["residual", "start_jacobian", "shared_jacobian"])
@pytest.mark.parametrize("number", [np.nan, np.inf, 1e300])
def test_the_other_observations_determine_the_fit(field: str, number: float) -> None:
    fitted = fit_windows(Overflowing(film_three(), number, field))
    assert np.isfinite(fitted.cost)
    assert np.isfinite(fitted.covariance).all()
    assert np.abs(fitted.shared - TRUTH).max() < 5 * fitted.sigma.max()


def test_derivatives_beyond_the_precision_of_numbers_determine_nothing() -> None:
    model = Overflowing(film_three(), 1e13, "start_jacobian")
    flow = linearize_window(model, 1, model.windows[1].start, TRUTH)
    assert not flow.start_jacobian[LATE].any()
    assert not flow.shared_jacobian[LATE].any()
    assert flow.start_jacobian[:30].any()
    sound = linearize_window(model, 0, model.windows[0].start, TRUTH)
    np.testing.assert_array_equal(
        sound.start_jacobian, model.linearize(0, model.windows[0].start, TRUTH).start_jacobian
    )


def test_only_linked_windows_form_a_chain() -> None:
    bounces = film_three()
    first, second, third = bounces.windows
    linked = replace(second, shot=0, link_sigma=np.full(2, 1e-3))
    model = replace(bounces, windows=(first, linked, replace(third, shot=0)))
    assert build_problem(model).chains == ((0, 1), (2,))
