"""`trueroll cache`: list, measure and prune the cache."""

from __future__ import annotations

import json
import math

from models.core.errors import OptionError
from pipeline.engine.result_cache import open_cache
from pipeline.terminal import command_line as cli


@cli.command("cache")
def show_cache(
    prune: bool = False,
    older_than: float | None = None,
    max_size: float | None = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """List the entries of the cache by stage, measure it, or prune it.

    Args:
        prune: Remove entries by age, or until the rest fits.
        older_than: Remove entries whose last use is longer ago, in days.
        max_size: Remove the least recently used entries until this size is left, in MB.
    """
    store = open_cache(cache)
    if prune:
        if older_than is None and max_size is None:
            raise OptionError("Pruning needs to know what to remove: give --older-than DAYS or --max-size MB")
        for flag, value, unit in (("--older-than", older_than, "days"), ("--max-size", max_size, "MB")):
            if value is not None and not 0 <= value < math.inf:
                raise OptionError(f"{flag} is a number of {unit} that is 0 or more; got {value:g}")
        removed = store.prune(
            older_than_s=None if older_than is None else 86400 * older_than,
            largest_bytes=None if max_size is None else round(1e6 * max_size),
        )
        print(f"Removed {len(removed)} entries, {sum(entry.size for entry in removed) / 1e6:.1f} MB")
    entries = list(store.entries())
    if as_json:
        print(json.dumps([{"stage": e.stage, "key": e.key, "size": e.size, "used": e.used} for e in entries]))
        return
    rows = []
    for stage in sorted({entry.stage for entry in entries}):
        own = [entry for entry in entries if entry.stage == stage]
        size, seconds = sum(e.size for e in own) / 1e6, sum(e.seconds for e in own)
        rows.append((stage, str(len(own)), f"{size:.1f}", f"{seconds:.1f}"))
    cli.print_rows(("stage", "entries", "MB", "made in s"), rows)
    print(f"{len(entries)} entries, {sum(entry.size for entry in entries) / 1e6:.1f} MB in {store.root}")
