"""Two effects of similar size are both named, although neither alone explains more than it leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.reference_frames import PLANE

from diagnosis.diagnose import diagnose
from models.core.recording import Recording
from models.estimation.gap_scenes.flight_scene import build_flight_scene
from models.estimation.gap_scenes.gap_scene import neutral_values

NOISE = 0.003
"""m"""
FLIGHT = build_flight_scene(2)
NAMES = [f"{effect.name}.{prior.name}" for effect in FLIGHT.effects for prior in effect.parameters]
ROWS = 40
"""rows, at 30 frames per second"""


def throws(acts: dict[str, float], seed: int) -> tuple[Recording, ...]:
    """Simulate eight throws to either side."""
    rng, recordings, shared = np.random.default_rng(seed), [], neutral_values(FLIGHT)
    for name, value in acts.items():
        shared[NAMES.index(name)] = value
    for shot in range(8):
        speed, angle, side = rng.uniform(6, 12), np.radians(rng.uniform(35, 80)), rng.choice([-1, 1])
        blank = Recording(
            shot,
            np.arange(ROWS),
            np.arange(ROWS) / 30,
            ("ball",),
            np.zeros((ROWS, 1, 2)),
            np.full((ROWS, 1), NOISE),
            PLANE,
        )
        start = np.array([0, 1, side * speed * np.cos(angle), speed * np.sin(angle)])
        path = FLIGHT.predict_positions(blank, start, shared, ())
        recordings.append(replace(blank, positions=path + NOISE * rng.standard_normal(path.shape)))
    return tuple(recordings)


@pytest.mark.parametrize("spin", [-0.265, 0.35])
def test_drag_and_lift_of_like_size_are_both_named(spin: float) -> None:
    report = diagnose(FLIGHT, throws({"air_drag.k": 0.085, "magnus.s": spin}, 1))
    assert report.effects == ("air_drag", "magnus")
    assert report.gap.closure.closed > 0.99
