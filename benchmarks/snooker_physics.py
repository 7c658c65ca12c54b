"""What the snooker clips say of their cloth, and how well it predicts where balls stop.

    python benchmarks/snooker_physics.py [-o DIR] [--reuse]

Rolling and sliding friction with errors, pooled and per path, of a level table and of one that leans; then rest places
predicted from the first third of each shot with the friction of the other clips, beside rivals that know no physics;
a ball that meets something later, or was seen in fewer than three pictures since it did, is not predicted.
The footage's authors missed rests by 12 to 32 mm from starts marked by hand.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from filmed import Filmed, asked_clips, filmed_clips, with_measured_noise

from models.core.events import Events
from models.estimation.multiple_shooting.shooting_fit import Shooting, priors_of, shoot
from models.estimation.reconstruction.fit_shot import fit_shot
from models.estimation.whole_shot.free_paths import PIECE, FreePath, FreePaths, cloth_priors, free_paths, rest_place

MOVED = 0.02
"""m: a path shorter than this tells nothing of friction."""
LEVEL = 1e-3
"""mm/m: prior standard deviation of a slope that is not there."""
ROUGH = (0.006, 0.012, 0.02)
"""m/s^2 of unevenness that are tried."""
NOISE = (0.3, 0.4, 0.6)
"""factors on the sigmas of the tracks that are tried: they hold errors that are the same all along a path."""
AT_REST = 0.1
"""s before a rest from which a ball counts as lying, a millimetre from its place."""
FEW = 3
"""samples after the last contact from which a rest can be predicted."""


@dataclass(frozen=True)
class Shot:
    """One clip, its events and its free paths."""

    clip: Filmed
    events: Events
    paths: tuple[FreePath, ...]


def filmed_shots(folder: Path, reuse: bool) -> Iterator[Shot]:
    for number, clip in enumerate(filmed_clips("snooker", folder, reuse)):
        events = fit_shot(clip.tracks, clip.scene).events
        tracks = with_measured_noise(clip.tracks, clip.scene.table.ball_radius)
        yield Shot(clip, events, free_paths(tracks, events, number, MOVED))


def best_cloth(paths: tuple[FreePath, ...], slope: float) -> tuple[FreePaths, Shooting]:
    """The unevenness and the noise that the paths themselves find most probable, and the fit with them."""
    seen = 2 * sum(len(path.t) for path in paths)
    tried = []
    for rough in ROUGH:
        for noise in NOISE:
            cloth = FreePaths(paths, rough, slope, noise)
            fit = shoot(cloth)
            tried.append((fit.log_evidence - seen * np.log(noise), cloth, fit))
    _, cloth, fit = max(tried, key=lambda one: one[0])
    return cloth, fit


def short(shot: Shot) -> str:
    return shot.clip.name.removeprefix("snooker_").replace("gleitreibungskoeffizient", "gleit")


def _off(shot: Shot) -> str:
    return f"{short(shot)} {1000 * np.ptp(shot.clip.clock.taken - shot.clip.clock.shown):.0f} ms"


def told(value: float, sigma: float, prior_only: bool, digits: int) -> str:
    return f"{value:.{digits}f} +- {sigma:.{digits}f}" + (" (prior)" if prior_only else "")


def row(name: str, fit: Shooting, paths: int) -> None:
    s, sigma, only = fit.shared, fit.sigma, fit.prior_only
    cells = [told(s[1], sigma[1], only[1], 4), told(s[0], sigma[0], only[0], 3)]
    cells += [told(s[k], sigma[k], only[k], 1) if sigma[k] > 2 * LEVEL else "-" for k in (2, 3)]
    print(f"| {name} | {paths} | {' | '.join(cells)} | {fit.chi2_per_dof:.2f} | {fit.inflation:.1f} |")


def print_friction(shots: list[Shot]) -> FreePaths:
    """Pooled and per path; the cloth that the evidence prefers."""
    paths = tuple(path for shot in shots for path in shot.paths)
    cloths = {"level table": best_cloth(paths, LEVEL), "table that leans": best_cloth(paths, 2.0)}
    print("\n## Friction of the cloth (decelerations mu g)\n")
    print("| paths | number | rolling mu | sliding mu | slope_x mm/m | slope_y mm/m | chi2/dof | variance x |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (cloth, fit) in cloths.items():
        row(f"all, {name}", fit, len(cloth.paths))
    level = cloths["level table"][0]
    ways = []
    for name, sign in (("towards -x, level", -1), ("towards +x, level", 1)):
        chosen = tuple(p for p in paths if sign * (p.xy[-1] - p.xy[0])[0] > 0.5 * np.linalg.norm(p.xy[-1] - p.xy[0]))
        ways.append(shoot(replace(level, paths=chosen)))
        row(name, ways[-1], len(chosen))
    singles = []
    for shot in shots:
        for path in shot.paths:
            way = (path.xy[-1] - path.xy[0]) * 1000
            name = f"{short(shot)} {path.ball} ({way[0]:+.0f}, {way[1]:+.0f}) mm"
            singles.append(shoot(replace(level, paths=(path,))))
            row(name, singles[-1], 1)
    apart, error = ways[1].shared[1] - ways[0].shared[1], float(np.hypot(ways[0].sigma[1], ways[1].sigma[1]))
    print(f"\nrolling friction towards +x less that towards -x (slope, nap, a bad path): {apart:+.4f} +- {error:.4f}")
    print_scatter([(fit.shared[1], fit.sigma[1]) for fit in singles if not fit.prior_only[1]])
    gain = cloths["table that leans"][1].log_evidence - cloths["level table"][1].log_evidence
    same = cloths["table that leans"][0].noise == level.noise
    print(f"\nlog evidence of a table that leans over a level one: {gain:+.1f}" + ("" if same else " (other noise)"))
    for name, (cloth, _) in cloths.items():
        print(
            f"{name}: unevenness {cloth.unevenness:g} m/s^2 per {PIECE:g} s, noise {cloth.noise:g} of the tracks' sigma"
        )
    print("pictures show moments off an even time by up to " + ", ".join(_off(shot) for shot in shots))
    return cloths["table that leans"][0] if gain > 0 else level


def print_scatter(single: list[tuple[float, float]]) -> None:
    """Whether single paths agree about rolling friction: scatter beyond their own errors, and the mean that holds it
    (DerSimonian and Laird 1986, doi:10.1016/0197-2456(86)90046-2)."""
    mu, sigma = np.array(single).T
    weight = 1 / sigma**2
    chi2, free = float(weight @ (mu - np.average(mu, weights=weight)) ** 2), len(mu) - 1
    beyond = max(chi2 - free, 0.0) / (weight.sum() - (weight**2).sum() / weight.sum())
    weight = 1 / (sigma**2 + beyond)
    mean, sigma_of_mean = np.average(mu, weights=weight), weight.sum() ** -0.5
    print(f"rolling friction of the {len(mu)} paths that tell one: {mean:.4f} +- {sigma_of_mean:.4f}, "
          f"scatter beyond their errors {beyond**0.5:.4f} (chi2 {chi2:.0f} of {free})")  # fmt: skip


def straight_line(path: FreePath) -> np.ndarray:
    """Rest of a ball that goes on as a parabola fitted to its samples says: constant deceleration."""
    t = path.t - path.t[0]
    a, v, x = np.polyfit(t, path.xy, 2)
    speed = float(np.hypot(*(v + 2 * a * t[-1])))
    slow = float(-(2 * a) @ (v + 2 * a * t[-1])) / max(speed, 1e-9)
    now = x + v * t[-1] + a * t[-1] ** 2
    return now + (v + 2 * a * t[-1]) * speed / (2 * slow) if slow > 0.02 else now


def print_rests(shots: list[Shot], cloth: FreePaths) -> None:
    print("\n## Rests predicted from the first third of each shot, friction from the other clips\n")
    print("| clip | ball | pictures since its last contact | way to go mm | does not move | constant deceleration "
          "| ours | promised sigma |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    misses = []
    for number, shot in enumerate(shots):
        others = tuple(path for k, other in enumerate(shots) for path in other.paths if k != number)
        known = priors_of(cloth_priors(cloth.slope), shoot(replace(cloth, paths=others)))
        misses += list(_rests_of(shot, replace(cloth, known=known)))
    table = np.array([miss for miss in misses if miss is not None])
    still, line, ours, promised = table.T
    print(f"\n{len(table)} of {len(misses)} rests predicted; medians: does not move {np.median(still):.0f} mm, "
          f"constant deceleration {np.median(line):.0f} mm, ours {np.median(ours):.0f} mm")  # fmt: skip
    print(f"ours: RMS {np.sqrt(np.mean(ours**2)):.0f} mm, {np.sqrt(np.mean((ours / promised) ** 2)):.1f} times the "
          f"promised sigma per axis (1.4 is honest in two dimensions)")  # fmt: skip
    print("friction and slope come from the other clips; unevenness, noise and that the table leans from all of them")
    print("the footage's authors, with a simulator started from marks by hand: 12 to 32 mm")


def _rests_of(shot: Shot, cloth: FreePaths) -> Iterator[tuple[float, float, float, float] | None]:
    e = shot.events
    strikes = [float(t) for t, kind in zip(e.t, e.kind, strict=True) if kind == "strike"]
    for t, kind, ball in zip(e.t, e.kind, e.a, strict=True):
        if kind != "rest" or not strikes or t <= strikes[0]:
            continue
        third = strikes[0] + (t - strikes[0]) / 3
        last = [path for path in shot.paths if path.ball == ball]
        column = shot.clip.tracks.ids.index(ball)
        lies = np.flatnonzero(shot.clip.tracks.observed[:, column] & (shot.clip.tracks.t > t - AT_REST))[-5:]
        name = f"{short(shot)} | {ball}"
        if not last or len(lies) == 0:
            why = f"moves less than {1000 * MOVED:.0f} mm" if len(lies) else "not seen at rest"
            print(f"| {name} | {why} | | | | | |")
            yield None
            continue
        path, goal = last[-1], np.median(shot.clip.tracks.xy[lies, column], axis=0)
        early = path.t <= third
        if early.sum() < FEW:
            print(f"| {name} | {early.sum()}: a contact comes later | | | | | |")
            yield None
            continue
        seen = replace(path, t=path.t[early], xy=path.xy[early], whiten=path.whiten[early])
        yield _predicted(name, seen, goal, cloth)


def _predicted(name: str, seen: FreePath, goal: np.ndarray, cloth: FreePaths) -> tuple[float, float, float, float]:
    fit = shoot(replace(cloth, paths=(seen,)))
    model = replace(cloth, paths=(seen,))
    place = rest_place(fit.starts[0], fit.shared, seen.spinless)
    sigma = _promised(fit, model, seen)
    miss = [1000 * float(np.linalg.norm(p - goal)) for p in (seen.xy[-1], straight_line(seen), place)]
    print(f"| {name} | {len(seen.t)} | {miss[0]:.0f} | {miss[0]:.0f} | {miss[1]:.0f} | {miss[2]:.0f} | {sigma:.0f} |")
    return miss[0], miss[1], miss[2], sigma


def _promised(fit: Shooting, model: FreePaths, seen: FreePath) -> float:
    """mm per axis: start, friction and the uneven cloth ahead, one after another."""
    rng, places = np.random.default_rng(0), []
    roots = [np.linalg.cholesky(c + 1e-15 * np.eye(len(c))) for c in (fit.start_covariances[0], fit.covariance)]
    for _ in range(200):
        start, shared = (
            value + root @ rng.standard_normal(len(value))
            for value, root in zip((fit.starts[0], fit.shared), roots, strict=True)
        )
        low, high = np.array([p.bounds for p in model.unknowns]).T
        places.append(rest_place(start, np.clip(shared, low, high), seen.spinless))
    return 1000 * float(np.sqrt(np.var(places, axis=0).mean()))


def main() -> int:
    arguments = asked_clips(__doc__)
    shots = list(filmed_shots(arguments.out, arguments.reuse))
    cloth = print_friction(shots)
    print_rests(shots, cloth)
    return 0


if __name__ == "__main__":
    sys.exit(main())
