"""The recording of a run: the layers of clip, plan, plots, events and text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from models.core.detections import Detections
from models.core.fit_result import Fit, is_undecided
from models.core.number_format import format_measured, format_unit
from models.core.scene import Scene, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from pipeline.engine.atomic_write import replace_file
from pipeline.reporting.figures.motion_samples import kinetic_energy
from pipeline.reporting.recording.recorded_shot import (
    FRAME,
    VIDEO_TIME,
    RecordedShot,
    build_blueprint,
    build_recorded_shot,
    build_time_columns,
    finish_stream,
    log_detections,
    log_paths,
    log_tracks,
    log_video,
    open_stream,
)
from pipeline.reporting.text.call_sentences import format_gap
from pipeline.reporting.text.check_sentences import format_event_probability
from pipeline.reporting.text.fit_sentences import format_whole_shot
from pipeline.reporting.text.text_formatting import format_event, format_event_time, format_textbook_range
from video.drawing.palette import lighten_for_text
from video.io.clip import Clip

# s for which a caption is shown below the plan.
CAPTION_SECONDS = 0.8
# Distance of captions from the table, ball radii.
CAPTION_OFFSET_RADII = 3.0
MARK_COLOUR = (255, 200, 40)


def log_events(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log all events in `log/events`, and a mark for each event except rests in `picture/events` and `plan/events`."""
    events = shot.fit.events
    if len(events):
        words = [
            f"{format_event_time(events, k)}: {format_event(events, k, shot.fit.naming)}" for k in range(len(events))
        ]
        columns = rr.TextLog.columns(text=words, level=["INFO"] * len(words))
        stream.send_columns("log/events", build_time_columns(events.t, shot.clip), columns)
    marked = [k for k in range(len(events)) if events.kind[k] != "rest"]
    for k in marked:
        _log_mark(stream, shot, k)
    if marked:
        _log_captions(stream, shot, marked)


def format_mark(fit: Fit, k: int) -> str:
    """Format time, sentence, how nearly balls missed each other, and the probability of an undecided event."""
    events = fit.events
    parts = [format_event_time(events, k), format_event(events, k, fit.naming)]
    if events.kind[k] == "ball" and np.isfinite(events.gap[k]):
        parts.append(format_gap(events.gap[k], events.gap_sigma[k]))
    if is_undecided(events.probability[k]):
        parts.append(format_event_probability(events, k, fit.explanation, fit.naming))
    return " · ".join(parts)


def _log_mark(stream: rr.RecordingStream, shot: RecordedShot, k: int) -> None:
    """Log a mark that is shown from the event on; if the camera moves, it follows the table."""
    events, shown = shot.fit.events, shot.clip.t
    for view in ("plan", "picture"):
        entity = f"{view}/events/{k:02d}-{events.kind[k]}"
        look = {
            "colors": MARK_COLOUR,
            "radii": rr.Radius.ui_points(4),
            "labels": [format_mark(shot.fit, k)],
            "show_labels": False,
        }
        stream.log(entity, rr.Points2D.from_fields(**look), static=True)
        drifts = view == "picture" and shot.scene.camera.motion is not None
        t = np.concatenate([events.t[[k]], shown[shown > events.t[k]] if drifts else np.empty(0)])
        at = np.repeat(events.xy[[k]], len(t), axis=0)
        if view == "picture":
            at = shot.scene.camera.to_pixels(at, shot.scene.table.ball_radius, shot.clip.frames_shown_at(t))
        stream.send_columns(entity, build_time_columns(t, shot.clip), rr.Points2D.columns(positions=at))


def _log_captions(stream: rr.RecordingStream, shot: RecordedShot, marked: list[int]) -> None:
    """Log captions of recent events below the plan."""
    events, last = shot.fit.events, float(shot.clip.t[-1])
    table = shot.scene.table
    place = rr.Points2D(
        [[table.length / 2, table.width + CAPTION_OFFSET_RADII * table.ball_radius]], radii=0.0, colors=MARK_COLOUR
    )
    for k, following in zip(marked, [*events.t[marked[1:]], np.inf], strict=True):
        stream.set_time(VIDEO_TIME, duration=float(events.t[k]))
        stream.set_time(FRAME, sequence=int(shot.clip.frames_shown_at(events.t[[k]])[0]))
        stream.log("plan/caption", place, rr.Points2D.from_fields(labels=[format_mark(shot.fit, k)], show_labels=True))
        end = min(float(events.t[k]) + CAPTION_SECONDS, last)
        if end < following:
            stream.set_time(VIDEO_TIME, duration=end)
            stream.set_time(FRAME, sequence=int(shot.clip.frames_shown_at(np.array([end]))[0]))
            stream.log("plan/caption", rr.Clear(recursive=False))
    stream.reset_time()


# Colour of the sum over all balls.
ALL_BALLS_COLOUR = (120, 170, 255)


def log_plots(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log `plots/speed` (m/s), `plots/energy` (mJ, also the sum of all balls) and `plots/residual` (mm)."""
    speed = np.linalg.norm(shot.state.v, axis=-1)
    energy = 1000 * kinetic_energy(shot.state, shot.scene.table)
    residual = 1000 * np.linalg.norm(shot.fit.residual, axis=-1)
    for k in np.flatnonzero(shot.is_moving):
        ball, name, colour = shot.ids[k], shot.tracks.looks[k].name, tuple(int(part) for part in shot.plan_colours[k])
        _log_line(stream, shot, f"plots/speed/{ball}", name, colour, shot.t, speed[:, k])
        _log_line(stream, shot, f"plots/energy/{ball}", name, colour, shot.t, energy[:, k])
        left = np.where(shot.fit.moving[:, k], residual[:, k], np.nan)
        _log_line(stream, shot, f"plots/residual/{ball}", name, colour, shot.tracks.t, left)
    if shot.is_moving.sum() > 1:
        whole = np.nansum(energy[:, shot.is_moving], axis=1)
        _log_line(stream, shot, "plots/energy/all", "all balls", ALL_BALLS_COLOUR, shot.t, whole)


def _log_line(
    stream: rr.RecordingStream,
    shot: RecordedShot,
    entity: str,
    name: str,
    colour: tuple[int, ...],
    t: FloatArray,
    values: FloatArray,
) -> None:
    stream.log(entity, rr.SeriesLines(colors=colour, names=name, widths=1.5), static=True)
    finite = np.isfinite(values)
    if finite.any():
        stream.send_columns(
            entity, build_time_columns(t[finite], shot.clip), rr.Scalars.columns(scalars=values[finite])
        )


# Level of rerun's text log, and a sentence.
LogLine = tuple[str, str]


def log_stage_lines(stream: rr.RecordingStream, clip: Clip, stage: str, lines: list[LogLine]) -> None:
    """Log lines of a stage in `log/chain` at the first frame."""
    if lines:
        levels, texts = zip(*lines, strict=True)
        columns = rr.TextLog.columns(text=[f"{stage}: {text}" for text in texts], level=list(levels))
        stream.send_columns(f"log/chain/{stage}", build_time_columns(np.full(len(lines), clip.t[0]), clip), columns)


def describe_stages(
    clip: Clip, scene: Scene, detections: Detections, tracks: Tracks, fit: Fit
) -> dict[str, list[LogLine]]:
    """Describe the result of every stage: faults, assumptions, numbers, noise and trust."""
    counted = f"{clip.frame_count} frames, {len(clip.distinct_frames)} distinct, {float(clip.fps):.3f} fps"
    ball_line = ("WARN", "no ball was detected")
    if len(detections):
        count = f"{len(detections)} detections in {len(np.unique(detections.frame))} frames"
        ball_line = ("INFO", f"{count}, median position sigma {float(np.median(detections.sigma)):.2f} px")
    shares = zip(tracks.looks, tracks.is_observed.mean(axis=0), strict=True)
    level = {"green": "INFO", "amber": "WARN", "red": "ERROR"}[fit.trust.level]
    quality = f"noise {1000 * fit.noise:.2f} mm, chi2 per degree of freedom {fit.chi2_per_dof:.2f}"
    return {
        "read": [("INFO", f"{counted}, {clip.width} x {clip.height}"), *(("WARN", note) for note in clip.notes)],
        "calibrate": [("WARN" if note in scene.warnings else "INFO", note) for note in scene.notes],
        "detect": [ball_line],
        "track": [("INFO", f"{look.name} observed in {100 * share:.0f} % of the frames") for look, share in shares],
        "fit": [
            ("INFO", quality), *(("INFO", one) for one in [format_whole_shot(fit)] if one),
            *((level, f"trust {fit.trust.level}: {reason}") for reason in fit.trust.reasons),
        ],
    }  # fmt: skip


def format_about(shot: RecordedShot) -> str:
    """Format trust level, parameters and the legend of the plan as Markdown."""
    trust = shot.fit.trust
    lines = [f"# Trust: {trust.level}", *(f"- {reason}" for reason in trust.reasons), "", "## Fitted"]
    lines += ["| parameter | value | sigma | unit | textbook range |", "|---|---|---|---|---|"]
    for p in shot.fit.parameters:
        value, sigma = format_measured(p.value, p.sigma)
        unit, source = format_unit(p.unit), " (prior)" if p.prior_only else ""
        lines.append(f"| {p.name} | {value} | {sigma}{source} | {unit} | {format_textbook_range(p.name)} |")
    lines += ["", f"Noise {1000 * shot.fit.noise:.2f} mm, chi2 per degree of freedom {shot.fit.chi2_per_dof:.2f}."]
    lines += [
        "",
        "## Legend of the plan",
        f"- pink arrows: measured minus fitted, {residual_magnification(shot):g} times as long",
    ]
    lines += ["- faint line: whole path; bright line: path up to the current time"]
    return "\n".join([*lines, "", "## Table", *(f"- {note}" for note in shot.scene.notes)])


# Radius of a drawn pocket, ball radii.
POCKET_RADII = 1.6
# Drawn length of the median residual, ball radii.
ARROW_RADII = 1.0
# Drawing order of arrows: above the balls.
ARROW_DRAW_ORDER = 50.0


def log_table(stream: rr.RecordingStream, table: Table) -> None:
    """Log cushion noses and pockets."""
    outline = np.vstack([table.corners, table.corners[:1]])
    stream.log("plan/table", rr.LineStrips2D([outline], colors=[120, 160, 140], radii=0.006), static=True)
    if len(table.pocket_centres):
        holes = rr.Points2D(table.pocket_centres, radii=POCKET_RADII * table.ball_radius, colors=[60, 60, 60])
        stream.log("plan/pockets", holes, static=True)


def log_fitted_balls(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the fitted position of each ball as a disc of its size."""
    places = shot.fit.trajectory.at(shot.clip.t).xy
    for k, ball in enumerate(shot.ids):
        there = np.isfinite(places[:, k, 0])
        if there.any():
            points = rr.Points2D.columns(positions=places[there, k]).partition(there.astype(np.int64))
            stream.send_columns(f"plan/balls/{ball}", build_time_columns(shot.clip.t, shot.clip), points)
        look = {
            "colors": shot.frame_colours[k],
            "radii": shot.scene.table.ball_radius,
            "labels": [shot.tracks.looks[k].name],
            "show_labels": False,
        }
        stream.log(f"plan/balls/{ball}", rr.Points2D.from_fields(**look), static=True)


def log_residuals(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log the residuals of moving balls as magnified arrows from the fitted to the measured position."""
    tracks, fit = shot.tracks, shot.fit
    factor = residual_magnification(shot)
    fitted = fit.trajectory.at(tracks.t).xy
    for k in np.flatnonzero(shot.is_moving):
        is_drawn = np.isfinite(fit.residual[:, k, 0]) & np.isfinite(fitted[:, k, 0]) & fit.moving[:, k]
        entity = f"plan/residuals/{shot.ids[k]}"
        if not is_drawn.any():
            continue
        arrows = rr.Arrows2D.columns(origins=fitted[is_drawn, k], vectors=factor * fit.residual[is_drawn, k])
        stream.send_columns(
            entity, build_time_columns(tracks.t, shot.clip), arrows.partition(is_drawn.astype(np.int64))
        )
        look = {"colors": [255, 96, 160], "radii": rr.Radius.ui_points(1.0), "draw_order": ARROW_DRAW_ORDER}
        stream.log(entity, rr.Arrows2D.from_fields(**look), static=True)


def residual_magnification(shot: RecordedShot) -> float:
    """Compute the magnification of drawn residuals: 1, 2 or 5 times a power of ten, at least 1."""
    sizes = np.linalg.norm(shot.fit.residual[shot.fit.moving], axis=-1)
    usual = float(np.median(sizes[np.isfinite(sizes)])) if np.isfinite(sizes).any() else 0.0
    if not usual > 0:
        return 1.0
    wanted = max(ARROW_RADII * shot.scene.table.ball_radius / usual, 1.0)
    step = 10.0 ** np.floor(np.log10(wanted))
    return float(step * max(n for n in (1, 2, 5) if n * step <= wanted * (1 + 1e-12)))


def write_recording(
    clip: Clip,
    scene: Scene,
    detections: Detections,
    tracks: Tracks,
    fit: Fit,
    path: Path,
    title: str,
) -> None:
    """Write the recording of a run, with a blueprint; its timelines are seconds and frames of the source clip.

    Entities: `picture/` in px, `plan/` in m, `plots/` (speed m/s, energy mJ, residual mm), `log/`, `parameters/`
    and `about`; docs/reference/file-formats.md lists them.

    Args:
        scene: Table and camera.
        detections: K detections.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        path: File to write (.rrd).
        title: Name of the recording in the viewer.
    """
    stream = open_stream(clip.digest, title)
    with replace_file(path) as fresh:
        stream.save(fresh, default_blueprint=build_blueprint(clip, scene.table))
        log_video(stream, clip, path.parent)
        log_table(stream, scene.table)
        log_detections(stream, clip, detections)
        colours = [lighten_for_text(look.colour) for look in tracks.looks]
        log_tracks(stream, clip, tracks, np.array(colours, dtype=np.uint8).reshape(-1, 3))
        shot = build_recorded_shot(clip, scene, tracks, fit)
        for log in (log_paths, log_fitted_balls, log_residuals, log_plots, log_events):
            log(stream, shot)
        for p in (*fit.parameters, *(fit.whole_shot.parameters if fit.whole_shot is not None else ())):
            facts = rr.AnyValues(value=p.value, sigma=p.sigma, unit=p.unit, prior_only=p.prior_only)
            stream.log(f"parameters/{p.name}", facts, static=True)
        about = rr.TextDocument(format_about(shot), media_type=rr.MediaType.MARKDOWN)
        stream.log("about", about, static=True)
        for stage, lines in describe_stages(clip, scene, detections, tracks, fit).items():
            log_stage_lines(stream, clip, stage, lines)
        finish_stream(stream, path)
