"""Causes of velocity changes: which contacts explain two balls that change at the same time."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.estimation.segmentation.contact_classification import VelocityChange, assign_causes
from models.estimation.segmentation.track_segmentation import SegmentFit
from models.physics.billiards.tables import TABLE_PRESETS

TABLE = TABLE_PRESETS["pool-9ft"]


def change(ball: int, x: list[float], before: float, after: float) -> VelocityChange:
    """A ball at a place whose velocity along the table changes within a tenth of a millisecond."""
    place: FloatArray = np.array(x)
    still = SegmentFit(0.0, place, np.zeros(2), np.zeros(2), np.zeros(2), 0.0, 0.0)
    along: FloatArray = np.array([1.0, 0.0])
    return VelocityChange(
        ball, 0, 0.5, 0.49995, 0.50005, place, before * along, after * along, before == 0, 500.0, still, still, False
    )


@pytest.mark.parametrize(("radii", "touch"), [(1.48, False), (1.62, True), (2.0, True), (2.38, True), (2.52, False)])
def test_balls_whose_distance_errs_by_less_than_half_a_radius_have_met(radii: float, touch: bool) -> None:
    """Calibrations err by as much; balls farther apart were struck one by one."""
    place = [1.2, 0.6]
    beside = [place[0] + radii * TABLE.ball_radius, place[1]]
    causes = assign_causes([change(0, place, 1.0, 0.05), change(1, beside, 0.0, 0.95)], TABLE)
    assert ("ball" in [cause.kind for cause in causes]) == touch
