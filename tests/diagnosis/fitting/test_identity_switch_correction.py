"""Identity switches of a tracker are undone; contacts, outliers and gaps are left unchanged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.diagnose import diagnose
from diagnosis.fitting.identity_switch_correction import undo_identity_switches
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene

NOISE = 1e-3
"""m"""
ROWS = 60
T = np.arange(ROWS) / 60


def of(*paths: np.ndarray, shot: int = 0, seed: int = 0) -> Recording:
    places = np.stack(paths, axis=1)
    places = places + NOISE * np.random.default_rng(seed).standard_normal(places.shape)
    names = tuple("abcd"[: len(paths)])
    return Recording(shot, np.arange(ROWS), T, names, places, np.full(places.shape[:2], NOISE), TABLE_PLANE)


def line(x: float, y: float, vx: float, vy: float) -> np.ndarray:
    return np.stack([x + vx * T, y + vy * T], axis=1)


def switch_identities(recording: Recording, row: int, order: list[int]) -> Recording:
    places = recording.positions.copy()
    places[row:] = places[row:, order]
    return replace(recording, positions=places)


def test_two_names_that_were_exchanged_are_given_back() -> None:
    true = of(line(0, 0, 1, 0), line(0, 0.5, -0.5, 0.2))
    restored, switches = undo_identity_switches(switch_identities(true, 30, [1, 0]))
    np.testing.assert_array_equal(restored.positions, true.positions)
    assert str(switches[0]) == "in shot 0 bodies a and b were exchanged at 0.50 s; the exchange was undone"


def test_three_names_in_a_ring_and_an_exchange_that_is_undone_later_are_given_back() -> None:
    true = of(line(0, 0, 1, 0), line(0, 0.5, -0.5, 0.2), line(0.7, 0.7, 0, 0))
    for order in ([1, 2, 0], [2, 0, 1]):
        np.testing.assert_array_equal(
            undo_identity_switches(switch_identities(true, 20, order))[0].positions, true.positions
        )
    twice = switch_identities(switch_identities(true, 20, [1, 0, 2]), 40, [1, 0, 2])
    restored, switches = undo_identity_switches(twice)
    np.testing.assert_array_equal(restored.positions, true.positions)
    assert len(switches) == 2


def test_what_was_not_seen_around_an_exchange_does_not_hide_it() -> None:
    true = of(line(0, 0, 1, 0), line(0, 0.5, -0.5, 0.2))
    places = switch_identities(true, 30, [1, 0]).positions.copy()
    places[29:31, 1] = np.nan
    restored, switches = undo_identity_switches(replace(true, positions=places))
    assert len(switches) == 1
    np.testing.assert_array_equal(restored.positions[31:], true.positions[31:])


def test_a_ball_that_stops_dead_and_one_that_takes_its_speed_keep_their_names() -> None:
    """A straight hit: each body goes on as the other would have, but neither leaps."""
    hit = 0.5
    runs = np.where(hit > T, 2.0 * T, 2.0 * hit)
    goes = np.where(hit > T, 2.0 * hit + 0.05, 2.0 * T + 0.05)
    met = of(np.stack([runs, 0 * T], axis=1), np.stack([goes, 0 * T], axis=1))
    assert undo_identity_switches(met) == (met, ())


def test_a_mistake_of_one_picture_and_a_body_put_elsewhere_are_no_exchange() -> None:
    still = of(line(0, 0, 1, 0), line(0, 0.5, -0.5, 0.2))
    places = still.positions.copy()
    places[30] += 0.3
    places[45:, 0] += 0.4
    strange = replace(still, positions=places)
    assert undo_identity_switches(strange) == (strange, ())


def test_an_effect_is_named_although_names_were_exchanged_in_every_shot() -> None:
    scene, rng, shots = build_sliding_scene(("sliding_friction",)), np.random.default_rng(3), []
    strengths = [0.15, 0.0, 0.0, 6.0, -4.0]  # mu, drags, slope
    shared = np.array(strengths + [0.0] * (sum(len(e.parameters) for e in scene.effects) - len(strengths)))
    for shot in range(8):
        angle, speed = rng.uniform(0, 2 * np.pi, 2), rng.uniform(0.8, 2.0, 2)
        blank = of(line(0, 0, 0, 0), line(0, 0, 0, 0), shot=shot)
        x = np.array([[0.0, 0.0], [0.7, 0.1]])
        start = np.column_stack([x, speed * np.cos(angle), speed * np.sin(angle)]).ravel()
        path = scene.predict_positions(blank, start, shared, ())
        shots.append(switch_identities(of(path[:, 0], path[:, 1], shot=shot, seed=shot), 30, [1, 0]))
    report = diagnose(scene, tuple(shots))
    assert report.effects == ("slope",)
    assert len(report.notes) == 8
