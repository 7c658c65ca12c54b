"""The clip: metadata of a video file and sequential access to its frames.

Files that are no video at all are refused in `refused_files`; videos without enough frames, or with frames of a wrong
size or rate, here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from models.core.errors import ClipError
from models.core.progress import Progress, ignore_progress
from models.core.typing import FloatArray
from video.io.clip_digest import compute_clip_digest
from video.io.decoder import (
    ONE_FRAME_CODECS,
    DecodingDamage,
    decode_frames,
    decode_frames_from,
    open_container,
    pixel_aspect_ratio,
    read_capture_rate,
)
from video.io.duplicate_frames import FrameChangeMeter, classify_frames
from video.io.frame_layout import STORED_LAYOUT, FrameLayout, extract_stored_luma, read_layout
from video.io.frame_memory import FrameMemory
from video.io.refused_files import require_readable_file
from video.io.timestamps import compute_presentation_times, even_times, find_camera_clock
from video.io.view_changes import ViewMeter

Image = TypeVar("Image")

# Fewest distinct frames of a clip; fewer do not show a motion that can be tracked.
MIN_DISTINCT_FRAMES = 5

# Smallest and largest side of a frame: no table is recognised in smaller frames, and no camera records larger ones.
SIDE_RANGE_PX = (32, 16384)

# Lowest and highest frame rate of a clip, 1/s.
FPS_RANGE = (1, 1000)

# s by which a time may be before that of its frame: rounding.
TIME_TOLERANCE_S = 1e-9

# Longest time between two frames: a screen recording skips still moments, but a damaged timestamp skips years.
MAX_GAP_S = 60.0

# First words of the notes that report missing frames.
INCOMPLETE_PREFIXES = ("it breaks off", "it is damaged")

# Frame rate, 1/s, where neither timestamps nor header contain one; FFmpeg uses the same value.
DEFAULT_FPS = Fraction(25)


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A video file, or a part of one, with T frames in presentation order, duplicate frames included.

    Frames are upright, have square pixels and the colours of a standard display. `notes` reports what that changed.
    """

    path: Path
    digest: str
    """SHA-256 of the file's bytes, hexadecimal."""
    width: int
    """px, of the upright frame."""
    height: int
    """px, of the upright frame."""
    fps: Fraction
    """Nominal frame rate of the container, 1/s, duplicate frames included."""
    t: FloatArray
    """(T,) s, presentation time of each frame; that of the first frame of the file is 0."""
    is_duplicate: NDArray[np.bool_]
    """(T,) True where a frame shows the previous one again."""
    has_audio: bool
    notes: tuple[str, ...] = ()
    """Sentences for the user: defects of the file and how they were handled."""
    first_frame: int = 0
    """Index in the file of the clip's first frame; above 0 for a shot cut from a recording. All frames count so."""
    is_whole_file: bool = True
    """Whether the clip covers the whole file."""
    memory: FrameMemory | None = None
    """Decoded frames that all passes share; None decodes the file in every pass."""
    unobserved_frames: tuple[int, ...] = ()
    """Indices in the file of frames that show no moment: damaged, referring to damaged ones, or mixed of two images."""
    pixel_aspect: Fraction = Fraction(1)
    """Width of a stored pixel over its height, as the file states it."""
    stored_scale: tuple[float, float] = (1.0, 1.0)
    """Stored pixels per pixel of the upright image, along x and y."""
    clock_rate: float = 1.0
    """Seconds of `t` per second of the container: below 1 for slow motion, 0 where other times replaced its own."""
    views: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), np.int64))
    """(V, 2) first frame of each stretch without a cut or a fade, and the frame after its last one."""
    sway: FloatArray = field(default_factory=lambda: np.empty(0))
    """(T,) shares of the width by which the image seems to move as a whole within `FADE_GAP_S`; empty if unknown."""
    jumps: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    """(J, 4) frame at which a thing as small as a ball appears (1) or goes (-1), as where a fixed camera is cut to
    itself, its place in shares of width and height of the upright image, and this sign."""

    def __post_init__(self) -> None:
        if self.t.shape != self.is_duplicate.shape or self.t.ndim != 1 or np.any(np.diff(self.t) <= 0):
            raise ValueError("Clip.t and Clip.is_duplicate must have the same shape (T,), and t must increase")

    @property
    def missing_parts(self) -> tuple[str, ...]:
        """The notes that report missing frames."""
        return tuple(note for note in self.notes if note.startswith(INCOMPLETE_PREFIXES))

    @property
    def stored_start(self) -> float | None:
        """Time of the first frame by the container's timestamps, s after that of the file; None where unknown."""
        return float(self.t[0]) / self.clock_rate if self.clock_rate else None

    @property
    def frame_count(self) -> int:
        """Number of frames T, duplicate frames included."""
        return len(self.t)

    @property
    def frames(self) -> NDArray[np.int64]:
        """(T,) indices in the file of all frames."""
        return np.arange(self.first_frame, self.first_frame + self.frame_count, dtype=np.int64)

    @property
    def distinct_frames(self) -> NDArray[np.int64]:
        """(D,) indices in the file of the frames that are observed: those that are no duplicates and show a moment."""
        is_observed = ~self.is_duplicate
        is_observed[np.array(self.unobserved_frames, np.int64) - self.first_frame] = False
        return self.frames[is_observed]

    def times_of(self, frames: NDArray[np.int64]) -> FloatArray:
        """Return the presentation times of frames.

        Args:
            frames: (K,) their indices in the file.

        Returns:
            (K,) s.
        """
        times: FloatArray = self.t[frames - self.first_frame]
        return times

    def frames_shown_at(self, t: FloatArray) -> NDArray[np.int64]:
        """Return the frames that are shown at given times.

        Args:
            t: (K,) s.

        Returns:
            (K,) their indices in the file; before the first frame, the first.
        """
        rows = np.searchsorted(self.t, np.asarray(t) + TIME_TOLERANCE_S, side="right") - 1
        return np.maximum(rows, 0).astype(np.int64) + self.first_frame

    def extract_subclip(self, first: int, stop: int) -> Clip:
        """Cut a part out of a clip; its frames keep their numbers and times.

        Args:
            first: index of its first frame in the file.
            stop: index of the frame after its last one.

        Returns:
            The part as a clip that refers to the same file.

        Raises:
            ValueError: the range is empty or outside the clip.
        """
        begin = self.first_frame
        if not begin <= first < stop <= begin + self.frame_count:
            raise ValueError(f"frames {first} to {stop} are no part of frames {begin} to {begin + self.frame_count}")
        own = slice(first - begin, stop - begin)
        is_duplicate = self.is_duplicate[own].copy()
        is_duplicate[0] = False
        unobserved = tuple(frame for frame in self.unobserved_frames if first <= frame < stop)
        return replace(
            self, t=self.t[own], is_duplicate=is_duplicate, first_frame=first, is_whole_file=False, memory=None,
            views=np.array([[first, stop]], np.int64), sway=self.sway[own], jumps=np.empty((0, 4)),
            unobserved_frames=unobserved,
        )  # fmt: skip


def open_clip(
    path: Path, *, fps: Fraction | None = None, aspect: Fraction | None = None, progress: Progress = ignore_progress,
    memory: FrameMemory | None = None,
) -> Clip:  # fmt: skip
    """Read a video file, or a folder of numbered images, once and collect its times, duplicate frames and size.

    Args:
        path: the file or folder.
        fps: frame rate (1/s) that replaces the container's timestamps: frame k is at k / fps.
        aspect: width of a pixel over its height, instead of what the container states.
        progress: is called with the share that has been read, 0 to 1.
        memory: keeps the decoded frames for later passes.

    Returns:
        The clip. A truncated or damaged file is used up to the defect, which `Clip.notes` reports.

    Raises:
        ClipError: the file cannot be used; the message is one sentence for the user.
        ValueError: `fps` is not positive.
    """
    if fps is not None and fps <= 0:
        raise ValueError(f"fps must be positive; got {fps}")
    require_readable_file(path)
    scan = _scan_file(path, aspect, progress, memory or FrameMemory())
    is_duplicate, is_mixed, blending = classify_frames(scan.change, scan.has_fields)
    unobserved = np.unique([*scan.damaged, *np.flatnonzero(is_mixed)]).astype(np.int64)
    observed = int(np.count_nonzero(~np.delete(is_duplicate, unobserved)))
    if observed < MIN_DISTINCT_FRAMES:
        raise ClipError(
            f"{path.name} has {observed} {'intact and ' * bool(scan.damaged)}distinct frame{'s' * (observed != 1)}; "
            f"tracking needs at least {MIN_DISTINCT_FRAMES}"
        )
    t, note = compute_presentation_times(scan.pts, scan.dts, scan.time_base, scan.fps or DEFAULT_FPS)
    notes = [*_describe_problems(scan, t, note if fps is None else "")]
    if fps is not None:
        nominal, rate = Fraction(fps), 0.0
        t = even_times(len(t), nominal)
    else:
        clock = find_camera_clock(t, scan.fps, scan.capture_fps)
        t, nominal, rate = clock.t, clock.fps, clock.rate
        if 0 < rate != 1:
            notes.append(
                f"it was filmed at {float(nominal):.4g} fps and stores {rate * float(nominal):.4g} fps; "
                f"its times are {rate:.3g} of those stored"
            )
        elif clock.jitter:
            notes.append(
                f"its timestamps jitter by {1e3 * clock.jitter:.1f} ms about {float(nominal):.4g} fps; "
                "even times are used"
            )
    if blending is not None:
        t, rate = blending.estimate_times(t), 0.0
        notes.append(
            f"its frames were mixed of those of a camera at {float(nominal * blending.ratio):.4g} fps; "
            f"{np.count_nonzero(is_mixed)} of {len(t)} that show two moments are not observed"
        )
    jumps = scan.views.jumps
    jumps[:, 1:3] = scan.layout.orientation.rotate_places(jumps[:, 1:3])
    clip = Clip(
        path, compute_clip_digest(path), *scan.size, nominal, t, is_duplicate, scan.has_audio and rate in (0, 1),
        (*notes, *_describe_layout(scan)), memory=memory, unobserved_frames=tuple(unobserved.tolist()),
        pixel_aspect=scan.aspect, stored_scale=scan.layout.stored_scale, clock_rate=rate,
        views=scan.views.find_views(t), sway=scan.views.measure_sway(t), jumps=jumps,
    )  # fmt: skip
    _check_times(path, t, nominal)
    return clip


def read_frames(
    clip: Clip, *, indices: Sequence[int] | NDArray[np.int64] | None = None, grey: bool = False
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Decode frames of a clip in ascending order.

    Frames come from the memory of the clip once it holds them. Otherwise decoding stops after the last requested frame,
    or, while the memory is filling, after the last one of the clip.

    Args:
        clip: the clip to read.
        indices: (K,) indices in the file of the requested frames in any order; None requests all distinct frames.
        grey: return only the luma plane, which costs no colour conversion.

    Returns:
        Iterator over (index, image) with upright uint8 images: RGB (H, W, 3), or luma (H, W).

    Raises:
        ValueError: an index is outside the clip.
        ClipError: raised during the iteration if the file has changed since it was opened.
    """
    wanted = np.zeros(clip.frame_count, np.bool_)
    chosen = clip.distinct_frames if indices is None else np.asarray(indices, np.int64)
    first, stop = clip.first_frame, clip.first_frame + clip.frame_count
    if np.any((chosen < first) | (chosen >= stop)):
        raise ValueError(f"{clip.path.name} has frames {first} to {stop - 1}; got {chosen.min()} to {chosen.max()}")
    wanted[chosen - first] = True
    return _decode_wanted_frames(clip, wanted, FrameLayout.extract_luma if grey else FrameLayout.extract_rgb)


def read_planes(clip: Clip) -> Iterator[tuple[int, tuple[NDArray[np.uint8], NDArray[np.uint8]]]]:
    """Decode the distinct frames of a clip to luma and chroma, which costs no colour conversion.

    Returns:
        Iterator over (index, (luma (H, W), chroma (H/2, W/2, 2))), upright; chroma is neutral at 128.
    """
    wanted = np.zeros(clip.frame_count, np.bool_)
    wanted[clip.distinct_frames - clip.first_frame] = True
    return _decode_wanted_frames(clip, wanted, lambda layout, f: (layout.extract_luma(f), layout.extract_chroma(f)))


def _decode_wanted_frames(
    clip: Clip, wanted: NDArray[np.bool_], extract: Callable[[FrameLayout, Any], Image]
) -> Iterator[tuple[int, Image]]:
    layout: FrameLayout | None = None
    for index, frame in enumerate(_iterate_frames(clip, int(np.max(np.flatnonzero(wanted), initial=-1)))):
        layout = read_layout(frame, clip.pixel_aspect) if layout is None else layout
        if wanted[index]:
            yield clip.first_frame + index, extract(layout, frame)


def _iterate_frames(clip: Clip, last: int) -> Iterator[Any]:
    """Yield the frames of a clip up to index `last`, as decoded."""
    memory = clip.memory or FrameMemory()
    if last < 0 or memory.is_complete:
        yield from memory.frames[: last + 1]
        return
    index = -1
    with open_container(clip.path) as (container, stream):
        for index, frame in enumerate(decode_frames_from(container, stream, clip.first_frame, clip.stored_start)):
            memory.add_frame(index, frame)
            if index <= last:
                yield frame
            if index == clip.frame_count - 1:
                memory.is_complete = memory.is_filling and len(memory.frames) == clip.frame_count
                return
            if index >= last and not memory.is_filling:
                return
    if index < last:
        raise ClipError(f"{clip.path.name} has changed since it was opened: frame {last} is gone; open it again")


def _check_times(path: Path, t: FloatArray, fps: Fraction) -> None:
    """Raise ClipError for implausible times, which would make every speed meaningless."""
    if not FPS_RANGE[0] <= fps <= FPS_RANGE[1]:
        raise ClipError(
            f"{path.name} has a frame rate of {float(fps):.4g} fps; {FPS_RANGE[0]} to {FPS_RANGE[1]} were expected",
            remedy="rate",
        )
    longest = int(np.argmax(np.diff(t)))
    if t[longest + 1] - t[longest] > MAX_GAP_S:
        raise ClipError(
            f"{path.name} shows nothing new for {t[longest + 1] - t[longest]:.4g} s after frame {longest}; cut it there"
        )


@dataclass(slots=True)
class _FileScan:
    """Results of one pass through a file: a few numbers per frame."""

    pts: list[int | None]
    dts: list[int | None]
    change: list[tuple[float, float]]
    views: ViewMeter = field(default_factory=ViewMeter)
    size: tuple[int, int] = (0, 0)
    layout: FrameLayout = STORED_LAYOUT
    has_fields: bool = False
    time_base: Fraction = Fraction(1)
    fps: Fraction | None = None
    duration_s: float | None = None
    aspect: Fraction = Fraction(1)
    capture_fps: Fraction | None = None
    has_audio: bool = False
    errors: tuple[str, ...] = ()
    damaged: list[int] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    codec: str = ""


def _scan_file(path: Path, aspect: Fraction | None, progress: Progress, memory: FrameMemory) -> _FileScan:
    scan, meter, damage = _FileScan([], [], []), FrameChangeMeter(), DecodingDamage()
    with open_container(path) as (container, stream):
        _read_header(scan, container, stream)
        scan.aspect = scan.aspect if aspect is None else aspect
        for frame in decode_frames(container, stream, damage):
            _check_size(path, scan, frame)
            scan.time_base = frame.time_base or stream.time_base
            memory.add_frame(len(scan.pts), frame)
            if damage.is_current:
                scan.damaged.append(len(scan.pts))
            scan.pts.append(frame.pts)
            scan.dts.append(frame.dts)
            scan.change.append(meter.measure_change(extract_stored_luma(frame)))
            scan.views.add_frame(meter.thumbnail)
            if scan.duration_s and frame.time is not None:
                progress(min(max(frame.time / scan.duration_s, 0.0), 1.0))
    if not scan.pts:
        raise ClipError(
            f"{path.name} contains no frame that can be decoded: "
            f"{damage.errors[0] if damage.errors else 'the stream is empty'}"
        )
    scan.errors, scan.has_fields = tuple(damage.errors), damage.has_fields
    if scan.codec in ONE_FRAME_CODECS and not scan.has_fields:
        scan.lost = sorted(pts for pts in damage.lost if pts > (scan.pts[0] or 0))  # those before refer to other files
    memory.is_complete = memory.is_filling
    progress(1.0)
    return scan


def _read_header(scan: _FileScan, container: Any, stream: Any) -> None:
    scan.fps = stream.guessed_rate or stream.average_rate
    if stream.duration:
        scan.duration_s = float(stream.duration * stream.time_base)
    elif container.duration:
        scan.duration_s = container.duration / 1e6  # FFmpeg's AV_TIME_BASE
    scan.aspect, scan.capture_fps = pixel_aspect_ratio(stream), read_capture_rate(container)
    scan.has_audio, scan.codec = len(container.streams.audio) > 0, getattr(stream, "name", "")


def _check_size(path: Path, scan: _FileScan, frame: Any) -> None:
    if not scan.pts:
        scan.layout = read_layout(frame, scan.aspect)
    size = scan.layout.upright_size(frame)
    if not scan.pts:
        if min(size) < SIDE_RANGE_PX[0] or max(size) > SIDE_RANGE_PX[1]:
            raise ClipError(
                f"{path.name} is {size[0]} x {size[1]} px; a table can be found in frames with sides of "
                f"{SIDE_RANGE_PX[0]} to {SIDE_RANGE_PX[1]} px"
            )
        scan.size = size
    elif size != scan.size:
        raise ClipError(
            f"{path.name} changes its frame size at frame {len(scan.pts)}, from {scan.size[0]} x {scan.size[1]} to "
            f"{size[0]} x {size[1]} px; cut it there"
        )


def _describe_problems(scan: _FileScan, t: FloatArray, timing: str) -> Iterator[str]:
    if timing:
        yield timing
    decoded_s = _last_frame_end(scan, t)
    if scan.duration_s and decoded_s < scan.duration_s - max(3 * (t[-1] - t[-2]), 0.02 * scan.duration_s):
        at = f"{decoded_s:.2f} s of {scan.duration_s:.2f} s"
        yield f"{INCOMPLETE_PREFIXES[0]} at {at}; the {len(t)} frames before are used"
    elif scan.errors and not scan.damaged:
        yield f"{INCOMPLETE_PREFIXES[1]} ({scan.errors[0]}); the {len(t)} frames that can be decoded are used"
    elif scan.lost and not scan.damaged:
        first, last = (float((pts - (scan.pts[0] or 0)) * scan.time_base) for pts in (scan.lost[0], scan.lost[-1]))
        yield f"{INCOMPLETE_PREFIXES[1]}; {len(scan.lost)} frames from {first:.2f} to {last:.2f} s cannot be decoded"
    runs = np.split(scan.damaged, 1 + np.flatnonzero(np.diff(scan.damaged) > 1)) if scan.damaged else ()
    for first, last in ((run[0], run[-1]) for run in runs):
        span = f"from {t[first]:.2f} to {t[last]:.2f} s; frames {first} to {last} are"
        lone = f"at {t[first]:.2f} s; frame {first} is"
        yield f"{INCOMPLETE_PREFIXES[1]} {span if first < last else lone} not observed"


def _describe_layout(scan: _FileScan) -> Iterator[str]:
    """Describe what is done with the images of a file."""
    layout, (width, height) = scan.layout, scan.size
    if layout.aspect != 1:
        yield (
            f"its pixels are not square ({layout.aspect.numerator}:{layout.aspect.denominator}); "
            f"positions are in pixels of the upright image with square pixels, {width} x {height} px"
        )
    if scan.has_fields:
        yield "it is interlaced; each field is a frame"
    if layout.colours is not None:
        yield f"its colours ({layout.colours.colours.name}) are converted to those of a standard display"


def _last_frame_end(scan: _FileScan, t: FloatArray) -> float:
    """Return the time at which the last frame ends, s of the container's clock."""
    first = float((scan.pts[0] or 0) * scan.time_base)
    return max(first, 0.0) + float(t[-1] + (t[-1] - t[-2]))
