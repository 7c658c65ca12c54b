"""Plain in-between frames of a clip: the chain up to its fit, then pictures to a video and, if wanted, to PNGs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.core.errors import OptionError
from models.core.fit_result import Trust
from models.core.typing import FloatArray, ImageArray
from pipeline.chain import fit_graph, fitted, refuse_closed
from pipeline.engine.atomic_write import aside, new_folder
from pipeline.engine.result_cache import Cache
from pipeline.engine.stage_graph import Watcher
from pipeline.options import RunOptions
from pipeline.reporting.text.run_trust import run_trust
from video.flow.optical_flow import Blend, Interpolator, OpticalFlow
from video.io.audio import add_sound
from video.io.clip import Clip
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import Sightings, sight
from video.overlay.plain_interpolation import Making, even_rate, even_times, pictures_at, times_between
from video.overlay.vertical_crop import window_lefts, window_width
from video.synthesis.frame_synthesis import scenery_of

TICK = Fraction(1, 90000)
"""s, of videos whose pictures come unevenly."""
RATES = (24, 240)
"""1/s, of finished videos that are asked for by their rate."""
MOST_SLOW = 100.0
MOST_SHUTTER = 360.0
"""degrees"""


@dataclass(frozen=True, slots=True)
class InterpolateOptions:
    """Which pictures, and how they are made and shown."""

    factor: int | None = None
    """Steps from picture to picture."""
    rate: Fraction | None = None
    """Pictures per second of the finished video, instead of a factor; real ones only where they fall on them."""
    slow: float = 1.0
    """Times slower than the clip."""
    shutter: float | None = None
    """Degrees of the step from picture to picture for which the shutter is open; None: as it was filmed."""
    upright: bool = False
    """A window of 9:16 that follows the action."""
    elsewhere: str = "flow"
    """What makes the picture where no ball is: flow, blend, or the path of an ONNX network."""

    def __post_init__(self) -> None:
        if (self.factor is None) == (self.rate is None):
            raise OptionError("Either --factor or --rate says which pictures are made; give one of them")
        if self.rate is not None and not RATES[0] <= self.rate <= RATES[1]:
            raise OptionError(f"--rate is {RATES[0]} to {RATES[1]} pictures per second; got {float(self.rate):g}")
        if not 1 <= self.slow <= MOST_SLOW:
            raise OptionError(f"--slow is 1 to {MOST_SLOW:g} times; got {self.slow:g}")
        if self.shutter is not None and not 0 <= self.shutter <= MOST_SHUTTER:
            raise OptionError(f"--shutter is 0 to {MOST_SHUTTER:g} degrees; got {self.shutter:g}")


@dataclass(frozen=True, slots=True)
class Interpolated:
    """What came out."""

    pictures: int
    originals: int
    rate: float
    """Pictures per second, on average."""
    trust: Trust
    notes: tuple[str, ...]


def interpolate_clip(
    clip: Path,
    video: Path,
    frames: Path | None,
    wanted: InterpolateOptions,
    options: RunOptions,
    cache: Cache,
    watcher: Watcher,
) -> Interpolated:
    """Write the pictures of a clip and those between them, and as PNGs into `frames` if it is given.

    With a factor these are (D - 1) factor + 1 of D distinct ones. Raises a TruerollError, one sentence, where the clip
    cannot be used; nothing is left half-written then.
    """
    for place in (video.parent, *([frames] if frames is not None else [])):
        refuse_closed(place)
    if video.exists() and video.samefile(clip):
        raise OptionError(f"The video would overwrite the clip {clip} itself; name another with -o")
    if frames is not None and frames.is_dir() and any(frames.iterdir()):
        raise OptionError(f"--frames needs a new or an empty folder; {frames} holds files")
    elsewhere = _interpolator(wanted.elsewhere)
    seen, scene, tracks, fit = fitted(fit_graph(clip, options), clip, cache, watcher)
    progress, start = watcher.started("interpolate"), time.perf_counter()
    times, rate, even = _schedule(seen, wanted)
    scenery = scenery_of(sight(scene, tracks, fit), seen)
    making = Making(elsewhere, _exposure(wanted, times))
    window = _Window.of(scenery.sightings, times, seen, wanted.upright)
    video.parent.mkdir(parents=True, exist_ok=True)
    base = None if even else TICK
    with aside(video) as place, _folder(frames) as folder:
        silent = place.with_name(f".{video.name}.silent{place.name.removeprefix('.' + video.name)}")
        try:
            with VideoWriter(silent, window.width, seen.height, rate, crf=18, time_base=base, direct=True) as writer:
                for k, picture in enumerate(pictures_at(seen, scenery, times, making)):
                    shown = window.cut(picture, k)
                    writer.write(shown, None if even else float(wanted.slow * (times[k] - times[0])))
                    if folder is not None:
                        Image.fromarray(shown).save(folder / f"{k:06d}.png", compress_level=1)
                    progress((k + 1) / len(times))
            _with_sound(silent, seen, options, wanted.slow, place)
        finally:
            silent.unlink(missing_ok=True)
    watcher.finished("interpolate", time.perf_counter() - start, False)
    originals = int(np.isin(times, seen.t[seen.distinct]).sum())
    return Interpolated(len(times), originals, float(rate), run_trust(seen, fit), seen.notes)


def _schedule(clip: Clip, wanted: InterpolateOptions) -> tuple[FloatArray, Fraction, bool]:
    """Times (K,) s of the clip, the rate of the finished video, and whether its pictures come evenly."""
    slow = Fraction(wanted.slow).limit_denominator(1000)
    if wanted.rate is not None:
        return even_times(clip, float(wanted.rate * slow)), wanted.rate, True
    assert wanted.factor is not None
    times, exact = times_between(clip, wanted.factor), even_rate(clip, wanted.factor)
    mean = Fraction((len(times) - 1) / float(times[-1] - times[0])).limit_denominator(1001)
    return times, (exact or mean) / slow, exact is not None


def _exposure(wanted: InterpolateOptions, times: FloatArray) -> float | None:
    """s of the clip for which the shutter is open."""
    if wanted.shutter is None:
        return None
    return float(wanted.shutter / MOST_SHUTTER * np.median(np.diff(times)))


def _interpolator(name: str) -> Interpolator:
    if name in ("flow", "blend"):
        return OpticalFlow() if name == "flow" else Blend()
    from video.flow.onnx_interpolation import OnnxNetwork  # slow to import

    if not Path(name).is_file():
        raise OptionError(f"--elsewhere is flow, blend or the path of an ONNX network; got {name}")
    return OnnxNetwork.load(Path(name))


def _with_sound(silent: Path, clip: Clip, options: RunOptions, slow: float, place: Path) -> None:
    """Put the clip's sound under the pictures; where times are not the container's, there is none that fits."""
    if clip.has_audio and options.read.fps is None:
        add_sound(silent, clip, slow, place)
    else:
        silent.rename(place)


@dataclass(frozen=True, slots=True)
class _Window:
    """The part of the pictures that is shown."""

    width: int
    lefts: NDArray[np.int64]
    """(K,) px"""

    @classmethod
    def of(cls, sightings: Sightings, times: FloatArray, clip: Clip, upright: bool) -> _Window:
        if not upright:
            return cls(clip.width, np.zeros(len(times), np.int64))
        return cls(window_width(clip.width, clip.height), window_lefts(sightings, times))

    def cut(self, picture: ImageArray, k: int) -> ImageArray:
        left = int(self.lefts[k])
        return np.ascontiguousarray(picture[:, left : left + self.width])


@contextmanager
def _folder(frames: Path | None) -> Iterator[Path | None]:
    """A folder to fill that appears as `frames` at the end, or None where no pictures are wanted."""
    if frames is None:
        yield None
        return
    frames.parent.mkdir(parents=True, exist_ok=True)
    with new_folder(frames) as folder:
        yield folder
