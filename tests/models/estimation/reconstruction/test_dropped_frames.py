"""Fits of recordings whose capture times differ from their presentation times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.filmed_shots import Filmed, match, random_shot
from support.frame_rates import convert_rate

from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot


def as_shown(shot: Filmed) -> Filmed:
    """The shot with the presentation times of its contacts."""
    tracks = convert_rate(shot.tracks)
    taken = shot.tracks.t[np.arange(len(shot.tracks.t)) % 6 != 4]
    contacts = [(float(np.interp(t, taken, tracks.t)), kind, a, b) for t, kind, a, b in shot.contacts]
    return replace(shot, tracks=tracks, contacts=contacts)


@pytest.mark.parametrize("seed", [3, 5])
def test_contacts_are_reported_at_presentation_times(seed: int) -> None:
    shot = as_shown(random_shot(seed, missing=0.0))
    fit = view_shot(explain(shot.tracks, shot.scene))
    errors, missed, extra = match(fit, shot)
    assert not missed
    assert extra == 0
    assert np.median(np.abs(errors)) < 0.003
    assert np.nanmax(np.abs(fit.residual)) < 0.01
    assert fit.trust.level == "green"


def test_speeds_are_those_of_the_real_shot() -> None:
    shot = random_shot(3, missing=0.0)
    whole, part = view_shot(explain(shot.tracks, shot.scene)), view_shot(explain(convert_rate(shot.tracks), shot.scene))
    t = 0.6 + np.arange(20) / 30
    shown = np.interp(t, shot.tracks.t[np.arange(len(shot.tracks.t)) % 6 != 4], convert_rate(shot.tracks).t)
    assert part.trajectory.at(shown).v[:, 0] == pytest.approx(whole.trajectory.at(t).v[:, 0], abs=0.03)
