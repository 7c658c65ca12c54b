"""Corrections on the page in a real browser: by mouse, by touch and by keys, on a desk and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from support.app_servers import serve_synthetic_shot, wait_for_corrections
from support.browser import accessibility_violations, console_messages, open_chromium, show_frame, wait_on

from models.core.corrections import BallPlace, ContactCorrection, Corrections
from models.core.fit_result import MarkOutcome
from pipeline.app.app_server import AppServer
from pipeline.io.corrections_file import CorrectionsFile, read_corrections, write_corrections

pytestmark = pytest.mark.slow

WIDTHS = (1280, 390)
desk_only = pytest.mark.parametrize("browser", WIDTHS[:1], indirect=True)
"""For what does not depend on the width of the screen."""


@pytest.fixture(scope="module", params=WIDTHS)
def browser(request: pytest.FixtureRequest) -> Iterator[webdriver.Chrome]:
    with open_chromium(request.param) as opened:
        yield opened


@dataclass(frozen=True)
class ShotPage:
    """The page of a shot, open for corrections."""

    browser: webdriver.Chrome
    server: AppServer
    shot: str
    clip: Path

    def open(self) -> None:
        self.browser.get("about:blank")  # the address differs in its last part only
        self.browser.get(f"{self.server.url}#/shot/{self.shot}")
        wait_on(self.browser).until(lambda b: b.find_elements(By.ID, "tab-correct"))
        self.browser.execute_script("document.getElementById('tab-correct').click()")
        wait_on(self.browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#events button"))
        wait_on(self.browser).until(lambda b: b.execute_script("return document.getElementById('frame')?.naturalWidth"))

    def press(self, *keys: str) -> None:
        webdriver.ActionChains(self.browser).send_keys(*keys).perform()

    def show(self, frame: int) -> None:
        show_frame(self.browser, frame)

    def read(self) -> CorrectionsFile:
        return read_corrections(self.clip)

    def wait_for_revision(self, revision: int) -> Corrections:
        wait_on(self.browser).until(lambda _: self.read().revision == revision)
        return self.read().corrections


@pytest.fixture
def page(browser: webdriver.Chrome, tmp_path: Path) -> Iterator[ShotPage]:
    with serve_synthetic_shot(tmp_path) as (server, shot):
        opened = ShotPage(browser, server, shot, tmp_path / "shot.mp4")
        opened.open()
        yield opened
        browser.get("about:blank")


def test_the_page_complains_about_nothing_and_fits_the_screen(page: ShotPage) -> None:
    for css in ("#balls button", "#events button"):
        button = page.browser.find_element(By.CSS_SELECTOR, css)
        page.browser.execute_script("arguments[0].click()", button)
        assert accessibility_violations(page.browser) == []
    wide, screen = page.browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= screen
    assert console_messages(page.browser) == []


@desk_only
def test_one_key_goes_through_the_places_to_check(page: ShotPage) -> None:
    reasons = [one.text.partition(" s\n")[2] for one in page.browser.find_elements(By.CSS_SELECTOR, "#checks button")]
    assert len(reasons) > 1
    for reason in reasons:
        page.press("d")
        wait_on(page.browser).until(
            lambda b, words=reason: b.find_element(By.ID, "hint-text").text.partition(": ")[2] == words
        )
        assert page.browser.find_element(By.ID, "when").text != "frame 0, 0.000 s"


@desk_only
def test_keys_place_a_ball_and_move_a_corner(page: ShotPage) -> None:
    page.press("b", Keys.ARROW_LEFT, Keys.ARROW_UP)
    wait_on(page.browser).until(lambda b: b.find_element(By.ID, "lens").is_displayed())
    page.press(Keys.ENTER)
    (mark,) = page.wait_for_revision(1).balls
    assert (mark.kind, mark.ball.frame, mark.ball.x_px, mark.ball.y_px) == ("placed", 0, 119.0, 69.0)
    wait_for_corrections(page.server, page.shot)
    wait_on(page.browser).until(lambda b: b.find_element(By.ID, "undo").is_enabled())
    page.press("z")
    assert page.wait_for_revision(2) == Corrections()
    wait_for_corrections(page.server, page.shot)
    wait_on(page.browser).until(lambda b: b.find_element(By.ID, "redo").is_enabled())  # the page has drawn that too
    corner = page.browser.find_elements(By.CSS_SELECTOR, ".corner")[2]
    page.browser.execute_script("arguments[0].focus()", corner)
    page.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert page.wait_for_revision(3).corners == ((20.0, 20.0), (220.0, 20.0), (221.0, 120.0), (20.0, 120.0))


def test_a_ball_is_touched_and_renamed_and_placing_one_leaves_the_picture_where_it_is(page: ShotPage) -> None:
    ring = page.browser.find_element(By.CSS_SELECTOR, "[data-ball=red]")
    webdriver.ActionChains(page.browser).move_to_element(ring).click().perform()
    field = wait_on(page.browser).until(lambda b: b.find_element(By.ID, "ball-name"))
    field.clear()
    field.send_keys("object", Keys.ENTER)
    assert page.wait_for_revision(1).tracks[0].name == "object"
    wait_for_corrections(page.server, page.shot)
    place = (
        "const box = document.getElementById('frame').getBoundingClientRect(); return [box.left, box.top, box.width]"
    )
    before = page.browser.execute_script(place)
    page.press("b")
    wait_on(page.browser).until(lambda b: b.find_element(By.ID, "cancel").is_displayed())
    assert page.browser.execute_script(place) == before


WHITE = BallPlace(15, 90.0, 70.0, "white")
DELETED = ContactCorrection("delete", "cushion", 15.0, WHITE, cushion="right")


def open_corrected(
    browser: webdriver.Chrome, folder: Path, contacts: tuple[ContactCorrection, ...], *outcomes: MarkOutcome
) -> Iterator[ShotPage]:
    write_corrections(folder / "shot.mp4", CorrectionsFile(1, "", Corrections(contacts=contacts)))
    with serve_synthetic_shot(folder, outcomes) as (server, shot):
        opened = ShotPage(browser, server, shot, folder / "shot.mp4")
        opened.open()
        wait_for_corrections(server, shot)
        yield opened
        browser.get("about:blank")


@desk_only
def test_a_mark_replaces_the_deletion_of_the_same_contact(browser: webdriver.Chrome, tmp_path: Path) -> None:
    other = replace(DELETED, cushion="left")
    for page in open_corrected(browser, tmp_path, (DELETED, other)):
        page.show(14)
        page.press("1", "c")
        rail = "//section[@id='selection']//button[starts-with(text(),'right ')]"
        wait_on(browser).until(lambda b, path=rail: b.find_element(By.XPATH, path)).click()
        kept, mark = page.wait_for_revision(2).contacts
    assert (kept, mark.kind, mark.frame, mark.cushion) == (other, "mark", 14, "right")


@desk_only
def test_a_contradicted_correction_is_removed_where_the_contradiction_is_shown(
    browser: webdriver.Chrome, tmp_path: Path
) -> None:
    other = replace(DELETED, frame=5.0)
    outcome = MarkOutcome("delete", "change_remains", ("white",), "right", 0.5)
    for page in open_corrected(browser, tmp_path, (other, DELETED), outcome):
        line = wait_on(browser).until(lambda b: b.find_element(By.CSS_SELECTOR, "#changes .against"))
        assert line.text.startswith("The contact of white and the right short rail at about 0.5 s was deleted by hand")
        line.find_element(By.TAG_NAME, "button").click()
        assert page.wait_for_revision(2).contacts == (other,)


@desk_only
def test_a_deleted_contact_that_was_moved_before_stays_deleted(browser: webdriver.Chrome, tmp_path: Path) -> None:
    moved = replace(DELETED, kind="move", frame=11.0, to_frame=15.0)
    for page in open_corrected(browser, tmp_path, (moved,)):
        browser.find_elements(By.CSS_SELECTOR, "#events button")[1].click()
        page.press(Keys.DELETE)
        assert page.wait_for_revision(2).contacts == (replace(DELETED, frame=11.0),)


@desk_only
def test_a_second_tab_shows_what_the_first_one_changed(page: ShotPage) -> None:
    browser, first = page.browser, page.browser.current_window_handle
    browser.switch_to.new_window("tab")
    try:
        page.open()
        page.press("1", Keys.DELETE)
        assert len(page.wait_for_revision(1).balls) == 1
    finally:
        browser.close()
        browser.switch_to.window(first)
    wait_on(browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#by-hand li"))
    page.press("2", "s")
    corrections = page.wait_for_revision(2)
    assert (len(corrections.balls), len(corrections.tracks)) == (1, 1)
