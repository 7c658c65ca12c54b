"""The graph of stages: their order, what is cached, what is stale and why, and running them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any, Literal, Protocol

from models.core.progress import Progress
from pipeline.engine.result_cache import Cache, Entry, Key
from pipeline.engine.source_fingerprint import Look, library_versions, source_hashes
from pipeline.engine.stage import Stage
from pipeline.engine.value_files import FORMAT, load_value, save_value

State = Literal["cached", "stale", "waiting"]


@dataclass(frozen=True, slots=True)
class Outlook:
    """How a stage stands before a run."""

    stage: str
    needs: tuple[str, ...]
    state: State
    why: str
    """Why it would run; empty where it is cached."""


def nothing() -> None:
    """A check that nobody asked for."""


class Watcher(Protocol):
    """Who follows a run: a display, a log, a test."""

    def started(self, stage: str) -> Progress:
        """A stage begins; the returned function hears its progress."""
        ...

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        """A stage is done."""
        ...


@dataclass(frozen=True, slots=True)
class Graph:
    """Stages by name, in an order in which each comes after what it needs."""

    stages: tuple[Stage, ...]
    clip: str
    """Digest of the clip, under which the last keys are remembered."""

    @classmethod
    def of(cls, stages: Iterable[Stage], clip: str) -> Graph:
        """Put stages in order; ValueError for a missing input or a cycle."""
        by_name = {stage.name: stage for stage in stages}
        for stage in by_name.values():
            if missing := set(stage.needs) - by_name.keys():
                raise ValueError(f"stage {stage.name} needs {sorted(missing)}, which is not there")
        order = TopologicalSorter({name: stage.needs for name, stage in by_name.items()}).static_order()
        return cls(tuple(by_name[name] for name in order), clip)

    def outlook(self, cache: Cache) -> list[Outlook]:
        """What a run would do, without doing it."""
        sources = self._sources()
        contents: dict[str, str] = {}
        behind: dict[str, set[str]] = {}
        views = []
        for stage in self.stages:
            behind[stage.name] = set(stage.needs).union(*(behind[name] for name in stage.needs))
            waits = [name for name in stage.needs if name not in contents]
            if waits:
                nearest = [name for name in waits if not any(name in behind[other] for other in waits)]
                views.append(Outlook(stage.name, stage.needs, "waiting", f"waits for {', '.join(nearest)}"))
                continue
            key = stage_key(stage, contents, sources[stage.name])
            entry = cache.find(key)
            if entry is not None:
                contents[stage.name] = entry.content
                views.append(Outlook(stage.name, stage.needs, "cached", ""))
            else:
                why = "its entry is damaged" if cache.is_damaged(key) else _difference(key, cache, self.clip)
                views.append(Outlook(stage.name, stage.needs, "stale", why))
        return views

    def run(
        self,
        cache: Cache,
        watcher: Watcher,
        bound: Mapping[str, Callable[[Any], Any]] | None = None,
        check: Callable[[], None] = nothing,
        look: Look | None = None,
    ) -> dict[str, Entry]:
        """Run what is not cached; `bound` adapts the values of the stages it names before they are handed on.

        `check` raises where what a stage has made since is not to be kept. `look` is the code as it was when this
        process began, which is what it runs; without it the code is read now.
        """
        sources = self._sources(look)
        entries: dict[str, Entry] = {}
        values: dict[str, Any] = {}
        for stage in self.stages:
            key = stage_key(stage, {name: entry.content for name, entry in entries.items()}, sources[stage.name])
            progress = watcher.started(stage.name)
            entry = cache.find(key)
            cached = entry is not None
            if entry is None:
                inputs = {name: self._value(name, entries, values, bound or {}) for name in stage.needs}
                entry = cache.make(key, partial(_build, stage, inputs, progress, check))
            if cache.recall(stage.name, self.clip) != key.plain:
                cache.remember(key, self.clip)
            entries[stage.name] = entry
            watcher.finished(stage.name, entry.seconds, cached)
        return entries

    def _sources(self, look: Look | None = None) -> dict[str, dict[str, str]]:
        """By stage, the code behind it as it is now: what is edited during a long run counts for the next one."""
        look = Look() if look is None else look
        return {stage.name: source_hashes(stage.module, look=look) for stage in self.stages}

    def _value(
        self,
        name: str,
        entries: Mapping[str, Entry],
        values: dict[str, Any],
        bound: Mapping[str, Callable[[Any], Any]],
    ) -> Any:
        """The output of a finished stage, loaded once."""
        if name not in values:
            stage = next(stage for stage in self.stages if stage.name == name)
            value = stage_value(stage, entries[name])
            values[name] = bound[name](value) if name in bound else value
        return values[name]


def stage_key(stage: Stage, contents: Mapping[str, str], source: Mapping[str, str]) -> Key:
    """The key of a stage whose inputs have these contents and whose code is `source` (hashes by file)."""
    parts = {
        "options": stage.settings,
        "facts": dict(stage.facts),
        "inputs": {name: contents[name] for name in sorted(stage.needs)},
        "source": dict(source),
        "libraries": library_versions(),
        "format": FORMAT,
    }
    return Key(stage.name, parts)


def stage_value(stage: Stage, entry: Entry) -> Any:
    """What a finished stage made: its value, or the folder of its files."""
    return entry.folder if stage.output is None else load_value(stage.output, entry.folder)


def _build(
    stage: Stage, inputs: Mapping[str, Any], progress: Progress, check: Callable[[], None], folder: Path
) -> None:
    value = stage.run(inputs, stage.options, folder, progress)
    check()
    if stage.output is None:
        return
    if not isinstance(value, stage.output):
        raise TypeError(f"stage {stage.name} should make a {stage.output.__name__}; it made a {type(value).__name__}")
    save_value(value, folder)


def _difference(key: Key, cache: Cache, clip: str) -> str:
    """In words: what changed since this stage last ran for this clip."""
    before = cache.recall(key.stage, clip)
    if before is None:
        return "it never ran for this clip"
    now = key.plain
    words = []
    for part, noun in (("options", "option"), ("facts", "input"), ("inputs", "input"), ("source", "file")):
        old, new = before.get(part, {}), now[part]
        changed = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
        if changed:
            words.append(f"{noun} {', '.join(changed[:3])}{' and more' if len(changed) > 3 else ''} changed")
    if before.get("libraries") != now["libraries"]:
        words.append("a library has another version")
    return "; ".join(words) or "its entry was pruned"
