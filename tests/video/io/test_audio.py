"""Audio has the length of the video, the pitch of the original, and starts at the same moment."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from support import staged_shot as shot

from video.io.audio import add_audio
from video.io.clip import open_clip
from video.io.video_writer import VideoWriter

TONE, SAMPLES = 440.0, 44100
SILENCE = 0.2
"""s before the tone begins."""


def write_video_with_tone(folder: Path) -> Path:
    """Write a second of video; the tone begins after `SILENCE`."""
    with VideoWriter(folder / "film.mp4", shot.WIDTH, shot.HEIGHT, Fraction(shot.RATE), threads=1) as writer:
        for k in range(30):
            writer.write(shot.film(k / shot.RATE))
    t = np.arange(SAMPLES) / SAMPLES
    tone = np.where(t > SILENCE, 0.5 * np.sin(2 * np.pi * TONE * t), 0).astype(np.float32)
    path = folder / "both.mp4"
    with av.open(str(folder / "film.mp4")) as video, av.open(str(path), "w") as output:
        copy = output.add_stream_from_template(video.streams.video[0])
        voice = output.add_stream("aac", rate=SAMPLES, layout="mono")
        frame = av.AudioFrame.from_ndarray(tone[None], format="fltp", layout="mono")
        frame.sample_rate, frame.pts = SAMPLES, 0
        for packet in video.demux(video=0):
            if packet.dts is not None:
                packet.stream = copy
                output.mux(packet)
        output.mux(voice.encode(frame))
        output.mux(voice.encode(None))
    return path


@pytest.mark.parametrize("slow", [1.0, 3.0, 8.0])
def test_audio_has_the_length_of_the_video_and_keeps_its_pitch_and_moment(tmp_path: Path, slow: float) -> None:
    clip = open_clip(write_video_with_tone(tmp_path))
    silent, out = tmp_path / "silent.mp4", tmp_path / "out.mp4"
    with VideoWriter(silent, shot.WIDTH, shot.HEIGHT, Fraction(shot.RATE) / Fraction(slow), threads=1) as writer:
        for k in range(30):
            writer.write(shot.film(k / shot.RATE))
    add_audio(silent, clip, slow, out)
    with av.open(str(out)) as container:
        frame_times = [float(frame.time) for frame in container.decode(video=0)]
    with av.open(str(out)) as container:
        frames = list(container.decode(audio=0))
    wave = np.concatenate([frame.to_ndarray()[0] for frame in frames])
    seconds, rate = len(wave) / frames[0].sample_rate, frames[0].sample_rate
    np.testing.assert_allclose(frame_times, np.arange(30) * slow / shot.RATE, atol=1e-3)
    assert seconds == pytest.approx(slow, abs=0.08)
    loud = np.flatnonzero(np.abs(wave) > 0.15)
    # windows of the stretching filter: less than one and a half frames of the clip
    assert loud[0] / rate == pytest.approx(SILENCE * slow, abs=0.045 * slow)
    middle = wave[int(0.4 * slow * rate) : int(0.8 * slow * rate)]
    spectrum = np.abs(np.fft.rfft(middle * np.hanning(len(middle))))
    assert np.argmax(spectrum) * rate / len(middle) == pytest.approx(TONE, rel=0.02)
