"""Live recording: results of the stages are sent to the viewer while the chain runs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import rerun as rr

from models.core.progress import Progress
from pipeline.engine.stage_graph import RunWatcher
from pipeline.io.run_views import view_run
from pipeline.reporting.recording.recorded_shot import build_recorded_shot, open_stream
from pipeline.reporting.recording.stage_layers import (
    log_calibrate_stage,
    log_detect_stage,
    log_fit_stage,
    log_read_stage,
    log_stage_lines,
    log_track_stage,
)
from pipeline.reporting.recording.viewer_blueprint import build_blueprint

PROGRESS_STEP = 0.1
"""Share of a stage between two progress lines of the log."""


class LiveRecording:
    """Recording that sends the value of every stage to a viewer as soon as it exists."""

    def __init__(self, address: str, title: str) -> None:
        self._address, self._title = address, title
        self._stream: rr.RecordingStream | None = None
        self._values: dict[str, Any] = {}

    def record_value(self, stage: str, value: Any) -> None:
        """Send the value of a finished stage."""
        self._values[stage] = value
        if stage == "read":
            self._stream = open_stream(value.digest, self._title)
            self._stream.connect_grpc(self._address, default_blueprint=build_blueprint(value, None))
            log_read_stage(self._stream, value, Path(tempfile.gettempdir()))
        elif self._stream is not None:
            self._log_value(self._stream, stage, value)

    def _log_value(self, stream: rr.RecordingStream, stage: str, value: Any) -> None:
        clip = self._values["read"]
        if stage == "calibrate":
            stream.send_blueprint(build_blueprint(clip, value.table))
            log_calibrate_stage(stream, clip, value)
        elif stage == "detect":
            log_detect_stage(stream, clip, value)
        elif stage == "track":
            log_track_stage(stream, clip, value)
        elif stage == "explain":
            log_fit_stage(stream, build_recorded_shot(clip, value.scene, value.tracks, view_run(value)))

    def log_progress(self, stage: str, sentence: str) -> None:
        """Log a line of progress of a stage."""
        if self._stream is not None:
            log_stage_lines(self._stream, self._values["read"], f"progress/{stage}", [("INFO", sentence)])

    def close(self) -> None:
        """Send everything that is buffered and disconnect."""
        if self._stream is not None:
            self._stream.flush()
            self._stream.disconnect()


class LiveWatcher:
    """Run watcher that passes everything on to another one and logs it in the recording."""

    def __init__(self, watcher: RunWatcher, recording: LiveRecording) -> None:
        self._watcher, self._recording = watcher, recording

    def start_stage(self, stage: str) -> Progress:
        """Start a stage in both places."""
        report_share = self._watcher.start_stage(stage)
        logged_share = 0.0

        def progress(share: float) -> None:
            nonlocal logged_share
            report_share(share)
            if share >= logged_share + PROGRESS_STEP:  # never true for NaN, the share of a stage of unknown length
                logged_share = share
                self._recording.log_progress(stage, f"{share:.0%}")

        return progress

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Report the end of a stage in both places."""
        self._watcher.finish_stage(stage, seconds, cached)
        self._recording.log_progress(stage, "read from the cache" if cached else f"done in {seconds:.1f} s")
