"""The page of the editor in a real browser: by mouse, by touch and by keys, on a desk and on a phone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from support.browser import accessibility_violations, console_messages, open_chromium, wait_on
from support.edit_servers import serve_synthetic_run, wait_for_result

from models.core.corrections import BallPlace, ContactCorrection, Corrections
from models.core.fit_result import MarkOutcome
from pipeline.editing.edit_server import EditServer
from pipeline.io.corrections_file import CorrectionsFile, read_corrections, write_corrections

WIDTHS = (1280, 390)
desk_only = pytest.mark.parametrize("browser", WIDTHS[:1], indirect=True)
"""For what does not depend on the width of the screen."""


@pytest.fixture(scope="module", params=WIDTHS)
def browser(request: pytest.FixtureRequest) -> Iterator[webdriver.Chrome]:
    with open_chromium(request.param) as opened:
        yield opened


@pytest.fixture
def server(tmp_path: Path) -> Iterator[EditServer]:
    with serve_synthetic_run(tmp_path) as served:
        yield served


def open_editor(browser: webdriver.Chrome, server: EditServer) -> None:
    browser.get(server.url)
    wait_on(browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#events button"))
    wait_on(browser).until(lambda b: b.execute_script("return document.getElementById('frame').naturalWidth"))


def press(browser: webdriver.Chrome, *keys: str) -> None:
    webdriver.ActionChains(browser).send_keys(*keys).perform()


def saved_keys(folder: Path) -> tuple[object, ...]:
    corrections = read_corrections(folder / "shot.mp4").corrections
    return corrections.balls, corrections.tracks, corrections.contacts


def test_the_page_complains_about_nothing_and_fits_the_screen(browser: webdriver.Chrome, server: EditServer) -> None:
    open_editor(browser, server)
    browser.find_elements(By.CSS_SELECTOR, "#balls button")[0].click()
    assert accessibility_violations(browser) == []
    browser.find_elements(By.CSS_SELECTOR, "#events button")[0].click()
    assert accessibility_violations(browser) == []
    wide, screen = browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= screen
    assert console_messages(browser) == []


@desk_only
def test_one_key_goes_through_the_places_to_check(browser: webdriver.Chrome, server: EditServer) -> None:
    open_editor(browser, server)
    reasons = [one.text.partition(" s\n")[2] for one in browser.find_elements(By.CSS_SELECTOR, "#checks button")]
    shown = []
    for _ in reasons:
        press(browser, "n")
        shown.append(browser.find_element(By.ID, "hint-text").text.partition(": ")[2])
        assert browser.find_element(By.ID, "when").text != "frame 0, 0.000 s"
    assert len(reasons) > 1
    assert [one.replace("\n", " ") for one in shown] == [one.replace("\n", " ") for one in reasons]


@desk_only
def test_a_missed_ball_is_placed_by_keys_alone(browser: webdriver.Chrome, server: EditServer, tmp_path: Path) -> None:
    open_editor(browser, server)
    press(browser, "b", Keys.ARROW_LEFT, Keys.ARROW_UP)
    assert browser.find_element(By.ID, "lens").is_displayed()
    press(browser, Keys.ENTER)
    wait_for_result(server)
    (mark,) = read_corrections(tmp_path / "shot.mp4").corrections.balls
    assert (mark.kind, mark.ball.frame, mark.ball.x_px, mark.ball.y_px) == ("placed", 0, 119.0, 69.0)
    press(browser, "z")
    wait_on(browser).until(lambda _: saved_keys(tmp_path) == ((), (), ()))


@desk_only
def test_a_corner_is_moved_by_arrow_keys(browser: webdriver.Chrome, server: EditServer, tmp_path: Path) -> None:
    open_editor(browser, server)
    corner = browser.find_elements(By.CSS_SELECTOR, ".corner")[2]
    browser.execute_script("arguments[0].focus()", corner)
    press(browser, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").corrections.corners)
    corners = read_corrections(tmp_path / "shot.mp4").corrections.corners
    assert corners == ((20.0, 20.0), (220.0, 20.0), (221.0, 120.0), (20.0, 120.0))


def test_a_ball_is_touched_and_renamed(browser: webdriver.Chrome, server: EditServer, tmp_path: Path) -> None:
    open_editor(browser, server)
    ring = browser.find_element(By.CSS_SELECTOR, "[data-ball=red]")
    webdriver.ActionChains(browser).move_to_element(ring).click().perform()
    field = browser.find_element(By.ID, "ball-name")
    field.clear()
    field.send_keys("object", Keys.ENTER)
    wait_for_result(server)
    wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").corrections.tracks)
    assert read_corrections(tmp_path / "shot.mp4").corrections.tracks[0].name == "object"


def test_placing_a_ball_leaves_the_picture_where_it_is(browser: webdriver.Chrome, server: EditServer) -> None:
    open_editor(browser, server)
    place = (
        "const box = document.getElementById('frame').getBoundingClientRect(); return [box.left, box.top, box.width]"
    )
    before = browser.execute_script(place)
    press(browser, "b")
    assert browser.find_element(By.ID, "cancel").is_displayed()
    assert browser.execute_script(place) == before


@desk_only
def test_keys_and_selection_stay_with_a_ball_that_is_called_otherwise(
    browser: webdriver.Chrome, server: EditServer
) -> None:
    open_editor(browser, server)
    press(browser, "1")
    heading = browser.find_element(By.CSS_SELECTOR, "#selection h2")
    first = heading.text
    balls = [{**ball, "name": ball["name"].upper(), "id": f"{ball['id']}-9"} for ball in server.session._view["balls"]]
    server.session._view = {**server.session._view, "balls": balls[::-1]}
    server.session._result += 1
    wait_on(browser).until(lambda b: b.find_element(By.CSS_SELECTOR, "#selection h2").text == first.upper())
    press(browser, Keys.ESCAPE, "2", "1")
    assert browser.find_element(By.CSS_SELECTOR, "#selection h2").text == first.upper()


@desk_only
def test_an_error_vanishes_when_the_run_works_again(browser: webdriver.Chrome, server: EditServer) -> None:
    open_editor(browser, server)
    message = browser.find_element(By.ID, "message")
    for error in ("The fit broke.", ""):
        server.session._error = error
        wait_on(browser).until(lambda _, shown=bool(error): message.is_displayed() == shown)


WHITE = BallPlace(15, 90.0, 70.0, "white")
DELETED = ContactCorrection("delete", "cushion", 15.0, WHITE, cushion="right")


@desk_only
def test_a_mark_replaces_the_deletion_of_the_same_contact(browser: webdriver.Chrome, tmp_path: Path) -> None:
    other = replace(DELETED, cushion="left")
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(1, "", Corrections(contacts=(DELETED, other))))
    with serve_synthetic_run(tmp_path) as server:
        open_editor(browser, server)
        browser.execute_script(
            "const s = document.getElementById('slider'); s.value = 14; s.dispatchEvent(new Event('input'))"
        )
        press(browser, "1", "c")
        browser.find_element(By.XPATH, "//section[@id='selection']//button[starts-with(text(),'right ')]").click()
        wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").revision == 2)
    kept, mark = read_corrections(tmp_path / "shot.mp4").corrections.contacts
    assert (kept, mark.kind, mark.frame, mark.cushion) == (other, "mark", 14, "right")


@desk_only
def test_a_contradicted_correction_is_removed_where_the_contradiction_is_shown(
    browser: webdriver.Chrome, tmp_path: Path
) -> None:
    other = replace(DELETED, frame=5.0)
    outcome = MarkOutcome("delete", "change_remains", ("white",), "right", 0.5)
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(1, "", Corrections(contacts=(other, DELETED))))
    with serve_synthetic_run(tmp_path, outcomes=(outcome,)) as server:
        open_editor(browser, server)
        line = browser.find_element(By.CSS_SELECTOR, "#changes .against")
        assert line.text.startswith("The contact of white and the right short rail at about 0.5 s was deleted by hand")
        line.find_element(By.TAG_NAME, "button").click()
        wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").revision == 2)
    assert read_corrections(tmp_path / "shot.mp4").corrections.contacts == (other,)


@desk_only
def test_a_deleted_contact_that_was_moved_before_stays_deleted(browser: webdriver.Chrome, tmp_path: Path) -> None:
    moved = replace(DELETED, kind="move", frame=11.0, to_frame=15.0)
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(1, "", Corrections(contacts=(moved,))))
    with serve_synthetic_run(tmp_path) as server:
        open_editor(browser, server)
        browser.find_elements(By.CSS_SELECTOR, "#events button")[1].click()
        press(browser, Keys.DELETE)
        wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").revision == 2)
    assert read_corrections(tmp_path / "shot.mp4").corrections.contacts == (replace(DELETED, frame=11.0),)


@desk_only
def test_a_second_tab_shows_what_the_first_one_changed_and_a_late_change_is_refused(
    browser: webdriver.Chrome, server: EditServer, tmp_path: Path
) -> None:
    open_editor(browser, server)
    # stop the polling of this tab, so that it does not hear of the change of another one
    browser.execute_script("window.fetch = ((real) => (path, ...rest) => path === 'status' ? new Promise(() => {})"
                           " : real(path, ...rest))(window.fetch)")  # fmt: skip
    first = browser.current_window_handle
    browser.switch_to.new_window("tab")
    try:
        open_editor(browser, server)
        press(browser, "1", Keys.DELETE)
        wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").corrections.balls)
    finally:
        browser.close()
        browser.switch_to.window(first)
    press(browser, "2", "s")
    message = wait_on(browser).until(lambda b: b.find_element(By.ID, "message").text)
    assert "The corrections were changed in another tab or program (revision 1, yours is 0)" in message
    assert len(read_corrections(tmp_path / "shot.mp4").corrections.tracks) == 0
    press(browser, "2", "s")
    wait_on(browser).until(lambda _: read_corrections(tmp_path / "shot.mp4").corrections.tracks)
    assert len(read_corrections(tmp_path / "shot.mp4").corrections.balls) == 1
