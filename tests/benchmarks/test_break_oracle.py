"""A known contact graph is fitted from where it begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import DELAY, RADIUS, film

from benchmarks.tracking.break_oracle import explain_graph
from models.core.contact_graph import Contact, ContactGraph, Segment
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

START, V = np.array([[1.2, 0.6]]), np.array([[1.6, 0.5]])


def test_a_known_graph_is_fitted_as_well_as_a_searched_one() -> None:
    rolling = np.array([[-V[0, 1] / RADIUS, V[0, 0] / RADIUS, 0.0]])
    shot = film(START, V, rolling, np.random.default_rng(5), noise_px=0.5, seconds=1.8)
    (true,) = (t for t, kind, _, _ in shot.contacts if kind == "cushion")
    begin = DELAY + 0.02  # between two frames, like `benchmarks` of breaks with known graphs
    early = np.where((shot.tracks.t < begin)[:, None, None], np.nan, shot.tracks.xy)
    states = (np.array([1.23, 0.61, *V[0], *np.zeros(4)]), np.array([2.51, 1.0, -1.2, 0.5, *np.zeros(4)]))
    segments = (Segment(0, False, None, 0, begin, states[0]), Segment(0, False, 0, None, true, states[1]))
    graph = ContactGraph(segments, (Contact("cushion", true + 2e-3, (0,), (1,), "right"),))
    fit = view_shot(explain_graph(graph, replace(shot.tracks, xy=early), shot.scene))
    full_fit = view_shot(explain(shot.tracks, shot.scene))
    assert [name for name in fit.events.kind if name != "rest"] == ["cushion"]
    assert fit.events.t[0] == pytest.approx(true, abs=3e-3)
    assert (
        abs(fit.events.t[0] - true) < abs(full_fit.events.t[list(full_fit.events.kind).index("cushion")] - true) + 1e-3
    )
    first = fit.trajectory.at(np.array([begin + 1e-4])).xy[0, 0]
    np.testing.assert_allclose(first, START[0] + V[0] * 0.02, atol=4e-3)


def test_an_unexplained_velocity_change_is_listed_with_ball_and_time() -> None:
    shot = film(START, V, np.zeros((1, 3)), np.random.default_rng(6), noise_px=0.5, seconds=0.8)
    states = (np.array([*START[0], *V[0], *np.zeros(4)]), np.array([1.4, 0.66, *V[0], *np.zeros(4)]))
    segments = (Segment(0, False, None, 0, DELAY, states[0]), Segment(0, False, 0, None, 0.55, states[1]))
    xy = np.where((shot.tracks.t < DELAY)[:, None, None], np.nan, shot.tracks.xy)
    fit = view_shot(
        explain_graph(
            ContactGraph(segments, (Contact("free", 0.55, (0,), (1,)),)), replace(shot.tracks, xy=xy), shot.scene
        )
    )
    (doubt,) = (reason for reason in fit.trust.reasons if "without a known cause" in reason)
    assert doubt.startswith("Changed speed or direction without a known cause: the cue ball at 0.")
