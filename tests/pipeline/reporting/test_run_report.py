"""The page of a run lists its events, needs no network, and escapes file names."""

from __future__ import annotations

import base64
import io
import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from support import synthetic_run as shot

from models.core import fit_result
from models.core.ball_look import BallLook, describe_unseen_balls
from models.core.fit_result import (
    MIN_LISTED_PROBABILITY,
    CauseHypothesis,
    Fit,
    Moment,
    ShotExplanation,
    ShotNumber,
    ShotNumbers,
    Trust,
    TrustLevel,
    WholeShotFit,
    WholeShotSolution,
)
from models.core.naming import Naming, build_naming
from models.core.scene import Scene
from models.core.shot import Note
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.shot_record import CandidateContact
from models.estimation.forecast.forecast_values import ForecastErrors
from models.estimation.joint_fit.trust_level import EXPLAINED
from models.estimation.shot_numbers.measure_shots import state_strike_speeds
from pipeline.io.run_views import assess_run_trust
from pipeline.reporting.figures.run_figures import (
    build_energy_figure,
    build_forecast_figure,
    build_plan_figure,
    build_speed_figure,
)
from pipeline.reporting.pages import run_report
from pipeline.reporting.pages.run_report import ReportFiles, build_event_rows, write_report
from pipeline.reporting.text.call_sentences import format_call, format_gap
from pipeline.reporting.text.text_formatting import format_event
from video.io.clip import Clip
from video.overlay import motion_paths


@pytest.fixture
def clip(tmp_path: Path) -> Clip:
    return shot.write_clip(tmp_path / "clip.mp4")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    clip = shot.write_clip(folder / "clip.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    Image.new("RGB", (32, 18)).save(folder / "poster.png")
    files = ReportFiles("clip.mp4", folder / "poster.png", 8.0)
    hostile = "<script>alert(1)</script>.mp4"
    fit = shot.make_fit(tracks.t)
    write_report(clip, scene, tracks, fit, files, hostile, ["--slow 8"], folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")


def test_the_page_loads_nothing_from_outside(page: str) -> None:
    outside = re.findall(r"<(?:script|link|img|video|source|iframe)[^>]*(?:src|href)=[\"']?(?:https?:)?//[^>]*>", page)
    assert outside == []


def test_a_file_name_cannot_run_a_script(page: str) -> None:
    assert "<script>alert(1)" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_the_page_counts_contacts_and_explains_only_the_terms_that_occur(page: str) -> None:
    assert "0 contacts of two balls, 1 of a ball and a rail, 0 balls potted." in page
    assert page.count("± is one standard deviation everywhere.") == 1
    assert "Cue tip" not in page
    assert "Doubt</th>" not in page


def test_how_much_of_a_ball_a_contact_covers_stands_beside_its_margin() -> None:
    assert format_gap(-0.0175, 0.0001) == "17.5 ± 0.1 mm from a miss"
    assert format_gap(0.0175, 0.0001) == "17.5 ± 0.1 mm from a touch"


def test_each_event_seeks_the_slow_motion_to_a_little_before_it(page: str) -> None:
    seeks = [float(s) for s in re.findall(r'data-seek="([\d.]+)"', page)]
    assert seeks == pytest.approx([0.0, (0.5 - 0.15) * 8.0])


def test_events_seek_where_a_slow_motion_without_its_still_beginning_shows_them() -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    rows = build_event_rows(fit, ReportFiles("slow.mp4", Path("poster.png"), 8.0, start=0.2))
    assert [row["seek"] for row in rows] == pytest.approx([0.0, (0.5 - 0.15 - 0.2) * 8.0])


def test_the_page_lists_events_with_time_and_trust_level(page: str) -> None:
    assert "White hits the right short rail, 0.50 m/s (1.8 km/h) straight into it" in page
    assert "0.5000 s ± 1.0 ms" in page
    assert "everything is made up" in page
    assert "rolling resistance, mu" in page


def test_a_touch_of_negligible_speed_is_described_without_it() -> None:
    events = shot.make_fit(np.linspace(0, 0.8, 25)).events
    slow = replace(events, speed=np.array([np.nan, 0.004]))
    assert format_event(events, 1, Naming()) == "White hits the right short rail, 0.50 m/s (1.8 km/h) straight into it"
    assert format_event(slow, 1, Naming()) == "White hits the right short rail"
    assert format_event(slow, 0, Naming()) == "White is struck"


@pytest.mark.parametrize(("creep", "lines"), [(0.0, ["white"]), (0.01, ["white"]), (0.1, ["red", "white"])])
def test_the_plan_shows_every_ball_and_the_ways_of_those_that_get_somewhere(creep: float, lines: list[str]) -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    position = fit.trajectory.position.copy()
    position[1, 1] = [0, creep]
    fit = replace(fit, trajectory=replace(fit.trajectory, position=position))
    looks = (BallLook("white"), BallLook("red"))
    drawn = build_plan_figure(shot.make_scene(), fit, looks).data[:-1]
    assert sorted(trace.name for trace in drawn if trace.mode == "markers") == ["red", "white"]
    assert sorted(trace.name for trace in drawn if trace.mode == "lines" and len(trace.x)) == lines
    assert sorted(trace.name for trace in build_speed_figure(shot.make_scene(), fit, looks).data) == lines


def test_a_ball_and_a_striped_one_of_the_same_colour_differ_in_every_chart() -> None:
    fit = shot.make_fit(np.linspace(0, 0.8, 25))
    blue = (44, 104, 232)
    looks = (BallLook("white", blue), BallLook("red", blue, is_striped=True))
    position = fit.trajectory.position.copy()
    position[1, 1] = [0, 0.1]
    fit = replace(fit, trajectory=replace(fit.trajectory, position=position))
    for build in (build_plan_figure, build_speed_figure, build_energy_figure):
        lines = [one for one in build(shot.make_scene(), fit, looks).data if one.name in fit.trajectory.ids]
        assert {(one.name, one.line.dash) for one in lines} == {("white", "solid"), ("red", "dash")}
    marks = [one.marker.symbol for one in build_plan_figure(shot.make_scene(), fit, looks).data if one.showlegend]
    assert marks == ["circle", "circle-dot"]


@pytest.mark.parametrize("turns", range(4))
def test_the_plan_lies_as_the_table_in_the_clip_with_the_names_of_its_rails(turns: int) -> None:
    scene, fit = shot.make_scene(), shot.make_fit(np.linspace(0, 0.8, 25))
    c, s = np.round([np.cos(turns * np.pi / 2), np.sin(turns * np.pi / 2)])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = replace(scene, camera=replace(scene.camera, matrix=turn @ scene.camera.matrix))
    ids, looks = fit.trajectory.ids, describe_unseen_balls(fit.trajectory.ids, fit.trajectory.ids)
    fit = replace(fit, naming=build_naming(scene.table, turned.camera, ids, looks))
    figure = build_plan_figure(turned, fit, looks)
    (path,) = [trace for trace in figure.data if trace.mode == "lines" and trace.name == "white"]
    drawn = np.array([path.x[-1] - path.x[0], path.y[-1] - path.y[0]])
    xy = fit.trajectory.at(np.array([0.0, 0.8])).xy[:, fit.trajectory.ids.index("white")]
    seen = np.diff(turned.camera.to_pixels(xy, scene.table.ball_radius), axis=0)[0]
    assert drawn @ seen > 0.99 * np.linalg.norm(drawn) * np.linalg.norm(seen)
    names = {note.text: (note.x, note.y) for note in figure.layout.annotations}
    left, right, far, near = (
        next(place for name, place in names.items() if name.startswith(word))
        for word in ("left", "right", "far", "near")
    )
    assert left[0] < far[0] < right[0]
    assert far[1] < left[1] < near[1]


def test_a_clip_that_breaks_off_is_amber_with_the_reason() -> None:
    notes = (Note("incomplete_clip", "it breaks off at 0.50 s of 0.80 s"),)
    trust = assess_run_trust(notes, shot.make_fit(np.arange(shot.FRAMES) / shot.RATE))
    assert trust.level == "amber"
    assert "breaks off at 0.50 s" in trust.reasons[0]


@pytest.fixture(scope="module")
def unsure_page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("unsure")
    clip = shot.write_clip(folder / "clip.mp4")
    scene, tracks = shot.make_scene(), shot.make_tracks(clip, shot.make_scene())
    Image.new("RGB", (32, 18)).save(folder / "poster.png")
    files = ReportFiles("clip.mp4", folder / "poster.png", 8.0)
    fit = shot.make_unsure_fit(tracks.t)
    fit = replace(fit, trust=assess_run_trust((), fit))
    write_report(clip, scene, tracks, fit, files, "shot", [], folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")


def test_places_to_check_have_a_sentence_a_frame_and_a_close_up(unsure_page: str) -> None:
    images = [base64.b64decode(data) for data in re.findall(r'src="data:image/jpeg;base64,([^"]+)"', unsure_page)]
    assert [Image.open(io.BytesIO(image)).size for image in images] == [(480, 360), (480, 360)]
    middle = np.asarray(Image.open(io.BytesIO(images[0])).convert("L"))[150:210, 210:270]
    assert middle.max() > 200, "the white ball is in the middle of its close-up"
    assert "0.500 s, around frame 15 · 39 % unsure" in unsure_page
    assert (
        "White: what it met at 0.5000 s ± 1.0 ms is unsure: right short rail 61 %, something else 39 %; too few frames"
        in unsure_page
    )
    assert unsure_page.index("frame 15 ·") < unsure_page.index("frame 21 ·")
    assert "No call is undecided" not in unsure_page


def test_undecided_events_are_marked_with_their_hypotheses(unsure_page: str) -> None:
    assert unsure_page.count("? undecided: 61 %, or something else 39 %") == 1
    assert 'class="doubt">undecided: 61 %<div class="small">or something else 39 %</div>' in unsure_page


def test_a_sure_run_says_that_nothing_is_unsure(page: str) -> None:
    assert "No call is undecided" in page
    assert "Least sure contact: white hits the right short rail (90 %)." in page
    assert "data-check=" not in page
    assert "? undecided" not in page


def test_the_trust_level_of_the_page_names_undecided_events(unsure_page: str) -> None:
    assert "Trust: amber" in unsure_page
    assert "Undecided: white touches red at 0.7000 s ± 1.0 ms (20 %)." in unsure_page
    assert "Trust level of the clip: amber." in unsure_page


def test_calls_that_the_clip_does_not_decide_say_so_with_the_reason() -> None:
    undecided = CallAnswer("first", ("white",), 0.6, met="red", alternatives=(("red", 0.6),), doubts=("hidden",))
    words, sure = (format_call(one, Naming()) for one in (undecided, replace(undecided, probability=0.99, doubts=())))
    assert (words.verdict, words.probability, words.statement) == (
        "cannot be decided", "red: 60 %", "white touched red first"
    )  # fmt: skip
    assert words.reason == "This clip cannot decide it: a ball was not detected around it."
    assert (sure.verdict, sure.probability, sure.reason) == ("red", "99 %", "")


def test_the_probability_of_a_call_is_that_of_the_call_and_an_order_has_no_margin() -> None:
    no = CallAnswer("cushion-first", ("white",), 0.002, 0.5, 0.001, 15.0, -0.0173, 0.0001, met="red")
    order = format_call(no, Naming())
    contact = format_call(replace(no, kind="contact", subject=("white", "red")), Naming())
    assert (order.verdict, order.probability, order.margin) == ("no", "99.8 %", "")
    assert order.statement == "white met red first at 0.5000 s ± 1.0 ms, frame 15.0"
    assert contact.margin == "", "free paths that overlap contradict what all evidence says"
    assert format_call(replace(no, kind="contact", subject=("white", "red"), probability=0.998), Naming()).margin == (
        "17.3 ± 0.1 mm from a miss"
    )


def test_what_did_not_happen_has_the_moment_of_the_smallest_distance() -> None:
    no = CallAnswer("pocket", ("white", "top"), 0.001, 0.5, math.nan, 15.0, 0.2, 0.001)
    assert format_call(no, Naming()).statement == (
        "white stayed on the table; 200.0 ± 1.0 mm short of the mouth of the far-side pocket at about 0.5 s, frame 15.0"
    )
    yes = format_call(replace(no, probability=0.99, margin=-0.0157), Naming())
    assert yes.statement.endswith("; 15.7 ± 1.0 mm inside the mouth of the far-side pocket")


def test_the_reason_of_an_amber_run_stands_in_the_table_of_its_quality(clip: Clip) -> None:
    doubt = "No green ball was detected, although it belongs on the table."
    scene, fit = replace(shot.make_scene(), warnings=()), shot.make_fit(clip.t)
    assert all(flag.good for flag in run_report.assess_quality(clip, scene, fit))
    amber = replace(fit, trust=Trust("amber", (f"{EXPLAINED} all the time.", doubt)))
    assert [flag.value for flag in run_report.assess_quality(clip, scene, amber) if not flag.good] == [doubt]


def test_a_variable_frame_rate_is_called_so_with_its_average(clip: Clip) -> None:
    scene, fit = shot.make_scene(), shot.make_fit(clip.t)
    uneven = clip.t + 0.02 * (np.arange(clip.frame_count) > 10)
    flags = run_report.assess_quality(replace(clip, t=uneven), scene, fit)
    values = {flag.what: flag.value for flag in flags}
    average = (clip.frame_count - 1) / uneven[-1]
    assert values["Frames"].endswith(f", variable, {average:.3f} a second on average")
    assert values["Capture times"] == "as the file states them"
    regular = run_report.assess_quality(clip, scene, fit)
    assert next(flag.value for flag in regular if flag.what == "Frames").endswith(f", {float(clip.fps):.3f} fps")


def test_balls_that_pass_within_two_diameters_are_asked_about(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(call_answers, "answer_contact", lambda _, *pair: pair)
    x = np.linspace(0.2, 1.4, 61)

    def ask(air: float, start: float = 0.2) -> list[CallAnswer]:
        path = np.stack([np.tile([1.0, 0.5 + 2 * 0.03 + air], (61, 1)), np.stack([x, 0 * x + 0.5], axis=1)], axis=1)
        path = path[x >= start]
        record = SimpleNamespace(
            path=path, ids=("red", "white"), events=shot.make_fit(x).events, table=SimpleNamespace(ball_radius=0.03),
            gaps=lambda a, b: np.linalg.norm(path[:, a] - path[:, b], axis=1) - 2 * 0.03,
        )  # fmt: skip
        return run_report._answer_near_misses(record)  # type: ignore[arg-type]

    assert ask(0.063) == ask(0.026) == [("white", "red")]
    assert ask(0.13) == [], "more than two diameters of air"
    assert ask(0.063, start=1.0) == [], "they only part"


def test_the_still_image_has_a_caption(page: str) -> None:
    assert (
        "Faint balls: a ball at earlier moments of its path; white rings: where the paths begin; dots: contacts."
        in page
    )


def test_a_carom_is_told_with_its_cushions_and_the_margin_of_their_order() -> None:
    path = tuple(
        CandidateContact(0, other, t, 1e-3, 1.0, -0.01, 1e-3)
        for other, t in (("red", 0.5), ("top", 0.8), ("left", 1.2), ("yellow", 1.5), ("bottom", 1.7))
    )
    touches = tuple(CallAnswer("contact", ("white", ball), 0.99) for ball in ("red", "yellow"))
    score = CallAnswer("score", ("white", "red", "yellow"), 0.98, 1.5, 0.001, 45.0, path=path, parts=touches)
    assert format_call(score, Naming()).statement == (
        "white touched red and, after 2 rails in all, yellow at 1.5000 s ± 1.0 ms, frame 45.0"
    )
    late = replace(score, kind="cushions", subject=(*score.subject, "3"), probability=0.0)
    assert format_call(late, Naming(game="carom")).statement == "2 cushions before the second ball"
    missed = replace(score, probability=0.01, path=path[:3], margin=0.003, margin_sigma=0.001)
    assert format_call(missed, Naming(game="carom")).sentence == (
        "No (99 %): white met 2 cushions and missed yellow; 3.0 ± 1.0 mm from a touch at 1.5000 s ± 1.0 ms, frame 45.0."
    )


def test_a_rail_is_not_taken_for_the_pocket_of_the_same_name() -> None:
    reached = CallAnswer("no-rail", ("cue", "cushion"), 0.01, balls=("solid-1",), met="top")
    assert format_call(reached, Naming()).statement == "after the first contact solid-1 hits the far long rail"
    potted = format_call(replace(reached, subject=("cue", "pocket")), Naming()).statement
    assert "pocket" in potted
    assert "rail" not in potted


@pytest.mark.parametrize(
    ("unsure", "verdict"),
    [(False, "No foul (99 %): ruled out: in-off."), (True, "Cannot be decided (no foul: 60 %): ")],
)
def test_a_foul_call_states_what_was_ruled_out_or_what_is_unsure(unsure: bool, verdict: str) -> None:
    p, doubts = (0.4, ("hidden",)) if unsure else (0.01, ())
    part = CallAnswer("scratch", ("white", "top"), p, doubts=doubts)
    foul = CallAnswer("foul", ("white", "snooker"), p, doubts=doubts, parts=(part,))
    assert format_call(foul, Naming(game="snooker")).sentence.startswith(verdict)
    unjudged = format_call(replace(foul, subject=("white",)), Naming(game="snooker"))
    assert unjudged.likely == "none of the fouls that can be judged", "the ball on is not known"


def test_the_page_answers_for_a_carom_and_lists_certain_fouls_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    record = SimpleNamespace(table=SimpleNamespace(game="pool"), ids=("cue", "red"))
    facts = (CallAnswer("scratch", ("cue",), 0.99), CallAnswer("no-rail", ("cue",), 0.5))
    foul = CallAnswer("foul", ("cue", "pool"), 0.99, parts=facts)
    monkeypatch.setattr(run_report, "answer_foul", lambda record, cue: foul)
    monkeypatch.setattr(run_report, "find_struck_ball", lambda record: "cue")
    assert [call.kind for call in run_report._answer_rules(record)] == ["scratch"]
    parts = tuple(CallAnswer("cushions", ("white", "red", "yellow", k), 0.9) for k in "0013")
    score = CallAnswer("score", ("white",), 0.9, parts=parts)
    monkeypatch.setattr(run_report, "answer_score", lambda record, cue: score)
    carom = SimpleNamespace(table=SimpleNamespace(game="carom"), ids=("white", "red", "yellow"))
    assert [call.kind for call in run_report._answer_rules(carom)] == ["score", "cushions", "cushions"]
    carom.ids = carom.ids[:2]
    assert not run_report._answer_rules(carom), "two balls are no carom"
    monkeypatch.setattr(run_report, "find_struck_ball", lambda record: "")
    assert not run_report._answer_rules(record), "no cue ball moves"


def write_page(folder: Path, fit: Fit, scene: Scene) -> str:
    clip = shot.write_clip(folder / "clip.mp4")
    Image.new("RGB", (32, 18)).save(folder / "poster.png")
    files = ReportFiles("clip.mp4", folder / "poster.png", 8.0)
    write_report(clip, scene, shot.make_tracks(clip, scene), fit, files, "shot", [], folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def test_what_was_set_by_hand_stands_at_the_trust_level(tmp_path: Path, clip: Clip) -> None:
    scene = replace(shot.make_scene(), notes=("set by hand: the corners of the table",))
    page = write_page(tmp_path, shot.make_fit(clip.t), scene)
    assert page.count("the corners of the table") == 1
    assert page.index("Set by hand: the corners of the table.") < page.index("In short")


def test_a_parameter_of_both_fits_stands_under_two_headings_with_its_own_digits(tmp_path: Path, clip: Clip) -> None:
    fit = shot.make_fit(clip.t)
    (own,) = fit.parameters
    others = (replace(own, value=0.009061, sigma=3.1e-05), replace(own, name="nose.left", value=-4e-232, sigma=0.004))
    empty = np.empty((0, 7, 7))
    whole = WholeShotSolution("mathavan_2010", "inelastic", 1.0, others, 0.1, (), empty[..., 0], empty)
    page = write_page(tmp_path, replace(fit, laws=WholeShotFit(whole)), shot.make_scene())
    assert page.index(run_report.BY_SEGMENT_HEADING) < page.index(run_report.WHOLE_SHOT_HEADING)
    assert '>0.009061</td><td data-label="±">0.000031</td>' in page
    assert '>0</td><td data-label="±">0.004</td>' in page


def moments_of(*p: float) -> ShotExplanation:
    return ShotExplanation(
        tuple(
            Moment(
                "white",
                float(k),
                0.001,
                np.zeros(2),
                (CauseHypothesis("ball", "red", q), CauseHypothesis("none", "", 1 - q)),
            )
            for k, q in enumerate(p)
        )
    )


def test_a_strike_has_the_speed_that_the_numbers_of_its_shot_state(clip: Clip) -> None:
    events = shot.make_fit(clip.t).events
    strike = events.kind.index("strike")
    t = float(events.t[strike])
    for is_observable, delay, expected in ((True, 0.0, 2.5), (False, 0.0, None), (True, 1.0, None)):
        number = ShotNumber("cue_speed", 2.5, 0.1, "m/s", is_observable, events.a[strike])
        shots = (ShotNumbers(t + delay, events.a[strike], "", "unknown", (), (), (), (number,)),)
        speed = events.speed.copy()
        speed[strike] = speed[strike] if expected is None else expected
        np.testing.assert_array_equal(state_strike_speeds(events, shots).speed, speed)


@pytest.mark.parametrize(("level", "expected"), [("green", "amber"), ("amber", "amber"), ("red", "red")])
def test_undecided_contacts_reduce_green_to_amber_and_no_further(level: TrustLevel, expected: str, clip: Clip) -> None:
    fit = replace(shot.make_fit(clip.t), explanation=moments_of(0.95, 0.2, 0.5, 0.05, 0.8, 0.89))
    trust = assess_run_trust((), replace(fit, trust=Trust(level, ("why",))))
    assert trust.level == expected
    undecided = (
        "Undecided: white touches red at 2.0000 s ± 1.0 ms (50 %), white touches red at 1.0000 s ± 1.0 ms (20 %), "
        "white touches red at 4.0000 s ± 1.0 ms (80 %) and 1 more."
    )
    assert trust.reasons == (("why", undecided) if level == "red" else (undecided, "why")), "what makes it so is first"


def test_decided_contacts_and_undecided_cushions_and_rests_stay_green(clip: Clip) -> None:
    hypotheses = (CauseHypothesis("cushion", "top", 0.5), CauseHypothesis("rest", "", 0.5))
    open_cushion = Moment("white", 0.5, 0.001, np.zeros(2), hypotheses)
    moments = (*moments_of(0.95, 0.05).moments, open_cushion)
    fit = replace(shot.make_fit(clip.t), explanation=ShotExplanation(moments))
    assert assess_run_trust((), fit) == fit.trust


def test_an_event_counts_as_undecided_where_the_fit_and_the_slow_motion_count_it_so() -> None:
    for module in (call_answers, fit_result, motion_paths):
        assert module.SURE_PROBABILITY == 0.9
    assert motion_paths.MIN_PROBABILITY == MIN_LISTED_PROBABILITY


def test_the_error_of_a_prediction_is_drawn_over_time_and_cushions() -> None:
    errors = ForecastErrors(
        0.5, ("white",) * 4, np.array([0.1, 0.2, 0.3, 0.4]), np.array([0, 0, 1, 1]),
        np.array([0.001, 0.003, 0.010, 0.020]),
    )  # fmt: skip
    over_time, over_cushions = build_forecast_figure(errors, Naming()).data
    np.testing.assert_allclose(over_time.y, [1, 3, 10, 20])
    assert list(over_cushions.x) == [0, 1]
    np.testing.assert_allclose(over_cushions.y, [2, 15])
