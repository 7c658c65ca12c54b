"""One method on one series, cached by its inputs and its code.

Trials in several processes, which share the cache.

They use a process pool of their own: the executors of fits have two processes and return all results at once, whereas
`--jobs` sets the number of processes here, and each trial is reported when it is finished.
"""

from __future__ import annotations

import hashlib
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    CUBIC,
    LINEAR,
    EarlyStopping,
    FittedMotion,
    MotionMethod,
    TrainingBudget,
)
from pipeline.engine.result_cache import CacheKey, ResultCache
from pipeline.engine.source_fingerprint import hash_sources, library_versions
from pipeline.engine.value_files import load_value, save_value
from pipeline.experiments.thesis.compared_methods import THESIS_NET, is_network
from pipeline.experiments.thesis.experiment_plan import ExperimentPlan, TrialTask, prepare_trial
from pipeline.experiments.thesis.thesis_scenes import (
    AssessedMotion,
    ExperimentCase,
    WithheldSeries,
    mean_squared_error,
)

STAGE = "reproduce"
# Largest counted error at a midpoint, px; larger and undefined errors are counted as this.
MAX_ERROR_PX = 1e6


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of one method on one series of H withheld midpoints."""

    case: ExperimentCase
    method: str
    mse: float
    """px^2 over the withheld midpoints: mean over points and coordinates."""
    x_linear: float
    """Ratio of the mse of linear interpolation to this one."""
    x_cubic: float
    """Ratio of the mse of the cubic spline to this one."""
    seconds: float
    """CPU time of the fit, s."""
    parameters: int
    """Number of learned parameters."""
    note: str
    """Warning about the motion; empty where there is none."""
    t: FloatArray
    """(H,) s of the midpoints."""
    error: FloatArray
    """(H,) px: root mean square over points and coordinates at each."""
    loss: FloatArray
    """(L,) training loss of a network."""
    is_trained: bool = True
    """Whether the training of a network ended by itself; else its error is not compared with others."""

    @property
    def row(self) -> dict[str, Any]:
        """The trial as a row of the contract.

        Numbers that are not finite are None, and so are ratios of a network that was not trained to the end.
        """
        ratios = {"x_linear": self.x_linear, "x_cubic": self.x_cubic} if self.is_trained else {}
        numbers = {"mse": self.mse, "x_linear": np.nan, "x_cubic": np.nan, "seconds": self.seconds, **ratios}
        finite = {name: value if np.isfinite(value) else None for name, value in numbers.items()}
        case = self.case
        return {"scene": case.scene, "variant": case.variant, "method": self.method, "fps": case.fps,
                "noise_px": case.noise, "seed": case.seed, **finite, "parameters": self.parameters,
                "trained": self.is_trained, "note": self.note}  # fmt: skip


def run_trial(method: MotionMethod, series: WithheldSeries, budget: TrainingBudget, cache: ResultCache) -> Trial:
    """Run a trial, or read it from the cache if the same was run with the same code."""
    key = _build_key(method, series, budget)
    entry = cache.find_or_build(key, lambda folder: save_value(_measure_trial(method, series, budget), folder))
    return load_value(Trial, entry.folder)


def _build_key(method: MotionMethod, series: WithheldSeries, budget: TrainingBudget) -> CacheKey:
    """Build the cache key from what the result depends on."""
    inner = method.network if isinstance(method, EarlyStopping) else method
    values = b"".join(np.ascontiguousarray(part).tobytes() for part in (series.t, series.observed, series.truth))
    parts: dict[str, Any] = {
        "case": asdict(series.case), "content": hashlib.sha256(values).hexdigest(),
        "method": [type(method).__qualname__, type(inner).__qualname__, method.name],
        "budget": [budget.effort, budget.seconds], "source": _hash_method_sources(type(inner).__module__),
        "libraries": library_versions(),
    }  # fmt: skip
    return CacheKey(STAGE, parts)


@lru_cache(maxsize=64)
def _hash_method_sources(module: str) -> dict[str, str]:
    """Hash the sources of a method and of this module."""
    return {**hash_sources(module), **hash_sources(__name__)}


def _measure_trial(method: MotionMethod, series: WithheldSeries, budget: TrainingBudget) -> Trial:
    """Run a method and compare its motion with the withheld samples."""
    t, truth = series.withheld_samples
    fitted, note = None, ""
    try:
        fitted = method.fit(*series.visible_samples, series.case.seed, budget)
    except ValueError as refusal:
        note = str(refusal)
    guess = np.full_like(truth, np.nan) if fitted is None else fitted.at(t)
    off = np.nan_to_num(guess - truth, nan=MAX_ERROR_PX, posinf=MAX_ERROR_PX, neginf=-MAX_ERROR_PX).clip(
        -MAX_ERROR_PX, MAX_ERROR_PX
    )
    error = np.sqrt(np.mean(off**2, axis=(1, 2)))
    loss = np.empty(0) if fitted is None else fitted.loss_curve
    mse = float(np.mean(off**2))
    x_linear, x_cubic = (
        mean_squared_error(curve.fit(*series.visible_samples, 0, budget).at(t), truth) / mse if mse > 0 else np.inf
        for curve in (LINEAR, CUBIC)
    )
    return Trial(
        series.case, method.name, mse, x_linear, x_cubic, fitted.seconds if fitted else np.nan,
        fitted.parameter_count if fitted else 0, note or _describe_defects(guess, fitted), t, error, loss,
        fitted is None or fitted.is_trained,
    )  # fmt: skip


def _describe_defects(guess: FloatArray, fitted: FittedMotion | None) -> str:
    """Describe the defects of a motion."""
    if not np.isfinite(guess).all():
        return "the motion is lost"
    if fitted is not None and not fitted.is_trained:
        return f"not trained to the end ({fitted.seconds:.0f} CPU s)"
    return "; ".join(fitted.warnings) if isinstance(fitted, AssessedMotion) else ""


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
    missing = [task for task in tasks if cache.find(_build_key(*prepare_trial(task, plan))) is None]
    if jobs == 1 or len(missing) <= 1:
        yield from (_run_task(plan, task, root) for task in tasks)
        return
    # fresh processes: a forked one would inherit threads of the libraries
    with ProcessPoolExecutor(min(jobs, len(missing)), multiprocessing.get_context("spawn")) as pool:
        longest_first = sorted(missing, key=lambda task: (task.method != THESIS_NET, not is_network(task.method)))
        pending = {task: pool.submit(_run_task, plan, task, root) for task in longest_first}
        try:
            for task in tasks:
                yield pending[task].result() if task in pending else _run_task(plan, task, root)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _run_task(plan: ExperimentPlan, task: TrialTask, root: Path) -> Trial:
    """Run the trial of a task, or read it from the cache."""
    return run_trial(*prepare_trial(task, plan), ResultCache(root))
