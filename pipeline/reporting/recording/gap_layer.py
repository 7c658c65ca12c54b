"""gap.rrd: where predictions of the user's simulator go wrong, for the viewer; a layer over a run, or by itself."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from diagnosis.verdicts.verdict import Gap, Report
from models.core.errors import OptionError
from models.core.typing import FloatArray
from pipeline.engine.atomic_write import aside
from pipeline.io.run_folder import read_scene
from pipeline.reporting.recording.recording_stream import VIDEO_TIME, finish, open_stream
from pipeline.reporting.text.gap_sentences import causes, closed_sentence, gap_sentence
from video.drawing.palette import Colour, mix

BEFORE, AFTER = (230, 80, 70), (70, 190, 130)
MILD, BAD = (255, 225, 130), (200, 20, 40)
"""Colours of no miss and of the largest."""
LARGE = 0.95
"""Share of the misses that are smaller than one that is drawn as the largest."""


@dataclass(frozen=True, slots=True)
class Missed:
    """K held-out sightings of one window, with what was predicted for them."""

    shot: int
    t: FloatArray
    """(K,) s"""
    since: FloatArray
    """(K,) s since the prediction began."""
    seen: FloatArray
    """(K, 2) as drawn, the second axis down: the first and the last coordinate, or time and the only one."""
    before: FloatArray
    """(K, 2)"""
    after: FloatArray
    """(K, 2)"""
    miss_before: FloatArray
    """(K,) m or rad."""
    miss_after: FloatArray
    """(K,)"""


def write_gap_recording(report: Report, inputs: Sequence[Path], path: Path) -> None:
    """Write the layers of a diagnosis; of one run's folder they join its recording."""
    digest = clip_of(inputs[0]) if len(inputs) == 1 else None
    joins = digest is not None
    own = hashlib.sha256("\n".join(str(one.resolve()) for one in inputs).encode("utf-8", "replace")).hexdigest()
    stream = open_stream(digest or own, f"gap: {inputs[0].resolve().name}")
    with aside(path) as fresh:
        stream.save(fresh, default_blueprint=None if joins else _blueprint(report))
        _log_misses(stream, missed(report.gap, down=report.scene == "billiards"), report.gap)
        _log_words(stream, report)
        finish(stream, path)


def clip_of(folder: Path) -> str | None:
    """The digest of the clip that a run's folder was made of; None of any other folder."""
    try:
        digest = (read_scene(folder / "scene.json").get("clip") or {}).get("sha256")
    except OptionError:  # a scene of another kind, or none at all: no run of ours
        return None
    return digest if isinstance(digest, str) and (folder / "recording.rrd").is_file() else None


def missed(gap: Gap, *, down: bool) -> list[Missed]:
    """By window: what was held out, and how far predictions miss it.

    The viewer's second axis runs down, as y of a table does; of other scenes it is turned over.
    """
    found = []
    turn = np.array([1.0, 1.0 if down else -1.0])
    for one, before, after in zip(gap.windows, gap.before, gap.after, strict=True):
        seen = one.piece.seen.copy()
        seen[: one.known] = False
        rows, _ = np.nonzero(seen)
        if not len(rows):
            continue
        t = one.piece.t[rows]
        places = [values[seen] for values in (one.piece.places, before, after)]
        drawn = [np.stack([t if part.shape[1] == 1 else part[:, 0], part[:, -1]], axis=1) * turn for part in places]
        misses = [np.linalg.norm(part - places[0], axis=1) for part in places[1:]]
        found.append(Missed(one.piece.shot, t, t - one.piece.t[one.known - 1], *drawn, *misses))
    return found


def _log_misses(stream: rr.RecordingStream, windows: list[Missed], gap: Gap) -> None:
    scale = 1000.0  # mm or mrad
    unit = "mrad" if gap.metric.endswith("rad") else "mm"
    if not windows:
        return
    miss = np.concatenate([one.miss_before for one in windows])
    seen = np.concatenate([one.seen for one in windows])
    worst = max(float(np.quantile(miss, LARGE)), 1e-12)
    colours = [miss_colour(float(value) / worst) for value in miss]
    arrows = np.concatenate([one.before - one.seen for one in windows])
    dots = rr.Points2D(seen, colors=colours, radii=rr.Radius.ui_points(2.5))
    stream.log("plan/gap/places", dots, rr.AnyValues(**{f"miss_{unit}": scale * miss}), static=True)
    drawn = rr.Arrows2D(origins=seen, vectors=arrows, colors=colours, radii=rr.Radius.ui_points(0.6))
    stream.log("plan/gap/misses", drawn, static=True)
    for number, one in enumerate(windows):
        _log_window(stream, f"shot-{one.shot:03d}/{number:03d}", one, scale)


def _log_window(stream: rr.RecordingStream, name: str, one: Missed, scale: float) -> None:
    """Predictions as points that go with the time, and their error over it."""
    moments = np.unique(one.t)
    times = [rr.TimeColumn(VIDEO_TIME, duration=moments)]
    counts = np.array([np.sum(one.t == t) for t in moments])
    order = np.argsort(one.t, kind="stable")
    for what, places, miss, colour in (
        ("before", one.before, one.miss_before, BEFORE),
        ("after", one.after, one.miss_after, AFTER),
    ):
        points = rr.Points2D.columns(positions=places[order]).partition(counts)
        stream.send_columns(f"plan/gap/{what}/{name}", times, points)
        look = rr.Points2D.from_fields(colors=colour, radii=rr.Radius.ui_points(4.0))
        stream.log(f"plan/gap/{what}/{name}", look, static=True)
        rms = np.array([np.sqrt(np.mean(miss[one.t == t] ** 2)) for t in moments])
        entity = f"plots/gap/{what}/{name}"
        stream.log(entity, rr.SeriesLines(colors=colour, names=f"{what}, shot {one.shot}", widths=1.0), static=True)
        stream.send_columns(entity, times, rr.Scalars.columns(scalars=scale * rms))


def miss_colour(share: float) -> Colour:
    """Of a miss, 1 being large."""
    return mix(MILD, BAD, float(np.clip(share, 0.0, 1.0)))


def _log_words(stream: rr.RecordingStream, report: Report) -> None:
    lines = [f"# {gap_sentence(report)}", "", closed_sentence(report), "", report.film_next, ""]
    lines += ["| cause | probability | strength |", "|---|---|---|"]
    lines += [f"| {one.name} | {one.probability:.1%} | {one.strength} |" for one in causes(report)[:8]]
    lines += ["", "Dots and arrows: held-out places, and where predictions put them; red: before, green: after."]
    stream.log("gap", rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN), static=True)
    stream.set_time(VIDEO_TIME, duration=0.0)
    stream.log("log/chain/diagnose", rr.TextLog(f"diagnose: {gap_sentence(report)}", level=rr.TextLogLevel.WARN))
    stream.reset_time()


def _blueprint(report: Report) -> rrb.Blueprint:
    unit = "mrad" if report.gap.metric.endswith("rad") else "mm"
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="plan", name="Where predictions go wrong"),
            rrb.Vertical(
                rrb.TextDocumentView(origin="gap", name="The gap"),
                rrb.TimeSeriesView(
                    origin="plots/gap",
                    name=f"Error of predictions ({unit})",
                    plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
                ),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=VIDEO_TIME, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
