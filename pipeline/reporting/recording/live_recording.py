"""A recording that grows in the viewer while the chain runs."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import rerun as rr

from models.core.progress import Progress
from pipeline.engine.stage_graph import Watcher
from pipeline.reporting.recording import text_layer
from pipeline.reporting.recording.forecast_layer import log_fans
from pipeline.reporting.recording.recorded_shot import Shot, shot_of
from pipeline.reporting.recording.recording_stream import open_stream
from pipeline.reporting.recording.stage_layers import log_detected, log_fitted, log_found_table, log_read, log_tracked
from pipeline.reporting.recording.viewer_blueprint import blueprint

TOLD_EVERY = 0.1
"""Share of a stage between two lines of its progress."""


class LiveRecording:
    """Hears what stages make and sends it to a viewer at once."""

    def __init__(self, listens: str, title: str) -> None:
        self._listens, self._title = listens, title
        self._stream: rr.RecordingStream | None = None
        self._made: dict[str, Any] = {}
        self._shot: Shot | None = None

    def made(self, stage: str, value: Any) -> None:
        """A stage has made its value."""
        self._made[stage] = value
        if stage == "read":
            self._stream = open_stream(value.digest, self._title)
            self._stream.connect_grpc(self._listens, default_blueprint=blueprint(value, None))
            log_read(self._stream, value, Path(tempfile.gettempdir()))
        elif self._stream is not None:
            self._show(self._stream, stage, value)

    def _show(self, stream: rr.RecordingStream, stage: str, value: Any) -> None:
        clip = self._made["read"]
        if stage == "calibrate":
            stream.send_blueprint(blueprint(clip, value.table))
            log_found_table(stream, clip, value)
        elif stage == "detect":
            log_detected(stream, clip, value)
        elif stage == "track":
            log_tracked(stream, clip, value)
        elif stage == "fit":
            self._shot = shot_of(clip, self._made["calibrate"], self._made["track"], value)
            log_fitted(stream, self._shot)
        elif stage == "forecast" and self._shot is not None:
            log_fans(stream, self._shot, value)

    def say(self, stage: str, sentence: str) -> None:
        """A line in the log of the chain."""
        if self._stream is not None:
            text_layer.log_chain(self._stream, self._made["read"], f"progress/{stage}", [("INFO", sentence)])

    def close(self) -> None:
        """Send what is left."""
        if self._stream is not None:
            self._stream.flush()
            self._stream.disconnect()


class LiveWatcher:
    """A watcher that tells the viewer too what it tells another."""

    def __init__(self, watcher: Watcher, recording: LiveRecording) -> None:
        self._watcher, self._recording = watcher, recording

    def started(self, stage: str) -> Progress:
        hear = self._watcher.started(stage)
        told = 0.0

        def progress(share: float) -> None:
            nonlocal told
            hear(share)
            if share >= told + TOLD_EVERY:  # never where a stage cannot tell how far it is
                told = share
                self._recording.say(stage, f"{share:.0%}")

        return progress

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        self._watcher.finished(stage, seconds, cached)
        self._recording.say(stage, "taken from the cache" if cached else f"done in {seconds:.1f} s")
