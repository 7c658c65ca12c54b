"""Score breaks of sixteen equal balls: identities, contacts and their times, and positions.

    python -m benchmarks.tracking.breaks [--quick] [--seeds 20] [--first 0] [--fps 30] [--noise 1] [--oracle]
        [--pockets] [--truth DIR] [--jobs 2]

The truth is `worlds/billiards.py`, run as a process. A contact counts if it closes faster than 60 mm/s; it is matched
if a contact of the same balls (and cushion) is reported within half a frame. A reported contact is false if there is no
contact faster than 30 mm/s, so that the threshold itself makes none false. The opening is the first 50 ms after the
first contact, one or two frames with twenty contacts; it is scored separately and with the rest. Contacts later than
two frames before the end are left out. Positions are compared between frames, every millisecond while a ball moves
faster than 20 mm/s, with the Akima spline through the same noisy detections with true identities. `--oracle` adds the
best possible fit of the same frames, see `break_oracle.py`. `--quick` adds the trackers of roboflow's kit. Takes half a
minute of CPU per break; the first break on a machine takes a minute longer, because code is compiled.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import Akima1DInterpolator

from benchmarks.support.figures import (
    Figure,
    MissingInputError,
    add_quick_option,
    estimate_count,
    estimate_mean,
    estimate_share,
    keep_recorded,
    run_quick,
)
from benchmarks.tracking import break_oracle
from benchmarks.tracking.break_rivals import track_constant_velocity, track_nearest
from benchmarks.tracking.break_shots import BALLS, HZ, Break, FilmedBreak, film_break, overhead_scene, simulate_break
from benchmarks.tracking.roboflow_trackers import TRACKERS, track_in_environment
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.tracking.build_tracks import build_tracks

# Closing speeds of contacts that must be found, and of contacts that may be reported, m/s.
FAST, SLOW = 0.06, 0.03
# Time after the first ball contact that is scored separately, s.
EARLY_SECONDS = 0.05
# Time around a contact of a ball that counts as near it, s.
NEAR_SECONDS = 0.02
# Least speed at which positions are scored, m/s.
MOVING_SPEED = 0.02

# Breaks whose identities are scored for `--quick`, and number of those that are fitted.
QUICK_SEEDS, QUICK_FITS, QUICK_FPS = range(700, 704), 2, 30.0
# Median of the absolute value of a standard normal number.
NORMAL_MEDIAN = 0.6745
# Negligible noise, px.
SILENT_NOISE = 1e-3


@dataclass(frozen=True, slots=True)
class BreakScore:
    """Scores of one break: counts, errors in ms and mm, CPU seconds."""

    seed: int
    contacts: int
    matched: int
    reported: int
    correct: int
    early: int
    early_matched: int
    early_reported: int
    early_correct: int
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
    """Scores of our model with the true contact graph, with and without noise; errors in ms and mm."""

    seed: int
    contacts: int
    matched: int
    time_ms: float
    stated_ms: float
    """Median time error that the stated sigmas predict."""
    near_mm: float
    near_akima_mm: float
    else_mm: float
    else_akima_mm: float
    silent_time_ms: float
    silent_near_mm: float
    silent_else_mm: float


_Row = TypeVar("_Row", BreakScore, OracleScore)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--seeds", type=int, default=20, help="number of breaks")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--fps", type=float, default=30.0, help="frame rate")
    parser.add_argument("--noise", type=float, default=1.0, help="noise of ball centres, px per axis; a pixel is 2 mm")
    parser.add_argument("--oracle", action="store_true", help="add the best possible fit of the same frames")
    parser.add_argument("--pockets", action="store_true", help="balls may be potted")
    parser.add_argument(
        "--truth", type=Path, default=Path("/tmp/trueroll-breaks"), help="folder in which simulated shots are kept"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of processes")
    arguments = parser.parse_args()
    if arguments.quick:
        seeds = f"seeds {QUICK_SEEDS[0]} to {QUICK_SEEDS[-1]}"
        inputs = f"breaks of 16 equal balls at {QUICK_FPS:g} fps, {seeds}, contacts of the first {QUICK_FITS}"
        with tempfile.TemporaryDirectory() as fresh:  # the truth of this code
            run_quick("tracking.breaks", lambda: measure_figures(Path(fresh)), inputs)
        return
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    work = [(seed, arguments.fps, arguments.noise, arguments.pockets, arguments.truth) for seed in seeds]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        print_head(BreakScore)
        print_medians([print_row(score) for score in pool.map(score_break, *zip(*work, strict=True))])
        if arguments.oracle and not arguments.pockets:
            print_head(OracleScore)
            print_oracle([print_row(score) for score in pool.map(score_oracle, *zip(*work, strict=True))])


def score_break(seed: int, fps: float, noise: float, pockets: bool, truth: Path) -> BreakScore:
    """Film, track, fit and compare one break."""
    shown = simulate_break(seed, truth, pockets)
    filmed = film_break(shown, fps, seed, pockets, noise)
    start = time.process_time()
    tracks = build_tracks(filmed.detections, filmed.frame, filmed.t, overhead_scene(pockets))
    tracked = time.process_time()
    fit = view_shot(explain(tracks, overhead_scene(pockets)))
    fitted = time.process_time()
    owner = find_owners(tracks, filmed)
    contacts = score_contacts(fit, tracks, owner, shown, filmed)
    places = score_positions(fit, tracks, owner, shown, filmed)
    rivals = [count_rival_switches(tracker, filmed) for tracker in (track_nearest, track_constant_velocity)]
    return BreakScore(
        seed, *contacts, count_switches(owner), *rivals, *places, tracked - start, fitted - tracked
    )  # fmt: skip


def measure_figures(truth: Path) -> list[Figure]:
    """Measure the figures of the documentation: contacts of few breaks, identities of more."""
    fitted = [score_break(seed, QUICK_FPS, 1.0, False, truth) for seed in QUICK_SEEDS[:QUICK_FITS]]
    counts = {field.name: sum(getattr(score, field.name) for score in fitted) for field in fields(BreakScore)}
    found, contacts = counts["matched"] + counts["early_matched"], counts["contacts"] + counts["early"]
    correct, reported = counts["correct"] + counts["early_correct"], counts["reported"] + counts["early_reported"]
    filmed = [film_break(simulate_break(seed, truth), QUICK_FPS, seed, False) for seed in QUICK_SEEDS]
    rivals = {"nearest detection": track_nearest, "constant velocity, Hungarian": track_constant_velocity}
    return [
        estimate_share("contacts found", found, contacts),
        estimate_share("contacts found in the opening", counts["early_matched"], counts["early"]),
        estimate_share("reported contacts that are true", correct, reported),
        estimate_count("trueroll: identity switches per break", [count_own_switches(one) for one in filmed], ""),
        *(estimate_count(f"{name}: identity switches per break",
                        [count_rival_switches(tracker, one) for one in filmed], "")
          for name, tracker in rivals.items()),
        *measure_kit(filmed),
    ]  # fmt: skip


def count_own_switches(filmed: FilmedBreak) -> int:
    tracks = build_tracks(filmed.detections, filmed.frame, filmed.t, overhead_scene(False))
    return count_switches(find_owners(tracks, filmed))


def measure_kit(films: list[FilmedBreak]) -> list[Figure]:
    """Measure the trackers of roboflow's kit, each with the size of box that suits these breaks best."""
    switches: dict[tuple[str, float], list[int]] = defaultdict(list)
    missing: dict[tuple[str, float], list[float]] = defaultdict(list)
    for filmed in films:
        d = filmed.detections
        try:
            tracks = track_in_environment(d.centre, d.frame, QUICK_FPS, float(d.radius[0]))
        except MissingInputError as error:
            return [f for name in TRACKERS for f in keep_recorded("tracking.breaks", name, error)]
        for option, track in tracks.items():
            paths = (track[(filmed.ball == ball) & (track >= 0)] for ball in range(BALLS))
            switches[option].append(sum(int(np.count_nonzero(np.diff(path))) for path in paths))
            missing[option].append(100 * float(np.mean(track < 0)))
    figures = []
    for tracker in TRACKERS:
        best = min((o for o in switches if o[0] == tracker), key=lambda o: float(np.mean(switches[o])))
        figures += [
            estimate_count(f"{tracker}: identity switches per break", switches[best], ""),
            estimate_mean(f"{tracker}: detections without a track", missing[best], "%"),
        ]
    return figures


def score_oracle(seed: int, fps: float, noise: float, pockets: bool, truth: Path) -> OracleScore:
    """Fit the true contact graph of one break to the same detections, with and without noise."""
    shown = simulate_break(seed, truth, pockets)
    results = []
    for px in (noise, SILENT_NOISE):
        filmed = film_break(shown, fps, seed, pockets, px)
        fit, tracks = break_oracle.fit_oracle(shown, filmed, EARLY_SECONDS)
        owner = break_oracle.true_owners(filmed)
        contacts, places = (
            score_contacts(fit, tracks, owner, shown, filmed),
            score_positions(fit, tracks, owner, shown, filmed),
        )
        is_contact = np.isin(fit.events.kind, ("ball", "cushion"))
        stated = 1e3 * NORMAL_MEDIAN * float(np.median(fit.events.t_sigma[is_contact]))
        results.append((contacts, places, stated))
    (contacts, places, stated), (silent, still, _) = results
    return OracleScore(seed, *contacts[:2], contacts[-2], stated, *places, silent[-2], still[0], still[2])


def find_owners(tracks: Tracks, filmed: FilmedBreak) -> IntArray:
    """Return the true ball (T, M tracks) of every detection of a track; -1 where there is none."""
    owner = np.full(tracks.is_observed.shape, -1)
    for frame, track in np.argwhere(tracks.is_observed):
        rows = np.flatnonzero(filmed.detections.frame == frame)
        apart = np.linalg.norm(filmed.detections.centre[rows] - tracks.px[frame, track], axis=1)
        owner[frame, track] = filmed.ball[rows[np.argmin(apart)]]
    return owner


def count_switches(owner: IntArray) -> int:
    """Count how often a true ball changes its track; an exchange of two balls counts twice."""
    total = 0
    for ball in range(int(owner.max()) + 1):
        frame, track = np.nonzero(owner == ball)
        total += int(np.count_nonzero(np.diff(track[np.argsort(frame)])))
    return total


def count_rival_switches(tracker: Callable[[list[FloatArray]], list[IntArray]], filmed: FilmedBreak) -> int:
    """Count the identity switches of a tracker without physics, on the same detections in metres."""
    xy = overhead_scene(False).camera.to_table(filmed.detections.centre, overhead_scene(False).table.ball_radius)
    rows = [np.flatnonzero(filmed.detections.frame == frame) for frame in filmed.frame]
    names = tracker([xy[row] for row in rows])
    owner = np.full((len(rows), max(int(name.max()) for name in names if len(name)) + 1), -1)
    for frame, (row, name) in enumerate(zip(rows, names, strict=True)):
        owner[frame, name] = filmed.ball[row]
    return count_switches(owner)


def score_contacts(
    fit: Fit, tracks: Tracks, owner: IntArray, shown: Break, filmed: FilmedBreak
) -> tuple[int, int, int, int, int, int, int, int, float, float]:
    """Return contacts, matched, reported and correct ones, late and early; median and RMS time error, ms."""
    window = 0.5 * float(np.median(np.diff(filmed.t)))
    true_t = shown.t + filmed.strike
    names = [_contact_key(kind, a, b) for kind, a, b in zip(shown.kind, shown.a, shown.b, strict=True)]
    reported = [k for k in range(len(fit.events)) if fit.events.kind[k] in ("ball", "cushion")]
    claims = [_possible_keys(fit, k, tracks, owner) for k in reported]
    pairs = sorted(
        (abs(float(fit.events.t[k] - t)), e, i)
        for i, k in enumerate(reported) for e, t in enumerate(true_t)
        if abs(fit.events.t[k] - t) < window and names[e] in claims[i] and shown.speed[e] > SLOW
    )  # fmt: skip
    match: dict[int, int] = {}
    for _, e, i in pairs:
        if e not in match and i not in match.values():
            match[e] = i
    begins = float(true_t[shown.kind == "ball"].min()) + EARLY_SECONDS
    ends = float(filmed.t[-1]) - 4 * window
    late = (true_t > begins) & (true_t < ends)
    fast = shown.speed > FAST
    times = np.array([fit.events.t[reported[match[e]]] - true_t[e] for e in match if late[e] and fast[e]])
    reported_late = [
        i for i, k in enumerate(reported) if begins < fit.events.t[k] < ends and fit.events.speed[k] > FAST
    ]
    early = fast & (true_t <= begins)
    reported_early = [i for i, k in enumerate(reported) if fit.events.t[k] <= begins and fit.events.speed[k] > FAST]
    return (
        int(np.sum(late & fast)), len(times), len(reported_late), sum(i in match.values() for i in reported_late),
        int(early.sum()), sum(bool(early[e]) for e in match),
        len(reported_early), sum(i in match.values() for i in reported_early),
        1e3 * float(np.median(np.abs(times))) if len(times) else np.nan,
        1e3 * float(np.sqrt(np.mean(times**2))) if len(times) else np.nan,
    )  # fmt: skip


def _contact_key(kind: str, a: str, b: str) -> tuple[str, ...]:
    return tuple(sorted((a, b))) if kind == "ball" else (a, b)


def _possible_keys(fit: Fit, k: int, tracks: Tracks, owner: IntArray) -> set[tuple[str, ...]]:
    """Return the true contacts that an event may mean, by the balls that its tracks follow just before and after it."""
    keys = set()
    for side in (-1, 0):
        around = [_find_ball(tracks, owner, name, float(fit.events.t[k]), side) for name in (fit.events.a[k],)]
        other = fit.events.b[k]
        if fit.events.kind[k] == "ball":
            other = _find_ball(tracks, owner, other, float(fit.events.t[k]), side)
        keys.add(_contact_key(fit.events.kind[k], around[0], other))
    return keys


def _find_ball(tracks: Tracks, owner: IntArray, name: str, t: float, side: int) -> str:
    column = owner[:, tracks.ids.index(name)]
    rows = np.flatnonzero(column >= 0)
    row = rows[np.clip(np.searchsorted(tracks.t[rows], t) + side, 0, len(rows) - 1)]
    return str(column[row])


def score_positions(
    fit: Fit, tracks: Tracks, owner: IntArray, shown: Break, filmed: FilmedBreak
) -> tuple[float, float, float, float]:
    """Return RMS errors per axis, mm: near contacts by the fit and by Akima, then elsewhere; after the first 50 ms."""
    t = filmed.strike + np.arange(len(shown.xy)) / HZ
    first = float(shown.t[shown.kind == "ball"].min()) + EARLY_SECONDS
    chosen = (t > filmed.strike + first) & (t < filmed.t[-1])
    state = fit.trajectory.at(t[chosen]).xy
    truth, fast = shown.xy[chosen], np.linalg.norm(shown.v[chosen], axis=2) > MOVING_SPEED
    ours, akima = np.full_like(truth, np.nan), np.full_like(truth, np.nan)
    measured = overhead_scene(False).camera.to_table(filmed.detections.centre, overhead_scene(False).table.ball_radius)
    near = np.zeros(fast.shape, bool)
    for ball in range(truth.shape[1]):
        rows = np.flatnonzero(filmed.ball == ball)
        times = filmed.t[filmed.detections.frame[rows]]
        akima[:, ball] = Akima1DInterpolator(times, measured[rows])(t[chosen])
        ours[:, ball] = _select_paths(state, t[chosen], tracks, owner == ball)
        for moment in shown.t[((shown.a == str(ball)) | (shown.b == str(ball))) & (shown.speed > SLOW)]:
            near[:, ball] |= np.abs(t[chosen] - filmed.strike - moment) < NEAR_SECONDS
    is_scored = fast & shown.on_table[chosen] & np.isfinite(akima[..., 0]) & np.isfinite(ours[..., 0])
    return tuple(
        1e3 * float(np.sqrt(np.mean((paths - truth)[is_scored & where] ** 2))) if np.any(is_scored & where) else np.nan
        for where in (near, ~near) for paths in (ours, akima)
    )  # type: ignore[return-value]  # fmt: skip


def _select_paths(state: FloatArray, t: FloatArray, tracks: Tracks, mine: NDArray[np.bool_]) -> FloatArray:
    """Return positions (M, 2) of one true ball, from the track that follows it in the nearest frame."""
    frame, track = np.nonzero(mine)
    if not len(frame):
        return np.full((len(t), 2), np.nan)
    order = np.argsort(frame)
    times, track = tracks.t[frame[order]], track[order]
    right = np.clip(np.searchsorted(times, t), 1, len(times) - 1) if len(times) > 1 else np.zeros(len(t), np.int64)
    nearest_row = right - (t - times[right - 1] < times[right] - t)
    return state[np.arange(len(t)), track[nearest_row]]


def print_head(kind: type[BreakScore] | type[OracleScore]) -> None:
    names = [field.name for field in fields(kind)]
    print("\n| " + " | ".join(names) + " |\n|" + "---|" * len(names), flush=True)


def print_row(score: _Row) -> _Row:
    """Print one row and return it."""
    print("| " + " | ".join(_format_cell(getattr(score, field.name)) for field in fields(score)) + " |", flush=True)
    return score


def print_oracle(scores: list[OracleScore]) -> None:
    names = [field.name for field in fields(OracleScore)]
    column = {name: np.array([getattr(score, name) for score in scores], dtype=np.float64) for name in names}
    print(f"\nthe oracle: medians of {len(scores)} breaks; pooled in brackets")
    for name, values, pooled in (
        ("matched within half a frame", column["matched"] / np.maximum(column["contacts"], 1),
         column["matched"].sum() / column["contacts"].sum()),
        ("time error, ms", column["time_ms"], np.nanmean(column["time_ms"])),
        ("time error that the stated sigmas predict, ms", column["stated_ms"], np.nanmean(column["stated_ms"])),
        ("time error without noise, ms", column["silent_time_ms"], np.nanmean(column["silent_time_ms"])),
        ("near contacts over Akima", *_error_ratio(column["near_mm"], column["near_akima_mm"])),
        ("elsewhere over Akima", *_error_ratio(column["else_mm"], column["else_akima_mm"])),
        ("near contacts without noise over Akima with it",
         *_error_ratio(column["silent_near_mm"], column["near_akima_mm"])),
        ("elsewhere without noise over Akima with it",
         *_error_ratio(column["silent_else_mm"], column["else_akima_mm"])),
    ):  # fmt: skip
        print(f"{name}: {np.nanmedian(values):.3g} ({pooled:.3g})")


def _error_ratio(ours: FloatArray, theirs: FloatArray) -> tuple[FloatArray, float]:
    """Return ratios of RMS errors (S,), and the ratio of the pooled RMS errors."""
    return ours / theirs, float(np.sqrt(np.nanmean(ours**2) / np.nanmean(theirs**2)))


def print_medians(scores: list[BreakScore]) -> None:
    names = [field.name for field in fields(BreakScore)]
    column = {name: np.array([getattr(score, name) for score in scores], dtype=np.float64) for name in names}
    recall = column["matched"] / np.maximum(column["contacts"], 1)
    precision = column["correct"] / np.maximum(column["reported"], 1)
    print(f"\nmedians of {len(scores)} breaks; pooled in brackets")
    for name, values, pooled in (
        ("recall after the opening", recall, column["matched"].sum() / column["contacts"].sum()),
        ("precision after the opening", precision, column["correct"].sum() / column["reported"].sum()),
        ("recall in the opening", column["early_matched"] / column["early"],
         column["early_matched"].sum() / column["early"].sum()),
        ("precision in the opening", column["early_correct"] / np.maximum(column["early_reported"], 1),
         column["early_correct"].sum() / column["early_reported"].sum()),
        ("recall of all", (column["matched"] + column["early_matched"]) / (column["contacts"] + column["early"]),
         (column["matched"] + column["early_matched"]).sum() / (column["contacts"] + column["early"]).sum()),
        ("precision of all",
         (column["correct"] + column["early_correct"]) / (column["reported"] + column["early_reported"]),
         (column["correct"] + column["early_correct"]).sum() / (column["reported"] + column["early_reported"]).sum()),
        ("time error, ms", column["time_ms"], np.nanmean(column["time_ms"])),
        ("near contacts over Akima", *_error_ratio(column["near_mm"], column["near_akima_mm"])),
        ("elsewhere over Akima", *_error_ratio(column["else_mm"], column["else_akima_mm"])),
        ("switches", column["switches"], column["switches"].mean()),
        ("switches, nearest", column["nearest"], column["nearest"].mean()),
        ("switches, constant velocity", column["velocity"], column["velocity"].mean()),
        ("CPU s, association", column["track_s"], column["track_s"].mean()),
        ("CPU s, fit", column["fit_s"], column["fit_s"].mean()),
    ):  # fmt: skip
        print(f"{name}: {np.nanmedian(values):.3g} ({pooled:.3g})")


def _format_cell(value: float) -> str:
    return f"{value:d}" if isinstance(value, int) else f"{value:.2f}"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
