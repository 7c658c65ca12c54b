"""gap.html: the diagnosis on one self-contained page that a coach can read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from diagnosis.verdict import Report, Strength
from diagnosis.words import growing, law, named, parameter, phase
from models.scene import Table
from pipeline.gap_cure import PROFILE, has_cure
from pipeline.gap_figures import figures
from pipeline.gap_words import causes, closed_sentence, gap_sentence, undecided, untold
from pipeline.page import embedded, plotly_source, render
from pipeline.publish import aside
from pipeline.sentences import told

SHOWN = 8
"""candidates in the list"""
_HEIGHT = 420
"""px of a figure."""


def write_gap_page(report: Report, title: str, path: Path, table: Table | None = None) -> None:
    """Write the page to `path`; plans show the table, where there is one, and its profile lies beside the page."""
    # a simulator to which nothing was added, fitted twice, is still one
    gap = replace(report.gap, after=report.gap.before) if report.verdict == "none" else report.gap
    html = render(
        "gap.html",
        name=title,
        report=report,
        sentence=gap_sentence(report),
        closed=closed_sentence(report),
        candidates=causes(report)[:SHOWN],
        where=[
            {
                "phase": phase(one.phase),
                "share": one.share,
                "mostly": ", ".join(_whom(one.ball, one.shot, one.region)),
                "grows_with": growing(one.grows_with or ""),
            }
            for one in report.where
        ],
        per_effect=[(named(one.effect), one) for one in report.per_effect],
        plots=[
            (caption, embedded(figure, f"plot-{k}", _HEIGHT)) for k, (caption, figure) in enumerate(figures(gap, table))
        ],
        fitted=[_fitted(one) for one in report.fitted],
        laws=" and ".join(law(name) for name in report.forms),
        model=", ".join(named(name) for name in report.model) or "no effect",
        undecided=undecided(report),
        profile=told(path.parent / PROFILE) if table is not None and has_cure(report) else "",
        plotly=plotly_source(),
    )
    with aside(path) as target:
        target.write_text(html, encoding="utf-8")


def _whom(ball: str | None, shot: int | None, region: str | None) -> list[str]:
    """Whom most of a phase's share concerns, in words."""
    shots = [] if shot is None else [f"shot {shot}"]
    return [*([] if ball is None else [f"ball {ball}"]), *shots, *([] if region is None else [region])]


def _fitted(one: Strength) -> dict[str, str]:
    """A line of the improved simulator; of what these shots do not tell no value is shown."""
    name, unit = parameter(one.name), one.unit if one.unit != "1" else ""
    if one.prior_only:
        return {"name": name, "untold": untold(one)}
    return {"name": name, "untold": "", "value": f"{one.value:.4g}", "sigma": f"{one.sigma:.2g}", "unit": unit}
