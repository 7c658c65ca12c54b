"""The command that makes frames between frames, on a sample clip cut short."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from support import synthetic_run

from pipeline.actions import particle_motion
from pipeline.cli.execute import execute_command_line
from pipeline.engine.atomic_write import create_folder, machine_id, replace_file

SAMPLE = Path(__file__).parents[3] / "sample_videos" / "overhead_pool.mp4"


def cut_short(path: Path, frames: int = 20) -> Path:
    """Copy the first coded frames of a sample."""
    with av.open(str(SAMPLE)) as source, av.open(str(path), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for k, packet in enumerate(packet for packet in source.demux(stream) if packet.dts is not None):
            if k < frames:
                packet.stream = copy
                target.mux(packet)
    return path


@pytest.mark.slow
def test_a_clip_becomes_a_video_and_pngs_with_the_originals_among_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, frames, video = cut_short(tmp_path / "cut.mp4"), tmp_path / "frames", tmp_path / "out.mp4"
    words = ["interpolate", str(clip), "--factor", "3", "-o", str(video), "--frames", str(frames), "--json"]
    assert execute_command_line([*words, "--cache", str(tmp_path / "cache")]) == 0
    result = json.loads(capsys.readouterr().out)
    with av.open(str(clip)) as container:
        real = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert result["pictures"] == 3 * (len(real) - 1) + 1
    names = sorted(path.name for path in frames.iterdir())
    assert names == [f"{k:06d}.png" for k in range(result["pictures"])]
    for k, frame in enumerate(real):
        np.testing.assert_array_equal(np.asarray(Image.open(frames / f"{3 * k:06d}.png")), frame)
    with av.open(str(video)) as container:
        assert sum(1 for _ in container.decode(video=0)) == result["pictures"]
    assert execute_command_line([*words, "--cache", str(tmp_path / "cache")]) == 2, "the folder of frames is not empty"


def test_a_video_of_another_kind_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute_command_line(["interpolate", str(SAMPLE), "--factor", "4", "-o", "frames.gif"]) == 2
    assert "-o is a video" in capsys.readouterr().err


def test_either_a_factor_or_a_rate_sets_the_frames(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--factor", "2", "--rate", "60"]):
        assert execute_command_line(["interpolate", str(SAMPLE), *words, "-o", "out.mp4"]) == 2
        assert "Either --factor or --rate" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "result"),
    [
        (["--rate", "12"], "--rate is 24 to 240"),
        (["--rate", "fast"], "--rate is a number"),
        (["--factor", "2", "--shutter", "400"], "--shutter is 0 to 360"),
    ],
)
def test_what_cannot_be_made_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], result: str
) -> None:
    assert execute_command_line(["interpolate", str(SAMPLE), *words, "-o", str(tmp_path / "out.mp4")]) == 2
    assert result in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_rate_slow_motion_and_window_have_their_effect_on_the_video(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip, video = cut_short(tmp_path / "cut.mp4"), tmp_path / "out.mp4"
    words = ["interpolate", str(clip), "--rate", "50", "--slow", "2", "--upright", "--shutter", "180", "-o", str(video)]
    assert execute_command_line([*words, "--json", "--cache", str(tmp_path / "cache")]) == 0
    result = json.loads(capsys.readouterr().out)
    with av.open(str(clip)) as container:
        times = [float(frame.time) for frame in container.decode(video=0)]
        height = container.streams.video[0].height
    with av.open(str(video)) as container:
        shown = [(float(p.time), p.width, p.height) for p in container.decode(video=0)]
    assert len(shown) == result["pictures"]
    assert len(shown) == pytest.approx(100 * (times[-1] - times[0]) + 1, abs=1)
    np.testing.assert_allclose([t for t, *_ in shown], np.arange(len(shown)) / 50, atol=1e-4)
    assert {(width, tall) for _, width, tall in shown} == {(2 * round(height * 9 / 32), height)}


def test_what_killed_runs_left_beside_the_output_is_cleared(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", "pass"])
    dead.wait()
    left = [
        tmp_path / f".v.mp4.{machine_id()}-{dead.pid}.part",
        tmp_path / f".v.mp4.silent.{machine_id()}-{dead.pid}.part",
    ]
    for path in left:
        path.write_bytes(b"half")
    frames = tmp_path / f".fr.{machine_id()}-{dead.pid}.part"
    frames.mkdir()
    (frames / "000000.png").write_bytes(b"half")
    with replace_file(tmp_path / "v.mp4") as place, create_folder(tmp_path / "fr") as folder:
        place.write_bytes(b"whole")
        (folder / "000000.png").write_bytes(b"whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fr", "v.mp4"]

    def broken() -> None:
        with create_folder(tmp_path / "broken") as folder:
            (folder / "000000.png").write_bytes(b"half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        broken()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fr", "v.mp4"]


def test_the_tracks_of_a_run_are_interpolated_by_its_own_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(25) / 30
    fit = synthetic_run.make_fit(t)
    xy = fit.trajectory.at(t).xy
    rows = [
        f"0,{k},{t[k]},{ball},{xy[k, n, 0]},{xy[k, n, 1]}"
        for k in range(25)
        for n, ball in enumerate(fit.trajectory.ids)
    ]
    (tmp_path / "tracks.csv").write_text("\n".join(["shot,frame,t,id,x,y", *rows]), encoding="utf-8")
    (tmp_path / "shot").mkdir()
    monkeypatch.setattr(particle_motion, "read_saved", lambda folder: None)
    monkeypatch.setattr(particle_motion, "view_shot", lambda shot: fit)
    monkeypatch.setattr(particle_motion, "fit_particles", lambda shot: pytest.fail("the run knows the motion"))
    command = ["interpolate", str(tmp_path / "tracks.csv"), "--factor", "2", "-o", str(tmp_path / "fine.csv")]
    assert execute_command_line(command) == 0
    assert "the fitted motion of the run" in capsys.readouterr().out
    fine = np.genfromtxt(tmp_path / "fine.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    between = fine[(fine["frame"] == 21) & (fine["id"] == fit.trajectory.ids[0])]
    expected = fit.trajectory.at(np.array([(t[10] + t[11]) / 2])).xy[0, 0]
    assert [between["x"][0], between["y"][0]] == pytest.approx(expected, abs=2e-6)
