"""Audio of a slow-motion video: the audio of the clip, stretched at constant pitch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
from av.filter import Graph

from video.io.clip import Clip
from video.io.decoder import demux_packets, open_container, pull_frames

# Sample rate of the output, Hz, and its channel layout.
SAMPLE_RATE_HZ, CHANNEL_LAYOUT = 48000, "stereo"
# Smallest tempo of one `atempo` filter; slower tempos use several in series.
MIN_TEMPO = 0.5


def add_audio(silent_video: Path, clip: Clip, slowdown: float, out: Path) -> None:
    """Write a slow-motion video with the audio of its clip, stretched at constant pitch.

    Args:
        silent_video: the video; it starts with the clip's first frame, and its packets are copied.
        clip: the clip whose audio is used.
        slowdown: factor by which the video is slower than the clip.
        out: the mp4 file to write (AAC audio).
    """
    with (
        av.open(str(silent_video)) as video_in,
        av.open(str(out), "w", format="mp4", options={"movflags": "+faststart"}) as output,
    ):
        video_stream = output.add_stream_from_template(video_in.streams.video[0])
        audio_stream = output.add_stream("aac", rate=SAMPLE_RATE_HZ, layout=CHANNEL_LAYOUT)
        duration = float((video_in.streams.video[0].duration or 0) * (video_in.streams.video[0].time_base or 0))
        audio_packets = _encode_packets(audio_stream, _stretch_audio(clip, slowdown, duration))
        pending = next(audio_packets, None)
        for packet in video_in.demux(video=0):
            if packet.dts is None:
                continue
            while pending is not None and pending.dts * pending.time_base <= packet.dts * packet.time_base:
                output.mux(pending)
                pending = next(audio_packets, None)
            packet.stream = video_stream
            output.mux(packet)
        while pending is not None:
            output.mux(pending)
            pending = next(audio_packets, None)


def _encode_packets(stream: Any, frames: Iterator[Any]) -> Iterator[Any]:
    """Encode frames and flush the encoder."""
    for frame in frames:
        yield from stream.encode(frame)
    yield from stream.encode(None)


def _stretch_audio(clip: Clip, slowdown: float, duration: float) -> Iterator[Any]:
    """Yield stretched audio frames from the first video frame on, at most `duration` s of them."""
    with av.open(str(clip.path)) as container:
        stream = container.streams.audio[0]
        start = _first_frame_time(clip) + float(clip.t[0])
        graph, source, sink = _build_filter_graph(stream, start, slowdown, duration)
        for packet in demux_packets(container, stream):
            for frame in packet.decode():
                source.push(frame)
                yield from pull_frames(sink)
        source.push(None)
        yield from pull_frames(sink)
        del graph


def _first_frame_time(clip: Clip) -> float:
    """Presentation time of the first video frame of the file, s of the container's clock."""
    with open_container(clip.path) as (container, stream):
        for frame in container.decode(stream):
            return float(frame.time or 0.0)
    return 0.0


def _build_filter_graph(stream: Any, start: float, slowdown: float, duration: float) -> tuple[Graph, Any, Any]:
    """Build a graph that cuts at the first video frame (or inserts silence), stretches, and converts to one format."""
    graph = Graph()
    source = graph.add_abuffer(template=stream)
    delay = float((stream.start_time or 0) * stream.time_base) - start
    steps = [("atrim", f"start={start:.6f}"), ("asetpts", "PTS-STARTPTS")]
    steps += [("adelay", f"{1e3 * delay:.3f}:all=1")] if delay > 0 else []
    tempo = 1 / slowdown
    while tempo < MIN_TEMPO:
        steps.append(("atempo", f"{MIN_TEMPO}"))
        tempo /= MIN_TEMPO
    steps += [("atempo", f"{tempo:.9f}")] if tempo != 1 else []
    steps += [("atrim", f"end={duration:.6f}")]
    steps += [("aformat", f"sample_fmts=fltp:sample_rates={SAMPLE_RATE_HZ}:channel_layouts={CHANNEL_LAYOUT}")]
    steps += [("asetnsamples", "n=1024:p=1")]
    before = source
    for name, options in steps:
        step = graph.add(name, options)
        before.link_to(step)
        before = step
    sink = graph.add("abuffersink")
    before.link_to(sink)
    graph.configure()
    return graph, source, sink
