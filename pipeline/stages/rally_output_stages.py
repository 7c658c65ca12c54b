"""The stages of the files of a rally: the same files as of a billiards shot, under the same names of stages."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from models.core.corrections import Corrections
from models.core.progress import Progress
from models.core.rally import Rally
from pipeline.engine.stage import Inputs, Stage
from pipeline.io.rally_files import write_rally_files
from pipeline.io.saved_shot import write_shot
from pipeline.stages.render_stage import SLOW_FILE, START_FILE
from video.io.video_options import RenderOptions


@dataclass(frozen=True, slots=True)
class RallyPageOptions:
    """Options of the page and of the recording of a rally."""

    title: str
    """Name of the clip."""
    slow: float
    """Slow-down factor of the slow motion."""
    settings: tuple[str, ...]
    """Options of the command line that reproduce the run."""


def rally_output_stages(
    options: RallyPageOptions, render: RenderOptions, corrections: Corrections
) -> tuple[Stage, ...]:
    """Build the stages that write the files of a rally.

    Args:
        options: Options of the page and of the recording.
        render: Options of the slow motion.
        corrections: What a person corrected, which scene.json states.

    Returns:
        The stages `export`, `poster`, `report`, `record`, and `render` where a slow motion is wanted.
    """
    own, needs = RenderOptions(slow=render.slow, trim_still=render.trim_still), ("read", "rally")
    record = RallyPageOptions(options.title, 1.0, ())  # the others do not change it
    stages = (
        Stage("export", __name__, needs, None, _export_rally, corrections),
        Stage("poster", __name__, needs, None, _draw_poster, own),
        Stage("report", __name__, (*needs, "poster"), None, _write_report, options),
        Stage("record", __name__, (*needs, "candidates"), None, _record_layers, record),
    )
    return stages if render.no_video else (*stages, Stage("render", __name__, needs, None, _render_video, render))


def _export_rally(inputs: Inputs, options: Corrections, folder: Path, progress: Progress) -> None:
    """Write the saved rally, and its exports."""
    rally: Rally = inputs["rally"]
    write_shot(rally, {}, version("trueroll"), folder)
    write_rally_files(inputs["read"], rally, folder, options)


def _draw_poster(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Draw the poster, and note when the slow motion begins."""
    from pipeline.io.image_file import write_image
    from video.overlay.rally_poster import draw_rally_poster
    from video.overlay.rally_slow_motion import find_rally_times  # slow to import

    clip, rally = inputs["read"], inputs["rally"]
    write_image(draw_rally_poster(clip, rally, options), folder / "poster.png")
    start = float(find_rally_times(clip, rally, options)[0])
    (folder / START_FILE).write_text(json.dumps(start), encoding="utf-8")


def _write_report(inputs: Inputs, options: RallyPageOptions, folder: Path, progress: Progress) -> None:
    """Write report.html, which plays the slow motion that lies beside it, and summary.json."""
    from pipeline.reporting.pages.rally_report import write_rally_report  # slow to import
    from pipeline.reporting.pages.rally_summary import write_rally_summary
    from pipeline.reporting.pages.run_report import ReportFiles

    clip, rally, poster = inputs["read"], inputs["rally"], inputs["poster"] / "poster.png"
    start = float(json.loads((inputs["poster"] / START_FILE).read_text(encoding="utf-8")))
    files = ReportFiles(SLOW_FILE, poster, options.slow, start)
    write_rally_report(clip, rally, files, options.title, options.settings, folder / "report.html")
    write_rally_summary(clip, rally, files, folder)


def _record_layers(inputs: Inputs, options: RallyPageOptions, folder: Path, progress: Progress) -> None:
    """Write recording.rrd."""
    os.environ.setdefault("RUST_LOG", "off")  # read at import: rerun would print what it raises
    from pipeline.reporting.recording.rally_recording import write_rally_recording  # slow to import

    clip, rally, path = inputs["read"], inputs["rally"], folder / "recording.rrd"
    write_rally_recording(clip, rally, inputs["candidates"], path, options.title)


def _render_video(inputs: Inputs, options: RenderOptions, folder: Path, progress: Progress) -> None:
    """Render the slow motion."""
    from video.overlay.rally_slow_motion import render_rally  # slow to import

    render_rally(inputs["read"], inputs["rally"], folder / SLOW_FILE, options, progress)
