"""Where the gap shows: the phases in which a known cause acts, all phases where what is missing is unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.fitting.fit_residuals import DRAWS, Residuals
from diagnosis.fitting.residual_blocks import Block, Finding, Structure
from diagnosis.verdicts.localisation import places, shape
from models.estimation.gap_scenes.gap_scene import Recording

ROWS = 480
PHASES = ("free_roll", "cushion_contact", "ball_contact")
EXCESS = {"free_roll": 1.0, "cushion_contact": 3.0, "ball_contact": 0.0}
"""variance beyond that of the noise"""
NOTHING: frozenset[str] = frozenset()


def pieces() -> tuple[Recording, ...]:
    """Four shots, of whose films the first two show other balls in the first place than the last two."""
    frame = np.arange(ROWS // 8)
    return tuple(
        Recording(shot, frame, frame / 60, names, np.zeros((len(frame), 2, 2)), np.full((len(frame), 2), 0.001))
        for shot, names in enumerate((("white", "red"), ("white", "red"), ("red", "blue"), ("red", "blue")))
    )


def left(extra: dict[str, float], seed: int = 0) -> Residuals:
    """Noise of size 1, and more of it in some phases."""
    rng = np.random.default_rng(seed)
    window, row, body = np.repeat(np.arange(4), ROWS // 4), np.tile(np.repeat(np.arange(60), 2), 4), np.arange(ROWS) % 2
    phase = np.array(PHASES)[rng.integers(0, 3, ROWS)]
    spread = np.sqrt(1 + np.array([extra[name] for name in phase]))
    velocity = rng.normal(size=(ROWS, 2))
    return Residuals(
        left=spread[:, None] * rng.normal(size=(ROWS, 2)), drawn=rng.normal(size=(ROWS, 2, DRAWS)), window=window,
        shot=window, body=body, frame=row, t=row / 60, phase=phase, place=rng.normal(size=(ROWS, 2)), velocity=velocity,
        since_contact=np.full(ROWS, np.nan), image=None, size=1.0,
    )  # fmt: skip


def test_shares_are_those_of_the_squares_beyond_noise() -> None:
    """Three phases of alike many observations whose excess is as 1 to 3 to 0: within what 160 draws of each scatter."""
    found = {one.phase: one.share for one in places(left(EXCESS), pieces(), NOTHING)}
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["cushion_contact"] == pytest.approx(0.75, abs=0.1)
    assert found["free_roll"] == pytest.approx(0.25, abs=0.1)


def test_what_is_unknown_is_shown_in_all_phases_largest_first() -> None:
    found = places(left(EXCESS), pieces(), NOTHING)
    assert {one.phase for one in found} == set(PHASES)
    assert found[0].phase == "cushion_contact"
    assert [one.share for one in found] == sorted((one.share for one in found), reverse=True)


def test_a_known_cause_is_shown_where_it_acts_alone() -> None:
    found = places(left(EXCESS), pieces(), frozenset({"free_roll", "after_strike"}))
    assert [(one.phase, one.share) for one in found] == [("free_roll", 1.0)]


def test_a_cause_of_phases_that_were_not_seen_hides_none() -> None:
    assert {one.phase for one in places(left(EXCESS), pieces(), frozenset({"flight"}))} == set(PHASES)


def test_a_cause_of_the_camera_is_shown_in_the_picture_and_with_what_it_grows() -> None:
    found = replace(left(dict.fromkeys(PHASES, 0.0)), image=np.random.default_rng(1).normal(size=(ROWS, 2)))
    radius = np.linalg.norm(found.image, axis=1)
    found.left[:] *= (1 + 3 * radius / radius.max())[:, None]
    told = places(found, pieces(), frozenset({"image_region"}))
    assert [(one.phase, one.share, one.grows_with) for one in told] == [("image_region", 1.0, "radius")]


def test_the_ball_that_holds_most_is_named_by_its_name_in_every_film() -> None:
    """Red stands second in two films and first in two."""
    found = left(dict.fromkeys(PHASES, 0.0))
    red = found.body == np.where(found.window < 2, 1, 0)
    found.left[red] *= 3
    assert {one.ball for one in places(found, pieces(), NOTHING)} == {"red"}
    assert {one.shot for one in places(found, pieces(), NOTHING)} == {None}


def test_one_shot_that_holds_most_is_named() -> None:
    found = left(dict.fromkeys(PHASES, 0.0))
    found.left[found.shot == 2] *= 4
    assert {one.shot for one in places(found, pieces(), NOTHING)} == {2}


@pytest.mark.parametrize("name", ["time", "speed"])
def test_what_the_gap_grows_with_is_named(name: str) -> None:
    found = left(dict.fromkeys(PHASES, 0.0))
    number = found.t if name == "time" else found.speed
    found.left[:] *= (1 + 3 * number / number.max())[:, None]
    assert {one.grows_with for one in places(found, pieces(), NOTHING)} == {name}


def test_what_stands_out_is_told_in_words_where_it_is_beyond_chance() -> None:
    everything = np.ones(ROWS, bool)
    findings = (
        Finding(Block("phase", "cushion_contact", everything), "across", 12.4),
        Finding(Block("slow", "everywhere", everything), "waves", 6.0),
        Finding(Block("since_contact", "0.1 to 0.2", everything), "along", 4.6),
        Finding(Block("speed", "1 to 2", everything), "along", 3.9),
    )
    assert shape(Structure(1e-6, findings)).split("; ") == [
        "across the motion at cushions (12 times what chance does)",
        "slowly, as time goes by everywhere (6 times what chance does)",
        "along the motion 0.1 to 0.2 s after a contact (5 times what chance does)",
    ]
