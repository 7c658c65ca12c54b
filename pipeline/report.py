"""The page of a run: one self-contained HTML file to keep and send."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from models.fit import Fit
from models.scene import Scene
from models.tracks import Tracks
from pipeline.embedding import data_uri, write_page
from pipeline.publish import aside
from pipeline.sampling import ever_moves, sample_motion
from pipeline.sentences import event_sentence, parameter_range
from pipeline.verdict import run_trust
from video.clip import Clip
from video.palette import INK, Colour, ball_colour, mix

Floats = NDArray[np.float64]

EMBED_LIMIT_BYTES = 48_000_000
"""A larger slow.mp4 is linked beside the page instead of carried in it."""
SLOW_MARK = "slow-motion-carried-here"
"""Where the video goes in the page."""
PLOT_HZ = 60.0
HOVER = "%{customdata[0]:.3f} s, %{customdata[1]:.2f} m/s"
PACKAGES = ("trueroll", "torch", "opencv-python-headless", "onnxruntime", "numpy", "av")


@dataclass(frozen=True, slots=True)
class ReportFiles:
    """What the page shows: the slow motion and the still, already written."""

    slow: Path
    poster: Path
    slow_factor: float
    start: float = 0.0
    """s of the clip at which the slow motion begins."""


def write_report(
    clip: Clip,
    scene: Scene,
    tracks: Tracks,
    fit: Fit,
    files: ReportFiles,
    title: str,
    settings: Sequence[str],
    path: Path,
) -> None:
    """Write the page to `path`; `settings` are the options that reproduce the run, for its last section."""
    colours = [_css(ball_colour(*seen)) for seen in zip(tracks.kinds, tracks.colour, strict=True)]
    page = Environment(
        loader=PackageLoader("pipeline", "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    ).get_template("report.html")
    carried = {SLOW_MARK: (files.slow, "video/mp4")} if files.slow.stat().st_size <= EMBED_LIMIT_BYTES else {}
    html = page.render(
        name=title,
        trust=run_trust(clip, fit),
        poster=data_uri(files.poster, "image/png"),
        video=SLOW_MARK if carried else files.slow.name,
        events=_event_rows(fit, files),
        plan=_embedded(plan_figure(scene, fit, colours), "plan"),
        plan_ratio=round(scene.table.width / scene.table.length, 4),
        speeds=_embedded(speed_figure(scene, fit, colours), "speeds"),
        plotly=get_plotlyjs(),
        parameters=[(p, parameter_range(p.name)) for p in fit.parameters],
        quality=_quality(clip, fit),
        notes=[*scene.notes, *clip.notes],
        settings=list(settings),
        versions={name: version(name) for name in PACKAGES},
        digest=clip.digest,
    )
    with aside(path) as fresh:
        write_page(html, carried, fresh)


def plan_figure(scene: Scene, fit: Fit, colours: Sequence[str]) -> go.Figure:
    """The table from above: fitted paths, balls where they come to; y runs down, as in the picture."""
    table = scene.table
    figure = go.Figure()
    figure.add_shape(type="rect", x0=0, y0=0, x1=table.length, y1=table.width, line={"color": "#4b6b5d", "width": 3})
    for x, y in table.pocket_centres:
        r = 1.6 * table.ball_radius
        figure.add_shape(type="circle", x0=x - r, y0=y - r, x1=x + r, y1=y + r, fillcolor="#30343a", line_width=0)
    t, xy, speed = sample_motion(fit.trajectory, PLOT_HZ)
    moves = ever_moves(xy, table.ball_radius)
    for k, ball in enumerate(fit.trajectory.ids):
        rows = np.flatnonzero(np.isfinite(xy[:, k, 0]))
        if not len(rows):
            continue
        hover = np.stack([t, speed[:, k]], axis=-1)
        for shown, mode in ((rows if moves[k] else rows[:0], "lines"), (rows[-1:], "markers")):
            figure.add_scatter(
                x=xy[shown, k, 0], y=xy[shown, k, 1], mode=mode, name=ball, legendgroup=ball, marker_size=10,
                showlegend=mode == "markers", line_color=colours[k], marker_color=colours[k], customdata=hover[shown],
                hovertemplate=f"{HOVER}<extra>{ball}</extra>",
            )  # fmt: skip
    events = fit.events
    marked = [k for k in range(len(events)) if events.kind[k] not in ("rest",)]
    figure.add_scatter(
        x=events.xy[marked, 0], y=events.xy[marked, 1], mode="markers", name="contacts",
        marker={"symbol": "x", "size": 8, "color": "#c2410c"},
        text=[event_sentence(events, k) for k in marked], hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip
    rim = 0.04 * table.length
    figure.update_yaxes(
        range=[table.width + rim, -rim], scaleanchor="x", constrain="domain", constraintoward="top", title="y (m)"
    )
    figure.update_xaxes(range=[-rim, table.length + rim], constrain="domain", title="x (m)")
    return _styled(figure, height=440)


def speed_figure(scene: Scene, fit: Fit, colours: Sequence[str]) -> go.Figure:
    """Speed of every ball that moves, over the time of the source clip."""
    figure = go.Figure()
    t, xy, speed = sample_motion(fit.trajectory, PLOT_HZ)
    moves = ever_moves(xy, scene.table.ball_radius)
    for k, ball in enumerate(fit.trajectory.ids):
        if moves[k]:
            figure.add_scatter(x=t, y=speed[:, k], mode="lines", name=ball, line_color=colours[k])
    for k, when in enumerate(fit.events.t):
        if fit.events.kind[k] in ("strike", "ball", "cushion"):
            figure.add_vline(x=float(when), line_width=1, line_dash="dot", line_color="#9ca3af")
    figure.update_xaxes(title="time (s)")
    figure.update_yaxes(title="speed (m/s)", rangemode="tozero")
    return _styled(figure, height=320)


def _css(colour: Colour) -> str:
    """A ball's colour on a white page: darkened where it would not be seen."""
    red, green, blue = mix(colour, INK, 0.35 if min(colour) > 150 else 0.0)
    return f"rgb({red},{green},{blue})"


def _styled(figure: go.Figure, height: int) -> go.Figure:
    margin = {"l": 56, "r": 12, "t": 12, "b": 48}
    legend = {"orientation": "h", "y": -0.22}
    return figure.update_layout(template="plotly_white", height=height, margin=margin, legend=legend)


def _embedded(figure: go.Figure, name: str) -> str:
    config = {"displayModeBar": False, "responsive": True}  # the bar of buttons would cover a pocket
    html: str = figure.to_html(full_html=False, include_plotlyjs=False, div_id=name, config=config)
    return html


def _event_rows(fit: Fit, files: ReportFiles) -> list[dict[str, str | float]]:
    """The contact list: each row seeks the video to a little before the moment."""
    events = fit.events
    lead_in = 0.15
    rows: list[dict[str, str | float]] = []
    for k in range(len(events)):
        gap = f"{1000 * events.gap[k]:+.1f} ± {1000 * events.gap_sigma[k]:.1f}" if np.isfinite(events.gap[k]) else ""
        rows.append(
            {
                "seek": round(max(float(events.t[k]) - lead_in - files.start, 0.0) * files.slow_factor, 3),
                "time": f"{events.t[k]:.4f}",
                "sigma": f"{1000 * events.t_sigma[k]:.1f}",
                "sentence": event_sentence(events, k),
                "speed": f"{events.speed[k]:.2f}" if np.isfinite(events.speed[k]) else "",
                "gap": gap,
                "probability": f"{events.probability[k]:.0%}",
            }
        )
    return rows


def _quality(clip: Clip, fit: Fit) -> dict[str, str]:
    moving, held = int(fit.moving.sum()), int((fit.moving & fit.accepted).sum())
    return {
        "Pictures": f"{len(clip.distinct)} distinct of {clip.frame_count}, {float(clip.rate):.3f} per second",
        "Moving balls explained by physics": f"{held / moving:.0%} of their time" if moving else "nothing moves",
        "Noise of a measured position": f"{1000 * fit.noise:.2f} mm",
        "Chi-square per degree of freedom": f"{fit.chi2_per_dof:.2f}",
    }
