"""What all pages have in common: one look, templates that escape everything, figures that embed offline."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from plotly.io import templates, to_html
from plotly.offline import get_plotlyjs


def render(template: str, **values: object) -> str:
    """A page from a template of `pipeline/templates`; every value is escaped but what the template calls safe."""
    page = Environment(
        loader=PackageLoader("pipeline.reporting.pages", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    ).get_template(template)
    return page.render(**values)


def plotly_source() -> str:
    """The library that draws figures, to be carried in a page."""
    source: str = get_plotlyjs()
    return source


def embedded(figure: go.Figure, name: str, height: int) -> str:
    """A figure as HTML that `plotly_source` draws, in an element called `name`."""
    drawn = figure.to_plotly_json()
    margin = {"l": 60, "r": 14, "t": 14, "b": 48}
    legend = {"orientation": "h", "y": -0.24}
    # as plain words: given to the figure, the look is checked word by word, which takes longer than all the rest
    drawn["layout"] |= {"template": _look(), "height": height, "margin": margin, "legend": legend, "font": {"size": 13}}
    config = {"displayModeBar": False, "responsive": True}  # the bar of buttons would cover what is drawn
    html: str = to_html(drawn, config, full_html=False, include_plotlyjs=False, div_id=name, validate=False)
    return html


@lru_cache(maxsize=1)
def _look() -> dict[str, Any]:
    """What all figures have in common."""
    look: dict[str, Any] = templates["plotly_white"].to_plotly_json()
    return look
