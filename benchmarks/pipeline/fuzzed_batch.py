"""A batch of fuzzed inputs, and checks of its errors, times, memory and leftovers."""

from __future__ import annotations

import csv
import os
import resource
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from benchmarks.pipeline.fault_runs import BatchFolder, find_leftovers
from benchmarks.pipeline.fuzzed_inputs import write_inputs

Line = tuple[str, str, str, bool]

# Time limit per input, s; a clip of a table takes a few seconds, more on a shared machine.
LIMIT_S = 120
# Memory limit per input, MB.
LIMIT_MB = 3000


def run_fuzzed_batch(folder: Path, inputs: int, rng: np.random.Generator) -> list[Line]:
    """Run one batch on all fuzzed inputs: each must be a usable clip, or a row with one line of error."""
    place = BatchFolder(folder, "run")
    count, began = write_inputs(place.clips, inputs, rng), time.monotonic()
    limits = ("--time-limit", str(LIMIT_S), "--memory-limit", str(LIMIT_MB))
    status, _, err = place.run(*limits, timeout=7200)
    with (place.out / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    costs = pq.read_table(place.out / "summary.parquet")
    worst, peak = max(costs.column("seconds").to_pylist()), max(costs.column("peak_mb").to_pylist())
    failed = [row for row in rows if row["status"] == "failed"]
    sentences = [row["sentence"] for row in failed]
    traces = [f"{row['clip']}: {row['sentence']}" for row in failed if "unforeseen" in row["sentence"]]
    traces += [one for one in [*sentences, err] if "Traceback" in one]
    hung, died = (
        [one for one in sentences if "--time-limit" in one],
        [one for one in sentences if "the process that ran" in one],
    )
    greedy, lines = (
        [one for one in sentences if "--memory-limit" in one],
        [one for one in sentences if "\n" in one or not one],
    )
    strange = sorted(set(os.listdir(folder / "run")) - {"out", "cache"}) + find_leftovers(place)
    main = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return [
        (f"fuzzed inputs: {count}, of which {len(rows)} were taken as clips, in {time.monotonic() - began:.0f} s",
         ">= 2000; exit 1", f"exit {status}; {len(rows) - len(sentences)} done, {len(sentences)} failed",
         status == 1 and count >= inputs),
        ("fuzzed: tracebacks or unforeseen errors", "0", _summarize_entries(traces), not traces),
        (f"fuzzed: above {LIMIT_S} s", "0", f"{_summarize_entries(hung)}; the slowest took {worst:.1f} s", not hung),
        ("fuzzed: processes that died", "0", _summarize_entries(died), not died),
        ("fuzzed: no error message, or more than one line", "0", _summarize_entries(lines), not lines),
        ("fuzzed: leftovers", "0", _summarize_entries(strange), not strange),
        (f"fuzzed: largest process; {len(greedy)} were stopped", f"<= {LIMIT_MB} MB",
         f"{peak:.0f} MB of a clip, {main:.0f} MB of any", max(peak, main) < 1.2 * LIMIT_MB),
    ]  # fmt: skip


def _summarize_entries(entries: list[str]) -> str:
    return f"{len(entries)}" + "".join(f"; {one[:160]}" for one in entries[:8])
