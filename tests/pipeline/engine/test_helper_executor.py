"""Two processes give the same bits as one, however tasks are shared, also if one of them dies."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator

import numpy as np
import pytest
from support.noise_estimates import assume_correlation
from support.reference_frames import PLANE

from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects
from models.core.recording import Recording
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene
from models.numerics.executor import SERIAL, Executor
from pipeline.engine.helper_executor import DeferredExecutor, HelperExecutor
from pipeline.engine.process_setup import available_cores


@pytest.fixture(scope="module")
def executor() -> Iterator[HelperExecutor]:
    executor = HelperExecutor()
    executor.wait_until_ready()
    assert executor.is_ready
    yield executor
    executor.close()


def identify_process(subject: str, number: int) -> tuple[str, int, int]:
    """Return the process that runs the task."""
    time.sleep(0.02)
    return subject, number, os.getpid()


def exit_early(subject: int, number: int) -> int:
    """End every process except one in the first tasks."""
    if number < 6 and os.getpid() != subject:
        os._exit(9)
    time.sleep(0.01)
    return number


def fail_at_five(_: int, number: int) -> int:
    time.sleep(0.01)
    if number == 5:
        raise ValueError("five is too many")
    return number


def simulate_slide(shot: int) -> Recording:
    """Simulate a body that drag slows down, observed with an error of 0.5 mm."""
    rng = np.random.default_rng(shot)
    t = np.arange(20) / 30
    angle = rng.uniform(0, 2 * np.pi)
    way = rng.uniform(0.5, 1.5) * (1 - np.exp(-0.8 * t)) / 0.8
    observed = np.outer(way, [np.cos(angle), np.sin(angle)]) + 5e-4 * rng.standard_normal((len(t), 2))
    return Recording(shot, np.arange(len(t)), t, ("cube",), observed[:, None], np.full((len(t), 1), 5e-4), PLANE)


def fit_to_bytes(executor: Executor) -> list[bytes]:
    """Fit, and return all results as bytes."""
    question = build_diagnosis_problem(build_sliding_scene(()), assume_correlation(0.3), executor)
    shooting = fit_effects(
        question, tuple(simulate_slide(shot) for shot in range(3)), ("viscous_drag", "slope")
    ).shooting
    arrays = (shooting.shared, shooting.covariance, *shooting.starts, *shooting.start_covariances)
    return [array.tobytes() for array in arrays] + [repr((shooting.cost, shooting.log_evidence)).encode()]


def test_both_processes_work_and_results_keep_their_order(executor: HelperExecutor) -> None:
    for subject in ("first", "second"):
        results = executor.map_tasks(subject, identify_process, [(k,) for k in range(12)])
        assert [(one[0], one[1]) for one in results] == [(subject, k) for k in range(12)]
        assert {one[2] for one in results} >= {os.getpid()}
        assert len({one[2] for one in results}) == 2


def test_a_fit_has_the_same_bits(executor: HelperExecutor) -> None:
    batches_before = executor.submitted_batches
    assert fit_to_bytes(executor) == fit_to_bytes(SERIAL)
    assert executor.submitted_batches > batches_before + 10, "the helper ran its share"


def test_an_exception_in_the_helper_is_raised_here(executor: HelperExecutor) -> None:
    with pytest.raises(ValueError, match="five is too many"):
        executor.map_tasks(0, fail_at_five, [(k,) for k in range(8)])
    assert [one[1] for one in executor.map_tasks("next", identify_process, [(1,), (2,), (3,)])] == [1, 2, 3], (
        "no results are mixed up"
    )


def test_the_tasks_of_a_dead_helper_are_run_here() -> None:
    executor = HelperExecutor()
    executor.wait_until_ready()
    executor.map_tasks("it imports this module", identify_process, [(k,) for k in range(4)])
    assert executor.map_tasks(os.getpid(), exit_early, [(k,) for k in range(8)]) == list(range(8))
    assert not executor.is_ready
    assert executor.map_tasks(os.getpid(), exit_early, [(k,) for k in range(8)]) == list(range(8))
    executor.close()


def test_a_deferred_executor_starts_no_process_before_it_is_asked_to() -> None:
    before = set(multiprocessing.active_children())
    with DeferredExecutor() as executor:
        assert len(executor.map_tasks("alone", identify_process, [(1,), (2,)])) == 2
        assert set(multiprocessing.active_children()) == before
        executor.start()
        executor.start()
        assert len(set(multiprocessing.active_children()) - before) == min(available_cores() - 1, 1)
    assert set(multiprocessing.active_children()) == before


def test_tasks_do_not_wait_for_a_helper_that_has_not_started() -> None:
    executor = HelperExecutor()
    assert [one[2] for one in executor.map_tasks("alone", identify_process, [(1,), (2,)])] == [os.getpid()] * 2
    executor.close()
    assert SERIAL.map_tasks("alone", identify_process, [(1,)])[0][2] == os.getpid()
