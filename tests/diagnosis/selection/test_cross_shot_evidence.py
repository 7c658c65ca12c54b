"""Shots confirm the strengths that other shots determine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.reference_frames import PLANE

from diagnosis.selection.study import split_folds
from models.core.recording import Recording

ONE = Recording(0, np.arange(9), np.arange(9) / 60, ("a",), np.zeros((9, 1, 2)), np.full((9, 1), 1e-3), PLANE)
SHOTS = tuple(replace(ONE, shot=number) for number in (4, 1, 7))


def test_shots_that_were_spared_confirm() -> None:
    assert split_folds(SHOTS[:2], SHOTS[2:]) == [(SHOTS[:2], SHOTS[2:])]


def test_few_shots_confirm_what_the_others_tell() -> None:
    folds = [({one.shot for one in others}, {one.shot for one in here}) for others, here in split_folds(SHOTS, ())]
    assert folds == [({4, 7}, {1}), ({1, 7}, {4}), ({1, 4}, {7})]


def test_one_shot_confirms_nothing() -> None:
    assert split_folds(SHOTS[:1], ()) == []
