"""First results of a run for who follows it: an image of what is found, and the first contacts in sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from models.core.detections import Detections
from models.core.errors import TruerollError
from models.core.fit_result import Fit
from models.core.rally import BallCandidates, Rally
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.chain import FinishedRally, FinishedRun
from pipeline.engine.atomic_write import replace_file
from pipeline.engine.result_cache import CacheEntry
from pipeline.engine.stage_graph import StageGraph
from pipeline.reporting.text.rally_sentences import format_landing
from pipeline.reporting.text.shot_summary import MIN_PROBABILITY
from pipeline.reporting.text.stroke_sentences import format_point
from pipeline.reporting.text.text_formatting import format_event, format_event_time
from video.drawing.masks import SHIFT, draw_ring, to_fixed_point
from video.drawing.palette import FLASH
from video.io.clip import Clip, read_frames

# Longest side of the image, px, and its quality: 100 kB.
IMAGE_PX, JPEG_QUALITY = 960, 80
# Events that are named before the report is there.
MAX_EVENTS = 4
# Of a ring around a ball, radii of the ball; radius of a ball or shuttle in flight, px.
RING_SCALE, CANDIDATE_PX = 1.4, 8.0
# Stages with something new to draw; of the first one, a frame with nothing on it.
DRAWN_STAGES = ("read", "detect", "track", "candidates")


class FirstResults:
    """Follows a run and reports what is known so far."""

    def __init__(self, image: Path, report: Callable[[Sequence[str], tuple[int, int]], object]) -> None:
        """Start before the run.

        Args:
            image: JPEG file to write.
            report: Called with all sentences so far and width and height of a frame (px; 0 before it is known), also
                when only the image is new.
        """
        self._image, self._report = image, report
        self._size = 0, 0
        self._drawn: set[str] = set()
        self._sentences: tuple[str, ...] = ()

    def follow(self, graph: StageGraph, entries: Mapping[str, CacheEntry]) -> None:
        """Report what the newest stage has found."""
        newest = [name for name in DRAWN_STAGES if name in entries]
        if newest and newest[-1] not in self._drawn:
            self._drawn.update(newest)
            with suppress(OSError, ValueError, TruerollError):  # the run goes on without the image
                self._draw(graph, entries, newest[-1])
            self._report(self._sentences, self._size)
        if not self._sentences and "explain" in entries:
            self._say(list_first_events(view_shot(graph.load("explain", entries))))
        elif not self._sentences and "rally" in entries:
            self._say([describe_rally_landing(graph.load("rally", entries))])

    def conclude(self, run: FinishedRun | FinishedRally) -> None:
        """Report what is known at the end; a run of which all was cached has not reported anything else."""
        sentences = list_first_events(run.fit) if isinstance(run, FinishedRun) else [describe_rally_landing(run.rally)]
        self._say(sentences)

    def _say(self, sentences: Sequence[str]) -> None:
        if self._sentences != tuple(sentences):
            self._sentences = tuple(sentences)
            self._report(self._sentences, self._size)

    def _draw(self, graph: StageGraph, entries: Mapping[str, CacheEntry], stage: str) -> None:
        """Draw the newest frame in which something is found, with rings around it and lines along the tracks so far."""
        clip, value = graph.load("read", entries), graph.load(stage, entries)
        self._size = clip.width, clip.height
        paths: list[FloatArray] = []
        if isinstance(value, Clip):
            frame, rings, radii = clip.first_frame, np.zeros((0, 2)), np.zeros(0)
        elif len(value.frame):
            frame, (rings, radii, paths) = int(value.frame[-1]), _list_marks(value)
        else:
            return
        ((_, image),) = read_frames(clip, indices=np.array([frame]))
        drawn = image.copy()
        for path in paths:
            cv2.polylines(drawn, [to_fixed_point(path)], False, FLASH, 2, cv2.LINE_AA, SHIFT)
        for centre, radius in zip(rings, radii, strict=True):
            draw_ring(drawn, centre, float(radius), 2.0, FLASH, 1.0)
        scale = min(1.0, IMAGE_PX / max(drawn.shape))
        small = cv2.resize(drawn, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        quality = (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
        _, code = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), quality)
        with replace_file(self._image) as target:
            target.write_bytes(code.tobytes())


def _list_marks(value: Detections | Tracks | BallCandidates) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """List rings (K, 2) px with their radii (K,) px in the newest frame, and the paths until then, (T, 2) px each."""
    if isinstance(value, Tracks):
        is_seen = np.asarray(np.isfinite(value.px).all(axis=2))
        paths = [value.px[is_seen[:, k], k] for k in range(len(value.ids))]
        return value.px[-1, is_seen[-1]], value.radius_px[-1, is_seen[-1]] * RING_SCALE, paths
    newest = value.frame == value.frame[-1]
    radius = value.radius if isinstance(value, Detections) else np.full(len(value.frame), CANDIDATE_PX)
    return value.centre[newest], radius[newest] * RING_SCALE, []


def list_first_events(fit: Fit) -> list[str]:
    """List the first likely events of a shot with their times, as sentences."""
    events = fit.events
    likely = [k for k in range(len(events)) if events.probability[k] >= MIN_PROBABILITY]
    return [f"{format_event_time(events, k)}: {format_event(events, k, fit.naming)}." for k in likely[:MAX_EVENTS]]


def describe_rally_landing(rally: Rally) -> str:
    """Describe who won the last point of a rally, and where its last flight landed."""
    call = judge_landing(rally)
    return f"{format_point(rally, call).headline} {format_landing(call, rally).sentence}"
