"""The saved shot of a run folder: it is read back exactly, replaced in one step, and nothing kept beside it is lost."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.filmed_shots import film
from support.synthetic_run import save_shot

from models.core.corrections import BallPlace, ContactCorrection, Corrections
from models.core.errors import OptionError
from models.core.fit_result import WholeShotFit
from models.core.scene import Scene
from models.core.shot import Note, Shot
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.actions import predict_shot
from pipeline.engine.result_cache import ResultCache
from pipeline.io.kept_values import KEPT_FOLDER, find_kept_value, keep_value, load_shot
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.run_views import read_shot_record, view_run
from pipeline.io.saved_shot import FORMAT, SHOT_FILE, SHOT_FOLDER, SHOT_FORMAT, has_shot, read_shot
from pipeline.io.shot_laws import find_laws, keep_laws


@pytest.fixture(scope="module")
def shot() -> Shot:
    """A cue ball that drives two balls apart, filmed with dropped frames and marked by hand."""
    filmed = film(
        np.array([[0.5, 0.6], [1.1, 0.62], [1.2, 0.3]]), np.array([[2.6, 0.0], [0, 0], [0, 0]]), np.zeros((3, 3)),
        np.random.default_rng(4), seconds=1.6,
    )  # fmt: skip
    rows = np.flatnonzero(~np.isin(np.arange(len(filmed.tracks.t)), [30, 31]))
    tracks = replace(
        filmed.tracks, frame=filmed.tracks.frame[: len(rows)], t=filmed.tracks.t[: len(rows)],
        **{name: getattr(filmed.tracks, name)[rows]
           for name in ("xy", "px", "sigma", "sigma_along", "streak", "radius_px")},
    )  # fmt: skip
    place = BallPlace(5, *map(float, tracks.px[5, 2]))
    marks = Corrections(contacts=(ContactCorrection("mark", "cushion", 30.0, place, cushion="top"),))
    return explain(tracks, filmed.scene, corrections=marks, notes=(Note("incomplete_clip", "it breaks off"),))


def assert_equal(one: Any, other: Any) -> None:
    """Assert that two values are equal to the last bit."""
    if is_dataclass(one):
        assert type(one) is type(other)
        for field in fields(one):
            assert_equal(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_equal(a, b)
    else:
        np.testing.assert_array_equal(one, other)


def test_a_shot_is_read_back_to_the_last_bit_with_all_its_views(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path, {"break_price": 20.0}, "1.2.3")
    again = read_shot(tmp_path)
    assert_equal(shot, again)
    assert not shot.clock.is_identity
    assert shot.outcomes
    assert_equal(view_shot(shot), view_shot(again))


def test_the_document_is_strict_json_with_version_and_options(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path, {"break_price": 20.0}, "1.2.3")

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is not JSON")

    text = (tmp_path / SHOT_FOLDER / SHOT_FILE).read_text(encoding="utf-8")
    document = json.loads(text, parse_constant=refuse)
    assert (document["format"], document["program"], document["options"]) == (
        SHOT_FORMAT,
        "1.2.3",
        {"break_price": 20.0},
    )


def test_the_same_shot_gives_the_same_bytes(shot: Shot, tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        save_shot(shot, tmp_path / name)
    one, two = ({path.name: path.read_bytes() for path in (tmp_path / name / SHOT_FOLDER).iterdir()}
                for name in ("one", "two"))  # fmt: skip
    assert one == two


def test_a_new_shot_takes_the_place_of_the_old_one_and_of_its_arrays(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path)
    moved = replace(shot, whitening=2 * shot.whitening)
    save_shot(moved, tmp_path)
    assert_equal(read_shot(tmp_path), moved)
    assert len(list((tmp_path / SHOT_FOLDER).glob("*.npz"))) == 1


def test_a_shot_of_a_later_version_is_refused_with_what_to_do(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path, {}, "9.9")
    path = tmp_path / SHOT_FOLDER / SHOT_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": FORMAT + 1}))
    with pytest.raises(OptionError, match=r"saved by trueroll 9\.9.*update trueroll, or run the clip again"):
        read_shot(tmp_path)


@pytest.mark.parametrize("damage", ["document", "arrays"])
def test_a_damaged_shot_is_refused_with_what_to_do(shot: Shot, tmp_path: Path, damage: str) -> None:
    save_shot(shot, tmp_path)
    folder = tmp_path / SHOT_FOLDER
    path = folder / SHOT_FILE if damage == "document" else next(folder.glob("*.npz"))
    path.write_bytes(path.read_bytes()[: len(path.read_bytes()) // 2])
    with pytest.raises(OptionError, match=r"cannot be read .* run the clip again"):
        read_shot(tmp_path)


def test_a_folder_that_does_not_exist_is_said_not_to(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="missing does not exist; trueroll run CLIP -o"):
        read_shot(tmp_path / "missing")


def test_a_run_folder_of_an_earlier_version_says_how_to_get_a_shot(tmp_path: Path) -> None:
    (tmp_path / SOURCE_FILE).write_text("{}")
    with pytest.raises(OptionError, match=r"holds no saved shot.*run the clip again: trueroll run CLIP -o"):
        load_shot(tmp_path, None, ResultCache(tmp_path / "cache"))


def test_a_record_of_a_run_folder_is_that_of_its_shot(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path)
    record, events = read_shot_record(tmp_path), view_shot(shot).events
    np.testing.assert_array_equal(record.events.t, events.t)
    np.testing.assert_array_equal(record.events.speed, view_run(shot).events.speed)
    np.testing.assert_array_equal(record.frame, shot.tracks.frame)


def test_a_prediction_from_the_last_observation_starts_from_the_saved_shot(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_shot(shot, tmp_path)
    explained: list[float] = []

    def explain_again(tracks: Tracks, scene: Scene, _: ResultCache) -> Shot:
        explained.append(float(tracks.t[-1]))
        return explain(tracks, scene)

    monkeypatch.setattr(predict_shot, "explain_tracks", explain_again)
    last, cache = float(shot.tracks.t[-1]), ResultCache(tmp_path / "cache")
    for at, expected in ((None, []), (last, []), (last - 0.1, [pytest.approx(last - 0.1, abs=0.05)])):
        predict_shot.predict_shot(tmp_path, 0.1, at, None, None, 0, 256, tmp_path / "out", cache)
        assert explained == expected


@dataclass(frozen=True)
class Kept:
    """What an answer keeps."""

    number: int
    values: np.ndarray


def test_commands_that_keep_values_at_once_lose_nothing_and_compute_each_once(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path)
    cache, built = ResultCache(tmp_path / "cache"), []

    def keep(number: int) -> Kept:
        def build() -> Kept:
            built.append(number)
            return Kept(number, np.full(3, number))

        return keep_value(tmp_path, cache, "test", {"number": number}, Kept, __name__, build)

    with ThreadPoolExecutor(8) as pool:
        values = list(pool.map(keep, [k % 5 for k in range(40)]))
    assert [one.number for one in values] == [k % 5 for k in range(40)]
    assert sorted(built) == list(range(5))
    assert len(list((tmp_path / SHOT_FOLDER / KEPT_FOLDER / "entries").rglob("value.json"))) == 5


def test_runs_that_save_into_one_folder_at_once_leave_a_shot_that_can_be_read(shot: Shot, tmp_path: Path) -> None:
    shots = [replace(shot, moving_speed=0.02 + 0.001 * k) for k in range(6)]
    with ThreadPoolExecutor(6) as pool:
        for _ in range(5):
            list(pool.map(save_shot, shots, [tmp_path] * len(shots)))
            assert read_shot(tmp_path).moving_speed in [one.moving_speed for one in shots]


def test_a_field_that_a_later_version_added_takes_its_default(shot: Shot, tmp_path: Path) -> None:
    save_shot(shot, tmp_path)
    path = tmp_path / SHOT_FOLDER / SHOT_FILE
    document = json.loads(path.read_text())
    del document["value"]["passes"]
    path.write_text(json.dumps(document))
    assert read_shot(tmp_path).passes == ()


def test_models_that_were_kept_of_another_shot_are_not_used(shot: Shot, tmp_path: Path) -> None:
    cache, laws = ResultCache(tmp_path / "cache"), WholeShotFit(refusal="No ball moved.")
    save_shot(shot, tmp_path)
    keep_laws(tmp_path, shot, laws, cache)
    found = find_laws(tmp_path, read_shot(tmp_path), cache)
    assert found is not None
    assert found.refusal == laws.refusal
    assert find_laws(tmp_path, replace(shot, whitening=2 * shot.whitening), cache) is None


def test_a_folder_that_cannot_be_written_keeps_values_in_the_cache(
    shot: Shot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = ResultCache(tmp_path / "cache")
    save_shot(shot, tmp_path)
    monkeypatch.setattr("os.access", lambda path, mode: False)
    keep_value(tmp_path, cache, "test", {}, Kept, __name__, lambda: Kept(1, np.zeros(1)))
    assert find_kept_value(tmp_path, cache, "test", {}, Kept, __name__) is not None
    assert not (tmp_path / SHOT_FOLDER / KEPT_FOLDER).exists()


def test_a_folder_without_a_saved_shot_keeps_values_in_the_cache(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path / "cache")
    keep_value(tmp_path, cache, "test", {}, Kept, __name__, lambda: Kept(1, np.zeros(1)))
    assert not has_shot(tmp_path)
    assert list((tmp_path / "cache" / "entries").rglob("value.json"))
