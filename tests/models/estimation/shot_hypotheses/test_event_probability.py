"""Probabilities of events from their evidence."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from models.core.contact_graph import Contact
from models.core.fit_result import SURE_PROBABILITY
from models.estimation.shot_hypotheses import weigh_hypotheses
from models.estimation.shot_hypotheses.event_probability import (
    CATEGORIES,
    EVIDENCE_NAMES,
    EventEvidence,
    EventRow,
    compress_gain,
    compress_rival,
    count_missed_frames,
    estimate_event_probability,
    read_event_model,
)


def test_the_coefficients_cover_all_evidence_and_categories() -> None:
    model = read_event_model()
    assert len(model.weight) == len(EVIDENCE_NAMES)
    assert set(model.bias) == set(model.count) == set(CATEGORIES)
    assert set(model.unlisted_contact) == {"clear", "unclear_far", "unclear_near"}


@pytest.mark.parametrize("name", ["hidden", "misfit", "edge", "slow", "short", "apart"])
def test_evidence_against_an_event_lowers_its_probability(name: str) -> None:
    doubted = EventEvidence(**{name: 1.0})
    assert estimate_event_probability("strike", doubted) < estimate_event_probability("strike", EventEvidence())


def test_no_probability_is_nearer_to_certainty_than_the_number_of_known_shots_allows() -> None:
    limit = 1 / (read_event_model().count["cushion"] + 2)
    sure = EventEvidence(gain=100.0, misfit=-100.0)
    assert estimate_event_probability("cushion", sure) == pytest.approx(1 - limit)
    assert estimate_event_probability("cushion", EventEvidence(slow=100.0)) == pytest.approx(limit)


def test_a_rest_that_the_fit_shows_well_is_decided() -> None:
    assert estimate_event_probability("rest", EventEvidence(short=0.05)) > SURE_PROBABILITY
    doubted = EventEvidence(short=0.5, misfit=2.0)
    assert estimate_event_probability("rest", doubted) < SURE_PROBABILITY


def test_gains_and_rivals_are_compressed_monotonically() -> None:
    assert compress_gain(0.0) == 0.0
    assert compress_gain(-40.0) == -compress_gain(40.0) < 0 < compress_gain(20.0) < compress_gain(2000.0) < 10
    assert compress_rival(-5.0) == 1.0 > compress_rival(20.0) == 0.5 > compress_rival(1e6)


def test_missed_frames_are_counted_between_the_samples_around_a_time() -> None:
    times = [0.0, 0.1, 0.4, 0.5]
    assert count_missed_frames(times, 0.25, 0.1) == pytest.approx(2.0)
    assert count_missed_frames(times, 0.45, 0.1) == pytest.approx(0.0)
    assert count_missed_frames(times, 0.9, 0.1) == 0.0


@pytest.mark.parametrize(("gain", "remainder"), [(17.0, "none"), (23.0, "unexplained")])
def test_a_velocity_change_that_the_fit_needs_is_certain_whatever_its_cause(gain: float, remainder: str) -> None:
    """What it needs is what it would pay for: a contact costs a chi2 of 20."""
    graph = SimpleNamespace(contacts=[Contact("ball", 0.5, (0,), (1,), gain=gain)])
    shot = SimpleNamespace(solution=SimpleNamespace(graph=graph))
    row = EventRow("ball", 0.5, 1e-3, "cue", "red", np.zeros(2), "ball", 0, probability=0.3)
    moment = weigh_hypotheses._make_moment(shot, [(row, EventEvidence())], EventEvidence())  # type: ignore[arg-type]
    assert moment.best.cause == remainder
