"""The tables of a terminal."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table as Grid

from pipeline.experiments.thesis.thesis_page import sheets
from pipeline.experiments.thesis.thesis_sentences import Cell

LOOKS = {"best": "bold green", "worse": "dim"}


def grids(scene: str, found: list[Cell]) -> list[Grid]:
    """A table for each variant of a scene: methods down, rates and noises across."""
    made = []
    for sheet in sheets(scene, found):
        grid = Grid(title=escape(sheet.caption), box=None, pad_edge=False, title_justify="left")
        grid.add_column("method", no_wrap=True)
        for head in sheet.heads:
            grid.add_column(head.replace(", ", "\n"), justify="right")
        for line in sheet.rows:
            looks = [LOOKS.get(number.look) for number in line.cells]
            texts = [f"[{look}]{number.text}[/]" if look else number.text
                     for look, number in zip(looks, line.cells, strict=True)]  # fmt: skip
            grid.add_row(escape(line.method), *texts)
        made.append(grid)
    return made
