"""The page in a real browser, all the way: an empty library, a clip, its answers, corrections, a comparison."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from selenium import webdriver
from selenium.common.exceptions import ElementClickInterceptedException, StaleElementReferenceException
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import Select, WebDriverWait
from support.app_servers import ask_app, serve_app
from support.browser import HANG_S, accessibility_violations, console_messages, open_chromium
from support.carom_start import Home

from pipeline.app.app_server import AppServer
from pipeline.app.job_queue import OPEN_STATES, Job, JobQueue
from pipeline.app.shot_library import Card, ShotLibrary
from pipeline.io.corrections_file import read_corrections

pytestmark = pytest.mark.slow

TOUCH_PX = 44
"""Least size of what a finger must hit."""
SMALL = f"""const touched = "button:not(.tick), .button, select, input:not([type=checkbox]), [role=tab], nav a";
return [...document.querySelectorAll(touched)].map((one) => [one, one.getBoundingClientRect()])
.filter(([one, box]) => box.width && !one.matches(".link") && box.height < {TOUCH_PX} - 0.5)
.map(([one]) => one.outerHTML.slice(0, 120))"""
"""Script: what is too small for a finger."""
SHOWN = """return [...document.querySelectorAll(arguments[0])]
.find((one) => one.checkVisibility() && one.innerText.includes(arguments[1]))"""
"""Script: the first element that is shown and has a text."""
FOREIGN = """return performance.getEntriesByType("resource").map((one) => one.name)
.filter((name) => !name.startsWith(location.origin) && !name.startsWith("data:") && !name.startsWith("blob:"))"""
"""Script: addresses of other machines that the page asked."""


ASKED = """return performance.getEntriesByType("resource").filter((one) => one.name.endsWith("/ask")).length"""
"""Script: how many questions the page has asked."""


@pytest.fixture(scope="module")
def browser() -> Iterator[webdriver.Chrome]:
    with open_chromium() as opened:
        yield opened


class Visitor:
    """Somebody who uses the page."""

    def __init__(self, browser: webdriver.Chrome) -> None:
        self.browser = browser

    def find(self, css: str, text: str = "") -> WebElement:
        """Wait for an element that is shown and has a text."""
        return self.wait(lambda: self.browser.execute_script(SHOWN, css, text))

    def click(self, css: str, text: str = "") -> None:
        """Click an element; the page may draw it again meanwhile."""

        def try_click() -> bool:
            one = self.find(css, text)
            self.browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", one)
            one.click()
            return True

        self.wait(try_click)

    def wait(self, condition: Callable[[], Any]) -> Any:
        """Wait until something is so."""
        passing = (StaleElementReferenceException, ElementClickInterceptedException)
        return WebDriverWait(self.browser, HANG_S, ignored_exceptions=passing).until(lambda _: condition())

    def ask(self, one: str, two: str) -> str:
        """Ask whether two bodies touched; return the verdict."""
        before = self.find(".answer .question").text
        for field, name in (("ask-one", one), ("ask-two", two)):
            Select(self.find(f"#{field}")).select_by_visible_text(name)
        self.wait(lambda: self.find(".answer .question").text != before)
        return self.find(".answer .verdict").text

    def require_faultless(self, *, is_phone: bool = False) -> None:
        """Require that the page fits, is accessible, and complains about nothing."""
        assert accessibility_violations(self.browser) == []
        wide, screen = self.browser.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert wide <= screen
        assert console_messages(self.browser) == []
        assert self.browser.execute_script(FOREIGN) == []
        assert "undefined" not in self.browser.find_element(By.TAG_NAME, "body").text
        if is_phone:
            assert self.browser.execute_script(SMALL) == []


def read_library(server: AppServer) -> list[dict[str, Any]]:
    shots = ask_app(server, "GET", "api/library")["shots"]
    assert isinstance(shots, list)
    return shots


def is_queue_idle(server: AppServer) -> bool:
    """Tell whether nothing runs or waits."""
    return not any(one["state"] in OPEN_STATES for one in ask_app(server, "GET", "api/library")["jobs"])


def test_a_visitor_goes_from_a_clip_to_answers_corrections_and_a_comparison(
    browser: webdriver.Chrome, own_home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pipeline.app.shot_routes as shot_routes

    monkeypatch.setenv("TRUEROLL_CACHE", str(own_home.cache))
    monkeypatch.setattr(shot_routes, "write_share_clip", lambda *given: given[-1].write_bytes(b"a clip"))
    library = tmp_path / "library"
    library.mkdir()
    visitor = Visitor(browser)
    with serve_app(library) as server:
        browser.get(server.url)
        visitor.find(".drop.large")
        visitor.require_faultless()

        # A clip is dropped; the page is closed and opened again while it runs.
        browser.find_element(By.ID, "chooser").send_keys(str(own_home.clip))
        visitor.find(".job", "start")
        browser.refresh()
        visitor.find(".job, .card", "start")
        visitor.click(".card h2 a", "start")

        # The first answer is there, without a question.
        assert "sure" in visitor.find(".answer .verdict").text
        assert "pocket" not in visitor.find(".plan figcaption").text, "a carom table has none"
        visitor.require_faultless()

        # Three questions.
        shot = read_library(server)[0]["id"]
        document = ask_app(server, "GET", f"api/shots/{shot}")
        names = [ball["name"] for ball in document["run"]["balls"]]
        rails = document["run"]["rails"]
        verdicts = [
            visitor.ask(names[0], names[1]),
            visitor.ask(names[0], rails["left"]),
            visitor.ask(names[1], rails["top"]),
        ]
        assert all("sure" in verdict for verdict in verdicts)

        # The same shot is played otherwise.
        visitor.click("#tab-play")
        browser.execute_script("document.getElementById('speed_percent').focus()")
        webdriver.ActionChains(browser).send_keys(Keys.ARROW_RIGHT * 5).perform()
        visitor.find(".measures dd", "%")
        assert browser.find_elements(By.CSS_SELECTOR, ".path.played")
        visitor.require_faultless()

        # A class and a contact are corrected.
        visitor.click("#tab-correct")
        visitor.click("#balls button", names[0])
        other = next(one for one in document["run"]["classes"] if one != document["run"]["balls"][0]["kind"])
        asked = browser.execute_script(ASKED)
        visitor.click(f"#selection [data-class={other}]")
        clip = next((library / "clips").glob("*.mp4"))
        visitor.wait(lambda: read_corrections(clip).corrections.tracks)
        assert read_corrections(clip).corrections.tracks[0].name == other
        visitor.wait(lambda: ask_app(server, "GET", f"api/shots/{shot}/status")["result"] == 1)
        version = ask_app(server, "GET", f"api/shots/{shot}")["version"]
        visitor.wait(lambda: version in str(visitor.find("#frame").get_attribute("src")))
        visitor.wait(lambda: browser.execute_script(ASKED) > asked)  # the answer is that of the corrected shot
        visitor.click("#events button", "touch")
        visitor.click("#selection [data-action=delete]")
        visitor.wait(lambda: read_corrections(clip).corrections.contacts)
        visitor.wait(lambda: ask_app(server, "GET", f"api/shots/{shot}/status")["result"] == 2)
        visitor.find("#changes li:not(.small)")
        visitor.require_faultless()
        visitor.click("#undo")
        visitor.wait(lambda: not read_corrections(clip).corrections.contacts)

        # Share.
        visitor.click(".shot-head button", "Share")
        visitor.find("dialog a[download]")
        assert accessibility_violations(browser) == []
        visitor.click("dialog .main")

        # Three shots are compared; one is deleted, and comes back.
        for copy in ("again", "once-more"):
            shutil.copytree(next(library.glob("start*")), library / copy)
        visitor.click(".back")
        for k in range(3):
            visitor.wait(lambda: len(browser.find_elements(By.CSS_SELECTOR, ".card input")) == 3)
            browser.execute_script("document.querySelectorAll('.card input')[arguments[0]].click()", k)
        visitor.click(".selection-bar button", "Compare")
        visitor.wait(lambda: any(one["kind"] == "session" for one in read_library(server)))
        visitor.wait(lambda: is_queue_idle(server))  # nothing is deleted that is still written
        visitor.click(".card .pick")
        visitor.click(".selection-bar .danger")
        visitor.wait(lambda: len(read_library(server)) == 3)
        visitor.click(".notice button:not(.icon)")
        visitor.wait(lambda: len(read_library(server)) == 4)
        visitor.require_faultless()
        session = next(one for one in read_library(server) if one["kind"] == "session")
        browser.get(f"{server.url}#/session/{session['id']}")
        browser.switch_to.frame(visitor.find("iframe"))
        visitor.find("h1")
        browser.switch_to.default_content()
        with open_chromium(390) as phone:
            look_around_on_a_phone(Visitor(phone), f"{server.url}#/shot/{shot}", names)
        browser.get("about:blank")


def look_around_on_a_phone(visitor: Visitor, address: str, names: list[str]) -> None:
    """Ask, and look at all parts of a shot and at the library."""
    visitor.browser.get(address)
    assert "sure" in visitor.find(".answer .verdict").text
    assert "sure" in visitor.ask(names[1], names[2])
    for tab, shown in (
        ("story", ".list"),
        ("numbers", ".numbers"),
        ("placement", ".ball-place"),
        ("correct", "#balls"),
    ):
        visitor.click(f"#tab-{tab}")
        visitor.find(shown)
        visitor.require_faultless(is_phone=True)
    visitor.click(".back")
    visitor.find(".card")
    visitor.require_faultless(is_phone=True)


CARDS = 2000
SOON_MS = 100
"""Time within which scrolling and filtering show their result, ms."""
MEASURE = """const done = arguments[arguments.length - 1];
(async () => {
  const search = document.getElementById("search");
  const settle = async (isDone) => { while (!isDone()) await new Promise((resolve) => setTimeout(resolve)); };
  const names = () => [...document.querySelectorAll(".card h2")].map((one) => one.innerText);
  const times = {filter: [], scroll: []};
  for (let k = 0; k < 5; k += 1) {
    const name = `take ${1100 + k}`;
    let start = performance.now();
    search.value = name;
    search.dispatchEvent(new Event("input", {bubbles: true}));
    await settle(() => names().join() === name);
    times.filter.push(performance.now() - start);
    search.value = "";
    search.dispatchEvent(new Event("input", {bubbles: true}));
    await settle(() => names().length > 1);
    const before = names()[0];
    start = performance.now();
    scrollTo(0, (k + 1) * 9000);
    await settle(() => names()[0] !== before);
    times.scroll.push(performance.now() - start);
  }
  done({...times, cards: document.querySelectorAll(".card").length, top: scrollY});
})();"""
"""Script: times, ms, of filtering and scrolling, each five times, and how many cards are in the document then."""


def test_two_thousand_shots_are_filtered_and_scrolled_at_once(
    browser: webdriver.Chrome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cards = [
        Card(f"{k:04d}", f"take {k:04d}", f"take {k:04d}", "shot", "2026-01-02T03:04:05+00:00", 0.0, "pool-9ft", 6,
             3.0, "high", "The cue ball hit red 3 first", False, "done", "", "report.html", 1000)
        for k in range(CARDS)
    ]  # fmt: skip
    monkeypatch.setattr(ShotLibrary, "list_cards", lambda _: cards)
    with serve_app(tmp_path) as server:
        browser.get(server.url)
        Visitor(browser).find(".card")
        times = browser.execute_async_script(MEASURE)
        browser.get("about:blank")
    assert times["top"] > 40_000
    assert times["cards"] < 80
    assert min(times["filter"]) < SOON_MS  # the least of five: the others measure what else the machine does
    assert min(times["scroll"]) < SOON_MS


MOVE = """const [isFinal, predicts, done] = arguments;
(async () => {
  const at = (name) => import(new URL(name, document.baseURI));
  const [{ html }, { render }, { createStore }, { PlayTab }] =
    await Promise.all(["html.js", "vendor/preact.js", "store.js", "tabs/play_tab.js"].map(at));
  const root = document.body.appendChild(document.createElement("main"));
  const move = (value) => {
    const slider = root.querySelector("#speed_percent");
    slider.value = value;
    slider.dispatchEvent(new Event("input", { bubbles: true }));
  };
  const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  const asked = [];
  window.fetch = async (path, { body, signal }) => {
    const given = JSON.parse(body);
    const own = path === "predict" ? "predicted" : `${given.speed_percent}${given.is_quick ? " quickly" : ""}`;
    asked.push(own);
    if (own === "1 quickly" && !predicts) setTimeout(() => move(2));
    await wait(own === "1 quickly" ? 20 : 800);
    if (signal.aborted) throw new DOMException("", "AbortError");
    return new Response(JSON.stringify({ sentences: [own], is_final: isFinal || !given.is_quick }));
  };
  const desk = createStore({ played: null });
  const player = { clock: createStore({ t: 0 }) };
  render(html`<${PlayTab} shot=${{ desk, player, address: (path) => path }} />`, root);
  move(1);
  if (predicts) [...root.querySelectorAll("button")].at(-1).click();
  await wait(2500);
  done([asked, desk.get().played.sentences[0]]);
})();"""
"""Script: two moves of a slider, the second while the first is answered, or a prediction after one move; what is asked
for, and what is shown in the end."""


@pytest.mark.parametrize("is_final", [True, False])
def test_what_is_asked_last_is_shown(is_final: bool, browser: webdriver.Chrome, tmp_path: Path) -> None:
    with serve_app(tmp_path) as server:
        browser.get(server.url)
        moved = browser.execute_async_script(MOVE, is_final, False)
        browser.refresh()
        predicted = browser.execute_async_script(MOVE, is_final, True)
        browser.get("about:blank")
    assert moved == [["1 quickly", "2 quickly", *(() if is_final else ("2",))], "2 quickly" if is_final else "2"]
    assert predicted == [["predicted"], "predicted"]


def test_corners_are_marked_on_a_clip_whose_table_was_not_found(browser: webdriver.Chrome, tmp_path: Path) -> None:
    with serve_app(tmp_path) as server:
        queue = server.queue
        home = server.library.own / "queue"
        home.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(home / "1.jpg"), np.full((360, 640, 3), 90, np.uint8))
        failed = Job("1", "far.mp4", "far", str(tmp_path / "far.mp4"), state="failed", error="far.mp4 shows no table",
                     remedy="corners", frame_size=(1280, 720), preview_revision=1, ended=time.time())  # fmt: skip
        (home / "1.json").write_text(json.dumps(asdict(failed)))
        visitor = Visitor(browser)
        browser.get(server.url)
        visitor.click(".small-job .main")
        picture = visitor.find("#corner-frame")
        visitor.wait(lambda: picture.get_property("naturalWidth"))
        assert accessibility_violations(browser) == []
        handles = browser.find_elements(By.CSS_SELECTOR, ".corner-handle")
        webdriver.ActionChains(browser).click_and_hold(handles[0]).move_by_offset(-30, -20).perform()
        assert visitor.find("#lens")
        webdriver.ActionChains(browser).release().perform()
        handles[2].send_keys(Keys.SHIFT, Keys.ARROW_RIGHT)
        Select(visitor.find("#corner-sport")).select_by_value("tennis")
        width, height = picture.size["width"], picture.size["height"]
        visitor.click("dialog .main")
        visitor.wait(lambda: "corners" in read_settings(queue))
        browser.get("about:blank")
    settings = read_settings(queue)
    shares = (np.array(settings["corners"].split(","), float).reshape(4, 2) + 0.5) / [1280, 720]
    moved = [[0.2 - 30 / width, 0.25 - 20 / height], [0.8, 0.25], [0.8 + 10 / width, 0.75], [0.2, 0.75]]
    assert shares == pytest.approx(np.array(moved), abs=1.5 / height)
    assert settings["sport"] == "tennis"


def read_settings(queue: JobQueue) -> dict[str, Any]:
    """Read the settings that were given to the only job of a queue."""
    (path,) = queue._home.glob("*.json")
    settings = json.loads(path.read_text())["settings"]
    assert isinstance(settings, dict)
    return settings
