"""The recording of a diagnosis of a mechanism for the rerun viewer: predictions beside what was recorded.

Held-out windows follow one another. In each, predictions begin where the recording is: the shapes of the model move as
recorded (solid), as predicted by the simulator (red) and with the named effects (green). Plots show the joints.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TextLogColumn
from scipy.spatial.transform import Rotation

from diagnosis.fitting.prediction_windows import PredictionWindow
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.typing import FloatArray
from models.estimation.gap_scenes.outside_simulator import OutsideSimulator
from pipeline.engine.atomic_write import replace_file
from pipeline.io.simulators.mujoco_simulator import MujocoSimulator, Shape
from pipeline.reporting.recording.recorded_shot import arrange_panels, finish_stream, open_stream
from pipeline.reporting.text import gap_sentences

# Name of the timeline in s, on which windows follow one another.
TIME = "time"
# s between two windows.
PAUSE_S = 0.5
# Colours on a dark background: what was recorded, and predictions before and after.
COLOURS = {"recorded": (205, 212, 208), "before": (239, 83, 80), "after": (102, 187, 106)}
# Side of the smallest view of a mechanism, m.
MIN_SIDE = 0.1


def write_gap_recording(
    report: DiagnosisReport, simulator: OutsideSimulator, path: Path, title: str, origins: Mapping[int, str]
) -> None:
    """Write the recording of the held-out windows of a diagnosis, with a blueprint; none without such windows.

    Entities: `world/recorded/`, `world/before/`, `world/after/` and `world/fixed/` (shapes of a MuJoCo model, m),
    `plots/JOINT/` (rad or m), `log/runs` and `about`.

    Args:
        report: Result of the diagnosis.
        simulator: Simulator that was diagnosed; one without shapes has plots alone.
        path: File to write (.rrd).
        title: Name of the recording in the viewer.
        origins: Origins of the shots, by shot.
    """
    gap = report.gap
    numbers = _choose_windows(gap.windows)
    if not numbers:
        path.unlink(missing_ok=True)  # of an earlier diagnosis
        return
    windows = [gap.windows[k] for k in numbers]
    spans = [float(np.ptp(one.segment.t)) for one in windows]
    starts = np.cumsum([0.0, *(span + PAUSE_S for span in spans[:-1])])
    t = np.concatenate([one.segment.t - one.segment.t[0] + start for one, start in zip(windows, starts, strict=True)])
    paths = {"recorded": [one.segment.positions for one in windows], "before": [gap.before[k] for k in numbers]}
    if report.verdict != "none":
        paths["after"] = [gap.after[k] for k in numbers]
    places = {name: np.concatenate(parts)[:, :, 0] for name, parts in paths.items()}
    joints = windows[0].segment.bodies
    units = {joint.name: joint.unit for joint in simulator.joints}
    poses = _Poses(simulator, joints, places)
    stream = open_stream(hashlib.sha256(b"".join(one.tobytes() for one in (t, *places.values()))).hexdigest(), title)
    with replace_file(path) as fresh:
        stream.save(fresh, default_blueprint=_build_gap_blueprint(joints, units, poses))
        ends = t[1:][np.diff(t) >= PAUSE_S] - PAUSE_S / 2  # NaN there interrupts the lines
        for name, columns in places.items():
            for joint, column in zip(joints, columns.T, strict=True):
                entity = rr.new_entity_path(["plots", joint, name])
                look = {"colors": COLOURS[name], "names": name}
                shown = rr.SeriesPoints(marker_sizes=2, **look) if name == "recorded" else rr.SeriesLines(**look)
                stream.log(entity, shown, static=True)
                values = np.append(column, np.full(len(ends), np.nan))
                stream.send_columns(entity, _build_times(np.append(t, ends)), rr.Scalars.columns(scalars=values))
            poses.log(stream, name, t)
        _log_runs(stream, report, numbers, starts, origins)
        about = [gap_sentences.format_verdict(report), gap_sentences.format_gap_closure(report)]
        text = "\n\n".join(gap_sentences.name_runs(report.scene, one) for one in about)
        stream.log("about", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        finish_stream(stream, path)


def _choose_windows(windows: tuple[PredictionWindow, ...]) -> list[int]:
    """Choose windows of which something is predicted, and that do not overlap."""
    chosen, ends = [], dict[int, float]()
    for k, one in enumerate(windows):
        if one.is_predicted.any() and one.segment.t[0] >= ends.get(one.segment.shot, -np.inf):
            chosen.append(k)
            ends[one.segment.shot] = float(one.segment.t[-1])
    return chosen


def _build_times(t: FloatArray) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(TIME, duration=t)]


class _Poses:
    """Shapes of a mechanism that moves as several paths say; nothing for a simulator without shapes."""

    def __init__(self, simulator: OutsideSimulator, joints: tuple[str, ...], paths: Mapping[str, FloatArray]) -> None:
        self.shapes: tuple[Shape, ...] = ()
        if not isinstance(simulator, MujocoSimulator):
            return
        self.shapes = simulator.list_shapes()
        names = [joint.name for joint in simulator.joints]
        columns, self.places = [names.index(name) for name in joints], {}
        for name, path in paths.items():
            # joints that were not recorded stand as in the file
            pose = np.tile(simulator.rest[: len(names)], (len(path), 1))
            pose[:, columns] = path
            self.places[name] = simulator.place_shapes(self.shapes, pose)

    def log(self, stream: rr.RecordingStream, name: str, t: FloatArray) -> None:
        """Log the shapes along a path, at times (T,) s."""
        for k, shape in enumerate(self.shapes):
            if shape.is_fixed and name != "recorded":
                continue
            places, turns = (one[:, k] for one in self.places[name])
            there = np.isfinite(places).all(axis=1)
            entity = rr.new_entity_path(["world", "fixed" if shape.is_fixed else name, shape.body, str(shape.geom)])
            stream.log(entity, _build_shape(shape, name), static=True)
            if shape.is_fixed:
                stream.log(entity, rr.Transform3D(translation=places[0], mat3x3=turns[0]), static=True)
            elif there.any():
                quaternions = np.empty((len(places), 4))
                quaternions[there] = Rotation.from_matrix(turns[there]).as_quat()
                moved = rr.Transform3D.columns(translation=places[there], quaternion=quaternions[there])
                stream.send_columns(entity, _build_times(t[there]), moved)


def _build_shape(shape: Shape, name: str) -> rr.AsComponents:
    """Build a shape: solid as recorded, and as a frame where it is predicted."""
    fill = rr.components.FillMode.Solid if name == "recorded" else rr.components.FillMode.TransparentFillMajorWireframe
    look = {"colors": COLOURS[name], "fill_mode": fill}
    radius, half = shape.size[:2]
    if shape.kind == "capsule":  # from the middle of one end to that of the other
        return rr.Capsules3D(radii=[radius], lengths=[2 * half], translations=[[0, 0, -half]], **look)
    if shape.kind == "cylinder":
        return rr.Cylinders3D(radii=[radius], lengths=[2 * half], **look)
    if shape.kind in ("sphere", "ellipsoid"):
        return rr.Ellipsoids3D(half_sizes=[np.full(3, radius) if shape.kind == "sphere" else shape.size], **look)
    return rr.Boxes3D(half_sizes=[shape.size], centers=[shape.middle], **look)


def _log_runs(
    stream: rr.RecordingStream,
    report: DiagnosisReport,
    numbers: list[int],
    starts: FloatArray,
    origins: Mapping[int, str],
) -> None:
    """Log which run a window is of, and the errors of its predictions."""
    gap, words = report.gap, []
    for number in numbers:
        one = gap.windows[number]
        errors = [
            gap_sentences.format_error_size(float(np.sqrt(np.nanmean(squares))), gap.metric)
            for squares in (
                np.square(paths[number] - one.segment.positions)[one.is_predicted] for paths in (gap.before, gap.after)
            )
        ]
        name = gap_sentences.name_runs(report.scene, gap_sentences.format_shot_name(one.segment.shot, origins))
        error = errors[0] if report.verdict == "none" else " -> ".join(errors)
        words.append(f"{name}, from {one.segment.t[0]:.2f} s: rms error {error}")
    stream.send_columns("log/runs", _build_times(starts), rr.TextLog.columns(text=words))


def _build_gap_blueprint(joints: tuple[str, ...], units: Mapping[str, str], poses: _Poses) -> rrb.Blueprint:
    """Build the layout: the mechanism in space, where it has shapes, above the plots of its joints."""
    body = rrb.TextLogColumns(timeline_columns=[], text_log_columns=[TextLogColumn("Body")])
    texts = rrb.Tabs(
        rrb.TextDocumentView(origin="about", name="Answer"),
        rrb.TextLogView(origin="log/runs", name="Runs", columns=body),
        active_tab=0,
    )
    plots = rrb.Grid(
        *(rrb.TimeSeriesView(origin=rr.new_entity_path(["plots", one]), name=f"{one} ({units[one]})") for one in joints)
    )
    layout: rrb.Container = rrb.Horizontal(plots, texts, column_shares=[3, 1])
    moving = [k for k, shape in enumerate(poses.shapes) if not shape.is_fixed]
    if moving:
        places = poses.places["recorded"][0][:, moving].reshape(-1, 3)
        low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
        reach = max(2 * float(np.max([np.linalg.norm(poses.shapes[k].size) for k in moving])), MIN_SIDE)
        side = float(np.linalg.norm(high - low)) + reach
        eye = rrb.EyeControls3D(
            position=(low + high) / 2 + side * np.array([-0.5, -1.0, 0.5]), look_target=(low + high) / 2,
            eye_up=[0, 0, 1],
        )  # fmt: skip
        view = rrb.Spatial3DView(origin="world", name="Recorded, and predicted (m)", eye_controls=eye)
        layout = rrb.Vertical(rrb.Horizontal(view, texts, column_shares=[3, 1]), plots, row_shares=[3, 2])
    return arrange_panels(layout, TIME)
