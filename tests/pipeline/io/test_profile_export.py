"""Files of the improved simulator: a profile of the table, and the parameters of pooltool."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.diagnosis_reports import TABLE, make_report, make_strength

from pipeline.io.gap_files import write_profile_files


def test_side_spin_decays_in_pooltool_as_fitted(tmp_path: Path) -> None:
    write_profile_files(
        make_report(make_strength("spin_decay.rate", 9.0, 0.5, "rad/s2"), make_strength("sliding_friction.mu", 0.21)),
        TABLE,
        tmp_path,
    )
    document = json.loads((tmp_path / "pooltool.json").read_text())
    ball = document["ball_params"]
    u_sp = ball["u_sp_proportionality"] * ball["R"]
    assert 5 * u_sp * ball["g"] / (2 * ball["R"]) == pytest.approx(9.0)
    assert ball["u_s"] == 0.21
    assert document["sigma"]["u_sp_proportionality"] / ball["u_sp_proportionality"] == pytest.approx(0.5 / 9.0)


def test_what_was_not_fitted_is_absent_in_pooltool_not_usual_and_not_refused(tmp_path: Path) -> None:
    """pooltool takes no friction that is not positive."""
    write_profile_files(
        make_report(make_strength("rolling_resistance.mu", 0.01), make_strength("sliding_friction.mu", 0.0)),
        TABLE,
        tmp_path,
    )
    ball = json.loads((tmp_path / "pooltool.json").read_text())["ball_params"]
    assert (ball["e_b"], ball["e_c"]) == (1.0, 1.0)
    assert all(0 < ball[name] < 1e-5 for name in ("u_s", "u_b", "f_c", "u_sp_proportionality"))


def test_balls_throw_each_other_in_pooltool_as_here(tmp_path: Path) -> None:
    """Its impulse of friction between balls that slip is u_b e_b v per mass, ours mu (1 + e) v / 2."""
    write_profile_files(
        make_report(make_strength("ball_friction.mu", 0.06, 0.006), make_strength("ball_restitution.e", 0.9)),
        TABLE,
        tmp_path,
    )
    document = json.loads((tmp_path / "pooltool.json").read_text())
    ball = document["ball_params"]
    assert ball["u_b"] * ball["e_b"] == pytest.approx(0.06 * (1 + 0.9) / 2)
    assert document["sigma"]["u_b"] / ball["u_b"] == pytest.approx(0.1)
    assert (document["ball_ball"], document["ball_ball_friction"]) == ("frictional_inelastic", "average")


def test_a_mirror_is_held_by_pooltool_as_long_as_it_has_no_friction(tmp_path: Path) -> None:
    write_profile_files(make_report(make_strength("cushion_restitution.e", 0.8)), TABLE, tmp_path)
    document = json.loads((tmp_path / "pooltool.json").read_text())
    assert (document["ball_cushion"], document["ball_cushion_options"]) == ("unrealistic", {"restitution": True})
    assert document["not_held"] == []
    write_profile_files(
        make_report(make_strength("cushion_restitution.e", 0.8), make_strength("cushion_friction.mu", 0.2)),
        TABLE,
        tmp_path,
    )
    assert json.loads((tmp_path / "pooltool.json").read_text())["not_held"] == ["cushion_friction of a mirror"]


def test_what_pooltool_cannot_hold_is_named(tmp_path: Path) -> None:
    report = make_report(
        make_strength("slope.slope_x", 1.5, 0.1, "mm/m"),
        make_strength("ball_restitution.e", 0.94),
        forms=("mathavan_2010", "alciatore"),
    )
    write_profile_files(report, TABLE, tmp_path)
    document = json.loads((tmp_path / "pooltool.json").read_text())
    assert document["not_held"] == ["slope"]
    assert document["ball_cushion"] == "mathavan_2010"
    assert (document["ball_ball"], document["ball_ball_friction"]) == ("frictional_inelastic", "alciatore")


def test_the_height_of_a_nose_is_a_measure_of_pooltools_table(tmp_path: Path) -> None:
    height = make_strength("cushion_height.ratio", 1.4, 0.02)
    write_profile_files(make_report(height, forms=("han_2005", "inelastic")), TABLE, tmp_path)
    document = json.loads((tmp_path / "pooltool.json").read_text())
    assert document["table_specs"]["cushion_height"] == pytest.approx(1.4 * TABLE.ball_radius)
    assert document["not_held"] == []
    write_profile_files(make_report(height), TABLE, tmp_path)
    assert json.loads((tmp_path / "pooltool.json").read_text())["not_held"] == ["cushion_height"]


def test_the_profile_has_effects_with_sigmas_and_contact_models(tmp_path: Path) -> None:
    write_profile_files(
        make_report(
            make_strength("slope.slope_x", 1.5, 0.1, "mm/m"), make_strength("slope.slope_y", 0.0, float("inf"), "mm/m")
        ),
        TABLE,
        tmp_path,
    )
    document = json.loads((tmp_path / "profile.json").read_text())
    assert document["effects"]["slope"]["slope_x"] == {"value": 1.5, "sigma": 0.1, "unit": "mm/m"}
    assert document["effects"]["slope"]["slope_y"]["sigma"] is None
    assert document["laws"] == {"cushion": "mirror", "ball": "inelastic"}
    assert document["table"] == {"length": TABLE.length, "width": TABLE.width}


def test_nothing_fitted_writes_nothing(tmp_path: Path) -> None:
    write_profile_files(make_report(), TABLE, tmp_path)
    assert list(tmp_path.iterdir()) == []
