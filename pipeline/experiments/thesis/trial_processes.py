"""Trials in several processes; what the cache has is only read."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from pipeline.engine.result_cache import Cache
from pipeline.experiments.thesis.experiment_plan import Plan, Task, method_of, series_of
from pipeline.experiments.thesis.trials import Trial, is_known, tried


def carried_out(plan: Plan, tasks: Sequence[Task], root: Path, jobs: int) -> Iterator[Trial]:
    """Every trial of `tasks`, in their order."""
    cache = Cache(root)
    missing = [
        task
        for task in tasks
        if not is_known(method_of(task, plan), series_of(task.case, plan), plan.budget(task.case.scene), cache)
    ]
    if jobs == 1 or len(missing) <= 1:
        yield from (_trial(plan, task, cache) for task in tasks)
        return
    # fresh processes: a forked one would inherit threads of the libraries
    with ProcessPoolExecutor(min(jobs, len(missing)), multiprocessing.get_context("spawn")) as pool:
        pending = {task: pool.submit(_prepare, plan, task, root) for task in missing}
        try:
            for task in tasks:
                if task in pending:
                    pending[task].result()
                yield _trial(plan, task, cache)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _prepare(plan: Plan, task: Task, root: Path) -> None:
    """See to it that the cache has a trial."""
    _trial(plan, task, Cache(root))


def _trial(plan: Plan, task: Task, cache: Cache) -> Trial:
    return tried(method_of(task, plan), series_of(task.case, plan), plan.budget(task.case.scene), cache)
