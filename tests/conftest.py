"""Shared places for the tests."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
FOOTAGE = ROOT.parent / "shared" / "data" / "billiards"


@pytest.fixture
def footage() -> Path:
    """Real clips that are not ours to ship; the test skips where they are absent."""
    if not FOOTAGE.is_dir():
        pytest.skip(f"real footage is not at {FOOTAGE}")
    return FOOTAGE
