"""Compare single contacts of our contact models with those of pooltool, a published billiards engine.

    python -m benchmarks.physics.foreign_engines [--quick]

pooltool runs in an environment of its own, which is made on the first call. Differences are those of velocity and
surface speed (R w) after random contacts, as a share of the normal speed: with pooltool unchanged, and with the known
differences removed. The conversions are in docs/reference/contact-models.md. Takes seconds.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.physics import pooltool_contacts
from benchmarks.physics.pooltool_contacts import MASS, PACKAGES, RADIUS, VERSION
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_share, run_quick
from benchmarks.support.rival_environment import RivalEnvironment
from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_ball import alciatore
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, stronge
from models.physics.billiards.contact_model import (
    NOSE_HEIGHT,
    apply_cushion_impulse,
    contact_inclination,
    contact_velocities,
)

POOLTOOL = RivalEnvironment("pooltool", PACKAGES)
SURFACE = np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])
# Random contacts per model; fewer where pooltool integrates in many steps.
CONTACTS, INTEGRATED_CONTACTS, EULER_STEPS = 400, 100, (1000, 100_000)
# Share of the normal speed up to which two solutions of the same equations count as equal.
EQUAL = 1e-6


def draw_cushion_contacts(count: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Draw states (vn, vt, wn, wt, wz) of 0.2 to 3 m/s with spin, a third of them rolling, and parameters."""
    rng = np.random.default_rng(1)
    for i in range(count):
        ball = np.array([rng.uniform(0.2, 3), rng.normal() * 1.5, *(rng.normal(size=3) * 40)])
        if i % 3 == 0:
            ball[2:4] = -ball[1] / RADIUS, ball[0] / RADIUS
        p = parameter_vector.neutral_parameters()
        p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_MU] = rng.uniform(0.5, 1), rng.uniform(0.05, 0.4)
        p[parameter_vector.SLIDING_MU] = rng.uniform(0.1, 0.3)
        yield ball, p


def draw_ball_contacts(count: int) -> Iterator[tuple[FloatArray, FloatArray, float, float, FloatArray]]:
    """Draw states before contacts along x, restitution and pooltool's friction, with the states (10) by our model."""
    rng = np.random.default_rng(2)
    for _ in range(count):
        a = np.array([rng.uniform(0.2, 3), rng.normal() * 1.5, *(rng.normal(size=3) * 40)])
        b = np.array([-rng.uniform(0, 2), rng.normal(), *(rng.normal(size=3) * 40)])
        p = parameter_vector.neutral_parameters()
        p[parameter_vector.BALL_E] = e = rng.uniform(0.7, 1)
        slip = math.hypot(a[1] - b[1] + RADIUS * (a[4] + b[4]), RADIUS * (a[3] + b[3]))
        here = np.array(alciatore.collide(*a, *b, RADIUS, RADIUS, MASS, MASS, p))
        yield a, b, e, 9.951e-3 + 0.108 * math.exp(-1.088 * slip), here


def measure_differences() -> dict[str, FloatArray]:
    """Measure the relative differences of all contacts, by model."""
    balls, parameters = map(np.array, zip(*draw_cushion_contacts(CONTACTS), strict=True))
    e, mu, cloth = (parameters[:, k] for k in (
        parameter_vector.CUSHION_E, parameter_vector.CUSHION_MU, parameter_vector.SLIDING_MU
    ))  # fmt: skip
    leans = [contact_inclination(p, NOSE_HEIGHT) for p in parameters]
    speeds = np.array([contact_velocities(*ball, RADIUS, *lean) for ball, lean in zip(balls, leans, strict=True)])
    slip = np.hypot(speeds[:, 1], speeds[:, 2])
    a, b, ball_e, ball_mu, here = map(np.array, zip(*draw_ball_contacts(CONTACTS), strict=True))
    # pooltool bounds friction by mu e v; the normal impulse per mass of equal balls is (1 + e) v / 2.
    there = POOLTOOL.call(pooltool_contacts.compute_contacts, {
        "ball": balls, "e": e, "mu": mu, "cloth": cloth, "height": np.array(NOSE_HEIGHT * RADIUS),
        "steps": np.array(EULER_STEPS), "integrated": np.array(INTEGRATED_CONTACTS),
        "slip": slip, "closing": speeds[:, 0], "eta_squared": np.array(stronge.ETA_SQUARED),
        "first": a, "second": b, "ball_e": ball_e,
        "ball_mu": np.array([ball_mu, (1 + ball_e) / (2 * ball_e) * ball_mu]),
    })  # fmt: skip
    rows = {"Han": compare_rebounds(han_2005.rebound, there["han"], balls, parameters)}
    # Larger friction at the nose lifts the ball: pooltool then lets the cloth pull it back, our model releases it.
    sine, cosine = contact_inclination(parameter_vector.neutral_parameters(), NOSE_HEIGHT)
    few = slice(INTEGRATED_CONTACTS)
    for steps, after in zip(EULER_STEPS, there["mathavan"], strict=True):
        found = compare_rebounds(mathavan_2010.rebound, after, balls[few], parameters[few])
        rows[f"Mathavan, {steps:,} steps"] = found
        rows[f"Mathavan, {steps:,} steps, mu below tan(theta)"] = found[mu[few] < sine / cosine]
    # pooltool solves one dimension, along the slip. Its omega_ratio is our `FREQUENCY_RATIO`.
    share = (there["stronge"] + slip) / (3.5 * slip)
    after = np.array([
        apply_cushion_impulse(*ball, RADIUS, (1 + restitution) * closing, -one * st, -one * sk, *lean)
        for ball, restitution, (closing, st, sk), one, lean in zip(balls, e, speeds, share, leans, strict=True)
    ])  # fmt: skip
    rows["Stronge"] = found = compare_rebounds(stronge.rebound, after, balls, parameters)
    # Below this restitution the contact sticks while still compressed, which pooltool's bound for sliding ignores.
    rows["Stronge, e above 0.59"] = found[e > 1 / stronge.FREQUENCY_RATIO]
    for name, after in zip(("Alciatore", "Alciatore, bound of friction corrected"), there["balls"], strict=True):
        rows[name] = np.abs((here - after) * np.tile(SURFACE, 2)).max(axis=1) / (a[:, 0] - b[:, 0])
    return rows


def compare_rebounds(
    rebound: Callable[..., object], there: FloatArray, balls: FloatArray, parameters: FloatArray
) -> FloatArray:
    """Compute the largest difference (n,) of each contact over its normal speed."""
    here = np.array([rebound(*ball, RADIUS, MASS, p) for ball, p in zip(balls, parameters, strict=True)])
    return np.asarray(np.abs((here - there) * SURFACE).max(axis=1) / balls[:, 0])


def measure_figures() -> list[Figure]:
    """Measure the figures of the documentation: medians, or the share of equal contacts where most are equal."""
    figures = []
    for name, differences in measure_differences().items():
        if np.median(differences) < EQUAL:
            figures.append(estimate_share(f"{name}: equal", int(np.sum(differences < EQUAL)), len(differences)))
        else:
            figures.append(estimate_median(f"{name}: median difference", 100 * differences, "%"))
    return figures


def print_rows() -> None:
    print(f"{'model':46} {'n':>5} {'median':>9} {'90 %':>9} {'most':>9}")
    for name, differences in measure_differences().items():
        shares = " ".join(f"{value:9.1e}" for value in np.percentile(differences, [50, 90, 100]))
        print(f"{name:46} {len(differences):5} {shares}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    if not parser.parse_args().quick:
        print_rows()
        return
    inputs = f"pooltool {VERSION} in an environment of its own, {CONTACTS} random contacts per model, seeds 1 and 2"
    run_quick("physics.foreign_engines", measure_figures, inputs)


if __name__ == "__main__":
    main()
