"""What is motion and what is jitter, before a track is told as a story."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray
from models.estimation.segmentation.track_segmentation import Samples, Segment, SpanStart, fit_span

SETTLED = 0.15
"""m/s: a ball that is slower before it stands has rolled out rather than been stopped."""
STILL = 0.12
"""ball radii: a ball that stays within is at rest, whatever its jitter."""
AWAY, BACK = 1.0, 0.25
"""ball radii: a ball that goes no farther from its place, and is so near to it again later, never left it."""
MOST_NUDGED = 3
"""parts of a track in which a ball rests, is nudged, and rests again."""
PROGRESS = 2.5
"""times its own scatter: a ball that stays within one radius must get on by so much to have moved."""
SET_OFF = 0.3
"""m/s: a ball that leaves its rest so fast was hit, by a cue or by a ball that had been."""
MOVES_OF_ITSELF = 6.0
"""chi2 by which a ball may rest worse than it would roll, before another one could have sent it off."""
BREAK = 20.0
"""chi2 that a break of a track pays, as `models.core.options.FitOptions.break_price`."""


def tidy(samples: Samples, segments: list[Segment], radius: float) -> list[Segment]:
    """Balls that only jitter rest; single samples move; a moving ball that rolls out takes its rest along."""
    if len(segments) > MOST_NUDGED and _never_left(samples, radius):
        return [Segment(0, len(samples.t) - 1, True)]
    named = []
    for part in segments:
        lone = part.last == part.first and _seen_leaving(samples, part, radius)
        named.append(Segment(part.first, part.last, not lone and (part.static or _still(samples, part, radius))))
    named = _returned(samples, named, radius)
    joined = [named[0]]
    for part in named[1:]:
        last = joined[-1]
        both = last.static and part.static
        rolled_out = part.static and not last.static and _end_speed(samples, last) < SETTLED
        if both or rolled_out:
            joined[-1] = Segment(last.first, part.last, both)
        else:
            joined.append(part)
    return joined


def resting_until_hit(samples: list[Samples], segments: list[list[Segment]]) -> list[list[Segment]]:
    """Segments of balls that were told to move before any ball set off, cut where one did.

    A ball of a rack that rolls a few centimetres after a break is told well enough as one that rolls from the
    beginning of the clip on; but nothing moves before the cue comes.
    """
    moments = sorted(
        float(seen.t[parts[0].last])
        for seen, parts in zip(samples, segments, strict=True)
        if len(parts) > 1 and parts[0].static and not parts[1].static and _start_speed(seen, parts[1]) > SET_OFF
    )
    if not moments:
        return segments
    return [_rested(seen, parts, moments) for seen, parts in zip(samples, segments, strict=True)]


def _rested(samples: Samples, parts: list[Segment], moments: list[float]) -> list[Segment]:
    """Parts of a track, at rest until one of the moments (s) if that tells it as well."""
    best, cost = parts, 0.0
    if not parts or (parts[0].static and samples.t[parts[0].last] >= moments[0]):
        return parts
    for first in sorted({int(np.searchsorted(samples.t, moment, side="right")) for moment in moments}):
        cut = next((k for k, part in enumerate(parts) if part.first < first <= part.last), None)
        if cut is None or first < 2 or (cut == 0 and parts[0].static):
            continue
        told = sum(curve_of(samples, part).chi2 for part in parts[: cut + 1]) + cut * BREAK
        rest, gone = Segment(0, first - 1, True), Segment(first, parts[cut].last, parts[cut].static)
        worse = curve_of(samples, rest).chi2 + curve_of(samples, gone).chi2 - told - MOVES_OF_ITSELF
        if worse < cost:
            best, cost = [rest, gone, *parts[cut + 1 :]], worse
    return best


def _start_speed(samples: Samples, part: Segment) -> float:
    """m/s; of a single sample, by the way to it."""
    if part.last > part.first:
        return float(np.hypot(*curve_of(samples, part).velocity(float(samples.t[part.first]))))
    way = samples.xy[part.first] - samples.xy[part.first - 1]
    return float(np.hypot(*way) / (samples.t[part.first] - samples.t[part.first - 1]))


def part_of(samples: Samples, segment: Segment) -> Samples:
    """The samples of a segment."""
    return samples.part(slice(segment.first, segment.last + 1))


def curve_of(samples: Samples, part: Segment) -> SpanStart:
    """The curve through a segment: one place where it rests, else a span."""
    seen = part_of(samples, part)
    if part.static:
        zero = np.zeros(2)
        middle = np.median(seen.xy, axis=0)
        chi2 = ((seen.xy - middle) ** 2 * seen.weight).sum()
        return SpanStart(float(seen.t[0]), middle, zero, zero, zero, 0.0, float(chi2))
    return fit_span(seen, float(seen.t[0]))


def _seen_leaving(samples: Samples, lone: Segment, radius: float) -> bool:
    """Whether a single sample shows motion: between others, or as the last one, far from where the ball was."""
    if lone.first == 0:
        return False
    way = np.linalg.norm(samples.xy[lone.first] - samples.xy[lone.first - 1])
    return lone.last < len(samples.t) - 1 or bool(way > AWAY * radius)


def _never_left(samples: Samples, radius: float) -> bool:
    """Whether a ball ends where it began and is hardly ever seen farther than `AWAY` from there."""
    some = max(len(samples.t) // 5, 1)
    began, ended = (np.median(samples.xy[part], axis=0) for part in (slice(some), slice(-some, None)))
    ways = np.linalg.norm(samples.xy - np.median(samples.xy, axis=0), axis=1)
    return bool(np.linalg.norm(ended - began) < BACK * radius and np.quantile(ways, 0.98) < AWAY * radius)


def _returned(samples: Samples, parts: list[Segment], radius: float) -> list[Segment]:
    """Parts, those between two rests at one place joined with them: no ball goes away and comes back by itself."""
    joined: list[Segment] = []
    k = 0
    while k < len(parts):
        part, k = parts[k], k + 1
        if part.static:
            place = np.median(samples.xy[part.first : part.last + 1], axis=0)
            if not any(before.static for before in joined) and _began_at(samples, place, part.first, radius):
                joined, part = [], Segment(0, part.last, True)
            for later in range(len(parts) - 1, k - 1, -1):
                end = parts[later]
                ways = np.linalg.norm(samples.xy[part.first : end.last + 1] - place, axis=1)
                back = np.linalg.norm(np.median(samples.xy[end.first : end.last + 1], axis=0) - place)
                if end.static and back < BACK * radius and ways.max() < AWAY * radius:
                    part, k = Segment(part.first, end.last, True), later + 1
                    break
        joined.append(part)
    return joined


def _began_at(samples: Samples, place: FloatArray, first: int, radius: float) -> bool:
    """Whether the samples before the first rest begin at its place and stay near: the ball was not on its way there."""
    ways = np.linalg.norm(samples.xy[:first] - place, axis=1)
    return first > 0 and bool(ways[0] < BACK * radius and ways.max() < AWAY * radius)


def _still(samples: Samples, part: Segment, radius: float) -> bool:
    """Whether samples only jitter about one place: within little, or to and fro rather than on."""
    seen = part_of(samples, part)
    few = min(5, max(len(seen.xy) // 3, 1))
    drift = np.linalg.norm(np.median(seen.xy[:few], axis=0) - np.median(seen.xy[-few:], axis=0))
    spread = np.linalg.norm(seen.xy - np.median(seen.xy, axis=0), axis=1)
    if spread.max() > radius:
        return False
    if drift < STILL * radius and np.median(spread) < STILL * radius:
        return True
    if len(seen.t) < 6:
        return False
    rough = seen.xy - fit_span(seen, float(seen.t[0])).at(seen.t)
    scatter = np.sqrt((rough**2).sum() / (len(seen.t) - 3))
    return bool(np.sqrt((spread**2).mean()) < PROGRESS / 2 * scatter)


def _end_speed(samples: Samples, part: Segment) -> float:
    if part.last == part.first:
        return np.inf
    fit = curve_of(samples, part)
    return float(np.hypot(*fit.velocity(float(samples.t[part.last]))))
