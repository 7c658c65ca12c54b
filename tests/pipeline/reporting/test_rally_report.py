"""The page and the recording of a rally answer who won its last point, and show its strokes."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader
from support.browser import accessibility_violations, console_messages, open_chromium, open_page
from support.filmed_rally import film_rally
from support.page_words import read_page
from support.staged_rally import stage_rally

from models.core.corrections import NO_CORRECTIONS
from models.core.court_camera import rotation_matrix
from models.core.progress import ignore_progress
from models.core.rally import BallCandidates, Rally
from models.estimation.rally.landing_judgement import NetCrossing, judge_landing
from models.estimation.rally.stroke_summary import summarize_strokes
from models.sports.sport_catalogue import find_sports
from pipeline.reporting.pages.rally_report import write_rally_report
from pipeline.reporting.pages.run_report import ReportFiles
from pipeline.reporting.recording.rally_recording import split_projection, write_rally_recording
from pipeline.reporting.text.rally_sentences import assess_rally_trust, format_height_over_net, format_landing
from pipeline.reporting.text.stroke_sentences import format_point, list_stroke_rows
from pipeline.stages.rally_output_stages import RallyPageOptions, rally_output_stages
from video.io.clip import Clip
from video.io.video_options import RenderOptions
from video.overlay.rally_poster import draw_rally_poster
from video.overlay.rally_slow_motion import find_rally_times


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Clip, Rally]:
    return film_rally(tmp_path_factory.mktemp("rally") / "clip.mp4")


@pytest.fixture(scope="module")
def page(filmed: tuple[Clip, Rally], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    Image.new("RGB", (64, 36), (40, 90, 70)).save(folder / "poster.png")
    files = ReportFiles("slow.mp4", folder / "poster.png", 8.0)
    write_rally_report(*filmed, files, "rally.mp4", ["--sport badminton"], folder / "report.html")
    return folder / "report.html"


def move_landing(rally: Rally, y: float) -> Rally:
    place = np.array([rally.landings[0].place[0], y, rally.landings[0].place[2]])
    return replace(rally, landings=(replace(rally.landings[0], place=place),))


def test_the_first_words_of_the_page_are_the_verdict(page: Path) -> None:
    words = " ".join(read_page(page).split())
    start = words[: words.index("What happened")]
    assert "The near player won the last point: the shuttle was in." in start
    assert "left singles line" in start
    assert "above 99.9 %" in start
    for heading in ("speed at the racket", "apex", "at the net", "landing", "The court from above"):
        assert heading in words


def test_the_winner_follows_from_the_call(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    edge = rally.scene.sport.areas["singles"][1][1]
    out = move_landing(rally, edge - 0.2)
    point = format_point(out, judge_landing(out))
    assert point.headline == "The far player won the last point: the shuttle was out."
    close = move_landing(rally, edge + 0.005)
    point = format_point(close, judge_landing(close))
    assert not point.is_decided
    assert point.headline == "Who won the last point cannot be decided."
    assert "If it was in, the near player won; if it was out, the far player." in point.reason
    nothing = replace(rally, landings=(), no_landing=1.0)
    assert not format_point(nothing, judge_landing(nothing)).is_decided


def test_page_and_call_decide_nothing_where_trust_is_red(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    (flight,) = rally.flights
    wrong = replace(flight, start=flight.start - 9.0, end=flight.start, chi2=9.0)
    untrusted = replace(rally, flights=(wrong, flight))
    call = judge_landing(untrusted)
    assert assess_rally_trust(untrusted).level == "red"
    assert call.verdict == "undecided"  # what close-up, poster and slow motion show
    assert format_landing(call, untrusted).verdict == "cannot be decided"
    assert not format_point(untrusted, call).is_decided


def test_a_call_names_the_nearest_line_and_what_its_probability_depends_on() -> None:
    rally = stage_rally(find_sports()["badminton"], (11.4, 0.96), sigma=(1.5, 0.02))
    sentence = format_landing(judge_landing(rally), rally).sentence
    assert "landed 50.0 ± 2.0 cm inside the outer edge of the left singles line, at " in sentence
    assert sentence.endswith(
        "The probability depends more on another distance: 2.0 ± 1.5 m inside the outer edge of the far end line."
    )


def test_a_camera_that_turns_is_no_doubt(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    for note, level in (("camera-moves", "green"), ("camera-travels", "amber")):
        noted = replace(rally, scene=replace(rally.scene, notes=(note,)))
        assert assess_rally_trust(noted).level == level


def test_times_of_the_page_count_from_where_a_trimmed_slow_motion_begins(
    filmed: tuple[Clip, Rally], tmp_path: Path
) -> None:
    clip, rally = filmed
    (flight,) = rally.flights
    late = replace(rally, flights=(replace(flight, start=flight.start + 0.5),))
    begin = {}
    for trim in (False, True):
        folder = tmp_path / str(trim)
        folder.mkdir()
        render = RenderOptions(slow=8.0, trim_still=trim)
        page = RallyPageOptions("rally.mp4", 8.0, ())
        stages = {one.name: one for one in rally_output_stages(page, render, NO_CORRECTIONS)}
        inputs = {"read": clip, "rally": late, "poster": folder}
        for name in ("poster", "report"):
            stages[name].run(inputs, stages[name].options, folder, ignore_progress)
        html = (folder / "report.html").read_text(encoding="utf-8")
        begin[trim] = float(re.search(r'id="now">([0-9.]+)<', html)[1])
    assert begin[False] == 0.0
    assert begin[True] == pytest.approx(find_rally_times(clip, late, render)[0], abs=1e-3)
    assert begin[True] > 0.3


def test_an_unsure_last_hit_leaves_the_point_open(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    hit, *others = rally.events
    unsure = replace(rally, events=(replace(hit, probability=0.7), *others))
    point = format_point(unsure, judge_landing(unsure))
    assert not point.is_decided
    assert "70 %" in point.confidence


def test_a_returned_stroke_states_where_it_would_have_landed(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    (flight,) = rally.flights
    middle = (flight.start + flight.end) / 2
    hit = replace(rally.events[0], t=middle + 0.2, player="far")
    cut = replace(rally, flights=(replace(flight, end=middle),), events=(rally.events[0], hit), landings=())
    first, second = summarize_strokes(cut)
    assert first.call is not None
    assert first.call.landing is not None
    np.testing.assert_allclose(first.call.landing.place[:2], rally.landings[0].place[:2], atol=0.02)
    assert first.net is not None
    assert second.call is None
    (_, cells), _ = list_stroke_rows(cut, (first, second))
    assert cells[5].startswith("without the return, at ")
    assert "left singles line" in cells[6]


@pytest.mark.parametrize(
    ("height", "is_touch", "words"),
    [
        (0.3, False, "30 ± 10 cm over its edge"),
        (-0.02, False, "close over its edge (measured: 2 ± 10 cm below)"),
        (-0.02, True, "2 ± 10 cm below its edge"),
        (-0.5, False, "50 ± 10 cm below its edge"),
    ],
)
def test_what_passes_the_net_passes_over_its_edge_as_far_as_errors_allow(
    height: float, is_touch: bool, words: str
) -> None:
    crossing = NetCrossing(1.0, np.zeros(3), height, 0.1, 10.0, is_touch)
    assert format_height_over_net(crossing) == words


def test_the_last_stroke_lands_as_the_call_says(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    (landing,) = rally.landings
    other = replace(landing, weight=0.45, place=landing.place + np.array([0.0, 0.3, 0.0]))
    rivals = replace(rally, landings=(replace(landing, weight=0.45), other), no_landing=0.1)
    call = summarize_strokes(rivals)[-1].call
    assert call is not None
    assert (call.verdict, call.reason, call.probability) == (
        judge_landing(rivals).verdict, judge_landing(rivals).reason, judge_landing(rivals).probability,
    )  # fmt: skip
    assert call.landing is not None


def test_a_rally_without_strokes_has_a_page(filmed: tuple[Clip, Rally], page: Path, tmp_path: Path) -> None:
    clip, rally = filmed
    empty = replace(rally, flights=(), events=(), landings=(), no_landing=1.0, is_used=np.zeros(len(rally.t), bool))
    assert summarize_strokes(empty) == ()
    files = ReportFiles("slow.mp4", page.with_name("poster.png"), 8.0)
    write_rally_report(clip, empty, files, "rally.mp4", [], tmp_path / "report.html")
    assert "No stroke was found." in read_page(tmp_path / "report.html")
    assert draw_rally_poster(clip, empty).shape == (clip.height, clip.width, 3)


def test_apex_and_height_over_the_net_agree_with_the_flight(filmed: tuple[Clip, Rally]) -> None:
    rally = filmed[1]
    (stroke,) = summarize_strokes(rally)
    dense = rally.t[0] + np.arange(0, rally.t[-1], 1e-3)
    from models.estimation.rally.rally_views import evaluate_rally

    xyz = evaluate_rally(rally, dense).xyz
    assert stroke.apex[2] == pytest.approx(np.nanmax(xyz[:, 2]), abs=2e-3)
    crossing = np.nanargmin(np.abs(xyz[:, 0] - rally.scene.sport.length / 2))
    assert stroke.net is not None
    edge = rally.scene.sport.net.height_at(xyz[[crossing], 1], rally.scene.sport.width)[0]
    assert stroke.net.height == pytest.approx(xyz[crossing, 2] - rally.scene.sport.object.radius - edge, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_fits_the_screen_and_is_accessible(page: Path, width: int) -> None:
    with open_chromium(width) as browser:
        open_page(page, browser)
        wide = browser.execute_script(
            "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )
        assert wide <= 0
        assert not accessibility_violations(browser)
        assert not [one for one in console_messages(browser) if "slow.mp4" not in one]


def test_the_recording_holds_court_camera_flights_and_events(filmed: tuple[Clip, Rally], tmp_path: Path) -> None:
    clip, rally = filmed
    seen = np.flatnonzero(np.isfinite(rally.px[:, 0]))
    one = np.ones(len(seen))
    candidates = BallCandidates(rally.frame[seen], rally.px[seen], np.zeros((len(seen), 2)), one, one, one)
    write_rally_recording(clip, rally, candidates, tmp_path / "recording.rrd", "made up")
    entities = {chunk.entity_path for chunk in RrdReader(tmp_path / "recording.rrd").stream()}
    wanted = ["/court/lines", "/court/net", "/court/object", "/picture", "/picture/video", "/picture/candidates"]
    wanted += ["/picture/used", "/plots/height/shuttle", "/plots/speed/shuttle", "/log/events", "/about"]
    assert not set(wanted) - entities
    assert any(name.startswith("/court/flights/") for name in entities)
    assert any(name.startswith("/court/events/") for name in entities)


def test_the_recording_shows_what_happened_when_the_clip_does(filmed: tuple[Clip, Rally], tmp_path: Path) -> None:
    """Rerun decodes the video by its own times, and everything else must be beside the frame that shows it."""
    clip, rally = filmed
    late = 0.013  # s: the frames were taken so much before the clip shows them
    hit = replace(rally.events[0], t=rally.events[0].t - late)
    flights = tuple(replace(one, start=one.start - late, end=one.end - late) for one in rally.flights)
    early = replace(rally, t=rally.t - late, flights=flights, events=(hit,))
    none = np.empty(0)
    candidates = BallCandidates(np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)), none, none, none)
    write_rally_recording(clip, early, candidates, tmp_path / "recording.rrd", "made up")
    entities = "/picture/used", "/court/object", "/plots/speed/shuttle", "/log/events"
    times: dict[str, list[float]] = {entity: [] for entity in entities}
    for chunk in RrdReader(tmp_path / "recording.rrd").stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path in times and "video_time" in batch.schema.names:
            times[chunk.entity_path] += [one.as_py() / 1e9 for one in batch.column("video_time").cast("int64")]
    for entity in entities[:-1]:
        assert set(np.round(times[entity], 6)) <= set(np.round(clip.t, 6)), entity
        assert times[entity], entity
    assert times["/log/events"] == pytest.approx([rally.events[0].t], abs=1e-6)


def test_a_projection_splits_into_camera_and_rotation() -> None:
    intrinsic = np.array([[900.0, 3.0, 320.0], [0, 880.0, 180.0], [0, 0, 1.0]])
    turn = rotation_matrix(np.array([0.3, -1.2, 0.7]))
    camera, rotation = split_projection(2.5 * intrinsic @ turn)
    np.testing.assert_allclose(camera, intrinsic, atol=1e-9)
    np.testing.assert_allclose(rotation, turn, atol=1e-12)
