"""The command that makes frames between frames, on a sample clip cut short."""

from __future__ import annotations

import json
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from pipeline.execute import execute

SAMPLE = Path(__file__).parents[2] / "sample_videos" / "overhead_pool.mp4"


def cut_short(path: Path, pictures: int = 20) -> Path:
    """The first pictures of a sample as they are coded."""
    with av.open(str(SAMPLE)) as source, av.open(str(path), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for k, packet in enumerate(packet for packet in source.demux(stream) if packet.dts is not None):
            if k < pictures:
                packet.stream = copy
                target.mux(packet)
    return path


@pytest.mark.slow
def test_a_clip_becomes_a_video_and_pngs_with_the_originals_among_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, frames, video = cut_short(tmp_path / "cut.mp4"), tmp_path / "frames", tmp_path / "out.mp4"
    words = ["interpolate", str(clip), "--factor", "3", "-o", str(video), "--frames", str(frames), "--json"]
    assert execute([*words, "--cache", str(tmp_path / "cache")]) == 0
    told = json.loads(capsys.readouterr().out)
    with av.open(str(clip)) as container:
        real = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)]
    assert told["pictures"] == 3 * (len(real) - 1) + 1
    names = sorted(path.name for path in frames.iterdir())
    assert names == [f"{k:06d}.png" for k in range(told["pictures"])]
    for k, picture in enumerate(real):
        np.testing.assert_array_equal(np.asarray(Image.open(frames / f"{3 * k:06d}.png")), picture)
    with av.open(str(video)) as container:
        assert sum(1 for _ in container.decode(video=0)) == told["pictures"]
    assert execute([*words, "--cache", str(tmp_path / "cache")]) == 2, "the folder of pictures is taken"


def test_a_video_of_another_kind_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["interpolate", str(SAMPLE), "--factor", "4", "-o", "pictures.gif"]) == 2
    assert "-o is a video" in capsys.readouterr().err
