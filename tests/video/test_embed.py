"""What is embedded plays everywhere, and shows any of its pictures soon."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from video.clip import Clip, open_clip, read_frames
from video.embed import SMOOTH_PX, playable

RATE, WIDTH, HEIGHT, PICTURES = 30, 640, 360, 60


def filmed(path: Path, key_frame_each: int) -> Clip:
    """A disc that rolls over cloth, coded as cameras and sites do it: with B-frames, and key frames far apart."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.options = {"g": str(key_frame_each), "keyint_min": "1", "sc_threshold": "0", "bf": "2", "crf": "18"}
        for k in range(PICTURES):
            rgb = np.full((HEIGHT, WIDTH, 3), (30, 110, 70), np.uint8)
            cv2.circle(rgb, (40 + 9 * k, 180), 20, (230, 60, 40), -1)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())
    return open_clip(path)


def key_frames(path: Path) -> list[int]:
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
    return [k for k, packet in enumerate(packets) if packet.is_keyframe]


@pytest.mark.parametrize("allowed", [1.0, 0.99])
def test_a_clip_is_copied_only_if_too_much_must_be_decoded_to_show_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, allowed: float
) -> None:
    clip = filmed(tmp_path / "clip.mp4", 250)
    assert key_frames(clip.path) == [0]
    monkeypatch.setattr("video.embed.SMOOTH_PX", allowed * PICTURES * WIDTH * HEIGHT)
    assert playable(clip, tmp_path / "copy.mp4") == (clip.path if allowed == 1 else tmp_path / "copy.mp4")


def test_a_copy_has_a_key_frame_each_second_and_the_same_pictures_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = filmed(tmp_path / "clip.mp4", 250)
    monkeypatch.setattr("video.embed.SMOOTH_PX", 0)
    copy = open_clip(playable(clip, tmp_path / "copy.mp4"))
    assert max(np.diff([*key_frames(copy.path), PICTURES])) <= RATE
    assert copy.frame_count == PICTURES
    assert copy.t == pytest.approx(clip.t, abs=1e-6)
    whole = [k for k in range(PICTURES) if 40 + 9 * k < WIDTH - 20]
    seen = [disc(rgb) for _, rgb in read_frames(copy, indices=np.array(whole))]
    assert seen == pytest.approx([40 + 9 * k for k in whole], abs=0.5)


def disc(rgb: np.ndarray) -> float:
    """Column (px) of the middle of what is red."""
    return float(np.nonzero(rgb[..., 0] > 130)[1].mean())


def test_a_second_of_full_hd_at_sixty_needs_no_copy() -> None:
    assert 60 * 1920 * 1080 <= SMOOTH_PX < 121 * 1920 * 1080
