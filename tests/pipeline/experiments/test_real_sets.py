"""`gapcheck --real` on a folder of sets with sealed answers: right and wrong answers, and sets that cannot be read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.pseudo_terminal import Terminal, make_terminal

from models.core.errors import OptionError
from pipeline.experiments.gapcheck.real_sets import MEASURED_SETS, list_real_sets

trueroll = pytest.fixture(make_terminal)
pytestmark = pytest.mark.usefixtures("alone")

GRAVITY, NOISE = 9.81, 3e-4


def write_slides(folder: Path, friction: float, seed: int) -> None:
    """Write five slides of 30 frames in various directions that dry friction brakes."""
    rng = np.random.default_rng(seed)
    t = np.arange(30) / 60
    rows = ["shot,frame,t,id,x,y,sigma"]
    for shot in range(5):
        heading, speed = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 2.0)
        way = speed * t - 0.5 * friction * GRAVITY * t**2
        places = way[:, None] * np.array([np.cos(heading), np.sin(heading)]) + NOISE * rng.standard_normal((30, 2))
        rows += [f"{shot},{k},{t[k]:.5f},a,{x:.6f},{y:.6f},{NOISE}" for k, (x, y) in enumerate(places)]
    folder.mkdir(parents=True)
    (folder / "tracks.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "scene.json").write_text(json.dumps({"scene": "slide", "units": "m", "fps": 60, "model": []}))


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sets")
    write_slides(folder / "ice", 0.0, 1)
    write_slides(folder / "wood", 0.1, 2)
    write_slides(folder / "mislabelled", 0.1, 3)
    answers = {
        "ice": {"accepted": [[]]},
        "wood": {"accepted": [["sliding_friction"]], "source": "simulated"},
        "mislabelled": {"accepted": [["slope"]]},
        "lost": {"accepted": [["slope"]]},
    }
    (folder / "answers.json").write_text(json.dumps(answers), encoding="utf-8")
    return folder


def test_each_set_is_one_row_with_its_answer_and_an_unreadable_one_is_named(trueroll: Terminal, sets: Path) -> None:
    done = trueroll("gapcheck", "--real", sets, "--json")
    assert done.status == 1  # one set cannot be read
    document = json.loads(done.out)
    assert document["cases"] == [], "simulated cases are not asked for"
    rows = {one["set"]: one for one in document["measured"]}
    assert rows["wood"]["named"] == ["sliding_friction"]
    assert rows["wood"]["right"]
    assert rows["wood"]["first_right"]
    assert rows["wood"]["closed"] > 0.95
    assert rows["wood"]["shares"]["sliding_friction"] == pytest.approx(rows["wood"]["closed"])
    assert rows["ice"]["verdict"] == "none"
    assert rows["ice"]["right"]
    assert rows["mislabelled"]["named"] == ["sliding_friction"]
    assert not rows["mislabelled"]["right"]
    assert "lost" in rows["lost"]["unreadable"]


def test_the_table_counts_right_answers(trueroll: Terminal, sets: Path, tmp_path: Path) -> None:
    done = trueroll("gapcheck", "--real", sets, "--only", "wood", "--keep", tmp_path)
    assert done.status == 0
    assert "right: 1 of 1; first named effect right: 1 of 1" in " ".join(done.out.split())
    assert "method" not in done.out
    assert json.loads((tmp_path / "wood" / "gap" / "gap.json").read_text())["effects"] == ["sliding_friction"]


@pytest.mark.parametrize("content", ["[1]", "{", '{"wood": {"missing": "slope"}}'])
def test_answers_that_cannot_be_read_are_one_sentence(tmp_path: Path, content: str) -> None:
    (tmp_path / "answers.json").write_text(content, encoding="utf-8")
    with pytest.raises(OptionError, match=r"answers\.json"):
        list_real_sets(tmp_path, tmp_path)


def test_a_folder_of_something_else_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="holds neither"):
        list_real_sets(tmp_path, tmp_path)


@pytest.mark.parametrize(
    ("height", "climb", "turn", "speed", "slides"),
    [
        (0.0017, 0.042, 0.85, 0.092, True),
        (0.0023, 0.0, 0.0, 0.3, False),  # an edge in the air
        (0.0, 0.058, 0.0, 0.3, False),
        (0.0, 0.0, 1.15, 0.3, False),  # it turns by 13 degrees in the 30 frames
        (0.0, 0.0, 0.0, 0.068, False),  # at rest within the errors of its velocity
    ],
)
def test_a_cube_slides_where_it_lies_flat_and_moves_without_turning(
    height: float, climb: float, turn: float, speed: float, slides: bool, tmp_path: Path
) -> None:
    toss = np.zeros((60, 13))
    toss[:, 2] = 0.0524 + 0.1  # in the air
    toss[20:50, 2], toss[20:50, 7], toss[20:50, 9], toss[20:50, 12] = 0.0524 + height, speed, climb, turn
    still = np.zeros((60, 13))
    (tmp_path / "contactnets_cube").mkdir()
    np.savez(tmp_path / "contactnets_cube" / "cube_tosses_SI_64.npz", toss=toss, still=still)
    (cube,) = [one for one in MEASURED_SETS if one.name == "sliding_cube"]
    assert [len(frames) for frames, *_ in cube.read(tmp_path)] == ([30] if slides else [])
