"""Debian's Chromium without a window, for tests of pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from axe_core_python.selenium import Axe
from selenium import webdriver

DRIVER = "chromedriver"
RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"]}
"""What a page is checked for: WCAG 2.1, level AA."""


@contextmanager
def chromium(width: int = 1280, *, draws: bool = False) -> Iterator[webdriver.Chrome]:
    """A browser with a window of this width, px; below 600 it is a phone. One that `draws` has WebGL, in software."""
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
    browser.set_script_timeout(60)
    try:
        yield browser
    finally:
        browser.quit()


def complaints(browser: webdriver.Chrome) -> list[str]:
    """What the browser's console was told that is not mere information."""
    return [line["message"] for line in browser.get_log("browser") if line["level"] in ("WARNING", "SEVERE")]


def barriers(browser: webdriver.Chrome) -> list[str]:
    """Where the page that is shown keeps people out, as axe-core finds it."""
    found = Axe().run(browser, options=RULES)
    return [f"{one['id']}: {node['html'][:200]}" for one in found["violations"] for node in one["nodes"]]


def page_of(path: Path, browser: webdriver.Chrome) -> webdriver.Chrome:
    """The browser, showing the page."""
    browser.get(path.resolve().as_uri())
    return browser
