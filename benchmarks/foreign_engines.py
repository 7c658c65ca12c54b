"""Single contacts by our laws against those of pooltool, a published billiards engine.

    python -m pip install pooltool-billiards     # in an environment of its own
    PYTHONPATH=. python benchmarks/foreign_engines.py

Prints, per law, how far velocity and surface speed (R w) end up apart over random contacts, as a share of the normal
speed: with pooltool as it is, and with what is known to differ taken out. Conversions are in docs/laws.md. Skips with a
sentence where pooltool cannot be imported.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from models.core.typing import FloatArray
from models.physics.billiards import parameters
from models.physics.billiards.ball_ball import alciatore
from models.physics.billiards.ball_cushion import han_2005, mathavan_2010, stronge
from models.physics.billiards.ball_cushion.cushion_contact import COSINE, NOSE_HEIGHT, SINE, approach, push

RADIUS, MASS = 0.028575, 0.17
SURFACE = np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])


def cushion_contacts(count: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """vn, vt, wn, wt, wz of 0.2 to 3 m/s with spins, a third rolling; and the parameters."""
    rng = np.random.default_rng(1)
    for i in range(count):
        ball = np.array([rng.uniform(0.2, 3), rng.normal() * 1.5, *(rng.normal(size=3) * 40)])
        if i % 3 == 0:
            ball[2:4] = -ball[1] / RADIUS, ball[0] / RADIUS
        p = parameters.neutral()
        p[parameters.CUSHION_E], p[parameters.CUSHION_MU] = rng.uniform(0.5, 1), rng.uniform(0.05, 0.4)
        p[parameters.SLIDING_MU] = rng.uniform(0.1, 0.3)
        yield ball, p


def han_there(ball: FloatArray, p: FloatArray) -> FloatArray:
    """pooltool's frame has x into the cushion and z up: ours."""
    from pooltool.physics.resolve.ball_cushion.han_2005.model import han2005

    state = np.array([[0.0, 0.0, 0.0], [ball[0], ball[1], 0.0], ball[2:]])
    e, mu = p[parameters.CUSHION_E], p[parameters.CUSHION_MU]
    after = han2005(state, np.array([1.0, 0.0, 0.0]), RADIUS, MASS, NOSE_HEIGHT * RADIUS, e, mu)
    return np.array([after[1, 0], after[1, 1], *after[2]])


def mathavan_there(ball: FloatArray, p: FloatArray, steps: int) -> FloatArray:
    """pooltool's frame has y into the cushion and x along it, so its x is our -t."""
    from pooltool.physics.resolve.ball_cushion.mathavan_2010.model import solve

    e, mu, cloth = (p[i] for i in (parameters.CUSHION_E, parameters.CUSHION_MU, parameters.SLIDING_MU))
    start = (-ball[1], ball[0], -ball[3], ball[2], ball[4])
    height = NOSE_HEIGHT * RADIUS
    x, y, wx, wy, wz = solve(MASS, RADIUS, height, e, cloth, mu, *start, steps, MASS * ball[0] / steps)
    return np.array([y, -x, wy, -wx, wz])


def stronge_there(ball: FloatArray, p: FloatArray) -> FloatArray:
    """pooltool's one-dimensional solution along the slip, put back by our axes; its omega_ratio is our RATIO."""
    from pooltool.physics.resolve.stronge_compliant import resolve_collinear_compliant_frictional_inelastic_collision

    closing, st, sk = approach(*ball, RADIUS)
    slip = math.hypot(st, sk)
    e, mu = p[parameters.CUSHION_E], p[parameters.CUSHION_MU]
    slip_after, _ = resolve_collinear_compliant_frictional_inelastic_collision(
        -slip, -closing, MASS, 3.5, 1.0, mu, e, 1e3, stronge.ETA_SQUARED
    )
    share = (slip_after + slip) / (3.5 * slip)
    return np.array(push(*ball, RADIUS, (1 + e) * closing, -share * st, -share * sk))


def apart(law: object, there: FloatArray, ball: FloatArray, p: FloatArray) -> float:
    here = np.array(law.rebound(*ball, RADIUS, MASS, p))  # type: ignore[attr-defined]
    return float(np.abs((here - there) * SURFACE).max() / ball[0])


def print_row(name: str, differences: list[float]) -> None:
    median, most = np.percentile(differences, [50, 90]), max(differences)
    print(f"{name:58} {len(differences):5} {median[0]:9.1e} {median[1]:9.1e} {most:9.1e}")


def print_cushions() -> None:
    contacts = list(cushion_contacts(400))
    print_row("han_2005", [apart(han_2005, han_there(b, p), b, p) for b, p in contacts])
    for steps in (1000, 100_000):
        rows = [apart(mathavan_2010, mathavan_there(b, p, steps), b, p) for b, p in contacts[:100]]
        print_row(f"mathavan_2010, there {steps} Euler steps", rows)
        # Friction up the nose above this lifts the ball; there the cloth then pulls it back, here it lets go.
        loaded = [row for row, (_, p) in zip(rows, contacts, strict=False) if p[parameters.CUSHION_MU] < SINE / COSINE]
        print_row(f"mathavan_2010, there {steps} steps, mu < tan theta", loaded)
    print_row("stronge", [apart(stronge, stronge_there(b, p), b, p) for b, p in contacts])
    # Below this restitution a tip comes to rest while still pressed in, which pooltool's bound for sliding overlooks.
    stiff = [(b, p) for b, p in contacts if p[parameters.CUSHION_E] > 1 / stronge.RATIO]
    print_row("stronge, e above 1 / omega ratio", [apart(stronge, stronge_there(b, p), b, p) for b, p in stiff])


def ball_there(a: FloatArray, b: FloatArray, e: float, mu: float) -> FloatArray:
    from pooltool.physics.resolve.ball_ball.frictional_inelastic import _resolve_ball_ball

    one = np.array([[0.0, 0.0, 0.0], [a[0], a[1], 0.0], a[2:]])
    two = np.array([[2 * RADIUS, 0.0, 0.0], [b[0], b[1], 0.0], b[2:]])
    one, two = _resolve_ball_ball(one, two, RADIUS, mu, e)
    return np.array([*one[1][:2], *one[2], *two[1][:2], *two[2]])


def print_balls() -> None:
    """pooltool's bound of friction is mu e v; the normal impulse per mass of equal balls is (1 + e) v / 2."""
    rng = np.random.default_rng(2)
    rows: dict[str, list[float]] = {"alciatore": [], "alciatore, friction there times (1 + e) / (2 e)": []}
    for _ in range(400):
        a = np.array([rng.uniform(0.2, 3), rng.normal() * 1.5, *(rng.normal(size=3) * 40)])
        b = np.array([-rng.uniform(0, 2), rng.normal(), *(rng.normal(size=3) * 40)])
        p = parameters.neutral()
        p[parameters.BALL_E] = e = rng.uniform(0.7, 1)
        slip = math.hypot(a[1] - b[1] + RADIUS * (a[4] + b[4]), RADIUS * (a[3] + b[3]))
        mu = 9.951e-3 + 0.108 * math.exp(-1.088 * slip)
        here = np.array(alciatore.collide(*a, *b, RADIUS, RADIUS, MASS, MASS, p))
        for name, factor in zip(rows, (1.0, (1 + e) / (2 * e)), strict=True):
            off = (here - ball_there(a, b, e, factor * mu)) * np.tile(SURFACE, 2)
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
    print(f"{'law':58} {'n':>5} {'median':>9} {'90 %':>9} {'most':>9}")
    print_cushions()
    print_balls()


if __name__ == "__main__":
    main()
