"""Where balls lay, and which present ball belongs to which place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support import synthetic_run as shot

from models.core.scene import Table
from models.estimation.ball_places import (
    locate_balls,
    match_places,
    measure_cushion_distances,
    select_moment_before_strike,
)
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record

NO_COLOUR = np.full((3, 3), np.nan)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> ShotRecord:
    """A white ball at 1 m/s from x = 0.2 m that is said to be struck at 0.1 s, and a red one at rest."""
    clip, scene = shot.write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4"), shot.make_scene()
    fit = shot.make_fit(clip.t)
    return make_shot_record(shot.make_tracks(clip, scene), fit.events, fit.trajectory, scene.table, scene.camera)


def test_the_moment_is_three_standard_deviations_before_the_strike(record: ShotRecord) -> None:
    assert select_moment_before_strike(record) == pytest.approx(0.1 - 3 * 0.002)


def test_without_a_strike_the_moment_is_that_of_the_first_frame(record: ShotRecord) -> None:
    events = replace(record.events, probability=np.array([0.2, 0.9]))
    assert select_moment_before_strike(replace(record, events=events)) == record.shown[0]


def test_balls_are_where_the_path_has_them_with_their_speeds(record: ShotRecord) -> None:
    places = locate_balls(record, 0.25)
    assert places.ids == ("white", "red")
    np.testing.assert_allclose(places.xy, [[0.45, 0.5], [1.5, 0.3]], atol=1e-6)
    np.testing.assert_allclose(places.speed, [1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("end", [0, -1])
def test_at_the_first_and_the_last_frame_too_a_ball_lies_on_its_path(record: ShotRecord, end: int) -> None:
    """The path is stored at full milliseconds, a frame at 3.5667 s lies beside them."""
    assert record.moments[end] == record.shown[end]
    assert np.isfinite(record.path[end]).all()
    assert np.isfinite(locate_balls(record, float(record.shown[end])).speed).all()


def test_a_gap_of_the_path_is_bridged_by_observations_and_a_longer_absence_is_reported(record: ShotRecord) -> None:
    path = record.path.copy()
    path[:, 1] = np.nan
    bridged = locate_balls(replace(record, path=path), 0.25)
    np.testing.assert_allclose(bridged.xy[1], [1.5, 0.3], atol=1e-6)
    assert np.isnan(bridged.speed[1])
    early = record.ball != 1
    parts = {name: getattr(record, name)[early] for name in ("ball", "t", "xy", "px", "sigma")}
    places = locate_balls(replace(record, path=path, **parts), 0.25)
    assert places.absent == ("red",)
    assert places.ids == ("white",)


def test_distances_to_opposite_noses_add_to_the_size_of_the_table() -> None:
    table = Table("any", "pool", 2.54, 1.27, 0.0286, 0.17, True)
    left, right, top, bottom = measure_cushion_distances(table, np.array([[0.3, 0.4]]))[0]
    assert (left, top) == (0.3, 0.4)
    assert left + right == pytest.approx(table.length)
    assert top + bottom == pytest.approx(table.width)


def test_balls_of_one_kind_are_matched_by_least_total_distance() -> None:
    wanted = np.array([[0.0, 0.0], [0.1, 0.0], [1.0, 0.5]])
    present = np.array([[0.06, 0.0], [0.1, 0.05], [1.0, 0.6]])  # the first is nearest to the second place
    pairs = match_places((("red",) * 3, wanted, NO_COLOUR), (("red",) * 3, present, NO_COLOUR), 0.06)
    assert dict(zip(pairs.wanted.tolist(), pairs.present.tolist(), strict=True)) == {0: 0, 1: 1, 2: 2}


def test_kinds_win_over_distance_and_a_ball_without_a_place_stays_over() -> None:
    wanted, present = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array([[0.9, 0.0], [0.1, 0.0], [0.5, 0.0]])
    kinds, there = ("cue", "red", "black"), ("cue", "red", "yellow")
    pairs = match_places((kinds, wanted, NO_COLOUR), (there, present, NO_COLOUR), 0.06)
    assert dict(zip(pairs.wanted.tolist(), pairs.present.tolist(), strict=True)) == {0: 0, 1: 1}


def test_a_misnamed_ball_at_its_place_is_matched() -> None:
    places = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    pairs = match_places(
        (("cue", "solid", "stripe"), places, NO_COLOUR), (("cue", "solid", "solid"), places + 0.004, NO_COLOUR), 0.06
    )
    assert pairs.present.tolist() == [0, 1, 2]


def test_two_solids_are_told_apart_by_their_colours() -> None:
    colours = np.array([[50.0, 60.0, 40.0], [40.0, 10.0, -50.0], [np.nan] * 3])
    wanted, present = np.array([[0.2, 0.2], [0.8, 0.2], [1.5, 0.5]]), np.array([[0.7, 0.2], [0.3, 0.2], [1.4, 0.5]])
    pairs = match_places((("solid",) * 3, wanted, colours), (("solid",) * 3, present, colours), 0.06)
    assert pairs.present.tolist() == [0, 1, 2]


def test_nothing_present_matches_nothing() -> None:
    pairs = match_places(((), np.empty((0, 2)), np.empty((0, 3))), (("red",), np.zeros((1, 2)), np.zeros((1, 3))), 0.06)
    assert len(pairs.wanted) == 0
