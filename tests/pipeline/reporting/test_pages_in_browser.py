"""The pages in a real browser: nothing complains, a contact seeks the video, nobody is kept out."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.by import By
from support import synthetic_run as shot
from support.browser import accessibility_violations, console_messages, open_chromium, open_page, wait_on
from support.reference_frames import PLANE

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
    Strength,
    Unexplained,
)
from models.core.recording import Recording
from pipeline.batch.clip_job import ClipResult
from pipeline.batch.run_batch import render_index_page
from pipeline.experiments.thesis.experiment_plan import Depth, ExperimentPlan
from pipeline.experiments.thesis.thesis_page import write_results
from pipeline.experiments.thesis.thesis_scenes import ExperimentCase
from pipeline.experiments.thesis.trials import Trial
from pipeline.reporting.pages.gap_page import write_gap_page
from pipeline.reporting.pages.page_template import build_jpeg_uri
from pipeline.reporting.pages.run_report import ReportFiles, write_report

SLOWER = 2.0
WIDTHS = (1280, 390)
MAX_PAGE_BYTES = 3_000_000
desk_only = pytest.mark.parametrize("browser", WIDTHS[:1], indirect=True)
"""For what does not depend on the width of the screen."""
REST = Unexplained(
    0.01, 0.001, 4.0, (GapLocation("slide", 1.0, None, None, None, None, "speed"),), "along the motion everywhere",
    ForceLaw("along", "speed", np.arange(3.0), np.arange(3.0), np.ones(3), np.ones((2, 3)), "a = 1 u^1.00", 0.6),
    LocalPatch(np.array([0.2, 0.1]), np.array([0.01, 0.01]), 0.1, 0.01, -0.2, 0.02, 0.0025),
)  # fmt: skip


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    clip = shot.write_clip(folder / "slow.mp4")
    scene = shot.make_scene()
    tracks = shot.make_tracks(clip, scene)
    Image.fromarray(np.full((140, 240, 3), 90, np.uint8)).save(folder / "poster.png")
    files = ReportFiles("slow.mp4", folder / "poster.png", SLOWER, start=0.2)
    name = "<b>shot</b>&\"'.mp4"
    write_report(clip, scene, tracks, shot.make_unsure_fit(tracks.t), files, name, ["--slow 2"], folder / "report.html")
    return folder / "report.html"


@pytest.fixture(scope="module", params=WIDTHS)
def browser(request: pytest.FixtureRequest) -> Iterator[webdriver.Chrome]:
    with open_chromium(request.param) as opened:
        yield opened


@desk_only
def test_choosing_a_contact_seeks_the_video(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    wait_on(browser).until(lambda b: b.execute_script("return document.getElementById('slow').readyState") >= 2)
    browser.execute_script("document.getElementById('slow').play = () => Promise.resolve()")  # the moment stands still
    hit = next(b for b in browser.find_elements(By.CSS_SELECTOR, "[data-seek]") if "right short rail" in b.text)
    browser.execute_script("arguments[0].click()", hit)
    wait_on(browser).until(lambda b: not b.execute_script("return document.getElementById('slow').seeking"))
    at = browser.execute_script("return document.getElementById('slow').currentTime")
    assert at == pytest.approx((0.5 - 0.15 - 0.2) * SLOWER, abs=1e-3)
    assert console_messages(browser) == []


@desk_only
def test_choosing_a_place_to_check_seeks_the_video(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    wait_on(browser).until(lambda b: b.execute_script("return document.getElementById('slow').readyState") >= 2)
    browser.execute_script("document.getElementById('slow').play = () => Promise.resolve()")
    place = browser.find_elements(By.CSS_SELECTOR, "[data-check]")[1]
    browser.execute_script("arguments[0].scrollIntoView(); arguments[0].click()", place)
    wait_on(browser).until(lambda b: not b.execute_script("return document.getElementById('slow').seeking"))
    at = browser.execute_script("return document.getElementById('slow').currentTime")
    assert at == pytest.approx((0.7 - 0.15 - 0.2) * SLOWER, abs=1e-3)
    image = place.find_element(By.TAG_NAME, "img")
    wait_on(browser).until(lambda b: b.execute_script("return arguments[0].naturalWidth", image) == 480)


@desk_only
def test_a_contact_is_reached_and_chosen_by_the_keyboard(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    buttons = browser.find_elements(By.CSS_SELECTOR, "[data-seek]")
    buttons[-1].send_keys("\n")
    assert browser.execute_script("return document.getElementById('slow').currentTime") > 0
    assert browser.switch_to.active_element == buttons[-1]


@desk_only
def test_the_contact_that_is_shown_is_marked_in_the_list(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    wait_on(browser).until(lambda b: b.execute_script("return document.getElementById('slow').readyState") >= 2)
    browser.execute_script("document.getElementById('slow').currentTime = 0.7")
    now = wait_on(browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "[aria-current]"))
    assert "right short rail" in now[0].get_attribute("textContent")
    assert float(browser.find_element(By.ID, "now").text) == pytest.approx(0.2 + 0.7 / SLOWER, abs=2e-3)


def test_the_report_keeps_nobody_out(report: Path, browser: webdriver.Chrome) -> None:
    assert accessibility_violations(open_page(report, browser)) == []


@desk_only
def test_a_report_without_its_slow_motion_says_so(report: Path, browser: webdriver.Chrome, tmp_path: Path) -> None:
    open_page(report, browser)
    assert not browser.find_element(By.ID, "missing").is_displayed()
    (tmp_path / "report.html").write_bytes(report.read_bytes())
    open_page(tmp_path / "report.html", browser)
    wait_on(browser).until(lambda b: b.find_element(By.ID, "missing").is_displayed())
    assert not browser.find_element(By.ID, "playing").is_displayed()
    offers = browser.find_elements(By.CLASS_NAME, "plays")
    assert offers, "the page says what plays"
    assert not any(offer.is_displayed() for offer in offers)
    browser.get_log("browser")  # the missing file is reported there, and a later test must not see it


def test_the_report_is_no_wider_than_the_screen(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    wide, screen = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= screen


HIDDEN_CELLS = """
return [...document.querySelectorAll('td, tbody th')].filter((cell) => cell.textContent.trim()).filter((cell) => {
  const range = document.createRange();
  range.selectNodeContents(cell);
  const { left, right, height } = range.getBoundingClientRect();
  return !height || left < 0 || right > innerWidth || (innerWidth < 600 && cell.closest('.scroll')
    && cell.tagName === 'TD' && cell.dataset.label === undefined);
}).map((cell) => cell.textContent)"""
"""Texts of table cells that are not on the screen, or of which a phone does not say what they mean."""


def test_a_phone_shows_every_number_of_the_report(report: Path, browser: webdriver.Chrome) -> None:
    assert open_page(report, browser).execute_script(HIDDEN_CELLS) == []
    boxes = "return [...document.querySelectorAll('.scroll')].map((box) => box.scrollWidth - box.clientWidth)"
    assert max(browser.execute_script(boxes)) <= 0
    assert report.stat().st_size < MAX_PAGE_BYTES


AFTER_TAP = 0.5
"""s within which a browser tells a double tap from two taps."""
TAP_PLACE = """
const plot = document.querySelector(`#${arguments[0]} .nsewdrag`);
plot.scrollIntoView({ block: 'center' });
const { left, top, width, height } = plot.getBoundingClientRect();
return [left + 0.3 * width, top + 0.5 * height]"""


@pytest.mark.parametrize("browser", WIDTHS[1:], indirect=True)
@pytest.mark.parametrize("figure", ["speeds", "energies", "parameters", "plan"])
def test_a_tap_on_a_figure_shows_the_value_there(report: Path, browser: webdriver.Chrome, figure: str) -> None:
    x, y = open_page(report, browser).execute_script(TAP_PLACE, figure)
    size = f"const {{ x, y, width, height }} = document.querySelector('#{figure} .nsewdrag').getBoundingClientRect();"
    before = browser.execute_script(f"{size} return [x, y, width, height]")
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    value = f"return document.querySelector('#{figure} .hoverlayer').textContent"
    assert any(letter.isdigit() for letter in wait_on(browser).until(lambda b: b.execute_script(value)))
    time.sleep(AFTER_TAP)
    assert browser.execute_script(f"{size} return [x, y, width, height]") == before, "a tap changes no size"


OVERHANG = """
return [...document.querySelectorAll('.figure')].map((figure) => Math.max(...[...figure.querySelectorAll('.main-svg')]
  .map((drawn) => drawn.getBoundingClientRect().right)) - figure.getBoundingClientRect().right)"""
"""By how many px the drawing of each figure is wider than its place."""


def test_no_figure_overlaps_its_neighbour(report: Path, browser: webdriver.Chrome) -> None:
    over = open_page(report, browser).execute_script(OVERHANG)
    assert len(over) == 4
    assert max(over) <= 1


def test_on_paper_all_figures_and_tables_fit_and_the_still_replaces_the_video(report: Path) -> None:
    with open_chromium() as browser:
        open_page(report, browser)
        browser.set_window_size(700, 900)  # A4 upright is about so wide
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
        browser.execute_script("dispatchEvent(new Event('beforeprint'))")
        assert max(browser.execute_script(OVERHANG)) <= 1
        drawn = "return [...document.querySelectorAll('.main-svg')].map((d) => d.getBoundingClientRect().width)"
        assert max(browser.execute_script(drawn)) <= 660
        tables = "return [...document.querySelectorAll('.scroll')].map((s) => s.scrollWidth - s.clientWidth)"
        assert max(browser.execute_script(tables)) <= 0
        assert not browser.find_element(By.ID, "slow").is_displayed()
        assert browser.find_element(By.ID, "still").size["height"] > 100
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.set_window_size(1280, 900)
        browser.execute_script("dispatchEvent(new Event('afterprint'))")
        wait_on(browser).until(lambda b: max(b.execute_script(drawn)) > 1000)


@desk_only
def test_figures_are_drawn_and_describe_the_point_under_the_mouse(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    for name in ("plan", "speeds", "energies", "parameters"):
        assert browser.execute_script(f"return document.querySelectorAll('#{name} .main-svg').length") > 0
    hover = "Plotly.Fx.hover('plan', [{curveNumber: 0, pointNumber: 3}]);"
    hover_text = "return document.querySelector('#plan .hoverlayer').textContent"
    assert "m/s" in browser.execute_script(hover + hover_text)


@desk_only
def test_a_hostile_name_is_only_text(report: Path, browser: webdriver.Chrome) -> None:
    open_page(report, browser)
    assert browser.find_element(By.TAG_NAME, "h1").text == "<b>shot</b>&\"'.mp4"


def make_diagnosis() -> DiagnosisReport:
    """Two shots of a body whose drag the simulator lacks."""
    t = np.arange(20) / 30
    windows, before, after = [], [], []
    for number in (3, 5):
        places = np.stack([t, number * t - t**2], axis=-1)[:, None]
        piece = Recording(number, np.arange(20), t, ("cube",), places, np.full((20, 1), 1e-3), PLANE)
        windows.append(PredictionWindow(piece, 8))
        before.append(places + 0.05 * t[:, None, None])
        after.append(places + 0.001)
    drag = Strength("k", "1/s", 0.8, 0.02, 0.05)
    none = Strength("k", "1/m", 0.0, 0.1, float("inf"))
    return DiagnosisReport(
        "slide", ("sliding_friction",), "effects", ("viscous_drag",),
        (CandidateEffect("viscous_drag", 0.9, ("viscous_drag",), (drag,)),
         CandidateEffect("air_drag", 0.1, ("air_drag",), (none,))),
        (GapLocation("free_roll", 1.0, "cube", 3, (0.0, 0.6), None, "speed"),),
        Gap("rms_m", 0.5, (3, 5), GapClosure(0.03, 0.001, 0.001, 1.0, (0.98, 1.0), True), tuple(windows), tuple(before),
            tuple(after), coordinates=("x", "y")),
        (EffectShare("viscous_drag", 0.99, (0.98, 1.0), 0.99),), REST,
        (drag,), (), ("frame_rate",), ("lens_distortion",), "Film faster shots.", 1e-9, (),
    )  # fmt: skip


def write_shots(folder: Path) -> Path:
    """Write what the page of a batch reads of a recording of two shots."""
    image = build_jpeg_uri(np.full((90, 160, 3), 90, np.uint8))
    for k, (trust, answer) in enumerate((("green", "yes"), ("red", "no")), 1):
        (folder / f"shot-00{k}").mkdir(parents=True)
        call = {"topic": "score", "question": "Did the <white> score?", "answer": answer, "probability": "98 %"}
        summary = {
            "begins": 10.0 * k, "ends": 10.0 * k + 4.0 + k, "balls": ["white", "<b>yellow</b>", "red"][: 4 - k],
            "strike_count": 1, "ball_count": k, "cushion_count": 3, "pocket_count": 0,
            "trust": {"light": trust, "why": ["All motion is explained."]},
            "sentences": ["The white hit the red first."], "calls": [call], "thumbnail": image,
        }  # fmt: skip
        (folder / f"shot-00{k}" / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    (folder / "shot-001" / "slow.mp4").touch()
    shots = [{"folder": f"shot-00{k}"} for k in (1, 2)]
    (folder / "scene.json").write_text(json.dumps({"shots": shots}), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every other page, by its name."""
    folder = tmp_path_factory.mktemp("others")
    write_gap_page(make_diagnosis(), "<i>shots</i>", folder / "gap.html")
    Image.fromarray(np.full((90, 160, 3), 90, np.uint8)).save(folder / "poster.png")
    rows = [
        ClipResult("a & b.mp4", "done", "amber", 4, 3.5, str(folder), "", seconds=1.0, peak_mb=300.0),
        ClipResult("<c>.mp4", "failed", "", 0, 0.0, "", "No table was found in <c>.mp4", shots=0),
        ClipResult("match.mp4", "done", "green", 4, 3.5, str(write_shots(folder / "match")), "", in_shots=True),
    ]
    (folder / "summary.html").write_text(render_index_page(rows, folder), encoding="utf-8")
    case = ExperimentCase("double-pendulum", "stiff", 30.0, 0.0, 0)
    trials = [
        Trial(case, name, mse, 1.0, 1.0, 1.0, 0, "", np.linspace(0, 1, 4), np.full(4, mse), np.zeros(0))
        for name, mse in (("linear", 4.0), ("cubic", 1.0))
    ]
    write_results(ExperimentPlan(("double-pendulum",), (0,), Depth.QUICK), trials, 2, folder)
    return {name: folder / f"{name}.html" for name in ("gap", "summary", "reproduce")}


def test_the_shots_of_a_batch_are_searched_filtered_and_ordered(
    others: dict[str, Path], browser: webdriver.Chrome
) -> None:
    open_page(others["summary"], browser)

    def list_names() -> list[str]:
        return [card.text for card in browser.find_elements(By.CSS_SELECTOR, ".card h2") if card.is_displayed()]

    def enter(name: str, value: str) -> list[str]:
        browser.execute_script(
            "const one = document.forms[0].elements[arguments[0]]; one.value = arguments[1];"
            "one.dispatchEvent(new Event('input', { bubbles: true }));",
            name, value,
        )  # fmt: skip
        return list_names()

    clip, first, second = "a & b.mp4", "match.mp4, shot-001", "match.mp4, shot-002"
    assert list_names() == [clip, first, second]
    assert enter("words", "WHITE yellow") == [first, second]
    assert enter("answer", "score: no") == [second]
    assert browser.find_element(By.ID, "shown").text == "1 of 3 shots"
    assert enter("answer", "") == [first, second]
    assert enter("order", "seconds") == [second, first]
    for name, value in (("trust", "green"), ("seconds-to", "5.5"), ("balls-from", "3"), ("contacts-to", "4")):
        assert enter(name, value) == [first]
        assert enter(name, "") == [second, first]
    browser.execute_script("document.forms[0].reset()")
    wait_on(browser).until(lambda _: list_names() == [clip, first, second])
    links = [link.get_attribute("href") for link in browser.find_elements(By.CSS_SELECTOR, ".links a")]
    assert sum(link.endswith("shot-001/slow.mp4") for link in links) == 1
    assert not any(link.endswith("shot-002/slow.mp4") for link in links)


def test_images_of_a_page_of_many_shots_get_smaller_until_it_is_small(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (180, 320, 3)).astype(np.uint8)
    write_shots(tmp_path / "match")
    place = tmp_path / "match" / "shot-001" / "summary.json"
    place.write_text(json.dumps(json.loads(place.read_text()) | {"thumbnail": build_jpeg_uri(noise)}))
    shots = {"shots": [{"folder": "shot-001"}] * 300}
    (tmp_path / "match" / "scene.json").write_text(json.dumps(shots))
    row = ClipResult("match.mp4", "done", "green", 4, 3.5, str(tmp_path / "match"), "", in_shots=True)
    page = render_index_page([row], tmp_path)
    assert page.count("data:image/jpeg") == 300
    assert 0.3 * MAX_PAGE_BYTES < len(page.encode()) < MAX_PAGE_BYTES


@pytest.mark.parametrize("name", ["gap", "summary", "reproduce"])
def test_no_other_page_complains_keeps_anybody_out_or_is_too_wide(
    name: str, others: dict[str, Path], browser: webdriver.Chrome
) -> None:
    open_page(others[name], browser)
    assert accessibility_violations(browser) == []
    assert console_messages(browser) == []
    wide, screen = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= screen
    assert "trueroll" in browser.title
