"""Strikes and first contacts between the same two frames."""

from __future__ import annotations

import numpy as np
import pytest
from support.filmed_shots import RADIUS, Filmed, film

from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

FPS = 8
"""Frames per second: one is taken 25 ms before the strike, the next 100 ms after it."""
GAP = 1 / FPS


def quick_opening(seed: int) -> Filmed:
    """A cue ball that meets another one before the next frame, with any spin."""
    rng = np.random.default_rng(seed)
    x = np.array([[0.7, 0.5], [0.0, 0.0], [2.2, 0.3]])
    speed, angle = rng.uniform(3.0, 4.0), rng.uniform(-0.5, 0.5)
    way = 2 * RADIUS + rng.uniform(0.4, 0.7) * 0.1 * speed
    x[1] = x[0] + way * np.array([np.cos(angle), np.sin(angle)])
    aim = angle + rng.uniform(-1.2, 1.2) * RADIUS / way
    v, w = np.zeros((3, 2)), np.zeros((3, 3))
    v[0] = speed * np.array([np.cos(aim), np.sin(aim)])
    w[0, :2] = rng.uniform(-0.3, 0.8) * np.array([-v[0, 1], v[0, 0]]) / RADIUS
    return film(x, v, w, rng, fps=FPS, seconds=4.0, missing=0.0)


@pytest.mark.parametrize("seed", [0, 2, 15, 18, 19])
def test_a_ball_that_is_hit_before_the_next_frame_was_hit_by_the_struck_one(seed: int) -> None:
    shot = quick_opening(seed)
    events = view_shot(explain(shot.tracks, shot.scene)).events
    t, kind, a, b = shot.contacts[0]
    assert (kind, {a, b}) == ("ball", {"cue", "solid-1"})
    first = [k for k in range(len(events)) if events.kind[k] in ("strike", "ball") and events.t[k] < t + GAP]
    assert [(events.kind[k], {events.a[k], events.b[k]}) for k in first] == [("strike", {"cue", ""}), ("ball", {a, b})]
    assert events.t[first] == pytest.approx([shot.strike, t], abs=0.005)
