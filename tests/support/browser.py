"""Headless Chromium for tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from axe_core_python.selenium import Axe
from selenium import webdriver
from selenium.webdriver.support.ui import WebDriverWait

DRIVER = "chromedriver"
HANG_S = 300
"""Time after which a page hangs, s."""
DRAWN = "return !document.getElementById('plotly') || document.body.dataset.drawn"
"""Script: whether a page has drawn its figures, or has none."""
RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]}
"""Rules of axe-core: WCAG 2.1, level AA."""


@contextmanager
def open_chromium(width: int = 1280, *, draws: bool = False) -> Iterator[webdriver.Chrome]:
    """Open a browser with a window of this width (px), below 600 emulating a phone; with `draws`, WebGL in software."""
    driver = shutil.which(DRIVER)
    if driver is None:
        pytest.skip("chromedriver is not installed; apt-get install chromium-driver")
    options = webdriver.ChromeOptions()
    graphics = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader") if draws else ("--disable-gpu",)
    for argument in ("--headless=new", "--no-sandbox", *graphics, f"--window-size={width},900"):
        options.add_argument(argument)
    if width < 600:
        options.add_experimental_option("mobileEmulation", {"deviceMetrics": {"width": width, "height": 800}})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    browser.set_script_timeout(HANG_S)
    try:
        yield browser
    finally:
        browser.quit()


def wait_on(browser: webdriver.Chrome) -> WebDriverWait[webdriver.Chrome]:
    """Wait for something on a page, however slow the machine is."""
    return WebDriverWait(browser, HANG_S)


def show_frame(browser: webdriver.Chrome, row: int) -> None:
    """Move the slider of a shot to a row of its frames."""
    script = "const s = document.getElementById('slider'); s.value = arguments[0]; s.dispatchEvent(new Event('input'))"
    browser.execute_script(script, row)


def console_messages(browser: webdriver.Chrome) -> list[str]:
    """Return the warnings and errors of the browser console."""
    return [line["message"] for line in browser.get_log("browser") if line["level"] in ("WARNING", "SEVERE")]


def accessibility_violations(browser: webdriver.Chrome) -> list[str]:
    """Return the accessibility violations of the page that axe-core finds."""
    results = Axe().run(browser, options=RULES)
    return [f"{one['id']}: {node['html'][:200]}" for one in results["violations"] for node in one["nodes"]]


def open_page(path: Path, browser: webdriver.Chrome) -> webdriver.Chrome:
    """Open a page in the browser, and wait until its figures are drawn."""
    browser.get(path.resolve().as_uri())
    wait_on(browser).until(lambda b: b.execute_script(DRAWN))
    return browser
