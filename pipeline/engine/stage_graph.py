"""The graph of stages: orders them, lists which are cached or stale and why, and runs them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

from models.core.progress import Progress, ignore_progress
from pipeline.engine.result_cache import CacheEntry, CacheKey, ResultCache, build_stage_key
from pipeline.engine.source_fingerprint import SourceSnapshot, hash_sources
from pipeline.engine.stage import Stage
from pipeline.engine.value_files import load_value, save_value

State = Literal["cached", "stale", "waiting"]


@dataclass(frozen=True, slots=True)
class StageStatus:
    """State of a stage before a run."""

    stage: str
    needs: tuple[str, ...]
    state: State
    why: str
    """Why the stage would run; empty where it is cached."""


def accept_result() -> None:
    """Accept the result of a stage: the check of runs that need none."""


class RunWatcher(Protocol):
    """Follows a run: a display, a log or a test."""

    def start_stage(self, stage: str) -> Progress:
        """Note that a stage begins.

        Args:
            stage: Name of the stage.

        Returns:
            A function that is called with the finished share of the stage, 0 to 1.
        """
        ...

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Note that a stage is done.

        Args:
            stage: Name of the stage.
            seconds: Time that it took when it ran, s.
            cached: Whether its result came from the cache.
        """
        ...


class SilentWatcher:
    """Follows a run, and shows nothing."""

    def start_stage(self, stage: str) -> Progress:
        """Return a function that does nothing."""
        return ignore_progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Do nothing."""


@dataclass(frozen=True, slots=True)
class StageGraph:
    """Stages in an order in which each comes after its inputs."""

    stages: tuple[Stage, ...]
    clip: str
    """Digest of the clip, under which the cache remembers the latest keys."""

    @classmethod
    def from_stages(cls, stages: Iterable[Stage], clip: str) -> StageGraph:
        """Order stages by their inputs; otherwise they keep their order.

        Args:
            stages: The stages, preferably in the order in which their results are wanted.
            clip: Digest of the clip.

        Raises:
            ValueError: An input is missing, or inputs form a cycle.
        """
        by_name = {stage.name: stage for stage in stages}
        for stage in by_name.values():
            if missing := set(stage.needs) - by_name.keys():
                raise ValueError(f"stage {stage.name} needs {sorted(missing)}, which is not there")
        order: list[Stage] = []
        while len(order) < len(by_name):
            done = {stage.name for stage in order}
            ready = [s for s in by_name.values() if s.name not in done and done.issuperset(s.needs)]
            if not ready:
                raise ValueError(f"stages {sorted(by_name.keys() - done)} form a cycle: they need each other")
            order.append(ready[0])
        return cls(tuple(order), clip)

    def select(self, name: str) -> StageGraph:
        """Select a stage and all that it needs, directly or indirectly."""
        needed = {name}
        for stage in reversed(self.stages):
            if stage.name in needed:
                needed.update(stage.needs)
        return StageGraph(tuple(stage for stage in self.stages if stage.name in needed), self.clip)

    def list_statuses(self, cache: ResultCache) -> list[StageStatus]:
        """List the state of every stage in the order of a run, without running any."""
        sources = self._hash_all_sources()
        contents: dict[str, str] = {}
        ancestors: dict[str, set[str]] = {}
        statuses = []
        for stage in self.stages:
            ancestors[stage.name] = set(stage.needs).union(*(ancestors[name] for name in stage.needs))
            waits = [name for name in stage.needs if name not in contents]
            if waits:
                nearest = [name for name in waits if not any(name in ancestors[other] for other in waits)]
                statuses.append(StageStatus(stage.name, stage.needs, "waiting", f"waits for {', '.join(nearest)}"))
                continue
            key = build_stage_key(stage, contents, sources[stage.name])
            entry = cache.find(key)
            if entry is not None:
                contents[stage.name] = entry.content
                statuses.append(StageStatus(stage.name, stage.needs, "cached", ""))
            else:
                why = "its entry is damaged" if cache.is_damaged(key) else _describe_difference(key, cache, self.clip)
                statuses.append(StageStatus(stage.name, stage.needs, "stale", why))
        return statuses

    def run(
        self,
        cache: ResultCache,
        watcher: RunWatcher,
        check: Callable[[], None] = accept_result,
        snapshot: SourceSnapshot | None = None,
        listener: Callable[[Mapping[str, CacheEntry]], None] | None = None,
    ) -> dict[str, CacheEntry]:
        """Run the stages that are not cached.

        Args:
            cache: Where results are looked up and stored.
            watcher: Follows the run.
            check: Called after every stage that ran; raises if its result must not be stored.
            snapshot: The project's code when this process started, which is the code that it runs; None reads it now.
            listener: Called before a stage runs, with the entries of the stages before it.

        Returns:
            The cache entries of all stages by name.
        """
        sources = self._hash_all_sources(snapshot)
        entries: dict[str, CacheEntry] = {}
        values: dict[str, Any] = {}
        for stage in self.stages:
            key = build_stage_key(stage, {name: entry.content for name, entry in entries.items()}, sources[stage.name])
            progress = watcher.start_stage(stage.name)
            entry = cache.find(key)
            cached = entry is not None
            if entry is None:
                if listener is not None:
                    listener(entries)
                values |= {name: self.load(name, entries) for name in stage.needs if name not in values}
                inputs = {name: values[name] for name in stage.needs}
                entry = cache.find_or_build(key, partial(_run_and_save, stage, inputs, progress, check))
            if cache.recall(stage.name, self.clip) != key.json_parts:
                cache.remember(key, self.clip)
            entries[stage.name] = entry
            watcher.finish_stage(stage.name, entry.seconds, cached)
        return entries

    def _hash_all_sources(self, snapshot: SourceSnapshot | None = None) -> dict[str, dict[str, str]]:
        """Hash the code behind every stage once, so that an edit during a long run counts for the next run."""
        snapshot = SourceSnapshot() if snapshot is None else snapshot
        return {stage.name: hash_sources(stage.module, snapshot=snapshot) for stage in self.stages}

    def load(self, name: str, entries: Mapping[str, CacheEntry]) -> Any:
        """Load the output of a finished stage; see `load_stage_output`."""
        return load_stage_output(next(stage for stage in self.stages if stage.name == name), entries[name])


def load_stage_output(stage: Stage, entry: CacheEntry) -> Any:
    """Load the output of a finished stage.

    Args:
        entry: Its cache entry.

    Returns:
        The output value, or the folder of its files where the stage has no output type.
    """
    if stage.output is None:
        return entry.folder
    value: Any = load_value(stage.output, entry.folder)
    return value if stage.adapt is None else stage.adapt(value)


def _run_and_save(
    stage: Stage, inputs: Mapping[str, Any], progress: Progress, check: Callable[[], None], folder: Path
) -> None:
    """Run a stage, check the result and save its value into the folder of the cache entry."""
    value = stage.run(inputs, stage.options, folder, progress)
    check()
    if stage.output is None:
        return
    if not isinstance(value, stage.output):
        raise TypeError(f"stage {stage.name} should make a {stage.output.__name__}; it made a {type(value).__name__}")
    save_value(value, folder)


def _describe_difference(key: CacheKey, cache: ResultCache, clip: str) -> str:
    """Describe what changed since the stage last ran for this clip."""
    before = cache.recall(key.stage, clip)
    if before is None:
        return "it never ran for this clip"
    now = key.json_parts
    changes = []
    for part, noun in (("options", "option"), ("facts", "input"), ("inputs", "input"), ("source", "file")):
        old, new = before.get(part, {}), now[part]
        changed = sorted(name for name in old.keys() | new.keys() if old.get(name) != new.get(name))
        if changed:
            changes.append(f"{noun} {', '.join(changed[:3])}{' and more' if len(changed) > 3 else ''} changed")
    if before.get("libraries") != now["libraries"]:
        changes.append("a library has another version")
    return "; ".join(changes) or "its entry was pruned"
