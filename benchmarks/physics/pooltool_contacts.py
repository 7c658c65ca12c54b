"""Contacts of pooltool, a published billiards engine; runs in the environment of the rival and imports only numpy here.

Its Han frame is ours: x into the cushion, z up. In its Mathavan frame y points into the cushion and x along it, so its
x is our -t.
"""

from __future__ import annotations

import numpy as np

VERSION = "0.6.0"
# pooltool pins a development build of panda3d that PyPI does not have. It only draws, so the release will do, and the
# other packages are named here because dependencies are not resolved.
PACKAGES = (
    "--no-deps", f"pooltool-billiards=={VERSION}", "panda3d==1.10.15", "panda3d-gltf==1.3.0",
    "panda3d-simplepbr==0.13.1", "numpy==2.3.5", "numba==0.62.1", "llvmlite==0.45.1", "scipy==1.17.1",
    "numpy-quaternion==2024.0.13", "attrs==26.1.0", "cattrs==26.2.1", "typing-extensions==4.16.0", "msgpack==1.2.4",
    "msgpack-numpy==0.4.8", "h5py==3.16.0", "pyyaml==6.0.4", "click==8.5.1", "h11==0.16.0", "pillow==13.0.0",
    "rich==14.3.4", "pygments==2.21.0", "markdown-it-py==4.3.0", "mdurl==0.1.2",
)  # fmt: skip
MASS, RADIUS = 0.17, 0.028575


def compute_contacts(
    ball: np.ndarray,
    e: np.ndarray,
    mu: np.ndarray,
    cloth: np.ndarray,
    height: float,
    steps: np.ndarray,
    integrated: int,
    slip: np.ndarray,
    closing: np.ndarray,
    eta_squared: float,
    first: np.ndarray,
    second: np.ndarray,
    ball_e: np.ndarray,
    ball_mu: np.ndarray,
) -> dict[str, np.ndarray]:
    """Compute what pooltool's models make of contacts.

    Args:
        ball: States (n, 5) before cushions: vn, vt, wn, wt, wz.
        e: Restitution (n) of cushions.
        mu: Friction (n) of the nose.
        cloth: Friction (n) of the cloth.
        height: Height of the nose, m.
        steps: Numbers (k) of Euler steps of Mathavan's model.
        integrated: Number of contacts that are integrated.
        slip: Slip (n) before compliant contacts, m/s.
        closing: Their closing speeds (n), m/s.
        eta_squared: Their ratio of stiffness.
        first: States (m, 5) of balls before they meet others along x.
        second: States (m, 5) of the others.
        ball_e: Restitution (m) of balls.
        ball_mu: Friction (j, m) of balls.

    Returns:
        `han` (n, 5) after cushions, `mathavan` (k, integrated, 5), `stronge` (n) slips, `balls` (j, m, 10).
    """  # fmt: skip
    few = slice(int(integrated))
    return {
        "han": np.array([_rebound_by_han(*one, float(height)) for one in zip(ball, e, mu, strict=True)]),
        "mathavan": np.array([
            [_rebound_by_mathavan(*one, float(height), int(count))
             for one in zip(ball[few], e[few], mu[few], cloth[few], strict=True)]
            for count in steps
        ]),
        "stronge": np.array([
            _slip_after_stronge(*one, float(eta_squared)) for one in zip(slip, closing, e, mu, strict=True)
        ]),
        "balls": np.array([
            [_collide_balls(*one) for one in zip(first, second, ball_e, friction, strict=True)] for friction in ball_mu
        ]),
    }  # fmt: skip


def _rebound_by_han(ball: np.ndarray, e: float, mu: float, height: float) -> np.ndarray:
    from pooltool.physics.resolve.ball_cushion.han_2005.model import han2005

    state = np.array([[0.0, 0.0, 0.0], [ball[0], ball[1], 0.0], ball[2:]])
    after = han2005(state, np.array([1.0, 0.0, 0.0]), RADIUS, MASS, height, e, mu)
    return np.array([after[1, 0], after[1, 1], *after[2]])


def _rebound_by_mathavan(ball: np.ndarray, e: float, mu: float, cloth: float, height: float, steps: int) -> np.ndarray:
    from pooltool.physics.resolve.ball_cushion.mathavan_2010.model import solve

    start = (-ball[1], ball[0], -ball[3], ball[2], ball[4])
    x, y, wx, wy, wz = solve(MASS, RADIUS, height, e, cloth, mu, *start, steps, MASS * ball[0] / steps)
    return np.array([y, -x, wy, -wx, wz])


def _slip_after_stronge(slip: float, closing: float, e: float, mu: float, eta_squared: float) -> float:
    """Compute the slip after a compliant contact along one line."""
    from pooltool.physics.resolve.stronge_compliant import resolve_collinear_compliant_frictional_inelastic_collision

    after, _ = resolve_collinear_compliant_frictional_inelastic_collision(
        -slip, -closing, MASS, 3.5, 1.0, mu, e, 1e3, eta_squared
    )
    return float(after)


def _collide_balls(a: np.ndarray, b: np.ndarray, e: float, mu: float) -> np.ndarray:
    from pooltool.physics.resolve.ball_ball.frictional_inelastic import _resolve_ball_ball

    one = np.array([[0.0, 0.0, 0.0], [a[0], a[1], 0.0], a[2:]])
    two = np.array([[2 * RADIUS, 0.0, 0.0], [b[0], b[1], 0.0], b[2:]])
    one, two = _resolve_ball_ball(one, two, RADIUS, mu, e)
    return np.array([*one[1][:2], *one[2], *two[1][:2], *two[2]])
