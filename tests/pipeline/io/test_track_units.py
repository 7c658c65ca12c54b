"""Units, clocks and encodings of tracks that nobody stated: shown by the motion, or said to be assumed."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.typing import FloatArray
from models.estimation.track_evidence import fit_even_times
from pipeline.io.text_table import build_row_grid
from pipeline.io.track_conventions import LENGTH_UNITS
from pipeline.io.track_folder import TrackFolder, read_track_folders

Columns = dict[str, FloatArray]


def write_folder(folder: Path, columns: Columns, scene: dict[str, object]) -> Path:
    folder.mkdir()
    rows = np.stack(list(columns.values()), axis=1)
    lines = [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def read_columns(place: Path, columns: Columns, **scene: object) -> TrackFolder:
    return read_track_folders([write_folder(place, columns, scene)])


def coast(count: int = 40, drag: float = 4e-4) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, heights and speeds of a rocket that coasts, never slow."""
    rng, height, speed, rows = np.random.default_rng(1), 500.0, 250.0, []
    for frame in range(count):
        rows.append((frame / 20, height + rng.normal(0, 0.3), speed))
        for _ in range(20):
            speed -= (9.81 + drag * speed**2) / 400
            height += speed / 400
    t, z, v = np.array(rows).T
    return t, z, v


def swing(amplitude: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, angles (rad) and rates (rad/s) of a pendulum of half a metre."""
    t, rate = np.arange(500) / 100, np.sqrt(9.81 / 0.5)
    noise = np.random.default_rng(2).normal(0, 0.003 * amplitude, len(t))
    return t, amplitude * np.cos(rate * t) + noise, -amplitude * rate * np.sin(rate * t)


@pytest.mark.parametrize("unit", LENGTH_UNITS)
def test_a_height_whose_unit_nothing_shows_is_said_to_be_assumed(tmp_path: Path, unit: str) -> None:
    """Drag hides gravity in a rocket that is never slow."""
    t, z, _ = coast()
    columns = {"t": t, "z": z / LENGTH_UNITS[unit]}
    if unit == "mm":  # no drag slows by two thousand times gravity
        with pytest.raises(OptionError, match="state the units"):
            read_columns(tmp_path / "a", columns, scene="flight")
        return
    read = read_columns(tmp_path / "a", columns, scene="flight")
    is_right = np.allclose(read.recordings[0].positions[:, 0, 0], z, rtol=1e-5)
    assert any("metres are assumed" in note for note in read.notes) or is_right


@pytest.mark.parametrize(("header", "unit"), [("h_ft", "ft"), ("Altitude [km]", "km"), ("height (in)", "in")])
def test_the_unit_of_a_header_counts(tmp_path: Path, header: str, unit: str) -> None:
    t, z, _ = coast()
    read = read_columns(tmp_path / "a", {"t": t, header: z / LENGTH_UNITS[unit]}, scene="flight")
    assert np.allclose(read.recordings[0].positions[:, 0, 0], z, rtol=1e-4)
    assert not any("assumed" in note for note in read.notes)


@pytest.mark.parametrize(("header", "speed_unit"), [("vz [m/s]", 1.0), ("vz (ft/s)", 0.3048), ("climb rate", 1.0)])
def test_a_column_of_speed_shows_the_unit_of_a_height(tmp_path: Path, header: str, speed_unit: float) -> None:
    t, z, v = coast()
    read = read_columns(tmp_path / "a", {"t": t, "z": z / 0.3048, header: v / speed_unit}, scene="flight")
    assert any("z is in feet, as its rate" in note for note in read.notes), read.notes
    assert np.allclose(read.recordings[0].positions[:, 0, 0], z, rtol=1e-5)


@pytest.mark.parametrize("degrees", [0.5, 1.0, 1.6])
def test_small_angles_are_said_to_be_assumed_unless_their_rate_shows_the_unit(tmp_path: Path, degrees: float) -> None:
    t, angle, rate = swing(np.radians(degrees))
    alone = read_columns(tmp_path / "a", {"t": t, "angle": np.degrees(angle)}, scene="pendulum")
    assert any("radians are assumed" in note or "are in degrees" in note for note in alone.notes)
    both = read_columns(tmp_path / "b", {"t": t, "angle": np.degrees(angle), "omega": rate}, scene="pendulum")
    assert any("theta1 is in degrees, as its rate omega shows" in note for note in both.notes)
    assert np.allclose(both.recordings[0].positions[:, 0, 0], angle, atol=1e-7)


def test_an_angle_under_another_name_is_not_its_own_rate(tmp_path: Path) -> None:
    """What decays exponentially has a rate in proportion to itself: here 57.3 per second, as of degrees and rad/s."""
    t = np.arange(100) / 400
    read = read_columns(tmp_path / "a", {"t": t, "phi": 0.01 * np.exp(57.3 * (t - t[-1]))}, scene="pendulum")
    assert not any("as its rate" in note for note in read.notes)


def test_the_unit_of_positions_on_a_surface_is_said_to_be_assumed(tmp_path: Path) -> None:
    t = np.arange(40) / 40
    read = read_columns(tmp_path / "a", {"t": t, "x": 0.2 + t, "y": 0.1 + 0.5 * t}, scene="slide")
    assert any("no unit of x, y is stated, and nothing shows it; metres are assumed" in note for note in read.notes)
    read = read_columns(tmp_path / "b", {"t": t, "x": 0.2 + t, "y": 0.1 + 0.5 * t}, scene="slide", units="m")
    assert not any("assumed" in note for note in read.notes)


@pytest.mark.parametrize(("rate", "clock"), [(60.0, 0.01), (240.0, 0.01), (240.0, 0.001), (30.0, 0.01)])
@pytest.mark.parametrize("has_frames", [True, False])
def test_times_that_a_coarse_clock_rounded_become_even(
    tmp_path: Path, rate: float, clock: float, has_frames: bool
) -> None:
    """At 240 fps, two or three positions had one time, and the first of them alone was used."""
    frame = np.arange(int(1.5 * rate), dtype=float)
    true = frame / rate
    columns = {"t": np.round(true / clock) * clock, "x": 3 * true, "z": 1 + 5 * true - 4.905 * true**2}
    read = read_columns(tmp_path / "a", {"frame": frame, **columns} if has_frames else columns, scene="flight")
    (one,) = read.recordings
    assert any(f"times are rounded to {clock:g} s" in note for note in read.notes), read.notes
    assert len(one.t) == len(true)
    assert np.abs(one.t - one.t[0] - true).max() < 0.15 * clock


def test_a_missing_sample_of_an_exact_clock_is_no_rounding() -> None:
    """One step of 20 ms among steps of 10 ms is what rounding even times of 10.2 ms gives as well."""
    number = np.delete(np.arange(60.0), 30)
    assert fit_even_times(np.arange(59.0), number / 100) is None
    assert fit_even_times(number, number / 100) is None, "nothing is rounded"
    assert fit_even_times(np.arange(59.0), np.cumsum(np.random.default_rng(0).uniform(0.01, 0.02, 59))) is None


def test_rows_at_one_time_are_counted(tmp_path: Path) -> None:
    t = np.repeat(np.arange(30) / 30, 2)
    x = np.where(np.arange(60) % 2, 2.0, 0.0) + t  # two bodies without a name
    read = read_columns(tmp_path / "a", {"t": t, "x": x, "y": 0 * t}, scene="slide", units="m")
    assert any("30 of 60 rows repeat the time of a row of their body" in note for note in read.notes)
    assert not any("rounded" in note for note in read.notes)


def test_a_table_with_exchanged_axes_or_in_inches_is_said_and_one_in_feet_named(tmp_path: Path) -> None:
    t = np.arange(40) / 40
    long, short, scene = 0.3 + 2 * t, 0.2 + 0.9 * t, {"scene": "billiards", "table": {"length": 2.54, "width": 1.27}}
    read = read_columns(tmp_path / "a", {"t": t, "x": short, "y": long}, **scene)
    assert any("x and y are exchanged" in note for note in read.notes)
    assert np.allclose(read.recordings[0].positions[:, 0], np.stack([long, short], axis=1), atol=1e-6)
    read = read_columns(tmp_path / "b", {"t": t, "x": long / 0.0254, "y": short / 0.0254}, **scene)
    assert any("in centimetres, and in inches too" in note for note in read.notes)
    with pytest.raises(OptionError, match='if it is in feet, write "units": "ft"'):
        read_columns(tmp_path / "c", {"t": t, "x": long / 0.3048, "y": short / 0.3048}, **scene)


TEXT = "t,x,z\n" + "".join(f"{k / 50:.2f},{0.1 * k:.3f},{1 + 0.1 * k - 4.905 * (k / 50) ** 2:.5f}\n" for k in range(50))


@pytest.mark.parametrize("data", [
    gzip.compress(TEXT.encode()), TEXT.encode("utf-16-le"), TEXT.encode("utf-16"), ("\ufeff" + TEXT).encode(),
    TEXT.replace("\n", "\r").encode(), TEXT.replace("0.500,", "-,").replace("0.700,", "none,").encode(),
])  # fmt: skip
def test_text_is_read_in_any_encoding_and_with_any_word_for_a_missing_value(tmp_path: Path, data: bytes) -> None:
    folder = write_folder(tmp_path / "a", {"t": np.zeros(1)}, {"scene": "flight"})
    (folder / "tracks.csv").write_bytes(data)
    (one,) = read_track_folders([folder]).recordings
    assert len(one.t) in (48, 50)
    assert one.positions[10, 0, 0] == pytest.approx(1.0 if len(one.t) == 50 else 1.2)


@pytest.mark.parametrize(("data", "words"), [
    (gzip.compress(TEXT.encode())[:200], "gzip archive that breaks off"),
    (b"PK\x03\x04\x14\x00\x06\x00xl/workbook.xml" + bytes(60), "is no text; save it as CSV"),
    (b'[{"t": 0, "x": 1}]', "is JSON, XML or HTML"), (b"<html><body>404</body></html>", "is JSON, XML or HTML"),
    (TEXT.replace("0.02,", "00:00:00.02,").encode(), "'00:00:00.02' in row 2; write seconds"),
    (TEXT.replace("1.500,", '"1,500.0",').encode(), "the column x .* '1,500.0' in row 16; write a plain number"),
    (TEXT[:-9].encode(), "row 50 has 2 values for 3 columns; complete or remove it"),
    (b"t,cue_x,cue_y\n0,1,2\n", "a row for each body and time; it has t, cue_x, cue_y: rename them"),
])  # fmt: skip
def test_what_is_no_table_is_refused_with_a_remedy(tmp_path: Path, data: bytes, words: str) -> None:
    folder = write_folder(tmp_path / "a", {"t": np.zeros(1)}, {"scene": "flight"})
    (folder / "tracks.csv").write_bytes(data)
    with pytest.raises(OptionError, match=words) as caught:
        read_track_folders([folder])
    assert "\n" not in str(caught.value)


def test_rows_become_a_grid_of_which_the_first_of_several_counts() -> None:
    grid = build_row_grid(np.array([5, 3, 5, 5]), np.array(["b", "a", "a", "b"]))
    assert grid.bodies == ("b", "a")
    assert grid.first.tolist() == [1, 0]
    values = grid.scatter(np.array([1.0, 2.0, 3.0, 4.0]))
    assert np.array_equal(values, [[np.nan, 2.0], [1.0, 3.0]], equal_nan=True)
    assert build_row_grid(np.array([5, 3]), np.array(["b", "a"]), ("a", "b")).place.tolist() == [0, 3]
