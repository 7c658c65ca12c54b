"""Breaks of sixteen equal balls, filmed: which ball is which, what met what and when, and how well places are known.

    python benchmarks/breaks.py [--seeds 20] [--first 0] [--fps 30] [--noise 1] [--oracle] [--pockets] [--truth DIR]
                               [--jobs 2]

The truth is `worlds/billiards.py`, run as a process. A contact counts where it closes faster than 60 mm/s; it is found
where one of the same balls (and cushion) is told within half a picture. A told one is false where no contact faster
than 30 mm/s is there, so that the threshold itself condemns none. The burst is the first 50 ms after the first contact:
there a picture or two hold twenty contacts; it is scored apart, then with the rest. Contacts later than two pictures
before the end are left out. Places are compared between pictures, every millisecond while a ball moves faster than
20 mm/s, with the Akima spline through the same noisy detections, rightly named. `--oracle` adds what the same pictures
hold at best, see `break_oracle.py`. The peers' switches were measured on breaks of ten equal balls, with the same noise
and share of missed balls.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import break_oracle
import numpy as np
from break_rivals import constant_velocity, nearest
from break_shots import HZ, Break, Filmed, film, happened, scene
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.reconstruction.fit_shot import fit_shot
from models.tracking.build_tracks import associate

FAST, SLOW = 0.06, 0.03
"""m/s of closing: contacts that have to be found, and contacts that may be told."""
BURST = 0.05
"""s after the first contact of balls."""
NEAR = 0.02
"""s around a contact of a ball that count as near it."""
MOVING = 0.02
"""m/s."""

PEERS = {
    30.0: "norfair 58 (gate 2R) or 7 (80 px), ByteTrack 3 (14 % unassigned), OC-SORT 3, constant velocity 5",
    60.0: "norfair 32 (gate 2R) or 2 (80 px), ByteTrack 5 (14 % unassigned), OC-SORT 1, constant velocity 2",
}
"""Switches of the kits by pictures a second, ten balls."""
NORMAL_MEDIAN = 0.6745
"""Of the absolute value of a standard normal number."""
SILENT = 1e-3
"""px: noise that is none."""


@dataclass(frozen=True, slots=True)
class Score:
    """Of one break; counts, errors in ms and mm, CPU seconds."""

    seed: int
    contacts: int
    found: int
    told: int
    true: int
    burst: int
    burst_found: int
    burst_told: int
    burst_true: int
    time_ms: float
    time_rms_ms: float
    switches: int
    nearest: int
    velocity: int
    near_mm: float
    near_akima_mm: float
    else_mm: float
    else_akima_mm: float
    track_s: float
    fit_s: float


@dataclass(frozen=True, slots=True)
class OracleScore:
    """Of our model told the true story, with the noise of the pictures and with none; errors in ms and mm."""

    seed: int
    contacts: int
    found: int
    time_ms: float
    stated_ms: float
    """Median error of times that its own sigmas promise."""
    near_mm: float
    near_akima_mm: float
    else_mm: float
    else_akima_mm: float
    silent_time_ms: float
    silent_near_mm: float
    silent_else_mm: float


_Row = TypeVar("_Row", Score, OracleScore)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=20, help="how many breaks")
    options.add_argument("--first", type=int, default=0, help="the first seed")
    options.add_argument("--fps", type=float, default=30.0)
    options.add_argument("--noise", type=float, default=1.0, help="of centres, px per axis; a pixel is 2 mm")
    options.add_argument("--oracle", action="store_true", help="what the same pictures hold at best")
    options.add_argument("--pockets", action="store_true", help="balls may be potted")
    options.add_argument("--truth", type=Path, default=Path("/tmp/trueroll-breaks"), help="where the worlds are kept")
    options.add_argument("--jobs", type=int, default=2)
    given = options.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    work = [(seed, given.fps, given.noise, given.pockets, given.truth) for seed in seeds]
    with ProcessPoolExecutor(given.jobs) as pool:
        print_head(Score)
        print_medians([printed(score) for score in pool.map(score_break, *zip(*work, strict=True))])
        if given.fps in PEERS and given.noise == 1.0:
            print(f"switches of kits, ten balls: {PEERS[given.fps]}")
        if given.oracle and not given.pockets:
            print_head(OracleScore)
            print_oracle([printed(score) for score in pool.map(score_oracle, *zip(*work, strict=True))])


def score_break(seed: int, fps: float, noise: float, pockets: bool, truth: Path) -> Score:
    """Film, track, fit and compare one break."""
    shown = happened(seed, truth, pockets)
    filmed = film(shown, fps, seed, pockets, noise)
    start = time.process_time()
    tracks = associate(filmed.detections, filmed.frame, filmed.t, scene(pockets))
    tracked = time.process_time()
    fit = fit_shot(tracks, scene(pockets))
    fitted = time.process_time()
    owner = owners(tracks, filmed)
    contacts = score_contacts(fit, tracks, owner, shown, filmed)
    places = score_places(fit, tracks, owner, shown, filmed)
    rivals = [rival_switches(tracker, filmed) for tracker in (nearest, constant_velocity)]
    return Score(
        seed, *contacts, switches(owner), *rivals, *places, tracked - start, fitted - tracked
    )  # fmt: skip


def score_oracle(seed: int, fps: float, noise: float, pockets: bool, truth: Path) -> OracleScore:
    """Fit the true story of one break to the same sightings, and to the same without noise."""
    shown = happened(seed, truth, pockets)
    found = []
    for px in (noise, SILENT):
        filmed = film(shown, fps, seed, pockets, px)
        fit, tracks = break_oracle.oracle(shown, filmed, BURST)
        owner = break_oracle.owners(filmed)
        contacts, places = (
            score_contacts(fit, tracks, owner, shown, filmed),
            score_places(fit, tracks, owner, shown, filmed),
        )
        told = np.isin(fit.events.kind, ("ball", "cushion"))
        promised = 1e3 * NORMAL_MEDIAN * float(np.median(fit.events.t_sigma[told]))
        found.append((contacts, places, promised))
    (contacts, places, promised), (silent, still, _) = found
    return OracleScore(seed, *contacts[:2], contacts[-2], promised, *places, silent[-2], still[0], still[2])


def owners(tracks: Tracks, filmed: Filmed) -> IntArray:
    """Which true ball (T, M tracks) each sighting of a track is; -1 where it has none."""
    owner = np.full(tracks.observed.shape, -1)
    for picture, track in np.argwhere(tracks.observed):
        rows = np.flatnonzero(filmed.detections.frame == picture)
        apart = np.linalg.norm(filmed.detections.centre[rows] - tracks.px[picture, track], axis=1)
        owner[picture, track] = filmed.ball[rows[np.argmin(apart)]]
    return owner


def switches(owner: IntArray) -> int:
    """How often a true ball is seen in another track than before; an exchange of two balls counts twice."""
    total = 0
    for ball in range(int(owner.max()) + 1):
        picture, track = np.nonzero(owner == ball)
        total += int(np.count_nonzero(np.diff(track[np.argsort(picture)])))
    return total


def rival_switches(tracker: Callable[[list[FloatArray]], list[IntArray]], filmed: Filmed) -> int:
    """`switches` of a tracker without physics, on the same detections in metres."""
    xy = scene(False).camera.to_table(filmed.detections.centre, scene(False).table.ball_radius)
    rows = [np.flatnonzero(filmed.detections.frame == picture) for picture in filmed.frame]
    names = tracker([xy[row] for row in rows])
    owner = np.full((len(rows), max(int(name.max()) for name in names if len(name)) + 1), -1)
    for picture, (row, name) in enumerate(zip(rows, names, strict=True)):
        owner[picture, name] = filmed.ball[row]
    return switches(owner)


def score_contacts(
    fit: Fit, tracks: Tracks, owner: IntArray, shown: Break, filmed: Filmed
) -> tuple[int, int, int, int, int, int, int, int, float, float]:
    """Contacts, found, told, true, after the burst and in it; median and RMS error of the times found after it, ms."""
    window = 0.5 * float(np.median(np.diff(filmed.t)))
    happened_at = shown.t + filmed.strike
    names = [_parties(kind, a, b) for kind, a, b in zip(shown.kind, shown.a, shown.b, strict=True)]
    told = [k for k in range(len(fit.events)) if fit.events.kind[k] in ("ball", "cushion")]
    claims = [_claimed(fit, k, tracks, owner) for k in told]
    pairs = sorted(
        (abs(float(fit.events.t[k] - t)), e, i)
        for i, k in enumerate(told) for e, t in enumerate(happened_at)
        if abs(fit.events.t[k] - t) < window and names[e] in claims[i] and shown.speed[e] > SLOW
    )  # fmt: skip
    match: dict[int, int] = {}
    for _, e, i in pairs:
        if e not in match and i not in match.values():
            match[e] = i
    begins = float(happened_at[shown.kind == "ball"].min()) + BURST
    ends = float(filmed.t[-1]) - 4 * window
    late = (happened_at > begins) & (happened_at < ends)
    fast = shown.speed > FAST
    times = np.array([fit.events.t[told[match[e]]] - happened_at[e] for e in match if late[e] and fast[e]])
    sure = [i for i, k in enumerate(told) if begins < fit.events.t[k] < ends and fit.events.speed[k] > FAST]
    burst = fast & (happened_at <= begins)
    sure_burst = [i for i, k in enumerate(told) if fit.events.t[k] <= begins and fit.events.speed[k] > FAST]
    return (
        int(np.sum(late & fast)), len(times), len(sure), sum(i in match.values() for i in sure),
        int(burst.sum()), sum(bool(burst[e]) for e in match),
        len(sure_burst), sum(i in match.values() for i in sure_burst),
        1e3 * float(np.median(np.abs(times))) if len(times) else np.nan,
        1e3 * float(np.sqrt(np.mean(times**2))) if len(times) else np.nan,
    )  # fmt: skip


def _parties(kind: str, a: str, b: str) -> tuple[str, ...]:
    return tuple(sorted((a, b))) if kind == "ball" else (a, b)


def _claimed(fit: Fit, k: int, tracks: Tracks, owner: IntArray) -> set[tuple[str, ...]]:
    """Parties that an event may mean: by the true balls that its tracks follow just before it, or just after."""
    found = set()
    for side in (-1, 0):
        around = [_followed(tracks, owner, name, float(fit.events.t[k]), side) for name in (fit.events.a[k],)]
        other = fit.events.b[k]
        if fit.events.kind[k] == "ball":
            other = _followed(tracks, owner, other, float(fit.events.t[k]), side)
        found.add(_parties(fit.events.kind[k], around[0], other))
    return found


def _followed(tracks: Tracks, owner: IntArray, name: str, t: float, side: int) -> str:
    column = owner[:, tracks.ids.index(name)]
    rows = np.flatnonzero(column >= 0)
    row = rows[np.clip(np.searchsorted(tracks.t[rows], t) + side, 0, len(rows) - 1)]
    return str(column[row])


def score_places(
    fit: Fit, tracks: Tracks, owner: IntArray, shown: Break, filmed: Filmed
) -> tuple[float, float, float, float]:
    """RMS per axis in mm: near contacts of the fit and of Akima, then elsewhere; after the burst, both known there."""
    t = filmed.strike + np.arange(len(shown.xy)) / HZ
    first = float(shown.t[shown.kind == "ball"].min()) + BURST
    chosen = (t > filmed.strike + first) & (t < filmed.t[-1])
    state = fit.trajectory.at(t[chosen]).xy
    truth, fast = shown.xy[chosen], np.linalg.norm(shown.v[chosen], axis=2) > MOVING
    ours, akima = np.full_like(truth, np.nan), np.full_like(truth, np.nan)
    seen = scene(False).camera.to_table(filmed.detections.centre, scene(False).table.ball_radius)
    near = np.zeros(fast.shape, bool)
    for ball in range(truth.shape[1]):
        rows = np.flatnonzero(filmed.ball == ball)
        times = filmed.t[filmed.detections.frame[rows]]
        akima[:, ball] = Akima1DInterpolator(times, seen[rows])(t[chosen])
        ours[:, ball] = _followed_paths(state, t[chosen], tracks, owner == ball)
        for moment in shown.t[((shown.a == str(ball)) | (shown.b == str(ball))) & (shown.speed > SLOW)]:
            near[:, ball] |= np.abs(t[chosen] - filmed.strike - moment) < NEAR
    known = fast & shown.on_table[chosen] & np.isfinite(akima[..., 0]) & np.isfinite(ours[..., 0])
    return tuple(
        1e3 * float(np.sqrt(np.mean((paths - truth)[known & where] ** 2))) if np.any(known & where) else np.nan
        for where in (near, ~near) for paths in (ours, akima)
    )  # type: ignore[return-value]  # fmt: skip


def _followed_paths(state: FloatArray, t: FloatArray, tracks: Tracks, mine: NDArray[np.bool_]) -> FloatArray:
    """Places (M, 2) of one true ball: of the track that follows it (T, tracks) at the nearest picture."""
    picture, track = np.nonzero(mine)
    if not len(picture):
        return np.full((len(t), 2), np.nan)
    order = np.argsort(picture)
    times, track = tracks.t[picture[order]], track[order]
    right = np.clip(np.searchsorted(times, t), 1, len(times) - 1) if len(times) > 1 else np.zeros(len(t), np.int64)
    nearest_row = right - (t - times[right - 1] < times[right] - t)
    return state[np.arange(len(t)), track[nearest_row]]


def print_head(kind: type[Score] | type[OracleScore]) -> None:
    names = [field.name for field in fields(kind)]
    print("\n| " + " | ".join(names) + " |\n|" + "---|" * len(names), flush=True)


def printed(score: _Row) -> _Row:
    """Print one row as soon as it is known."""
    print("| " + " | ".join(_cell(getattr(score, field.name)) for field in fields(score)) + " |", flush=True)
    return score


def print_oracle(scores: list[OracleScore]) -> None:
    names = [field.name for field in fields(OracleScore)]
    column = {name: np.array([getattr(score, name) for score in scores], dtype=np.float64) for name in names}
    print(f"\nthe oracle: medians of {len(scores)} breaks; pooled in brackets")
    for name, values, pooled in (
        ("told within half a picture", column["found"] / np.maximum(column["contacts"], 1),
         column["found"].sum() / column["contacts"].sum()),
        ("time error, ms", column["time_ms"], np.nanmean(column["time_ms"])),
        ("time error that its sigmas promise, ms", column["stated_ms"], np.nanmean(column["stated_ms"])),
        ("time error without noise, ms", column["silent_time_ms"], np.nanmean(column["silent_time_ms"])),
        ("near contacts over Akima", *_over(column["near_mm"], column["near_akima_mm"])),
        ("elsewhere over Akima", *_over(column["else_mm"], column["else_akima_mm"])),
        ("near contacts without noise over Akima with it", *_over(column["silent_near_mm"], column["near_akima_mm"])),
        ("elsewhere without noise over Akima with it", *_over(column["silent_else_mm"], column["else_akima_mm"])),
    ):  # fmt: skip
        print(f"{name}: {np.nanmedian(values):.3g} ({pooled:.3g})")


def _over(ours: FloatArray, theirs: FloatArray) -> tuple[FloatArray, float]:
    """Ratios of two root mean squares (S,), and of those of all."""
    return ours / theirs, float(np.sqrt(np.nanmean(ours**2) / np.nanmean(theirs**2)))


def print_medians(scores: list[Score]) -> None:
    names = [field.name for field in fields(Score)]
    column = {name: np.array([getattr(score, name) for score in scores], dtype=np.float64) for name in names}
    recall = column["found"] / np.maximum(column["contacts"], 1)
    precision = column["true"] / np.maximum(column["told"], 1)
    print(f"\nmedians of {len(scores)} breaks; pooled in brackets")
    for name, values, pooled in (
        ("recall after the burst", recall, column["found"].sum() / column["contacts"].sum()),
        ("precision after the burst", precision, column["true"].sum() / column["told"].sum()),
        ("recall in the burst", column["burst_found"] / column["burst"],
         column["burst_found"].sum() / column["burst"].sum()),
        ("precision in the burst", column["burst_true"] / np.maximum(column["burst_told"], 1),
         column["burst_true"].sum() / column["burst_told"].sum()),
        ("recall of all", (column["found"] + column["burst_found"]) / (column["contacts"] + column["burst"]),
         (column["found"] + column["burst_found"]).sum() / (column["contacts"] + column["burst"]).sum()),
        ("precision of all", (column["true"] + column["burst_true"]) / (column["told"] + column["burst_told"]),
         (column["true"] + column["burst_true"]).sum() / (column["told"] + column["burst_told"]).sum()),
        ("time error, ms", column["time_ms"], np.nanmean(column["time_ms"])),
        ("near contacts over Akima", *_over(column["near_mm"], column["near_akima_mm"])),
        ("elsewhere over Akima", *_over(column["else_mm"], column["else_akima_mm"])),
        ("switches", column["switches"], column["switches"].mean()),
        ("switches, nearest", column["nearest"], column["nearest"].mean()),
        ("switches, constant velocity", column["velocity"], column["velocity"].mean()),
        ("CPU s, association", column["track_s"], column["track_s"].mean()),
        ("CPU s, fit", column["fit_s"], column["fit_s"].mean()),
    ):  # fmt: skip
        print(f"{name}: {np.nanmedian(values):.3g} ({pooled:.3g})")


def _cell(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.2f}"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
