"""The gap is located in the phases where a known cause acts, or in all phases if the cause is unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.fitting.fit_residuals import NOISE_DRAWS, FitResiduals, GroupFinding, ObservationGroup, ResidualStructure
from diagnosis.verdicts.gap_localisation import describe_structure, localise_gap
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE

ROWS = 480
PHASES = ("free_roll", "cushion_contact", "ball_contact")
EXCESS = {"free_roll": 1.0, "cushion_contact": 3.0, "ball_contact": 0.0}
"""variance beyond that of the noise"""
NOTHING: frozenset[str] = frozenset()


def segments() -> tuple[Recording, ...]:
    """Four shots, of whose films the first two show other balls in the first place than the last two."""
    frame = np.arange(ROWS // 8)
    return tuple(
        Recording(
            shot, frame, frame / 60, names, np.zeros((len(frame), 2, 2)), np.full((len(frame), 2), 0.001), TABLE_PLANE
        )
        for shot, names in enumerate((("white", "red"), ("white", "red"), ("red", "blue"), ("red", "blue")))
    )


def make_residuals(extra: dict[str, float], seed: int = 0) -> FitResiduals:
    """Noise of size 1, and more of it in some phases."""
    rng = np.random.default_rng(seed)
    window, row, body = np.repeat(np.arange(4), ROWS // 4), np.tile(np.repeat(np.arange(60), 2), 4), np.arange(ROWS) % 2
    phase = np.array(PHASES)[rng.integers(0, 3, ROWS)]
    spread = np.sqrt(1 + np.array([extra[name] for name in phase]))
    velocity = rng.normal(size=(ROWS, 2))
    return FitResiduals(
        values=spread[:, None] * rng.normal(size=(ROWS, 2)), noise_draws=rng.normal(size=(ROWS, 2, NOISE_DRAWS)),
        window=window, shot=window, body=body, t=row / 60, phase=phase, position=rng.normal(size=(ROWS, 2)),
        velocity=velocity, since_contact=np.full(ROWS, np.nan), image=None, reference=TABLE_PLANE, scale=1.0,
    )  # fmt: skip


def test_shares_are_those_of_the_squares_beyond_noise() -> None:
    """Three phases of alike many observations whose excess is as 1 to 3 to 0: within what 160 draws of each scatter."""
    shares = {one.phase: one.share for one in localise_gap(make_residuals(EXCESS), segments(), NOTHING)}
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["cushion_contact"] == pytest.approx(0.75, abs=0.1)
    assert shares["free_roll"] == pytest.approx(0.25, abs=0.1)


def test_what_is_unknown_is_shown_in_all_phases_largest_first() -> None:
    locations = localise_gap(make_residuals(EXCESS), segments(), NOTHING)
    assert {one.phase for one in locations} == set(PHASES)
    assert locations[0].phase == "cushion_contact"
    assert [one.share for one in locations] == sorted((one.share for one in locations), reverse=True)


def test_a_known_cause_is_shown_where_it_acts_alone() -> None:
    locations = localise_gap(make_residuals(EXCESS), segments(), frozenset({"free_roll", "after_strike"}))
    assert [(one.phase, one.share) for one in locations] == [("free_roll", 1.0)]


def test_a_cause_of_phases_that_were_not_seen_hides_none() -> None:
    assert {one.phase for one in localise_gap(make_residuals(EXCESS), segments(), frozenset({"flight"}))} == set(PHASES)


def test_a_cause_of_the_camera_is_shown_in_the_picture_and_with_what_it_grows() -> None:
    residuals = replace(
        make_residuals(dict.fromkeys(PHASES, 0.0)), image=np.random.default_rng(1).normal(size=(ROWS, 2))
    )
    radius = np.linalg.norm(residuals.image, axis=1)
    residuals.values[:] *= (1 + 3 * radius / radius.max())[:, None]
    locations = localise_gap(residuals, segments(), frozenset({"image_region"}))
    assert [(one.phase, one.share, one.grows_with) for one in locations] == [("image_region", 1.0, "radius")]


def test_the_ball_that_holds_most_is_named_by_its_name_in_every_film() -> None:
    """Red stands second in two films and first in two."""
    residuals = make_residuals(dict.fromkeys(PHASES, 0.0))
    red = residuals.body == np.where(residuals.window < 2, 1, 0)
    residuals.values[red] *= 3
    assert {one.ball for one in localise_gap(residuals, segments(), NOTHING)} == {"red"}
    assert {one.shot for one in localise_gap(residuals, segments(), NOTHING)} == {None}


def test_one_shot_that_holds_most_is_named() -> None:
    residuals = make_residuals(dict.fromkeys(PHASES, 0.0))
    residuals.values[residuals.shot == 2] *= 4
    assert {one.shot for one in localise_gap(residuals, segments(), NOTHING)} == {2}


@pytest.mark.parametrize("name", ["time", "speed"])
def test_what_the_gap_grows_with_is_named(name: str) -> None:
    residuals = make_residuals(dict.fromkeys(PHASES, 0.0))
    number = residuals.t if name == "time" else residuals.speed
    residuals.values[:] *= (1 + 3 * number / number.max())[:, None]
    assert {one.grows_with for one in localise_gap(residuals, segments(), NOTHING)} == {name}


def test_what_stands_out_is_told_in_words_where_it_is_beyond_chance() -> None:
    everything = np.ones(ROWS, bool)
    findings = (
        GroupFinding(ObservationGroup("phase", "cushion_contact", everything), "across", 12.4),
        GroupFinding(ObservationGroup("slow", "in all shots", everything), "waves", 6.0),
        GroupFinding(ObservationGroup("since_contact", "0.1 to 0.2", everything), "along", 4.6),
        GroupFinding(ObservationGroup("speed", "1 to 2", everything), "along", 3.9),
    )
    assert describe_structure(ResidualStructure(1e-6, findings), TABLE_PLANE).split("; ") == [
        "a shift across the motion at cushions (12 standard deviations of noise)",
        "a slow drift in all shots (6 standard deviations of noise)",
        "a shift along the motion 0.1 to 0.2 s after a contact (5 standard deviations of noise)",
    ]
