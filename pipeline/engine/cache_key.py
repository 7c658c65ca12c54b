"""The cache key of a stage: everything that its result depends on, and the digest of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.engine.source_fingerprint import library_versions
from pipeline.engine.stage import Stage


@dataclass(frozen=True, slots=True)
class CacheKey:
    """What an entry depends on. Its digest is the address of the entry."""

    stage: str
    parts: Mapping[str, Any]
    """JSON-able: options, inputs (content hashes), source (hash per file), libraries."""

    @property
    def json_parts(self) -> dict[str, Any]:
        """The parts as read back from JSON: tuples have become lists."""
        parts: dict[str, Any] = json.loads(json.dumps(self.parts))
        return parts

    @property
    def digest(self) -> str:
        """SHA-256 of the stage name and all parts."""
        text = json.dumps({"stage": self.stage, **self.parts}, sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def build_stage_key(stage: Stage, contents: Mapping[str, str], source: Mapping[str, str]) -> CacheKey:
    """Build the cache key of a stage.

    Args:
        stage: The stage.
        contents: Content hashes of its inputs (`CacheEntry.content`) by stage name.
        source: Hashes of the files of code behind it, by path.

    Returns:
        The key.
    """
    from pipeline.engine.value_files import FORMAT  # imports numpy, for which `trueroll --help` need not wait

    parts = {
        "options": stage.json_options,
        "facts": dict(stage.facts),
        "inputs": {name: contents[name] for name in sorted(stage.needs)},
        "source": dict(source),
        "libraries": library_versions(),
        "format": FORMAT,
    }
    return CacheKey(stage.name, parts)
