"""Which track is which true ball, and which reported event is which true event."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from benchmarks.stress_cases.shot_truth import ShotTruth, TrueEvent, TruePaths
from benchmarks.stress_cases.stress_chain import FittedShot
from models.core.events import Events
from models.core.typing import FloatArray, IntArray

# Largest distances of a track from the labelled ball, from the labelled place of the contact of the other ball, and
# from a true path, in ball radii.
BALL_RADII, OTHER_RADII, PATH_RADII = 2.5, 3.5, 1.5
# Distance that a wrong ball class, or another track than usual for the name, is worth, in ball radii.
CLASS_RADII, VOTE_RADII = 2.0, 1.0
# Frames before its first and after its last detection at which a track still takes part in events.
PRESENT_FRAMES = 2.0
# Largest distance of a reported from a labelled event whose ball has no track, in ball radii.
PLACE_RADII = 4.0
# Ball classes that a word of a label may mean; the most specific words come first in `ball_class_words`.
CLASSES_OF_WORD = {
    "white": ("cue", "white"), "solid": ("solid",), "stripe": ("stripe",), "red": ("red",), "yellow": ("yellow",),
    "black": ("black", "eight"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class BallMatch:
    """Ids of the tracks of the balls `a` and `b` of every true event (E,), and the true name of every matched track."""

    a: tuple[frozenset[str], ...]
    b: tuple[frozenset[str], ...]
    names: dict[str, str]

    def ids_of(self, name: str) -> frozenset[str]:
        """Return the ids of the tracks of a true ball."""
        return frozenset(track for track, own in self.names.items() if own == name)


def match_balls(truth: ShotTruth, shot: FittedShot) -> BallMatch:
    """Match true balls with tracks: by their paths where these are known, otherwise by the places of the events.

    Args:
        truth: The true events.
        shot: Tracks and fit.

    Returns:
        The match.
    """
    if truth.paths is None:
        return _match_by_places(truth, shot)
    names = _match_by_paths(truth.paths, shot)
    return BallMatch(
        tuple(_select_present(shot, names, event.a, event) for event in truth.events),
        tuple(
            _select_present(shot, names, event.b, event) if event.kind == "ball" else frozenset()
            for event in truth.events
        ),
        names,
    )


def match_events(
    events: Events, truth: ShotTruth, match: BallMatch, kept: IntArray | None, frame_s: float, radius: float
) -> list[int | None]:
    """Match reported events with true ones, each at most once, sure ones first and the nearest in time first.

    Args:
        events: Reported events; those that are undecided may be off by two of their own standard deviations.
        truth: The true events.
        match: Tracks of the true balls.
        kept: Frames that were left when frames were removed; None where none was.
        frame_s: Duration of a frame, s.
        radius: Radius of the balls, m.

    Returns:
        For every reported event, the index of the true one.
    """
    bounds = [widen_bounds(event, kept) for event in truth.events]
    candidates = []
    for k in range(len(events)):
        slack = 2 * events.t_sigma[k] / frame_s if 0.1 < events.probability[k] < 0.9 else 0.0
        for e, event in enumerate(truth.events):
            lo, hi = bounds[e][0] - slack, bounds[e][1] + slack
            if lo <= events.frame[k] <= hi and _agrees(events, k, event, match.a[e], match.b[e], radius):
                distance = abs(events.frame[k] - (lo + hi) / 2)
                candidates.append((event.certainty != "sure", distance, k, e))
    matched: list[int | None] = [None] * len(events)
    taken: set[int] = set()
    for _, _, k, e in sorted(candidates):
        if matched[k] is None and e not in taken:
            matched[k] = e
            taken.add(e)
    return matched


def widen_bounds(event: TrueEvent, kept: IntArray | None) -> tuple[float, float]:
    """Return the frames between which an event counts as found: half a frame more, or the neighbouring kept frames.

    Args:
        event: The true event.
        kept: Frames that were left; None where no frame was removed.

    Returns:
        First and last fractional frame.
    """
    lo, hi = event.lo, event.hi
    if kept is not None:
        before, after = kept[kept <= lo], kept[kept >= hi]
        lo, hi = float(before[-1]) if len(before) else lo, float(after[0]) if len(after) else hi
    return lo - 0.5, hi + 0.5


def _agrees(events: Events, k: int, event: TrueEvent, a: frozenset[str], b: frozenset[str], radius: float) -> bool:
    """Return whether a reported event has the kind and the balls of a true one; the place decides without a track."""
    if events.kind[k] != event.kind:
        return False
    is_near = bool(np.linalg.norm(events.xy[k] - event.xy) <= PLACE_RADII * radius)
    one, other = events.a[k], events.b[k]
    if event.kind != "ball":
        return (one in a if a else is_near) and (event.kind in ("strike", "rest") or other == event.b)
    if not (a and b):
        return is_near and bool(not (a or b) or {one, other} & (a | b))
    return (one in a and other in b) or (one in b and other in a)


def ball_class_words(name: str) -> tuple[str, ...]:
    """Return the ball classes that a labelled name may mean: `green solid (6)` is a solid; empty if it names none."""
    words = name.replace("(", " ").replace("/", " ").split()
    for word, classes in CLASSES_OF_WORD.items():
        if word in words:
            return classes
    return ()


def trace_balls(shot: FittedShot, match: BallMatch) -> TruePaths:
    """Return the observed paths of the matched balls by name, and of all other balls by their ids in brackets.

    Args:
        shot: Tracks of a shot without damage.
        match: Its balls.

    Returns:
        The paths.
    """
    tracks, paths = shot.tracks, dict[str, FloatArray]()
    for k, track in enumerate(tracks.ids):
        name = match.names.get(track, f"[{track}]")
        old = paths.get(name, np.full_like(tracks.xy[:, k], np.nan))
        paths[name] = np.where(np.isfinite(old), old, tracks.xy[:, k])
    return TruePaths(tracks.frame.astype(np.float64), tuple(paths), np.stack(list(paths.values()), axis=1))


def _match_by_paths(paths: TruePaths, shot: FittedShot) -> dict[str, str]:
    """Name every track after the ball that it is nearest to in half of their common frames."""
    tracks, names = shot.tracks, {}
    _, mine, theirs = np.intersect1d(tracks.frame, paths.frame, return_indices=True)
    for k, track in enumerate(tracks.ids):
        away = np.linalg.norm(tracks.xy[mine, k, None] - paths.xy[theirs], axis=2)  # (frames, balls)
        common = np.isfinite(away).sum(axis=0)
        median = [
            np.nanmedian(away[:, n]) if common[n] >= max(1, common.max() / 2) else np.inf for n in range(away.shape[1])
        ]
        if min(median) <= PATH_RADII * shot.recording.scene.table.ball_radius:
            names[track] = paths.names[int(np.argmin(median))]
    return names


def _select_present(shot: FittedShot, names: dict[str, str], name: str, event: TrueEvent) -> frozenset[str]:
    """Return the tracks of a true ball that exist at an event; all of its tracks if none does."""
    tracks, own, present = shot.tracks, [track for track in names if names[track] == name], []
    for track in own:
        seen = tracks.frame[tracks.is_observed[:, tracks.ids.index(track)]]
        if seen[0] - PRESENT_FRAMES <= event.hi and event.lo <= seen[-1] + PRESENT_FRAMES:
            present.append(track)
    return frozenset(present or own)


def _match_by_places(truth: ShotTruth, shot: FittedShot) -> BallMatch:
    """Match the balls of every event with the tracks near its place; a second round prefers the usual track.

    Tracks along the path of a named ball without damage keep that name.
    """
    known = {} if truth.tracked is None else _match_by_paths(truth.tracked, shot)
    known = {track: name for track, name in known.items() if not name.startswith("[")}
    votes: dict[str, Counter[str]] = {}
    a: list[frozenset[str]] = []
    b: list[frozenset[str]] = []
    for _ in range(2):
        a, b, ballots = [], [], dict[str, Counter[str]]()
        for event in truth.events:
            if event.hi < shot.tracks.frame[0]:  # cut away
                a.append(frozenset())
                b.append(frozenset())
                continue
            distance = _distances_in_radii(shot, event)
            distance_of_a, distance_of_b = (
                np.where([known.get(track, name) == name for track in shot.tracks.ids], distance, np.inf)
                for name in (event.a, event.b)
            )
            own = _pick_track(shot, event.a, distance_of_a, BALL_RADII, votes, "")
            other = event.kind == "ball" and _pick_track(shot, event.b, distance_of_b, OTHER_RADII, votes, own)
            a.append(frozenset({own} if own else ()))
            b.append(frozenset({other} if other else ()))
            for name, track in ((event.a, own), (event.b, other)):
                if track:
                    ballots.setdefault(name, Counter())[track] += 1
        votes = ballots
    names: dict[str, tuple[int, str]] = {}
    for name, counts in votes.items():
        for track, count in counts.items():
            names[track] = max(names.get(track, (0, "")), (count, name))
    return BallMatch(tuple(a), tuple(b), {track: name for track, (_, name) in names.items()} | known)


def _pick_track(
    shot: FittedShot,
    name: str,
    distance: FloatArray,
    limit: float,
    votes: dict[str, Counter[str]],
    taken: str | None,
) -> str | None:
    """Pick the nearest track (distance (N,) in radii), where a wrong class or an unusual track counts as distance."""
    classes, usual = ball_class_words(name), votes.get(name)
    costs = []
    for k, track in enumerate(shot.tracks.ids):
        kind = shot.tracks.kinds[k]
        cost = distance[k] + CLASS_RADII * (bool(classes) and kind not in classes and kind != "ball")
        cost += VOTE_RADII * (usual is not None and usual.most_common(1)[0][0] != track)
        if distance[k] <= limit and track != taken:
            costs.append((cost, track))
    return min(costs)[1] if costs else None


def _distances_in_radii(shot: FittedShot, event: TrueEvent) -> FloatArray:
    """Return the least distances (N,) of the fitted and the observed paths from an event while it may happen."""
    tracks = shot.tracks
    frames = np.arange(event.lo - 0.5, event.hi + 0.51, 0.1)
    times = np.interp(frames, tracks.frame, tracks.t)
    places = [shot.fit.trajectory.at(times).xy]
    observed = np.full_like(places[0], np.nan)
    for k in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, k])
        near = rows[np.abs(tracks.frame[rows] - (event.lo + event.hi) / 2) <= (event.hi - event.lo) / 2 + 2]
        if len(near):
            for axis in range(2):
                observed[:, k, axis] = np.interp(frames, tracks.frame[near], tracks.xy[near, k, axis])
    away = np.linalg.norm(np.concatenate([*places, observed]) - event.xy, axis=2)
    return np.asarray(np.nan_to_num(away, nan=np.inf).min(axis=0) / shot.recording.scene.table.ball_radius)
