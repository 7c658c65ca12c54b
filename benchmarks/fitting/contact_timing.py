"""Compare errors of fitted contact times with the Cramer-Rao bound and with interpolation, and with the bends of paths.

    python -m benchmarks.fitting.contact_timing [--quick] [--seeds N] [--truth DIR]

Truth: worlds/billiards.py, run as a process (fixed steps, Alciatore's ball friction). Closing speed about 1 m/s along
the line of centres, 1 mm noise per axis, frames within 0.3 s of the contact. The bound is computed for every contact
from the exact Fisher information of the samples with these unknowns: both paths, restitution, friction between the
balls, sliding and rolling friction, and the spin of sliding balls. Ball size, equal masses and conservation of momentum
are given. A second bound takes only time, position, direction and velocities as unknown. `--seeds 2` takes a quarter of
a minute.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline, make_interp_spline

from benchmarks.fitting.ball_pairs import (
    GRAVITY,
    LENGTH,
    WIDTH,
    Meeting,
    R,
    Truth,
    film_pair,
    overhead_scene,
    simulate_meetings,
)
from benchmarks.fitting.path_bends import measure_bends
from benchmarks.support.figures import (
    Figure,
    add_quick_option,
    estimate_rms,
    estimate_share,
    estimate_statistic,
    run_quick,
)
from models.core.contact_graph import ClothFriction
from models.core.tracks import Tracks
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

RATES, QUICK_RATES = (30, 60, 240), (30, 60)
QUICK_SEEDS = 10
NOISE, CLOSING = 1e-3, 1.0
# Step of the central differences for the Fisher information.
FISHER_STEP = 1e-6


def draw_isolated(rng: np.random.Generator) -> Meeting:
    """Draw a rolling ball that hits a resting one, at cut angles of up to 55 degrees."""
    n = _unit_vector(rng.uniform(0, 2 * np.pi))
    across = np.tan(np.radians(rng.uniform(-55, 55)))
    v = np.array([CLOSING * (n + across * _turn_left(n)), np.zeros(2)])
    return _make_meeting(n, v, np.zeros((2, 2)), rng)


def draw_both_moving(rng: np.random.Generator) -> Meeting:
    """Draw two rolling balls, the second at 0.2 to 0.8 m/s in any direction."""
    n = _unit_vector(rng.uniform(0, 2 * np.pi))
    second = rng.uniform(0.2, 0.8) * _unit_vector(rng.uniform(0, 2 * np.pi))
    first = second + CLOSING * (n + rng.uniform(-0.8, 0.8) * _turn_left(n))
    return _make_meeting(n, np.array([first, second]), np.zeros((2, 2)), rng)


def draw_sliding(rng: np.random.Generator) -> Meeting:
    """Draw a sliding ball, from backspin to overspin, that hits a resting one."""
    n = _unit_vector(rng.uniform(0, 2 * np.pi))
    v = CLOSING * (n + np.tan(np.radians(rng.uniform(-45, 45))) * _turn_left(n))
    slip = rng.choice([-0.4, 0.3, 0.8, 1.4]) * v + 0.1 * rng.normal(size=2)
    return _make_meeting(n, np.array([v, np.zeros(2)]), np.array([slip, np.zeros(2)]), rng)


def _make_meeting(n: np.ndarray, v: np.ndarray, slip: np.ndarray, rng: np.random.Generator) -> Meeting:
    middle = np.array([LENGTH / 2, WIDTH / 2])
    x = middle + R * np.array([-n, n])
    return Meeting(x, v, slip, rng.uniform(0.16, 0.24), rng.uniform(0.007, 0.013), rng.uniform(0.93, 0.97))


def _unit_vector(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def _turn_left(n: np.ndarray) -> np.ndarray:
    return np.array([-n[1], n[0]])


# Functions that draw meetings, and the goal of the fit as a multiple of the bound.
CASES: dict[str, tuple[Callable[[np.random.Generator], Meeting], float]] = {
    "one at rest": (draw_isolated, 1.3),
    "both moving": (draw_both_moving, 1.7),
    "sliding": (draw_sliding, 1.7),
}


def paths_at(p: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return both paths, flat, as a function of the parameters p.

    p holds time, position and direction of the contact, velocities, e, friction impulses between the balls across and
    up (shares of the normal one), ln mu_s, ln mu_r and slips.
    """
    n, slips = _unit_vector(p[3]), p[13:17].reshape(2, 2)
    v, friction = p[4:8].reshape(2, 2), ClothFriction(float(np.exp(p[11])), float(np.exp(p[12])))
    normal = (1 + p[8]) / 2 * ((v[0] - v[1]) @ n)
    push, spun = normal * (n + p[9] * _turn_left(n)), 2.5 * normal * p[10] * n
    earlier = t < p[0]
    paths = []
    for ball, sign in enumerate((-1, 1)):
        x = p[1:3] + (0 if ball == 0 else 2 * R) * n
        speed, slip = np.hypot(*v[ball]), np.hypot(*slips[ball])
        a = -friction.sliding * GRAVITY * slips[ball] / slip if slip > 0 else np.zeros(2)
        if slip == 0 and speed > 0:
            a = -friction.rolling * GRAVITY * v[ball] / speed
        tau = (t[earlier] - p[0])[:, None]
        change = sign * push
        state = np.concatenate([x, v[ball] + change, slips[ball] + change + spun, np.zeros(2)])
        tau_after = t[~earlier] - p[0]
        after = evaluate_kinematics(np.repeat(state[None], len(tau_after), axis=0), tau_after, friction)[:, :2]
        paths.append(np.concatenate([x + v[ball] * tau + a * tau**2 / 2, after]))
    return np.concatenate(paths).ravel()


def timing_bound(meeting: Meeting, truth: Truth, t: np.ndarray, physics_known: bool = False) -> float:
    """Return the least standard deviation of the contact time, s: (F^-1)[0, 0]^(1/2), Kay 1993, eq. 3.21.

    With `physics_known`, only the contact's time, position and direction and the velocities are unknown.
    """
    n = (meeting.x[1] - meeting.x[0]) / (2 * R)
    p = np.concatenate(
        [[truth.contact], meeting.x[0], [np.arctan2(n[1], n[0])], meeting.v.ravel(), [meeting.e, 0.02, 0.02],
         np.log([meeting.mu_s, meeting.mu_r]), meeting.slip.ravel()]
    )  # fmt: skip
    moves, slides = np.hypot(*meeting.v.T) > 0, np.hypot(*meeting.slip.T) > 0
    free = [*range(4), *(4 + k for k in range(4) if moves[k // 2])]
    if not physics_known:
        free += [*range(8, 13), *(13 + k for k in range(4) if slides[k // 2])]
    slope = []
    for k in free:
        step = np.zeros(len(p))
        step[k] = FISHER_STEP
        slope.append((paths_at(p + step, t) - paths_at(p - step, t)) / (2 * FISHER_STEP))
    jacobian = np.array(slope).T / NOISE
    return float(np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[0, 0]))


def fit_contact_time(tracks: Tracks) -> tuple[float, float, float]:
    """Fit the contact time of a and b, its sigma and how far it is from the bends of the paths, s.

    NaN without a detected contact. The paths are sampled and rounded as in trajectory.csv.
    """
    fit = view_shot(explain(tracks, overhead_scene()))
    events, t = fit.events, np.arange(round(tracks.t[0] * 1000), round(tracks.t[-1] * 1000) + 1) / 1000
    rows = [k for k, kind in enumerate(events.kind) if kind == "ball"]
    if not rows:
        return np.nan, np.nan, np.nan
    bends = measure_bends(events, t, np.round(fit.trajectory.at(t).xy, 6), tracks.ids)[rows[0]]
    return float(events.t[rows[0]]), float(events.t_sigma[rows[0]]), float(np.fmax(*np.abs(bends)))


RIVALS: dict[str, Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]]] = {
    "linear": lambda t, x: make_interp_spline(t, x, k=1),
    "cubic": lambda t, x: CubicSpline(t, x, bc_type="not-a-knot"),
    "Akima": lambda t, x: Akima1DInterpolator(t, x),
}


def interpolate_contact(name: str, tracks: Tracks) -> float:
    """Return when two interpolated paths first come within two radii, else when they are nearest, s."""
    curve = RIVALS[name](tracks.t, tracks.xy.reshape(len(tracks.t), 4))
    t = np.arange(tracks.t[0], tracks.t[-1], 2e-5)
    xy = curve(t)
    gap = np.hypot(xy[:, 2] - xy[:, 0], xy[:, 3] - xy[:, 1]) - 2 * R
    inside = np.flatnonzero(gap < 0)
    return float(t[inside[0] if len(inside) else np.argmin(gap)])


@dataclass(frozen=True)
class ContactErrors:
    """Errors of contact times and their bounds, one row per meeting, ms; NaN without a detected contact."""

    fit: np.ndarray
    pull: np.ndarray
    """Error divided by its stated sigma."""
    bend: np.ndarray
    """Largest distance from the bend of a path; NaN where none can be measured."""
    bound: np.ndarray
    bound_with_known_physics: np.ndarray
    rivals: dict[str, np.ndarray]

    @property
    def is_found(self) -> np.ndarray:
        return np.isfinite(self.fit)


def measure_errors(meetings: list[Meeting], truths: list[Truth], fps: int) -> ContactErrors:
    rows = []
    for seed, (meeting, truth) in enumerate(zip(meetings, truths, strict=True)):
        tracks = film_pair(truth, fps, np.random.default_rng([seed, fps]), noise=NOISE)
        estimate, sigma, bend = fit_contact_time(tracks)
        bounds = (timing_bound(meeting, truth, tracks.t, known) for known in (False, True))
        rivals = (interpolate_contact(name, tracks) - truth.contact for name in RIVALS)
        error = estimate - truth.contact
        rows.append([error, error / sigma, bend, *bounds, *rivals])
    fit, pull, bend, bound, informed, *rivals = np.array(rows).T
    return ContactErrors(
        1e3 * fit, pull, 1e3 * bend, 1e3 * bound, 1e3 * informed,
        {k: 1e3 * e for k, e in zip(RIVALS, rivals, strict=True)},
    )  # fmt: skip


def format_row(case: str, fps: int, goal: float, errors: ContactErrors) -> str:
    found = errors.is_found
    fit, least, informed = (
        _root_mean_square(e[found]) for e in (errors.fit, errors.bound, errors.bound_with_known_physics)
    )
    cells = [
        case, str(fps), f"{found.sum()}/{len(found)}", f"{informed:.3f}", f"{least:.3f}", f"{fit:.3f}",
        f"{fit / least:.2f} (<= {goal})", f"{errors.fit[found].mean():+.3f}",
        f"{_root_mean_square(errors.pull[found]):.2f}", f"{np.nanmax(errors.bend):.4f}",
        *(f"{_root_mean_square(e[found]):.2f}" for e in errors.rivals.values()),
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


def _root_mean_square(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def measure_figures(folder: Path) -> list[Figure]:
    """Measure the figures of the documentation, all cases together."""
    meetings = [
        draw(np.random.default_rng([number, seed]))
        for number, (draw, _) in enumerate(CASES.values()) for seed in range(QUICK_SEEDS)
    ]  # fmt: skip
    truths = simulate_meetings(meetings, folder)
    figures = []
    for fps in QUICK_RATES:
        errors = measure_errors(meetings, truths, fps)
        found = errors.is_found
        fit, bound = errors.fit[found], errors.bound[found]
        figures += [
            estimate_share(f"{fps} fps: contacts found", int(found.sum()), len(found)),
            estimate_rms(f"{fps} fps: fit", fit, "ms"),
            estimate_statistic(
                f"{fps} fps: fit over bound", np.column_stack([fit, bound]), "",
                lambda x: _root_mean_square(x[:, 0]) / _root_mean_square(x[:, 1]),
            ),
            estimate_rms(f"{fps} fps: error over stated sigma", errors.pull[found], ""),
            estimate_rms(f"{fps} fps: distance from the bend of the path", errors.bend[np.isfinite(errors.bend)], "ms"),
            *(estimate_rms(f"{fps} fps: {name} interpolation", e[found], "ms") for name, e in errors.rivals.items()),
        ]  # fmt: skip
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--seeds", type=int, default=60, help="contacts per row of the table")
    parser.add_argument("--truth", type=Path, default=Path(tempfile.gettempdir()) / "trueroll_pairs",
                        help="folder in which simulated shots are kept")  # fmt: skip
    arguments = parser.parse_args()
    if arguments.quick:
        cases = f"{', '.join(CASES)}, seeds 0 to {QUICK_SEEDS - 1} of each"
        with tempfile.TemporaryDirectory() as fresh:  # the truth of this code
            run_quick("fitting.contact_timing", lambda: measure_figures(Path(fresh)), cases)
        return
    head = (
        "contact",
        "fps",
        "found",
        "bound, physics known ms",
        "bound ms",
        "fit RMS ms",
        "over bound",
        "bias ms",
        "RMS error/sigma",
        "largest distance from bend ms",
        *RIVALS,
    )
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for number, (case, (draw, goal)) in enumerate(CASES.items()):
        meetings = [draw(np.random.default_rng([number, seed])) for seed in range(arguments.seeds)]
        truths = simulate_meetings(meetings, arguments.truth)
        for fps in RATES:
            print(format_row(case, fps, goal, measure_errors(meetings, truths, fps)), flush=True)


if __name__ == "__main__":
    main()
