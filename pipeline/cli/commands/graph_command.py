"""`trueroll graph`: list the stages, which are cached, and why others are stale."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path
from typing import Annotated

import typer

from models.core.errors import OptionError
from pipeline.chain import build_court_graph, build_run_graph
from pipeline.engine.atomic_write import write_text
from pipeline.engine.result_cache import ResultCache, open_cache
from pipeline.engine.stage_graph import StageStatus
from pipeline.run_options import RunOptions, build_options, list_settings
from pipeline.terminal import command_line as cli
from pipeline.terminal.command_settings import add_settings


@cli.command("graph")
@add_settings(list_settings(), build_options)
def graph(
    options: RunOptions,
    clip: Annotated[Path | None, typer.Argument()] = None,
    out: Annotated[Path | None, cli.OUT] = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
) -> None:
    """List the stages in order: which are cached, and why others are stale.

    Args:
        clip: The clip whose stages are listed.
        out: Draw the graph into an .svg file.
    """
    if clip is None:
        stages = build_run_graph(Path(__file__), options).stages
        views = [StageStatus(s.name, s.needs, "waiting", "waits for a clip" if not s.needs else "") for s in stages]
    else:
        views = _list_statuses(clip, options, open_cache(cache))
    if out is not None:
        write_graph_image(views, out)
    if as_json:
        print(json.dumps([asdict(v) for v in views]))
        return
    if clip is None:
        cli.print_rows(("stage", "needs"), ((v.stage, ", ".join(v.needs)) for v in views))
        print(f"Drawn in {out}" if out is not None else "Name a clip to see what is cached: trueroll graph CLIP")
        return
    style = {"cached": "green", "stale": "yellow", "waiting": "dim"}
    rows = ((v.stage, ", ".join(v.needs), f"[{style[v.state]}]{v.state}[/]", v.why) for v in views)
    cli.print_rows(("stage", "needs", "state", "why"), rows)
    if out is not None:
        print(f"Drawn in {out}")


def _list_statuses(clip: Path, options: RunOptions, cache: ResultCache) -> list[StageStatus]:
    """List the states of the stages of a clip, of a rally where a court was found in it."""
    if options.court.sport is None:
        views = build_court_graph(clip, options).list_statuses(cache)
        if any(view.stage == "court" and view.state == "cached" for view in views):
            return views
    return build_run_graph(clip, options).list_statuses(cache)


# Size of a box, space between columns and rows, border, all in px.
BOX, GAP, MARGIN = (200, 54), (70, 26), 24
COLOURS = {"cached": "#d7f0e2", "stale": "#fde6c4", "waiting": "#eceff1"}
LINE, INK, SOFT = "#7b8a84", "#1b2420", "#55605a"
# Most characters in the second line of a box.
CHARACTERS = 32


@dataclass(frozen=True, slots=True)
class StageBox:
    """A stage and the top left corner of its box, px."""

    status: StageStatus
    x: int
    y: int

    @property
    def lines(self) -> tuple[str, str]:
        """Text of the box: the name of the stage, and its state or why it is stale."""
        why = self.status.why or self.status.state
        return self.status.stage, why if len(why) <= CHARACTERS else why[: CHARACTERS - 1] + "…"


def arrange_boxes(statuses: Sequence[StageStatus]) -> list[StageBox]:
    """Arrange boxes in columns, each stage right of everything that it needs."""
    column: dict[str, int] = {}
    rows: dict[int, int] = {}
    boxes = []
    for status in statuses:
        column[status.stage] = max((column[name] + 1 for name in status.needs), default=0)
        row = rows.get(column[status.stage], 0)
        rows[column[status.stage]] = row + 1
        x = MARGIN + column[status.stage] * (BOX[0] + GAP[0])
        boxes.append(StageBox(status, x, MARGIN + row * (BOX[1] + GAP[1])))
    return boxes


def write_graph_image(statuses: Sequence[StageStatus], path: Path) -> None:
    """Draw the graph into a file.

    Args:
        statuses: Stages with their states, in the order of the graph.
        path: The .svg file.

    Raises:
        OptionError: The suffix is another one.
    """
    if path.suffix.lower() != ".svg":
        raise OptionError(f"The graph is drawn into an .svg file; {path.name} is none")
    boxes = arrange_boxes(statuses)
    width = max(box.x for box in boxes) + BOX[0] + MARGIN
    height = max(box.y for box in boxes) + BOX[1] + MARGIN
    write_text(path, _format_svg(boxes, width, height))


def _list_arrows(boxes: Sequence[StageBox]) -> list[tuple[int, int, int, int]]:
    """List the arrows to every stage from its direct inputs as (x0, y0, x1, y1), px."""
    by_name = {box.status.stage: box for box in boxes}
    half = BOX[1] // 2
    return [
        (by_name[name].x + BOX[0], by_name[name].y + half, box.x, box.y + half)
        for box in boxes
        for name in _select_direct_inputs(box.status, by_name)
    ]


def _select_direct_inputs(status: StageStatus, by_name: dict[str, StageBox]) -> list[str]:
    """Select the inputs that no other input needs; arrows from the others would hide the order."""
    covered: set[str] = set()
    for name in status.needs:
        waiting = list(by_name[name].status.needs)
        while waiting:
            above = waiting.pop()
            covered.add(above)
            waiting.extend(by_name[above].status.needs)
    return [name for name in status.needs if name not in covered]


def _format_svg(boxes: Sequence[StageBox], width: int, height: int) -> str:
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="system-ui, DejaVu Sans, sans-serif">',
        f'<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        f'<path d="M0 0 8 4 0 8z" fill="{LINE}"/></marker><rect width="100%" height="100%" fill="#fff"/>',
    ]
    for x0, y0, x1, y1 in _list_arrows(boxes):
        bend = (x0 + x1) // 2
        curve = f"M{x0} {y0}C{bend} {y0} {bend} {y1} {x1} {y1}"
        parts.append(f'<path d="{curve}" fill="none" stroke="{LINE}" stroke-width="1.5" marker-end="url(#tip)"/>')
    for box in boxes:
        name, why = box.lines
        parts.append(
            f'<g><title>{escape(box.status.why or "cached")}</title><rect x="{box.x}" y="{box.y}" width="{BOX[0]}" '
            f'height="{BOX[1]}" rx="8" fill="{COLOURS[box.status.state]}" stroke="{LINE}"/>'
            f'<text x="{box.x + 12}" y="{box.y + 23}" font-size="15" font-weight="600" fill="{INK}">'
            f"{escape(name)}</text>"
            f'<text x="{box.x + 12}" y="{box.y + 42}" font-size="11" fill="{SOFT}">{escape(why)}</text></g>'
        )
    return "\n".join([*parts, "</svg>\n"])
