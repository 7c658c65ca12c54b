"""Two processes give the bits of one, whichever does what, and one that is lost is not missed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import numpy as np
import pytest

from diagnosis.fitting.hypothesis_fits import fit, question_of
from models.estimation.gap_scenes.gap_scene import Recording
from models.estimation.gap_scenes.sliding_scene import slide_scene
from models.numerics.executor import ALONE, Crew
from pipeline.engine.helper_process import Pair


@pytest.fixture(scope="module")
def pair() -> Iterator[Pair]:
    found = Pair()
    found.wait()
    assert found.ready
    yield found
    found.close()


def whose(subject: str, number: int) -> tuple[str, int, int]:
    """Who does a job."""
    time.sleep(0.02)
    return subject, number, os.getpid()


def lost_after(subject: int, number: int) -> int:
    """Ends every process but one, after its first jobs."""
    if number < 6 and os.getpid() != subject:
        os._exit(9)
    time.sleep(0.01)
    return number


def failing(_: int, number: int) -> int:
    time.sleep(0.01)
    if number == 5:
        raise ValueError("five is too many")
    return number


def pushed(shot: int) -> Recording:
    """A body that drag slows down, seen with an error of 0.5 mm."""
    rng = np.random.default_rng(shot)
    t = np.arange(40) / 30
    angle = rng.uniform(0, 2 * np.pi)
    way = rng.uniform(0.5, 1.5) * (1 - np.exp(-0.8 * t)) / 0.8
    seen = np.outer(way, [np.cos(angle), np.sin(angle)]) + 5e-4 * rng.standard_normal((len(t), 2))
    return Recording(shot, np.arange(len(t)), t, ("cube",), seen[:, None], np.full((len(t), 1), 5e-4))


def fitted(crew: Crew) -> list[bytes]:
    """All that a fit gives, to the last bit."""
    question = question_of(slide_scene(()), 0.3, crew)
    found = fit(question, tuple(pushed(shot) for shot in range(6)), ("viscous_drag", "slope")).shooting
    arrays = (found.shared, found.covariance, *found.starts, *found.start_covariances)
    return [array.tobytes() for array in arrays] + [repr((found.cost, found.log_evidence)).encode()]


def test_both_work_and_answers_keep_their_order(pair: Pair) -> None:
    for subject in ("first", "second"):
        found = pair.each(subject, whose, [(k,) for k in range(12)])
        assert [(one[0], one[1]) for one in found] == [(subject, k) for k in range(12)]
        assert {one[2] for one in found} >= {os.getpid()}
        assert len({one[2] for one in found}) == 2


def test_a_fit_has_the_same_bits(pair: Pair) -> None:
    jobs_there = pair.handed_over
    assert fitted(pair) == fitted(ALONE)
    assert pair.handed_over > jobs_there + 10, "and the other did its part"


def test_what_fails_there_fails_here(pair: Pair) -> None:
    with pytest.raises(ValueError, match="five is too many"):
        pair.each(0, failing, [(k,) for k in range(8)])
    assert [one[1] for one in pair.each("next", whose, [(1,), (2,), (3,)])] == [1, 2, 3], "no answer is mixed up"


def test_a_helper_that_is_lost_is_not_missed() -> None:
    mine = Pair()
    mine.wait()
    mine.each("it imports this module", whose, [(k,) for k in range(4)])
    assert mine.each(os.getpid(), lost_after, [(k,) for k in range(8)]) == list(range(8))
    assert not mine.ready
    assert mine.each(os.getpid(), lost_after, [(k,) for k in range(8)]) == list(range(8))
    mine.close()


def test_nobody_is_waited_for_that_has_not_started() -> None:
    mine = Pair()
    assert [one[2] for one in mine.each("alone", whose, [(1,), (2,)])] == [os.getpid()] * 2
    mine.close()
    assert ALONE.each("alone", whose, [(1,)])[0][2] == os.getpid()
