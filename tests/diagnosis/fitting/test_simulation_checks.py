"""Whether the windows of a fit can be simulated with other parameters is known from the first one that cannot."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from support.pucks import Pucks

from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, can_simulate, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.multiple_shooting.shooting_windows import LOST_RESIDUAL


def test_the_first_window_that_cannot_be_simulated_is_the_last_one_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    t, tried = np.arange(30) / 30, []
    places = np.outer(t, [0.3, 0.1])[:, None]
    shots = tuple(Recording(k, np.arange(30), t, ("a",), places, np.full((30, 1), 1e-3), TABLE_PLANE) for k in (0, 1))
    problem = build_diagnosis_problem(Pucks(), WHITE_NOISE)
    fitted = fit_effects(problem, shots)

    def lose(model: object, k: int, start: object, shared: object) -> SimpleNamespace:
        tried.append(k)
        return SimpleNamespace(residual=np.full((2, 2), LOST_RESIDUAL))

    monkeypatch.setattr("diagnosis.fitting.hypothesis_fits.simulate_window", lose)
    assert not can_simulate(problem, fitted, fitted.forms, fitted.shared)
    assert tried == [0]
