"""The files of the cure: a profile of the table, and pooltool's parameters."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from diagnosis.fitting.gap_closure import Closing
from diagnosis.verdicts.verdict import Gap, Report, Strength
from models.physics.billiards.tables import PRESETS
from pipeline.io.profile_export import write_cure

TABLE = PRESETS["pool-9ft"]


def told(*fitted: Strength, forms: tuple[str, str] = ("mirror", "inelastic")) -> Report:
    nothing = Closing(0.0, 0.0, 0.0, float("nan"), (-1.0, 1.0), False)
    return Report(
        "billiards", ("sliding_friction",), "effects", ("slope",), (), (), "",
        Gap("rms_m", 0.85, (), nothing, (), (), ()),
        (), fitted, forms, (), (), "", 1.0, (),
    )  # fmt: skip


def of(name: str, value: float, sigma: float = 0.1, unit: str = "1") -> Strength:
    return Strength(name, unit, value, sigma, 0.0)


def test_side_spin_decays_in_pooltool_as_it_was_found(tmp_path: Path) -> None:
    write_cure(told(of("spin_decay.rate", 9.0, 0.5, "rad/s2"), of("sliding_friction.mu", 0.21)), TABLE, tmp_path)
    found = json.loads((tmp_path / "pooltool.json").read_text())
    ball = found["ball_params"]
    u_sp = ball["u_sp_proportionality"] * ball["R"]
    assert 5 * u_sp * ball["g"] / (2 * ball["R"]) == pytest.approx(9.0)
    assert ball["u_s"] == 0.21
    assert found["sigma"]["u_sp_proportionality"] / ball["u_sp_proportionality"] == pytest.approx(0.5 / 9.0)


def test_what_was_not_fitted_is_absent_in_pooltool_not_usual_and_not_refused(tmp_path: Path) -> None:
    """pooltool takes no friction that is not positive."""
    write_cure(told(of("rolling_resistance.mu", 0.01), of("sliding_friction.mu", 0.0)), TABLE, tmp_path)
    ball = json.loads((tmp_path / "pooltool.json").read_text())["ball_params"]
    assert (ball["e_b"], ball["e_c"]) == (1.0, 1.0)
    assert all(0 < ball[name] < 1e-5 for name in ("u_s", "u_b", "f_c", "u_sp_proportionality"))


def test_balls_throw_each_other_in_pooltool_as_here(tmp_path: Path) -> None:
    """Its impulse of friction between balls that slip is u_b e_b v per mass, ours mu (1 + e) v / 2."""
    write_cure(told(of("ball_friction.mu", 0.06, 0.006), of("ball_restitution.e", 0.9)), TABLE, tmp_path)
    found = json.loads((tmp_path / "pooltool.json").read_text())
    ball = found["ball_params"]
    assert ball["u_b"] * ball["e_b"] == pytest.approx(0.06 * (1 + 0.9) / 2)
    assert found["sigma"]["u_b"] / ball["u_b"] == pytest.approx(0.1)
    assert (found["ball_ball"], found["ball_ball_friction"]) == ("frictional_inelastic", "average")


def test_a_mirror_is_held_by_pooltool_as_long_as_it_has_no_friction(tmp_path: Path) -> None:
    write_cure(told(of("cushion_restitution.e", 0.8)), TABLE, tmp_path)
    found = json.loads((tmp_path / "pooltool.json").read_text())
    assert (found["ball_cushion"], found["ball_cushion_options"]) == ("unrealistic", {"restitution": True})
    assert found["not_held"] == []
    write_cure(told(of("cushion_restitution.e", 0.8), of("cushion_friction.mu", 0.2)), TABLE, tmp_path)
    assert json.loads((tmp_path / "pooltool.json").read_text())["not_held"] == ["cushion_friction of a mirror"]


def test_what_pooltool_cannot_hold_is_named(tmp_path: Path) -> None:
    report = told(
        of("slope.slope_x", 1.5, 0.1, "mm/m"), of("ball_restitution.e", 0.94), forms=("mathavan_2010", "alciatore")
    )
    write_cure(report, TABLE, tmp_path)
    found = json.loads((tmp_path / "pooltool.json").read_text())
    assert found["not_held"] == ["slope"]
    assert found["ball_cushion"] == "mathavan_2010"
    assert (found["ball_ball"], found["ball_ball_friction"]) == ("frictional_inelastic", "alciatore")


def test_the_profile_holds_effects_with_sigmas_and_laws(tmp_path: Path) -> None:
    write_cure(
        told(of("slope.slope_x", 1.5, 0.1, "mm/m"), of("slope.slope_y", 0.0, float("inf"), "mm/m")), TABLE, tmp_path
    )
    found = json.loads((tmp_path / "profile.json").read_text())
    assert found["effects"]["slope"]["slope_x"] == {"value": 1.5, "sigma": 0.1, "unit": "mm/m"}
    assert found["effects"]["slope"]["slope_y"]["sigma"] is None
    assert found["laws"] == {"cushion": "mirror", "ball": "inelastic"}
    assert found["table"] == {"length": TABLE.length, "width": TABLE.width}


def test_nothing_fitted_writes_nothing(tmp_path: Path) -> None:
    write_cure(told(), TABLE, tmp_path)
    assert list(tmp_path.iterdir()) == []
