"""Trials in several processes, which share the cache.

They use a process pool of their own: the executors of fits have two processes and return all results at once, whereas
`--jobs` sets the number of processes here, and each trial is reported when it is finished.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from pipeline.engine.result_cache import ResultCache
from pipeline.experiments.thesis.compared_methods import THESIS_NET, is_network
from pipeline.experiments.thesis.experiment_plan import ExperimentPlan, TrialTask, build_case_series, find_method
from pipeline.experiments.thesis.trials import Trial, is_cached, run_trial


def run_trials(plan: ExperimentPlan, tasks: Sequence[TrialTask], root: Path, jobs: int) -> Iterator[Trial]:
    """Run trials, in this process or in several.

    Args:
        plan: The requested experiments.
        tasks: Tasks to run.
        root: Folder of the cache.
        jobs: Number of processes.

    Yields:
        The trial of each task, in their order.
    """
    cache = ResultCache(root)
    missing = [
        task
        for task in tasks
        if not is_cached(
            find_method(task, plan), build_case_series(task.case, plan), plan.budget(task.case.scene), cache
        )
    ]
    if jobs == 1 or len(missing) <= 1:
        yield from (_run_task(plan, task, cache) for task in tasks)
        return
    # fresh processes: a forked one would inherit threads of the libraries
    with ProcessPoolExecutor(min(jobs, len(missing)), multiprocessing.get_context("spawn")) as pool:
        longest_first = sorted(missing, key=lambda task: (task.method != THESIS_NET, not is_network(task.method)))
        pending = {task: pool.submit(_fill_cache, plan, task, root) for task in longest_first}
        try:
            for task in tasks:
                if task in pending:
                    pending[task].result()
                yield _run_task(plan, task, cache)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _fill_cache(plan: ExperimentPlan, task: TrialTask, root: Path) -> None:
    """Run a trial so that the cache holds it."""
    _run_task(plan, task, ResultCache(root))


def _run_task(plan: ExperimentPlan, task: TrialTask, cache: ResultCache) -> Trial:
    """Run the trial of a task, or read it from the cache."""
    return run_trial(find_method(task, plan), build_case_series(task.case, plan), plan.budget(task.case.scene), cache)
