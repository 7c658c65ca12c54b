"""Twelve kinds of mistakes repaired on the page, each in at most three clicks or keys."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select
from support.app_servers import serve_app, wait_for_corrections
from support.browser import console_messages, open_chromium, show_frame, wait_on
from support.planted_mistakes import (
    FALSE_PLACE,
    LOST_FRAME,
    MISTAKES,
    ONE_CORNER,
    SPLIT_FRAME,
    CleanRun,
    Mistake,
    SilentWatcher,
    list_differences,
    plant,
    point_of,
    prepare_mistake,
    run_clip_tables,
)

from models.core.typing import FloatArray
from pipeline.app.app_server import AppServer
from pipeline.chain import run_tables
from pipeline.editing.run_view import ClipRun
from pipeline.engine.result_cache import ResultCache
from pipeline.io.corrections_file import read_corrections
from pipeline.run_options import build_options

pytestmark = pytest.mark.slow


@dataclass(slots=True)
class Editor:
    """The page, and how often it was clicked or a key was pressed."""

    browser: webdriver.Chrome
    server: AppServer
    shot: str
    count: int = 0

    def show(self, frame: int) -> None:
        """Show a frame, which is no repair."""
        show_frame(self.browser, frame)

    def click(self, css: str, text: str = "") -> None:
        """Click the last button with a text."""
        self.count += 1
        # the page draws anew after every answer of the server
        buttons = wait_on(self.browser).until(
            lambda b: [one for one in b.find_elements(By.CSS_SELECTOR, css) if text in one.text]
        )
        buttons[-1].click()

    def click_at(self, px: FloatArray) -> None:
        """Click a place of the frame."""
        self.count += 1
        self._move_to(px).click().perform()

    def drag(self, start: FloatArray, end: FloatArray) -> None:
        """Drag from one place of the frame to another."""
        self.count += 1
        chain = self._move_to(start).click_and_hold()
        dx, dy = self._offset(end) - self._offset(start)
        chain.move_by_offset(round(dx), round(dy)).release().perform()

    def press(self, key: str) -> None:
        """Press a key."""
        self.count += 1
        webdriver.ActionChains(self.browser).send_keys(key).perform()

    def choose(self, name: str, value: str) -> None:
        """Choose from a list: one click opens it, another one selects."""
        self.count += 2
        Select(self.browser.find_element(By.ID, name)).select_by_visible_text(value)

    def _offset(self, px: FloatArray) -> FloatArray:
        width, height = self.browser.execute_script(
            "const b = document.getElementById('overlay').getBoundingClientRect(); return [b.width, b.height]"
        )
        image = wait_on(self.browser).until(
            lambda b: b.execute_script(
                "const f = document.getElementById('frame'); return f.complete ? f.naturalWidth : 0"
            )
        )
        return np.asarray((px + 0.5) * width / image - np.array([width, height]) / 2)

    def _move_to(self, px: FloatArray) -> webdriver.ActionChains:
        overlay = self.browser.find_element(By.ID, "overlay")
        x, y = self._offset(px)
        return webdriver.ActionChains(self.browser).move_to_element_with_offset(overlay, round(x), round(y))


def _exchange_back(editor: Editor, truth: ClipRun) -> None:
    editor.show(SPLIT_FRAME)
    editor.click_at(point_of(truth, "solid-1", SPLIT_FRAME))
    editor.press("x")
    editor.click_at(point_of(truth, "solid-2", SPLIT_FRAME))


def _place_ball(editor: Editor, truth: ClipRun) -> None:
    editor.press("b")
    editor.click_at(point_of(truth, "stripe-1", 0))


def _reject_ball(editor: Editor, truth: ClipRun) -> None:
    editor.show(20)
    editor.click_at(FALSE_PLACE)
    editor.press(Keys.DELETE)


def _mark_contact(editor: Editor, truth: ClipRun) -> None:
    editor.show(LOST_FRAME)
    editor.click_at(point_of(truth, "solid-1", LOST_FRAME))
    editor.press("c")
    _, _, right, left = truth.scene.camera.corners_px
    editor.click_at(0.3 * right + 0.7 * left)


def _reject_contact(editor: Editor, truth: ClipRun) -> None:
    editor.click("#events button", "The cue ball is struck")
    editor.press(Keys.DELETE)


def _join_tracks(editor: Editor, truth: ClipRun) -> None:
    state = wait_for_corrections(editor.server, editor.shot)
    (later,) = [ball["name"] for ball in state["run"]["balls"] if ball["path"][0][0] >= SPLIT_FRAME - 1]
    editor.show(SPLIT_FRAME - 5)
    editor.click_at(point_of(truth, "cue", SPLIT_FRAME - 5))
    editor.press("m")
    editor.click("#selection button", later)


def _cut_track(editor: Editor, truth: ClipRun) -> None:
    editor.show(SPLIT_FRAME)
    editor.click_at(point_of(truth, "stripe-2", SPLIT_FRAME))
    editor.press("s")


def _set_class(editor: Editor, truth: ClipRun) -> None:
    editor.click_at(point_of(truth, "cue", 0))
    editor.click("#selection [data-class=cue]")


def _drag_corner(editor: Editor, truth: ClipRun) -> None:
    state = wait_for_corrections(editor.server, editor.shot)
    editor.drag(np.array(state["run"]["corners"][0]), truth.scene.camera.corners_px[0])


REPAIRS: dict[str, Callable[[Editor, ClipRun], None]] = {
    "one corner off": _drag_corner,
    "all corners off": lambda editor, _: editor.click("#find-table"),
    "wrong table": lambda editor, _: editor.choose("table", "pool-9ft"),
    "wrong frame rate": lambda editor, _: editor.choose("fps", "30"),
    "identity switch": _exchange_back,
    "missed ball": _place_ball,
    "false ball": _reject_ball,
    "missed contact": _mark_contact,
    "false contact": _reject_contact,
    "split track": _join_tracks,
    "merged tracks": _cut_track,
    "wrong ball class": _set_class,
}


@pytest.fixture(scope="module")
def browser() -> Iterator[webdriver.Chrome]:
    with open_chromium(1400) as opened:
        yield opened


@contextmanager
def open_editor(browser: webdriver.Chrome, run: Path) -> Iterator[Editor]:
    """Open a run folder on the page, for corrections."""
    with serve_app(run.parent) as server:
        shot = server.library.identify(run)
        browser.get(f"{server.url}#/shot/{shot}")
        wait_on(browser).until(lambda b: b.find_elements(By.ID, "tab-correct"))
        browser.execute_script("document.getElementById('tab-correct').click()")
        wait_on(browser).until(lambda b: b.find_elements(By.CSS_SELECTOR, "#events button"))
        wait_for_corrections(server, shot)
        console_messages(browser)  # those of the page before
        yield Editor(browser, server, shot)
        browser.get("about:blank")


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda one: one.name)
def test_a_mistake_is_repaired_in_three_clicks(
    mistake: Mistake, clean: CleanRun, browser: webdriver.Chrome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = prepare_mistake(mistake, clean, tmp_path)
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    with plant(mistake, clean.run, clean.detections):
        wrong = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
        corners = [run.scene.camera.corners_px for run in (wrong, clean.run)]
        assert list_differences(wrong, clean.run) or np.ptp(corners[0] - corners[1])
        with open_editor(browser, tmp_path / "out") as editor:
            REPAIRS[mistake.name](editor, clean.run)
            wait_on(browser).until(lambda _: read_corrections(clip).revision == 2)
            wait_for_corrections(editor.server, editor.shot)
            # a question that a wrong run cannot answer is refused with a sentence, which the page shows
            messages = [one for one in console_messages(browser) if "/ask - " not in one]
        corrected = run_clip_tables(clip, tmp_path / "out", tmp_path / "cache")
    assert list_differences(corrected, clean.run) == []
    assert editor.count <= 3
    assert messages == []


def test_a_dragged_corner_beats_the_corners_of_the_run(
    clean: CleanRun, browser: webdriver.Chrome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(clean.detected, tmp_path / "cache")
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    clip = Path(shutil.copy(clean.clip, tmp_path))
    right = clean.run.scene.camera.corners_px
    wrong = ",".join(f"{value:.1f}" for value in (right + ONE_CORNER).ravel())
    options = build_options({"laws": False, "corners": wrong})
    run_tables(clip, tmp_path / "out", options, ResultCache(tmp_path / "cache"), SilentWatcher())
    with open_editor(browser, tmp_path / "out") as editor:
        editor.drag(right[0] + ONE_CORNER[0], right[0])
        wait_on(browser).until(lambda _: read_corrections(clip).revision == 1)
        shown = wait_for_corrections(editor.server, editor.shot)["run"]["corners"]
    assert np.abs(np.array(shown) - right).max() < 1.0
    assert list_differences(run_clip_tables(clip, tmp_path / "out", tmp_path / "cache"), clean.run) == []
