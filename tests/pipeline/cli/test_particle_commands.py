"""`trueroll interpolate` and `trueroll predict` for particles of which only a tracks.csv is known."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from models.estimation.particle_fit import ParticleMotion
from pipeline.actions.particle_motion import format_physics_lines, summarize_physics
from pipeline.cli.execute import execute_command_line

RATE, SAMPLES = 20.0, 31


def falling(folder: Path, header: str = "t", missing: tuple[int, ...] = (), samples: int = SAMPLES) -> Path:
    """A tracks.csv of two particles in free flight, thrown against each other."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [f"{header},id,x,y"]
    for k in range(samples):
        t = k / RATE
        for name, speed in (("left", 100.0), ("right", -60.0)):  # both begin at 0
            if k in missing and name == "left":
                continue
            clock = f"{t:.6f}" if header == "t" else str(k)
            lines.append(f"{clock},{name},{speed * t:.2f},{-300 * t + 490.5 * t * t:.2f}")
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "tracks.csv"


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def test_a_video_is_not_made_of_tracks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    video = tmp_path / "fine.mp4"
    assert execute_command_line(["interpolate", str(falling(tmp_path)), "--factor", "4", "-o", str(video)]) == 2
    assert "Name the clip to make a video" in capsys.readouterr().err
    assert not video.exists()


def test_between_two_samples_come_the_places_of_the_motion(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = falling(tmp_path)
    assert (
        execute_command_line(["interpolate", str(source), "--factor", "4", "-o", str(tmp_path / "fine.csv"), "--json"])
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert result["factor"] == 4
    table = rows(tmp_path / "fine.csv")
    assert len(table) == 2 * ((SAMPLES - 1) * 4 + 1)
    t = np.array([float(row["t"]) for row in table])
    assert np.array([float(row["y"]) for row in table]) == pytest.approx(-300 * t + 490.5 * t**2, abs=0.02)
    assert {row["observed"] for row in table if int(row["frame"]) % 4 == 0} == {"1"}
    assert {row["observed"] for row in table if int(row["frame"]) % 4} == {"0"}


def test_numbers_of_the_physics_have_their_errors_and_what_is_not_identifiable_is_named() -> None:
    numbers, errors = {"rest": 80.0, "mass 2": 1.0}, {"rest": 0.005, "mass 2": np.inf}
    motion = ParticleMotion("springs", lambda t: t, np.zeros(1), numbers, errors, ("mass 2 is hardly identifiable.",))
    result = json.loads(json.dumps(summarize_physics(motion), allow_nan=False))
    assert result["numbers_sigma"] == {"rest": 0.005, "mass 2": None}
    assert list(format_physics_lines(result)) == ["  rest 80 ± 0.005", "  mass 2 1", "  mass 2 is hardly identifiable."]


def test_samples_stay_as_they_were_and_gaps_are_filled(tmp_path: Path) -> None:
    source = falling(tmp_path, missing=(10, 11))
    assert execute_command_line(["interpolate", str(source), "--factor", "2", "-o", str(tmp_path / "out")]) == 0
    table = {(int(row["frame"]), row["id"]): row for row in rows(tmp_path / "out" / "tracks.csv")}
    assert table[(20, "left")]["observed"] == "0"
    assert float(table[(20, "left")]["x"]) == pytest.approx(50, abs=0.1)
    assert all(row["observed"] == "1" for (frame, name), row in table.items() if name == "right" and frame % 2 == 0)


def test_a_particle_that_appears_late_is_fitted_with_the_others(tmp_path: Path) -> None:
    """The search for springs begins with the first 40 samples, in which this one is seen four times."""
    source = falling(tmp_path, missing=tuple(range(36)), samples=60)
    assert execute_command_line(["interpolate", str(source), "--factor", "2", "-o", str(tmp_path / "out")]) == 0
    late = [row for row in rows(tmp_path / "out" / "tracks.csv") if row["id"] == "left"]
    assert int(late[0]["frame"]) == 72


def test_an_error_that_is_not_known_is_left_empty(tmp_path: Path) -> None:
    lines = ["t,id,x,y", *(f"{k},a,{k * k},{-k}" for k in range(5))]
    (tmp_path / "tracks.csv").write_text("\n".join(lines), encoding="utf-8")
    assert execute_command_line(["interpolate", str(tmp_path), "--factor", "2", "-o", str(tmp_path / "out.csv")]) == 0
    assert {row["sigma"] for row in rows(tmp_path / "out.csv")} == {""}


def test_a_file_without_times_needs_the_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = falling(tmp_path, header="frame")
    command = ["interpolate", str(source), "--factor", "2", "-o", str(tmp_path / "out")]
    assert execute_command_line(command) == 2
    assert "--fps" in capsys.readouterr().err
    assert execute_command_line([*command, "--fps", str(RATE)]) == 0
    assert float(rows(tmp_path / "out" / "tracks.csv")[-1]["t"]) == pytest.approx((SAMPLES - 1) / RATE)


def test_the_future_of_particles_without_times_needs_the_rate(tmp_path: Path) -> None:
    command = ["predict", str(falling(tmp_path, "frame")), "--seconds", "0.5", "-o", str(tmp_path / "out")]
    assert execute_command_line(command) == 2
    assert execute_command_line([*command, "--fps", str(RATE)]) == 0
    last = rows(tmp_path / "out" / "prediction.csv")[-1]
    assert float(last["t"]) == pytest.approx((SAMPLES - 1) / RATE + 0.5)


def test_the_future_of_particles_has_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = falling(tmp_path)
    command = ["predict", str(source), "--at", "1.0", "--seconds", "0.5", "-o", str(tmp_path / "out"), "--json"]
    assert execute_command_line(command) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["from"] == pytest.approx(1.0)
    last = [row for row in rows(tmp_path / "out" / "prediction.csv") if float(row["t"]) == pytest.approx(1.5)]
    assert {row["id"]: float(row["x"]) for row in last} == pytest.approx({"left": 150, "right": -90}, abs=0.5)
    assert all(float(row["sigma"]) > 0 for row in last)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("id,x\na,1\n", "lacks the columns y"),
        ("t,id,x,y\n0,a,1,1\n1,a,1,2\n", "at least 4"),
        ("t,id,x,y\n", "has no position"),
    ],
)
def test_files_that_are_no_particles_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    (tmp_path / "tracks.csv").write_text(text, encoding="utf-8")
    assert (
        execute_command_line(
            ["interpolate", str(tmp_path / "tracks.csv"), "--factor", "2", "-o", str(tmp_path / "out")]
        )
        == 2
    )
    message = capsys.readouterr().err.strip()
    assert words in message
    assert "\n" not in message
    assert not (tmp_path / "out").exists()
