"""Numbers that are derived from a learned cloth."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.constants import GRAVITY
from models.estimation.table_learning.table_measurements import compute_roll_out


@pytest.mark.parametrize("drag", [0.0, 1e-7, 0.002, 0.05])
def test_a_ball_rolls_out_as_far_as_its_equation_of_motion_says(drag: float) -> None:
    rolling, speed = 0.008, 2.0
    v = np.linspace(0.0, speed, 200_001)
    length = np.trapezoid(v / (rolling * GRAVITY + drag * v), v)  # dx = v dv / a
    assert compute_roll_out(rolling, drag, speed) == pytest.approx(length, rel=1e-6)
