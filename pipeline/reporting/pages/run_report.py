"""report.html: a run on one self-contained page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import combinations
from pathlib import Path

import numpy as np

from models.core.ball_look import format_colour
from models.core.fit_result import Fit, is_undecided
from models.core.naming import join_names
from models.core.number_format import format_measured, format_probability, format_unit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import CallAnswer
from models.estimation.contact_test.rule_answers import answer_foul, answer_score, find_struck_ball
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.forecast.forecast_values import ForecastErrors
from models.estimation.joint_fit.trust_level import EXPLAINED
from pipeline.engine.atomic_write import write_text
from pipeline.reporting.figures.run_figures import (
    PARAMETER_ROW_PX,
    build_energy_figure,
    build_forecast_figure,
    build_parameter_figure,
    build_plan_figure,
    build_speed_figure,
)
from pipeline.reporting.pages.page_template import (
    build_jpeg_uri,
    embed_figure,
    embed_image_file,
    pack_plotly_source,
    render_template,
)
from pipeline.reporting.text.call_sentences import format_call, format_gap, name_topic
from pipeline.reporting.text.check_list import CheckPlace, select_check_places
from pipeline.reporting.text.check_sentences import format_alternatives, format_check_place, format_least_sure
from pipeline.reporting.text.fit_sentences import HAND_PREFIX, format_whole_shot
from pipeline.reporting.text.number_sentences import list_number_rows
from pipeline.reporting.text.shot_summary import MIN_PROBABILITY, ShotSummary, summarize_shots
from pipeline.reporting.text.text_formatting import (
    format_event,
    format_event_time,
    format_no_events,
    format_parameter_name,
    format_textbook_range,
    summarize_trust,
)
from video.calibration.table_classifier import ALTERNATIVES_PREFIX
from video.io.clip import Clip, read_frames
from video.overlay.close_up import CloseUpFrame, NamedOutline, draw_place

# What the page of a batch shows of a run, beside the report.
SUMMARY_FILE = "summary.json"
# Longest side of the small poster of that page, and JPEG quality: 8 to 15 kB.
THUMBNAIL_PX, THUMBNAIL_QUALITY = 320, 70
# s of the clip before an event, from which the video plays.
LEAD_IN_SECONDS = 0.15
BY_SEGMENT_HEADING = "Every motion and contact fitted by itself"
WHOLE_SHOT_HEADING = "One contact model fitted to the whole shot"
PACKAGES = ("trueroll", "torch", "opencv-python-headless", "onnxruntime", "numpy", "av")
# Largest gap of two balls without contact for which the page answers whether they touched: farther apart, nobody asks
# whether they did.
NEAR_MISS_DIAMETERS = 2.0
# Answers on balls that came near each other.
MAX_NEAR_MISSES = 6
# Limits of good quality: explained share of the motion, noise of a position (px).
MIN_EXPLAINED_SHARE, MAX_NOISE_PX = 0.9, 1.0


@dataclass(frozen=True, slots=True)
class ReportFiles:
    """Files of a run that the page shows."""

    slow: str
    """File name of the slow motion, which the page links to; it may be made later, or be left out."""
    poster: Path
    """Embedded, so already written."""
    slow_factor: float
    start: float = 0.0
    """s of the clip at which the slow motion begins."""

    @property
    def times(self) -> dict[str, float]:
        """When the slow motion shows what, as JSON values of summary.json."""
        return {"start": self.start, "slow": self.slow_factor}


@dataclass(frozen=True, slots=True)
class QualityFlag:
    """One property of a run, good or doubtful."""

    what: str
    value: str
    good: bool


def write_report(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, files: ReportFiles, title: str, settings: Sequence[str],
    path: Path, errors: ForecastErrors | None = None,
) -> None:  # fmt: skip
    """Write the page of a run, and beside it what the page of a batch shows of it.

    Args:
        scene: Table and camera.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        files: Slow motion and poster.
        title: Heading of the page.
        settings: Options that reproduce the run.
        path: File to write.
        errors: Comparison of the rest of the shot with its prediction, if there is one.
    """
    by_hand = [note for note in scene.notes if note.startswith(HAND_PREFIX)]
    places = select_check_places(tracks, fit, scene.table)
    calls = answer_standard_questions(
        make_shot_record(tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
    )
    probable = zip(fit.events.kind, fit.events.probability, strict=True)
    likely = [kind for kind, p in probable if p >= MIN_PROBABILITY]
    is_guess = any(doubt.startswith(ALTERNATIVES_PREFIX) for doubt in scene.warnings)
    doubts = ["Lengths and speeds hold for the guessed table size (see above)."] if is_guess else []
    summaries = summarize_shots(tracks, fit, scene.table, doubts, calls)
    shot_numbers = [(one.t, list_number_rows(one, fit.naming, scene.table.ball_radius)) for one in fit.shot_numbers]
    finite = [p for p in fit.parameters if np.isfinite(p.sigma)]
    height = 50 + PARAMETER_ROW_PX * len(finite)
    html = render_template(
        "report.html",
        name=title,
        trust=fit.trust,
        summaries=summaries,
        balls=[(look.name, format_colour(look.colour)) for look in tracks.looks],
        stripes=any(look.is_striped for look in tracks.looks),
        poster=embed_image_file(files.poster),
        video=files.slow,
        slow=files.slow_factor,
        start=files.start,
        events=build_event_rows(fit, files, scene.table.ball_radius),
        no_events=format_no_events(fit),
        counts=[likely.count(kind) for kind in ("ball", "cushion", "pocket")],
        least_sure=format_least_sure(fit.events, range(len(fit.events)), fit.explanation, fit.naming),
        checks=_list_checks(clip, scene, tracks, fit, places, files),
        plan=embed_figure(build_plan_figure(scene, fit, tracks.looks), "plan", 440),
        speeds=embed_figure(build_speed_figure(scene, fit, tracks.looks), "speeds", 330),
        energies=embed_figure(build_energy_figure(scene, fit, tracks.looks), "energies", 330),
        calls=[format_call(call, fit.naming) for call in calls],
        shot_numbers=shot_numbers,
        terms=" ".join(f"{what} {value}" for _, rows in shot_numbers for what, _, value, _ in rows),
        prior_only=any(p.prior_only for p in fit.parameters),
        rail=fit.naming.rail_word,
        near_diameters=f"{NEAR_MISS_DIAMETERS:g}",
        near_count=MAX_NEAR_MISSES,
        plotly=pack_plotly_source(),
        parameter_plot="" if not finite else embed_figure(build_parameter_figure(finite), "parameters", height),
        parameters=_list_parameters(fit),
        whole_shot=format_whole_shot(fit),
        forecast_plot=""
        if errors is None or not len(errors.error)
        else embed_figure(build_forecast_figure(errors, fit.naming), "forecast", 330),
        forecast_time=None if errors is None else errors.t,
        flags=assess_quality(clip, scene, fit),
        notes=[
            note
            for note in dict.fromkeys([*fit.profile_misfits, *scene.notes, *clip.notes])
            if note not in (*by_hand, *fit.trust.reasons)
        ],
        by_hand=[note.removeprefix(HAND_PREFIX) for note in by_hand],
        settings=list(settings),
        versions={name: version(name) for name in PACKAGES},
        digest=clip.digest,
    )
    write_text(path, html)
    thumbnail = embed_image_file(files.poster, THUMBNAIL_PX, THUMBNAIL_QUALITY)
    summary = describe_run(clip, tracks, fit, calls, summaries) | {"video": files.times, "thumbnail": thumbnail}
    write_text(path.with_name(SUMMARY_FILE), json.dumps(summary, indent=1, allow_nan=False))


def describe_run(
    clip: Clip, tracks: Tracks, fit: Fit, calls: Sequence[CallAnswer], summaries: Sequence[ShotSummary]
) -> dict[str, object]:
    """Describe a run in a few numbers, words and calls, as JSON values."""
    counts = {f"{kind}_count": fit.events.kind.count(kind) for kind in ("strike", "ball", "cushion", "pocket")}
    words = [(name_topic(call, fit.naming), format_call(call, fit.naming)) for call in calls]
    return {
        "begins": round(float(clip.t[0]), 3), "ends": round(float(clip.t[-1]), 3),
        "balls": [look.name for look in tracks.looks], **counts, "trust": summarize_trust(fit.trust),
        "sentences": [" ".join(filter(None, (one.score, one.first, one.potted))) for one in summaries],
        "calls": [
            {"topic": topic, "question": one.question, "answer": one.verdict, "probability": one.probability}
            for topic, one in words
        ],
    }  # fmt: skip


def _list_parameters(fit: Fit) -> list[tuple[str, list[tuple[str, str, str, str, str, str, str]]]]:
    """List the fitted parameters as table rows, under one heading for each of the two fits."""
    whole = () if fit.whole_shot is None else fit.whole_shot.parameters
    groups = ((BY_SEGMENT_HEADING, fit.parameters), (WHOLE_SHOT_HEADING, whole))
    return [
        (heading, [
            (p.name, format_parameter_name(p.name), *format_measured(p.value, p.sigma), format_unit(p.unit),
             format_textbook_range(p.name), "prior only" if p.prior_only else "this clip")
            for p in parameters
        ])
        for heading, parameters in groups if parameters
    ]  # fmt: skip


def build_event_rows(
    fit: Fit, files: ReportFiles, radius: float = np.nan
) -> list[dict[str, str | float | bool]]:  # fmt: skip
    """Build the rows of the event list for balls of a radius (m); each seeks the video to shortly before its event."""
    events, naming = fit.events, fit.naming
    rows: list[dict[str, str | float | bool]] = []
    for k in range(len(events)):
        alternatives = format_alternatives(events, k, fit.explanation, naming)
        rows.append(
            {
                "seek": find_seek_time(float(events.t[k]), files),
                "at": round(max(float(events.t[k]) - files.start, 0.0) * files.slow_factor, 3),
                "time": format_event_time(events, k),
                "sentence": format_event(events, k, naming),
                "gap": format_gap(events.gap[k], events.gap_sigma[k]) if events.kind[k] == "ball" else "",
                "probability": format_probability(events.probability[k]),
                "undecided": bool(alternatives) and is_undecided(events.probability[k]),
                "alternatives": alternatives,
            }
        )
    return rows


def find_seek_time(t: float, files: ReportFiles) -> float:
    """Return the time of the video, s, shortly before t (s of the clip)."""
    return round(max(t - LEAD_IN_SECONDS - files.start, 0.0) * files.slow_factor, 3)


def answer_standard_questions(record: ShotRecord) -> list[CallAnswer]:
    """Answer standard questions: first contact of each struck ball, pockets, a carom, fouls, and near misses."""
    rows = zip(record.events.kind, record.events.a, record.events.b, strict=True)
    events = [row for row in rows if row[1] in record.ids]
    struck = dict.fromkeys(a for kind, a, _ in events if kind == "strike") or [find_struck_ball(record)]
    calls = [call_answers.answer_first_contact(record, a) for a in struck if a]
    calls += [call_answers.answer_cushion_first(record, a) for a in struck if a]
    calls += [call_answers.answer_pocket(record, a, pocket) for kind, a, pocket in events if kind == "pocket"]
    return calls + _answer_rules(record) + _answer_near_misses(record)


def _answer_rules(record: ShotRecord) -> list[CallAnswer]:
    """Answer whether a carom scored, and what of a foul the clip certainly shows; nothing where that makes no sense."""
    cue, is_carom = find_struck_ball(record), record.table.game == "carom"
    if not cue or (len(record.ids) != 3 if is_carom else len(record.ids) < 2):
        return []
    if is_carom:
        score = answer_score(record, cue)
        return [score, *score.parts[2:]]
    return [part for part in answer_foul(record, cue).parts if part.verdict == "yes"]


def _answer_near_misses(record: ShotRecord) -> list[CallAnswer]:
    """Answer whether balls touched that came near each other without a contact, the nearest pairs first."""
    events, radius = record.events, record.table.ball_radius
    touching = {frozenset((events.a[k], events.b[k])) for k in range(len(events)) if events.kind[k] == "ball"}
    near = []
    travels = np.nansum(np.abs(np.diff(record.path, axis=0)), axis=(0, 2))
    for a, b in combinations(np.argsort(-travels, kind="stable").tolist(), 2):  # a ball on its way misses a resting one
        gaps, pair = record.gaps(a, b), (record.ids[a], record.ids[b])
        gaps = gaps[np.isfinite(gaps)]
        is_near = len(gaps) and gaps.min() < 2 * NEAR_MISS_DIAMETERS * radius and gaps[0] - gaps.min() > radius
        if is_near and frozenset(pair) not in touching:
            near.append((float(gaps.min()), pair))
    pairs = [pair for _, pair in sorted(near)[:MAX_NEAR_MISSES]]
    return [call_answers.answer_contact(record, a, b) for a, b in pairs]


def assess_quality(clip: Clip, scene: Scene, fit: Fit) -> list[QualityFlag]:
    """Assess the properties that the trust level depends on, and others, as good or doubtful."""
    moving, explained_count = int(fit.moving.sum()), int((fit.moving & fit.accepted).sum())
    share = explained_count / moving if moving else 1.0
    centre, is_regular = scene.table.corners.mean(axis=0), fit.trajectory.clock is None
    scale = float(np.sqrt(abs(np.linalg.det(scene.camera.metres_per_pixel(centre, scene.table.ball_radius)))))
    steps = np.diff(clip.t)
    rate = f"{float(clip.fps):.3f} fps"
    if len(steps) and np.ptp(steps) > steps.mean() / 2:  # a time base rounds steps by less
        rate = f"variable, {1 / steps.mean():.3f} a second on average"
    frames = f"{len(clip.distinct_frames)} distinct of {clip.frame_count}, {rate}"
    explained = f"{100 * share:.0f} % of their time" if moving else "no ball moves"
    noise = f"{1000 * fit.noise:.2f} mm ({fit.noise / scale:.2f} px)"
    table = f"{scene.table.name}, {scene.table.length:g} x {scene.table.width:g} m"
    low, high = fit.chi2_range
    chi2 = f"{fit.chi2_per_dof:.2f} ({low:.2f} to {high:.2f} agree with the noise)"
    doubts = [one for one in fit.trust.reasons if not one.startswith(EXPLAINED) and one not in scene.warnings]
    return [
        QualityFlag("Clip", "complete" if not clip.notes else " ".join(clip.notes), not clip.notes),
        QualityFlag("Frames", frames, True),
        QualityFlag("Table", table, not scene.warnings),
        QualityFlag("Camera", "moves" if scene.camera.motion is not None else "static", scene.camera.motion is None),
        QualityFlag("Moving balls explained by physics", explained, share >= MIN_EXPLAINED_SHARE),
        QualityFlag("Noise of a measured position", noise, fit.noise / scale <= MAX_NOISE_PX),
        QualityFlag("Chi-square per degree of freedom", chi2, low <= fit.chi2_per_dof <= high),
        QualityFlag(
            "Capture times",
            "as the file states them" if is_regular else "estimated, not as the file states them",
            is_regular,
        ),
        *(QualityFlag("Doubt", doubt, False) for doubt in doubts if fit.trust.level != "green"),
    ]


# Balls of a place that are outlined.
MAX_OUTLINES = 3
# Radius of a ball without any.
DEFAULT_RADIUS_PX = 10.0
# Reasons whose moment lies between frames, so that the balls are also outlined there.
DATED_CODES = ("undecided", "unexplained")


def _list_checks(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, places: Sequence[CheckPlace], files: ReportFiles
) -> list[dict[str, str | float]]:
    """List the places to check with their close-ups; each seeks the video to shortly before it."""
    frames = sorted({place.frame for place in places})
    images = dict(read_frames(clip, indices=frames)) if frames else {}
    return [
        {
            "frame": place.frame, "t": place.t, "uncertainty": format_probability(place.uncertainty),
            "sentence": format_check_place(place, fit.naming), "seek": find_seek_time(place.t, files),
            "image": _embed_close_up(scene, tracks, fit, place, images[place.frame]),
            "alt": f"close-up of {join_names(map(fit.naming.say, place.balls[:MAX_OUTLINES]))} in frame {place.frame}",
        }
        for place in places
    ]  # fmt: skip


def _embed_close_up(scene: Scene, tracks: Tracks, fit: Fit, place: CheckPlace, image: ImageArray) -> str:
    """Draw the close-up of a place and embed it; empty if the place is unknown."""
    if not np.isfinite(place.xy).all():
        return ""
    t = float(tracks.t[np.searchsorted(tracks.frame, place.frame)])
    is_dated = place.reasons[0].code in DATED_CODES
    view = CloseUpFrame(
        image, place.frame, t, _outline_balls(scene, tracks, fit, place, t),
        _outline_balls(scene, tracks, fit, place, place.t) if is_dated else (),
    )  # fmt: skip
    centre: FloatArray = scene.camera.to_pixels(place.xy, scene.table.ball_radius, place.frame)
    return build_jpeg_uri(draw_place(view, centre, _find_radius(tracks, place.balls[0], place.t)))


def _outline_balls(scene: Scene, tracks: Tracks, fit: Fit, place: CheckPlace, t: float) -> tuple[NamedOutline, ...]:
    """Outline the balls of a place at their fitted positions at t (s); balls without one are left out."""
    xy = fit.trajectory.at(t).xy
    outlines = []
    for name in place.balls[:MAX_OUTLINES]:
        at = xy[fit.trajectory.ids.index(name)]
        if np.isfinite(at).all():
            centre = scene.camera.to_pixels(at, scene.table.ball_radius, place.frame)
            outlines.append(NamedOutline(fit.naming.name_ball(name), centre, _find_radius(tracks, name, t)))
    return tuple(outlines)


def _find_radius(tracks: Tracks, ball: str, t: float) -> float:
    """Return the radius of a ball, px, in the nearest frame to t (s) in which it was detected."""
    radii = tracks.radius_px[:, tracks.ids.index(ball)]
    rows = np.flatnonzero(np.isfinite(radii))
    return float(radii[rows[np.argmin(np.abs(tracks.t[rows] - t))]]) if len(rows) else DEFAULT_RADIUS_PX
