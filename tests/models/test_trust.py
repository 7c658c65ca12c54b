"""What a light says, and what takes it away."""

from __future__ import annotations

import pytest

from models.core.fit_result import Light, Trust
from models.estimation.joint_fit.trust_level import light, with_doubts


@pytest.mark.parametrize(("share", "colour"), [(0.95, "green"), (0.75, "amber"), (0.3, "red")])
def test_the_light_follows_the_share_of_motion_that_is_explained(share: float, colour: Light) -> None:
    assert light(share, 1.0, 5.0, []).light == colour


def test_a_doubt_about_the_table_takes_the_green_light_and_is_said() -> None:
    doubted = with_doubts(light(1.0, 1.0, 5.0, []), ("The table could also be pool-8ft.",))
    assert doubted.light == "amber"
    assert doubted.reasons[-1] == "The table could also be pool-8ft."


def test_a_red_light_stays_red_and_no_doubt_changes_nothing() -> None:
    red = Trust("red", ("No ball was seen.",))
    assert with_doubts(red, ("The table could also be pool-8ft.",)).light == "red"
    assert with_doubts(red, ()) == red
