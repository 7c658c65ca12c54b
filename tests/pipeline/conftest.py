"""Runs that tests share, and commands that start no helper."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.carom_start import Home, run_start
from support.shared_runs import fill_once


@pytest.fixture(scope="session")
def home(tmp_path_factory: pytest.TempPathFactory) -> Home:
    """The quick run of the start of a sample clip; read only."""
    return Home(fill_once(tmp_path_factory, "carom-start", run_start))


@pytest.fixture
def own_home(home: Home, tmp_path: Path) -> Home:
    """A copy of its clip and its cache, in which a test may change things."""
    return home.copy_to(tmp_path / "home")


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands start no helper process, whose imports take longer than a small diagnosis."""
    monkeypatch.setattr("pipeline.engine.helper_executor.available_cores", lambda: 1)
