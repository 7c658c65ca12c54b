"""Compiles the kernels of a run in a second process while the run is on its first stages; once per installation.

Each preparation evaluates a problem without content, so that the types of its arguments are those of a run. A kernel
that both processes need is compiled by the one that comes first, see `models.numerics.jit`.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Collection
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.process import BaseProcess, parent_process
from types import TracebackType

from pipeline.engine.process_setup import available_cores, limit_garbage_collection


class KernelPreparation:
    """A process that compiles the kernels of a run, as a context manager; it ends with the `with` block."""

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._is_checked = False

    def __enter__(self) -> KernelPreparation:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._process is not None:
            self._process.terminate()
            self._process.join()

    def start(self, done: Collection[str]) -> bool:
        """Start the process if kernels are missing and this process may use a second core; only the first call acts.

        Args:
            done: Names of the stages whose results exist; the fit uses the kernels.

        Returns:
            Whether the process runs.
        """
        if not self._is_checked and "explain" not in done:
            self._is_checked = True
            if available_cores() > 1 and not _has_kernels():
                process = get_context("spawn").Process(target=_prepare_kernels, daemon=True)
                with suppress(OSError):  # no process can be started: this one compiles everything
                    process.start()
                    self._process = process
        return self._process is not None and self._process.is_alive()

    def prepare(self) -> None:
        """Load the kernels into this process before a run needs them; where they are missing, start to compile them."""
        if not self.start(()) and _has_kernels():
            prepare_fit_kernels()


def _has_kernels() -> bool:
    """Return whether the last kernels to be compiled are on disk."""
    from models.estimation.joint_fit.pseudo_observations import evaluate_prior_rows
    from models.numerics.jit import is_compiled

    return is_compiled(evaluate_prior_rows)


def _prepare_kernels() -> None:
    """Compile the kernels of a run, those first that the run itself needs last."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process decides what an interrupt ends
    limit_garbage_collection()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    prepare_fit_kernels()


def _exit_with_parent() -> None:
    """End this process when the process that started it ends, even if that was killed."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)


def prepare_fit_kernels() -> None:
    """Compile the kernels of the joint fit, those of its priors first."""
    import numpy as np

    from models.core.contact_graph import SHARED_COUNT, ContactGraph, Observations
    from models.estimation.joint_fit.fit_solution import FitParameters, build_graph_arrays
    from models.estimation.joint_fit.joint_refinement import refine_graph
    from models.estimation.joint_fit.pseudo_observations import evaluate_priors
    from models.physics.billiards.tables import TABLE_PRESETS

    table, graph = TABLE_PRESETS["pool-9ft"], ContactGraph((), ())
    parameters = FitParameters(np.zeros((0, 8)), np.zeros(0), np.ones(SHARED_COUNT))
    evaluate_priors(build_graph_arrays(graph), parameters, parameters, table)
    nothing = Observations(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)))
    refine_graph(graph, nothing, table)
