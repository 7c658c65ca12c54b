"""What a second process compiles ahead of a run is what the run needs, and nothing is started once it is there."""

from __future__ import annotations

import multiprocessing
from typing import Any

import numpy as np
import pytest

from models.core.contact_graph import Contact, ContactGraph, Observations, Segment
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.joint_fit.pseudo_observations import evaluate_prior_rows
from models.numerics.jit import is_compiled
from models.physics.billiards.tables import TABLE_PRESETS
from pipeline.engine.process_setup import available_cores
from pipeline.stages import kernel_preparation
from pipeline.stages.kernel_preparation import KernelPreparation, prepare_fit_kernels

TABLE = TABLE_PRESETS["pool-9ft"]


def list_signatures(kernels: tuple[Any, ...]) -> list[set[Any]]:
    return [set(kernel.signatures) for kernel in kernels]


def test_the_kernels_of_a_fit_are_prepared() -> None:
    prepare_fit_kernels()
    prepared = list_signatures((evaluate_prior_rows,))
    still, moving = np.array([0.3, 0.3, *np.zeros(6)]), np.array([0.3, 0.3, 1.0, 0.2, 1.0, 0.2, 0.0, 0.0])
    segments = Segment(0, True, None, 0, 0.0, still), Segment(0, False, 0, None, 0.5, moving)
    t = np.arange(30) / 30
    xy = np.where(t[:, None] < 0.5, still[:2], moving[:2] + moving[2:4] * (t[:, None] - 0.5))
    seen_from_above = Observations(np.zeros(30, np.int64), t, xy, np.tile(1e3 * np.eye(2), (30, 1, 1)))
    refine_graph(ContactGraph(segments, (Contact("strike", 0.5, (0,), (1,)),)), seen_from_above, TABLE)
    assert list_signatures((evaluate_prior_rows,)) == prepared
    assert is_compiled(evaluate_prior_rows)


def test_no_process_is_started_where_the_kernels_are_there_or_the_fit_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    prepare_fit_kernels()
    before = set(multiprocessing.active_children())
    with KernelPreparation() as kernels:
        kernels.start(())
        assert set(multiprocessing.active_children()) == before
    monkeypatch.setattr(kernel_preparation, "_has_kernels", lambda: False)
    with KernelPreparation() as kernels:
        kernels.start(("read", "explain"))
        assert set(multiprocessing.active_children()) == before
        kernels.start(("read",))
        started = set(multiprocessing.active_children()) - before
        assert len(started) == min(available_cores() - 1, 1)
    assert set(multiprocessing.active_children()) == before
