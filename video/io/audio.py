"""The sound of a clip, stretched with the picture: slower at the same pitch."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
from av.filter import Graph

from video.io.clip import Clip
from video.io.decoder import opened, packets_of

RATE, LAYOUT = 48000, "stereo"
"""1/s, of samples; channels."""
SLOWEST_STEP = 0.5
"""The least tempo of one `atempo` filter; slower ones stand in a row."""


def add_sound(silent: Path, clip: Clip, slow: float, out: Path) -> None:
    """Write the pictures of `silent` with the sound of `clip`, `slow` times slower, to `out` (mp4, AAC).

    The pictures begin with the clip's first one, and are copied as they are coded.
    """
    with (
        av.open(str(silent)) as pictures,
        av.open(str(out), "w", format="mp4", options={"movflags": "+faststart"}) as made,
    ):
        film = made.add_stream_from_template(pictures.streams.video[0])
        voice = made.add_stream("aac", rate=RATE, layout=LAYOUT)
        end = float((pictures.streams.video[0].duration or 0) * (pictures.streams.video[0].time_base or 0))
        sound = _packets(voice, _stretched(clip, slow, end))
        waiting = next(sound, None)
        for packet in pictures.demux(video=0):
            if packet.dts is None:
                continue
            while waiting is not None and waiting.dts * waiting.time_base <= packet.dts * packet.time_base:
                made.mux(waiting)
                waiting = next(sound, None)
            packet.stream = film
            made.mux(packet)
        while waiting is not None:
            made.mux(waiting)
            waiting = next(sound, None)


def _packets(voice: Any, frames: Iterator[Any]) -> Iterator[Any]:
    for frame in frames:
        yield from voice.encode(frame)
    yield from voice.encode(None)


def _stretched(clip: Clip, slow: float, seconds: float) -> Iterator[Any]:
    """Frames of sound from the first picture on, at the most `seconds` of them when stretched."""
    with av.open(str(clip.path)) as container:
        voice = container.streams.audio[0]
        graph, source, sink = _graph(voice, _first_picture(clip), slow, seconds)
        for packet in packets_of(container, voice):
            for frame in packet.decode():
                source.push(frame)
                yield from _ready(sink)
        source.push(None)
        yield from _ready(sink)
        del graph


def _first_picture(clip: Clip) -> float:
    """s by the container's clock at which the first picture is shown."""
    with opened(clip.path) as (container, stream):
        for picture in container.decode(stream):
            return float(picture.time or 0.0)
    return 0.0


def _graph(voice: Any, start: float, slow: float, seconds: float) -> tuple[Graph, Any, Any]:
    """Cut at the first picture (silence before sound that begins later), stretch, one format."""
    graph = Graph()
    source = graph.add_abuffer(template=voice)
    late = float((voice.start_time or 0) * voice.time_base) - start
    steps = [("atrim", f"start={start:.6f}"), ("asetpts", "PTS-STARTPTS")]
    steps += [("adelay", f"{1e3 * late:.3f}:all=1")] if late > 0 else []
    tempo = 1 / slow
    while tempo < SLOWEST_STEP:
        steps.append(("atempo", f"{SLOWEST_STEP}"))
        tempo /= SLOWEST_STEP
    steps += [("atempo", f"{tempo:.9f}")] if tempo != 1 else []
    steps += [("atrim", f"end={seconds:.6f}")]
    steps += [("aformat", f"sample_fmts=fltp:sample_rates={RATE}:channel_layouts={LAYOUT}")]
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


def _ready(sink: Any) -> Iterator[Any]:
    while True:
        try:
            yield sink.pull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return
