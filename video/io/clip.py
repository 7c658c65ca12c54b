"""A clip: what is known of a video file, and its pictures one after another."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.core.errors import ClipError
from models.core.progress import Progress, silent
from models.core.typing import FloatArray
from video.io.decoder import Turn, decoded, decoded_from, luma_of, opened, pixel_aspect, rgb_of, turn_of
from video.io.duplicate_frames import ChangeMeter, mark_repeats
from video.io.image_sequence import open_sequence, sequence_digest
from video.io.timestamps import even_times, nominal_rate, presentation_times

FEWEST_PICTURES = 5
"""Distinct pictures; fewer do not show a motion that could be followed."""

SIDES = (32, 16384)
"""px: no table is recognised in a smaller picture, and no camera makes a larger one."""

RATES = (1, 1000)
"""Pictures per second of a film of moving balls."""

LONGEST_GAP_S = 60.0
"""s between two pictures; a recording of a screen skips what is still, a spoilt timestamp skips years."""

INCOMPLETE = ("it breaks off", "it is damaged")
"""How a note begins that says that pictures are missing."""

USUAL_RATE = Fraction(25)
"""Pictures per second where neither timestamps nor header say one: what FFmpeg takes as well."""


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A video file of F pictures in presentation order, repeats counted.

    The pixels are those of the stored pictures, turned upright: where they are not square (a note says so) they are not
    resampled, because the homography of the table takes up the stretch.
    """

    path: Path
    digest: str
    """SHA-256 of the file's bytes, hex."""
    width: int
    """px, upright."""
    height: int
    """px, upright."""
    rate: Fraction
    """1/s: nominal rate at which the container shows pictures, repeats counted."""
    t: FloatArray
    """(F,) s, presentation time of each picture, the first at 0."""
    repeat: NDArray[np.bool_]
    """(F,) True where the picture shows the one before once more."""
    has_audio: bool
    notes: tuple[str, ...] = ()
    """Sentences on what was not as it should be, and what was done about it."""
    first: int = 0
    """Picture of the file with which the clip begins: a shot of a long recording is a clip of its own."""
    begins: float = 0.0
    """s, when that picture is shown in the file."""
    whole: bool = True
    """Whether the clip is all of the file."""

    def __post_init__(self) -> None:
        if self.t.shape != self.repeat.shape or self.t.ndim != 1 or np.any(np.diff(self.t) <= 0):
            raise ValueError("Clip.t and Clip.repeat must be (F,) alike, and t must go forward")

    @property
    def frame_count(self) -> int:
        """F, repeats counted."""
        return len(self.t)

    @property
    def distinct(self) -> NDArray[np.int64]:
        """(D,) indices of the pictures that are no repeats."""
        return np.flatnonzero(~self.repeat).astype(np.int64)

    def between(self, first: int, stop: int) -> Clip:
        """The pictures from `first` on, and before `stop`, as a clip of their own: counted and timed from its first."""
        if not self.whole or not 0 <= first < stop <= self.frame_count:
            raise ValueError(f"{first} to {stop} is no part of the {self.frame_count} pictures of a whole file")
        repeat = self.repeat[first:stop].copy()
        repeat[0] = False
        t, begins = self.t[first:stop], float(self.t[first])
        return replace(self, t=t - begins, repeat=repeat, first=first, begins=begins, whole=False)


def open_clip(path: Path, *, fps: Fraction | None = None, progress: Progress = silent) -> Clip:
    """Look through the whole file once: times, repeats, size.

    `fps` (1/s) overrides the container's times: picture k is at k / fps. ClipError, one sentence, where the file cannot
    be used; a file that breaks off is used as far as it goes, and `Clip.notes` says so.
    """
    if fps is not None and fps <= 0:
        raise ValueError(f"fps must be positive; got {fps}")
    check_file(path)
    seen = _look_through(path, progress)
    repeat = mark_repeats(*np.array(seen.change).T)
    distinct = int(np.count_nonzero(~repeat))
    if distinct < FEWEST_PICTURES:
        raise ClipError(
            f"{path.name} has {distinct} distinct picture{'s' * (distinct != 1)}; "
            f"tracking needs at least {FEWEST_PICTURES}"
        )
    t, note = presentation_times(seen.pts, seen.dts, seen.time_base, seen.rate or USUAL_RATE)
    notes = tuple(_notes(seen, t, note if fps is None else ""))
    rate = nominal_rate(t, seen.rate) if fps is None else Fraction(fps)
    t = t if fps is None else even_times(len(t), rate)
    _check_times(path, t, rate)
    return Clip(path, clip_digest(path), *seen.size, rate, t, repeat, seen.has_audio, notes)


def read_frames(
    clip: Clip, *, indices: Sequence[int] | NDArray[np.int64] | None = None, grey: bool = False
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield (frame, picture), ascending: RGB (H, W, 3), or the luma plane (H, W); None stands for the distinct frames.

    One picture at a time is held, so memory does not grow with the clip; decoding stops after the last one asked for.
    """
    wanted = np.zeros(clip.frame_count, np.bool_)
    chosen = clip.distinct if indices is None else np.asarray(indices, np.int64)
    if np.any((chosen < 0) | (chosen >= clip.frame_count)):
        raise ValueError(
            f"{clip.path.name} has frames 0 to {clip.frame_count - 1}; got {chosen.min()} to {chosen.max()}"
        )
    wanted[chosen] = True
    return _pictures(clip, wanted, grey)


def _pictures(clip: Clip, wanted: NDArray[np.bool_], grey: bool) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    last = int(np.max(np.flatnonzero(wanted), initial=-1))
    if last < 0:
        return
    with opened(clip.path) as (container, stream):
        turn: Turn | None = None
        for frame, picture in enumerate(decoded_from(container, stream, clip.first, clip.begins)):
            turn = turn_of(picture) if turn is None else turn
            if wanted[frame]:
                yield frame, turn.upright(luma_of(picture) if grey else rgb_of(picture))
            if frame == last:
                return
    raise ClipError(f"{clip.path.name} has changed since it was opened: frame {last} is gone; open it again")


def _check_times(path: Path, t: FloatArray, rate: Fraction) -> None:
    """ClipError for times at which nobody films: motion would be computed over hours, or over nothing."""
    if not RATES[0] <= rate <= RATES[1]:
        raise ClipError(
            f"{path.name} says that it shows {float(rate):.4g} pictures per second; {RATES[0]} to {RATES[1]} were "
            "expected; give the right number with --fps"
        )
    longest = int(np.argmax(np.diff(t)))
    if t[longest + 1] - t[longest] > LONGEST_GAP_S:
        raise ClipError(
            f"{path.name} shows nothing new for {t[longest + 1] - t[longest]:.4g} s after frame {longest}; cut it there"
        )


@dataclass(slots=True)
class _Seen:
    """What one look through a file gathers: a few numbers per picture."""

    pts: list[int | None]
    dts: list[int | None]
    change: list[tuple[float, float]]
    size: tuple[int, int] = (0, 0)
    turned: bool = False
    time_base: Fraction = Fraction(1)
    rate: Fraction | None = None
    seconds: float | None = None
    aspect: Fraction = Fraction(1)
    has_audio: bool = False
    damage: tuple[str, ...] = ()


def _look_through(path: Path, progress: Progress) -> _Seen:
    seen, meter, damage = _Seen([], [], []), ChangeMeter(), list[str]()
    with opened(path) as (container, stream):
        _read_header(seen, container, stream)
        for picture in decoded(container, stream, damage):
            _check_size(path, seen, picture)
            seen.time_base = picture.time_base or stream.time_base
            seen.pts.append(picture.pts)
            seen.dts.append(picture.dts)
            seen.change.append(meter.change(luma_of(picture)))
            if seen.seconds and picture.time is not None:
                progress(min(max(picture.time / seen.seconds, 0.0), 1.0))
    if not seen.pts:
        raise ClipError(
            f"{path.name} holds no picture that can be decoded: {damage[0] if damage else 'the stream is empty'}"
        )
    seen.damage = tuple(damage)
    progress(1.0)
    return seen


def _read_header(seen: _Seen, container: Any, stream: Any) -> None:
    seen.rate = stream.guessed_rate or stream.average_rate
    if stream.duration:
        seen.seconds = float(stream.duration * stream.time_base)
    elif container.duration:
        seen.seconds = container.duration / 1e6  # FFmpeg's AV_TIME_BASE
    seen.aspect = pixel_aspect(stream)
    seen.has_audio = len(container.streams.audio) > 0


def _check_size(path: Path, seen: _Seen, picture: Any) -> None:
    if not seen.pts:
        seen.turned = turn_of(picture).swap
    size = (picture.height, picture.width) if seen.turned else (picture.width, picture.height)
    if not seen.pts:
        if min(size) < SIDES[0] or max(size) > SIDES[1]:
            raise ClipError(
                f"{path.name} is {size[0]} x {size[1]} px; a table can be found in pictures of {SIDES[0]} to "
                f"{SIDES[1]} px a side"
            )
        seen.size = size
    elif size != seen.size:
        raise ClipError(
            f"{path.name} changes its picture size at frame {len(seen.pts)}, from {seen.size[0]} x {seen.size[1]} to "
            f"{size[0]} x {size[1]} px; cut it there"
        )


def _notes(seen: _Seen, t: FloatArray, timing: str) -> Iterator[str]:
    if timing:
        yield timing
    shown = _shown(seen, t)
    if seen.seconds and shown < seen.seconds - max(3 * (t[-1] - t[-2]), 0.02 * seen.seconds):
        yield f"{INCOMPLETE[0]} at {shown:.2f} s of {seen.seconds:.2f} s; the {len(t)} pictures before are used"
    elif seen.damage:
        yield f"{INCOMPLETE[1]} ({seen.damage[0]}); the {len(t)} pictures that can be decoded are used"
    if seen.aspect != 1:
        yield f"its pixels are not square ({seen.aspect.numerator}:{seen.aspect.denominator}); they are used as stored"


def _shown(seen: _Seen, t: FloatArray) -> float:
    """s from the container's zero to the end of the last picture."""
    first = float((seen.pts[0] or 0) * seen.time_base)
    return max(first, 0.0) + float(t[-1] + (t[-1] - t[-2]))


def check_file(path: Path) -> None:
    """ClipError where this cannot be a clip: a device would be read for ever."""
    if path.is_dir():
        open_sequence(path)
        return
    if not path.exists():
        raise ClipError(f"{path} does not exist; give a video file")
    if not path.is_file():
        raise ClipError(f"{path} is no ordinary file; give a video file")
    if path.stat().st_size == 0:
        raise ClipError(f"{path.name} is empty (0 bytes); copy or download it again")


def clip_digest(path: Path) -> str:
    """SHA-256 of the file's bytes, hex; of a folder of pictures over those of all. OSError where it cannot be read."""
    if path.is_dir():
        return sequence_digest(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
