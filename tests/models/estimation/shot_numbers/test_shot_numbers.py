"""Numbers of a shot against geometry, and against the engine that plays it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_pot import FPS, LEAD, SCENE, film_pot, true_numbers

from models.core.errors import TrackError
from models.core.fit_result import Fit, ShotNumber, ShotNumbers, WholeShotSolution
from models.core.scene import Table
from models.core.tracks import Tracks
from models.estimation.changed_shot import draw_struck_ensemble
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import (
    add_shot_numbers,
    classify_spin,
    evaluate_contact,
    measure_shots,
)
from models.estimation.shot_numbers.strike_numbers import rewind_samples
from models.physics.billiards.cushion_geometry import find_mouth_line
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.parametrised_shot import NEUTRAL_SHOT_PARAMETERS, convert_to_starts
from models.physics.billiards.simulation.simulate_shot import BallSet, Physics, simulate

R = 0.028575
TABLE = Table("pool-9ft", "pool", 2.54, 1.27, R, 0.17, True)


def contact_states(cut: float) -> np.ndarray:
    """States of a frictionless contact: a ball at 2 m/s along +x, cut angle in degrees to its right (+y)."""
    normal = np.array([np.cos(np.radians(cut)), np.sin(np.radians(cut))])
    cue, other = np.zeros(6), np.zeros(6)
    cue[2:4], cue[4:6] = (2.0, 0.0), (2.0, 0.0)
    other[:2] = 2 * R * normal
    after, other_after = cue.copy(), other.copy()
    other_after[2:4] = 2.0 * np.cos(np.radians(cut)) * normal
    after[2:4] = cue[2:4] - other_after[2:4]
    return np.stack([cue, other, after, other_after, after])


@pytest.mark.parametrize("cut", [30.0, -30.0, 60.0])
def test_a_contact_without_friction_has_the_angles_of_geometry(cut: float) -> None:
    speed, share, angle, throw, object_speed, deflection = evaluate_contact(contact_states(cut))
    assert (speed, share) == (pytest.approx(2.0), pytest.approx(0.0))
    assert angle == pytest.approx(cut)
    assert throw == pytest.approx(0.0, abs=1e-9)
    assert object_speed == pytest.approx(2.0 * np.cos(np.radians(cut)))
    assert deflection == pytest.approx(cut - 90 if cut > 0 else cut + 90)


def test_a_clip_in_which_nothing_moves_has_no_shot() -> None:
    still = film_pot(0).truncate_after(LEAD - 1 / FPS)
    explained = explain(still, SCENE)
    fit, solution = view_shot(explained), explained.solution
    assert solution is not None
    assert measure_shots(fit, solution, still, SCENE.table) == ()
    with pytest.raises(TrackError, match="no ball moves"):
        draw_struck_ensemble(fit, solution, still, SCENE.table, 0, 4, 0)
    with pytest.raises(TrackError, match="no stroke of this clip is at least 50 % probable"):
        draw_struck_ensemble(replace(fit, moving=~fit.moving), solution, still, SCENE.table, 0, 4, 0)


@pytest.mark.parametrize(("value", "state"), [(-0.5, "draw"), (0.0, "stun"), (0.5, "follow"), (1.0, "roll")])
def test_spin_is_classified_by_its_share(value: float, state: str) -> None:
    named, chances = classify_spin(ShotNumber("contact_spin_share", value, 0.01, "", True))
    assert named == state
    assert sum(chances) == pytest.approx(1.0)
    assert max(chances) > 0.99


def test_spin_that_is_not_observable_has_no_state() -> None:
    assert classify_spin(ShotNumber("contact_spin_share", 0.5, 0.5, "", False))[0] == "unknown"


def test_samples_are_taken_back_to_the_strike_as_the_engine_plays() -> None:
    state = np.array([[0.5, 0.6, 2.0, 0.4, 3.0, 10.0, 12.0]])
    physics = Physics.from_effects({"sliding_friction": {"mu": 0.2}, "spin_decay": {"rate": 10.0}})
    shot = simulate(BallSet(("cue",), state, np.array([R]), np.array([0.17])), TABLE, physics, 1.0)
    later = convert_to_starts(shot.states_at(0.016), np.array([R]))
    values = NEUTRAL_SHOT_PARAMETERS.copy()
    values[SLIDING_MU], values[SPIN_DECAY] = 0.2, 10.0
    whole = WholeShotSolution(
        "mirror", "inelastic", 1.0, (), 0.116, ("cue",), state, np.zeros((1, 7, 7)), np.array([True]), later,
        values[None], ("inelastic",),
    )  # fmt: skip
    (sample,) = rewind_samples(whole, "cue", 0.1, 0.0, R)
    np.testing.assert_allclose(sample.states, convert_to_starts(state, np.array([R])), atol=1e-9)


def test_the_mouth_of_a_pocket_is_square_to_its_centre_line() -> None:
    corner, middle = find_mouth_line(TABLE, "bottom-right"), find_mouth_line(TABLE, "top")
    np.testing.assert_allclose(corner.outward, np.sqrt([0.5, 0.5]))
    np.testing.assert_allclose(corner.middle, [2.54 - 0.1159 / np.sqrt(8), 1.27 - 0.1159 / np.sqrt(8)])
    np.testing.assert_allclose(middle.outward, [0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(middle.middle, [1.27, 0.0])
    along = 0.1159 / np.sqrt(2)  # from the corner to each nose
    np.testing.assert_allclose(sorted(corner.ends.tolist()), [[2.54 - along, 1.27], [2.54, 1.27 - along]])
    beside_nose, inside, before = [1.27 + 0.1286 / 2 + 0.03, 0.04], [1.28, -0.02], [1.3, 0.1]
    np.testing.assert_allclose(middle.measure_gap(np.array([beside_nose, inside, before])), [0.05, -0.02, 0.1])


@pytest.fixture(scope="module")
def fit() -> Fit:
    explained = explain(film_pot(3), SCENE)
    return add_shot_numbers(view_shot(explained), explained.solution, explained.tracks, SCENE.table)


@pytest.fixture(scope="module")
def shot(fit: Fit) -> ShotNumbers:
    (one,) = fit.shot_numbers
    return one


def number(shot: ShotNumbers, name: str, ball: str = "") -> ShotNumber:
    one = shot.find_number(name, ball)
    assert one is not None
    assert one.observable
    return one


def test_a_filmed_pot_has_the_numbers_of_the_engine(shot: ShotNumbers) -> None:
    truth = true_numbers()
    assert (shot.cue, shot.first, shot.potted, shot.pockets) == ("cue", "red", ("red",), ("bottom-right",))
    assert number(shot, "cue_speed").value == pytest.approx(truth["cue_speed"], rel=0.03)
    for name in ("cue_speed", "direction", "top_spin_share", "contact_speed", "cut_angle", "object_speed", "length"):
        one = number(shot, name)
        assert abs(one.value - truth[name]) < 4 * one.sigma + 1e-3, name
    assert number(shot, "cut_angle").value > 0
    assert number(shot, "cushions", "red").value == 0


def test_the_length_of_a_path_is_that_of_the_trajectory_into_the_pocket(fit: Fit, shot: ShotNumbers) -> None:
    red = fit.trajectory.ids.index("red")
    xy = fit.trajectory.at(np.linspace(0.0, float(fit.trajectory.end.max()), 20_001)).xy[:, red]
    steps = np.diff(xy[np.isfinite(xy).all(axis=1)], axis=0)
    assert number(shot, "length", "red").value == pytest.approx(np.linalg.norm(steps, axis=1).sum(), abs=1e-3)
    assert fit.events.speed[fit.events.kind.index("strike")] == number(shot, "cue_speed").value


def test_the_passage_of_the_pocket_is_measured(shot: ShotNumbers) -> None:
    one = number(shot, "pocket_offset", "red")
    assert one.place == "bottom-right"
    assert abs(one.value - true_numbers()["pocket_offset"]) < 4 * one.sigma
    assert one.sigma < 5.0


def test_side_spin_is_not_observable_without_a_fit_of_the_whole_shot(shot: ShotNumbers) -> None:
    side = shot.find_number("side_spin_share")
    assert side is not None
    assert not side.observable
    assert np.isnan(side.value)


def test_a_clip_that_begins_in_motion_has_no_speed_at_the_strike() -> None:
    tracks = film_pot(3)
    rows = tracks.t > 0.4
    late: Tracks = replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], xy=tracks.xy[rows], px=tracks.px[rows],
        sigma=tracks.sigma[rows], sigma_along=tracks.sigma_along[rows], streak=tracks.streak[rows],
        radius_px=tracks.radius_px[rows],
    )  # fmt: skip
    explained = explain(late, SCENE)
    fit, solution = view_shot(explained), explained.solution
    assert solution is not None
    (one,) = measure_shots(fit, solution, late, SCENE.table)
    speed = one.find_number("cue_speed")
    assert speed is not None
    assert not speed.observable
    assert number(one, "cut_angle").value > 0
