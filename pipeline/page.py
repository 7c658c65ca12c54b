"""What all pages have in common: one look, templates that escape everything, figures that embed offline."""

from __future__ import annotations

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.offline import get_plotlyjs


def render(template: str, **values: object) -> str:
    """A page from a template of `pipeline/templates`; every value is escaped but what the template calls safe."""
    page = Environment(
        loader=PackageLoader("pipeline", "templates"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    ).get_template(template)
    return page.render(**values)


def plotly_source() -> str:
    """The library that draws figures, to be carried in a page."""
    source: str = get_plotlyjs()
    return source


def embedded(figure: go.Figure, name: str, height: int) -> str:
    """A figure as HTML that `plotly_source` draws, in an element called `name`."""
    margin = {"l": 60, "r": 14, "t": 14, "b": 48}
    legend = {"orientation": "h", "y": -0.24}
    figure.update_layout(template="plotly_white", height=height, margin=margin, legend=legend, font={"size": 13})
    config = {"displayModeBar": False, "responsive": True}  # the bar of buttons would cover what is drawn
    html: str = figure.to_html(full_html=False, include_plotlyjs=False, div_id=name, config=config)
    return html
