"""How the viewer lies when a recording is opened: picture beside plan, plots and words below."""

from __future__ import annotations

import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from models.core.scene import Table
from pipeline.reporting.recording.recording_stream import VIDEO_TIME
from video.io.clip import Clip

MARGIN_RADII = 4.0
"""Ball radii about the table."""


def blueprint(clip: Clip, table: Table | None) -> rrb.Blueprint:
    """Of a clip on this table; before the table is known, the plan shows what there is."""
    whole = rrb.VisualBounds2D(x_range=[-0.5, clip.width - 0.5], y_range=[-0.5, clip.height - 0.5])
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="picture", name="Picture", visual_bounds=whole),
                rrb.Vertical(plan_view(table), _words(), row_shares=[3, 2]),
                column_shares=[3, 2],
            ),
            rrb.Horizontal(
                _plot(clip, "speed", "Speed (m/s)"),
                _plot(clip, "energy", "Energy (mJ)"),
                _plot(clip, "residual", "Measured minus fitted (mm)"),
            ),
            row_shares=[5, 2],
        ),
        rrb.TimePanel(timeline=VIDEO_TIME, state="collapsed", play_state="playing", loop_mode="all"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def plan_view(table: Table | None) -> rrb.Spatial2DView:
    """The table from above."""
    if table is None:
        return rrb.Spatial2DView(origin="plan", name="Plan (m)")
    margin = MARGIN_RADII * table.ball_radius
    below = table.width + 1.5 * margin  # with room for the caption
    bounds = rrb.VisualBounds2D(x_range=[-margin, table.length + margin], y_range=[-margin, below])
    return rrb.Spatial2DView(origin="plan", name="Plan (m)", visual_bounds=bounds)


def _words() -> rrb.Tabs:
    body, level = TextLogColumn("Body"), TextLogColumn("LogLevel")
    events = rrb.TextLogView(
        origin="log/events", name="Events", columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[body])
    )
    chain = rrb.TextLogView(
        origin="log/chain",
        name="How it was found",
        columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=[level, body]),
    )
    return rrb.Tabs(events, rrb.TextDocumentView(origin="about", name="What was fitted"), chain, active_tab=0)


def _plot(clip: Clip, what: str, name: str) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.RightTop)  # most is fast and uncertain at the beginning
    first, last = (rrb.TimeRangeBoundary.absolute(seconds=float(clip.t[k])) for k in (0, -1))
    whole = rrb.TimeAxis(view_range=rrb.TimeRange(start=first, end=last))  # alike in all: moments stand over each other
    return rrb.TimeSeriesView(origin=f"plots/{what}", name=name, plot_legend=legend, axis_x=whole)
