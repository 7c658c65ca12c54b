"""`trueroll check`: a rendered clip passes, a clip of no table does not, and scripts get a status and JSON."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.sample_clips import SAMPLES

from pipeline.cli.execute import execute_command_line
from pipeline.io.image_file import write_image
from pipeline.reporting.text.filming_sentences import rank_faults
from video.filming_check.measure_filming import CODES, FilmingMeasurement
from video.io.clip import open_clip, read_frames
from video.io.video_writer import VideoWriter


def test_a_good_clip_is_a_go_with_a_still(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip, still = SAMPLES / "oblique_pool.mp4", tmp_path / "still.png"
    assert execute_command_line(["check", str(clip), "--json", "-o", str(still)]) == 0
    report = json.loads(capsys.readouterr().out)
    values = {one["code"]: one["value"] for one in report["measurements"]}
    assert report["verdict"] == "go"
    assert report["faults"] == []
    assert tuple(values) == CODES
    assert values["frame_rate"] == pytest.approx(60)
    assert values["corners"] == 4
    truth = json.loads((SAMPLES / "oblique_pool.truth.json").read_text())
    with Image.open(still) as image:
        assert image.width > truth["width_px"]
        assert image.height >= truth["height_px"]


def test_a_clip_without_a_table_is_a_no_go_for_scripts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clip = tmp_path / "wall.mp4"
    with VideoWriter(clip, 320, 240, Fraction(60)) as writer:
        for k in range(40):
            writer.write(np.full((240, 320, 3), 60 + k % 3, np.uint8))
    assert execute_command_line(["check", str(clip)]) == 1
    out = capsys.readouterr().out
    assert "No-go" in out
    assert "A run refuses this clip: wall.mp4 " in out
    assert "corners of the table in view: 0 of 4" in out


def test_the_light_is_named_before_what_it_hides_and_a_missing_table_last() -> None:
    codes = ("corners", "camera_drift", "exposure", "focus")
    faults = [FilmingMeasurement(code, 0.0 if code == "exposure" else 90.0, "doubt") for code in codes]
    ranked = [one.code for one in rank_faults([*faults, FilmingMeasurement("glare", 99.0, "bad")])]
    assert ranked[:2] == ["glare", "exposure"]
    assert ranked[-1] == "corners"


def test_a_file_that_is_no_video_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.mp4").write_text("no video")
    assert execute_command_line(["check", str(tmp_path / "notes.mp4")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_check_and_detect_take_oblong_pixels_as_square_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = json.loads((SAMPLES / "overhead_pool.truth.json").read_text())
    clip, still, table = tmp_path / "squeezed.mp4", tmp_path / "squeezed.png", tmp_path / "balls.csv"
    frames = read_frames(open_clip(SAMPLES / "overhead_pool.mp4"), indices=range(14))
    squeezed = [cv2.resize(image, (960, 720), interpolation=cv2.INTER_AREA) for _, image in frames]
    with VideoWriter(clip, 960, 720, Fraction(30)) as writer:
        for image in squeezed:
            writer.write(np.asarray(image, np.uint8))
    write_image(np.asarray(squeezed[0], np.uint8), still)
    execute_command_line(["check", str(clip), "--json", "--pixel-aspect", "4/3"])
    report = json.loads(capsys.readouterr().out)
    assert report["table"] == "pool-9ft"
    assert report["balls"] == len(truth["balls"])
    assert execute_command_line(["detect", str(still), "--pixel-aspect", "4/3", "-o", str(table)]) == 0
    found = np.loadtxt(table, delimiter=",", skiprows=1, usecols=(1, 2))
    rows = np.genfromtxt(SAMPLES / "overhead_pool.truth.csv", delimiter=",", skip_header=1, usecols=(0, 5, 6))
    places = rows[rows[:, 0] == 0, 1:]
    assert len(found) == len(places)
    assert np.linalg.norm(found[:, None] - places, axis=2).min(axis=1).max() < 1.5


def test_check_names_the_table_of_a_run_and_takes_its_options(capsys: pytest.CaptureFixture[str]) -> None:
    clip = str(SAMPLES / "overhead_pool.mp4")
    assert execute_command_line(["check", clip, "--json", "--table", "2.54x1.27", "--ball-radius", "0.02"]) == 0
    report = json.loads(capsys.readouterr().out)
    truth = json.loads((SAMPLES / "overhead_pool.truth.json").read_text())
    assert report["table"] == "2.54x1.27"
    assert len(report["warnings"]) == 1
    assert "40 mm in diameter" in report["warnings"][0]
    assert execute_command_line(["check", clip, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["table"] == "pool-9ft"
    assert report["balls"] == len(truth["balls"])
    assert report["warnings"] == []
