"""Distinction of motion and jitter in the parts of a track."""

from __future__ import annotations

import numpy as np

from models.core.options import FitOptions
from models.core.typing import FloatArray
from models.estimation.segmentation.track_segmentation import BallSamples, SampleRange, SegmentFit, fit_segment

# m/s: a ball slower than this before it rests has rolled out rather than been stopped.
SETTLED_SPEED = 0.15
# Ball radii: a ball that stays within rests, whatever its jitter.
STILL_RADII = 0.12
# Ball radii: a ball that goes no farther from its place, and later returns so near to it, never left it.
MAX_AWAY_RADII, MAX_RETURN_RADII = 1.0, 0.25
# Parts of a track in which a ball rests, is nudged, and rests again.
MAX_NUDGED_PARTS = 3
# Multiple of its own scatter by which a ball within one radius must advance to have moved.
MIN_PROGRESS = 2.5
# m/s: a ball that leaves its rest so fast was hit by a cue or a ball.
MIN_DEPARTURE_SPEED = 0.3
# chi2 by which rest may fit worse than rolling, before another ball could have set this one in motion.
MAX_REST_PENALTY = 6.0
# chi2 that a velocity change costs, as usual in the structure search.
BREAK_PENALTY = FitOptions().break_price


def remove_jitter(samples: BallSamples, parts: list[SampleRange], radius: float) -> list[SampleRange]:
    """Classify jitter as rest, single samples as motion, and merge a roll-out with the rest that follows.

    Args:
        samples: Samples of one ball.
        parts: Parts of its track.
        radius: Ball radius, m.

    Returns:
        The corrected parts.
    """
    if len(parts) > MAX_NUDGED_PARTS and _stays_in_place(samples, radius):
        return [SampleRange(0, len(samples.t) - 1, True)]
    classified = []
    for part in parts:
        lone = part.last == part.first and _shows_departure(samples, part, radius)
        classified.append(
            SampleRange(part.first, part.last, not lone and (part.static or _only_jitters(samples, part, radius)))
        )
    classified = _merge_returns(samples, classified, radius)
    joined = [classified[0]]
    for part in classified[1:]:
        last = joined[-1]
        both = last.static and part.static
        rolled_out = part.static and not last.static and _speed_at_end(samples, last) < SETTLED_SPEED
        if both or rolled_out:
            joined[-1] = SampleRange(last.first, part.last, both)
        else:
            joined.append(part)
    return joined


def extend_rest_until_hit(
    samples: list[BallSamples], parts_by_ball: list[list[SampleRange]]
) -> list[list[SampleRange]]:
    """Let balls that seem to move before any departure rest until one of the departures.

    A ball of a rack that rolls a few centimetres after a break fits nearly as well as one that rolls from the start of
    the clip, but nothing moves before the cue strikes.

    Args:
        samples: Samples of N balls.
        parts_by_ball: Parts of each track.

    Returns:
        The corrected parts of each track.
    """
    departure_times = sorted(
        float(ball_samples.t[parts[0].last])
        for ball_samples, parts in zip(samples, parts_by_ball, strict=True)
        if len(parts) > 1
        and parts[0].static
        and not parts[1].static
        and _speed_at_start(ball_samples, parts[1]) > MIN_DEPARTURE_SPEED
    )
    if not departure_times:
        return parts_by_ball
    return [
        _extend_rest(ball_samples, parts, departure_times)
        for ball_samples, parts in zip(samples, parts_by_ball, strict=True)
    ]


def _extend_rest(samples: BallSamples, parts: list[SampleRange], departure_times: list[float]) -> list[SampleRange]:
    """Let a ball rest until one of the departure times (s) if that fits as well."""
    best, cost = parts, 0.0
    if not parts or (parts[0].static and samples.t[parts[0].last] >= departure_times[0]):
        return parts
    for first in sorted({int(np.searchsorted(samples.t, moment, side="right")) for moment in departure_times}):
        cut = next((k for k, part in enumerate(parts) if part.first < first <= part.last), None)
        if cut is None or first < 2 or (cut == 0 and parts[0].static):
            continue
        current_cost = sum(fit_curve(samples, part).chi2 for part in parts[: cut + 1]) + cut * BREAK_PENALTY
        rest, gone = SampleRange(0, first - 1, True), SampleRange(first, parts[cut].last, parts[cut].static)
        worse = fit_curve(samples, rest).chi2 + fit_curve(samples, gone).chi2 - current_cost - MAX_REST_PENALTY
        if worse < cost:
            best, cost = [rest, gone, *parts[cut + 1 :]], worse
    return best


def _speed_at_start(samples: BallSamples, part: SampleRange) -> float:
    """Return the speed at the start of a part, m/s; of a single sample, by the step to it."""
    if part.last > part.first:
        return float(np.hypot(*fit_curve(samples, part).velocity_at(float(samples.t[part.first]))))
    way = samples.xy[part.first] - samples.xy[part.first - 1]
    return float(np.hypot(*way) / (samples.t[part.first] - samples.t[part.first - 1]))


def select_samples(samples: BallSamples, part: SampleRange) -> BallSamples:
    """Select the samples of a part."""
    return samples.select_rows(slice(part.first, part.last + 1))


def fit_curve(samples: BallSamples, part: SampleRange) -> SegmentFit:
    """Fit the curve of a part: one place if it rests, else a segment."""
    selected = select_samples(samples, part)
    if part.static:
        zero = np.zeros(2)
        middle = np.median(selected.xy, axis=0)
        chi2 = ((selected.xy - middle) ** 2 * selected.weight).sum()
        return SegmentFit(float(selected.t[0]), middle, zero, zero, zero, 0.0, float(chi2))
    return fit_segment(selected, float(selected.t[0]))


def _shows_departure(samples: BallSamples, lone: SampleRange, radius: float) -> bool:
    """Return whether a single sample shows motion: between others, or as the last one far from the place before."""
    if lone.first == 0:
        return False
    way = np.linalg.norm(samples.xy[lone.first] - samples.xy[lone.first - 1])
    return lone.last < len(samples.t) - 1 or bool(way > MAX_AWAY_RADII * radius)


def _stays_in_place(samples: BallSamples, radius: float) -> bool:
    """Return whether a ball ends where it began and is hardly ever farther away than `MAX_AWAY_RADII`."""
    count = max(len(samples.t) // 5, 1)
    began, ended = (np.median(samples.xy[part], axis=0) for part in (slice(count), slice(-count, None)))
    distances = np.linalg.norm(samples.xy - np.median(samples.xy, axis=0), axis=1)
    return bool(
        np.linalg.norm(ended - began) < MAX_RETURN_RADII * radius
        and np.quantile(distances, 0.98) < MAX_AWAY_RADII * radius
    )


def _merge_returns(samples: BallSamples, parts: list[SampleRange], radius: float) -> list[SampleRange]:
    """Merge the parts between two rests at one place: no ball goes away and comes back by itself."""
    joined: list[SampleRange] = []
    k = 0
    while k < len(parts):
        part, k = parts[k], k + 1
        if part.static:
            place = np.median(samples.xy[part.first : part.last + 1], axis=0)
            if not any(before.static for before in joined) and _starts_at_place(samples, place, part.first, radius):
                joined, part = [], SampleRange(0, part.last, True)
            for later in range(len(parts) - 1, k - 1, -1):
                end = parts[later]
                distances = np.linalg.norm(samples.xy[part.first : end.last + 1] - place, axis=1)
                back = np.linalg.norm(np.median(samples.xy[end.first : end.last + 1], axis=0) - place)
                if end.static and back < MAX_RETURN_RADII * radius and distances.max() < MAX_AWAY_RADII * radius:
                    part, k = SampleRange(part.first, end.last, True), later + 1
                    break
        joined.append(part)
    return joined


def _starts_at_place(samples: BallSamples, place: FloatArray, first: int, radius: float) -> bool:
    """Return whether the samples before the first rest begin at its place and stay near it."""
    distances = np.linalg.norm(samples.xy[:first] - place, axis=1)
    return first > 0 and bool(distances[0] < MAX_RETURN_RADII * radius and distances.max() < MAX_AWAY_RADII * radius)


def _only_jitters(samples: BallSamples, part: SampleRange, radius: float) -> bool:
    """Return whether samples only jitter about one place: within little, or to and fro rather than on."""
    selected = select_samples(samples, part)
    few = min(5, max(len(selected.xy) // 3, 1))
    drift = np.linalg.norm(np.median(selected.xy[:few], axis=0) - np.median(selected.xy[-few:], axis=0))
    spread = np.linalg.norm(selected.xy - np.median(selected.xy, axis=0), axis=1)
    if spread.max() > radius:
        return False
    if drift < STILL_RADII * radius and np.median(spread) < STILL_RADII * radius:
        return True
    if len(selected.t) < 6:
        return False
    rough = selected.xy - fit_segment(selected, float(selected.t[0])).position_at(selected.t)
    scatter = np.sqrt((rough**2).sum() / (len(selected.t) - 3))
    return bool(np.sqrt((spread**2).mean()) < MIN_PROGRESS / 2 * scatter)


def _speed_at_end(samples: BallSamples, part: SampleRange) -> float:
    """Return the speed at the end of a part, m/s."""
    if part.last == part.first:
        return np.inf
    fit = fit_curve(samples, part)
    return float(np.hypot(*fit.velocity_at(float(samples.t[part.last]))))
