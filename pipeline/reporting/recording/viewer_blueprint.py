"""Layout of the viewer for a recording: video beside plan and text, plots below."""

from __future__ import annotations

import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from models.core.scene import Table
from pipeline.reporting.recording.recorded_shot import VIDEO_TIME
from video.io.clip import Clip

# Margin of the plan around the table, ball radii.
MARGIN_RADII = 4.0


def build_blueprint(clip: Clip, table: Table | None) -> rrb.Blueprint:
    """Build the layout for a clip; without a table, the plan has no fixed bounds."""
    whole = rrb.VisualBounds2D(x_range=[-0.5, clip.width - 0.5], y_range=[-0.5, clip.height - 0.5])
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="picture", name="Video", visual_bounds=whole),
                rrb.Vertical(build_plan_view(table), _build_text_views(), row_shares=[3, 2]),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                _build_plot_view(clip, "speed", "Speed (m/s)"),
                _build_plot_view(clip, "energy", "Energy (mJ)"),
                _build_plot_view(clip, "residual", "Measured minus fitted (mm)"),
            ),
            row_shares=[5, 2],
        ),
        rrb.TimePanel(timeline=VIDEO_TIME, state="collapsed", play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def build_plan_view(table: Table | None) -> rrb.Spatial2DView:
    """Build the view of the table from above."""
    if table is None:
        return rrb.Spatial2DView(origin="plan", name="Plan (m)")
    margin = MARGIN_RADII * table.ball_radius
    below = table.width + 1.5 * margin  # with room for the caption
    bounds = rrb.VisualBounds2D(x_range=[-margin, table.length + margin], y_range=[-margin, below])
    return rrb.Spatial2DView(origin="plan", name="Plan (m)", visual_bounds=bounds)


def _build_text_views() -> rrb.Tabs:
    body, level = TextLogColumn("Body"), TextLogColumn("LogLevel")
    events = rrb.TextLogView(
        origin="log/events", name="Events", columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[body])
    )
    chain = rrb.TextLogView(
        origin="log/chain",
        name="Processing log",
        columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[level, body]),
    )
    return rrb.Tabs(events, rrb.TextDocumentView(origin="about", name="Fitted model"), chain, active_tab=0)


def _build_plot_view(clip: Clip, what: str, name: str) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)  # the upper right is empty: balls are fast at the beginning
    first, last = (rrb.TimeRangeBoundary.absolute(seconds=float(clip.t[k])) for k in (0, -1))
    whole = rrb.TimeAxis(
        view_range=rrb.TimeRange(start=first, end=last)
    )  # same range in all plots, so that times align
    return rrb.TimeSeriesView(origin=f"plots/{what}", name=name, plot_legend=legend, axis_x=whole)
