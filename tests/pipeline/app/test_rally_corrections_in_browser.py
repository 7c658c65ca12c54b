"""Corrections of a rally on the page in a real browser, on a desk and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from support.app_servers import serve_app, wait_for_corrections
from support.browser import accessibility_violations, console_messages, open_chromium, show_frame, wait_on
from support.filmed_rally import film_rally

import pipeline.editing.edit_session as edit_session
from models.core.corrections import Corrections
from models.core.rally import Rally
from models.estimation.rally.rally_marks import resolve_marks, settle_marks
from pipeline.app.app_server import AppServer
from pipeline.chain import honour_corrections
from pipeline.io.corrections_file import describe_corrections, read_corrections
from pipeline.io.saved_shot import publish_shot, write_shot
from pipeline.io.strict_json import write_json
from pipeline.run_options import RunOptions

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class RallyPage:
    """The page of a rally, open for corrections."""

    browser: webdriver.Chrome
    server: AppServer
    shot: str
    clip: Path
    rally: Rally

    def click(self, css: str) -> None:
        button = wait_on(self.browser).until(lambda b: b.find_element(By.CSS_SELECTOR, css))
        self.browser.execute_script("arguments[0].click()", button)

    def press(self, *keys: str) -> None:
        webdriver.ActionChains(self.browser).send_keys(*keys).perform()

    def show(self, row: int) -> None:
        show_frame(self.browser, row)

    def wait_for(self, revision: int) -> Corrections:
        """Wait until a revision of the corrections is in the file and shown."""
        wait_on(self.browser).until(lambda _: read_corrections(self.clip).revision == revision)
        wait_for_corrections(self.server, self.shot)
        wait_on(self.browser).until(
            lambda b: (
                "up to date" in b.find_element(By.ID, "progress-text").text
                or "no report" in b.find_element(By.ID, "progress-text").text
            )
        )
        return read_corrections(self.clip).corrections


@pytest.fixture(scope="module", params=(1280, 390))
def browser(request: pytest.FixtureRequest) -> Iterator[webdriver.Chrome]:
    with open_chromium(request.param) as opened:
        yield opened


@pytest.fixture
def page(browser: webdriver.Chrome, tmp_path: Path) -> Iterator[RallyPage]:
    clip, rally = film_rally(tmp_path / "rally.mp4")
    out = tmp_path / "library" / "out"
    (out / "fresh").mkdir(parents=True)
    write_shot(rally, {}, "1", out / "fresh")
    publish_shot(out / "fresh", out)
    write_json({"path": str(clip.path)}, out / "source.json")

    def run_tables(path: Path, folder: Path, options: RunOptions, *_: Any) -> tuple[Any, ...]:
        """Let corrected events be as likely as marks are, without a search."""
        corrections = honour_corrections(path, "", options).corrections
        marks = resolve_marks(corrections.events, rally.frame, rally.t)
        write_json(
            {"scene": "rally", "fps": 25.0, "set_by_hand": describe_corrections(corrections)}, folder / "scene.json"
        )
        return clip, settle_marks(rally, corrections.balls, marks), "0" * 64

    write_json({"scene": "rally", "fps": 25.0}, out / "scene.json")
    with patch.object(edit_session, "run_tables", run_tables), serve_app(out.parent) as server:
        opened = RallyPage(browser, server, server.library.identify(out), clip.path, rally)
        browser.get("about:blank")
        browser.get(f"{server.url}#/shot/{opened.shot}")
        wait_on(browser).until(lambda b: b.find_elements(By.ID, "tab-correct"))
        opened.click("#tab-correct")
        wait_on(browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#events button"))
        wait_on(browser).until(lambda b: b.execute_script("return document.getElementById('frame')?.naturalWidth"))
        yield opened
        browser.get("about:blank")


def test_the_page_of_a_rally_complains_about_nothing_and_fits_the_screen(page: RallyPage) -> None:
    page.click("#events button")
    assert accessibility_violations(page.browser) == []
    wide, screen = page.browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= screen
    assert console_messages(page.browser) == []


def test_an_event_is_marked_moved_and_deleted(page: RallyPage) -> None:
    page.show(20)
    page.click("[data-mark=hit]")
    (mark,) = page.wait_for(1).events
    assert (mark.kind, mark.event, mark.frame) == ("mark", "hit", 20)
    page.click("#undo")
    assert page.wait_for(2).events == ()
    page.click("#events li:nth-child(1) button")
    page.show(12)
    page.click("[data-action=move]")
    (mark,) = page.wait_for(3).events
    assert (mark.kind, mark.event, mark.to_frame) == ("move", "hit", 12)
    page.click("#undo")
    page.wait_for(4)
    page.click("#events li:nth-child(2) button")
    page.click("[data-action=delete]")
    (mark,) = page.wait_for(5).events
    assert (mark.kind, mark.event) == ("delete", "landing")
    listed = [one.text for one in page.browser.find_elements(By.CSS_SELECTOR, "#events li")]
    assert len(listed) == 1
    assert "is hit" in listed[0]
    page.click("#by-hand button")
    assert page.wait_for(6).events == ()


def test_a_shuttle_is_placed_or_is_none_and_a_corner_is_of_the_court(page: RallyPage) -> None:
    page.show(5)
    page.click("#place")
    page.press(Keys.ARROW_LEFT, Keys.ENTER)
    (mark,) = page.wait_for(1).balls
    camera = page.rally.scene.camera
    assert (mark.kind, mark.ball.frame, mark.ball.x_px) == ("placed", 5, camera.width_px / 2 - 1)
    page.show(5)
    page.click("#place")
    page.press(Keys.ARROW_UP, Keys.ENTER)
    (again,) = page.wait_for(2).balls
    assert (again.ball.frame, again.ball.x_px) == (5, camera.width_px / 2)
    corner = page.browser.find_element(By.CSS_SELECTOR, "[data-corner='0']")
    page.show(0)
    page.browser.execute_script("arguments[0].focus()", corner)
    page.press(Keys.ARROW_RIGHT)
    corrected = page.wait_for(3)
    assert corrected.sport == "badminton"
    assert corrected.corners is not None
    assert len(corrected.corners) == 4
    page.click("#by-hand li:nth-child(2) button")  # the sport, to which the corners belong
    without = page.wait_for(4)
    assert (without.sport, without.corners, len(without.balls)) == (None, None, 1)
    page.click("#undo")
    page.wait_for(5)
    choose = "const s = document.getElementById('sport'); s.value = 'tennis'; s.dispatchEvent(new Event('change'))"
    page.browser.execute_script(choose)
    chosen = page.wait_for(6)
    assert (chosen.sport, chosen.corners) == ("tennis", None)


# Corrections take a while to be sent, as from afar; a document, too.
SLOW_ANSWERS = """const own = window.fetch;
window.fetch = async (...given) => {
  const answer = await own(...given);
  await new Promise((resolve) => { setTimeout(resolve, 600); });
  return answer;
};"""


def test_what_is_corrected_while_a_correction_is_sent_is_not_lost(page: RallyPage) -> None:
    page.browser.execute_script(SLOW_ANSWERS)
    for row in (5, 9):
        page.show(row)
        page.click("#place")
        page.press(Keys.ENTER)
    page.click("#events button")
    page.show(12)
    page.press("v")
    page.show(20)
    page.browser.execute_script("document.querySelector('[data-corner]').focus()")
    page.press(Keys.ARROW_RIGHT)
    corrected = page.wait_for(4)
    assert [one.ball.frame for one in corrected.balls] == [5, 9]
    assert [one.to_frame for one in corrected.events] == [12], "as it was shown when the key was pressed"
    assert corrected.corners is not None
