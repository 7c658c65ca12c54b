"""The processes that run clips, as others keep them."""

from __future__ import annotations

import select
import sys

import pytest

from pipeline.batch import clip_runner
from pipeline.batch.supervision import START_TIMEOUT_S, SupervisedProcess


def test_a_process_that_was_ready_long_ago_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    script = "import os; os.write(1, b'{\"ready\": true}\\n'); input(); input()"
    monkeypatch.setattr(clip_runner, "build_command", lambda: [sys.executable, "-c", script])
    with SupervisedProcess() as process:
        process.prepare()
        child = process._child
        assert child is not None
        assert child.process.stdout is not None
        select.select([child.process.stdout], [], [])
        child.started_at -= 2 * START_TIMEOUT_S
        assert process._ready_process() is child
