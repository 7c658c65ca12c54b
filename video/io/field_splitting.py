"""Interlaced video: the two fields of a frame, taken one after the other, become two frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import av
from av.filter import Graph

# FFmpeg filter that makes a frame of each field, in the order that the frame states, and passes progressive frames.
FIELD_FILTER = ("bwdif", "mode=send_field:parity=auto:deint=interlaced")


class FieldSplitter:
    """Splits frames that state to be interlaced; progressive frames before the first of them pass unchanged."""

    def __init__(self) -> None:
        self._graph: Graph | None = None

    def split_fields(self, frame: Any) -> Iterator[Any]:
        """Yield the frames that a frame completes; None yields the rest at the end of the video."""
        if self._graph is None and (frame is None or not frame.interlaced_frame):
            yield from () if frame is None else (frame,)
            return
        if self._graph is None:
            self._graph = _build_field_graph(frame)
        self._graph.push(frame)
        while True:
            try:
                yield self._graph.pull()
            except (av.error.BlockingIOError, av.error.EOFError):
                return


def _build_field_graph(frame: Any) -> Graph:
    """Build the filter graph for frames like this one."""
    graph = Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    graph.link_nodes(source, graph.add(*FIELD_FILTER), graph.add("buffersink")).configure()
    return graph
