"""Segmentation of a recording into shots: still balls, a strike, motion, and rest again.

The views between cuts and fades are segmented one by one. A view is also divided where balls jump: there something was
cut out although the camera stayed where it was. A view without a table contains no shot, and a replay of an earlier
shot is none: its frames show the same balls at the same places, in the same order.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, groupby, pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.errors import TableNotFound
from models.core.progress import Progress, ignore_progress
from models.core.typing import ByteArray, FloatArray
from video.calibration.cloth_region import find_cloth_regions
from video.calibration.table_finder import locate_table
from video.io.clip import Clip, read_frames
from video.io.duplicate_frames import measure_nth_largest

# px, height of the reduced frame: the smallest ball of a table that fills the frame covers four of its pixels.
SCAN_HEIGHT_PX = 180
# s between two compared frames: a ball at 5 mm/s is not at rest and moves half a millimetre.
COMPARISON_GAP_S = 0.12
# Grey levels of the fourth largest change on the cloth; coding and a flickering lamp reach up to 10.
MIN_MOTION_CHANGE = 16.0
# Share of the cloth that changes where a person or the camera moves; 16 balls of a break cover 2.5 %, twice.
LARGE_SHARE = 0.05
# s without motion that separate two shots.
MIN_STILLNESS_S = 1.0
# s of motion; shorter ones are a light that is switched.
MIN_MOTION_S = 0.25
# s of stillness before and after the motion of a shot: longer observation of balls at rest is more precise.
MARGIN_S = 0.5
# s above which a view may contain several shots.
LONG_RECORDING_S = 12.0
# Frames of a view in which a table is searched, and s between them: a player may stand before it.
TABLE_TRIES, TABLE_TRY_S = 8, 1.0
# Cameras of a recording whose table is remembered: to find one takes as long as to read 10 s of a view.
MAX_CAMERAS = 12
# Grey levels by which a pixel of one camera's view changes with light and coding, the share of the pixels that do not
# change more, and the blur before, px. People and balls take up to a tenth; two cameras share less than half.
SAME_CAMERA_CHANGE, SAME_CAMERA_SHARE, SAME_CAMERA_BLUR_PX = 12.0, 0.9, 1.0
# Earlier shots of which a shot may be a replay; each takes up to 3 MB.
REPLAY_SHOTS = 12
# Most frames that are kept of a shot to recognise its replay.
REPLAY_FRAMES = 200
# Frames of a shot that are searched among those of an earlier one.
REPLAY_SAMPLES = 16
# Frames of the earlier shot that are compared with a sample pixel by pixel, the nearest in blocks of so many px.
REPLAY_CANDIDATES, REPLAY_BLOCK_PX = 4, 3
# Share of these frames that an earlier shot shows too: a fast ball of a slowed replay is between its places there.
MIN_REPLAY_SHARE = 0.75
# Share of a frame up to which what differs in all frames is a label of the replay, such as its word or a logo. Balls
# that lie elsewhere differ in all frames too, but then another ball moves, or moves otherwise.
MAX_LABEL_SHARE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class ShotIntervals:
    """The S shots of a recording, in order and without overlap."""

    first_frames: NDArray[np.int64]
    """(S,) first frame of each shot."""
    stop_frames: NDArray[np.int64]
    """(S,) frame after the last one of each shot."""
    motion_s: FloatArray
    """(S,) s in which things as small as balls move."""
    replays: NDArray[np.int64]
    """(R, 3) first frame of each replay, the frame after its last one, and the number of the shot that it repeats."""
    views: NDArray[np.int64]
    """(V, 2) first frame of each view, and the frame after its last one; balls that jump divide views too."""
    views_without_table: int = 0
    """Number of views in which no table was found."""

    def __post_init__(self) -> None:
        if self.first_frames.shape != self.stop_frames.shape or np.any(self.stop_frames <= self.first_frames):
            raise ValueError("ShotIntervals.first_frames and stop_frames must both be (S,), each stop after its first")

    def __len__(self) -> int:
        return len(self.first_frames)


@dataclass(slots=True)
class _View:
    """What one pass collects of a view."""

    first: int
    stop: int
    cloth: ByteArray | None = None
    """(h, w) mask of the cloth in the reduced frame; None where there is none."""
    has_table: bool = False
    change: list[float] = field(default_factory=list)
    """Grey levels of change on the cloth of each frame; NaN where there is no cloth."""
    share: list[float] = field(default_factory=list)
    """Share of the cloth that changes."""
    moving: deque[tuple[int, ByteArray]] = field(default_factory=lambda: deque(maxlen=REPLAY_SHOTS * REPLAY_FRAMES))
    """The last frames in which something moves, reduced to half the size of the scan."""


def segment_shots(clip: Clip, progress: Progress = ignore_progress) -> ShotIntervals:
    """Segment a recording into shots. A view without a table contains no shot, nor does one without motion.

    Args:
        clip: the recording.
        progress: is called with the share that has been read, 0 to 1.

    Returns:
        The shots and the replays.
    """
    shots: list[tuple[int, int, float]] = []
    replays: list[tuple[int, int, int]] = []
    recent: deque[tuple[int, list[ByteArray]]] = deque(maxlen=REPLAY_SHOTS)
    views, without_table = list[tuple[int, int]](), 0
    for view in _scan_views(clip, progress):
        without_table += not view.has_table
        parts = _split_at_jumps(clip, view)
        views += parts
        for begin, first, stop in _find_intervals(clip, view, parts) if view.has_table else ():
            shown = _thin_out([image for frame, image in view.moving if first <= frame < stop])
            repeated = [number for number, earlier in recent if is_replay(shown, earlier)]
            begins_so = bool(replays) and replays[-1][0] >= begin and (not shots or shots[-1][0] < begin)
            if not repeated and begins_so:  # a view that begins with a replay is one
                repeated = [replays[-1][2]]
            if repeated:
                replays.append((first, stop, repeated[-1]))
                continue
            recent.append((len(shots), shown))
            shots.append((first, stop, _measure_motion(clip, view, first, stop)))
    spans = np.array([shot[:2] for shot in shots], np.int64).reshape(-1, 2)
    return ShotIntervals(
        spans[:, 0], spans[:, 1], np.array([shot[2] for shot in shots]),
        np.array(replays, np.int64).reshape(-1, 3), np.array(views, np.int64), without_table,
    )  # fmt: skip


def list_shot_spans(clip: Clip, intervals: ShotIntervals) -> list[tuple[int, int, float]]:
    """List the spans of a recording that can be run.

    Args:
        clip: The recording.
        intervals: Its shots.

    Returns:
        First frame, frame after the last one, and s of motion of each shot; without any, the longest view. Empty where
        the recording is one shot as a whole.
    """
    is_one_view = len(intervals.views) == 1 and clip.frame_count == np.ptp(intervals.views)
    if len(intervals) < 2 and not len(intervals.replays) and is_one_view:
        return []
    columns = intervals.first_frames, intervals.stop_frames, intervals.motion_s
    spans = list(zip(*(column.tolist() for column in columns), strict=True))
    longest = max(intervals.views.tolist(), key=lambda view: view[1] - view[0])
    return spans or [(longest[0], longest[1], 0.0)]


def rank_span(begins: float, ends: float, motion_s: float) -> tuple[bool, float]:
    """Return the key by which spans, s, are sorted: the longest first; those without motion come last."""
    return motion_s <= 0, -round(ends - begins, 1)


def _split_at_jumps(clip: Clip, view: _View) -> list[tuple[int, int]]:
    """Split the frames of a view where a ball vanishes from the cloth and another one appears there."""
    borders = [view.first]
    for frame in np.unique(clip.jumps[:, 0]).astype(int).tolist():
        if view.cloth is None or not view.first < frame < view.stop:
            continue
        _, x, y, sign = clip.jumps[clip.jumps[:, 0] == frame].T
        height, width = view.cloth.shape
        is_on_cloth = view.cloth[(y * height).astype(int), (x * width).astype(int)] > 0
        if {-1.0, 1.0} <= set(sign[is_on_cloth]):
            borders.append(frame)
    return list(pairwise([*borders, view.stop]))


def _find_intervals(clip: Clip, view: _View, parts: list[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    """Yield the part of a view and each shot in it; a short part with one of them is the shot as a whole."""
    change = np.full(clip.frame_count, np.nan)
    change[view.first : view.stop] = view.change
    for begin, end in parts:
        change[begin : np.searchsorted(clip.t, clip.t[begin] + COMPARISON_GAP_S)] = np.nan  # compared across a cut
        intervals = find_motion_intervals(clip.t, change, begin, end)
        is_short = clip.t[end - 1] - clip.t[begin] < LONG_RECORDING_S
        for first, stop in [(begin, end)] if is_short and len(intervals) == 1 else intervals:
            yield begin, first, stop


def _measure_motion(clip: Clip, view: _View, first: int, stop: int) -> float:
    """Measure how long, s, things as small as balls move."""
    inside = slice(first - view.first, stop - view.first)
    is_moving = np.nan_to_num(np.array(view.change[inside])) > MIN_MOTION_CHANGE
    is_small = is_moving & (np.array(view.share[inside]) < LARGE_SHARE)
    return float(np.sum(np.diff(clip.t[first:stop], prepend=clip.t[first])[is_small]))


def _thin_out(images: list[ByteArray]) -> list[ByteArray]:
    """Keep at most `REPLAY_FRAMES` images, evenly spread."""
    places = np.unique(np.linspace(0, len(images) - 1, min(len(images), REPLAY_FRAMES)).round().astype(int))
    return [images[k] for k in places]


def is_replay(shown: list[ByteArray], earlier: list[ByteArray]) -> bool:
    """Decide whether frames of a shot are those of an earlier one, at another speed or not.

    Args:
        shown: reduced frames (h, w) in which something moves.
        earlier: those of the earlier shot.

    Returns:
        True where most frames equal one of the earlier shot, in the same order.
    """
    if len(shown) < REPLAY_SAMPLES or len(earlier) < 2 or shown[0].shape != earlier[0].shape:
        return False
    samples = np.linspace(0, len(shown) - 1, REPLAY_SAMPLES).round().astype(int)
    coarse, matches = _reduce_images(earlier), list[int]()
    nearest = [np.argsort(np.abs(coarse - _reduce_images([shown[k]])).sum(axis=1))[:REPLAY_CANDIDATES] for k in samples]
    plain = _mask_overlay([cv2.absdiff(shown[k], earlier[own[0]]) for k, own in zip(samples, nearest, strict=True)])
    for k, own in zip(samples, nearest, strict=True):
        changes = [measure_nth_largest(cv2.bitwise_and(cv2.absdiff(shown[k], earlier[one]), plain)) for one in own]
        if min(changes) < MIN_MOTION_CHANGE:
            matches.append(int(own[int(np.argmin(changes))]))
    if len(matches) < MIN_REPLAY_SHARE * REPLAY_SAMPLES:
        return False
    return bool(np.mean(np.diff(matches) >= 0) >= MIN_REPLAY_SHARE)


def _mask_overlay(differences: list[ByteArray]) -> ByteArray:
    """Mask (h, w) of the pixels without a label that a replay has in all of its frames: 255, and 0 in the label."""
    label = (np.min(differences, axis=0) > MIN_MOTION_CHANGE).astype(np.uint8)
    if label.mean() > MAX_LABEL_SHARE:
        label[:] = 0
    return np.asarray(255 * (1 - cv2.dilate(label, np.ones((3, 3), np.uint8))), np.uint8)


def _reduce_images(images: list[ByteArray]) -> NDArray[np.int16]:
    """Reduce images to columns of blocks (N, K) that still show where balls are."""
    height, width = images[0].shape
    size = max(width // REPLAY_BLOCK_PX, 1), max(height // REPLAY_BLOCK_PX, 1)
    return np.array([cv2.resize(image, size, interpolation=cv2.INTER_AREA).ravel() for image in images], np.int16)


def find_motion_intervals(t: FloatArray, change: FloatArray, begin: int, end: int) -> list[tuple[int, int]]:
    """Find the intervals of motion within frames [begin, end), extended by stillness.

    Args:
        t: (T,) s, presentation times.
        change: (T,) grey levels of change on the cloth; NaN where there is no cloth.
        begin: first frame to consider.
        end: frame after the last one to consider.

    Returns:
        Intervals [first, stop) of frames, in order and without overlap.
    """
    moving = begin + np.flatnonzero(change[begin:end] > MIN_MOTION_CHANGE)
    if not len(moving):
        return []
    parts = np.split(moving, np.flatnonzero(np.diff(t[moving]) > MIN_STILLNESS_S) + 1)
    intervals = [
        (t[part[0]] - COMPARISON_GAP_S, t[part[-1]]) for part in parts if t[part[-1]] - t[part[0]] >= MIN_MOTION_S
    ]
    padded = []
    for k, (start, stop) in enumerate(intervals):
        least = (intervals[k - 1][1] + start) / 2 if k else -np.inf
        most = (stop + intervals[k + 1][0]) / 2 if k + 1 < len(intervals) else np.inf
        first, to = np.searchsorted(t, [max(start - MARGIN_S, least), min(stop + MARGIN_S, most)])
        padded.append((int(max(first, begin)), int(min(to + 1, end))))
    return [(a, min(b, c)) for (a, b), (c, _) in pairwise([*padded, (end, end)])]


def _scan_views(clip: Clip, progress: Progress) -> Iterator[_View]:
    """Read all views once. A view that begins like one with a table is of the same camera, and shows the same table."""
    cameras: deque[tuple[ByteArray, ByteArray]] = deque(maxlen=MAX_CAMERAS)
    number = np.full(clip.frame_count, -1)
    for k, (first, stop) in enumerate(clip.views.tolist()):
        number[first:stop] = k
    frames = np.flatnonzero(number >= 0)
    for k, group in groupby(read_frames(clip, indices=frames), key=lambda one: int(number[one[0]])):
        view, images = _View(*clip.views[k].tolist()), iter(group)
        first = next(images)
        begin = _downscale_frame(first[1])
        same = next((cloth for image, cloth in cameras if _is_one_camera(begin, image)), None)
        view.cloth, view.has_table = same, same is not None
        _scan_view(clip, view, chain([first], images))
        if same is None and view.has_table and view.cloth is not None:
            cameras.append((begin, view.cloth))
        progress(view.stop / clip.frame_count)
        yield view


def _is_one_camera(image: ByteArray, other: ByteArray) -> bool:
    """Return whether two reduced frames show one table from one place: only balls and people differ."""
    difference = cv2.absdiff(*(cv2.GaussianBlur(one, (0, 0), SAME_CAMERA_BLUR_PX) for one in (image, other)))
    return bool(np.mean(difference.max(axis=2) < SAME_CAMERA_CHANGE) >= SAME_CAMERA_SHARE)


def _scan_view(clip: Clip, view: _View, images: Iterator[tuple[int, ByteArray]]) -> None:
    """Measure the changes on the cloth of a view, and search its table."""
    recent = deque[tuple[float, ByteArray]]()
    tries, next_try = TABLE_TRIES, -np.inf
    for frame, image in images:
        t, small = float(clip.t[frame]), _downscale_frame(image)
        if not view.has_table and tries and t >= next_try:
            tries, next_try = tries - 1, t + TABLE_TRY_S
            view.cloth = _cloth_mask(small) if view.cloth is None else view.cloth
            view.has_table = view.cloth is not None and _has_table(image)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.uint8)
        while len(recent) > 1 and t - recent[1][0] >= COMPARISON_GAP_S:
            recent.popleft()
        change, share = np.nan, 0.0
        if view.cloth is not None and recent:
            difference = cv2.absdiff(recent[0][1], grey)[view.cloth > 0]
            change, share = measure_nth_largest(difference), float(np.mean(difference > MIN_MOTION_CHANGE))
        view.change.append(change)
        view.share.append(share)
        if view.cloth is not None and change > MIN_MOTION_CHANGE:
            half = cv2.resize(cv2.bitwise_and(grey, view.cloth), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            view.moving.append((frame, half.astype(np.uint8, copy=False)))
        recent.append((t, grey))


def _has_table(image: ByteArray) -> bool:
    """Whether a table can be located in a frame."""
    try:
        locate_table(image)
    except TableNotFound:
        return False
    return True


def _downscale_frame(image: ByteArray) -> ByteArray:
    height, width = image.shape[:2]
    if height <= SCAN_HEIGHT_PX:
        return image
    size = (max(width * SCAN_HEIGHT_PX // height, 1), SCAN_HEIGHT_PX)
    small: ByteArray = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small


def _cloth_mask(image: ByteArray) -> ByteArray | None:
    """Mask (H, W) of the cloth; None where the frame shows no table."""
    regions = find_cloth_regions(image, 1)
    if not regions:
        return None
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, regions[0].corners.round().astype(np.int32), 255)
    return mask
