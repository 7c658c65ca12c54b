"""The certificate of a table from the shots of a session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from models.core.answer import Answer, Quantity
from models.estimation.table_learning.table_measurements import TableMeasurement, measure_table
from models.numerics.executor import Executor
from pipeline.actions.fit_table import fit_table_of_shots
from pipeline.engine.result_cache import ResultCache
from pipeline.io.certificate_files import (
    CERTIFICATE_FILE,
    NAMES,
    CertifiedTable,
    NumberComparison,
    compare_certificates,
    describe_certificate,
    describe_comparison,
)
from pipeline.io.run_folder import list_files_beside, parse_camera, read_csv_columns, read_scene_document
from pipeline.io.strict_json import write_json
from pipeline.reporting.pages.certificate_page import (
    format_certificate,
    format_comparison,
    format_number,
    format_too_few,
    write_certificate_page,
)
from pipeline.reporting.text.text_formatting import name_folders
from video.calibration.camera_model import ShapeEstimate, estimate_shape

PAGE_FILE = "certificate.html"


def certify_table(
    sources: list[Path], other: tuple[Path, dict[str, Any]] | None, folder: Path, cache: ResultCache,
    executor: Executor, on_activity: Callable[[str], None],
) -> Answer:  # fmt: skip
    """Learn a table from its shots, measure it, and write its certificate.

    Args:
        sources: Run folders and track folders.
        other: File and content of an earlier certificate to compare with; None for none.
        folder: Folder of certificate.json and certificate.html; created if it does not exist.
        cache: Holds the fits of shots.
        executor: Distributes the learning over processes.
        on_activity: Called with what is done next.

    Returns:
        The numbers of the table.

    Raises:
        OptionError: No source can be read, or the tables differ.
        TrackError: The shots are too few.
    """
    fitted = fit_table_of_shots(sources, cache, executor, on_activity)
    used = list(fitted.sources)
    measured = measure_table(fitted.lesson, list(fitted.fits), fitted.table)
    document = describe_certificate(
        fitted.table, measured, _measure_shape(used), fitted.shot_count, fitted.refusals,
        _count_potted(used),
    )  # fmt: skip
    tracks = tuple(one for _, one in fitted.fits)
    certified = CertifiedTable(
        document, fitted.sources, fitted.table, tracks, fitted.lesson.table.cushion_law, measured
    )
    rows: tuple[NumberComparison, ...] = ()
    name = ""
    if other is not None:
        rows = compare_certificates(other[1], document)
        name = other[0].stem if other[0].suffix == ".json" else other[0].name
        document["compared_with"] = {"certificate": str(other[0]), "numbers": describe_comparison(rows)}
    write_json(document, folder / CERTIFICATE_FILE)
    write_certificate_page(certified, name_folders(certified.sources), folder / PAGE_FILE, rows, name)
    numbers = document["numbers"].items()
    notes = (
        f"The openings of the pockets cannot be measured: {document['pocket_openings']['why']}.",
        *(f"Note: {refusal}." for refusal in document["refused"]),
        format_comparison(rows, name) if rows else "",
    )
    return Answer(
        "What are the numbers of this table?",
        tuple(filter(None, (format_certificate(document), format_too_few(document)))),
        quantities=tuple(
            Quantity(key, one["value"], one["sigma"], one["unit"]) for key, one in numbers if one["value"] is not None
        ),
        rows=(("quantity", "value", "±", "unit"), *((NAMES[key], *format_number(key, one)) for key, one in numbers)),
        notes=tuple(filter(None, notes)),
        document=document,
        figures=(str(folder / PAGE_FILE),),
    )


def _measure_shape(sources: list[Path]) -> tuple[TableMeasurement, ...]:
    """Measure angle and aspect in the view that tells most; views of one camera share their errors."""
    shapes: list[ShapeEstimate] = []
    for file in list_files_beside(sources, "scene.json"):
        camera = parse_camera(read_scene_document(file))
        if camera is not None:
            shapes.append(
                estimate_shape(camera.corners_px, camera.corner_covariance, camera.width_px, camera.height_px)
            )
    if not shapes:
        return ()
    best = min(shapes, key=lambda one: one.angle_sigma)
    return (
        TableMeasurement("angle", best.angle, best.angle_sigma, "degrees", len(shapes)),
        TableMeasurement("aspect", best.aspect, best.aspect_sigma, "", len(shapes)),
    )


def _count_potted(sources: list[Path]) -> int:
    """Count the pocket events of run folders that more probably happened than not."""
    tables = (read_csv_columns(file, ("kind", "probability")) for file in list_files_beside(sources, "events.csv"))
    return sum(int(np.sum((events["kind"] == "pocket") & (events["probability"] >= 0.5))) for events in tables)
