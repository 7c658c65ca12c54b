"""Tracks against shots of an independent simulator, and against marked centres of real clips."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.sample_clips import read_sample_truth
from support.tracking_shots import POOL, R, Seen, break_shot, observe, overhead, owners, play, scattered, switches

from models.core.detections import Detections
from models.core.errors import TrackError
from models.core.options import TrackOptions
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.tracking.build_tracks import build_tracks
from models.tracking.table_detections import project_detections
from models.tracking.tracklet_linking import link_tracklets, make_tracklet

CLOTH = overhead().cloth_lab


def _build_tracks(observed: Seen, scene: Scene | None = None) -> Tracks:
    return build_tracks(observed.detections, observed.frame, observed.t, scene or overhead())


@pytest.mark.parametrize("fps", [30, 60])
@pytest.mark.parametrize("balls", [10, 16])
def test_equal_balls_keep_their_identity_through_contacts(balls: int, fps: int) -> None:
    rng = np.random.default_rng(balls)
    observed = observe(play(*scattered(balls, rng), seconds=4.0), overhead(), fps, rng)
    tracks = _build_tracks(observed)
    assert len(tracks.ids) == balls
    assert switches(tracks, observed.px) == 0
    assert np.sum(owners(tracks, observed.px) >= 0) >= 0.99 * np.sum(observed.ball >= 0)


@pytest.mark.parametrize("fps", [30, 60])
def test_a_break_of_equal_balls_switches_few(fps: int) -> None:
    counts = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        observed = observe(play(*break_shot(16, rng), seconds=3.0), overhead(), fps, rng)
        tracks = _build_tracks(observed)
        assert len(tracks.ids) == 16
        counts.append(switches(tracks, observed.px))
    assert sum(counts) <= 10


def test_a_head_on_contact_is_no_passing_through() -> None:
    rng = np.random.default_rng(3)
    samples = play(np.array([0.5, 0.6]), np.array([1.5, 0.0]), np.array([[1.2, 0.6]]), seconds=1.5)
    observed = observe(samples, overhead(), 30, rng, clutter=0)
    tracks = _build_tracks(observed)
    assert switches(tracks, observed.px) == 0
    assert len(tracks.ids) == 2


def test_clutter_and_hands_are_no_balls() -> None:
    rng = np.random.default_rng(5)
    samples = play(np.array([0.5, 0.6]), np.array([1.0, 0.3]), np.array([[1.6, 0.3]]), seconds=3.0)
    observed = observe(samples, overhead(), 30, rng, clutter=3.0)
    frame = np.arange(10, 40)
    hand = np.array([400.0, 250.0]) + np.cumsum(rng.normal(0, 8, (30, 2)), axis=0)
    d = observed.detections
    order = np.argsort(np.concatenate([d.frame, frame]), kind="stable")
    columns = {name: np.concatenate([getattr(d, name), getattr(d, name)[:30]])[order] for name in Detections.__slots__}
    columns["frame"] = np.concatenate([d.frame, frame])[order]
    columns["centre"] = np.concatenate([d.centre, hand])[order]
    tracks = build_tracks(Detections(**columns), observed.frame, observed.t, overhead())
    assert len(tracks.ids) == 2


def _add_detections(observed: Seen, frame: np.ndarray, centre: np.ndarray, **changed: object) -> Detections:
    """Add one sharp detection per frame to a shot, of the balls' colour unless `changed` sets another."""
    d = observed.detections
    rows = {name: np.repeat(getattr(d, name)[:1], len(frame), axis=0) for name in Detections.__slots__}
    rows |= {"frame": frame, "centre": centre, "streak": np.zeros((len(frame), 2))}
    for name, value in changed.items():
        rows[name] = np.broadcast_to(np.asarray(value, float), rows[name].shape)
    order = np.argsort(np.concatenate([d.frame, frame]), kind="stable")
    return Detections(*(np.concatenate([getattr(d, name), rows[name]])[order] for name in Detections.__slots__))


def _two_balls(rng: np.random.Generator, seconds: float = 2.0) -> Seen:
    samples = play(np.array([0.5, 0.6]), np.array([1.0, 0.3]), np.array([[1.6, 0.3]]), seconds=seconds)
    return observe(samples, overhead(), 30, rng, clutter=0)


@pytest.mark.parametrize("frames", [8, 20])
def test_a_hand_that_hides_a_ball_is_not_the_beginning_of_its_track(frames: int) -> None:
    """A bridge hand turns where a ball lies, which is detected only after it is hit: the looks differ."""
    samples = play(np.array([0.5, 0.6]), np.array([1.5, 0.0]), np.array([[1.2, 0.62]]), seconds=3.0)
    observed = observe(samples, overhead(), 30, np.random.default_rng(21), clutter=0)
    hit = int(np.argmax(np.hypot(*(observed.px[:, 1] - observed.px[0, 1]).T) > 12))
    is_hidden = (observed.ball == 1) & (observed.detections.frame < hit)
    seen = replace(observed, detections=observed.detections.select_rows(~is_hidden))
    turns = np.array([0, 0, 7, 15, -9, -9, 0, 0, 12, -5, -11, 8, 0, 0, 0, 10, -14, 0, 6, -8])[-frames:]
    path = np.stack([np.cumsum(turns), np.cumsum(np.roll(turns, 3)) / 2], axis=1)
    hand = observed.px[0, 1] + 24 + path - path[-1]
    detections = _add_detections(seen, np.arange(hit - 1 - frames, hit - 1), hand, colour=[70.0, 25.0, 25.0])
    tracks = build_tracks(detections, observed.frame, observed.t, overhead())
    assert len(tracks.ids) == 2
    assert not (owners(tracks, observed.px) == -2).any()
    assert tracks.is_observed.sum() > 150


@pytest.mark.parametrize(("frames", "is_kept"), [(2, False), (3, True)])
def test_a_resting_ball_does_not_leave_in_the_last_two_frames(frames: int, is_kept: bool) -> None:
    """A hand passes over it as the clip ends, and is detected in its place."""
    observed = observe(
        play(np.array([0.5, 0.6]), np.array([1.0, 0.3]), np.array([[1.6, 0.3]]), seconds=2.0),
        overhead(), 30, np.random.default_rng(23), clutter=0, miss=0,
    )  # fmt: skip
    last = len(observed.frame) - frames
    is_hidden = (observed.ball == 1) & (observed.detections.frame >= last)
    seen = replace(observed, detections=observed.detections.select_rows(~is_hidden))
    hand = observed.px[0, 1] + np.arange(1, frames + 1)[:, None] * [40.0, 5.0]
    detections = _add_detections(seen, np.arange(last, last + frames), hand)
    tracks = build_tracks(detections, observed.frame, observed.t, overhead())
    assert (owners(tracks, observed.px) == -2).any() == is_kept


@pytest.mark.parametrize(("gap", "distance", "is_linked"), [(0.4, 0.2, True), (0.4, 0.5, False), (1.0, 0.5, True)])
def test_a_ball_that_rests_on_both_sides_of_a_gap_went_no_farther_than_it_can_slow_down(
    gap: float, distance: float, is_linked: bool
) -> None:
    t = np.concatenate([np.arange(12) / 30, 11 / 30 + gap + np.arange(12) / 30])
    xy = np.repeat([[0.8, 0.6], [0.8 + distance, 0.6]], 12, axis=0)
    scene, one = overhead(), np.ones(24)
    detections = Detections(
        np.arange(24), scene.camera.to_pixels(xy, R), 11.4 * one, np.zeros((24, 2)),
        np.tile([60.0, 0.0, 10.0], (24, 1)), 0.1 * one, 0.1 * one, 0.5 * one, one, 0.5 * one, 0.5 * one,
    )  # fmt: skip
    projected = project_detections(detections, np.arange(24), scene)
    parts = [make_tracklet(rows, rows, projected, t) for rows in (np.arange(12), np.arange(12, 24))]
    assert len(link_tracklets(parts, projected, t, POOL)) == 2 - is_linked


def test_a_hand_that_halts_and_turns_is_no_ball() -> None:
    observed = _two_balls(np.random.default_rng(20))
    turns = np.array([0, 0, 0, 9, 9, -4, -12, 0, 0, 0, 7, 15, -9, -9, 0, 0, 12, -5, -11, 8, 0, 0, 0, 10, -14, 0, 6, -8])
    hand = np.array([1000.0, 520.0]) + np.stack([np.cumsum(turns), np.cumsum(np.roll(turns, 3)) / 2], axis=1)
    detections = _add_detections(observed, np.arange(8, 8 + len(turns)), hand)
    assert len(build_tracks(detections, observed.frame, observed.t, overhead()).ids) == 2


def test_a_still_hand_detected_now_and_then_is_no_ball_but_one_that_a_player_hides_is() -> None:
    rng = np.random.default_rng(22)
    observed = _two_balls(rng)
    place = np.array([1000.0, 520.0])
    now_and_then, all_along = np.array([3, 4, 6, 7, 11, 14, 15, 18, 22, 23, 27, 31, 32, 36]), np.arange(36)
    for frame, balls in ((now_and_then, 2), (all_along, 3)):
        detections = _add_detections(observed, frame, place + rng.normal(0, 0.3, (len(frame), 2)), score=0.97)
        assert len(build_tracks(detections, observed.frame, observed.t, overhead()).ids) == balls


def test_a_streak_that_goes_nowhere_is_no_ball() -> None:
    rng = np.random.default_rng(21)
    observed = _two_balls(rng)
    sleeve = np.array([1000.0, 520.0]) + rng.normal(0, 1, (30, 2))
    detections = _add_detections(observed, np.arange(30), sleeve, streak=[2.0, 50.0], sigma_along=1.5)
    assert len(build_tracks(detections, observed.frame, observed.t, overhead()).ids) == 2


def test_a_slow_ball_takes_no_streak_that_it_cannot_have_left() -> None:
    """An edge of a cushion looks like a streak beside a ball that is hidden for one frame. No exposure is so long that
    the ball could have gone that way; a shorter streak is assigned to it.
    """
    observed = _two_balls(np.random.default_rng(24))
    hidden = (observed.ball == 1) & (observed.detections.frame == 20)
    reduced = replace(observed, detections=observed.detections.select_rows(~hidden))
    place = observed.px[20, 1] + [4.0, 2.0]
    for length, taken in ((60.0, False), (8.0, True)):
        detections = _add_detections(
            reduced, np.array([20]), place[None], streak=[0.4 * length, 0.9 * length], sigma_along=3.0
        )
        tracks = build_tracks(detections, observed.frame, observed.t, overhead())
        assert bool((np.hypot(*(tracks.px[20] - place).T) < 1.0).any()) is taken


def test_a_ball_keeps_off_a_shadow_of_the_cloths_colour() -> None:
    observed = _two_balls(np.random.default_rng(22))
    hidden = (observed.ball == 1) & (observed.detections.frame >= 20) & (observed.detections.frame < 30)
    reduced = replace(observed, detections=observed.detections.select_rows(~hidden))
    place = observed.px[20, 1] + [7.0, 3.0]
    detections = _add_detections(
        reduced, np.arange(20, 30), np.tile(place, (10, 1)), colour=np.add(CLOTH, [2.0, 3.0, 1.0])
    )
    tracks = build_tracks(detections, observed.frame, observed.t, overhead())
    assert len(tracks.ids) == 2
    assert not np.any(np.hypot(*np.moveaxis(tracks.px - place, 2, 0)) < 1.0)


def test_a_lining_of_a_pocket_is_no_ball_but_one_in_the_jaws_is() -> None:
    observed = _two_balls(np.random.default_rng(23))
    for xy, balls in (([3.4 * R, 0.8 * R], 2), ([1.3 * R, 1.3 * R], 3)):
        place = overhead().camera.to_pixels(np.array([xy]), R)
        detections = _add_detections(observed, observed.frame, np.tile(place, (len(observed.frame), 1)))
        assert len(build_tracks(detections, observed.frame, observed.t, overhead()).ids) == balls


def test_a_steady_ball_of_the_cloths_colour_stays() -> None:
    rng = np.random.default_rng(24)
    observed = _two_balls(rng)
    place = np.array([1000.0, 520.0]) + rng.normal(0, 0.3, (len(observed.frame), 2))
    detections = _add_detections(observed, observed.frame, place, colour=np.add(CLOTH, [5.0, 4.0, 3.0]))
    assert len(build_tracks(detections, observed.frame, observed.t, overhead()).ids) == 3


def test_tracklets_of_a_resting_ball_that_overlap_are_one_ball() -> None:
    observed = _two_balls(np.random.default_rng(26))
    scene, resting = overhead(), np.flatnonzero(observed.ball == 1)
    detections = project_detections(observed.detections, observed.frame, scene)
    row = np.flatnonzero(np.isin(detections.row, resting))[:12]
    frame_index = np.searchsorted(detections.first, row, side="right") - 1
    first, second = (
        make_tracklet(frame_index[part], row[part], detections, observed.t) for part in (slice(0, 7), slice(5, 12))
    )
    (joined,) = link_tracklets([first, second], detections, observed.t, scene.table)
    assert np.array_equal(joined.frame_index, frame_index)
    apart = make_tracklet(frame_index[2:12], row[2:12], detections, observed.t)
    assert len(link_tracklets([first, apart], detections, observed.t, scene.table)) == 2


def test_two_balls_that_leave_undetected_keep_their_identity() -> None:
    """The cue ball is struck behind a hand, and its object ball is one faded streak before it is in a pocket."""
    rng = np.random.default_rng(25)
    scene, colours = overhead(), np.array([[98.0, 0.0, 2.0], [50.0, 70.0, 50.0]])
    xy = np.array([[1.27, 0.35], [1.27, 0.18]])
    rows = [(k, i, *xy[i], 0.0) for k in range(60) for i in (0, 1) if k < 29 or (k == 29 and i)]
    rows += [(30, 1, 1.27, 0.08, 0.09)] + [(k, 0, 1.27, 0.24, 0.0) for k in range(30, 60)]
    table = np.array(sorted(rows))
    one, streaked = np.ones(len(table)), table[:, 4] > 0
    colour = colours[table[:, 1].astype(int)] + rng.normal(0, 2, (len(table), 3))
    colour[streaked] += 0.4 * (scene.cloth_lab - colour[streaked])
    px = scene.camera.to_pixels(table[:, 2:4], R) + rng.normal(0, 0.2, (len(table), 2))
    streak = np.stack([0 * one, 400.0 * table[:, 4]], axis=1)
    detections = Detections(
        table[:, 0].astype(np.int64), px, 11.0 * one, streak, colour, 0.1 * one, 0.1 * one, 0.5 * one, one, 0.3 * one,
        np.where(streaked, 1.5, 0.3),
    )  # fmt: skip
    tracks = build_tracks(detections, np.arange(60), np.arange(60) / 30, scene)
    assert len(tracks.ids) == 2
    ends = sorted(int(np.flatnonzero(tracks.is_observed[:, j])[-1]) for j in range(2))
    assert ends == [30, 59]


def test_a_resting_ball_behind_a_hand_stays_the_same_ball() -> None:
    rng = np.random.default_rng(6)
    samples = play(np.array([0.5, 0.6]), np.array([1.0, 0.3]), np.array([[1.6, 0.3]]), seconds=4.0)
    observed = observe(samples, overhead(), 30, rng)
    hidden = (observed.ball == 1) & (observed.detections.frame > 30) & (observed.detections.frame < 75)
    tracks = build_tracks(observed.detections.select_rows(~hidden), observed.frame, observed.t, overhead())
    assert len(tracks.ids) == 2
    column = int(np.argmax((owners(tracks, observed.px) == 1).sum(axis=0)))
    assert np.isnan(tracks.xy[31:75, column]).all()
    assert np.isfinite(tracks.xy[75:, column, 0]).mean() > 0.9


def test_a_potted_ball_ends() -> None:
    rng = np.random.default_rng(7)
    place = np.array([[0.3, 0.3]])
    aim = place[0] - [0.6, 0.6]
    samples = play(np.array([0.6, 0.6]), aim / np.hypot(*aim) * 1.5, place, seconds=3.0)
    assert samples[-1, 1, 4] == 0
    observed = observe(samples, overhead(), 30, rng)
    tracks = _build_tracks(observed)
    assert len(tracks.ids) == 2
    for j, ball in enumerate(owners(tracks, observed.px).max(axis=0)):
        end = int(np.flatnonzero(tracks.is_observed[:, j])[-1])
        assert abs(end - int(observed.detections.frame[observed.ball == ball][-1])) <= 1


def test_positions_and_sigmas_are_metres_on_the_table() -> None:
    rng = np.random.default_rng(8)
    scene = overhead()
    observed = observe(play(*scattered(6, rng, speed=1.0), seconds=2.0), scene, 30, rng, clutter=0)
    tracks = _build_tracks(observed, scene)
    truth = scene.camera.to_table(observed.px, R)
    own = owners(tracks, observed.px)
    k, j = np.nonzero(own >= 0)
    off = tracks.xy[k, j] - truth[k, own[k, j]]
    assert 0.8 < np.sqrt(np.mean((off / tracks.sigma_along[k, j, None]) ** 2)) < 1.2


def test_the_same_input_gives_the_same_tracks() -> None:
    rng = np.random.default_rng(9)
    observed = observe(play(*break_shot(16, rng), seconds=1.0), overhead(), 30, rng)
    first, second = _build_tracks(observed), _build_tracks(observed)
    assert first.ids == second.ids
    assert np.array_equal(first.xy, second.xy, equal_nan=True)


def test_a_clip_without_balls_says_so() -> None:
    rng = np.random.default_rng(10)
    observed = observe(play(*scattered(2, rng), seconds=1.0), overhead(), 30, rng)
    with pytest.raises(TrackError, match="contain none"):
        build_tracks(observed.detections.select_rows(observed.ball == -1), observed.frame, observed.t, overhead())
    with pytest.raises(TrackError, match="at least 5"):
        build_tracks(observed.detections, observed.frame[:3], observed.t[:3], overhead())


def test_the_number_of_balls_can_be_limited() -> None:
    rng = np.random.default_rng(11)
    observed = observe(play(*scattered(5, rng), seconds=1.0), overhead(), 30, rng)
    tracks = build_tracks(observed.detections, observed.frame, observed.t, overhead(), TrackOptions(balls=3))
    assert len(tracks.ids) == 3


@pytest.mark.parametrize("clip", ["carom_F1", "carom_F2", "carom_F3"])
@pytest.mark.parametrize("coloured", [True, False])
def test_marked_carom_balls_keep_their_identity(footage: Path, clip: str, coloured: bool) -> None:
    marks = json.loads((footage / f"{clip}.gt.json").read_text())
    names = sorted(marks["tracks"])
    rows = [
        (frame, i, x, y)
        for i, name in enumerate(names) for frame, x, y in filter(None, marks["tracks"][name]) if x is not None
    ]  # fmt: skip
    _check_carom_identity(rows, names, _carom_scene(marks["playing_area_centre_limits_px"]), 15.0, coloured)


@pytest.mark.parametrize("coloured", [True, False])
def test_balls_of_a_rendered_carom_clip_keep_their_identity(coloured: bool) -> None:
    truth = read_sample_truth("carom_match")
    names = sorted(truth.ids)
    rows = [
        (int(frame), names.index(truth.ids[ball]), *truth.px[frame, ball])
        for frame, ball in np.argwhere(np.isfinite(truth.px[..., 0]))
    ]
    table, scale, matrix = truth.table, truth.table.ball_radius, np.array(truth.scene["camera"]["matrix"])
    corners = np.array([[scale, scale], [table.length - scale, table.width - scale]])
    projected = np.column_stack([corners, np.full(2, scale), np.ones(2)]) @ matrix.T
    low, high = projected[:, :2] / projected[:, 2:]
    limits = {"x": (low[0], high[0]), "y": (low[1], high[1])}
    _check_carom_identity(rows, names, _carom_scene(limits), 30.0 / 1.001, coloured)


def _check_carom_identity(
    places: list[tuple[int, int, float, float]], names: list[str], scene: Scene, fps: float, coloured: bool
) -> None:
    """Track noisy detections at (frame, ball, x, y), 5 % of them missing, and compare the identities."""
    rng = np.random.default_rng(12)
    lab = {"red": (40.0, 55.0, 35.0), "white": (85.0, 0.0, 12.0), "yellow": (75.0, 5.0, 60.0)}
    rows = sorted(
        (frame, i, x + rng.normal(0, 0.3), y + rng.normal(0, 0.3)) for frame, i, x, y in places if rng.random() > 0.05
    )
    table = np.array(rows)
    one = np.ones(len(table))
    colour = np.array([lab[names[int(i)]] if coloured else (60.0, 0.0, 0.0) for i in table[:, 1]])
    colour += rng.normal(0, 3, colour.shape)
    detections = Detections(
        table[:, 0].astype(np.int64), table[:, 2:], 6.5 * one, np.zeros((len(one), 2)), colour,
        0.1 * one, 0.1 * one, 0.5 * one, one, 0.4 * one, 0.4 * one,
    )  # fmt: skip
    frame = np.unique(detections.frame)
    tracks = build_tracks(detections, frame, frame / fps, scene)
    assert len(tracks.ids) == 3
    place = {(int(k), round(x, 6)): int(i) for k, i, x, _ in rows}
    own = [
        [place[int(frame[k]), round(tracks.px[k, j, 0], 6)] for k in np.flatnonzero(tracks.is_observed[:, j])]
        for j in range(3)
    ]
    assert np.sum([np.count_nonzero(np.diff(column)) for column in own]) <= (0 if coloured else 2)
    if coloured:
        assert {tracks.kinds[j]: names[own[j][0]] for j in range(3)} == {
            "red": "red",
            "white": "white",
            "yellow": "yellow",
        }


def _carom_scene(limits: dict) -> Scene:
    """Build a camera straight above a match table, from the limits (px) that the centres of its balls reach."""
    (left, right), (top, bottom) = (limits[axis] for axis in "xy")
    table = Table("carom-match", "carom", 2.84, 1.42, 0.03075, 0.21, pockets=False)
    scene = overhead(table, px_per_m=(right - left) / (table.length - 2 * table.ball_radius))
    matrix = scene.camera.matrix.copy()
    centre = scene.camera.to_pixels(np.array([table.length, table.width]) / 2, table.ball_radius)
    shift = np.eye(3)
    shift[:2, 2] = np.array([(left + right) / 2, (top + bottom) / 2]) - centre
    return replace(scene, camera=replace(scene.camera, matrix=shift @ matrix))


def test_the_table_of_the_tests_is_a_pool_table() -> None:
    assert POOL.pocket_centres.shape == (6, 2)
