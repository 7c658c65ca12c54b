"""Walls and known inputs of track folders: spellings, splines, and errors in one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.errors import OptionError
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene

T = np.arange(40) / 60


def write_folder(place: Path, scene: dict[str, Any], columns: dict[str, Any], ids: tuple[str, ...] = ("puck",)) -> Path:
    """A folder with 40 frames of each body; a column is an array (40,) or text."""
    place.mkdir()
    (place / "scene.json").write_text(json.dumps(scene))
    rows = [
        ",".join([f"0,{k},{t:.9f},{name}", *(str(v if isinstance(v, str) else v[k]) for v in columns.values())])
        for k, t in enumerate(T)
        for name in ids
    ]
    (place / "tracks.csv").write_text("\n".join([f"shot,frame,t,id,{','.join(columns)}", *rows]) + "\n")
    return place


def write_slide(place: Path, **entries: Any) -> Path:
    return write_folder(place, {"scene": "slide", **entries}, {"x": 0.1 + 0.8 * T, "y": 0.25 + 0.0 * T})


@pytest.mark.parametrize(
    "walls",
    [
        [0, 0, 1, 0.5],
        [1, 0.5, 0, 0],
        {"x": [0, 1], "y": [0.5, 0]},
        {"length": 1, "width": 0.5},
    ],
)
def test_walls_limit_the_centre_of_a_body(walls: Any, tmp_path: Path) -> None:
    scene = build_gap_scene(read_track_folders([write_slide(tmp_path / "a", walls=walls, radius=0.05)]))
    assert isinstance(scene, ContactFreeScene)
    assert np.allclose(scene.walls, [(0.05, 0.95), (0.05, 0.45)])


@pytest.mark.parametrize("walls", [[0, 0, 1], "box", {"x": [0, 1]}, [0, 0, 0, 1], {"x": [0, "far"], "y": [0, 1]}, 3])
def test_walls_that_are_no_rectangle_are_refused(walls: Any, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"walls: needs a rectangle as \[x0, y0, x1, y1\], \{\"x\""):
        read_track_folders([write_slide(tmp_path / "a", walls=walls)])


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"walls": [0, 0, 1, 0.5], "radius": 0.3}, "radius 0.3 m does not fit"),
        ({"walls": [0, 0, 100, 50]}, None),
        ({"walls": [0, 0, 0.2, 0.5]}, "x goes from 0.1 to 0.62 m, but the walls keep it between 0 and 0.2 m"),
        ({"model": ["wall_friction"]}, r"wall_friction needs walls in scene.json; state them as \[x0"),
        ({"scene": "flight", "walls": [0, 0, 1, 1]}, "walls belong to the scene slide"),
    ],
)
def test_walls_that_contradict_the_folder_are_one_sentence(
    entries: dict[str, Any], words: str | None, tmp_path: Path
) -> None:
    read = read_track_folders([write_slide(tmp_path / "a", **entries)])
    if words is None:
        assert "wall_friction: no body meets a wall" in build_gap_scene(read).not_tested
        return
    with pytest.raises(OptionError, match=words):
        build_gap_scene(read)


def test_folders_with_other_walls_are_not_put_together(tmp_path: Path) -> None:
    places = [write_slide(tmp_path / str(k), walls=[0, 0, 1, 1 + k]) for k in range(2)]
    with pytest.raises(OptionError, match="states other walls, radius or known inputs"):
        read_track_folders(places)


def read_inputs(place: Path, scene: str, **columns: Any) -> np.ndarray:
    coordinates = {"x": T, "y": T} if scene == "slide" else {"theta1": T}
    read = read_track_folders([write_folder(place, {"scene": scene}, {**coordinates, **columns})])
    assert read.inputs == tuple(columns)
    inputs = read.recordings[0].inputs
    assert inputs is not None
    return inputs[:, 0]


def test_a_force_is_a_spline_and_a_platform_its_second_derivative(tmp_path: Path) -> None:
    w = 2 * np.pi * 1.5
    given = read_inputs(tmp_path / "a", "slide", force_y=np.sin(w * T), platform_x=0.02 * np.cos(w * T))
    inner = slice(4, -4)
    assert np.allclose(given[inner, 1, 0], np.sin(w * T)[inner], atol=1e-4)
    assert np.allclose(given[inner, 1, 1], w * np.cos(w * T)[inner], atol=1e-3)
    assert np.allclose(given[inner, 0, 0], 0.02 * w**2 * np.cos(w * T)[inner], atol=5e-3)


def test_the_inputs_of_a_pendulum_are_torque_and_acceleration_of_the_pivot(tmp_path: Path) -> None:
    given = read_inputs(tmp_path / "a", "pendulum", torque=3.0 * T, pivot_y=0.5 * 2.0 * T**2)
    assert np.allclose(given[:, 0], np.stack([3.0 * T, np.full(40, 3.0)], axis=1), atol=1e-4)
    assert not given[:, 1].any()
    assert np.allclose(given[:, 2, 0], 2.0, atol=1e-3)


def test_an_input_with_gaps_is_interpolated(tmp_path: Path) -> None:
    sparse = [f"{value:.6f}" if k % 5 == 0 else "" for k, value in enumerate(np.sin(3 * T))]
    given = read_inputs(tmp_path / "a", "slide", force_x=sparse)
    assert np.allclose(given[:36, 0, 0], np.sin(3 * T)[:36], atol=1e-3)


@pytest.mark.parametrize(
    ("scene", "columns", "words"),
    [
        (
            "slide",
            {"x": T, "y": T, "torque": T},
            "has the column torque, a known input|takes the inputs force_x, force_y",
        ),
        ("billiards", {"x": T, "y": T, "pivot_x": T}, "the scene billiards takes no known inputs; remove or rename it"),
        ("flight", {"x": T, "z": T, "axis_y": T}, "a spin axis needs axis_x, axis_y, axis_z beside x, y, z"),
        ("pendulum", {"theta1": T, "force_x": T}, "takes the inputs torque, pivot_x, pivot_y"),
        ("slide", {"x": T, "y": T, "force_x": ""}, "shot 0: puck has no value of force_x"),
        ("slide", {"x": T, "y": T, "force_x": "strong"}, "the column force_x has a value that is not a number"),
    ],
)
def test_an_input_that_cannot_act_is_one_sentence(
    scene: str, columns: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(OptionError, match=words):
        read_track_folders([write_folder(tmp_path / "a", {"scene": scene}, columns)])


def test_of_a_spin_axis_only_the_direction_counts(tmp_path: Path) -> None:
    columns = {"x": T, "y": T, "z": T, "axis_x": 0 * T + 3.0, "axis_y": 0 * T, "axis_z": 0 * T - 4.0}
    read = read_track_folders([write_folder(tmp_path / "a", {"scene": "flight"}, columns)])
    inputs = read.recordings[0].inputs
    assert inputs is not None
    assert np.allclose(inputs[:, 0, :, 0], [0.6, 0.0, -0.8])
    assert np.allclose(inputs[..., 1], 0.0)
    scene = build_gap_scene(read)
    assert isinstance(scene, ContactFreeScene)
    assert scene.input_count == 3


def test_another_column_is_no_input(tmp_path: Path) -> None:
    columns = {"x": T, "y": T, "force": T, "current": T}
    read = read_track_folders([write_folder(tmp_path / "a", {"scene": "slide"}, columns)])
    assert read.inputs == ()
    assert read.recordings[0].inputs is None
