"""Print the published contact models side by side, and compare the thesis' stiff spring with impulses.

    python -m benchmarks.physics.contact_models [--quick] [--plot FILE.png]

Prints three tables, in seconds: the rebounds of every cushion model over angle and spin (e = 0.85, mu = 0.2 at the
cushion and 0.2 on the cloth; the models scale with speed, so 1 m/s represents all speeds); the changes that a spring
of finite stiffness makes in a cut shot; and its changes where three balls touch at once. The plot needs matplotlib
(extra `check`).
"""

from __future__ import annotations

import argparse
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.support.figures import Figure, add_quick_option, run_quick, state_exact
from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_ball import mass_spring
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, stronge

CUSHIONS = {"han_2005": han_2005, "mathavan_2010": mathavan_2010, "stronge": stronge}
RADIUS, MASS = 0.028575, 0.17
# Angles between path and normal, degrees.
ANGLES = (0.0, 20.0, 40.0, 60.0, 75.0)
# Forward roll and side spin, in units of v / R.
SPINS = {"stun": (0.0, 0.0), "roll": (1.0, 0.0), "draw": (-1.0, 0.0), "running": (1.0, -1.0), "check": (1.0, 1.0)}
ROW = 2 * RADIUS * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
# Places (3, 2) of a ball that meets a touching row of two, and the middle of two, m.
WEDGE = 2 * RADIUS * np.array([[-np.cos(np.pi / 6), 0.0], [0.0, 0.5], [0.0, -0.5]])
# Spring stiffnesses, N/m; phenolic balls at 1 m/s are near 2e7.
STIFFNESS = (1e4, 1e5, 1e6, 1e7, 1e8)


def make_parameters(e: float, mu: float, cloth: float) -> FloatArray:
    p = parameter_vector.neutral_parameters()
    p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_MU], p[parameter_vector.SLIDING_MU] = e, mu, cloth
    return p


def simulate_rebound(name: str, degrees: float, roll: float, side: float, p: FloatArray) -> tuple[float, float, float]:
    """Return speed, angle to the normal (degrees) and side spin (v / R) of a ball of 1 m/s after the cushion."""
    vn, vt = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    spin = np.array([-roll * vt, roll * vn, side]) / RADIUS
    after = np.array(CUSHIONS[name].rebound(vn, vt, *spin, RADIUS, MASS, p))
    return float(np.hypot(*after[:2])), float(np.degrees(np.arctan2(after[1], -after[0]))), float(after[4] * RADIUS)


def print_cushions() -> None:
    p = make_parameters(0.85, 0.2, 0.2)
    print("Rebound of a ball of 1 m/s: speed, angle to the normal, side spin R wz\n")
    print(f"{'spin':8} {'angle':>5}  " + "  ".join(f"{name:^20}" for name in CUSHIONS))
    for spin, (roll, side) in SPINS.items():
        for degrees in ANGLES:
            cells = (simulate_rebound(name, degrees, roll, side, p) for name in CUSHIONS)
            row = "  ".join(f"{speed:6.3f} {angle:6.1f} {turn:6.3f}" for speed, angle, turn in cells)
            print(f"{spin:8} {degrees:5.0f}  {row}")


def plot_cushions(path: Path) -> None:
    """Plot angle and speed after the cushion over the angle before it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    p, angles = make_parameters(0.85, 0.2, 0.2), np.linspace(0.0, 80.0, 81)
    figure, axes = plt.subplots(2, len(SPINS), figsize=(15, 6), sharex=True, sharey="row", layout="constrained")
    for column, (spin, (roll, side)) in enumerate(SPINS.items()):
        for name in CUSHIONS:
            curve = np.array([simulate_rebound(name, degrees, roll, side, p) for degrees in angles])
            axes[0, column].plot(angles, curve[:, 1], label=name)
            axes[1, column].plot(angles, curve[:, 0], label=name)
        axes[0, column].plot(angles, angles, "k:", linewidth=0.8)
        axes[0, column].set_title(spin)
        axes[1, column].set_xlabel("angle before (degrees)")
    axes[0, 0].set_ylabel("angle after (degrees)")
    axes[1, 0].set_ylabel("speed after / before")
    axes[0, 0].legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def integrate_springs(
    x: FloatArray, v: FloatArray, stiffness: float, e: float, seconds: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return positions (N, 2) and velocities (N, 2) after `seconds` of spring contacts, and the time in contact, s.

    Chen 2022, eqs 1 to 6, without gravity; a spring acts on overlapping balls and its damper returns e for a pair.
    """
    count = len(x)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    damper = 2 * mass_spring.damping_ratio(max(e, 1e-12)) * np.sqrt(stiffness * MASS / 2)

    def rates(_: float, y: FloatArray) -> FloatArray:
        positions, speeds = y[: 2 * count].reshape(-1, 2), y[2 * count : 4 * count].reshape(-1, 2)
        force, touching = np.zeros((count, 2)), 0.0
        for i, j in pairs:
            offset = positions[j] - positions[i]
            distance = float(np.hypot(*offset))
            if distance < 2 * RADIUS:
                normal = offset / distance
                push = stiffness * (2 * RADIUS - distance) - damper * float((speeds[j] - speeds[i]) @ normal)
                force[i] -= push * normal
                force[j] += push * normal
                touching = 1.0
        return np.concatenate([speeds.ravel(), force.ravel() / MASS, [touching]])

    period = np.pi * np.sqrt(MASS / 2 / stiffness)
    start = np.concatenate([x.ravel(), v.ravel(), [0.0]])
    run = solve_ivp(rates, (0, seconds), start, "DOP853", rtol=1e-9, atol=1e-12, max_step=period / 50)
    end = run.y[:, -1]
    return end[: 2 * count].reshape(-1, 2), end[2 * count : 4 * count].reshape(-1, 2), float(end[-1])


def apply_impulses(x: FloatArray, v: FloatArray, e: float) -> FloatArray:
    """Return velocities (N, 2) after pairwise impulses, the fastest closing pair first, until no pair closes."""
    v = v.copy()
    normals = {
        (i, j): (x[j] - x[i]) / np.hypot(*(x[j] - x[i]))
        for i in range(len(x))
        for j in range(i + 1, len(x))
        if np.hypot(*(x[j] - x[i])) < 2 * RADIUS + 1e-9
    }
    for _ in range(1000):
        closing = {pair: float((v[pair[0]] - v[pair[1]]) @ n) for pair, n in normals.items()}
        (i, j), speed = max(closing.items(), key=lambda item: item[1])
        if speed < 1e-9:
            break
        push = 0.5 * (1 + e) * speed * normals[i, j]
        v[i] -= push
        v[j] += push
    return v


def measure_cut(stiffness: float) -> tuple[float, float, float, float]:
    """Measure what a spring changes in a half-ball hit at 2 m/s without friction, against an impulse.

    Returns:
        Time in contact (ms), largest change of a velocity (mm/s), turn of the object ball (degrees) and the largest
        distance of a ball (mm).
    """
    e, speed, seconds = 0.95, 2.0, 0.03
    line = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    x, v = np.array([[0.0, 0.0], 2 * RADIUS * line]), np.array([[speed, 0.0], [0.0, 0.0]])
    ideal = apply_impulses(x, v, e)
    places, after, touched = integrate_springs(x, v, stiffness, e, seconds)
    turn = float(np.degrees(np.arctan2(after[1, 1], after[1, 0]))) - 30.0
    lag = float(np.linalg.norm(places - (x + ideal * seconds), axis=1).max()) * 1e3
    return touched * 1e3, float(np.abs(after - ideal).max()) * 1e3, turn, lag


def print_cut() -> None:
    print("\nHalf-ball hit at 2 m/s, e = 0.95, spring against impulse")
    print(f"{'N/m':>8} {'contact ms':>10} {'closed form':>11} {'dv mm/s':>8} {'object ball deg':>15} {'lag mm':>7}")
    for stiffness in STIFFNESS:
        touched, off, turn, lag = measure_cut(stiffness)
        formula = mass_spring.contact_duration(MASS, MASS, 0.95) * np.sqrt(mass_spring.STIFFNESS / stiffness)
        print(f"{stiffness:8.0e} {touched:10.3f} {formula * 1e3:11.3f} {off:8.2f} {turn:15.3f} {lag:7.3f}")


def print_three() -> None:
    """Compare springs and impulses for a row of three balls, and for one ball that hits two."""
    v = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    print("\nOne ball of 1 m/s into two: velocities along its path (m/s) after springs and after successive impulses")
    for name, x in (("row", ROW), ("wedge", WEDGE)):
        for e in (1.0, 0.95):
            for gap in (0.0, 1e-6, 1e-5, 1e-4) if name == "row" else (0.0,):
                apart = x + np.array([[0.0, 0.0], [0.0, 0.0], [gap, 0.0]])
                _, after, touched = integrate_springs(apart, v, mass_spring.STIFFNESS, e, 2e-3)
                ideal = apply_impulses(x, v, e)
                cells = " ".join(f"{s:7.3f}" for s in after[:, 0]), " ".join(f"{s:7.3f}" for s in ideal[:, 0])
                print(f"{name:6} e {e:4.2f} gap {gap * 1e6:5.0f} um  {cells[0]}   {cells[1]}   {touched * 1e3:.3f} ms")


def measure_figures() -> list[Figure]:
    """Compute the figures of the documentation; nothing in them is random."""
    p, figures = make_parameters(0.85, 0.2, 0.2), []
    for spin in ("roll", "stun"):
        for name in CUSHIONS:
            speed, _, _ = simulate_rebound(name, 0.0, *SPINS[spin], p)
            figures.append(state_exact(f"{name}: speed after 1 m/s at right angles, {spin}", speed, "m/s"))
    _, _, turn, lag = measure_cut(1e7)
    figures += [state_exact("half-ball hit: object ball", turn, "deg"), state_exact("half-ball hit: lag", lag, "mm")]
    v = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    for name, x in (("row", ROW), ("wedge", WEDGE)):
        _, after, _ = integrate_springs(x, v, mass_spring.STIFFNESS, 1.0, 2e-3)
        for method, speeds in (("springs", after), ("impulses", apply_impulses(x, v, 1.0))):
            for ball, speed in enumerate(speeds[:, 0], start=1):
                figures.append(state_exact(f"{name}, {method}: ball {ball}", float(speed), "m/s"))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plot", type=Path, help="PNG file for a plot of the cushion models")
    add_quick_option(parser)
    arguments = parser.parse_args()
    if arguments.plot and find_spec("matplotlib") is None:
        parser.error("--plot needs matplotlib; install trueroll with the extra dev: pip install -e '.[dev]'")
    if arguments.quick:
        run_quick(
            "physics.contact_models",
            measure_figures,
            "e = 0.85 and mu = 0.2 at cushions, e = 1 between balls; no seeds",
        )
        return
    print_cushions()
    print_cut()
    print_three()
    if arguments.plot:
        plot_cushions(arguments.plot)


if __name__ == "__main__":
    main()
