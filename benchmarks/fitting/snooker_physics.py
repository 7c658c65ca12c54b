"""Estimate cloth friction from the snooker clips, and predict with it where balls stop.

    python -m benchmarks.fitting.snooker_physics [-o DIR] [--reuse]

Needs the footage of ../shared/data; takes some minutes. Prints rolling and sliding friction with errors, pooled and per
path, for a level and for a tilted table; then rest positions predicted from the first third of each shot with the
friction of the other clips, beside rivals without physics. A ball is not predicted if it meets something later, or if
fewer than three frames show it after its last contact. With starts marked by hand, the authors of the footage missed
rest positions by 12 to 32 mm.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.fitting.free_paths import (
    WINDOW_LENGTH,
    FreePath,
    FreePaths,
    cloth_priors,
    extract_free_paths,
    predict_rest_position,
)
from benchmarks.support.run_folder_tracks import FilmedClip, measure_noise, parse_clip_arguments, read_filmed_clips
from models.core.events import Events
from models.estimation.multiple_shooting.shooting_fit import ShootingFit, convert_to_priors, fit_windows
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

# Paths shorter than this do not constrain friction, m.
LEAST_MOTION = 0.02
# Prior standard deviation of the slope of a level table, mm/m.
LEVEL_SLOPE_SIGMA = 1e-3
# Candidate unevenness of the cloth, m/s^2.
UNEVENNESS_CANDIDATES = (0.006, 0.012, 0.02)
# Candidate factors on the sigmas of the tracks, which include errors that are constant along a path.
NOISE_FACTORS = (0.3, 0.4, 0.6)
# Time before a rest from which a ball is within a millimetre of its rest position, s.
REST_SECONDS = 0.1
# Least number of samples after the last contact for a prediction.
LEAST_SAMPLES = 3


@dataclass(frozen=True)
class SnookerShot:
    """One clip, its events and its free paths."""

    clip: FilmedClip
    events: Events
    paths: tuple[FreePath, ...]


def read_shots(folder: Path, reuse: bool) -> Iterator[SnookerShot]:
    for number, clip in enumerate(read_filmed_clips("snooker", folder, reuse)):
        events = view_shot(explain(clip.tracks, clip.scene)).events
        tracks = measure_noise(clip.tracks, clip.scene.table.ball_radius)
        yield SnookerShot(clip, events, extract_free_paths(tracks, events, number, LEAST_MOTION))


def select_cloth(paths: tuple[FreePath, ...], slope: float) -> tuple[FreePaths, ShootingFit]:
    """Select unevenness and noise by the evidence of the paths; returns the model and its fit."""
    count = 2 * sum(len(path.t) for path in paths)
    candidates = []
    for rough in UNEVENNESS_CANDIDATES:
        for noise in NOISE_FACTORS:
            cloth = FreePaths(paths, rough, slope, noise)
            fit = fit_windows(cloth)
            candidates.append((fit.log_evidence - count * np.log(noise), cloth, fit))
    _, cloth, fit = max(candidates, key=lambda one: one[0])
    return cloth, fit


def short_name(shot: SnookerShot) -> str:
    return shot.clip.name.removeprefix("snooker_").replace("gleitreibungskoeffizient", "gleit")


def _format_clock_offset(shot: SnookerShot) -> str:
    return (
        f"{short_name(shot)} {1000 * np.ptp(shot.clip.clock.capture_time - shot.clip.clock.presentation_time):.0f} ms"
    )


def format_estimate(value: float, sigma: float, prior_only: bool, digits: int) -> str:
    return f"{value:.{digits}f} +- {sigma:.{digits}f}" + (" (prior)" if prior_only else "")


def print_row(name: str, fit: ShootingFit, paths: int) -> None:
    s, sigma, only = fit.shared, fit.sigma, fit.prior_only
    cells = [format_estimate(s[1], sigma[1], only[1], 4), format_estimate(s[0], sigma[0], only[0], 3)]
    cells += [format_estimate(s[k], sigma[k], only[k], 1) if sigma[k] > 2 * LEVEL_SLOPE_SIGMA else "-" for k in (2, 3)]
    print(f"| {name} | {paths} | {' | '.join(cells)} | {fit.chi2_per_dof:.2f} | {fit.inflation:.1f} |")


def print_friction(shots: list[SnookerShot]) -> FreePaths:
    """Print friction, pooled and per path; returns the cloth that the evidence prefers."""
    paths = tuple(path for shot in shots for path in shot.paths)
    cloths = {"level table": select_cloth(paths, LEVEL_SLOPE_SIGMA), "tilted table": select_cloth(paths, 2.0)}
    print("\n## Friction of the cloth (decelerations mu g)\n")
    print("| paths | number | rolling mu | sliding mu | slope_x mm/m | slope_y mm/m | chi2/dof | variance x |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (cloth, fit) in cloths.items():
        print_row(f"all, {name}", fit, len(cloth.paths))
    level = cloths["level table"][0]
    ways = []
    for name, sign in (("towards -x, level", -1), ("towards +x, level", 1)):
        chosen = tuple(p for p in paths if sign * (p.xy[-1] - p.xy[0])[0] > 0.5 * np.linalg.norm(p.xy[-1] - p.xy[0]))
        ways.append(fit_windows(replace(level, paths=chosen)))
        print_row(name, ways[-1], len(chosen))
    singles = []
    for shot in shots:
        for path in shot.paths:
            way = (path.xy[-1] - path.xy[0]) * 1000
            name = f"{short_name(shot)} {path.ball} ({way[0]:+.0f}, {way[1]:+.0f}) mm"
            singles.append(fit_windows(replace(level, paths=(path,))))
            print_row(name, singles[-1], 1)
    apart, error = ways[1].shared[1] - ways[0].shared[1], float(np.hypot(ways[0].sigma[1], ways[1].sigma[1]))
    print(f"\nrolling friction towards +x less that towards -x (slope, nap, a bad path): {apart:+.4f} +- {error:.4f}")
    print_scatter([(fit.shared[1], fit.sigma[1]) for fit in singles if not fit.prior_only[1]])
    gain = cloths["tilted table"][1].log_evidence - cloths["level table"][1].log_evidence
    same = cloths["tilted table"][0].noise == level.noise
    print(f"\nlog evidence of a tilted table over a level one: {gain:+.1f}" + ("" if same else " (other noise)"))
    for name, (cloth, _) in cloths.items():
        print(f"{name}: unevenness {cloth.unevenness:g} m/s^2 per {WINDOW_LENGTH:g} s, "
              f"noise {cloth.noise:g} of the tracks' sigma")  # fmt: skip
    print(
        "capture times deviate from presentation times by up to "
        + ", ".join(_format_clock_offset(shot) for shot in shots)
    )
    return cloths["tilted table"][0] if gain > 0 else level


def print_scatter(single: list[tuple[float, float]]) -> None:
    """Print the scatter of rolling friction between paths beyond their errors, and the mean that includes it.

    Source: DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2.
    """
    mu, sigma = np.array(single).T
    weight = 1 / sigma**2
    chi2, free = float(weight @ (mu - np.average(mu, weights=weight)) ** 2), len(mu) - 1
    beyond = max(chi2 - free, 0.0) / (weight.sum() - (weight**2).sum() / weight.sum())
    weight = 1 / (sigma**2 + beyond)
    mean, sigma_of_mean = np.average(mu, weights=weight), weight.sum() ** -0.5
    print(f"rolling friction of the {len(mu)} paths that constrain it: {mean:.4f} +- {sigma_of_mean:.4f}, "
          f"scatter beyond their errors {beyond**0.5:.4f} (chi2 {chi2:.0f} of {free})")  # fmt: skip


def extrapolate_rest(path: FreePath) -> np.ndarray:
    """Extrapolate the rest position with the constant deceleration of a parabola fitted to the samples."""
    t = path.t - path.t[0]
    a, v, x = np.polyfit(t, path.xy, 2)
    speed = float(np.hypot(*(v + 2 * a * t[-1])))
    slow = float(-(2 * a) @ (v + 2 * a * t[-1])) / max(speed, 1e-9)
    now = x + v * t[-1] + a * t[-1] ** 2
    return now + (v + 2 * a * t[-1]) * speed / (2 * slow) if slow > 0.02 else now


def print_rests(shots: list[SnookerShot], cloth: FreePaths) -> None:
    print("\n## Rests predicted from the first third of each shot, friction from the other clips\n")
    print("| clip | ball | frames since its last contact | distance to go mm | does not move | constant deceleration "
          "| ours | predicted sigma |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    misses = []
    for number, shot in enumerate(shots):
        others = tuple(path for k, other in enumerate(shots) for path in other.paths if k != number)
        priors = convert_to_priors(cloth_priors(cloth.slope), fit_windows(replace(cloth, paths=others)))
        misses += list(_predict_rests(shot, replace(cloth, priors=priors)))
    table = np.array([miss for miss in misses if miss is not None])
    still, line, ours, predicted = table.T
    print(f"\n{len(table)} of {len(misses)} rests predicted; medians: does not move {np.median(still):.0f} mm, "
          f"constant deceleration {np.median(line):.0f} mm, ours {np.median(ours):.0f} mm")  # fmt: skip
    print(f"ours: RMS {np.sqrt(np.mean(ours**2)):.0f} mm, {np.sqrt(np.mean((ours / predicted) ** 2)):.1f} times the "
          f"predicted sigma per axis (1.4 is correct in two dimensions)")  # fmt: skip
    print("friction and slope come from the other clips; unevenness, noise and tilt model from all of them")
    print("authors of the footage, with a simulator started from marks set by hand: 12 to 32 mm")


def _predict_rests(shot: SnookerShot, cloth: FreePaths) -> Iterator[tuple[float, float, float, float] | None]:
    e = shot.events
    strikes = [float(t) for t, kind in zip(e.t, e.kind, strict=True) if kind == "strike"]
    for t, kind, ball in zip(e.t, e.kind, e.a, strict=True):
        if kind != "rest" or not strikes or t <= strikes[0]:
            continue
        third = strikes[0] + (t - strikes[0]) / 3
        last = [path for path in shot.paths if path.ball == ball]
        column = shot.clip.tracks.ids.index(ball)
        lies = np.flatnonzero(shot.clip.tracks.is_observed[:, column] & (shot.clip.tracks.t > t - REST_SECONDS))[-5:]
        name = f"{short_name(shot)} | {ball}"
        if not last or len(lies) == 0:
            why = f"moves less than {1000 * LEAST_MOTION:.0f} mm" if len(lies) else "not observed at rest"
            print(f"| {name} | {why} | | | | | |")
            yield None
            continue
        path, goal = last[-1], np.median(shot.clip.tracks.xy[lies, column], axis=0)
        early = path.t <= third
        if early.sum() < LEAST_SAMPLES:
            print(f"| {name} | {early.sum()}: a contact comes later | | | | | |")
            yield None
            continue
        early_path = replace(path, t=path.t[early], xy=path.xy[early], whitening=path.whitening[early])
        yield _predict_rest(name, early_path, goal, cloth)


def _predict_rest(
    name: str, early_path: FreePath, goal: np.ndarray, cloth: FreePaths
) -> tuple[float, float, float, float]:
    fit = fit_windows(replace(cloth, paths=(early_path,)))
    model = replace(cloth, paths=(early_path,))
    place = predict_rest_position(fit.starts[0], fit.shared, early_path.spinless)
    sigma = _rest_sigma(fit, model, early_path)
    miss = [1000 * float(np.linalg.norm(p - goal)) for p in (early_path.xy[-1], extrapolate_rest(early_path), place)]
    print(
        f"| {name} | {len(early_path.t)} | {miss[0]:.0f} | {miss[0]:.0f} "
        f"| {miss[1]:.0f} | {miss[2]:.0f} | {sigma:.0f} |"
    )
    return miss[0], miss[1], miss[2], sigma


def _rest_sigma(fit: ShootingFit, model: FreePaths, early_path: FreePath) -> float:
    """Return the predicted sigma of a rest position, mm per axis, from start, friction and unevenness."""
    rng, places = np.random.default_rng(0), []
    roots = [np.linalg.cholesky(c + 1e-15 * np.eye(len(c))) for c in (fit.start_covariances[0], fit.covariance)]
    for _ in range(200):
        start, shared = (
            value + root @ rng.standard_normal(len(value))
            for value, root in zip((fit.starts[0], fit.shared), roots, strict=True)
        )
        low, high = np.array([p.bounds for p in model.unknowns]).T
        places.append(predict_rest_position(start, np.clip(shared, low, high), early_path.spinless))
    return 1000 * float(np.sqrt(np.var(places, axis=0).mean()))


def main() -> int:
    arguments = parse_clip_arguments(__doc__)
    shots = list(read_shots(arguments.out, arguments.reuse))
    cloth = print_friction(shots)
    print_rests(shots, cloth)
    return 0


if __name__ == "__main__":
    sys.exit(main())
