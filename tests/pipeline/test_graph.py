"""Exactly what changed runs again, and the graph says why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from PIL import Image

from models.core.errors import OptionError
from models.core.progress import Progress
from pipeline.engine.graph_drawing import write_picture
from pipeline.engine.result_cache import Cache
from pipeline.engine.source_fingerprint import source_hashes
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import Graph, stage_value

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
class Log:
    """A watcher that remembers which stages ran."""

    ran: list[str] = field(default_factory=list)

    def started(self, stage: str) -> Progress:
        return lambda share: None

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        if not cached:
            self.ran.append(stage)


def add(inputs: Mapping[str, Number], options: Plus, folder: Path, progress: Progress) -> Number:
    progress(1.0)
    return Number(options.plus + sum(number.value for number in inputs.values()))


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The source that stands behind the stages: each has a module, fit reaches a helper three imports deep."""
    folder = tmp_path / "code"
    files = {f"stages/{name}.py": "import shared\n" for name in NAMES} | {
        "shared.py": "",
        "stages/fit.py": "import one\nimport shared\n",
        "one.py": "import two\n",
        "two.py": "import three\nimport effects.catalogue\n",
        "three.py": "value = 3\n",
        "effects/__init__.py": "",
        "effects/catalogue.py": "",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.setattr("pipeline.engine.stage_graph.source_hashes", partial(source_hashes, root=folder))
    return folder


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    return Cache(tmp_path / "cache")


def chain(**plus: float) -> Graph:
    """The chain with other numbers for the stages that are named."""
    stages = [
        Stage(name, f"stages.{name}", NEEDS[name], Number, add, Plus(plus.get(name, 1.0)))
        for name in reversed(NAMES)  # the order is the graph's business
    ]
    return Graph.of(stages, "clip")


def ran(graph: Graph, cache: Cache) -> list[str]:
    log = Log()
    graph.run(cache, log)
    return log.ran


def why(graph: Graph, cache: Cache) -> dict[str, str]:
    return {view.stage: view.why for view in graph.outlook(cache) if view.state == "stale"}


def test_stages_come_after_what_they_need_and_run_once(code: Path, cache: Cache) -> None:
    graph = chain()
    entries = graph.run(cache, Log())
    assert stage_value(graph.stages[-1], entries["report"]) == Number(9.0)  # 3 + (1 + 4) + 1
    assert ran(graph, cache) == []


def test_a_changed_option_reruns_only_what_depends_on_it(code: Path, cache: Cache) -> None:
    graph = chain()
    graph.run(cache, Log())
    assert why(chain(fit=5.0), cache) == {"fit": "option plus changed"}
    assert ran(chain(fit=5.0), cache) == ["fit", "render", "report"]
    assert ran(chain(report=5.0), cache) == ["report"]
    assert ran(graph, cache) == [], "the way back is still known"


def test_a_helper_edited_three_imports_deep_reruns_exactly_the_stages_that_use_it(code: Path, cache: Cache) -> None:
    chain().run(cache, Log())
    (code / "three.py").write_text("value = 4\n")
    assert why(chain(), cache) == {"fit": "file three.py changed"}
    assert ran(chain(), cache) == ["fit"], "it made the same number, so what follows is still right"


def test_a_new_effect_file_makes_fit_rerun(code: Path, cache: Cache) -> None:
    chain().run(cache, Log())
    (code / "effects" / "nap.py").write_text("")
    assert why(chain(), cache) == {"fit": "file effects/nap.py changed"}
    assert ran(chain(), cache) == ["fit"]


def test_code_that_all_stages_share_reruns_all(code: Path, cache: Cache) -> None:
    chain().run(cache, Log())
    (code / "shared.py").write_text("# edited\n")
    assert ran(chain(), cache) == list(NAMES)


def test_another_version_of_a_library_reruns_all(code: Path, cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    chain().run(cache, Log())
    monkeypatch.setattr("pipeline.engine.stage_graph.library_versions", lambda: {"numpy": "99"})
    assert why(chain(), cache)["read"] == "a library has another version"
    assert ran(chain(), cache) == list(NAMES)


def test_a_damaged_entry_is_rebuilt_and_what_follows_is_kept(code: Path, cache: Cache) -> None:
    entries = chain().run(cache, Log())
    (entries["detect"].folder / "value.json").write_text("{")
    assert why(chain(), cache) == {"detect": "its entry is damaged"}
    assert ran(chain(), cache) == ["detect"]


def test_a_pruned_entry_is_rebuilt(code: Path, cache: Cache) -> None:
    chain().run(cache, Log())
    cache.prune(largest_bytes=0)
    assert why(chain(), cache) == {"read": "its entry was pruned"}
    assert ran(chain(), cache) == list(NAMES)


def test_a_stage_that_never_ran_says_so_and_the_others_wait(code: Path, cache: Cache) -> None:
    views = {view.stage: view for view in chain().outlook(cache)}
    assert (views["read"].state, views["read"].why) == ("stale", "it never ran for this clip")
    assert (views["render"].state, views["render"].why) == ("waiting", "waits for fit")


def test_a_stage_that_fails_leaves_the_finished_ones(code: Path, cache: Cache) -> None:
    def fail(*_: Any) -> Number:
        raise OptionError("no")

    broken = Graph.of([replace(s, run=fail) if s.name == "fit" else s for s in chain().stages], "clip")
    with pytest.raises(OptionError):
        broken.run(cache, Log())
    assert ran(chain(), cache) == ["fit", "render", "report"]


def test_a_stage_must_make_what_it_promises(code: Path, cache: Cache) -> None:
    wrong = replace(chain().stages[0], run=lambda *_: "a string")
    with pytest.raises(TypeError, match="should make a Number"):
        Graph.of([wrong], "clip").run(cache, Log())


def test_a_missing_input_and_a_circle_are_refused(code: Path) -> None:
    read, detect = chain().stages[:2]
    with pytest.raises(ValueError, match="needs"):
        Graph.of([detect], "clip")
    with pytest.raises(ValueError, match="cycle"):
        Graph.of([replace(read, needs=("detect",)), detect], "clip")


def test_the_picture_names_every_stage_and_its_reason(code: Path, cache: Cache, tmp_path: Path) -> None:
    chain().run(cache, Log())
    views = chain(fit=5.0).outlook(cache)
    write_picture(views, tmp_path / "graph.svg")
    words = "".join(ElementTree.parse(tmp_path / "graph.svg").getroot().itertext())
    assert all(name in words for name in NAMES)
    assert "option plus changed" in words
    write_picture(views, tmp_path / "graph.png")
    with Image.open(tmp_path / "graph.png") as picture:
        assert picture.width > 1000
        assert len(picture.getcolors(1 << 20)) > 10
    with pytest.raises(OptionError, match="svg"):
        write_picture(views, tmp_path / "graph.gif")
