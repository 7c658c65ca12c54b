"""Compare single contacts of our contact models with those of pooltool, a published billiards engine.

    python -m pip install pooltool-billiards     # in an environment of its own
    python -m benchmarks.physics.foreign_engines

Prints, per model, the difference of velocity and surface speed (R w) after random contacts as a share of the normal
speed: with pooltool unchanged, and with the known differences removed. The conversions are in
docs/reference/contact-models.md. Skips with a message where pooltool cannot be imported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.ball_ball import alciatore
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, stronge
from models.physics.billiards.ball_cushion.cushion_contact import (
    NOSE_HEIGHT,
    apply_cushion_impulse,
    contact_inclination,
    contact_velocities,
)

RADIUS, MASS = 0.028575, 0.17
SURFACE = np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])


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


def pooltool_han(ball: FloatArray, p: FloatArray) -> FloatArray:
    """Rebound by pooltool's Han model, whose x points into the cushion and z up, like ours."""
    from pooltool.physics.resolve.ball_cushion.han_2005.model import han2005

    state = np.array([[0.0, 0.0, 0.0], [ball[0], ball[1], 0.0], ball[2:]])
    e, mu = p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_MU]
    after = han2005(state, np.array([1.0, 0.0, 0.0]), RADIUS, MASS, NOSE_HEIGHT * RADIUS, e, mu)
    return np.array([after[1, 0], after[1, 1], *after[2]])


def pooltool_mathavan(ball: FloatArray, p: FloatArray, steps: int) -> FloatArray:
    """Rebound by pooltool's Mathavan model: y points into the cushion and x along it, so its x is our -t."""
    from pooltool.physics.resolve.ball_cushion.mathavan_2010.model import solve

    e, mu, cloth = (
        p[i] for i in (parameter_vector.CUSHION_E, parameter_vector.CUSHION_MU, parameter_vector.SLIDING_MU)
    )
    start = (-ball[1], ball[0], -ball[3], ball[2], ball[4])
    height = NOSE_HEIGHT * RADIUS
    x, y, wx, wy, wz = solve(MASS, RADIUS, height, e, cloth, mu, *start, steps, MASS * ball[0] / steps)
    return np.array([y, -x, wy, -wx, wz])


def pooltool_stronge(ball: FloatArray, p: FloatArray) -> FloatArray:
    """Rebound by pooltool's one-dimensional solution along the slip, turned into our axes.

    Its omega_ratio is our `FREQUENCY_RATIO`.
    """
    from pooltool.physics.resolve.stronge_compliant import resolve_collinear_compliant_frictional_inelastic_collision

    lean = contact_inclination(p, NOSE_HEIGHT)
    closing, st, sk = contact_velocities(*ball, RADIUS, *lean)
    slip = math.hypot(st, sk)
    e, mu = p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_MU]
    slip_after, _ = resolve_collinear_compliant_frictional_inelastic_collision(
        -slip, -closing, MASS, 3.5, 1.0, mu, e, 1e3, stronge.ETA_SQUARED
    )
    share = (slip_after + slip) / (3.5 * slip)
    return np.array(apply_cushion_impulse(*ball, RADIUS, (1 + e) * closing, -share * st, -share * sk, *lean))


def relative_difference(law: object, there: FloatArray, ball: FloatArray, p: FloatArray) -> float:
    here = np.array(law.rebound(*ball, RADIUS, MASS, p))  # type: ignore[attr-defined]
    return float(np.abs((here - there) * SURFACE).max() / ball[0])


def print_row(name: str, differences: list[float]) -> None:
    median, most = np.percentile(differences, [50, 90]), max(differences)
    print(f"{name:58} {len(differences):5} {median[0]:9.1e} {median[1]:9.1e} {most:9.1e}")


def print_cushions() -> None:
    contacts = list(draw_cushion_contacts(400))
    print_row("han_2005", [relative_difference(han_2005, pooltool_han(b, p), b, p) for b, p in contacts])
    for steps in (1000, 100_000):
        rows = [relative_difference(mathavan_2010, pooltool_mathavan(b, p, steps), b, p) for b, p in contacts[:100]]
        print_row(f"mathavan_2010, pooltool with {steps} Euler steps", rows)
        # Larger friction at the nose lifts the ball: pooltool then lets the cloth pull it back, our model releases it.
        sine, cosine = contact_inclination(parameter_vector.neutral_parameters(), NOSE_HEIGHT)
        loaded = [
            row for row, (_, p) in zip(rows, contacts, strict=False) if p[parameter_vector.CUSHION_MU] < sine / cosine
        ]
        print_row(f"mathavan_2010, pooltool with {steps} steps, mu < tan theta", loaded)
    print_row("stronge", [relative_difference(stronge, pooltool_stronge(b, p), b, p) for b, p in contacts])
    # Below this restitution the contact sticks while still compressed, which pooltool's bound for sliding ignores.
    stiff = [(b, p) for b, p in contacts if p[parameter_vector.CUSHION_E] > 1 / stronge.FREQUENCY_RATIO]
    print_row(
        "stronge, e above 1 / omega ratio",
        [relative_difference(stronge, pooltool_stronge(b, p), b, p) for b, p in stiff],
    )


def pooltool_ball_contact(a: FloatArray, b: FloatArray, e: float, mu: float) -> FloatArray:
    from pooltool.physics.resolve.ball_ball.frictional_inelastic import _resolve_ball_ball

    one = np.array([[0.0, 0.0, 0.0], [a[0], a[1], 0.0], a[2:]])
    two = np.array([[2 * RADIUS, 0.0, 0.0], [b[0], b[1], 0.0], b[2:]])
    one, two = _resolve_ball_ball(one, two, RADIUS, mu, e)
    return np.array([*one[1][:2], *one[2], *two[1][:2], *two[2]])


def print_balls() -> None:
    """Compare ball contacts.

    pooltool bounds friction by mu e v; the normal impulse per mass of equal balls is (1 + e) v / 2.
    """
    rng = np.random.default_rng(2)
    rows: dict[str, list[float]] = {"alciatore": [], "alciatore, pooltool friction times (1 + e) / (2 e)": []}
    for _ in range(400):
        a = np.array([rng.uniform(0.2, 3), rng.normal() * 1.5, *(rng.normal(size=3) * 40)])
        b = np.array([-rng.uniform(0, 2), rng.normal(), *(rng.normal(size=3) * 40)])
        p = parameter_vector.neutral_parameters()
        p[parameter_vector.BALL_E] = e = rng.uniform(0.7, 1)
        slip = math.hypot(a[1] - b[1] + RADIUS * (a[4] + b[4]), RADIUS * (a[3] + b[3]))
        mu = 9.951e-3 + 0.108 * math.exp(-1.088 * slip)
        here = np.array(alciatore.collide(*a, *b, RADIUS, RADIUS, MASS, MASS, p))
        for name, factor in zip(rows, (1.0, (1 + e) / (2 * e)), strict=True):
            off = (here - pooltool_ball_contact(a, b, e, factor * mu)) * np.tile(SURFACE, 2)
            rows[name].append(float(np.abs(off).max() / (a[0] - b[0])))
    for name, differences in rows.items():
        print_row(name, differences)


def main() -> None:
    try:
        import pooltool
    except ImportError as error:
        print(
            f"skipped: pooltool cannot be imported ({error}); install pooltool-billiards in an environment of its own"
        )
        return
    print(f"against pooltool {pooltool.__version__}; differences over the normal speed\n")
    print(f"{'model':58} {'n':>5} {'median':>9} {'90 %':>9} {'most':>9}")
    print_cushions()
    print_balls()


if __name__ == "__main__":
    main()
