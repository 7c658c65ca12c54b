"""The diagnosis on pucks: the right name, none, unknown, pairs, groups, and how far the gap shrinks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.pucks import CATALOGUE, LENS, SCALE, Filming, Pucks, film

from diagnosis.diagnose import diagnose, undo_identity_switches
from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.selection.hypotheses import SearchOutlook
from diagnosis.verdicts import diagnosis_report
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene

FRICTION = {"friction.mu": 0.02}
SHORT = Filming(shots=8, fps=30)
PUCKS = Pucks()
LACKING = {
    "slope": {"slope.slope_x": 2.0, "slope.slope_y": -1.0},
    "air_drag": {"air_drag.k": 0.1},
    "viscous_drag": {"viscous_drag.k": 0.15},
    "sideways": {"sideways.c": 0.1},
    "lens_distortion": {"lens_distortion.k1": 0.02},
}


def diagnose_pucks(
    truth: dict, seed: int = 1, filming: Filming = SHORT, scene: Pucks = PUCKS, extra=None
) -> DiagnosisReport:
    return diagnose(scene, film(np.random.default_rng(seed), FRICTION | truth, filming, extra))


@cache
def diagnose_lack(name: str) -> DiagnosisReport:
    """Diagnose a simulator that lacks one effect."""
    return diagnose_pucks(LACKING[name])


@pytest.mark.parametrize("name", LACKING)
def test_the_missing_effect_is_named_and_measured(name: str) -> None:
    report = diagnose_lack(name)
    assert report.verdict == "effects"
    assert report.effects == (name,)
    assert report.candidates[0].effect == name
    for one in report.candidates[0].strengths:
        truth = LACKING[name].get(f"{name}.{one.name}", 0.0)
        assert abs(one.value - truth) < 5 * one.sigma
    assert report.gap.closure.resolved
    assert report.gap.closure.closed > 0.7


def test_nothing_is_named_where_nothing_is_missing() -> None:
    report = diagnose_pucks({})
    assert report.verdict == "none"
    assert report.effects == ()
    assert np.isnan(report.gap.closure.closed)


def test_two_missing_effects_are_both_named() -> None:
    report = diagnose_pucks(LACKING["slope"] | LACKING["air_drag"])
    assert report.effects == ("air_drag", "slope")
    assert {one.effect for one in report.per_effect} == {"air_drag", "slope"}
    assert max(one.probability for one in report.candidates) < 0.5 < report.probability
    assert abs(sum(one.closed for one in report.per_effect) - report.gap.closure.closed) < 0.02


def test_a_force_that_the_library_lacks_is_unknown() -> None:
    def patch(place: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        return -0.5 * velocity * np.exp(-np.square(place - [0.2, 0.1]).sum() / (2 * 0.2**2))

    report = diagnose_pucks({}, extra=patch, filming=replace(SHORT, shots=12))
    assert report.verdict == "unknown"
    assert report.effects == ()
    assert report.candidates[0].effect == "unknown"
    assert report.unexplained.shape
    assert report.unexplained.where
    assert report.film_next.startswith("Most of the unexplained gap is")


def test_an_effect_taken_out_of_the_library_is_unknown() -> None:
    scene = Pucks(effects=tuple(effect for effect in CATALOGUE if effect.name != "sideways"))
    assert diagnose_pucks({"sideways.c": 0.2}, scene=scene).verdict == "unknown"


def test_probabilities_add_up_and_hold_none_and_unknown() -> None:
    report = diagnose_lack("slope")
    chances = [one.probability for one in report.candidates]
    assert abs(sum(chances) - 1) < 1e-9
    assert chances == sorted(chances, reverse=True)
    assert {"none", "unknown"} <= {one.effect for one in report.candidates}
    assert abs(sum(place.share for place in report.where) - 1) < 1e-9


def test_a_signature_that_states_absorb_is_named_unidentifiable() -> None:
    """Along one line of travel a slope is as good as friction, and a scale looks like other speeds."""
    scene = Pucks(effects=(CATALOGUE[0], CATALOGUE[1], SCALE))
    report = diagnose_pucks({}, scene=scene, filming=replace(SHORT, one_way=True))
    assert "scale" in report.unidentifiable


def test_two_effects_that_look_alike_are_a_group() -> None:
    """A twin of the lens under another name."""
    scene = Pucks(effects=(*CATALOGUE, replace(LENS, name="lens_twin")))
    report = diagnose_pucks(LACKING["lens_distortion"], scene=scene)
    assert report.verdict == "group"
    assert set(report.candidates[0].group) == {"lens_distortion", "lens_twin"}
    assert "lens twin" in report.film_next
    assert "lens distortion" in report.film_next


def test_shots_that_report_choose_nothing() -> None:
    shots = film(np.random.default_rng(2), FRICTION | LACKING["slope"], SHORT)
    honest = diagnose(Pucks(), shots)
    rng = np.random.default_rng(5)

    def garbage(one: Recording) -> Recording:
        held_out = one.shot in honest.gap.shots
        return replace(one, positions=rng.normal(0, 1, one.positions.shape)) if held_out else one

    poisoned = diagnose(Pucks(), tuple(garbage(one) for one in shots))
    assert honest.gap.shots
    assert poisoned.verdict == honest.verdict
    assert repr(poisoned.candidates) == repr(honest.candidates)  # not a number is not equal to itself
    assert repr(poisoned.where) == repr(honest.where)


@pytest.mark.parametrize(("floor", "verdict"), [(0.9, "undecidable"), (0.1, "unknown")])
def test_an_effect_that_may_close_nothing_of_the_gap_is_not_named(
    monkeypatch: pytest.MonkeyPatch, floor: float, verdict: str
) -> None:
    """What it leaves on hold-out shots, an rms error of 1, is noise or is not."""
    doubtful = GapClosure(1.5, 1.0, floor, 0.54, (-0.3, 0.84), True, 0.4)
    monkeypatch.setattr(diagnosis_report, "estimate_closure", lambda *_, **__: doubtful)
    report = diagnose_pucks(LACKING["slope"])
    assert (report.verdict, report.effects) == (verdict, ())
    assert "hold-out shots do not confirm slope" in report.reason
    assert "-30 %" in report.reason


def test_too_little_is_undecidable() -> None:
    one = film(np.random.default_rng(1), FRICTION, Filming(shots=1))[0]
    assert diagnose(Pucks(), (one.select_rows(0, 6),)).verdict == "undecidable"
    still = replace(
        one, positions=one.positions[:1] + 0.001 * np.random.default_rng(1).normal(size=one.positions.shape)
    )
    report = diagnose(Pucks(), (still,))
    assert report.verdict == "undecidable"
    assert "nothing moves" in report.film_next


def test_bodies_that_lie_still_never_seem_to_move() -> None:
    """Sixty bodies in noise alone: the widest of them must not pass for a motion."""
    rng, rows = np.random.default_rng(4), 120
    for shot in range(4):
        places = rng.uniform(0.1, 0.9, (15, 2)) + 1e-3 * rng.standard_normal((rows, 15, 2))
        names = tuple(str(number) for number in range(15))
        one = Recording(
            shot, np.arange(rows), np.arange(rows) / 60, names, places, np.full((rows, 15), 1e-3), TABLE_PLANE
        )
        assert "nothing moves" in diagnose(Pucks(), (one,)).film_next


def test_who_watches_is_told_what_is_tried() -> None:
    messages: list[tuple[str, tuple[str, ...], SearchOutlook]] = []
    diagnose(
        Pucks(),
        film(np.random.default_rng(0), FRICTION | LACKING["slope"], SHORT),
        on_progress=lambda *now: messages.append(now),
    )
    assert messages[0] == ("fitting the simulator", (), SearchOutlook())
    assert ("trying", ("slope",)) in [message[:2] for message in messages]
    assert messages[-1][0] == "predicting hold-out shots"
    outlooks = [outlook for *_, outlook in messages]
    steps = [outlook.steps_done for outlook in outlooks]
    assert steps == sorted(steps)
    assert steps[-1] > 3
    assert [outlook.best for outlook in outlooks if outlook.best is not None][-1] == ("slope",)
    assert all(outlook.steps_left > 0 for outlook in outlooks)


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
