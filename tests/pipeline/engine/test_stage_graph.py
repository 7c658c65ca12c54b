"""Exactly what changed runs again, and the graph says why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from models.core.errors import OptionError
from models.core.progress import Progress
from pipeline.cli.commands.graph_command import write_graph_image
from pipeline.engine.result_cache import ResultCache
from pipeline.engine.source_fingerprint import hash_sources
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import StageGraph, load_stage_output

NAMES = ("read", "detect", "fit", "render", "report")
NEEDS = {"read": (), "detect": ("read",), "fit": ("detect",), "render": ("read", "fit"), "report": ("fit", "render")}


@dataclass(frozen=True, slots=True)
class Number:
    value: float


@dataclass(frozen=True, slots=True)
class Plus:
    plus: float = 1.0
    signs: tuple[str, ...] = ("+",)
    """A tuple comes back from a file as a list: no change."""


@dataclass
class RunLog:
    """A watcher that remembers which stages ran."""

    ran: list[str] = field(default_factory=list)

    def start_stage(self, stage: str) -> Progress:
        return lambda share: None

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        if not cached:
            self.ran.append(stage)


def add_inputs(inputs: Mapping[str, Number], options: Plus, folder: Path, progress: Progress) -> Number:
    progress(1.0)
    return Number(options.plus + sum(number.value for number in inputs.values()))


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The source that stands behind the stages: each has a module, fit reaches a helper three imports deep."""
    folder = tmp_path / "code"
    files = {f"pipeline/{name}.py": "import models.shared\n" for name in NAMES} | {
        "models/shared.py": "",
        "pipeline/fit.py": "import models.one\nimport models.shared\n",
        "models/one.py": "import models.two\n",
        "models/two.py": "import models.three\nimport models.catalogue\n",
        "models/three.py": "value = 3\n",
        "models/catalogue.py": 'MODULES = discover_modules("models.effects")\n',
        "models/effects/__init__.py": "",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.setattr("pipeline.engine.stage_graph.hash_sources", partial(hash_sources, root=folder))
    return folder


@pytest.fixture
def cache(tmp_path: Path) -> ResultCache:
    return ResultCache(tmp_path / "cache")


def build_chain(**plus: float) -> StageGraph:
    """The chain with other numbers for the stages that are named."""
    stages = [
        Stage(name, f"pipeline.{name}", NEEDS[name], Number, add_inputs, Plus(plus.get(name, 1.0)))
        for name in reversed(NAMES)  # the order is the graph's business
    ]
    return StageGraph.from_stages(stages, "clip")


def run_stages(graph: StageGraph, cache: ResultCache) -> list[str]:
    log = RunLog()
    graph.run(cache, log)
    return log.ran


def list_reasons(graph: StageGraph, cache: ResultCache) -> dict[str, str]:
    return {view.stage: view.why for view in graph.list_statuses(cache) if view.state == "stale"}


def test_stages_come_after_what_they_need_and_run_once(code: Path, cache: ResultCache) -> None:
    graph = build_chain()
    entries = graph.run(cache, RunLog())
    assert load_stage_output(graph.stages[-1], entries["report"]) == Number(9.0)  # 3 + (1 + 4) + 1
    assert run_stages(graph, cache) == []


def test_a_changed_option_reruns_only_what_depends_on_it(code: Path, cache: ResultCache) -> None:
    graph = build_chain()
    graph.run(cache, RunLog())
    assert list_reasons(build_chain(fit=5.0), cache) == {"fit": "option plus changed"}
    assert run_stages(build_chain(fit=5.0), cache) == ["fit", "render", "report"]
    assert run_stages(build_chain(report=5.0), cache) == ["report"]
    assert run_stages(graph, cache) == [], "the way back is still known"


def test_a_helper_edited_three_imports_deep_reruns_exactly_the_stages_that_use_it(
    code: Path, cache: ResultCache
) -> None:
    build_chain().run(cache, RunLog())
    (code / "models" / "three.py").write_text("value = 4\n")
    assert list_reasons(build_chain(), cache) == {"fit": "file models/three.py changed"}
    assert run_stages(build_chain(), cache) == ["fit"], "it made the same number, so what follows is still right"


def test_a_new_effect_file_makes_fit_rerun(code: Path, cache: ResultCache) -> None:
    build_chain().run(cache, RunLog())
    (code / "models" / "effects" / "nap.py").write_text("")
    assert list_reasons(build_chain(), cache) == {"fit": "file models/effects/nap.py changed"}
    assert run_stages(build_chain(), cache) == ["fit"]


def test_code_that_all_stages_share_reruns_all(code: Path, cache: ResultCache) -> None:
    build_chain().run(cache, RunLog())
    (code / "models" / "shared.py").write_text("# edited\n")
    assert run_stages(build_chain(), cache) == list(NAMES)


def test_another_version_of_a_library_reruns_all(
    code: Path, cache: ResultCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    build_chain().run(cache, RunLog())
    monkeypatch.setattr("pipeline.engine.result_cache.library_versions", lambda: {"numpy": "99"})
    assert list_reasons(build_chain(), cache)["read"] == "a library has another version"
    assert run_stages(build_chain(), cache) == list(NAMES)


def test_a_damaged_entry_is_rebuilt_and_what_follows_is_kept(code: Path, cache: ResultCache) -> None:
    entries = build_chain().run(cache, RunLog())
    (entries["detect"].folder / "value.json").write_text("{")
    assert list_reasons(build_chain(), cache) == {"detect": "its entry is damaged"}
    assert run_stages(build_chain(), cache) == ["detect"]


def test_a_pruned_entry_is_rebuilt(code: Path, cache: ResultCache) -> None:
    build_chain().run(cache, RunLog())
    cache.prune(largest_bytes=0)
    assert list_reasons(build_chain(), cache) == {"read": "its entry was pruned"}
    assert run_stages(build_chain(), cache) == list(NAMES)


def test_a_stage_that_never_ran_is_stale_and_the_others_wait(code: Path, cache: ResultCache) -> None:
    views = {view.stage: view for view in build_chain().list_statuses(cache)}
    assert (views["read"].state, views["read"].why) == ("stale", "it never ran for this clip")
    assert (views["render"].state, views["render"].why) == ("waiting", "waits for fit")


def test_a_stage_that_fails_leaves_the_finished_ones(code: Path, cache: ResultCache) -> None:
    def fail(*_: Any) -> Number:
        raise OptionError("no")

    broken = StageGraph.from_stages(
        [replace(s, run=fail) if s.name == "fit" else s for s in build_chain().stages], "clip"
    )
    with pytest.raises(OptionError):
        broken.run(cache, RunLog())
    assert run_stages(build_chain(), cache) == ["fit", "render", "report"]


def test_a_stage_must_return_its_output_type(code: Path, cache: ResultCache) -> None:
    wrong = replace(build_chain().stages[0], run=lambda *_: "a string")
    with pytest.raises(TypeError, match="should make a Number"):
        StageGraph.from_stages([wrong], "clip").run(cache, RunLog())


def test_a_missing_input_and_a_cycle_are_refused(code: Path) -> None:
    read, detect = build_chain().stages[:2]
    with pytest.raises(ValueError, match="needs"):
        StageGraph.from_stages([detect], "clip")
    with pytest.raises(ValueError, match="cycle"):
        StageGraph.from_stages([replace(read, needs=("detect",)), detect], "clip")


def test_the_drawing_names_every_stage_and_its_reason(code: Path, cache: ResultCache, tmp_path: Path) -> None:
    build_chain().run(cache, RunLog())
    views = build_chain(fit=5.0).list_statuses(cache)
    write_graph_image(views, tmp_path / "graph.svg")
    words = "".join(ElementTree.parse(tmp_path / "graph.svg").getroot().itertext())
    assert all(name in words for name in NAMES)
    assert "option plus changed" in words
    with pytest.raises(OptionError, match="svg"):
        write_graph_image(views, tmp_path / "graph.png")


def test_a_selected_stage_keeps_all_that_it_needs_in_order(code: Path) -> None:
    chosen = build_chain().select("render")
    assert [stage.name for stage in chosen.stages] == ["read", "detect", "fit", "render"]
    assert chosen.clip == build_chain().clip
