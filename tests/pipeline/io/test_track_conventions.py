"""Tracks as people have them: each convention is recognised and said, or refused in one sentence, for every scene."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.recording import Recording
from models.estimation.track_evidence import find_held_samples
from pipeline.io.particle_files import read_particles
from pipeline.io.track_folder import TrackFolder, read_track_folders

Rows = dict[str, np.ndarray]
SHARED = Path(__file__).parents[4] / "shared" / "data" / "odd_inputs"


def throw(rate: float = 60.0, body: str = "ball") -> Rows:
    """Three throws with air drag, 1.5 s each, seen with 2 mm of noise."""
    rng, rows = np.random.default_rng(3), []
    for shot in range(3):
        t = np.arange(int(1.5 * rate)) / rate
        state = np.array([0.0, 1.0, rng.uniform(2, 5), rng.uniform(5, 7)])
        for frame, time in enumerate(t):
            rows.append((shot, frame, time, state[0] + rng.normal(0, 0.002), state[1] + rng.normal(0, 0.002)))
            for _ in range(10):
                speed = np.hypot(state[2], state[3])
                push = -0.05 * speed * state[2:] - [0, 9.81]
                state = state + np.concatenate([state[2:] + push / rate / 20, push]) / rate / 10
    shot, frame, time, x, z = np.array(rows).T
    return {"shot": shot, "frame": frame, "t": time, "id": np.full(len(time), body), "x": x, "z": z}


def swing(amplitude: float = 1.2, rate: float = 100.0) -> Rows:
    """A pendulum of 0.5 m, from two angles, 6 s each."""
    rng, rows = np.random.default_rng(4), []
    for shot, start in enumerate((amplitude, 0.8 * amplitude)):
        angle, speed = start, 0.0
        for frame in range(int(6 * rate)):
            rows.append((shot, frame, frame / rate, angle + rng.normal(0, 1e-3)))
            for _ in range(20):
                speed -= (9.81 / 0.5 * np.sin(angle) + 0.05 * speed) / rate / 20
                angle += speed / rate / 20
    shot, frame, time, theta = np.array(rows).T
    return {"shot": shot, "frame": frame, "t": time, "id": np.full(len(time), "arm"), "theta1": theta}


def write(folder: Path, rows: Rows, scene: dict[str, Any], delimiter: str = ",", decimal: str = ".") -> Path:
    folder.mkdir()
    cells = [[str(value).replace(".", decimal) for value in values.tolist()] for values in rows.values()]
    lines = [delimiter.join(row) for row in (tuple(rows), *zip(*cells, strict=True))]
    (folder / "tracks.csv").write_text("\n".join(lines) + "\n")
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def same(one: TrackFolder, other: TrackFolder, tolerance: float = 1e-6) -> bool:
    return len(one.recordings) == len(other.recordings) and all(
        a.positions.shape == b.positions.shape
        and np.allclose(a.positions, b.positions, atol=tolerance, equal_nan=True)
        and np.allclose(a.t - a.t[0], b.t - b.t[0], atol=1e-5)
        for a, b in zip(one.recordings, other.recordings, strict=True)
    )


FLIGHT, PENDULUM = {"scene": "flight", "model": []}, {"scene": "pendulum", "model": []}


def change(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Rows], Rows]:
    return lambda rows: {name: changes[name](values) if name in changes else values for name, values in rows.items()}


def rename(**names: str) -> Callable[[Rows], Rows]:
    return lambda rows: {names.get(name, name): values for name, values in rows.items()}


RECOGNISED: list[tuple[str, Callable[[Rows], Rows], str]] = [
    ("centimetres", change(x=lambda x: 100 * x, z=lambda z: 100 * z), "98.* m/s2 .* in centimetres"),
    ("millimetres", change(x=lambda x: 1e3 * x, z=lambda z: 1e3 * z), "in millimetres"),
    ("feet", change(x=lambda x: x / 0.3048, z=lambda z: z / 0.3048), "in feet"),
    ("kilometres", change(x=lambda x: x / 1e3, z=lambda z: z / 1e3), "in kilometres"),
    ("z down", change(z=lambda z: 3 - z), "fall towards larger z"),
    ("z down in mm", change(x=lambda x: 1e3 * x, z=lambda z: -1e3 * z), "in millimetres"),
    ("milliseconds", change(t=lambda t: 1e3 * t), "t is in ms"),
    ("microseconds", change(t=lambda t: 1e6 * t), "t is in us"),
    ("epoch", change(t=lambda t: 1.7e9 + t), "count from an epoch"),
    ("epoch in ms", change(t=lambda t: 1.7e12 + 1e3 * t), "count from an epoch"),
    ("other names", rename(t="Time (ms)", id="Track ID", z="height_m", frame="frame_idx"), "time is read as t"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "spoil", "words"), RECOGNISED, ids=[kind for kind, _, _ in RECOGNISED])
def test_a_flight_is_read_rightly_whatever_its_conventions(
    tmp_path: Path, kind: str, spoil: Callable[[Rows], Rows], words: str
) -> None:
    rows = throw()
    plain = read_track_folders([write(tmp_path / "plain", rows, FLIGHT)])
    assert plain.notes == ()
    changed = spoil(change(t=lambda t: 1e3 * t)(rows) if kind == "other names" else rows)
    read = read_track_folders([write(tmp_path / "odd", changed, FLIGHT)])
    if kind == "z down":
        for one in read.recordings:
            one.positions[..., 1] += 3
    assert same(plain, read)
    assert any(re.search(words, note) for note in read.notes), read.notes


@pytest.mark.parametrize("factor", [1.0, -1.0, 1000.0])
def test_exchanged_axes_of_a_flight_are_recognised(tmp_path: Path, factor: float) -> None:
    rows = throw()
    rows = {**rows, "y": factor * rows["z"], "z": abs(factor) * rows["x"], "x": abs(factor) * rows["x"]}
    read = read_track_folders([write(tmp_path / "odd", rows, FLIGHT)])
    assert "fall along y, not z" in read.notes[0]
    assert np.allclose(read.recordings[0].positions[:, 0, 2], rows["y"][rows["shot"] == 0] / factor)


def test_a_smash_that_drag_slows_is_not_turned(tmp_path: Path) -> None:
    """A shuttlecock at 60 m/s downwards decelerates by many times gravity, upwards."""
    rng, t, rows = np.random.default_rng(6), np.arange(12) / 120, []
    for shot in range(3):
        height, speed, path = 3.0, -60.0, []
        for _ in t:
            path.append(height + rng.normal(0, 0.002))
            for _ in range(20):
                speed -= (9.81 + 0.2 * speed * abs(speed)) / 2400
                height += speed / 2400
        rows.append(np.stack([np.full(12, shot), np.arange(12), t, path], axis=1))
    shots, frame, time, z = np.concatenate(rows).T
    columns = {"shot": shots, "frame": frame, "t": time, "id": np.full(36, "shuttle"), "z": z}
    read = read_track_folders([write(tmp_path / "plain", columns, {**FLIGHT, "units": "m"})])
    assert not any("turned" in note for note in read.notes)


@pytest.mark.parametrize(("factor", "words"), [(1e3, '9,[78].. m/s2 for a gravity of 9.81, so .* "units": "mm"'),
                                               (7.0, "state the units")])  # fmt: skip
def test_a_stated_unit_that_contradicts_the_fall_is_refused(tmp_path: Path, factor: float, words: str) -> None:
    rows = change(x=lambda x: factor * x, z=lambda z: factor * z)(throw())
    with pytest.raises(OptionError, match=words) as caught:
        read_track_folders([write(tmp_path / "odd", rows, {**FLIGHT, "units": "m"})])
    assert "\n" not in str(caught.value)


def test_pixels_that_fall_wrongly_blame_the_scale(tmp_path: Path) -> None:
    rows = change(x=lambda x: 4000 * x, z=lambda z: 4000 * z)(throw())
    with pytest.raises(OptionError, match="correct px_per_m"):
        read_track_folders([write(tmp_path / "odd", rows, {**FLIGHT, "units": "px", "px_per_m": 400})])


SWINGS: list[tuple[str, float, Callable[[np.ndarray], np.ndarray], str]] = [
    ("degrees", 1.2, np.degrees, "angles are in degrees"),
    ("few degrees", 0.1, np.degrees, "angles are in degrees"),
    ("wrapped at 2 pi", 1.2, lambda a: a % (2 * np.pi), "within one turn"),
    ("wrapped at 360", 1.2, lambda a: np.degrees(a) % 360, "within one turn"),
    ("wrapped at pi", 1.2, lambda a: (a + np.pi + np.pi) % (2 * np.pi) - np.pi, "within one turn"),
    ("wrapped at half a turn", 1.2, lambda a: a % np.pi, "within one turn"),
    ("upright is 0", 1.2, lambda a: a + np.pi, "hangs at 180 degrees"),
    ("level is 0", 1.2, lambda a: a - np.pi / 2, "hangs at -90 degrees"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "amplitude", "spoil", "words"), SWINGS, ids=[one[0] for one in SWINGS])
def test_a_pendulum_is_read_rightly_whatever_its_angles(
    tmp_path: Path, kind: str, amplitude: float, spoil: Callable[[np.ndarray], np.ndarray], words: str
) -> None:
    rows = swing(amplitude)
    plain = read_track_folders([write(tmp_path / "plain", rows, PENDULUM)])
    assert ["radians are assumed" in note for note in plain.notes] == [True] * (amplitude < 1)
    read = read_track_folders([write(tmp_path / "odd", change(theta1=spoil)(rows), PENDULUM)])
    assert any(words in note for note in read.notes), read.notes
    for one, other in zip(plain.recordings, read.recordings, strict=True):
        turns = (other.positions - one.positions) / (2 * np.pi)
        assert np.allclose(turns, np.round(turns[0, 0]), atol=1e-6)


def rise(start: float = 200.0, drag: float = 2e-4) -> Rows:
    """A rocket that coasts upwards for 3 s, never slow, with its height alone."""
    t, height, speed, rows = 0.0, 500.0, start, []
    rng = np.random.default_rng(5)
    for frame in range(60):
        rows.append((0, frame, t, height + rng.normal(0, 0.1)))
        for _ in range(10):
            speed -= (9.81 + drag * speed**2) * 0.005
            height += speed * 0.005
        t += 0.05
    shot, numbers, time, z = np.array(rows).T
    return {"shot": shot, "frame": numbers, "t": time, "id": np.full(60, "rocket"), "z": z}


def test_drag_of_bodies_that_are_never_slow_is_no_wrong_unit(tmp_path: Path) -> None:
    """They slow down by nearly twice gravity; in mm by a thousand times as much, which no drag does."""
    assert read_track_folders([write(tmp_path / "plain", rise(), {**FLIGHT, "units": "m"})]).notes == ()
    assert read_track_folders([write(tmp_path / "fast", rise(400.0, 5e-4), {**FLIGHT, "units": "m"})]).notes == ()
    rows = change(z=lambda z: 1e3 * z)(rise())
    with pytest.raises(OptionError, match="bodies fall at"):
        read_track_folders([write(tmp_path / "odd", rows, {**FLIGHT, "units": "m"})])


def test_a_pendulum_of_many_stated_radians_is_refused(tmp_path: Path) -> None:
    rows = change(theta1=lambda a: 150 * a)(swing())
    with pytest.raises(OptionError, match=r'angles up to 18\d move as a pendulum in deg.*"units": "deg"'):
        read_track_folders([write(tmp_path / "odd", rows, {**PENDULUM, "units": "rad"})])


def test_a_slide_faster_than_anything_on_a_table_is_refused(tmp_path: Path) -> None:
    t = np.arange(60) / 60
    rows = {"frame": np.arange(60), "t": t, "id": np.full(60, "puck"), "x": 800 * t, "y": 10 * t}
    with pytest.raises(OptionError, match="move at 800 m/s"):
        read_track_folders([write(tmp_path / "odd", rows, {"scene": "slide"})])


@pytest.mark.parametrize(("change_y", "change_x", "words"), [
    (lambda y: -y, lambda x: x, "y is negative"),
    (lambda y: y - 0.635, lambda x: x - 1.27, "from the middle"),
    (lambda y: 100 * y, lambda x: 100 * x, "in centimetres"),
])  # fmt: skip
def test_a_table_is_read_rightly_whatever_its_axes(
    tmp_path: Path, change_y: Callable[[Any], Any], change_x: Callable[[Any], Any], words: str
) -> None:
    t = np.arange(40) / 40
    x, y = 0.3 + 2.0 * t, 0.2 + 0.9 * t
    rows = {"frame": np.arange(40), "t": t, "id": np.full(40, "cue"), "x": change_x(x), "y": change_y(y)}
    scene = {"scene": "billiards", "table": {"length": 2.54, "width": 1.27}}
    read = read_track_folders([write(tmp_path / "odd", rows, scene)])
    assert words in read.notes[0]
    assert np.allclose(read.recordings[0].positions[:, 0], np.stack([x, y], axis=1))


def two_cameras(offset: float = 0.004, numbers: int = 0) -> tuple[Rows, np.ndarray]:
    one, other = throw(60.0, "a"), throw(50.0, "b")
    other["t"], other["frame"] = other["t"] + offset, other["frame"] + numbers
    return {name: np.concatenate([one[name], other[name]]) for name in one}, other["t"][other["shot"] == 0]


@pytest.mark.parametrize("numbers", [0, 1000])
def test_two_cameras_with_their_own_frame_numbers_keep_their_own_times(tmp_path: Path, numbers: int) -> None:
    """Body b got the times of body a."""
    rows, times = two_cameras(numbers=numbers)
    read = read_track_folders([write(tmp_path / "odd", rows, FLIGHT)])
    one = read.recordings[0]
    assert np.allclose(one.t[one.is_observed[:, 1]], times)
    assert any("a frame number has several times" in note for note in read.notes)


def test_a_time_that_is_rounded_differently_for_two_bodies_is_one_time(tmp_path: Path) -> None:
    rows = throw()
    other = {**rows, "id": np.full(len(rows["t"]), "b"), "t": np.round(rows["t"], 4)}
    both = {name: np.concatenate([rows[name], other[name]]) for name in rows}
    read = read_track_folders([write(tmp_path / "odd", both, FLIGHT)])
    assert read.notes == ()
    assert read.recordings[0].is_observed.all()


@pytest.mark.parametrize(("source", "shown"), [(30, 60), (30, 120), (25, 30), (24, 60)])
def test_held_samples_are_left_out(tmp_path: Path, source: int, shown: int) -> None:
    rows = throw(source)
    last, numbers = int(1.5 * source) - 1, np.arange(int(1.5 * shown)) * source // shown
    pick = np.concatenate([np.flatnonzero(rows["shot"] == shot)[np.minimum(numbers, last)] for shot in range(3)])
    held = {name: values[pick] for name, values in rows.items()}
    held["frame"] = np.tile(np.arange(int(1.5 * shown)), 3)
    held["t"] = held["frame"] / shown
    read = read_track_folders([write(tmp_path / "odd", held, FLIGHT)])
    assert "repeat the one before" in read.notes[0]
    assert all(len(one.t) == int(1.5 * source) for one in read.recordings)


def test_repeated_samples_of_a_run_are_observations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A detector that measures what moves finds a creeping ball at one place in several frames; no recorder held it."""
    monkeypatch.setattr("pipeline.io.track_conventions.has_shot", lambda folder: folder == tmp_path / "run")
    rows = {name: np.repeat(values, 2) for name, values in throw().items()}
    rows["frame"] = np.tile(np.arange(180), 3)
    rows["t"] = rows["frame"] / 120
    run, foreign = (read_track_folders([write(tmp_path / name, rows, FLIGHT)]) for name in ("run", "odd"))
    assert [len(read.recordings[0].t) for read in (run, foreign)] == [180, 90]


def test_held_samples_of_an_even_motion_are_left_out() -> None:
    """The steps of a body at constant speed are alike; what parts them is the unit of the last digit."""
    path = np.round(0.02 * np.arange(60)[:, None] + np.random.default_rng(0).normal(0, 1e-4, (60, 1)), 6)
    assert find_held_samples(np.repeat(path, 3, axis=0)).sum() == 120


def test_noisy_places_of_a_ball_at_rest_are_not_held_where_a_coded_image_repeats() -> None:
    rng = np.random.default_rng(1)
    values = 1.0 + rng.normal(0, 1e-4, (80, 2))
    repeated = np.repeat(values, rng.integers(1, 4, len(values)), axis=0)
    moving = 0.02 * np.arange(40)[:, None] + rng.normal(0, 1e-4, (40, 2))
    assert not find_held_samples(repeated).any()
    assert not find_held_samples(np.concatenate([moving, repeated])).any()


@pytest.mark.parametrize("step", [0.001, 0.01, 0.1, 0.3])
def test_rounded_and_resting_samples_are_not_held(step: float) -> None:
    rows = throw(120.0)
    path = np.stack([rows["x"], rows["z"]], axis=1)[:180]
    rounded = np.round(path / step) * step
    resting = np.concatenate([rounded[:90], np.repeat(rounded[89:90], 60, axis=0)])
    assert not find_held_samples(rounded).any()
    assert not find_held_samples(resting).any()


@pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), ("\t", "."), (" ", "."), ("|", ".")])
@pytest.mark.parametrize("wrap", ["", "\ufeff", "# a comment\n", "crlf"])
def test_any_delimiter_decimal_sign_and_line_end_is_read(
    tmp_path: Path, delimiter: str, decimal: str, wrap: str
) -> None:
    rows = throw()
    plain = read_track_folders([write(tmp_path / "plain", rows, FLIGHT)])
    folder = write(tmp_path / "odd", rows, FLIGHT, delimiter, decimal)
    text = (folder / "tracks.csv").read_text()
    text = text.replace("\n", "\r\n") if wrap == "crlf" else wrap + text
    (folder / "tracks.csv").write_bytes(text.encode())
    read = read_track_folders([folder])
    assert same(plain, read)
    assert "separated by" in read.notes[0]


@pytest.mark.parametrize(("text", "words"), [
    ("", "is empty"), ("0,1,2\n1,2,3\n", "has no header"), ("frame,t,id,x,z\n0,0,0,a,1,0,2\n", "has 7 values for 5"),
    ("\0\1\2", "is no text"), ("frame,t,id,x,z\n0,0,a,far,1\n", "x has a value that is not a number"),
    ("id,x,z\na,1,1\n", "has no times"), ("frame,t,id,x,x\n0,0,a,1,1\n", "x twice"),
])  # fmt: skip
def test_a_table_that_cannot_be_read_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    folder = write(tmp_path / "odd", throw(), FLIGHT)
    (folder / "tracks.csv").write_text(text)
    with pytest.raises(OptionError, match=words) as caught:
        read_track_folders([folder])
    assert "\n" not in str(caught.value)


def test_particles_are_read_by_the_same_reader(tmp_path: Path) -> None:
    rows, times = two_cameras()
    folder = write(tmp_path / "odd", rename(z="y")(rows), {}, ";", ",")
    (folder / "scene.json").unlink()
    shots, notes = read_particles(folder / "tracks.csv")
    one: Recording = shots[0]
    assert np.allclose(one.t[one.is_observed[:, 1]], times)
    assert any("decimal commas" in note for note in notes)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared material is not here")
@pytest.mark.parametrize(("odd", "control"), [
    ("held_samples/tracks_held", "held_samples/control_30Hz"),
    ("csv_semicolon_tab/semicolon", "flight_y_down/control_up"),
    ("csv_semicolon_tab/tab", "flight_y_down/control_up"),
])  # fmt: skip
def test_odd_files_of_others_equal_their_control(odd: str, control: str) -> None:
    read, plain = read_track_folders([SHARED / odd]), read_track_folders([SHARED / control])
    assert read.notes
    assert same(plain, read, 1e-5)
