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


def rebound_by_han(ball: np.ndarray, e: np.ndarray, mu: np.ndarray, height: float) -> dict[str, np.ndarray]:
    """Compute states (n, 5) after a cushion from states (vn, vt, wn, wt, wz) before; `height` of the nose in m."""
    from pooltool.physics.resolve.ball_cushion.han_2005.model import han2005

    after = []
    for state, restitution, friction in zip(ball, e, mu, strict=True):
        rvw = np.array([[0.0, 0.0, 0.0], [state[0], state[1], 0.0], state[2:]])
        rvw = han2005(rvw, np.array([1.0, 0.0, 0.0]), RADIUS, MASS, float(height), restitution, friction)
        after.append([rvw[1, 0], rvw[1, 1], *rvw[2]])
    return {"after": np.array(after)}


def rebound_by_mathavan(
    ball: np.ndarray, e: np.ndarray, mu: np.ndarray, cloth: np.ndarray, height: float, steps: int
) -> dict[str, np.ndarray]:
    """Compute states (n, 5) after a cushion, integrated in about `steps` Euler steps."""
    from pooltool.physics.resolve.ball_cushion.mathavan_2010.model import solve

    after = []
    for state, restitution, friction, drag in zip(ball, e, mu, cloth, strict=True):
        start = (-state[1], state[0], -state[3], state[2], state[4])
        x, y, wx, wy, wz = solve(
            MASS, RADIUS, float(height), restitution, drag, friction, *start, int(steps), MASS * state[0] / int(steps)
        )
        after.append([y, -x, wy, -wx, wz])
    return {"after": np.array(after)}


def slip_after_stronge(
    slip: np.ndarray, closing: np.ndarray, e: np.ndarray, mu: np.ndarray, eta_squared: float
) -> dict[str, np.ndarray]:
    """Compute the slip (n,) after a compliant contact along one line."""
    from pooltool.physics.resolve.stronge_compliant import resolve_collinear_compliant_frictional_inelastic_collision

    after = [
        resolve_collinear_compliant_frictional_inelastic_collision(
            -one, -speed, MASS, 3.5, 1.0, friction, restitution, 1e3, float(eta_squared)
        )[0]
        for one, speed, restitution, friction in zip(slip, closing, e, mu, strict=True)
    ]
    return {"after": np.array(after)}


def collide_balls(first: np.ndarray, second: np.ndarray, e: np.ndarray, mu: np.ndarray) -> dict[str, np.ndarray]:
    """Compute states (n, 10) of two equal balls after a contact along x."""
    from pooltool.physics.resolve.ball_ball.frictional_inelastic import _resolve_ball_ball

    after = []
    for a, b, restitution, friction in zip(first, second, e, mu, strict=True):
        one = np.array([[0.0, 0.0, 0.0], [a[0], a[1], 0.0], a[2:]])
        two = np.array([[2 * RADIUS, 0.0, 0.0], [b[0], b[1], 0.0], b[2:]])
        one, two = _resolve_ball_ball(one, two, RADIUS, friction, restitution)
        after.append([*one[1][:2], *one[2], *two[1][:2], *two[2]])
    return {"after": np.array(after)}
