"""`trueroll certify`: measure a table by the shots of a session."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table as Grid

from pipeline.actions.certify_table import certify_table, list_shot_folders
from pipeline.engine.atomic_write import require_writable_folder, write_json
from pipeline.engine.helper_executor import open_executor
from pipeline.engine.result_cache import open_cache
from pipeline.io.certificate_files import (
    CERTIFICATE_FILE,
    NAMES,
    compare_certificates,
    describe_comparison,
    read_certificate,
)
from pipeline.reporting.pages.certificate_page import (
    format_certificate,
    format_comparison,
    format_number,
    format_too_few,
    write_certificate_page,
)
from pipeline.reporting.text.text_formatting import name_folders
from pipeline.terminal import command_line as cli
from pipeline.terminal.activity_display import show_shot_fits

PAGE_FILE = "certificate.html"


@cli.app.command("certify")
def certify(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Run folders, track folders or a batch's folder, all of one table."),
    ],
    out: Annotated[Path, cli.make_output_option("Folder of the certificate.")] = Path("certificate"),
    compare: Annotated[
        Path | None,
        typer.Option("--compare", metavar="OTHER.json", help="An earlier certificate: which numbers differ from it."),
    ] = None,
    cache: cli.CacheOption = None,
    as_json: cli.JsonOption = False,
    debug: cli.DebugOption = False,
) -> None:
    """Certify a table: slope, restitution, speed of the cloth, size and squareness, each with its error.

    The fit of every shot is cached, so that a second call resumes, and a larger one continues.
    """
    other = None if compare is None else read_certificate(compare)  # an error of it comes before the work
    sources = list_shot_folders(inputs)
    require_writable_folder(out)
    store = open_cache(cache)
    with open_executor() as executor, show_shot_fits(cli.console, "measuring the table") as show:
        certified = certify_table(sources, store, executor, show)
    document = certified.document
    rows = () if other is None else compare_certificates(other, document)
    name = "" if compare is None else compare.stem if compare.suffix == ".json" else compare.name
    if other is not None:
        document["compared_with"] = {"certificate": str(compare), "numbers": describe_comparison(rows)}
    out.mkdir(parents=True, exist_ok=True)
    write_json(document, out / CERTIFICATE_FILE)
    write_certificate_page(certified, name_folders(certified.sources), out / PAGE_FILE, rows, name)
    if as_json:
        print(json.dumps(document, allow_nan=False))
    else:
        _print_certificate(document, format_comparison(rows, name) if rows else "", out)


def _print_certificate(document: dict[str, Any], comparison: str, out: Path) -> None:
    screen = cli.make_output_console()
    screen.print(f"[bold]{escape(format_certificate(document))}[/]")
    warning = format_too_few(document)
    if warning:
        screen.print(f"[yellow]{escape(warning)}[/]")
    grid = Grid("quantity", "value", "±", "unit", box=None, pad_edge=False)
    for name, entry in document["numbers"].items():
        grid.add_row(NAMES[name], *format_number(name, entry))
    screen.print(grid)
    screen.print(escape(f"Pocket openings are not observable: {document['pocket_openings']['why']}"))
    for refusal in document["refused"]:
        screen.print(escape(f"Note: {refusal}"))
    if comparison:
        screen.print(escape(comparison))
    print(f"Look at {out / PAGE_FILE}")
