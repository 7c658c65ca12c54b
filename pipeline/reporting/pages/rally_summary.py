"""summary.json of a rally: what the page of a batch shows of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from models.core.rally import Rally
from models.estimation.rally.landing_judgement import judge_landing
from pipeline.io.strict_json import write_json
from pipeline.reporting.pages.page_template import embed_image_file
from pipeline.reporting.pages.run_report import SUMMARY_FILE, THUMBNAIL_PX, THUMBNAIL_QUALITY, ReportFiles
from pipeline.reporting.text.rally_sentences import assess_rally_trust, format_landing
from pipeline.reporting.text.stroke_sentences import format_point
from pipeline.reporting.text.text_formatting import summarize_trust
from video.io.clip import Clip


def write_rally_summary(clip: Clip, rally: Rally, files: ReportFiles, folder: Path) -> None:
    """Write summary.json.

    Args:
        files: Slow motion and poster.
        folder: An existing folder.
    """
    thumbnail = embed_image_file(files.poster, THUMBNAIL_PX, THUMBNAIL_QUALITY)
    summary = summarize_rally(clip, rally) | {"video": files.times, "thumbnail": thumbnail}
    write_json(summary, folder / SUMMARY_FILE)


def summarize_rally(clip: Clip, rally: Rally) -> dict[str, Any]:
    """Summarize a rally in a few numbers, words and calls, as JSON values."""
    kinds, call = [one.kind for one in rally.events], judge_landing(rally)
    words = format_landing(call, rally)
    return {
        "begins": round(float(clip.t[0]), 3), "ends": round(float(clip.t[-1]), 3), "sport": rally.scene.sport.name,
        "balls": [rally.scene.sport.object.name],
        **{f"{kind}_count": kinds.count(kind) for kind in ("hit", "bounce", "net", "landing")},
        "trust": summarize_trust(assess_rally_trust(rally)),
        "sentences": [format_point(rally, call).headline, words.sentence],
        "calls": [{"topic": "landing", "question": words.question, "answer": words.verdict,
                   "probability": words.probability}],
    }  # fmt: skip
