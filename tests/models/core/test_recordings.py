"""Recordings: their shapes, and the positions of tracked balls as one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from support.staged_shot import tracks

from models.core.recording import Recording, ReferenceFrame
from models.core.tracks import TABLE_PLANE


def joints() -> Recording:
    """Two joints of a robot that known torques turn."""
    t, none = np.arange(4) / 10, np.full((4, 2), np.nan)
    reference = ReferenceFrame(("angle",), "rad", "from the link before")
    return Recording(
        0, np.arange(4), t, ("elbow", "wrist"), np.zeros((4, 2, 1)), none, reference, False, np.ones((4, 2, 1, 2))
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"positions": np.zeros((4, 2, 2))}, r"positions must be \(4, 2, 1\); got \(4, 2, 2\)"),
        ({"sigma": np.ones(4)}, "one sigma per row and body"),
        ({"frame": np.arange(3)}, "one frame number per row"),
        ({"inputs": np.ones((4, 2, 1))}, "a value and a rate per row and body"),
        ({"bodies": ("elbow", "elbow")}, "one unique name per body"),
        ({"t": np.array([0.0, 0.1, np.nan, 0.3])}, "forward in frame and time"),
        ({"frame": np.array([0, 1, 1, 2])}, "forward in frame and time"),
        ({"sigma": np.zeros((4, 2))}, "sigma must be positive"),
    ],
)
def test_a_value_that_does_not_fit_the_others_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(joints(), **change)


def test_inputs_stay_with_their_rows_and_bodies() -> None:
    given = np.arange(16.0).reshape(4, 2, 1, 2)
    part = replace(joints(), inputs=given).select_rows(0, 4, 2).select_body(1)
    assert part.inputs is not None
    assert np.array_equal(part.inputs, given[::2, 1:])
    assert (part.bodies, part.t.tolist()) == (("wrist",), [0.0, 0.2])


def test_a_frame_of_reference_is_named_in_messages() -> None:
    assert str(TABLE_PLANE) == "x, y (m) on the table"
    assert str(ReferenceFrame(("x",), "", "of points")) == "x of points"


def test_frames_and_balls_without_a_position_are_left_out() -> None:
    whole = tracks(np.arange(6) / 30)
    seen = whole.xy.copy()
    seen[2] = np.nan  # a frame without a ball
    seen[4, 1] = np.nan
    recording = replace(whole, xy=seen).record_positions(3)
    assert (recording.shot, recording.frame.tolist(), recording.bodies) == (3, [0, 1, 3, 4, 5], whole.ids)
    assert np.array_equal(recording.positions, seen[[0, 1, 3, 4, 5]], equal_nan=True)
    assert np.array_equal(np.isfinite(recording.sigma), recording.is_observed)
    assert recording.reference == TABLE_PLANE
    seen[:, 1] = np.nan
    assert replace(whole, xy=seen).record_positions().bodies == whole.ids[:1]


def test_the_error_of_a_blurred_ball_is_that_of_both_axes() -> None:
    whole = tracks(np.arange(3) / 30)
    blurred = replace(whole, streak=np.full(whole.streak.shape, 0.01), sigma_along=7 * whole.sigma)
    assert np.allclose(blurred.record_positions().sigma, 5 * whole.sigma)  # rms of 1 and 7
    assert np.allclose(whole.record_positions().sigma, whole.sigma)
