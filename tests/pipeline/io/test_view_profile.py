"""View, cloth, balls and friction of a profile that every run improves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.core.errors import OptionError
from models.core.fit_result import Parameter
from pipeline.io.table_profile import parse_table_prior, read_profile_text
from pipeline.io.view_profile import collect_views, list_profile_misfits, parse_view_prior, update_profile

CORNERS = np.array([[100.0, 80.0], [1180.0, 82.0], [1178.0, 640.0], [102.0, 642.0]])
LAB = [45.0, -30.0, 5.0]


def write_run(
    folder: Path, shift: float = 0.0, rolling: float = 0.010, lab: list[float] = LAB, length: float = 2.54, **more: Any
) -> Path:
    """Write the scene.json of a run whose view is `shift` px to the right."""
    folder.mkdir(parents=True)
    corners = (CORNERS + np.array([shift, 0.0])).tolist()
    scene = {
        "scene": "billiards",
        "table": {
            "name": "pool-9ft", "game": "pool", "length": length, "width": 1.27, "pockets": True, "cloth_lab": lab,
        },
        "ball_radius": 0.028575,
        "ball_size": {"radius": 0.028575, "sigma": 3e-4, "source": "combined", "estimates": []},
        "balls": [{"id": "cue", "kind": "cue"}, {"id": "eight", "kind": "eight"}],
        "image": {"width_px": 1280, "height_px": 720},
        "calibration": {
            "plane": "noses", "matrix": [[425.0, 0, 0, 100.0], [0, 440.0, 0, 80.0], [0, 0, -0.3, 1.0]],
            "corners_px": corners, "corner_covariance_px2": (0.4 * np.eye(8)).tolist(), "camera_height": 3.0,
            "camera_height_sigma": 0.2, "camera_moves": False,
        },
        "effects": {
            "rolling_resistance": {"mu": {"value": rolling, "sigma": 5e-4, "unit": "", "prior_only": False}},
            "sliding_friction": {"mu": {"value": 0.2, "sigma": 0.004, "unit": "", "prior_only": True}},
        },
    } | more  # fmt: skip
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def test_a_new_profile_holds_what_the_run_found_and_can_be_read_by_all_readers(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    assert update_profile(path, write_run(tmp_path / "run")) == ()
    text = read_profile_text(path)
    prior = parse_view_prior(text)
    assert prior is not None
    assert prior.corners is not None
    np.testing.assert_allclose(prior.corners, CORNERS)
    assert prior.image_size == (1280, 720)
    assert prior.table.name == "pool-9ft"
    assert prior.ball_size.sigma == pytest.approx(3e-4)
    document = json.loads(text)
    assert document["balls"]["kinds"] == ["cue", "eight"]
    assert [one.name for one in parse_table_prior(text).priors if one.value == 0.010] == ["rolling_resistance.mu"]
    assert "sliding_friction" not in document["effects"]  # the shot did not determine it


def test_more_runs_improve_the_friction_but_do_not_pretend_to_know_the_corners_better(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    sigmas = []
    for k, rolling in enumerate((0.0100, 0.0104, 0.0098, 0.0102)):
        update_profile(path, write_run(tmp_path / f"run{k}", shift=0.1 * k, rolling=rolling))
        sigmas.append(json.loads(path.read_text())["effects"]["rolling_resistance"]["mu"]["sigma"])
    document = json.loads(path.read_text())
    assert document["effects"]["rolling_resistance"]["mu"]["value"] == pytest.approx(0.0101, abs=2e-4)
    assert sigmas[3] == pytest.approx(sigmas[0] / 2, rel=0.05)
    assert document["view"]["shots"] == 4
    np.testing.assert_allclose(np.diag(document["view"]["corner_covariance_px2"]), 0.4, rtol=1e-6)


def test_a_camera_that_moved_begins_the_view_anew_and_is_named(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    update_profile(path, write_run(tmp_path / "a"))
    notes = update_profile(path, write_run(tmp_path / "b", shift=6.0))
    assert len(notes) == 1
    assert "the camera stands elsewhere" in notes[0]
    prior = parse_view_prior(path.read_text())
    assert prior is not None
    assert prior.shot_count == 1
    assert prior.corners is not None
    np.testing.assert_allclose(prior.corners, CORNERS + np.array([6.0, 0.0]))


def test_another_cloth_begins_colour_and_friction_anew(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    for k in range(3):
        update_profile(path, write_run(tmp_path / f"run{k}"))
    notes = update_profile(path, write_run(tmp_path / "red", lab=[40.0, 50.0, 30.0], rolling=0.0104))
    assert len(notes) == 1
    document = json.loads(path.read_text())
    assert document["cloth"] == {"lab": [40.0, 50.0, 30.0], "shots": 1}
    assert document["effects"]["rolling_resistance"]["mu"]["value"] == pytest.approx(0.0104)
    assert document["view"]["shots"] == 4


def test_another_table_is_refused_and_the_profile_stays(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    update_profile(path, write_run(tmp_path / "a"))
    before = path.read_text()
    with pytest.raises(OptionError, match=r"2\.54 x 1\.27 m.*name another file"):
        update_profile(path, write_run(tmp_path / "b", length=2.84))
    assert path.read_text() == before


def test_friction_that_many_shots_taught_is_not_spoilt_by_one_run(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    update_profile(path, write_run(tmp_path / "a"))
    learned = json.loads(path.read_text()) | {"learned_from": {"shots": 9, "cushion_contacts": 40}}
    path.write_text(json.dumps(learned))
    update_profile(path, write_run(tmp_path / "b", rolling=0.0105))
    assert json.loads(path.read_text())["effects"] == learned["effects"]


@pytest.mark.parametrize(
    ("lab", "rolling", "words"),
    [(LAB, 0.0103, ()), ([52.0, -28.0, 8.0], 0.0103, ()), ([45.0, 2.0, -38.0], 0.0103, ("colour",)),
     (LAB, 0.0160, ("rolling_resistance.mu is 0.0160",))],
)  # fmt: skip
def test_a_changed_cloth_is_noticed_by_its_colour_and_by_its_friction(
    tmp_path: Path, lab: list[float], rolling: float, words: tuple[str, ...]
) -> None:
    path = tmp_path / "club.json"
    update_profile(path, write_run(tmp_path / "a"))
    parameters = [Parameter("rolling_resistance.mu", rolling, 6e-4, "", False)]
    misfits = list_profile_misfits(path.read_text(), np.array(lab), parameters)
    assert len(misfits) == len(words)
    assert all(word in misfit for word, misfit in zip(words, misfits, strict=True))


def test_without_a_profile_nothing_misfits() -> None:
    assert list_profile_misfits("", np.array(LAB), [Parameter("rolling_resistance.mu", 0.1, 1e-3, "", False)]) == ()


def test_a_malformed_view_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "club.json"
    update_profile(path, write_run(tmp_path / "a"))
    document = json.loads(path.read_text())
    document["view"]["corner_covariance_px2"][0][0] = -1.0
    with pytest.raises(OptionError, match="corner_covariance_px2"):
        parse_view_prior(json.dumps(document))


def test_views_of_run_folders_are_collected_for_fit_table(tmp_path: Path) -> None:
    runs = [write_run(tmp_path / name, shift=0.1) for name in "ab"]
    views = collect_views([*runs, tmp_path / "nothing"])
    assert views["view"]["shots"] == 2
    assert set(views) == {"table", "view", "cloth", "balls", "ball_radius"}
