"""Rendering of HTML templates with escaped values, and of images and plotly figures that need no network."""

from __future__ import annotations

import base64
import gzip
import io
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape
from PIL import Image
from plotly.io import templates
from plotly.io.json import to_json_plotly
from plotly.offline import get_plotlyjs

from models.core.number_format import format_probability
from models.core.typing import ImageArray


def render_template(template: str, **values: object) -> str:
    """Render a template of `pipeline/reporting/pages/templates`.

    Args:
        template: File name of the template.
        values: Values of the template; all are escaped unless the template marks them as safe.

    Returns:
        The HTML page.
    """
    environment = Environment(
        loader=PackageLoader("pipeline.reporting.pages", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["keep_units"] = _keep_units
    environment.filters["probability"] = format_probability
    return environment.get_template(template).render(**values)


def _keep_units(text: str) -> Markup:
    """Keep units on the line of their number, and an option of the command line in one piece."""
    text = re.sub(r"(?<=\d) (?=(?:s|c?mm?|m/s|km/h|mrad|rad/s|diamonds|frames?)\b|%|±)", "\N{NO-BREAK SPACE}", text)
    return Markup(re.sub(r"--[a-z][\w-]*", r"<span class=option>\g<0></span>", str(escape(text))))


def pack_plotly_source() -> str:
    """Return the source of plotly.js, compressed to a third for a page: base64 of gzip."""
    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), mtime=0)).decode("ascii")


def embed_figure(figure: go.Figure, name: str, height: int) -> str:
    """Format a figure as HTML that the script of the page draws, in an element with the id `name`; height in px."""
    drawn = figure.to_plotly_json()
    margin = {"l": 60, "r": 14, "t": 14, "b": 48} | drawn["layout"].get("margin", {})
    legend = {"orientation": "h", "y": -0.24} | drawn["layout"].get("legend", {})
    # Set in the dictionary: plotly validates every property set on a figure, which takes longer than everything else.
    drawn["layout"] |= {
        "template": _load_figure_template(),
        "height": height,
        "margin": margin,
        "legend": legend,
        "font": {"size": 13},
    }
    config = {"displayModeBar": False, "responsive": True}  # the tool bar would cover the plot
    content = to_json_plotly({"data": drawn["data"], "layout": drawn["layout"], "config": config})
    return f'<div id="{name}" style="height: {height}px"></div>\n' + (
        f'<script type="application/json" data-figure="{name}">{content}</script>'
    )


@lru_cache(maxsize=1)
def _load_figure_template() -> dict[str, Any]:
    """Return the plotly template that all figures share."""
    template: dict[str, Any] = templates["plotly_white"].to_plotly_json()
    return template


JPEG_QUALITY = 82
# Longest side of an embedded image, px: phones load the page too.
MAX_IMAGE_PX = 1280


def embed_image_file(path: Path, longest: int = MAX_IMAGE_PX, quality: int = JPEG_QUALITY) -> str:
    """Encode an image file as the data URI of a JPEG whose sides are no longer than `longest` px."""
    with Image.open(path) as image:
        return build_jpeg_uri(np.asarray(image.convert("RGB")), longest, quality)


def build_jpeg_uri(pixels: ImageArray, longest: int = MAX_IMAGE_PX, quality: int = JPEG_QUALITY) -> str:
    """Encode an image (H, W, 3) as the data URI of a JPEG whose sides are no longer than `longest` px."""
    image, buffer = Image.fromarray(pixels), io.BytesIO()
    image.thumbnail((longest, longest))
    image.save(buffer, format="JPEG", quality=quality)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
