"""`trueroll predict` writes its files, prints a summary, and refuses bad input in one line."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pipeline.cli.execute import execute_command_line
from pipeline.io.observed_shot import read_observed_shot

R, G, MU, V = 0.028575, 9.81, 0.01, 0.8
SCENE: dict[str, Any] = {
    "scene": "billiards", "units": "m", "fps": 60, "table": {"length": 2.54, "width": 1.27, "pockets": False},
    "ball_radius": R,
}  # fmt: skip


def cue_position(t: float) -> tuple[float, float]:
    """Return the position of a ball that rolls along x from (0.4, 0.6) m at 0.8 m/s."""
    return 0.4 + V * t - MU * G * t**2 / 2, 0.6


def write_track_folder(folder: Path, until: float = 1.2, scene: dict[str, Any] | None = SCENE, drop: str = "") -> Path:
    """Write two equal shots of that ball and of one at rest, at 60 frames per second with 0.5 mm of noise."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    with (folder / "tracks.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        names = [name for name in ("shot", "frame", "t", "id", "x", "y") if name != drop]
        rows.writerow(names)
        for shot in (3, 4):
            for frame in range(int(until * 60) + 1):
                for ball, (x, y) in (("cue", cue_position(frame / 60)), ("red", (2.0, 1.0))):
                    x, y = np.array([x, y]) + rng.normal(0, 5e-4, 2)
                    cells = {"shot": shot, "frame": frame, "t": frame / 60, "id": ball, "x": x, "y": y}
                    rows.writerow([cells[name] for name in names])
    if scene is not None:
        (folder / "scene.json").write_text(json.dumps(scene), encoding="utf-8")
    return folder


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_a_track_folder_gives_the_rest_of_the_shot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_track_folder(tmp_path / "shots")
    assert execute_command_line(["predict", str(folder), "--seconds", "1", "-o", str(tmp_path / "out")]) == 0
    last = [row for row in read_rows(tmp_path / "out" / "prediction.csv") if row["id"] == "cue"][-1]
    assert float(last["t"]) == pytest.approx(2.2)
    miss = np.hypot(float(last["x"]) - cue_position(2.2)[0], float(last["y"]) - 0.6)
    assert miss < 4 * float(last["sigma"]) < 0.1
    assert float(last["x05"]) < float(last["x50"]) < float(last["x95"])
    printed = capsys.readouterr().out
    assert "The cue ball keeps moving" in printed
    place = (
        "its centre 27.0 cm (0.9 diamonds) from the near long rail and 54.0 cm (1.7 diamonds) from the right short rail"
    )
    assert f"The red stays at rest, {place}." in printed
    image = np.asarray(Image.open(tmp_path / "out" / "prediction.png"))
    assert image.shape[1] == 1280
    assert not (folder / "prediction.csv").exists()


def test_a_prediction_from_an_earlier_time_is_compared_with_the_observations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_track_folder(tmp_path / "shots")
    words = ["predict", str(folder / "tracks.csv"), "--at", "0.6", "--seconds", "0.5", "--shot", "4", "--json"]
    assert execute_command_line(words) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["shot"] == 4
    assert answer["t"] == 0.6
    assert {one["id"] for one in answer["compared"]} == {"cue", "red"}
    for one in answer["compared"]:
        assert one["error_mm"] < 5 + 4 * one["sigma_mm"]
        assert one["t"] == pytest.approx(1.1, abs=1e-6)
    assert json.loads((folder / "prediction.json").read_text()).items() <= answer.items()


def test_two_predictions_are_the_same_bytes(tmp_path: Path) -> None:
    folder = write_track_folder(tmp_path / "shots")
    for name in ("one", "two"):
        assert execute_command_line(["predict", str(folder), "--seconds", "2", "-o", str(tmp_path / name)]) == 0
    for name in ("prediction.csv", "prediction.json", "prediction.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_frames_without_times_take_them_from_the_rate(tmp_path: Path) -> None:
    timed, _, _ = read_observed_shot(write_track_folder(tmp_path / "timed"))
    counted, _, number = read_observed_shot(write_track_folder(tmp_path / "counted", drop="t"))
    assert number == 3
    np.testing.assert_allclose(counted.t, timed.t, atol=1e-12)
    np.testing.assert_array_equal(counted.xy, timed.xy)


def test_rows_that_the_physics_filled_in_are_no_observations(tmp_path: Path) -> None:
    folder = write_track_folder(tmp_path / "shots")
    lines = (folder / "tracks.csv").read_text(encoding="utf-8").splitlines()
    filled = [f"{line},{int(k > 40)}" for k, line in enumerate(lines[1:])]
    (folder / "tracks.csv").write_text("\n".join([lines[0] + ",observed", *filled]), encoding="utf-8")
    tracks, _, _ = read_observed_shot(folder)
    assert tracks.t[0] == pytest.approx(20 / 60, abs=1e-6)


@pytest.mark.parametrize(
    ("scene", "options", "words"),
    [
        (SCENE | {"scene": "pendulum"}, [], "no billiards scene"),
        (SCENE | {"units": "inch"}, [], "units: input should be 'm'"),
        ({key: value for key, value in SCENE.items() if key != "table"}, [], "table"),
        (SCENE, ["--at", "9"], "within what was seen"),
        (SCENE, ["--shot", "7"], "shots 3, 4"),
        (SCENE, ["--seconds", "-1"], "--seconds"),
    ],
)
def test_an_input_that_cannot_be_predicted_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scene: dict[str, Any] | None, options: list[str], words: str
) -> None:
    folder = write_track_folder(tmp_path / "shots", until=0.2, scene=scene)
    assert execute_command_line(["predict", str(folder), *options, "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_too_few_frames_are_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_track_folder(tmp_path / "shots", until=0.2)
    assert execute_command_line(["predict", str(folder), "--at", "0.03"]) == 1
    assert "needs at least 5" in capsys.readouterr().err
    assert not (folder / "prediction.csv").exists()
