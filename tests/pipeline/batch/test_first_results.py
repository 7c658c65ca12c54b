"""First results of a run for who follows it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from models.core.errors import OptionError
from pipeline.batch.first_results import FirstResults
from pipeline.engine.stage_graph import StageGraph


@pytest.mark.parametrize("error", [OSError("No space left"), ValueError("no frame"), OptionError("damaged")])
def test_an_image_that_cannot_be_drawn_does_not_end_the_run(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(graph: StageGraph, stage: str, entries: Mapping[str, Any]) -> Any:
        raise error

    monkeypatch.setattr(StageGraph, "load", load)
    told: list[object] = []
    results = FirstResults(tmp_path / "image.jpg", lambda *values: told.append(values))
    entries: dict[str, Any] = {"detect": None}
    results.follow(StageGraph.__new__(StageGraph), entries)
    assert told == [((), (0, 0))]
    assert list(tmp_path.iterdir()) == []
