"""Sentences, figures and page of a diagnosis agree with its numbers."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.diagnosis_reports import NOTHING_UNEXPLAINED
from support.page_words import read_page
from support.reference_frames import PLANE, ROD

from diagnosis.fitting.gap_closure import GapClosure
from diagnosis.fitting.prediction_windows import PredictionWindow
from diagnosis.unexplained.force_law import ForceLaw
from diagnosis.unexplained.local_patch import LocalPatch
from diagnosis.verdicts.verdict import (
    CandidateEffect,
    DiagnosisReport,
    EffectShare,
    Gap,
    GapLocation,
    ShotUse,
    Strength,
    Unexplained,
)
from models.core.recording import Recording
from models.core.scene import Table
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.io.simulators.function_simulator import FunctionSimulator
from pipeline.io.simulators.mechanism_recordings import MechanismShots
from pipeline.reporting.pages.gap_page import build_gap_figures, build_law_figure, write_gap_page
from pipeline.reporting.text.gap_sentences import (
    format_agreement,
    format_assumed_effects,
    format_gap_closure,
    format_share,
    format_shot_folders,
    format_shot_use,
    format_strength,
    format_strength_note,
    format_undecided,
    format_unexplained,
    format_verdict,
    list_causes,
)

NOTHING = GapClosure(0.02, 0.02, 0.01, float("nan"), (-1.0, 1.0), False)


def report(verdict: str, *where: GapLocation) -> DiagnosisReport:
    unknown = CandidateEffect("unknown", 1.0, ("unknown",), ())
    return DiagnosisReport(
        "billiards", (), verdict, (), (unknown,), where,  # type: ignore[arg-type]
        Gap("rms_m", 0.85, (), NOTHING, (), (), ()), (), NOTHING_UNEXPLAINED, (),
        ("mirror", "inelastic"), (), (), "", 1e-9, (),
    )  # fmt: skip


def at(phase: str, share: float, grows: str | None = None) -> GapLocation:
    return GapLocation(phase, share, None, None, None, None, grows)


def test_an_unknown_effect_is_described_by_where_it_appears_not_in_sigmas() -> None:
    sentence = format_verdict(report("unknown", at("cushion_contact", 0.86), at("rest", 0.14)))
    assert "86 % of the gap" in sentence
    assert "at cushions" in sentence
    assert "sigma" not in sentence
    assert "growing with time" in format_verdict(report("unknown", at("free_roll", 1.0, "time")))
    assert format_verdict(report("unknown")).endswith("trueroll does not know.")


def test_the_page_lists_what_each_of_several_effects_closes(tmp_path: Path) -> None:
    shares = (EffectShare("air_drag", -0.02, (-0.04, 0.35), 0.1), EffectShare("cushion_law", 0.96, (0.66, 0.98), 0.9))
    diagnosis = replace(report("effects"), effects=("air_drag", "cushion_law"), per_effect=shares)
    write_gap_page(diagnosis, "carom", tmp_path / "gap.html")
    page = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "How much of the gap each effect closes" in page
    assert (
        '>96.0 %</td><td data-label="95 % interval">66 % to 98.0 %</td><td data-label="closes alone">90 %</td>' in page
    )
    write_gap_page(replace(diagnosis, per_effect=()), "carom", tmp_path / "gap.html")
    assert "each effect closes" not in (tmp_path / "gap.html").read_text(encoding="utf-8")


def straight(number: int = 0, start_rows: int = 8) -> PredictionWindow:
    """A body that is followed for half a metre across and up."""
    t = np.arange(20) / 30
    places = np.stack([t, t], axis=-1)[:, None]
    return PredictionWindow(
        Recording(number, np.arange(20), t, ("a",), places, np.full((20, 1), 1e-3), PLANE), start_rows
    )


def gap_of(window: PredictionWindow, before: float, after: float) -> Gap:
    """Predictions that are off sideways by so many m at the end."""
    way = np.linspace(0, 1, len(window.segment.t))[:, None, None] * np.array([1.0, 0.0])
    paths = [window.segment.positions + off * way for off in (before, after)]
    shot = window.segment.shot
    return Gap("rms_m", 0.4, (shot,), NOTHING, (window,), (paths[0],), (paths[1],), coordinates=("x", "y"))


def test_predictions_after_are_drawn_only_where_something_was_added() -> None:
    assert not any("before and after" in title for title, _ in build_gap_figures(gap_of(straight(), 0.01, 0.01)))
    assert any("before and after" in title for title, _ in build_gap_figures(gap_of(straight(), 0.01, 0.001)))


def test_a_simulator_that_lacks_nothing_has_no_after(tmp_path: Path) -> None:
    diagnosis = replace(report("none"), gap=gap_of(straight(), 0.01, 0.0099))
    write_gap_page(diagnosis, "carom", tmp_path / "gap.html")
    assert "before and after" not in (tmp_path / "gap.html").read_text(encoding="utf-8")


def test_errors_are_drawn_only_where_something_could_be_predicted() -> None:
    for start_rows, drawn in ((8, 3), (20, 1)):
        assert len(build_gap_figures(gap_of(straight(start_rows=start_rows), 0.3, 0.3))) == drawn


@pytest.mark.parametrize("table", [None, TABLE_PRESETS["pool-9ft"]])
def test_millimetres_are_enlarged_until_before_and_after_part(table: Table | None) -> None:
    gap = gap_of(straight(7), 0.006, 0.0004)
    (whole, plan), (part, close), *_ = build_gap_figures(gap, table)
    assert "hold-out shot 7" in whole
    assert "enlarged: 0.036 m" in part
    left, right = close.layout.xaxis.range
    ends = {one.name: float(one.x[-1]) for one in close.data}
    assert "error before, 6 mm at 0.63 s" in ends
    assert left < ends["observed"] < right
    assert (ends["predicted before"] - ends["observed"]) / (right - left) > 0.1
    assert (ends["predicted after"] - ends["observed"]) / (right - left) < 0.02
    frame = plan.layout.shapes[-1]
    assert (frame.x0, frame.x1) == (left, right)
    assert sorted(close.layout.yaxis.range) == [frame.y0, frame.y1]
    assert close.layout.yaxis.scaleanchor == plan.layout.yaxis.scaleanchor, (
        "the enlarged part has the scales of the plan"
    )
    assert (close.layout.yaxis.range[0] > close.layout.yaxis.range[1]) == (table is not None), "as the plan has it"


def test_shots_are_named_by_their_folders_also_in_titles(tmp_path: Path) -> None:
    diagnosis = replace(report("unknown", replace(at("rest", 1.0), shot=7)), gap=gap_of(straight(7), 0.006, 0.0004))
    write_gap_page(diagnosis, "carom_F1 and 7 more", tmp_path / "gap.html", origins={0: "carom_F1", 7: "carom_F8"})
    page = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "on hold-out shot 7 (carom_F8)" in page
    assert ">shot 7 (carom_F8)</td>" in page
    assert "Shot numbers: 0 is carom_F1; 7 is carom_F8." in page
    assert format_shot_folders({}) == ""


def test_another_contact_model_is_named() -> None:
    diagnosis = replace(report("effects"), effects=("slope", "cushion_law"), forms=("han_2005", "inelastic"))
    assert format_verdict(diagnosis) == "Your simulator lacks slope and the right law of cushions (Han 2005 fits best)."


def test_parameters_that_the_contact_models_do_not_use_are_not_listed(tmp_path: Path) -> None:
    unused = Strength("cushion_cloth.factor", "1", 1.0, 0.1, float("inf"), prior_only=True)
    untouched = Strength("ball_restitution.e", "1", 0.95, 0.1, float("inf"), prior_only=True)
    diagnosis = replace(report("none"), model=("ball_restitution",), fitted=(unused, untouched))
    write_gap_page(diagnosis, "carom", tmp_path / "gap.html")
    page = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "friction of the cloth under the nose" not in page
    assert "ball restitution, e" in page


def test_what_shows_by_itself_is_not_enlarged() -> None:
    assert not any("enlarged" in title for title, _ in build_gap_figures(gap_of(straight(), 0.3, 0.01)))


def test_a_single_coordinate_is_enlarged_along_time_as_well() -> None:
    t = np.arange(20) / 30
    places = np.sin(t)[:, None, None]
    window = PredictionWindow(Recording(0, np.arange(20), t, ("rod",), places, np.full((20, 1), 1e-3), ROD), 8)
    off = places + 0.004 * t[:, None, None]
    gap = Gap("rms_rad", 0.4, (0,), NOTHING, (window,), (off,), (places,), coordinates=("theta1",))
    _, (title, close), *_ = build_gap_figures(gap)
    assert "rad" in title
    assert close.layout.xaxis.range[0] < t[-1] < close.layout.xaxis.range[1]


def test_the_legend_has_a_sample_of_every_line() -> None:
    _, figure = build_gap_figures(gap_of(straight(), 0.006, 0.0004))[0]
    shown = {one.name: one for one in figure.data if one.showlegend is not False}
    assert {"observed", "predicted before", "predicted after"} < set(shown)
    assert shown["observed"].mode == "markers"
    assert shown["predicted before"].line.dash == "dash", "distinguishable from the other without colours"
    assert shown["predicted before"].line.color != shown["predicted after"].line.color


def test_what_is_only_the_prior_is_no_finding(tmp_path: Path) -> None:
    rate = Strength("spin_decay.rate", "rad/s2", 10.0, 15.0, 47.0, prior_only=True)
    friction = Strength("sliding_friction.mu", "1", 0.2, 0.01, 0.03)
    assert format_strength(replace(rate, name="rate")) == (
        "rate: not identifiable from these shots, which would reveal 47 rad/s² or more"
    )
    assert "10" not in format_strength(replace(rate, detectable_from=float("inf")))
    gain = CandidateEffect("actuator_gain", 0.9, ("actuator_gain",), (replace(rate, name="gain.m1"),))
    (cause,) = list_causes(replace(report("none"), scene="mechanism", effects=(), candidates=(gain,)))
    assert "not identifiable from these runs" in cause.strength, "as the page calls them"
    write_gap_page(replace(report("none"), fitted=(rate, friction)), "carom", tmp_path / "gap.html")
    page = (tmp_path / "gap.html").read_text(encoding="utf-8")
    row = page[page.index("decay of side spin, rate") :].partition("</tr>")[0]
    assert "would reveal 47 rad/s² or more" in row
    assert "15" not in row
    assert '>0.200</td><td data-label="±">0.010</td>' in page


def test_effects_that_no_shot_identifies_are_separated_from_those_that_these_shots_miss() -> None:
    shutter = CandidateEffect("rolling_shutter", 0.0, ("rolling_shutter",), ())
    diagnosis = replace(
        report("effects"),
        candidates=(shutter,), unidentifiable=("frame_rate", "rolling_shutter"), not_tested=("lens_distortion",),
    )  # fmt: skip
    assert format_undecided(diagnosis) == (
        "Not identifiable from any shot: frame rate. Not detectable in these shots at usual strength: rolling shutter."
        " Not tested: lens distortion."
    )
    friction = CandidateEffect("joint_friction", 0.0, ("joint_friction",), ())
    diagnosis = replace(
        diagnosis, candidates=(friction,), unidentifiable=("joint_friction.viscous_motor",), not_tested=()
    )
    assert format_undecided(diagnosis) == (
        "Not detectable in these shots at usual strength: joint friction, viscous motor."
    )


def test_the_page_names_the_profile_and_the_option_that_uses_it(tmp_path: Path) -> None:
    diagnosis = replace(report("effects"), fitted=(Strength("slope.slope_x", "mm/m", 1.0, 0.1, 0.3),))
    path = tmp_path / "gap.html"
    write_gap_page(diagnosis, "carom", path, TABLE_PRESETS["pool-9ft"])
    page = path.read_text(encoding="utf-8")
    assert "To close the gap, use" in page
    assert f"trueroll run CLIP --profile {tmp_path / 'profile.json'}" in page
    write_gap_page(diagnosis, "cube", path)  # of no table
    assert "--profile" not in path.read_text(encoding="utf-8")


def test_the_page_has_no_words_of_programmers(tmp_path: Path) -> None:
    alike = CandidateEffect(
        "cushion_law", 0.5, ("cushion_law", "cushion_friction"), (Strength("slope_x", "mm/m", 1, 0.1, 0.3),)
    )
    diagnosis = replace(
        report("group", at("free_roll", 0.6, "time since contact"), at("cushion_contact", 0.4)),
        model=("rolling_resistance",), candidates=(alike,), unidentifiable=("parallax_shift",),
        not_tested=("lens_distortion",), fitted=(Strength("slope.slope_x", "mm/m", 1.0, 0.1, 0.3),),
        per_effect=tuple(EffectShare(name, 0.5, (0.4, 0.6), 0.5) for name in ("air_drag", "cushion_restitution_speed")),
        gap=gap_of(straight(), 0.006, 0.0004),
    )  # fmt: skip
    write_gap_page(diagnosis, "carom", tmp_path / "gap.html")
    read = read_page(tmp_path / "gap.html")
    assert "the time since the last contact" in read
    assert re.findall(r"\S*\w_\w\S*", read) == []


@pytest.mark.parametrize("scene", ["slide", "flight", "pendulum"])
def test_other_scenes_have_bodies_and_walls(tmp_path: Path, scene: str) -> None:
    place = replace(at("wall_contact", 1.0), ball="7")
    lost = replace(NOTHING, before=float("nan"), after=float("nan"), floor=float("nan"))
    diagnosis = replace(
        report("unknown", place), scene=scene, forms=(), gap=replace(gap_of(straight(), 0.3, 0.3), closure=lost),
        unexplained=replace(NOTHING_UNEXPLAINED, where=(place, at("slide", 0.0))),
    )  # fmt: skip
    write_gap_page(diagnosis, scene, tmp_path / "gap.html")
    words = read_page(tmp_path / "gap.html").replace("\N{NO-BREAK SPACE}", " ")
    assert "100 % of the gap appears at walls." in words
    assert "body 7" in words
    assert "or nothing moves" in words
    assert not re.search(r"\b(cushion|ball|table)s?\b", words)


def test_effects_that_are_missing_together_are_one_cause_of_their_whole_probability() -> None:
    drag, lift = (Strength(name, "1", 0.2, 0.01, 0.05) for name in ("k", "s"))
    alike = (
        CandidateEffect("air_drag", 0.46, ("air_drag",), (drag,)),
        CandidateEffect("magnus", 0.44, ("magnus",), (lift,)),
    )
    diagnosis = replace(report("effects"), effects=("air_drag", "magnus"))
    diagnosis = replace(diagnosis, candidates=(*alike, CandidateEffect("unknown", 0.1, ("unknown",), ())))
    together, unknown = list_causes(diagnosis)
    assert (together.name, unknown.name) == (
        "air drag and lift by spin",
        "a cause that trueroll does not know",
    )
    assert together.probability == pytest.approx(0.9)
    assert together.strength == "air drag k = 0.200 ± 0.010; lift by spin s = 0.200 ± 0.010"
    apart = list_causes(replace(diagnosis, effects=("air_drag",)))
    assert [one.name for one in apart] == ["air drag", "lift by spin", "a cause that trueroll does not know"]
    assert [one.probability for one in apart] == [0.46, 0.44, 0.1]


def test_what_comes_nearest_is_not_called_added_and_noise_is_no_larger_than_the_error() -> None:
    gap = gap_of(straight(), 0.3, 0.1)
    nearest = GapClosure(0.067, 0.05, 0.006, 0.45, (0.3, 0.6), True)
    diagnosis = replace(report("unknown"), gap=replace(gap, closure=nearest))
    assert "The most similar effect reduces the rms error over the first 0.40 s" in format_gap_closure(diagnosis)
    worse = replace(diagnosis, gap=replace(gap, closure=replace(nearest, after=0.068)))
    assert "no effect that trueroll knows reduces it" in format_gap_closure(worse)
    noise = replace(nearest, before=0.00162, after=0.00162, floor=0.00173, resolved=False)
    assert format_gap_closure(replace(report("none"), gap=replace(gap, closure=noise))).endswith(
        "1.62 mm, which is noise."
    )
    own = replace(report("none"), gap=replace(gap, closure=noise, as_stated=0.02))
    assert "the simulator, its coefficients fitted to the recordings, over the first" in format_gap_closure(own)
    assert format_verdict(own) == format_verdict(report("none")), "another effect may be missing"
    own = replace(own, fitted=(Strength("joint_friction.viscous", "N m", 0.31, 0.02, 0.1, stated=0.6),))
    assert format_verdict(own) == (
        "Coefficients of your simulator are wrong: with them, its rms error is 20 mm, and 1.62 mm with those that fit"
        " the recordings. Beyond that, these shots show no effect that your simulator lacks."
    )
    dry = replace(own, fitted=(Strength("joint_friction.dry", "N m", 0.02, 1e-4, 1e-4, stated=0.0),))
    assert "are wrong (joint friction, dry: it has none): with them" in format_verdict(dry)
    hidden_by_its_start = replace(own, gap=replace(own.gap, as_stated=1.15 * noise.before))
    assert format_verdict(hidden_by_its_start) == format_verdict(report("none"))
    small = replace(nearest, before=0.846, after=0.592, floor=0.592, closed=float("nan"), resolved=False)
    for verdict in ("effects", "unknown"):
        unseen = replace(report(verdict), gap=replace(gap, closure=replace(small, after=0.6)))
        assert "592 mm is noise; so few hold-out shots do not show a gap beyond it." in format_gap_closure(unseen)


REST = Unexplained(0.004, 0.0022, 4.5, (at("swing", 1.0, "speed"),), "", None, None)


def named(rest: Unexplained, closed: float = 0.996) -> DiagnosisReport:
    """Make a report that names joint friction, whose errors are angles."""
    closure = GapClosure(0.0334, 0.0023, 0.0005, closed, (0.99, 1.0), True)
    shares = (EffectShare("joint_friction", closed, (0.99, 1.0), closed),)
    friction = CandidateEffect("joint_friction", 0.98, ("joint_friction",), ())
    return replace(
        report("effects"), scene="pendulum", effects=("joint_friction",), candidates=(friction,), per_effect=shares,
        gap=Gap("rms_rad", 0.85, (), closure, (), (), ()), unexplained=rest,
    )  # fmt: skip


def test_the_first_sentence_states_a_rest_of_many_times_the_noise() -> None:
    sentence = format_verdict(named(REST))
    assert sentence.startswith("Your simulator lacks joint friction, which closes 99.6 % of the gap")
    assert "the error that remains, 2.3 mrad, is 4.5 times the attainable one" in sentence
    assert "2.3 times the attainable one" in format_verdict(named(replace(REST, times_floor=2.3)))
    assert format_verdict(named(replace(REST, times_floor=1.2))) == "Your simulator lacks joint friction."


def test_what_remains_is_stated_with_its_size_its_place_and_its_law() -> None:
    law = ForceLaw("along", "speed", np.ones(3), np.ones(3), np.ones(3), np.ones((2, 3)), "a = -0.3 u^1.50", 0.61)
    patch = LocalPatch(np.array([1.2, 0.4]), np.array([0.02, 0.03]), 0.15, 0.01, -0.12, 0.02, 0.0025)
    first, second, third = format_unexplained(named(replace(REST, law=law, patch=patch)))
    assert first.startswith(
        "0.4 % of the gap (in squared errors) remains: the rms error goes from 33.4 mrad to 2.3 mrad"
    )
    assert "where 0.5 mrad is attainable" in first
    assert "grows with speed" in first
    assert "a = -0.3 u^1.50" in second
    assert "61 % of the unexplained acceleration" in second
    assert third.startswith("A patch: within 150 ± 10 mm of (1.20, 0.40) m, bodies are slowed by 0.120 ± 0.020 m/s²")
    assert format_unexplained(named(replace(REST, where=()))) == ()


def test_an_unknown_effect_is_compared_with_the_best_of_the_library() -> None:
    diagnosis = replace(report("unknown"), per_effect=(EffectShare("air_drag", 0.31, (0.2, 0.4), 0.31),))
    assert "the best that it knows, air drag, would close 31 % of it" in format_verdict(diagnosis)
    patch = LocalPatch(np.array([1.2, 0.4]), np.array([0.02, 0.03]), 0.15, 0.01, -0.12, 0.02, 0.0025)
    placed = format_verdict(replace(diagnosis, unexplained=replace(REST, patch=patch)))
    assert "does not know: within 150 ± 10 mm of (1.20, 0.40) m, bodies are slowed" in placed


def test_effects_that_make_predictions_worse_leave_the_whole_gap() -> None:
    first, *_ = format_unexplained(named(replace(REST, share=1.14)))
    assert first.startswith("All of the gap (in squared errors) remains")
    assert format_share(-61.09) == "below -100 %"
    assert format_share(2e-4) == "less than 0.05 %", "what remains is not nothing"


LAW = ForceLaw(
    "along", "speed", np.arange(1.0, 6.0), np.arange(5.0), np.ones(5), np.ones((2, 3)), "a = 1 u - 1", 0.26
)  # fmt: skip


def test_a_law_of_less_than_half_is_described_in_words_and_has_no_curve() -> None:
    sentence = format_unexplained(named(replace(REST, law=LAW)))[1]
    assert "rises with speed" in sentence
    assert "explains 26 % of the unexplained acceleration" in sentence
    assert "a = 1" not in sentence
    falling, wavy = replace(LAW, acceleration=-LAW.at), replace(LAW, acceleration=np.array([0.0, 5.0, 1.0, 4.0, 2.0]))
    assert "falls with speed" in format_unexplained(named(replace(REST, law=falling)))[1]
    assert "without a steady trend" in format_unexplained(named(replace(REST, law=wavy)))[1]
    assert len(build_law_figure(LAW, "m").data) == 1
    assert len(build_law_figure(replace(LAW, explained=0.6), "m").data) == 2


def test_errors_are_of_all_predictions_up_to_a_time() -> None:
    diagnosis = named(REST)
    gap = replace(diagnosis.gap, windows=(straight(),))
    assert format_gap_closure(replace(diagnosis, gap=gap)).startswith(
        "Adding it reduces the rms error over the first 0.85 s of predicting hold-out shots from 33.4 mrad to 2.3 mrad"
    )


def agreed(p: float, limit: float) -> str:
    """Return what the page states of shots that agree with this p-value, which is at least the limit."""
    (friction,) = named(REST).candidates
    one = replace(friction, sign_flip_p_value=p, sign_flip_limit=limit)
    return format_agreement(replace(named(REST), candidates=(one,)))[0]


def test_few_shots_limit_how_well_they_can_agree() -> None:
    few = agreed(0.0625, 2.0**-4)
    assert "in 6 % of cases; with 5 shots this share cannot be below 6 %" in few
    assert "would not exclude chance" in few
    many = agreed(2.0**-12, 2.0**-12)
    assert "in less than 0.1 % of cases." in many
    assert "exclude" not in many
    assert "cannot be below" not in agreed(0.6, 2.0**-4)


def test_an_effect_that_may_add_nothing_is_named_last_with_its_share() -> None:
    shares = (
        EffectShare("slope", 0.6, (0.5, 0.65), 0.6),
        EffectShare("viscous_drag", 0.007, (-0.02, 0.09), 0.0, is_measured=False),
    )
    diagnosis = replace(report("effects"), effects=("slope", "viscous_drag"), per_effect=shares)
    assert format_verdict(diagnosis) == ("Your simulator lacks slope and, with a small share (0.7 %), viscous drag.")
    large = (shares[0], replace(shares[1], closed=0.07))
    assert "with an uncertain share (7 %), viscous drag" in format_verdict(replace(diagnosis, per_effect=large))
    hidden = (shares[0], replace(shares[1], is_measured=True))
    assert format_verdict(replace(diagnosis, per_effect=hidden)) == "Your simulator lacks slope and viscous drag."
    unsure = (replace(shares[1], effect="slope"), shares[1])
    assert format_verdict(replace(diagnosis, per_effect=unsure)) == "Your simulator lacks slope and viscous drag."


def test_the_page_states_shots_and_noise() -> None:
    diagnosis = replace(named(REST), shot_use=ShotUse((0, 2, 4), (1,), (3,), 0.0009))
    assert format_shot_use(diagnosis) == (
        "5 shots: 3 to fit, 1 to confirm effects, 1 held out to measure the gap; each coordinate is measured"
        " to 0.9 mrad, errors that last over several frames included."
    )
    assert format_shot_use(replace(diagnosis, shot_use=ShotUse((0,)))) == "1 shot: 1 to fit."
    assert format_shot_use(named(REST)) == ""


def test_strengths_of_effects_that_are_not_named_are_explained() -> None:
    drag = CandidateEffect("air_drag", 0.0, ("air_drag",), (), fitted_beside=("joint_friction",))
    tilt = CandidateEffect("gravity_tilt", 0.0, ("gravity_tilt",), (), fitted_beside=())
    diagnosis = named(REST)

    def note(*others: CandidateEffect) -> str:
        return format_strength_note(replace(diagnosis, candidates=(*diagnosis.candidates, *others)))

    assert "was fitted beside the named ones. That strength may differ from 0" in note(drag)
    assert "was fitted in place of the named ones" in note(tilt)
    assert "(tilt of the camera against the plumb line: in place of them)" in note(drag, tilt)
    assert note() == ""
    assert "alone, added to your simulator" in format_strength_note(replace(report("none"), candidates=(tilt,)))


def test_the_film_that_is_asked_for_has_a_heading(tmp_path: Path) -> None:
    for film, shown in (("Film shot 3 again.", True), ("", False)):
        write_gap_page(replace(named(REST), film_next=film), "swing", tmp_path / "gap.html")
        assert ("What to record next" in read_page(tmp_path / "gap.html")) == shown


def test_empty_columns_are_left_out(tmp_path: Path) -> None:
    rest = replace(REST, where=())
    write_gap_page(replace(named(rest), where=(at("swing", 1.0),)), "swing", tmp_path / "gap.html")
    words = read_page(tmp_path / "gap.html")
    assert not any(heading in words for heading in ("mostly", "grows with", "indistinguishable from"))
    alike = replace(named(rest).candidates[0], group=("joint_friction", "air_drag"))
    both = replace(named(rest), candidates=(alike,), where=(at("swing", 1.0, "time"),))
    write_gap_page(both, "swing", tmp_path / "gap.html")
    words = read_page(tmp_path / "gap.html")
    assert all(heading in words for heading in ("grows with", "indistinguishable from"))


def test_what_a_simulator_contains_is_never_nothing_in_flight() -> None:
    thrown = replace(report("none"), scene="flight")
    assert format_assumed_effects(thrown) == "gravity alone"
    assert format_assumed_effects(replace(thrown, model=("air_drag",))) == "gravity, air drag"
    assert format_assumed_effects(report("none")) == "none"


def test_effects_of_one_reason_are_listed_together() -> None:
    diagnosis = replace(
        report("effects"), unidentifiable=(),
        not_tested=("perspective", "wall_restitution: no walls are stated", "wall_friction: no walls are stated"),
    )  # fmt: skip
    assert format_undecided(diagnosis).endswith("wall restitution and wall friction (no walls are stated).")


def test_a_path_that_is_a_stroke_has_its_own_scales() -> None:
    window = straight()
    thin = replace(window, segment=replace(window.segment, positions=window.segment.positions * np.array([0.01, 1.0])))
    (title, figure), *_ = build_gap_figures(gap_of(thin, 0.01, 0.001))
    assert "different scales" in title
    assert figure.layout.yaxis.scaleanchor is None
    assert build_gap_figures(gap_of(straight(), 0.01, 0.001))[0][1].layout.yaxis.scaleanchor == "x"


def test_maps_before_and_after_have_the_same_colours_and_large_errors_on_top() -> None:
    maps = [figure for title, figure in build_gap_figures(gap_of(straight(), 0.01, 0.001)) if "are wrong" in title]
    before, after = (figure.data[0].marker for figure in maps)
    assert before.cmax == after.cmax == max(before.color)
    assert list(before.color) == sorted(before.color)
    assert max(after.color) < 0.2 * max(before.color)
    assert maps[0].layout.xaxis.title.text == "x (m)"


def test_the_first_panel_states_what_is_wrong_in_the_file_and_the_last_notes_how_a_log_was_read(tmp_path: Path) -> None:
    shots = MechanismShots(FunctionSimulator("math", "cos", (), (), 0.01, 0.0), (), {}, ("q is elbow",), {})
    diagnosis = replace(
        report("none"),
        scene="mechanism",
        forms=(),
        notes=("your damping is 0.6, the recordings say 0.31", "q is elbow"),
    )
    write_gap_page(diagnosis, "arm", tmp_path / "gap.html", shots=shots)
    html = (tmp_path / "gap.html").read_text(encoding="utf-8")
    panel = html[html.index('class="panel large"') : html.index("What was not decided")]
    assert "Your damping is 0.6, the recordings say 0.31." in panel
    assert "q is elbow" not in panel
    assert "Notes: q is elbow." in html


def test_the_page_of_a_robots_log_speaks_of_runs_and_rows(tmp_path: Path) -> None:
    place = replace(at("motion", 1.0), shot=3)
    diagnosis = replace(
        report("unknown", place), scene="mechanism", forms=(), gap=gap_of(straight(), 0.006, 0.0004),
        notes=("my/shot.csv and shot_2.csv have frames",),
    )  # fmt: skip
    write_gap_page(diagnosis, "arm", tmp_path / "gap.html", origins={3: "my shot.csv"})
    html = (tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "<script" in html
    words = read_page(tmp_path / "gap.html")
    assert "run 3" in words
    left = re.findall(r"\S*\b(?:[Ss]hot|[Ff]rame)s?\b\S*", words)
    assert {one.strip(".)") for one in left} <= {"my/shot.csv", "shot.csv"}
    assert "my/shot.csv and shot_2.csv have rows" in words
    write_gap_page(replace(diagnosis, scene="slide"), "cube", tmp_path / "gap.html", origins={})
    assert "shot 3" in read_page(tmp_path / "gap.html")
