"""A batch of nonsense, and what the program says of it."""

from __future__ import annotations

import csv
import os
import resource
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from fault_runs import Place, leftovers
from fuzzed_inputs import write_inputs

Line = tuple[str, str, str, bool]

LIMIT_S = 120
"""s that an input may take: the machine may be shared, and a whole clip of a table takes a few."""
LIMIT_MB = 3000


def fuzzed(folder: Path, inputs: int, rng: np.random.Generator) -> list[Line]:
    """Run the batch on it all, once; every input is a row with one sentence, or a clip that was fit to be used."""
    place = Place(folder, "run")
    count, began = write_inputs(place.clips, inputs, rng), time.monotonic()
    limits = ("--time-limit", str(LIMIT_S), "--memory-limit", str(LIMIT_MB))
    status, _, err = place.run(*limits, timeout=7200)
    with (place.out / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    costs = pq.read_table(place.out / "summary.parquet")
    worst, peak = max(costs.column("seconds").to_pylist()), max(costs.column("peak_mb").to_pylist())
    failed = [row for row in rows if row["status"] == "failed"]
    said = [row["sentence"] for row in failed]
    traces = [f"{row['clip']}: {row['sentence']}" for row in failed if "unforeseen" in row["sentence"]]
    traces += [one for one in [*said, err] if "Traceback" in one]
    hung, died = [one for one in said if "--time-limit" in one], [one for one in said if "the process that ran" in one]
    greedy, lines = [one for one in said if "--memory-limit" in one], [one for one in said if "\n" in one or not one]
    strange = sorted(set(os.listdir(folder / "run")) - {"out", "cache"}) + leftovers(place)
    main = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return [
        (f"fuzzed inputs: {count}, of which {len(rows)} were taken for clips, in {time.monotonic() - began:.0f} s",
         ">= 2000; exit 1", f"exit {status}; {len(rows) - len(said)} done, {len(said)} failed",
         status == 1 and count >= inputs),
        ("fuzzed: tracebacks, or what nobody foresaw", "0", _few(traces), not traces),
        (f"fuzzed: above {LIMIT_S} s", "0", f"{_few(hung)}; the slowest took {worst:.1f} s", not hung),
        ("fuzzed: processes that died", "0", _few(died), not died),
        ("fuzzed: no sentence, or more than a line", "0", _few(lines), not lines),
        ("fuzzed: leftovers", "0", _few(strange), not strange),
        (f"fuzzed: largest process; {len(greedy)} were stopped", f"<= {LIMIT_MB} MB",
         f"{peak:.0f} MB of a clip, {main:.0f} MB of any", max(peak, main) < 1.2 * LIMIT_MB),
    ]  # fmt: skip


def _few(found: list[str]) -> str:
    return f"{len(found)}" + "".join(f"; {one[:160]}" for one in found[:8])
