"""Completion of tracks from detections that no ball has, and cuts where the look changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.tracking_shots import Seen, observe, overhead, play

from models.tracking.table_detections import project_detections
from models.tracking.track_completion import complete_tracks
from models.tracking.tracklet_linking import LOOK_FRAMES, Tracklet, cut_tracklets, make_tracklet


def _film() -> Seen:
    samples = play(np.array([0.5, 0.6]), np.array([2.0, 0.3]), np.array([[1.6, 0.9]]), seconds=1.5)
    observed = observe(samples, overhead(), 30, np.random.default_rng(1), clutter=0)
    return replace(
        observed, detections=observed.detections.select_rows(observed.ball >= 0), ball=observed.ball[observed.ball >= 0]
    )


def _track(observed: Seen, ball: int, frames: range) -> tuple[Tracklet, np.ndarray]:
    """Return a track of a ball in these frames, and all rows of that ball."""
    table = project_detections(observed.detections, observed.frame, overhead())
    own = np.flatnonzero(observed.ball[table.row] == ball)
    frame_of = np.repeat(np.arange(len(observed.t)), np.diff(table.first))
    kept = own[np.isin(frame_of[own], list(frames))]
    return make_tracklet(frame_of[kept], kept, table, observed.t), own


def test_a_track_that_begins_late_is_extended_to_the_rest_before_the_strike() -> None:
    observed = _film()
    table = project_detections(observed.detections, observed.frame, overhead())
    last = len(observed.t)
    late, own = _track(observed, 0, range(14, last))
    other, _ = _track(observed, 1, range(last))
    completed = complete_tracks([late, other], [], table, observed.t, overhead().table)
    assert len(late.row) < len(own)
    assert np.array_equal(completed[0].row, own)
    assert np.array_equal(completed[1].row, other.row)


def test_a_gap_is_filled_by_the_ball_and_not_by_clutter_of_another_colour() -> None:
    observed = _film()
    table = project_detections(observed.detections, observed.frame, overhead())
    last = len(observed.t)
    whole, own = _track(observed, 0, range(last))
    frames = whole.frame_index[(whole.frame_index < 10) | (whole.frame_index > 13)]
    gapped = make_tracklet(frames, own[np.isin(whole.frame_index, frames)], table, observed.t)
    colour = table.colour.copy()
    hidden = own[(whole.frame_index >= 10) & (whole.frame_index <= 13)]
    other, _ = _track(observed, 1, range(last))
    filled = complete_tracks([gapped, other], [], table, observed.t, overhead().table)
    assert set(hidden.tolist()) <= set(filled[0].row.tolist())
    colour[hidden] = np.add(table.cloth, [2.0, 1.0, 0.0])
    shadowed = complete_tracks([gapped, other], [], replace(table, colour=colour), observed.t, overhead().table)
    assert not set(hidden.tolist()) & set(shadowed[0].row.tolist())


@pytest.mark.parametrize(("reach", "is_filled"), [(0.02, True), (0.8, False)])
def test_what_rests_elsewhere_while_a_ball_is_hidden_is_another_body(reach: float, is_filled: bool) -> None:
    """Two nets sway in turn at opposite pockets; a ball that a player nudges is the same one."""
    observed = _film()
    table = project_detections(observed.detections, observed.frame, overhead())
    whole, own = _track(observed, 1, range(len(observed.t)))
    xy = table.xy.copy()
    is_hidden = (whole.frame_index > 13) & (whole.frame_index < 30)
    xy[own] = np.where(is_hidden[:, None], [1.6, 0.9 - reach], [1.6, 0.9])
    xy[own] += np.random.default_rng(2).normal(0, 3e-4, (len(own), 2))
    table = replace(table, xy=xy)
    gapped = make_tracklet(whole.frame_index[~is_hidden], own[~is_hidden], table, observed.t)
    other, _ = _track(observed, 0, range(len(observed.t)))
    filled = complete_tracks([gapped, other], [], table, observed.t, overhead().table)
    assert bool(np.isin(own[is_hidden], filled[0].row).any()) == is_filled


@pytest.mark.parametrize(("change", "is_cut"), [(14.0, False), (26.0, True)])
def test_a_track_is_cut_where_its_colour_becomes_that_of_another_ball(change: float, is_cut: bool) -> None:
    """The colours of neighbouring balls of a set differ by 20 in CIE Lab; light and coding change one ball by less."""
    observed = _film()
    table = project_detections(observed.detections, observed.frame, overhead())
    whole, own = _track(observed, 0, range(30))
    rows = own[:24]
    colour = table.colour.copy()
    colour[rows] = np.add([60.0, 20.0, 30.0], np.outer(np.arange(24) >= 12, [0.0, change, 0.0]))
    colour[rows] += np.random.default_rng(1).normal(0, 1.0, (24, 3))
    parts = cut_tracklets([(whole.frame_index[:24], rows)], replace(table, colour=colour), observed.t)
    ends = [int(part.frame_index[-1]) for part in parts[:-1]]
    assert bool(ends) == is_cut
    assert all(abs(end - whole.frame_index[12]) < LOOK_FRAMES for end in ends)
