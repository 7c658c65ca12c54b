"""The recording of a rally for the rerun viewer: court, flights and events in space, camera, video and candidates.

Rerun's space is right-handed. Where x, y, z of the court are not, y is drawn with the opposite sign, so that the scene
looks as the clip shows it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn

from models.core.court_camera import CourtCamera, rotation_matrix
from models.core.number_format import format_probability, format_time
from models.core.rally import BallCandidates, Rally
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.rally_views import evaluate_rally
from models.estimation.rally.stroke_summary import Stroke, summarize_strokes
from pipeline.engine.atomic_write import replace_file
from pipeline.io.rally_files import build_rally_clock
from pipeline.reporting.recording.recorded_shot import (
    VIDEO_TIME,
    arrange_panels,
    build_time_columns,
    finish_stream,
    log_video,
    open_stream,
)
from pipeline.reporting.text.rally_sentences import assess_rally_trust, format_rally_event
from pipeline.reporting.text.stroke_sentences import format_point
from video.drawing.court_plan import SIDE_COLOURS, outline_line
from video.io.clip import Clip

# s between points of a flight.
PATH_STEP_S = 0.01
# Colours of the court, of the net, of the object, and of events.
LINE_COLOUR, NET_COLOUR, OBJECT_COLOUR, EVENT_COLOUR = (200, 214, 206), (150, 160, 170), (255, 255, 255), (255, 200, 40)
# Standard deviations of an ellipsoid; the least half axis that is visible, m.
ELLIPSOID_SIGMAS, MIN_HALF_AXIS = 2.0, 0.01
# Size of the object and of events, which would be too small to see in their own.
DOT = rr.Radius.ui_points(4)
# Upright and level lines of the drawn net, and m to which the camera's image is drawn in space.
NET_PARTS, IMAGE_DISTANCE = 24, 3.0


def write_rally_recording(clip: Clip, rally: Rally, candidates: BallCandidates, path: Path, title: str) -> None:
    """Write the recording of a rally, with a blueprint; its timelines are seconds and frames as the clip shows them.

    Entities: `court/` in m (lines, net, flights, events, object), `picture/` in px (video, candidates, used places,
    flights), `plots/` (height m, speed m/s), `log/events` and `about`.

    Args:
        candidates: Where the object may be seen.
        path: File to write (.rrd).
        title: Name of the recording in the viewer.
    """
    stream = open_stream(clip.digest, title)
    strokes, clock = summarize_strokes(rally), build_rally_clock(clip, rally)
    with replace_file(path) as fresh:
        stream.save(fresh, default_blueprint=build_rally_blueprint(clip, rally))
        _log_court(stream, rally)
        log_video(stream, clip, path.parent)
        _log_camera(stream, clip, rally)
        _log_candidates(stream, clip, clock, rally, candidates)
        for stroke in strokes:
            _log_stroke(stream, clip, clock, rally, stroke)
        _log_object(stream, clip, clock, rally)
        _log_rally_events(stream, clip, clock, rally)
        about = rr.TextDocument(_format_about(rally), media_type=rr.MediaType.MARKDOWN)
        stream.log("about", about, static=True)
        finish_stream(stream, path)


def to_viewer(xyz: FloatArray, camera: CourtCamera) -> FloatArray:
    """Map places or directions (..., 3) of the court to the right-handed axes of the viewer."""
    return np.asarray(xyz * [1.0, -1.0 if camera.is_left_handed else 1.0, 1.0])


def build_rally_blueprint(clip: Clip, rally: Rally) -> rrb.Blueprint:
    """Build the layout: the clip and the court in space above, plots and texts below."""
    whole = rrb.VisualBounds2D(x_range=[-0.5, clip.width - 0.5], y_range=[-0.5, clip.height - 0.5])
    middle = to_viewer(np.array([rally.scene.sport.length / 2, rally.scene.sport.width / 2, 0.5]), rally.scene.camera)
    side = 0.9 * rally.scene.sport.length
    eye = rrb.EyeControls3D(
        position=middle + side * np.array([-0.6, -1.0, 0.7]),
        look_target=middle, eye_up=[0, 0, 1],
    )  # fmt: skip
    body = rrb.TextLogColumns(timeline_columns=[], text_log_columns=[TextLogColumn("Body")])
    texts = rrb.Tabs(
        rrb.TextLogView(origin="log/events", name="Events", columns=body),
        rrb.TextDocumentView(origin="about", name="Answer"),
        active_tab=1,
    )
    return arrange_panels(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Spatial2DView(origin="picture", name="Video", contents="picture/**", visual_bounds=whole),
                rrb.Spatial3DView(
                    origin="/", name="Court (m)", contents=["court/**", "picture/video", "picture"], eye_controls=eye
                ),
            ),
            rrb.Horizontal(
                rrb.TimeSeriesView(origin="plots/height", name="Height (m)"),
                rrb.TimeSeriesView(origin="plots/speed", name="Speed (m/s)"),
                texts,
            ),
            row_shares=[5, 2],
        ),
    )


def _log_court(stream: rr.RecordingStream, rally: Rally) -> None:
    """Log lines and net."""
    sport, camera = rally.scene.sport, rally.scene.camera
    stream.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    paint = [np.column_stack([outline_line(one.start, one.end, one.width), np.zeros(4)]) for one in sport.lines]
    strips = [to_viewer(np.vstack([one, one[:1]]), camera) for one in paint]
    look = {"colors": LINE_COLOUR, "radii": rr.Radius.ui_points(0.8)}
    stream.log(
        "court/lines",
        rr.LineStrips3D(strips, **look, labels=[one.name for one in sport.lines], show_labels=False),
        static=True,
    )
    y = np.linspace(-sport.net.overhang, sport.width + sport.net.overhang, NET_PARTS)
    edge = np.column_stack([np.full(NET_PARTS, sport.length / 2), y, sport.net.height_at(y, sport.width)])
    foot = edge * [1.0, 1.0, 0.0]
    threads = [edge, *np.stack([foot, edge], axis=1)]
    net = rr.LineStrips3D(
        [to_viewer(one, camera) for one in threads], colors=NET_COLOUR, radii=rr.Radius.ui_points(0.6)
    )
    stream.log("court/net", net, static=True)


def _log_camera(stream: rr.RecordingStream, clip: Clip, rally: Rally) -> None:
    """Log the camera without its lens; one that turns or zooms, for every frame."""
    camera = rally.scene.camera
    size, place = [camera.width_px, camera.height_px], to_viewer(camera.centre, camera)
    look = {"resolution": size, "camera_xyz": rr.ViewCoordinates.RDF, "image_plane_distance": IMAGE_DISTANCE}
    middle = (np.array(size) - 1) / 2
    focal = float(np.exp(camera.parameters[6]))
    intrinsic = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
    turn = rotation_matrix(camera.parameters[3:6])
    pinhole = rr.Pinhole(image_from_camera=intrinsic, **look)
    stream.log("picture", pinhole, rr.Transform3D(translation=place, mat3x3=turn.T), static=camera.motion is None)
    motions = camera.motion_of(rally.frame)
    if motions is None:
        return
    shown = clip.times_of(rally.frame).tolist()
    for frame, t, motion in zip(rally.frame.tolist(), shown, motions, strict=True):
        own, turned = split_projection(motion @ intrinsic @ turn)
        stream.set_time(VIDEO_TIME, duration=t)
        stream.set_time("frame", sequence=frame)
        pinhole = rr.Pinhole(image_from_camera=own, **look)
        stream.log("picture", pinhole, rr.Transform3D(translation=place, mat3x3=turned.T))
    stream.reset_time()


def split_projection(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split a matrix (3, 3) into an upper triangular camera matrix with positive focal lengths and a rotation."""
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ matrix).T)
    signs = np.sign(np.diag(r))
    upper = flip @ (r.T * signs) @ flip
    return upper / upper[2, 2], flip @ (q * signs).T


def _build_columns(clip: Clip, clock: CaptureClock, t: FloatArray) -> list[rr.TimeColumn]:
    """Build both time columns for times t (K,) s at which something happened: when the clip shows it."""
    return build_time_columns(clock.presentation_time_at(t), clip)


def _log_candidates(
    stream: rr.RecordingStream, clip: Clip, clock: CaptureClock, rally: Rally, candidates: BallCandidates
) -> None:
    """Log the candidates with their scores, and the places to which the flights were fitted."""
    frames, counts = np.unique(candidates.frame, return_counts=True)
    if len(frames):
        points = rr.Points2D.columns(positions=candidates.centre, radii=np.full(len(candidates), 2.0)).partition(counts)
        facts = rr.AnyValues.columns(score=candidates.score, sigma_px=candidates.sigma).partition(counts)
        stream.send_columns("picture/candidates", build_time_columns(clip.times_of(frames), clip), [*points, *facts])
    stream.log("picture/candidates", rr.Points2D.from_fields(colors=[255, 255, 255, 90]), static=True)
    used = np.isfinite(rally.px[:, 0]) & rally.is_used
    if used.any():
        points = rr.Points2D.columns(positions=rally.px[used], radii=np.full(int(used.sum()), 5.0))
        stream.send_columns("picture/used", _build_columns(clip, clock, rally.t[used]), points)
    stream.log("picture/used", rr.Points2D.from_fields(colors=[*EVENT_COLOUR, 160]), static=True)


def _log_stroke(stream: rr.RecordingStream, clip: Clip, clock: CaptureClock, rally: Rally, stroke: Stroke) -> None:
    """Log the path of a stroke from its hit on: in space, and in the video as the camera shows it then."""
    t = np.append(np.arange(stroke.hit.t, stroke.end, PATH_STEP_S), stroke.end)
    xyz = evaluate_rally(rally, t).xyz
    xyz = xyz[np.isfinite(xyz[:, 0])]
    if len(xyz) < 2:
        return
    name, camera = f"{stroke.hit.t:07.3f}", rally.scene.camera
    look = {"colors": SIDE_COLOURS[stroke.hit.player], "radii": rr.Radius.ui_points(1.5)}
    stream.log(f"court/flights/{name}", rr.LineStrips3D([to_viewer(xyz, camera)], **look), static=True)
    rows = (rally.t >= stroke.hit.t) & (rally.t <= stroke.end)
    frames = rally.frame[rows]
    lines = [camera.to_pixels(xyz, int(frame)).astype(np.float32) for frame in frames]
    entity = f"picture/flights/{name}"
    stream.log(entity, rr.LineStrips2D.from_fields(**look), static=True)
    if len(lines):
        times = _build_columns(clip, clock, rally.t[rows])
        stream.send_columns(entity, times, rr.LineStrips2D.columns(strips=lines))
        stream.set_time(VIDEO_TIME, duration=float(clip.times_of(frames[-1:])[0]) + PATH_STEP_S)
        stream.set_time("frame", sequence=int(frames[-1]) + 1)
        stream.log(entity, rr.Clear(recursive=False))
        stream.reset_time()


def _log_object(stream: rr.RecordingStream, clip: Clip, clock: CaptureClock, rally: Rally) -> None:
    """Log the object in space, its height and its speed at every frame; it vanishes where no flight is."""
    path, sport = evaluate_rally(rally, rally.t), rally.scene.sport
    there = np.isfinite(path.xyz[:, 0])
    if not there.any():
        return
    places = to_viewer(path.xyz[there], rally.scene.camera)
    points = rr.Points3D.columns(positions=places).partition(there.astype(np.int64))
    stream.send_columns("court/object", _build_columns(clip, clock, rally.t), points)
    look = rr.Points3D.from_fields(colors=OBJECT_COLOUR, radii=DOT)
    stream.log("court/object", look, static=True)
    values = {"height": path.xyz[:, 2], "speed": np.linalg.norm(path.v, axis=1)}
    for what, column in values.items():
        entity = f"plots/{what}/{sport.object.name}"
        stream.log(entity, rr.SeriesLines(colors=EVENT_COLOUR, names=sport.object.name, widths=1.5), static=True)
        times = _build_columns(clip, clock, rally.t)
        stream.send_columns(entity, times, rr.Scalars.columns(scalars=column))  # NaN interrupts the line


def _log_rally_events(stream: rr.RecordingStream, clip: Clip, clock: CaptureClock, rally: Rally) -> None:
    """Log events as ellipsoids of two standard deviations, and as text."""
    name, camera = rally.scene.sport.object.name, rally.scene.camera
    if not rally.events:
        return
    t = np.array([one.t for one in rally.events])
    shown = clock.presentation_time_at(t).tolist()
    words = [
        f"{format_time(at, one.t_sigma)}: {format_rally_event(one, name)} ({format_probability(one.probability)})"
        for at, one in zip(shown, rally.events, strict=True)
    ]
    columns = rr.TextLog.columns(text=words, level=["INFO"] * len(words))
    stream.send_columns("log/events", _build_columns(clip, clock, t), columns)
    mirror = to_viewer(np.ones(3), camera)
    for k, event in enumerate(rally.events):
        values, axes = np.linalg.eigh(event.covariance * np.outer(mirror, mirror))
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        half = np.maximum(ELLIPSOID_SIGMAS * np.sqrt(np.maximum(values, 0)), MIN_HALF_AXIS)
        colour = SIDE_COLOURS[event.player] if event.kind == "hit" else EVENT_COLOUR
        shape = rr.Ellipsoids3D(half_sizes=[half], colors=colour)
        dot = rr.Points3D([[0.0, 0.0, 0.0]], colors=colour, radii=DOT, labels=[words[k]], show_labels=False)
        pose = rr.Transform3D(translation=event.place * mirror, mat3x3=axes)
        entity = f"court/events/{k:02d}-{event.kind}"
        stream.log(entity, shape, pose, static=True)
        stream.log(f"{entity}/place", dot, static=True)


def _format_about(rally: Rally) -> str:
    """Format the answer and the trust level as Markdown."""
    point, trust = format_point(rally, judge_landing(rally)), assess_rally_trust(rally)
    lines = [f"# {point.headline}", point.reason, "", point.confidence, "", f"## Trust: {trust.level}"]
    return "\n".join([*lines, *(f"- {reason}" for reason in trust.reasons)])
