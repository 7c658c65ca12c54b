"""Places of a clip that a person should check: where the explanation is least sure or a track most likely wrong.

The selection yields codes and values; `reporting.text.check_sentences` has the words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import MIN_LISTED_PROBABILITY, SURE_PROBABILITY, Fit, Moment
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray

# Why a place is worth a look: several causes remain; no cause is known; a ball moves when it is first detected; a track
# has a gap; a track ends while its ball moves; no accepted fit; a detection far from the path; two balls that may be
# exchanged.
CheckCode = Literal[
    "undecided", "unexplained", "moving_at_start", "gap", "lost", "unfitted", "outlier", "identity"
]  # fmt: skip
# Places of the list.
MAX_PLACES = 10
# Frames within which two places of the same ball, or of balls that meet there, are one.
MERGE_FRAMES = 2
# Missed frames of a moving ball that need no check.
MAX_GAP_FRAMES = 2
# Of a ball that moves from the first frame on, and of one that is first detected later. Guesses.
START_UNCERTAINTY, LATE_UNCERTAINTY = 0.3, 0.6
# Missed frames, and s without an accepted fit, at which the uncertainty is 0.5. Guesses.
HALF_GAP_FRAMES, HALF_UNFITTED_S = 10.0, 0.3
# Factor of the uncertainty of a gap that an accepted fit bridges. Guess.
BRIDGED_SHARE = 0.5
# Least distance of an outlier from the path: standard deviations of all residuals, and ball radii. Guesses.
OUTLIER_SIGMAS, OUTLIER_RADII = 6.0, 0.5
# Distance of two centres, ball radii, below which two balls that are not detected may be exchanged: their surfaces are
# within a radius.
PASSING_RADII = 3.0
# Uncertainty of a pair of very different and of the same colour, and the scale of CIE L*a*b* between. Guesses.
UNLIKE_UNCERTAINTY, LIKE_UNCERTAINTY, COLOUR_SCALE = 0.3, 0.7, 20.0


@dataclass(frozen=True, slots=True)
class CheckReason:
    """One reason to check a place."""

    code: CheckCode
    balls: tuple[str, ...]
    """The ball concerned, then the others that take part."""
    t: float
    """s."""
    xy: FloatArray
    """(2,) m, place of the ball; NaN where it is unknown."""
    uncertainty: float
    """0 to 1: of a moment, the probability that its most probable cause is wrong; of a track, a guess on the same
    scale."""
    value: float = float("nan")
    """Missed frames of `undecided`, `unexplained`, `gap` and `lost`; end of `unfitted`, s; distance from the path of
    `outlier`, m."""
    missed_ball: str = ""
    """Ball with these missed frames at a moment; empty if all were detected."""
    moment: Moment | None = None
    """The moment of `undecided` and `unexplained`."""


@dataclass(frozen=True, slots=True)
class CheckPlace:
    """One place to check."""

    frame: int
    """Nearest frame."""
    t: float
    """s."""
    balls: tuple[str, ...]
    """The ball concerned, then the others that take part."""
    xy: FloatArray
    """(2,) m; NaN where it is unknown."""
    reasons: tuple[CheckReason, ...]
    """All reasons, the main one first."""

    @property
    def uncertainty(self) -> float:
        """Uncertainty of the main reason, 0 to 1."""
        return self.reasons[0].uncertainty


def select_check_places(tracks: Tracks, fit: Fit, table: Table) -> list[CheckPlace]:
    """Select the places where the explanation is least sure, or a track most likely wrong.

    Args:
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.

    Returns:
        At most `MAX_PLACES` places, the most uncertain first; each ball has one place within `MERGE_FRAMES`.
    """
    if not len(tracks.t):
        return []
    fitted = fit.trajectory.at(tracks.t).xy
    reasons = [
        *_find_unsure_moments(tracks, fit),
        *_find_moving_starts(tracks, fit),
        *_find_gaps(tracks, fit, fitted, table.ball_radius),
        *_find_unfitted_motion(tracks, fit, fitted),
        *_find_outliers(tracks, fit, table.ball_radius),
        *_find_possible_exchanges(tracks, fit, fitted, table.ball_radius),
    ]
    places: list[CheckPlace] = []
    for reason in sorted(reasons, key=lambda one: (-one.uncertainty, one.t, one.balls)):
        frame = int(tracks.frame[np.argmin(np.abs(tracks.t - reason.t))])
        # its ball takes part there, or the reverse, at about the same time
        near = [k for k, place in enumerate(places) if abs(place.frame - frame) <= MERGE_FRAMES]
        joined = (k for k in near if reason.balls[0] in places[k].balls or places[k].balls[0] in reason.balls)
        same = next(joined, None)
        if same is None:
            places.append(CheckPlace(frame, reason.t, reason.balls, reason.xy, (reason,)))
        else:
            places[same] = replace(places[same], reasons=(*places[same].reasons, reason))
    return places[:MAX_PLACES]


def _find_unsure_moments(tracks: Tracks, fit: Fit) -> list[CheckReason]:
    """Find the moments whose cause is not decided, or not known."""
    interval = float(np.median(np.diff(tracks.t))) if len(tracks.t) > 1 else 0.0
    reasons = []
    for moment in fit.explanation.moments:
        if {one.cause for one in moment.hypotheses} <= {"rest", "none"}:
            continue  # a ball that does not rest yet is no alternative to look for: its time has an error
        causes = [one.probability for one in moment.hypotheses if one.cause != "unexplained"]
        uncertainty = 1 - max([*causes, _probability_of_contacts_by_others(fit, moment, interval)])
        if uncertainty <= 1 - SURE_PROBABILITY + 1e-9:
            continue
        partners = [
            one.other for one in moment.hypotheses if one.cause == "ball" and one.probability >= MIN_LISTED_PROBABILITY
        ]
        balls = tuple(dict.fromkeys((moment.ball, *partners)))
        missed = {name: _count_missed_frames(tracks, name, moment.t) for name in balls if name in tracks.ids}
        most = max(missed, key=lambda name: missed[name], default="")
        is_decided = moment.best.cause == "unexplained" and moment.best.probability > SURE_PROBABILITY
        frames = missed.get(most, 0)
        reasons.append(
            CheckReason(
                "unexplained" if is_decided else "undecided", balls, moment.t, moment.xy, uncertainty, float(frames),
                most if frames else "", moment,
            )
        )  # fmt: skip
    return reasons


def _probability_of_contacts_by_others(fit: Fit, moment: Moment, interval: float) -> float:
    """Return the largest probability of a contact with the ball of a moment that a moment of another ball has.

    The contact of two balls is a moment of one of them; a moment of the other ball holds its rivals only.
    """
    return max(
        (p for other in fit.explanation.moments if other.ball != moment.ball and abs(other.t - moment.t) <= interval
         for p in [one.probability for one in other.hypotheses if one.cause == "ball" and one.other == moment.ball]),
        default=0.0,
    )  # fmt: skip


def _count_missed_frames(tracks: Tracks, ball: str, t: float) -> int:
    """Count the frames around t (s) between the last and the next detection of a ball."""
    rows = np.flatnonzero(tracks.is_observed[:, tracks.ids.index(ball)])
    after = int(np.searchsorted(tracks.t[rows], t))
    return int(rows[after] - rows[after - 1]) - 1 if 0 < after < len(rows) else 0


def _find_moving_starts(tracks: Tracks, fit: Fit) -> list[CheckReason]:
    """Find the balls that move when they are first detected."""
    reasons = []
    for name in fit.explanation.moving_at_start:
        ball = tracks.ids.index(name)
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        if len(rows):
            uncertainty = START_UNCERTAINTY if rows[0] == 0 else LATE_UNCERTAINTY
            t, xy = float(tracks.t[rows[0]]), tracks.xy[rows[0], ball]
            reasons.append(CheckReason("moving_at_start", (name,), t, xy, uncertainty))
    return reasons


def _find_gaps(tracks: Tracks, fit: Fit, fitted: FloatArray, radius: float) -> list[CheckReason]:
    """Find the long gaps of tracks of moving balls, and tracks that end while their ball moves.

    `fitted` (T, N, 2) m are the fitted positions.
    """
    pocketed = {ball for kind, ball in zip(fit.events.kind, fit.events.a, strict=True) if kind == "pocket"}
    reasons = []
    for ball, name in enumerate(tracks.ids):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        for before, after in pairwise(rows):
            missed = int(after - before) - 1
            way = float(np.linalg.norm(tracks.xy[after, ball] - tracks.xy[before, ball]))
            if missed <= MAX_GAP_FRAMES or not (fit.moving[before + 1 : after, ball].any() or way > radius):
                continue
            share = BRIDGED_SHARE if fit.accepted[before + 1 : after, ball].all() else 1.0
            middle = int(before + after) // 2
            xy = fitted[middle, ball]
            xy = xy if np.isfinite(xy).all() else (tracks.xy[before, ball] + tracks.xy[after, ball]) / 2
            uncertainty = share * missed / (missed + HALF_GAP_FRAMES)
            reasons.append(CheckReason("gap", (name,), float(tracks.t[middle]), xy, uncertainty, float(missed)))
        missed = len(tracks.t) - 1 - int(rows[-1]) if len(rows) else 0
        if missed > MAX_GAP_FRAMES and fit.moving[rows[-1], ball] and name not in pocketed:
            uncertainty = missed / (missed + HALF_GAP_FRAMES)
            t, xy = float(tracks.t[rows[-1]]), tracks.xy[rows[-1], ball]
            reasons.append(CheckReason("lost", (name,), t, xy, uncertainty, float(missed)))
    return reasons


def _find_unfitted_motion(tracks: Tracks, fit: Fit, fitted: FloatArray) -> list[CheckReason]:
    """Find the motion that no accepted fit explains: `fitted` (T, N, 2) m follows the measurements there."""
    reasons = []
    for ball, name in enumerate(tracks.ids):
        for run in _split_runs(np.flatnonzero(fit.moving[:, ball] & ~fit.accepted[:, ball])):
            start, end = float(tracks.t[run[0]]), float(tracks.t[min(run[-1] + 1, len(tracks.t) - 1)])
            uncertainty = (end - start) / (end - start + HALF_UNFITTED_S)
            reasons.append(CheckReason("unfitted", (name,), start, fitted[run[0], ball], uncertainty, end))
    return reasons


def _find_outliers(tracks: Tracks, fit: Fit, radius: float) -> list[CheckReason]:
    """Find the detections far from the fitted path."""
    distance = np.linalg.norm(fit.residual, axis=2)
    deviation = np.linalg.norm(np.einsum("tnij,tnj->tni", tracks.whitening, fit.residual), axis=2)
    valid = np.isfinite(deviation) & np.isfinite(distance)
    if not valid.any():
        return []
    scale = max(float(np.median(deviation[valid])) / np.sqrt(2 * np.log(2)), 1.0)
    is_far = valid & (np.nan_to_num(deviation) > OUTLIER_SIGMAS * scale)
    is_far &= np.nan_to_num(distance) > OUTLIER_RADII * radius
    reasons = []
    for ball, name in enumerate(tracks.ids):
        for run in _split_runs(np.flatnonzero(is_far[:, ball])):
            row = int(run[np.argmax(distance[run, ball])])
            far = float(distance[row, ball])
            reasons.append(
                CheckReason("outlier", (name,), float(tracks.t[row]), tracks.xy[row, ball], far / (far + radius), far)
            )
    return reasons


def _find_possible_exchanges(tracks: Tracks, fit: Fit, fitted: FloatArray, radius: float) -> list[CheckReason]:
    """Find the pairs of balls that pass each other closely while neither is detected, so that they may be exchanged."""
    before = np.logical_or.accumulate(tracks.is_observed, axis=0)
    after = np.logical_or.accumulate(tracks.is_observed[::-1], axis=0)[::-1]
    is_hidden = ~tracks.is_observed & before & after
    reasons = []
    for one, two in combinations(range(len(tracks.ids)), 2):
        distance = np.linalg.norm(fitted[:, one] - fitted[:, two], axis=1)
        is_near = np.nan_to_num(distance, nan=np.inf) < PASSING_RADII * radius
        is_near &= is_hidden[:, one] & is_hidden[:, two] & (fit.moving[:, one] | fit.moving[:, two])
        for run in _split_runs(np.flatnonzero(is_near)):
            row = int(run[np.argmin(distance[run])])
            difference = float(np.linalg.norm(tracks.colour[one] - tracks.colour[two]))
            likeness = np.exp(-difference / COLOUR_SCALE) if np.isfinite(difference) else 1.0
            uncertainty = float(UNLIKE_UNCERTAINTY + (LIKE_UNCERTAINTY - UNLIKE_UNCERTAINTY) * likeness)
            xy = (fitted[row, one] + fitted[row, two]) / 2
            names = (tracks.ids[one], tracks.ids[two])
            reasons.append(CheckReason("identity", names, float(tracks.t[row]), xy, uncertainty))
    return reasons


def _split_runs(rows: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Split ascending rows into runs, which are more than `MERGE_FRAMES` apart."""
    return [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > MERGE_FRAMES) + 1) if len(run)]
