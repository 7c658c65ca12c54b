"""Conditions of the trust levels, and of their loss."""

from __future__ import annotations

import pytest

from models.core.fit_result import Trust, TrustLevel
from models.estimation.joint_fit.trust_level import NoiseAssessment, add_warnings, assess_trust


@pytest.mark.parametrize(("share", "colour"), [(0.95, "green"), (0.75, "amber"), (0.3, "red")])
def test_the_trust_level_follows_the_explained_share_of_motion(share: float, colour: TrustLevel) -> None:
    assert assess_trust(share, None, 5.0, []).level == colour


def test_a_warning_about_the_table_makes_green_amber_and_is_listed() -> None:
    doubted = add_warnings(assess_trust(1.0, None, 5.0, []), ("The table could also be pool-8ft.",))
    assert doubted.level == "amber"
    assert doubted.reasons[0] == "The table could also be pool-8ft."


def test_red_stays_red_and_no_warning_changes_nothing() -> None:
    red = Trust("red", ("No ball was seen.",))
    assert add_warnings(red, ("The table could also be pool-8ft.",)).level == "red"
    assert add_warnings(red, ()) == red


@pytest.mark.parametrize(("chi2", "level"), [(0.1, "amber"), (0.35, "green"), (1.4, "green"), (2.0, "amber")])
def test_residuals_that_contradict_the_noise_are_said_and_turn_the_level_amber(chi2: float, level: str) -> None:
    trust = assess_trust(1.0, NoiseAssessment(2e-4, chi2, (0.2, 1.6)), 5.0, [])
    assert trust.level == level
    doubt = f"The positions scatter {chi2**0.5:.1f} times as much around the fitted paths as their errors say;"
    doubt = f"{doubt} 0.4 to 1.3 times would agree."
    assert (doubt in trust.reasons) == (level == "amber")
