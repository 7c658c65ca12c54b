"""Shared places for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from support.planted_mistakes import CleanRun

ROOT = Path(__file__).resolve().parent.parent
FOOTAGE = ROOT.parent / "shared" / "data" / "billiards"


@pytest.fixture
def footage() -> Path:
    """Real clips that are not ours to ship; the test skips where they are absent."""
    if not FOOTAGE.is_dir():
        pytest.skip(f"real footage is not at {FOOTAGE}")
    return FOOTAGE


@pytest.fixture(scope="session")
def clean(tmp_path_factory: pytest.TempPathFactory) -> CleanRun:
    """A run of a sample clip without planted mistakes."""
    from support.planted_mistakes import make_clean_run  # slow to import

    return make_clean_run(tmp_path_factory.mktemp("clean"))
