"""The viewer shows the table and the paths of a recording without touching anything."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from support import synthetic_run as shot
from support.browser import open_chromium

from models.core.ball_look import CLASS_COLOURS
from pipeline.reporting.recording.rerun_viewer import find_free_port, start_viewer
from pipeline.reporting.recording.stage_layers import write_recording
from video.drawing.palette import adapt_to_any_background

PATIENCE = 90.0
"""Time limit, s, for a viewer on a busy machine without a graphics card."""
OUTLINE = (120, 160, 140)
CLOTH = (30, 110, 70)


def headless_viewer_is_missing() -> str:
    """Return why no viewer can be opened here; empty if one can."""
    drivers = list(Path("/usr/share/vulkan/icd.d").glob("*.json"))
    if not drivers:
        return "no Vulkan driver; apt-get install mesa-vulkan-drivers"
    return "" if shutil.which("ffmpeg") else "the viewer decodes H.264 by ffmpeg; apt-get install ffmpeg"


def share_of(image: np.ndarray, colour: tuple[int, int, int], off: int = 12) -> float:
    """Return the share of pixels of a colour."""
    return float(np.all(np.abs(image.astype(int) - colour) <= off, axis=-1).mean())


def wait_for_screenshot(client: object, image: Path, is_expected: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Take screenshots until one is as expected or the time is over, and return the last."""
    deadline = time.monotonic() + PATIENCE
    while True:
        client.save_screenshot(str(image))  # type: ignore[attr-defined]
        screenshot = np.asarray(Image.open(image).convert("RGB"))
        if is_expected(screenshot) or time.monotonic() > deadline:
            return screenshot
        time.sleep(1.0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording of the synthetic shot."""
    clip = shot.write_clip(tmp_path / "clip.mp4")
    scene, tracks = shot.make_scene(), shot.make_tracks(clip, shot.make_scene())
    detections, fit = shot.make_detections(tracks), shot.make_fit(tracks.t)
    path = tmp_path / "recording.rrd"
    write_recording(clip, scene, detections, tracks, fit, path, "made up")
    return path


@pytest.mark.slow
def test_the_viewer_shows_the_table_beside_the_video_and_the_paths_on_both(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if why := headless_viewer_is_missing():
        pytest.skip(why)
    from rerun.experimental import ViewerClient

    monkeypatch.setenv("RERUN_ANALYTICS", "0")
    program = str(Path(sys.executable).with_name("rerun"))
    client = ViewerClient.spawn(
        headless=True, port=find_free_port(0), hide_welcome_screen=True, executable_path=program
    )
    try:
        client.open(str(recording))
        wait_for_screenshot(client, tmp_path / "first.png", lambda p: share_of(p, OUTLINE) > 1e-4)
        client.set_time("video_time", duration=0.6, play_state="paused")
        image = wait_for_screenshot(
            client, tmp_path / "seen.png", lambda p: share_of(p[:, : p.shape[1] // 2], CLOTH) > 0.05
        )
    finally:
        client.quit()
    left, right = np.split(image, [3 * image.shape[1] // 5], axis=1)
    assert share_of(left, CLOTH) > 0.05, "the clip on the left"
    assert share_of(right, OUTLINE) > 1e-3, "the table on the right"
    assert share_of(left, (240, 240, 235), off=20) > 2e-4, "the white ball and its way"
    assert share_of(right, adapt_to_any_background(CLASS_COLOURS["white"])) > 2e-4, "the white ball's way on any ground"


@pytest.mark.slow
def test_the_viewer_in_the_browser_shows_them_too(recording: Path, tmp_path: Path) -> None:
    with closing(start_viewer([recording], web=True)) as viewer, open_chromium(960, draws=True) as browser:
        browser.get(viewer.page_url + "&renderer=webgl")

        def both(image: np.ndarray) -> bool:
            left, right = np.split(image, [3 * image.shape[1] // 5], axis=1)
            return share_of(left, CLOTH) > 0.05 and share_of(right, OUTLINE) > 1e-3

        assert both(wait_for_screenshot(browser, tmp_path / "seen.png", both)), (
            "the clip on the left, the table on the right"
        )
        asked = browser.execute_script("return performance.getEntriesByType('resource').map((one) => one.name)")
        assert {urlsplit(url).hostname for url in asked} == {"127.0.0.1"}
