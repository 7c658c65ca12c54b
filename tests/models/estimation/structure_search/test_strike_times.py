"""Strike times from few frames: they depend on the slip, which no frame shows."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_shots import DELAY, RADIUS, Filmed, film

from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

FPS = 8
TIP_RADII = 0.2
"""Standard deviation of the height at which a cue hits a ball, above and below its middle."""


def lone_shot(seed: int) -> Filmed:
    """A ball alone on the table."""
    rng = np.random.default_rng(seed)
    angle, speed = rng.uniform(-0.4, 0.4), rng.uniform(0.6, 2.5)
    v, w = speed * np.array([[np.cos(angle), np.sin(angle)]]), np.zeros((1, 3))
    w[0, :2] = 2.5 * rng.normal(0, TIP_RADII) * np.array([-v[0, 1], v[0, 0]]) / RADIUS
    return film(rng.uniform([[0.4, 0.5]], [[0.6, 0.7]]), v, w, rng, fps=FPS, seconds=2.5, missing=0.0)


def test_strikes_are_neither_early_nor_late_at_eight_fps() -> None:
    errors, pulls = [], []
    for seed in range(20):
        shot = lone_shot(seed)
        events = view_shot(explain(shot.tracks, shot.scene)).events
        row = events.kind.index("strike")
        errors.append(float(events.t[row]) - DELAY)
        pulls.append(errors[-1] / float(events.t_sigma[row]))
    assert np.mean(errors) == pytest.approx(0, abs=2e-3)
    assert np.sqrt(np.mean(np.square(errors))) < 8e-3
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5
