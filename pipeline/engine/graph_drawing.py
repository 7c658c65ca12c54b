"""The graph of stages as a picture: SVG for pages, PNG for everything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from models.core.errors import OptionError
from pipeline.engine.atomic_write import aside
from pipeline.engine.stage_graph import Outlook

BOX, GAP, MARGIN = (200, 54), (70, 26), 24
"""px: size of a box, space between columns and rows, border."""
COLOURS = {"cached": "#d7f0e2", "stale": "#fde6c4", "waiting": "#eceff1"}
LINE, INK, SOFT = "#7b8a84", "#1b2420", "#55605a"
CHARACTERS = 32
"""Of the second line of a box."""


@dataclass(frozen=True, slots=True)
class Box:
    """A stage and where it is drawn."""

    view: Outlook
    x: int
    y: int

    @property
    def words(self) -> tuple[str, str]:
        why = self.view.why or self.view.state
        return self.view.stage, why if len(why) <= CHARACTERS else why[: CHARACTERS - 1] + "…"


def lay_out(views: Sequence[Outlook]) -> list[Box]:
    """Boxes in columns: each stage right of everything that it needs."""
    column: dict[str, int] = {}
    rows: dict[int, int] = {}
    boxes = []
    for view in views:
        column[view.stage] = max((column[name] + 1 for name in view.needs), default=0)
        row = rows.get(column[view.stage], 0)
        rows[column[view.stage]] = row + 1
        x = MARGIN + column[view.stage] * (BOX[0] + GAP[0])
        boxes.append(Box(view, x, MARGIN + row * (BOX[1] + GAP[1])))
    return boxes


def write_picture(views: Sequence[Outlook], path: Path) -> None:
    """Write .svg or .png by the suffix of `path`; OptionError for another."""
    suffix = path.suffix.lower()
    if suffix not in (".svg", ".png"):
        raise OptionError(f"A picture of the graph is an .svg or a .png; {path.name} is neither")
    boxes = lay_out(views)
    width = max(box.x for box in boxes) + BOX[0] + MARGIN
    height = max(box.y for box in boxes) + BOX[1] + MARGIN
    with aside(path) as fresh:
        if suffix == ".svg":
            fresh.write_text(_svg(boxes, width, height), encoding="utf-8")
        else:
            _png(boxes, width, height).save(fresh, format="PNG")


def _arrows(boxes: Sequence[Box]) -> list[tuple[int, int, int, int]]:
    """Start and end of the arrow from every input."""
    by_name = {box.view.stage: box for box in boxes}
    half = BOX[1] // 2
    return [
        (by_name[name].x + BOX[0], by_name[name].y + half, box.x, box.y + half)
        for box in boxes
        for name in _direct_needs(box.view, by_name)
    ]


def _direct_needs(view: Outlook, by_name: dict[str, Box]) -> list[str]:
    """Inputs that no other input needs: the rest follows and would only hide the order."""
    covered: set[str] = set()
    for name in view.needs:
        waiting = list(by_name[name].view.needs)
        while waiting:
            above = waiting.pop()
            covered.add(above)
            waiting.extend(by_name[above].view.needs)
    return [name for name in view.needs if name not in covered]


def _svg(boxes: Sequence[Box], width: int, height: int) -> str:
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, DejaVu Sans, sans-serif">',
        f'<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        f'<path d="M0 0 8 4 0 8z" fill="{LINE}"/></marker><rect width="100%" height="100%" fill="#fff"/>',
    ]
    for x0, y0, x1, y1 in _arrows(boxes):
        bend = (x0 + x1) // 2
        curve = f"M{x0} {y0}C{bend} {y0} {bend} {y1} {x1} {y1}"
        parts.append(f'<path d="{curve}" fill="none" stroke="{LINE}" stroke-width="1.5" marker-end="url(#tip)"/>')
    for box in boxes:
        name, why = box.words
        parts.append(
            f'<g><title>{escape(box.view.why or "cached")}</title><rect x="{box.x}" y="{box.y}" width="{BOX[0]}" '
            f'height="{BOX[1]}" rx="8" fill="{COLOURS[box.view.state]}" stroke="{LINE}"/>'
            f'<text x="{box.x + 12}" y="{box.y + 23}" font-size="15" font-weight="600" fill="{INK}">'
            f"{escape(name)}</text>"
            f'<text x="{box.x + 12}" y="{box.y + 42}" font-size="11" fill="{SOFT}">{escape(why)}</text></g>'
        )
    return "\n".join([*parts, "</svg>\n"])


def _png(boxes: Sequence[Box], width: int, height: int) -> Image.Image:
    scale = 2
    picture = Image.new("RGB", (scale * width, scale * height), "white")
    draw = ImageDraw.Draw(picture)
    title, small = (ImageFont.load_default(scale * size) for size in (15, 11))
    for x0, y0, x1, y1 in ([scale * v for v in arrow] for arrow in _arrows(boxes)):
        bend = (x0 + x1) // 2
        draw.line([(x0, y0), (bend, y0), (bend, y1), (x1, y1)], fill=LINE, width=scale + 1)
        draw.polygon([(x1, y1), (x1 - 8 * scale, y1 - 4 * scale), (x1 - 8 * scale, y1 + 4 * scale)], fill=LINE)
    for box in boxes:
        name, why = box.words
        x, y = scale * box.x, scale * box.y
        corner = (x + scale * BOX[0], y + scale * BOX[1])
        draw.rounded_rectangle([(x, y), corner], 8 * scale, COLOURS[box.view.state], LINE, scale)
        draw.text((x + 12 * scale, y + 7 * scale), name, INK, title)
        draw.text((x + 12 * scale, y + 31 * scale), why, SOFT, small)
    return picture
