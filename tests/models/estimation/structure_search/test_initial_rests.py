"""Shots that begin within the first frames of a clip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import DELAY, film
from support.filmed_shots import scene as film_scene

from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import measure_shots


def _cut(tracks: Tracks, first: int) -> Tracks:
    """Cut the frames before `first`; times stay."""
    return replace(
        tracks, frame=tracks.frame[first:], t=tracks.t[first:], xy=tracks.xy[first:], px=tracks.px[first:],
        sigma=tracks.sigma[first:], sigma_along=tracks.sigma_along[first:], streak=tracks.streak[first:],
        radius_px=tracks.radius_px[first:],
    )  # fmt: skip


def _shot(seed: int) -> Tracks:
    return film(
        np.array([[0.5, 0.6], [1.6, 0.9]]), np.array([[3.0, 0.4], [0, 0]]), np.zeros((2, 3)),
        np.random.default_rng(seed), seconds=2.0, missing=0.0,
    ).tracks  # fmt: skip


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_strike_after_two_frames_at_rest_is_found_in_time(seed: int) -> None:
    tracks = _cut(_shot(seed), int(DELAY * 30) - 1)  # two frames at rest
    events = view_shot(explain(tracks, film_scene())).events
    strikes = [k for k in range(len(events)) if events.kind[k] == "strike" and events.a[k] == "cue"]
    assert len(strikes) == 1
    assert events.t[strikes[0]] == pytest.approx(DELAY, abs=0.5 / 30)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_ball_that_already_moves_was_not_surely_struck_within_the_clip(seed: int) -> None:
    tracks = _cut(_shot(seed), int(DELAY * 30) + 4)
    fit = view_shot(explain(tracks, film_scene()))
    sure = [k for k in range(len(fit.events)) if fit.events.kind[k] == "strike" and fit.events.probability[k] >= 0.9]
    assert not sure
    assert "cue" in fit.explanation.moving_at_start


def test_a_ball_near_whose_place_the_first_samples_lie_was_not_shot() -> None:
    tracks = _shot(0)
    tracks.xy[:5, 1, 1] += [0.014, 0.012, 0.011, 0.012, 0.01]  # m, half a radius
    shot = explain(tracks, film_scene())
    fit = view_shot(shot)
    assert shot.solution is not None
    assert not shot.solution.graph.segments[shot.solution.graph.segments_of_ball(1)[0]].static, "the fit follows them"
    assert "solid-1" not in fit.explanation.moving_at_start
    assert [one.cue for one in measure_shots(fit, shot.solution, tracks, film_scene().table)] == ["cue"]
