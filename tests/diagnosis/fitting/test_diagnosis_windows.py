"""Shots are split only where every body has enough observations in each part."""

from __future__ import annotations

import numpy as np
from support.pucks import Pucks

from diagnosis.fitting.diagnosis_windows import fit_adaptively
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE


def test_a_body_that_was_seen_at_the_beginning_alone_is_no_stumbling_block() -> None:
    t = np.arange(90) / 30
    rng = np.random.default_rng(4)
    places = np.stack([np.outer(t, [1.0, 0.2]) + 0.3 * np.sin(9 * t)[:, None], np.outer(t, [-0.5, 0.4])], axis=1)
    places += rng.normal(0, 1e-3, places.shape)
    places[10:, 1] = np.nan
    recording = Recording(0, np.arange(90), t, ("a", "b"), places, np.full((90, 2), 1e-3), TABLE_PLANE)
    fitted = fit_adaptively(build_diagnosis_problem(Pucks(), 0.0), (recording,))
    assert all((segment.is_observed.sum(axis=0) >= 2).all() for segment in fitted.segments)
