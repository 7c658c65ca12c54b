"""A frame rate that cannot be is doubted."""

from __future__ import annotations

from dataclasses import replace

import pytest
from support.filmed_shots import random_shot

from models.core.shot import Note
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.io.run_views import assess_run_trust


def list_doubts(time_factor: float) -> list[Note]:
    """List the doubts in a shot whose times are so many times too long."""
    shot = random_shot(3, missing=0.0)
    tracks = replace(shot.tracks, t=time_factor * shot.tracks.t)
    return [note for note in explain(tracks, shot.scene).notes if note.code == "implausible_deceleration"]


@pytest.mark.parametrize(("factor", "deceleration"), [(3.0, 1 / 9), (0.45, 4.94)])
def test_times_that_are_too_long_or_too_short_are_doubted(factor: float, deceleration: float) -> None:
    (note,) = list_doubts(factor)
    assert float(note.detail) == pytest.approx(9.81 * 0.01 * deceleration, rel=0.3)


@pytest.mark.parametrize("factor", [1.0, 0.8])
def test_times_of_a_usual_table_are_not_doubted(factor: float) -> None:
    assert list_doubts(factor) == []


def test_a_doubted_rate_is_said_and_the_level_is_not_green() -> None:
    shot = random_shot(3, missing=0.0)
    fit = view_shot(explain(shot.tracks, shot.scene))
    trust = assess_run_trust((Note("implausible_deceleration", "0.011"),), fit)
    assert trust.level == "amber"
    assert "slow down by 0.011 m/s²" in trust.reasons[0]
    assert "(3.0 times the stated one would agree), run it again with that." in trust.reasons[0]
