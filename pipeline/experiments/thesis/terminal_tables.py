"""Tables of results in the terminal."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table as Grid

from pipeline.experiments.thesis.thesis_page import build_tables
from pipeline.experiments.thesis.thesis_sentences import SettingResult

LOOKS = {"best": "bold green", "worse": "dim"}
"""Text styles of cells."""


def build_grids(scene: str, results: list[SettingResult]) -> list[Grid]:
    """Build a table for each variant of a scene: methods down, frame rates and noises across.

    Args:
        scene: Name of the scene.
        results: Results of all settings.

    Returns:
        One table per variant.
    """
    grids = []
    for sheet in build_tables(scene, results):
        grid = Grid(title=escape(sheet.caption), box=None, pad_edge=False, title_justify="left")
        grid.add_column("method", no_wrap=True)
        for head in sheet.heads:
            grid.add_column(head.replace(", ", "\n"), justify="right")
        for line in sheet.rows:
            looks = [LOOKS.get(number.look) for number in line.cells]
            texts = [f"[{look}]{number.text}[/]" if look else number.text
                     for look, number in zip(looks, line.cells, strict=True)]  # fmt: skip
            grid.add_row(escape(line.method), *texts)
        grids.append(grid)
    return grids
