"""The files of a run hold what was measured and fitted, in the columns that others rely on."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.fit_result import Fit, Parameter, WholeShotFit, WholeShotSolution
from models.core.scene import BallSize, Scene
from models.core.tracks import Tracks
from models.estimation.reconstruction.plausibility import CONTACT_FLOOR
from pipeline.engine.value_files import load_value, save_value
from pipeline.io.csv_tables import write_events
from pipeline.io.run_tables import write_scene, write_tracks, write_trajectory
from video.io.clip import Clip

TRACKS = "shot,frame,t,id,kind,x_px,y_px,x,y,sigma,radius_px,observed"
EVENTS = "shot,kind,t,t_sigma,frame,a,b,x,y,probability,gap_mm,gap_mm_sigma,speed"
TRAJECTORY = "shot,t,id,x,y,vx,vy,wx,wy,wz,sigma,sigma_v"


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Clip:
    return shot.write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4")


@pytest.fixture
def scene() -> Scene:
    """The made-up table under a camera 3 m above its middle, which sees the cloth as the made-up one does."""
    scene = shot.make_scene()
    height, (x, y) = 3.0, scene.table.corners.mean(axis=0)
    f, u, v = shot.PX_PER_M * height, 20 + shot.PX_PER_M * x, 20 + shot.PX_PER_M * y
    matrix = np.array([[f, 0, -u, height * u - f * x], [0, f, -v, height * v - f * y], [0, 0, -1, height]])
    return replace(scene, camera=replace(scene.camera, matrix=matrix))


@pytest.fixture
def tracks(clip: Clip, scene: Scene) -> Tracks:
    """The white ball was not observed in the fourth frame."""
    tracks = shot.make_tracks(clip, scene)
    hidden = np.zeros(tracks.is_observed.shape, bool)
    hidden[3, 0] = True
    return replace(
        tracks,
        xy=np.where(hidden[..., None], np.nan, tracks.xy),
        px=np.where(hidden[..., None], np.nan, tracks.px),
        sigma=np.where(hidden, np.nan, tracks.sigma),
        radius_px=np.where(hidden, np.nan, tracks.radius_px),
    )


@pytest.fixture
def fit(tracks: Tracks) -> Fit:
    return shot.make_fit(tracks.t)


def rows(path: Path, header: str) -> list[dict[str, str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == header
    return list(csv.DictReader(lines))


def test_tracks_have_a_row_per_ball_and_frame_and_mark_what_physics_filled_in(
    scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    write_tracks(scene, tracks, fit, tmp_path / "tracks.csv")
    table = rows(tmp_path / "tracks.csv", TRACKS)
    assert len(table) == 2 * shot.FRAMES
    (filled,) = [row for row in table if row["observed"] == "0"]
    assert (filled["id"], filled["frame"]) == ("white", "3")
    assert float(filled["x"]) == pytest.approx(0.2 + shot.SPEED * 3 / shot.RATE, abs=1e-3)
    place = np.array([float(filled["x"]), float(filled["y"])])
    px = scene.camera.to_pixels(place, scene.table.ball_radius)
    assert [float(filled["x_px"]), float(filled["y_px"])] == pytest.approx(list(px), abs=1e-2)
    assert float(filled["radius_px"]) == pytest.approx(shot.PX_PER_M * scene.table.ball_radius, rel=0.05)
    for row in table:
        assert float(row["t"]) == pytest.approx(int(row["frame"]) / shot.RATE, abs=1e-4)
        assert float(row["sigma"]) >= 0


def test_a_duplicate_frame_has_no_row(scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path) -> None:
    is_distinct = np.arange(len(tracks.frame)) != 5
    names = ("frame", "t", "xy", "px", "sigma", "sigma_along", "streak", "radius_px")
    distinct = replace(tracks, **{name: getattr(tracks, name)[is_distinct] for name in names})
    write_tracks(scene, distinct, fit, tmp_path / "tracks.csv")
    assert "5" not in {row["frame"] for row in rows(tmp_path / "tracks.csv", TRACKS)}


def test_where_no_physics_holds_nothing_is_filled_in(scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path) -> None:
    measured = replace(fit, trajectory=replace(fit.trajectory, phase=("measured", "rest")))
    write_tracks(scene, tracks, measured, tmp_path / "tracks.csv")
    table = rows(tmp_path / "tracks.csv", TRACKS)
    assert len(table) == 2 * shot.FRAMES - 1
    assert {row["observed"] for row in table} == {"1"}


def test_events_are_in_seconds_and_gaps_in_millimetres(fit: Fit, tmp_path: Path) -> None:
    events = replace(
        fit.events, gap=np.full(len(fit.events), 0.002), gap_sigma=np.full(len(fit.events), np.nan)
    )  # fmt: skip
    write_events(events, tmp_path / "events.csv")
    table = rows(tmp_path / "events.csv", EVENTS)
    assert [row["kind"] for row in table] == list(events.kind)
    assert [float(row["t"]) for row in table] == pytest.approx(list(events.t))
    assert {float(row["gap_mm"]) for row in table} == {2.0}
    assert {row["gap_mm_sigma"] for row in table} == {""}, "unknown is an empty cell"


def test_the_trajectory_has_a_thousand_rows_per_second_and_ball(fit: Fit, tmp_path: Path) -> None:
    write_trajectory(fit.trajectory, tmp_path / "trajectory.csv")
    white = [row for row in rows(tmp_path / "trajectory.csv", TRAJECTORY) if row["id"] == "white"]
    t = np.array([float(row["t"]) for row in white])
    assert np.diff(t) == pytest.approx(0.001)
    assert t[0] == 0
    assert t[-1] == pytest.approx((shot.FRAMES - 1) / shot.RATE, abs=1e-3)
    assert [float(row["x"]) for row in white] == pytest.approx(list(0.2 + shot.SPEED * t), abs=1e-5)
    assert {float(row["vx"]) for row in white} == {shot.SPEED}


def test_the_scene_is_that_of_a_track_folder_and_strict_json(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    odd = replace(fit, chi2_per_dof=float("nan"))
    write_scene(clip, scene, tracks, odd, tmp_path / "scene.json")
    text = (tmp_path / "scene.json").read_text(encoding="utf-8")
    document = json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert (document["scene"], document["units"], document["fps"]) == ("billiards", "m", shot.RATE)
    assert document["ball_radius"] == scene.table.ball_radius
    table = {name: document["table"][name] for name in ("length", "width")}
    assert table == {"length": scene.table.length, "width": scene.table.width}
    assert document["image"]["px_per_m"] == pytest.approx(shot.PX_PER_M, rel=0.05)
    assert (document["image"]["width_px"], document["image"]["height_px"]) == (clip.width, clip.height)
    assert np.shape(document["calibration"]["corner_covariance_px2"]) == (8, 8)
    assert document["effects"]["rolling_resistance"]["mu"]["sigma"] == 0.001
    assert document["effects"]["rolling_resistance"]["mu"]["unit"] == "1"
    assert "rolling_resistance" in document["model"]
    assert document["trust"]["light"] == "green"
    assert [ball["id"] for ball in document["balls"]] == ["white", "red"]
    assert document["balls"][0]["vx"] == shot.SPEED


def test_contact_models_of_whole_shots_are_in_the_scene_with_the_spin_they_determine(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    write_scene(clip, scene, tracks, replace(fit, laws=WholeShotFit(refusal="No ball moved.")), tmp_path / "scene.json")
    assert json.loads((tmp_path / "scene.json").read_text())["laws"]["why"] == "No ball moved."
    parameters = (
        Parameter("cushion_restitution.e", 0.9, 0.01, "1", False),
        Parameter("collision_radius.factor", 1.01, 0.002, "1", True),
        Parameter("nose.left", 0.001, 0.0005, "m", False),
    )
    state = np.array([[0.2, 0.5, 1.0, 0.0, 0.0, 35.0, 7.0]])
    laws = WholeShotSolution("han_2005", "inelastic", 1.1, parameters, 0.1, ("white",), state, np.eye(7)[None])
    write_scene(clip, scene, tracks, replace(fit, laws=WholeShotFit(laws)), tmp_path / "scene.json")
    document = json.loads((tmp_path / "scene.json").read_text())
    assert set(document["effects"]) == {"cushion_restitution"}
    assert document["laws"]["cushion"] == "han_2005"
    assert document["laws"]["collision_radius"]["value"] == pytest.approx(1.01 * scene.table.ball_radius)
    assert document["laws"]["noses"]["left"]["sigma"] == 0.0005
    white, red = document["balls"]
    assert (white["t"], white["wy"], white["wz"]) == (0.1, 35.0, 7.0)
    assert np.shape(white["covariance"]) == (7, 7)
    assert np.shape(red["covariance"]) == (4, 4)


def test_the_scene_lists_the_ball_size_with_its_independent_estimates(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    estimates = BallSize(0.03, 1e-4, "preset"), BallSize(0.0304, 6e-4, "image")
    scene = replace(scene, ball_size_estimates=estimates)
    touching = Parameter("ball_size.factor", 1.01, 0.012, "", False)
    write_scene(clip, scene, tracks, replace(fit, parameters=(*fit.parameters, touching)), tmp_path / "scene.json")
    document = json.loads((tmp_path / "scene.json").read_text())
    size = document["ball_size"]
    assert (size["radius"], size["sigma"], size["source"]) == (0.03, 1e-4, "combined")
    assert size["radius"] == document["ball_radius"]
    assert [one["source"] for one in size["estimates"]] == ["preset", "image", "contacts"]
    # without the prior 1 +- 0.02, touching balls are larger and less certain than with it
    assert size["estimates"][2]["radius"] == pytest.approx(0.03 * (1 + 0.01 / (1 - 0.36)))
    assert size["estimates"][2]["sigma"] == pytest.approx(0.03 * np.hypot(0.012 / 0.8, CONTACT_FLOOR))
    assert "ball_size" not in document["effects"]


def test_the_cache_returns_a_scene_with_its_ball_size(scene: Scene, tmp_path: Path) -> None:
    scene = replace(scene, ball_size_estimates=(BallSize(0.03, 5e-5, "user"), BallSize(0.033, 6e-4, "image")))
    save_value(scene, tmp_path)
    loaded = load_value(Scene, tmp_path)
    assert loaded.ball_size_estimates == scene.ball_size_estimates
    assert loaded.ball_size == scene.ball_size == BallSize(0.03, 5e-5, "user")


def test_a_shot_in_which_nothing_was_seen_still_makes_whole_files(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    nobody = replace(
        tracks, ids=(), kinds=(), xy=tracks.xy[:, :0], px=tracks.px[:, :0], sigma=tracks.sigma[:, :0],
        sigma_along=tracks.sigma_along[:, :0], streak=tracks.streak[:, :0], radius_px=tracks.radius_px[:, :0],
        colour=tracks.colour[:0], looks=(),
    )  # fmt: skip
    motion = fit.trajectory
    still = replace(
        motion, ids=(), ball=motion.ball[:0], start=motion.start[:0], end=motion.end[:0], position=motion.position[:0],
        spin=motion.spin[:0], phase=(), covariance=motion.covariance[:0],
    )  # fmt: skip
    nothing = replace(
        fit, trajectory=still, residual=fit.residual[:, :0], moving=fit.moving[:, :0], accepted=fit.accepted[:, :0]
    )
    write_tracks(scene, nobody, nothing, tmp_path / "tracks.csv")
    write_trajectory(nothing.trajectory, tmp_path / "trajectory.csv")
    write_scene(clip, scene, nobody, nothing, tmp_path / "scene.json")
    assert rows(tmp_path / "tracks.csv", TRACKS) == []
    assert rows(tmp_path / "trajectory.csv", TRAJECTORY) == []
    assert json.loads((tmp_path / "scene.json").read_text())["balls"] == []


def test_scene_json_lists_the_places_to_check(clip: Clip, scene: Scene, tracks: Tracks, tmp_path: Path) -> None:
    write_scene(clip, scene, tracks, shot.make_unsure_fit(tracks.t), tmp_path / "scene.json")
    first, second = json.loads((tmp_path / "scene.json").read_text(encoding="utf-8"))["check_here"]
    expected = {
        "frame": 15, "t": 0.5, "balls": ["white"], "x": 0.7, "y": 0.5, "uncertainty": pytest.approx(0.39),
        "codes": ["undecided"],
        "reason": "White: what it met at 0.5000 s ± 1.0 ms is unsure: right short rail 61 %, something else 39 %;"
        " too few frames"
        " show the motion before or after.",
    }  # fmt: skip
    px = scene.camera.to_pixels(np.array([0.7, 0.5]), scene.table.ball_radius)
    assert [first.pop("x_px"), first.pop("y_px")] == pytest.approx(list(px))
    assert first == expected
    assert (second["balls"], second["frame"]) == (["white", "red"], 21)


def test_scene_json_of_a_sure_shot_has_no_place_to_check(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, tmp_path: Path
) -> None:
    write_scene(clip, scene, tracks, fit, tmp_path / "scene.json")
    assert json.loads((tmp_path / "scene.json").read_text(encoding="utf-8"))["check_here"] == []
