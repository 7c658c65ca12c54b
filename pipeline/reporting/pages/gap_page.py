"""gap.html: the diagnosis on one self-contained page that a coach can read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from diagnosis.fitting.names import growing, law, named, parameter, phase
from diagnosis.verdicts.verdict import Place, Report, Strength
from models.core.scene import Table
from pipeline.engine.atomic_write import aside
from pipeline.io.profile_export import PROFILE, has_cure
from pipeline.reporting.figures.gap_figures import figures
from pipeline.reporting.pages.page_template import embedded, plotly_source, render
from pipeline.reporting.text.gap_sentences import (
    causes,
    closed_sentence,
    folders_of_shots,
    gap_sentence,
    shot_named,
    undecided,
    untold,
)
from pipeline.reporting.text.sentences import told

SHOWN = 8
"""candidates in the list"""
_HEIGHT = 420
"""px of a figure."""


def write_gap_page(
    report: Report,
    title: str,
    path: Path,
    table: Table | None = None,
    origins: Mapping[int, str] = MappingProxyType({}),
) -> None:
    """Write the page to `path`; plans show the table, where there is one, and its profile lies beside the page. Shots
    are named by their folders, where `origins` has them."""
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
                "mostly": ", ".join(_whom(one, origins)),
                "grows_with": growing(one.grows_with or ""),
            }
            for one in report.where
        ],
        per_effect=[(named(one.effect), one) for one in report.per_effect],
        plots=[
            (caption, embedded(figure, f"plot-{k}", _HEIGHT))
            for k, (caption, figure) in enumerate(figures(gap, table, origins))
        ],
        fitted=[_fitted(one) for one in report.fitted if _told_of(one, report)],
        numbered=folders_of_shots(origins),
        laws=" and ".join(law(name) for name in report.forms),
        model=", ".join(named(name) for name in report.model) or "no effect",
        undecided=undecided(report),
        profile=told(path.parent / PROFILE) if table is not None and has_cure(report) else "",
        plotly=plotly_source(),
    )
    with aside(path) as target:
        target.write_text(html, encoding="utf-8")


def _whom(one: Place, origins: Mapping[int, str]) -> list[str]:
    """Whom most of a phase's share concerns, in words."""
    ball = None if one.ball is None else f"ball {one.ball}"
    shot = None if one.shot is None else shot_named(one.shot, origins)
    return [word for word in (ball, shot, one.region) if word is not None]


def _told_of(one: Strength, report: Report) -> bool:
    """Whether a parameter belongs into the list: what the laws in use leave out is no part of the simulator."""
    effect = one.name.partition(".")[0]
    unused = one.prior_only and not math.isfinite(one.detectable_from)
    return not unused or effect in (*report.model, *report.effects)


def _fitted(one: Strength) -> dict[str, str]:
    """A line of the improved simulator; of what these shots do not tell no value is shown."""
    name, unit = parameter(one.name), one.unit if one.unit != "1" else ""
    if one.prior_only:
        return {"name": name, "untold": untold(one)}
    return {"name": name, "untold": "", "value": f"{one.value:.4g}", "sigma": f"{one.sigma:.2g}", "unit": unit}
