"""Splines through measured positions."""

from __future__ import annotations

import numpy as np
import pytest

from models.estimation.reconstruction.trajectory_assembly import (
    fit_cubic_pieces,
    fit_linear_pieces,
    fit_smoothing_pieces,
)


def test_splines_pass_through_their_samples_and_smoothing_stays_within_errors() -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 30))
    xy = np.stack([np.sin(t), t**2], axis=1)
    for pieces in (fit_linear_pieces(t, xy), fit_cubic_pieces(t, xy)):
        np.testing.assert_allclose(pieces[:, 0], xy[:-1])
    noisy = xy + np.random.default_rng(1).normal(size=xy.shape) * 0.01
    breaks, pieces = fit_smoothing_pieces(np.linspace(0, 2, 30), noisy, np.full(30, 0.01))
    assert len(breaks) == len(pieces) + 1 < 30
    row = np.clip(np.searchsorted(breaks, np.linspace(0, 2, 30), side="right") - 1, 0, len(pieces) - 1)
    tau = np.linspace(0, 2, 30) - breaks[row]
    curve = np.einsum("tk,tkd->td", tau[:, None] ** np.arange(4), pieces[row])
    assert np.sqrt(np.mean((curve - noisy) ** 2)) == pytest.approx(0.01, rel=0.3)
