"""Touching balls give an estimate of their size that is independent of calibration and prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run

from models.core.fit_result import Parameter
from models.core.scene import BallSize
from models.estimation.reconstruction.plausibility import (
    CONTACT_FLOOR,
    describe_ball_factor,
    estimate_contact_ball_size,
    warn_of_contact_ball_size,
)

RADIUS = 0.03


def test_the_estimate_of_the_contacts_excludes_the_prior() -> None:
    true, sigma, prior = 1.05, 0.01, 0.02
    information = sigma**-2 + prior**-2
    fitted = describe_ball_factor((true * sigma**-2 + prior**-2) / information, information**-0.5)
    size = estimate_contact_ball_size([fitted], RADIUS)
    assert size is not None
    assert size.source == "contacts"
    assert size.radius == pytest.approx(true * RADIUS)
    assert size.sigma == pytest.approx(np.hypot(sigma, CONTACT_FLOOR) * RADIUS)


def test_contacts_that_leave_the_prior_are_no_estimate() -> None:
    assert describe_ball_factor(0.96, 0.0155).prior_only
    assert estimate_contact_ball_size([describe_ball_factor(0.96, 0.0155)], RADIUS) is None
    assert estimate_contact_ball_size([describe_ball_factor(1.0, float("nan"))], RADIUS) is None
    assert estimate_contact_ball_size([Parameter("rolling_resistance.mu", 0.01, 0.001, "", False)], RADIUS) is None


def test_contacts_that_contradict_the_preset_give_a_warning() -> None:
    preset = BallSize(RADIUS, 1e-4, "preset")
    scene = replace(synthetic_run.make_scene(), ball_size_estimates=(preset,))
    (warning,) = warn_of_contact_ball_size([describe_ball_factor(1.08, 0.004)], scene)
    assert "8 % larger than those of a carom-small table" in warning
    assert warn_of_contact_ball_size([describe_ball_factor(1.01, 0.004)], scene) == ()
    contradicted = replace(scene, ball_size_estimates=(replace(preset, source="user"), BallSize(0.04, 1e-4, "image")))
    assert warn_of_contact_ball_size([describe_ball_factor(1.08, 0.004)], contradicted) == ()  # the scene warns
