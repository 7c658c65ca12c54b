"""The profile of a learned table survives its file, and other profiles still work for predictions."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.fit_result import Parameter
from models.core.scene import Table
from models.estimation.table_learning.learn_table import TableLesson
from models.estimation.table_learning.learned_table import DEFAULT_SCATTER, ContactScatter, LearnedTable
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION, WEIGHT_COUNT
from models.physics.billiards.parameter_vector import (
    BALL_E,
    CUSHION_E,
    CUSHION_MU,
    ROLLING_MU,
    SLIDING_MU,
    neutral_parameters,
)
from models.physics.effects.billiards_catalogue import find_prior
from pipeline.actions.fit_table import write_learned_profile
from pipeline.io.shot_setup import ShotSetup, parse_shot, place_on_learned_table
from pipeline.io.table_profile import parse_cloth_priors, parse_learned_table, parse_table_prior, read_profile_text

NOSES = 1e-6 * np.array([[4.0, 1.0, 0, 0], [1.0, 2.0, 0, 0], [0, 0, 17.0, 0], [0, 0, 0, 3.0]])
CUSHIONS = np.array([[4e-4, -1.5e-4], [-1.5e-4, 1e-4]])
TABLE = Table("carom", "carom", 2.84, 1.42, 0.03075, 0.21, False)


def make_lesson() -> TableLesson:
    physics = neutral_parameters()
    values = {"sliding_friction.mu": 0.19, "rolling_resistance.mu": 0.0042, "cushion_restitution.e": 0.91,
              "cushion_friction.mu": 0.24, "spin_decay.rate": 4.0}  # fmt: skip
    physics[[SLIDING_MU, ROLLING_MU, CUSHION_E]] = 0.19, 0.0042, 0.91
    learned = LearnedTable(
        "han_2005", physics, ContactScatter(0.02, 0.1, 0.06),
        np.array([-0.002, 0.0, 0.001, 0.0]), NOSES, np.array([CUSHION_E, CUSHION_MU]), CUSHIONS,
        np.linspace(-1, 1, WEIGHT_COUNT),
    )  # fmt: skip
    parameters = tuple(Parameter(name, value, 0.05 * value, "1", False) for name, value in values.items())
    return TableLesson(learned, parameters, (("han_2005", 12.0), ("mirror", -30.0)), 55, 0.2, np.empty((0, 0)))


def test_a_learned_table_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    write_learned_profile(make_lesson(), TABLE, 9, path)
    text = read_profile_text(path)
    learned = parse_learned_table(text)
    assert learned.cushion_law == "han_2005"
    assert learned.scatter == ContactScatter(0.02, 0.1, 0.06)
    assert learned.physics[[SLIDING_MU, ROLLING_MU, CUSHION_E]] == pytest.approx([0.19, 0.0042, 0.91])
    assert 0.9 < learned.physics[BALL_E] < 1.0  # not learned: the usual one
    np.testing.assert_allclose(learned.correction, np.linspace(-1, 1, WEIGHT_COUNT))
    np.testing.assert_allclose(learned.noses, [-0.002, 0.0, 0.001, 0.0])
    np.testing.assert_allclose(learned.nose_covariance, NOSES)
    assert learned.uncertain.tolist() == [CUSHION_E, CUSHION_MU]
    np.testing.assert_allclose(learned.covariance, CUSHIONS)
    drawn = learned.draw_physics(np.random.default_rng(0), 4000)
    assert np.corrcoef(drawn.T)[0, 1] == pytest.approx(-0.75, abs=0.05)
    assert parse_table_prior(text).laws.cushion == "han_2005"  # `run --profile` reads the same file
    assert json.loads(text)["learned_from"] == {"cushion_contacts": 55, "shots": 9}


def test_a_profile_without_scatter_predicts_with_the_usual_one(tmp_path: Path) -> None:
    text = json.dumps({"effects": {"cushion_restitution": {"e": {"value": 0.8}}}, "laws": {"cushion": "stronge"}})
    learned = parse_learned_table(text)
    assert learned.scatter == DEFAULT_SCATTER
    assert learned.physics[CUSHION_E] == 0.8
    assert learned.physics[ROLLING_MU] > 0


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ([[1.0]], "2 rows and columns"),
        ([[1.0, 0.5], [0.0, 1.0]], "symmetric"),
        ([[1.0, 2.0], [2.0, 1.0]], "eigenvalue"),
    ],
)
def test_a_matrix_that_is_no_covariance_is_refused(tmp_path: Path, matrix: list[list[float]], words: str) -> None:
    path = tmp_path / "profile.json"
    write_learned_profile(make_lesson(), TABLE, 9, path)
    content = json.loads(path.read_text())
    content["covariance"]["matrix"] = matrix
    path.write_text(json.dumps(content))
    with pytest.raises(OptionError, match=words):
        read_profile_text(path)


def test_noses_of_a_profile_are_priors_of_whole_shots_outwards(tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    write_learned_profile(make_lesson(), TABLE, 9, path)
    noses = {one.name: (one.value, one.sigma) for one in parse_table_prior(read_profile_text(path)).priors}
    assert noses["nose.left"] == pytest.approx((0.002, 0.002))


def test_a_profile_narrows_the_friction_of_the_contact_test(tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    write_learned_profile(make_lesson(), TABLE, 9, path)
    sliding, rolling = parse_cloth_priors(read_profile_text(path))
    assert (sliding.value, rolling.value) == pytest.approx((0.19, 0.0042))
    assert sliding.sigma < find_prior("sliding_friction", "mu").sigma
    assert rolling.sigma < find_prior("rolling_resistance", "mu").sigma


def test_pooltool_gets_what_it_can_hold_of_a_learned_table(tmp_path: Path) -> None:
    left_out = write_learned_profile(make_lesson(), TABLE, 9, tmp_path / "club.json")
    document = json.loads((tmp_path / "club.pooltool.json").read_text())
    assert (document["ball_cushion"], document["ball_ball_friction"]) == ("han_2005", "alciatore")
    assert (document["ball_params"]["u_s"], document["ball_params"]["e_c"]) == pytest.approx((0.19, 0.91))
    assert document["ball_params"]["e_b"] == pytest.approx(find_prior("ball_restitution", "e").value)
    assert document["not_held"] == [
        "correction of the cushion model", "offsets of the noses", "scatter of cushion contacts"
    ]  # fmt: skip
    assert tuple(document["not_held"]) == left_out


def test_a_shot_on_a_learned_table_has_its_cloth_noses_and_correction(tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    write_learned_profile(make_lesson(), TABLE, 9, path)
    shot = parse_shot(
        {
            "table": {"length": 2.84, "width": 1.42},
            "seconds": 3.0,
            "balls": [{"id": "a", "x": 0.5, "y": 0.7, "vx": -2.0}],
        }
    )
    placed = place_on_learned_table(shot, read_profile_text(path))
    contact = next(t for kind, t in zip(*_events_of(placed), strict=True) if kind == "cushion")
    assert contact > next(
        t for kind, t in zip(*_events_of(replace(placed, nose_offsets=None)), strict=True) if kind == "cushion"
    )
    np.testing.assert_array_equal(placed.correction, make_lesson().table.correction)
    slight = replace(placed, correction=0.02 * np.ones(WEIGHT_COUNT))  # one that no rule of energy leaves out
    ends = [
        one.simulate().states_at(np.array([1.0]))[0, 0, 2]
        for one in (slight, replace(slight, correction=NO_CORRECTION))
    ]
    assert ends[0] != ends[1]
    small = replace(shot, table=replace(shot.table, length=2.54, width=1.27))
    with pytest.raises(OptionError, match=r"2\.84 x 1\.42"):
        place_on_learned_table(small, read_profile_text(path))


def _events_of(shot: ShotSetup) -> tuple[tuple[str, ...], list[float]]:
    events = shot.simulate().list_events(1000.0)
    return events.kind, events.t.tolist()
