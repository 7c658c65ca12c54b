"""Dropped frames: found where balls jump ahead, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import add_pauses, find_time_jumps

FPS, SIGMA, DECELERATION = 30.0, 0.0003, 0.1


def rolling(rng: np.random.Generator, speed: float, turn_at: float | None = None) -> Recording:
    """Two balls of 4 s: one rolls to rest, one rests; at `turn_at` (s) the first one bounces back."""
    t = np.arange(120) / FPS
    before = np.minimum(t, speed / DECELERATION)
    x = speed * before - DECELERATION * before**2 / 2
    if turn_at is not None:
        at = np.interp(turn_at, t, x)
        x = np.where(t > turn_at, at - 0.7 * (x - at), x)
    xy = np.full((len(t), 2, 2), 0.5)
    xy[:, 0, 0] = x
    xy += SIGMA * rng.standard_normal(xy.shape)
    return Recording(0, np.arange(len(t)), t, ("cue", "red"), xy, np.full((len(t), 2), SIGMA), TABLE_PLANE)


def drop_frames(whole: Recording, lost: NDArray[np.bool_]) -> Recording:
    """Drop the frames `lost` (T,); number and time the rest without a gap."""
    rows = np.flatnonzero(~lost)
    return replace(whole.select_rows(0, len(rows)), positions=whole.positions[rows], sigma=whole.sigma[rows])


@pytest.mark.parametrize("count", [1, 2, 6])
def test_lost_frames_are_counted(count: int) -> None:
    right = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        whole = rolling(rng, rng.uniform(0.25, 0.8))
        lost = np.zeros(120, bool)
        at = int(rng.integers(12, 40))
        lost[at : at + count] = True
        result = find_time_jumps(drop_frames(whole, lost), 1 / FPS)
        right += [(jump.after, jump.lost_frames) for jump in result] == [(at - 1, count)]
    assert right == 10


def test_several_losses_are_found_in_one_recording() -> None:
    lost = np.zeros(120, bool)
    lost[[20, 45, 46]] = True
    shown = drop_frames(rolling(np.random.default_rng(3), 0.6), lost)
    result = find_time_jumps(shown, 1 / FPS)
    assert [jump.lost_frames for jump in result] == [1, 2]
    assert np.allclose(add_pauses(shown.t, result, 1 / FPS), (np.arange(120) / FPS)[~lost])


def test_contacts_and_whole_recordings_are_no_losses() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        assert find_time_jumps(rolling(rng, rng.uniform(0.2, 1.0)), 1 / FPS) == ()
        assert find_time_jumps(rolling(rng, rng.uniform(0.2, 1.0), turn_at=rng.uniform(0.4, 1.5)), 1 / FPS) == ()


def test_a_strike_is_no_loss() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        whole = rolling(rng, rng.uniform(0.2, 1.0))
        still = np.concatenate([np.repeat(whole.positions[:1], 20, axis=0), whole.positions[:100]])
        assert find_time_jumps(replace(whole, positions=still), 1 / FPS) == ()


def test_frames_lost_near_a_contact_are_found_where_they_are_expected() -> None:
    """A turn four frames after the loss leaves too few on that side for a camera without known losses."""
    rng, lost = np.random.default_rng(4), np.zeros(120, bool)
    lost[[round(FPS) - 5, round(FPS) - 4]] = True
    for _ in range(10):
        whole = rolling(rng, rng.uniform(0.8, 1.5), turn_at=1.0)
        shown = drop_frames(whole, lost)
        assert find_time_jumps(shown, 1 / FPS) == ()
        (result,) = find_time_jumps(shown, 1 / FPS, expected=True)
        assert result.lost_frames == 2
    for _ in range(20):
        assert find_time_jumps(rolling(rng, rng.uniform(0.2, 1.0), turn_at=1.0), 1 / FPS, expected=True) == ()
