"""Measure the figures of a documentation page with their noise, and compare them with the page, which is their record.

The record is the Markdown table between `<!-- figures: fitting.contact_timing -->` and `<!-- /figures -->` in README.md
or in a page of docs/. A script prints the same block for `--quick`; `python -m benchmarks.update_figures` writes the
figures that moved into the pages. The noise of a figure is two standard errors: how far its value may lie from that of
infinitely many cases. The seeds are the same in every run, so that only changes of the program move a figure.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
# A table of figures in a page. `alone`: the script measures times and runs while no other does.
BLOCK = re.compile(
    r"<!-- figures: (?P<script>[\w.]+)(?P<alone>, alone)? -->\n(?P<body>.*?)<!-- /figures -->", re.DOTALL
)
HEAD, RULE = "| figure | value | noise | unit | n |", "|---|---|---|---|---|"
# Exit status of a script whose inputs are not on this machine (the convention of automake).
SKIPPED = 77
LEFT_OUT = "is left out"
# Times vary by this factor: other processes take the caches, the memory bus and the clock rate of a laptop.
LOAD_FACTOR = 2.0
RESAMPLES = 1000


class MissingInputError(Exception):
    """Footage or an environment that a script needs is not on this machine."""


@dataclass(frozen=True)
class Figure:
    """One figure of the documentation."""

    name: str
    value: float
    noise: float
    """Two standard errors of the value."""
    unit: str
    samples: int


def estimate_statistic(
    name: str, cases: Sequence[float] | np.ndarray, unit: str, statistic: Callable[[np.ndarray], float]
) -> Figure:
    """Estimate a statistic of independent cases (n or n rows), and its noise by a bootstrap over the cases."""
    cases = np.asarray(cases, dtype=float)
    if len(cases) < 2 or not np.isfinite(cases).all():
        raise ValueError(f"the noise of '{name}' needs two cases or more, all finite, not {cases.tolist()}")
    rows = np.random.default_rng(len(cases)).integers(len(cases), size=(RESAMPLES, len(cases)))
    spread = np.std([statistic(cases[row]) for row in rows]) * np.sqrt(len(cases) / (len(cases) - 1))
    return Figure(name, float(statistic(cases)), 2 * float(spread), unit, len(cases))


def estimate_median(name: str, cases: Sequence[float] | np.ndarray, unit: str) -> Figure:
    return estimate_statistic(name, cases, unit, lambda x: float(np.median(x)))


def estimate_mean(name: str, cases: Sequence[float] | np.ndarray, unit: str) -> Figure:
    return estimate_statistic(name, cases, unit, lambda x: float(np.mean(x)))


def estimate_rms(name: str, cases: Sequence[float] | np.ndarray, unit: str) -> Figure:
    """Estimate the root mean square of errors (n) or of rows of errors (n cases, any)."""
    return estimate_statistic(name, cases, unit, lambda x: float(np.sqrt(np.mean(x**2))))


def estimate_share(name: str, hits: int, n: int) -> Figure:
    """Estimate a share in %, and its binomial noise, which 0 and 100 % have too (Agresti & Coull 1998)."""
    if not 0 <= hits <= n or n == 0:
        raise ValueError(f"the share '{name}' needs 0 to n hits of n > 0 cases, not {hits} of {n}")
    share = (hits + 2) / (n + 4)
    return Figure(name, 100 * hits / n, 200 * float(np.sqrt(share * (1 - share) / (n + 4))), "%", n)


def estimate_count(name: str, counts: Sequence[int], unit: str) -> Figure:
    """Estimate a mean count per case, and its Poisson noise with one event more: none does not prove a rate of 0."""
    total, n = sum(counts), len(counts)
    return Figure(name, total / n, 2 * float(np.sqrt(total + 1)) / n, unit, n)


def state_cost(name: str, value: float, unit: str, samples: int, factor: float = LOAD_FACTOR) -> Figure:
    """State a time or a memory, which vary with the machine and its load by a factor rather than with seeds."""
    return Figure(name, value, value * (factor - 1), unit, samples)


def state_exact(name: str, value: float, unit: str, decimals: int = 3) -> Figure:
    """State a value that neither seeds nor load change; its noise is a unit of its last decimal."""
    return Figure(name, round(value, decimals) + 0.0, 10.0**-decimals, unit, 1)


def format_block(script: str, figures: Sequence[Figure], inputs: str, alone: bool = False) -> str:
    """Format the table of a script as it stands in a page."""
    names = [figure.name for figure in figures]
    if len(set(names)) < len(names):
        raise ValueError(f"figures of {script} need different names: {names}")
    caption = f"`python -m benchmarks.{script} --quick`: {inputs}."
    marker = f"<!-- figures: {script}{', alone' if alone else ''} -->"
    return replace_rows(f"{marker}\n{caption}\n\n{HEAD}\n{RULE}\n", figures)


def replace_rows(block: str, figures: Sequence[Figure]) -> str:
    """Replace the rows of a block."""
    rows = [
        f"| {f.name} | {_format_number(f.value)} | {_format_number(f.noise, 2)} | {f.unit} | {f.samples} |"
        for f in figures
    ]
    return "\n".join([block.partition(f"{RULE}\n")[0] + RULE, *rows, "", "<!-- /figures -->"])


def parse_figures(body: str) -> dict[str, Figure]:
    """Parse the rows of a block, by name; none where the block is empty."""
    rows = [
        [cell.strip() for cell in line.strip("| ").split("|")] for line in body.splitlines() if line.startswith("|")
    ]
    return {name: Figure(name, float(v), float(s), unit, int(n)) for name, v, s, unit, n in rows[2:]}


def find_pages(root: Path = ROOT) -> dict[str, list[Path]]:
    """Find the pages that hold the table of each script."""
    pages: dict[str, list[Path]] = {}
    for page in [root / "README.md", *sorted((root / "docs").rglob("*.md"))]:
        for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
            pages.setdefault(block["script"], []).append(page)
    return pages


def read_record(script: str, root: Path = ROOT) -> dict[str, Figure]:
    """Read the recorded figures of a script; ValueError without a marker or with pages that differ."""
    pages = find_pages(root).get(script, [])
    blocks = {b["body"] for p in pages for b in BLOCK.finditer(p.read_text(encoding="utf-8")) if b["script"] == script}
    if len(blocks) != 1:
        raise ValueError(f"{script} needs one table of figures in README.md and docs, not {len(blocks)} different ones")
    return parse_figures(blocks.pop())


def keep_recorded(script: str, rival: str, reason: object) -> list[Figure]:
    """Return the recorded figures of a rival that is not on this machine, and print that it is left out."""
    print(f"{rival} {LEFT_OUT}, its figures stay as recorded: {reason}")
    return [figure for name, figure in read_record(script).items() if name.startswith(f"{rival}: ")]


def compare_figures(record: dict[str, Figure], figures: dict[str, Figure]) -> dict[str, str]:
    """Describe each figure that is new, gone, or off by more than its recorded noise, by its name."""
    changes = {name: f"{name}: no longer measured" for name in record if name not in figures}
    for name, new in figures.items():
        old = record.get(name)
        if old is None:
            changes[name] = f"{name}: not recorded -> {_format_number(new.value)} {new.unit}"
        elif not abs(new.value - old.value) <= old.noise * (1 + 1e-9) or new.unit != old.unit:
            values = f"{_format_number(old.value)} -> {_format_number(new.value)} {new.unit}"
            changes[name] = f"{name}: {values}, noise {_format_number(old.noise, 2)}"
    return changes


def add_quick_option(parser: argparse.ArgumentParser) -> None:
    text = "measure the figures of the documentation; status 1 if one is off by more than its noise"
    parser.add_argument("--quick", action="store_true", help=text)


def run_quick(script: str, measure: Callable[[], Sequence[Figure]], inputs: str, alone: bool = False) -> None:
    """Measure and print the figures of a script; SystemExit 1 names those that are off by more than their noise.

    Args:
        script: Name of the module below `benchmarks`.
        measure: Measures the figures; raises MissingInputError where its inputs are not on this machine.
        inputs: Seeds and inputs, one clause for the caption.
        alone: The figures are times.
    """
    try:
        block = format_block(script, measure(), inputs, alone)
    except MissingInputError as error:
        print(f"{script} is skipped: {error}")
        raise SystemExit(SKIPPED) from error
    print(block)
    changes = compare_figures(read_record(script), parse_figures(block))
    if changes:
        raise SystemExit("\n".join(f"{script}: {change}" for change in changes.values()))


def _format_number(value: float, digits: int = 3) -> str:
    """Format significant digits without an exponent."""
    text = f"{value:#.{digits}g}"
    return np.format_float_positional(float(text), trim="-") if "e" in text else text.rstrip(".")
