"""Start states without a gradient are found from further initial guesses, also where noise could hide them."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions, fit_windows
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, Window

COUNT, SPIN_LOSS, TRUE_SPIN = 400, 1.0, 1.4


class LostSpin:
    """A spin of which a loss of 1 is gone before it deflects what is observed; noise of one standard deviation."""

    unknowns = ()

    def __init__(self) -> None:
        self.observed = TRUE_SPIN - SPIN_LOSS + np.random.default_rng(0).standard_normal(COUNT)
        self.windows = (
            Window(0, np.arange(COUNT) / COUNT, np.zeros(COUNT, int), np.zeros(1), np.full(1, 10.0),
                   alternative_starts=(np.array([-1.5]), np.array([1.5]))),
        )  # fmt: skip

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        left = np.sign(start[0]) * max(abs(start[0]) - SPIN_LOSS, 0.0)
        slope = np.full((COUNT, 1, 1), float(abs(start[0]) > SPIN_LOSS))
        empty = np.empty((COUNT, 1, 0))
        return LinearizedWindow(
            (left - self.observed)[:, None], slope, empty, np.empty(0), np.empty((0, 1)), np.empty((0, 0))
        )


def test_a_spin_that_is_lost_is_found_although_a_fit_without_it_passes_as_noise() -> None:
    model = LostSpin()
    usual = fit_windows(model, starts=(np.zeros(1),), retry_guesses=True)
    thorough = fit_windows(
        model, starts=(np.zeros(1),), retry_guesses=True, options=ShootingOptions(tries_all_guesses=True)
    )
    assert usual.cost / COUNT < 1.3
    assert usual.starts[0][0] == 0.0
    assert thorough.cost < usual.cost - 30
    assert abs(thorough.starts[0][0] - TRUE_SPIN) < 4 / np.sqrt(COUNT)
