"""Measure all figures of the documentation again, rewrite their tables, and list what moved by more than its noise.

    python -m benchmarks.update_figures [--check] [--only SCRIPT ...]

Runs the `--quick` of every script that has a table in README.md or docs/ (see benchmarks/support/figures.py), two at a
time; scripts that measure times run alone, at the end. A figure within its noise keeps its recorded value, so that it
cannot drift away in small steps. A script that fails or needs missing footage stops nothing and leaves its table as it
is. The exit status is 1 if a script failed or a figure moved. `make figures` does the same.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from benchmarks.support.figures import (
    BLOCK,
    LEFT_OUT,
    ROOT,
    SKIPPED,
    compare_figures,
    find_pages,
    parse_figures,
    read_record,
    replace_rows,
)

TIMEOUT_S = 1800


@dataclass(frozen=True)
class QuickRun:
    """What one script printed for `--quick`."""

    script: str
    status: int
    stdout: str
    stderr: str
    seconds: float

    @property
    def block(self) -> str | None:
        """The printed table with its markers."""
        blocks = [b[0] for b in BLOCK.finditer(self.stdout) if b["script"] == self.script]
        return blocks[-1] if blocks and self.status in (0, 1) else None


def run_script(script: str) -> QuickRun:
    """Run the `--quick` of one script in its own process."""
    start = time.monotonic()
    command = [sys.executable, "-m", f"benchmarks.{script}", "--quick"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S,
                              check=False)  # fmt: skip
    except subprocess.TimeoutExpired:
        return QuickRun(script, 124, "", f"no end after {TIMEOUT_S} s", time.monotonic() - start)
    return QuickRun(script, done.returncode, done.stdout, done.stderr, time.monotonic() - start)


def replace_block(block: str, script: str, page: Path) -> None:
    """Replace the table of a script in a page."""
    text = page.read_text(encoding="utf-8")
    page.write_text(BLOCK.sub(lambda b: block if b["script"] == script else b[0], text), encoding="utf-8")


def update_script(run: QuickRun, root: Path, check: bool) -> bool:
    """Compare one run with its record, rewrite the pages, report; return whether all is well."""
    took = f"{run.script}: {run.seconds:.0f} s"
    if run.status == SKIPPED:
        print(f"{took}, {run.stdout.strip()}", flush=True)
        return True
    if run.block is None:
        print(f"{took}, FAILED with status {run.status}: {(run.stderr or run.stdout).strip()[-2000:]}", flush=True)
        return False
    body = BLOCK.fullmatch(run.block)
    assert body is not None
    figures = parse_figures(body["body"])
    try:
        record = read_record(run.script, root)
    except ValueError as error:
        print(f"{took}, FAILED: {error}", flush=True)
        return False
    changes = compare_figures(record, figures)
    table = [one if name in changes else record[name] for name, one in figures.items()]
    if changes and not check:
        for page in find_pages(root)[run.script]:
            replace_block(replace_rows(run.block, table), run.script, page)
    notes = [line for line in run.stdout.splitlines() if LEFT_OUT in line]
    print(f"{took}, {len(figures)} figures, {len(changes)} moved", *changes.values(), *notes, sep="\n    ", flush=True)
    return not changes


def update_figures(
    scripts: Iterable[str] = (), root: Path = ROOT, check: bool = False, run: Callable[[str], QuickRun] = run_script
) -> bool:
    """Run the scripts, all by default, and update their tables; return whether none failed and no figure moved."""
    pages = find_pages(root)
    names = list(scripts) or list(pages)
    alone = {b["script"] for page in {p for ps in pages.values() for p in ps}
             for b in BLOCK.finditer(page.read_text(encoding="utf-8")) if b["alone"]}  # fmt: skip
    with ThreadPoolExecutor(2) as executor:
        runs = executor.map(run, [name for name in names if name not in alone])
        is_good = [update_script(one, root, check) for one in runs]
    is_good += [update_script(run(name), root, check) for name in names if name in alone]
    return all(is_good)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare only; leave the tables as they are")
    parser.add_argument("--only", nargs="+", default=[], metavar="SCRIPT", choices=sorted(find_pages()),
                        help="scripts to run, for example fitting.contact_timing; all by default")  # fmt: skip
    arguments = parser.parse_args()
    start = time.monotonic()
    is_good = update_figures(arguments.only, check=arguments.check)
    print(f"all scripts: {time.monotonic() - start:.0f} s")
    sys.exit(not is_good)


if __name__ == "__main__":
    main()
