"""Tables of the stress test."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from benchmarks.stress_cases.case_scores import Scores, Statement

GROUPS = ("real", "damaged", "synthetic")
HEADERS = ("real, undamaged", "real, damaged", "synthetic")
SURE, VERY_SURE = 0.9, 0.99
BINS = 10
# Binomial standard deviations within which a bin is reliable.
BIN_SIGMAS = 2.0


def format_report(scores: Scores) -> str:
    """Format all tables, and the list of confident errors.

    Args:
        scores: Rows of all cases.

    Returns:
        Text in Markdown.
    """
    groups = [_select(scores, lambda row, name=group: row.case.group == name) for group in GROUPS]
    lines = ["| | " + " | ".join(HEADERS) + " |", "|---|---|---|---|"]
    lines += [f"| {name} | " + " | ".join(cell(part) for part in groups) + " |" for name, cell in ROWS]
    lines += [
        "",
        "## Reliability",
        "",
        "| group | stated | observed | n | sd | within 2 sd |",
        "|---|---|---|---|---|---|",
    ]
    for header, part in zip(HEADERS, groups, strict=True):
        for stated, observed, n, sd in compute_bins(part.statements):
            inside = "yes" if abs(observed - stated) <= BIN_SIGMAS * sd else "NO"
            lines.append(f"| {header} | {stated:.3f} | {observed:.3f} | {n} | {sd:.3f} | {inside} |")
    lines += ["", "## By damage", "", "| group, damage | cases | " + " | ".join(name for name, _ in ROWS) + " |"]
    lines.append("|" + "---|" * (len(ROWS) + 2))
    for key in sorted({(case.group, case.damage) for case in scores.cases}):
        part = _select(scores, lambda row, key=key: (row.case.group, row.case.damage) == key)
        count = sum((case.group, case.damage) == key for case in scores.cases)
        lines.append(f"| {key[0]}, {key[1]} | {count} | " + " | ".join(cell(part) for _, cell in ROWS) + " |")
    lines += ["", "## Confident errors", "", "| group | clip | damage | seed | statement | stated | truth |"]
    lines += ["|---|---|---|---|---|---|---|", *map(_format_error, find_confident_errors(scores.statements))]
    lines += ["", "## Starts and turns without a cause, unmarked", ""]
    lines += [
        f"- {m.case.group} {m.case.clip} {m.case.damage} {m.case.seed}: {m.text}"
        for m in scores.motions
        if not (m.caused or m.marked)
    ]
    lines += ["", "## Wrong first contacts", ""]
    lines += [
        f"- {s.case.group} {s.case.clip} {s.case.damage} {s.case.seed}: {s.text} ({s.probability:.4f}); truth {s.truth}"
        for s in scores.statements
        if s.topic == "first" and s.is_true is False and not s.undecided
    ]
    lines += ["", "## Sure events that were not found", ""]
    lines += [f"- {s.case.group} {s.case.clip} {s.case.damage}: {s.text}" for s in scores.sought if not s.found]
    lines += ["", f"## Crashes: {len(scores.crashes)}", ""]
    for text in dict.fromkeys(crash.text for crash in scores.crashes):
        cases = [f"{c.case.group} {c.case.clip} {c.case.damage}" for c in scores.crashes if c.text == text]
        lines.append(f"- {text}: {len(cases)} times: {', '.join(cases)}")
    lines += ["", f"## Skipped: {len(scores.skipped)}", "", *(f"- {text}" for text in scores.skipped)]
    return "\n".join(lines)


def count_shares(scores: Scores) -> dict[str, tuple[int, int]]:
    """Count the cases that the main rows of the table count, and of how many, by name."""
    sure = [s for s in scores.statements if s.topic == "event" and s.probability >= SURE and s.is_true is not None]
    very_sure = [s for s in scores.statements if _is_very_sure(s)]
    return {
        "sure events that are found, or listed as undecided": (
            sum(s.found for s in scores.sought), len(scores.sought),
        ),
        "events from 0.9 on that are true": (sum(bool(s.is_true) for s in sure), len(sure)),
        "statements from 0.99 on that are false": (sum(_is_wrong(s) for s in very_sure), len(very_sure)),
    }  # fmt: skip


def find_confident_errors(statements: Iterable[Statement]) -> list[Statement]:
    """Find the false statements at 0.99 or more, and the true ones at 0.01 or less, of calls and events.

    Returns:
        Those that are sure and wrong.
    """
    return [s for s in statements if _is_very_sure(s) and _is_wrong(s)]


def compute_bins(statements: Iterable[Statement]) -> list[tuple[float, float, int, float]]:
    """Compute the reliability in ten bins of equal width.

    Args:
        statements: All statements; those without a truth are left out.

    Returns:
        Mean stated probability, observed share, number, and binomial standard deviation of the share if the stated
        probabilities were right, of every bin that is not empty.
    """
    known = [(s.probability, bool(s.is_true)) for s in statements if s.is_true is not None]
    if not known:
        return []
    stated, observed = np.array(known, dtype=float).T
    index = np.clip((stated * BINS).astype(int), 0, BINS - 1)
    bins = []
    for k in np.unique(index):
        p, o = stated[index == k], observed[index == k]
        sd = float(np.sqrt((p * (1 - p)).sum()) / len(p))
        bins.append((float(p.mean()), float(o.mean()), len(p), sd))
    return bins


def _select(scores: Scores, chosen: Callable[..., bool]) -> Scores:
    return Scores(
        statements=[row for row in scores.statements if chosen(row)],
        sought=[row for row in scores.sought if chosen(row)],
        motions=[row for row in scores.motions if chosen(row)],
    )


def _is_very_sure(s: Statement) -> bool:
    return s.is_true is not None and (s.probability >= VERY_SURE or s.probability <= 1 - VERY_SURE)


def _is_wrong(s: Statement) -> bool:
    return s.is_true is not (s.probability > 0.5)


def _format_error(s: Statement) -> str:
    c = s.case
    return f"| {c.group} | {c.clip} | {c.damage} | {c.seed} | {s.text} | {s.probability:.4f} | {s.truth} |"


def _format_share(part: int, whole: int) -> str:
    return f"{part}/{whole} = {100 * part / whole:.1f} %" if whole else "-"


def _count_found(scores: Scores) -> str:
    text = _format_share(sum(s.found for s in scores.sought), len(scores.sought))
    return f"{text} ({sum(s.undecided for s in scores.sought)} undecided)"


def _count_true_events(scores: Scores) -> str:
    sure = [s for s in scores.statements if s.topic == "event" and s.probability >= SURE and s.is_true is not None]
    return _format_share(sum(bool(s.is_true) for s in sure), len(sure))


def _count_confident_errors(scores: Scores) -> str:
    sure = [s for s in scores.statements if _is_very_sure(s)]
    return _format_share(sum(_is_wrong(s) for s in sure), len(sure))


def _count_reliable_bins(scores: Scores) -> str:
    bins = compute_bins(scores.statements)
    inside = [abs(observed - stated) <= BIN_SIGMAS * sd for stated, observed, _, sd in bins]
    return f"{sum(inside)} of {len(bins)} bins" if bins else "-"


def _count_uncaused(scores: Scores) -> str:
    uncaused = [m for m in scores.motions if not m.caused]
    unmarked = sum(not m.marked for m in uncaused)
    return f"{unmarked} (of {len(scores.motions)} changes, {len(uncaused)} without a cause)"


def _count_first_contacts(scores: Scores) -> str:
    known = [s for s in scores.statements if s.topic == "first" and s.is_true is not None]
    undecided = sum(s.undecided for s in known)
    return f"{_format_share(sum(s.undecided or bool(s.is_true) for s in known), len(known))} ({undecided} undecided)"


# Rows of the main table: name, and cell of a group.
ROWS: tuple[tuple[str, Callable[[Scores], str]], ...] = (
    ("events labelled sure that are found within bounds ±0.5 frame, or listed as undecided", _count_found),
    ("events reported at >= 0.9 that are true", _count_true_events),
    ("statements at >= 0.99 (or <= 0.01) that are false", _count_confident_errors),
    ("reliability in ten bins within binomial error", _count_reliable_bins),
    ("a ball that starts or turns without a cause, unmarked", _count_uncaused),
    ("first contact of the shot right, or undecided", _count_first_contacts),
)
