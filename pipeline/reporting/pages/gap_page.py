"""gap.html: a diagnosis on one self-contained page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from diagnosis.fitting.display_names import (
    format_cause,
    format_growth_variable,
    format_parameter,
    format_phase,
)
from diagnosis.verdicts.verdict import DiagnosisReport, GapLocation, Strength
from models.core.number_format import format_measured, format_unit
from models.core.scene import Table
from pipeline.engine.atomic_write import write_text
from pipeline.io.gap_files import PROFILE_FILE, has_fitted_model
from pipeline.reporting.figures.gap_figures import build_gap_figures, build_law_figure
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template
from pipeline.reporting.text import gap_sentences
from pipeline.reporting.text.text_formatting import escape_text, format_law

# Candidates in the list.
MAX_CANDIDATES = 8
# Height of a figure, px.
_FIGURE_HEIGHT = 420


def write_gap_page(
    report: DiagnosisReport,
    title: str,
    path: Path,
    table: Table | None = None,
    origins: Mapping[int, str] = MappingProxyType({}),
) -> None:
    """Write the page of a diagnosis.

    Args:
        report: Result of the diagnosis.
        title: Heading of the page.
        path: File to write; for a table, profile.json is in the same folder.
        table: The table, drawn in the plans; None for other scenes.
        origins: Folder names of the shots; empty if all are in one folder.
    """
    # With the verdict "none" nothing was added to the simulator: draw its prediction once.
    gap = replace(report.gap, after=report.gap.before) if report.verdict == "none" else report.gap
    candidates, where = gap_sentences.list_causes(report)[:MAX_CANDIDATES], _list_places(report, origins)
    law = report.unexplained.law
    html = render_template(
        "gap.html",
        name=title,
        report=report,
        sentence=gap_sentences.format_verdict(report),
        closed=gap_sentences.format_gap_closure(report),
        shot_use=gap_sentences.format_shot_use(report),
        is_angle=report.gap.unit == "rad",
        candidates=candidates,
        has_detectable=any(one.detectable for one in candidates),
        has_rivals=any(one.rivals for one in candidates),
        strength_note=gap_sentences.format_strength_note(report),
        agreement=(*gap_sentences.format_body_differences(report), *gap_sentences.format_agreement(report)),
        where=where,
        has_mostly=any(one["mostly"] for one in where),
        has_growth=any(one["grows_with"] for one in where),
        unexplained=gap_sentences.format_unexplained(report),
        residual_p_value=gap_sentences.format_p_value(report.p_value),
        law="" if law is None else embed_figure(build_law_figure(law, report.gap.unit), "plot-law", _FIGURE_HEIGHT),
        law_variable="" if law is None else law.variable,
        per_effect=[
            (format_cause(one.effect), *map(gap_sentences.format_share, (one.closed, *one.interval, one.alone)))
            for one in report.per_effect
        ],
        plots=[
            (caption, embed_figure(figure, f"plot-{k}", _FIGURE_HEIGHT))
            for k, (caption, figure) in enumerate(build_gap_figures(gap, table, origins, report.unexplained.patch))
        ],
        fitted=[_format_parameter(one) for one in report.fitted if _is_listed(one, report)],
        numbered=gap_sentences.format_shot_folders(origins),
        laws=" and ".join(format_law(name) for name in report.forms),
        model=gap_sentences.format_assumed_effects(report),
        undecided=gap_sentences.format_undecided(report),
        profile=escape_text(path.parent / PROFILE_FILE) if table is not None and has_fitted_model(report) else "",
        plotly=pack_plotly_source(),
    )
    write_text(path, html)


def _list_places(report: DiagnosisReport, origins: Mapping[int, str]) -> list[dict[str, str]]:
    """List where the gap appears, as table rows."""
    return [
        {
            "phase": format_phase(one.phase),
            "share": gap_sentences.format_share(one.share),
            "mostly": ", ".join(_format_subjects(one, report.scene, origins)),
            "grows_with": format_growth_variable(one.grows_with or ""),
        }
        for one in report.where
    ]


def _format_subjects(one: GapLocation, scene: str, origins: Mapping[int, str]) -> list[str]:
    """Format the ball or other body, the shot and the image region that contribute most to a phase."""
    ball = None if one.ball is None else f"{'ball' if scene == 'billiards' else 'body'} {one.ball}"
    shot = None if one.shot is None else gap_sentences.format_shot_name(one.shot, origins)
    return [word for word in (ball, shot, one.region) if word is not None]


def _is_listed(one: Strength, report: DiagnosisReport) -> bool:
    """Return whether a parameter is listed; a parameter that the contact models do not use is not."""
    effect = one.name.partition(".")[0]
    unused = one.prior_only and not math.isfinite(one.detectable_from)
    return not unused or effect in (*report.model, *report.effects)


def _format_parameter(one: Strength) -> dict[str, str]:
    """Format a parameter as a table row; a parameter that is not identifiable has no value."""
    name, unit = format_parameter(one.name), format_unit(one.unit)
    if one.prior_only:
        return {"name": name, "unidentified": gap_sentences.format_unidentified(one)}
    value, sigma = format_measured(one.value, one.sigma)
    return {"name": name, "unidentified": "", "value": value, "sigma": sigma, "unit": unit}
