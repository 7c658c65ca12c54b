"""The viewer shows the table and the paths of a recording without touching anything."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support import synthetic_run as shot
from support.browser import chromium
from test_recording import made_up_fans

from pipeline.reporting.recording.recording_file import write_recording
from pipeline.reporting.recording.rerun_viewer import free_port, open_viewer
from video.drawing.palette import KIND_COLOURS, on_any_ground

PATIENCE = 90.0
"""s that a viewer on a busy machine without a graphics card may take."""
OUTLINE = (120, 160, 140)
CLOTH = (30, 110, 70)


def headless_viewer_is_missing() -> str:
    """Why no viewer can be opened here; empty where one can."""
    drivers = list(Path("/usr/share/vulkan/icd.d").glob("*.json"))
    if not drivers:
        return "no Vulkan driver; apt-get install mesa-vulkan-drivers"
    return "" if shutil.which("ffmpeg") else "the viewer decodes H.264 by ffmpeg; apt-get install ffmpeg"


def share_of(picture: np.ndarray, colour: tuple[int, int, int], off: int = 12) -> float:
    """Of the pixels, those of a colour."""
    return float(np.all(np.abs(picture.astype(int) - colour) <= off, axis=-1).mean())


def seen_when(client: object, picture: Path, told: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Screenshots until one shows what is awaited, and that one; the last where none does."""
    deadline = time.monotonic() + PATIENCE
    while True:
        client.save_screenshot(str(picture))  # type: ignore[attr-defined]
        seen = np.asarray(Image.open(picture).convert("RGB"))
        if told(seen) or time.monotonic() > deadline:
            return seen
        time.sleep(1.0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Of a made-up shot, fans and all."""
    clip = shot.made_up_clip(tmp_path / "clip.mp4")
    scene, tracks = shot.made_up_scene(), shot.made_up_tracks(clip, shot.made_up_scene())
    detections, fit = shot.made_up_detections(tracks), shot.made_up_fit(tracks.t)
    path = tmp_path / "recording.rrd"
    write_recording(clip, scene, detections, tracks, fit, made_up_fans(), path, "made up")
    return path


@pytest.mark.slow
def test_the_viewer_shows_the_table_beside_the_picture_and_the_paths_on_both(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if why := headless_viewer_is_missing():
        pytest.skip(why)
    from rerun.experimental import ViewerClient

    monkeypatch.setenv("RERUN_ANALYTICS", "0")
    program = str(Path(sys.executable).with_name("rerun"))
    client = ViewerClient.spawn(headless=True, port=free_port(0), hide_welcome_screen=True, executable_path=program)
    try:
        client.open(str(recording))
        seen_when(client, tmp_path / "first.png", lambda p: share_of(p, OUTLINE) > 1e-4)
        client.set_time("video_time", duration=0.6, play_state="paused")
        picture = seen_when(client, tmp_path / "seen.png", lambda p: share_of(p[:, : p.shape[1] // 2], CLOTH) > 0.05)
    finally:
        client.quit()
    left, right = np.split(picture, [3 * picture.shape[1] // 5], axis=1)
    assert share_of(left, CLOTH) > 0.05, "the clip on the left"
    assert share_of(right, OUTLINE) > 1e-3, "the table on the right"
    assert share_of(left, (240, 240, 235), off=20) > 2e-4, "the white ball and its way"
    assert share_of(right, on_any_ground(KIND_COLOURS["white"])) > 2e-4, "the white ball's way on any ground"


@pytest.mark.slow
def test_the_viewer_in_the_browser_shows_them_too(recording: Path, tmp_path: Path) -> None:
    with open_viewer([recording], web=True) as viewer, chromium(960, draws=True) as browser:
        browser.get(viewer.address + "&renderer=webgl")

        def both(picture: np.ndarray) -> bool:
            left, right = np.split(picture, [3 * picture.shape[1] // 5], axis=1)
            return share_of(left, CLOTH) > 0.05 and share_of(right, OUTLINE) > 1e-3

        assert both(seen_when(browser, tmp_path / "seen.png", both)), "the clip on the left, the table on the right"
