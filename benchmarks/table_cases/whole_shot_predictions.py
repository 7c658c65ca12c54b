"""Whole shots from one state, fitted to the first second: the error after each cushion on the way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.table_cases.recorded_shots import list_contact_times
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.forecast.forecast_check import estimate_state
from models.estimation.table_learning.learned_table import LearnedTable
from pipeline.engine.result_cache import ResultCache

# s, until which a shot is fitted.
STATE_TIME = 1.0
# mm RMS.
GOAL = 5.0


@dataclass(frozen=True)
class WholeShotRow:
    """One moving ball of one shot; mm."""

    group: int
    shot: int
    ball: str
    contacts: int
    """Contacts of the ball with cushions and balls after the state."""
    rms_fourth: float
    """RMS of the places until the fourth contact, or the last where there are fewer."""
    rms_last: float
    after: str
    """Median error after each number of cushions, from 0 on, by spaces."""


def score_whole_shot(
    group: int, number: int, tracks: Tracks, scene: Scene, learned: LearnedTable, cache: ResultCache
) -> Iterator[WholeShotRow]:
    """Simulate the rest of a shot from its most probable state, without random deviations, and compare."""
    state = estimate_state(tracks, scene, STATE_TIME, learned)
    law = state.most_probable_law
    later = tracks.t[tracks.t > STATE_TIME]
    run = state.simulate_ahead(state.simulation_inputs(state.mean, law), law, float(later[-1] - STATE_TIME) + 1e-3)
    places = run.states_at(later - STATE_TIME)[..., :2]
    for ball, name in enumerate(state.ids):
        column = tracks.ids.index(name)
        true, is_observed = tracks.xy[-len(later) :, column], tracks.is_observed[-len(later) :, column]
        cushions = np.array(list_contact_times(tracks, scene, cache, column))
        contacts = np.array(list_contact_times(tracks, scene, cache, column, ("cushion", "ball")))
        contacts, cushions = contacts[contacts > STATE_TIME], cushions[cushions > STATE_TIME]
        if not state.moving[ball] or not len(contacts):
            continue
        error = 1e3 * np.hypot(*(places[:, ball] - true).T)
        fourth, last = contacts[min(3, len(contacts) - 1)], contacts[-1]
        rms = [float(np.sqrt(np.mean(error[is_observed & (later <= end)] ** 2))) for end in (fourth, last)]
        passed = np.searchsorted(cushions, later)
        after = [
            np.median(error[is_observed & (passed == k)])
            for k in range(len(cushions) + 1)
            if np.any(is_observed & (passed == k))
        ]
        yield WholeShotRow(group, number, name, len(contacts), *rms, " ".join(f"{one:.1f}" for one in after))


def print_whole_shots(rows: list[WholeShotRow]) -> None:
    """Print the error by the number of cushions on the way, and the share within `GOAL`."""
    if not rows:
        return
    print(f"\nwhole shots from the state at {STATE_TIME:g} s: {len(rows)} moving balls")
    print("| cushions on the way | balls | error: median, 75 % |\n|---|---|---|")
    errors = [[float(one) for one in row.after.split()] for row in rows]
    for k in range(max(len(one) for one in errors)):
        part = [one[k] for one in errors if len(one) > k]
        print(f"| {k} | {len(part)} | {np.median(part):.0f}, {np.quantile(part, 0.75):.0f} mm |")
    for name, values in (
        ("fourth", [one.rms_fourth for one in rows if one.contacts >= 4]),
        ("last", [one.rms_last for one in rows]),
    ):
        share = np.mean(np.array(values) <= GOAL) if values else np.nan
        print(
            f"within {GOAL:g} mm RMS until the {name} contact: {share:.0%} of {len(values)}"
            f" (median {np.median(values or [np.nan]):.0f} mm)"
        )
