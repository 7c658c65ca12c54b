"""Rivals of the benchmarks work as they are meant to, and one that cannot be installed says so."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.interpolation.interpolation_rivals import FlowBothWays, blend_frames, run_minterpolate
from benchmarks.support import rival_environment
from benchmarks.support.figures import MissingInputError
from benchmarks.support.rival_environment import RivalEnvironment


def draw_square(x: int) -> np.ndarray:
    """Draw a square of blocks at x px on a dark ground."""
    image = np.full((128, 192, 3), 40, np.uint8)
    blocks = np.random.default_rng(0).integers(60, 255, (4, 4), dtype=np.uint8)
    image[48:80, x : x + 32] = np.kron(blocks, np.ones((8, 8), np.uint8))[..., None]
    return cv2.GaussianBlur(image, (0, 0), 1)


def test_rivals_with_motion_show_a_moving_square_halfway_and_a_blend_does_not() -> None:
    visible, between = [draw_square(x) for x in (60, 68, 76, 84)], draw_square(72)
    made = run_minterpolate(visible, 2)
    assert len(made) == 7
    assert all(np.abs(made[2 * k].astype(int) - frame).mean() < 2 for k, frame in enumerate(visible))
    flow = FlowBothWays(visible[1], visible[2]).synthesize(0.5)
    blend = blend_frames(visible[1], visible[2], 0.5)
    by_flow, by_blocks, by_blend = (np.abs(f.astype(int) - between).mean() for f in (flow, made[3], blend))
    assert max(by_flow, by_blocks) < 0.5 * by_blend


@pytest.mark.slow
def test_a_rival_that_cannot_be_installed_is_one_sentence_and_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rival_environment, "CACHE", tmp_path)
    rival = RivalEnvironment("rival", (str(tmp_path / "missing-1.0-py3-none-any.whl"),))
    for _ in range(2):
        with pytest.raises(MissingInputError, match=r"the environment of rival cannot be made: .+") as error:
            rival.prepare()
        assert "missing-1.0" in str(error.value)
        assert not list(tmp_path.glob("*/complete"))
