"""Simulate billiards with fixed small steps, independently of the library that is checked against it.

    python worlds/billiards.py SHOT.json OUT [SHOT.json OUT ...]

reads each shot (balls, effects and laws as `trueroll simulate` reads them) and writes OUT/trajectory.csv
(t,id,x,y,z,vx,vy,wx,wy,wz,qw,qx,qy,qz) and OUT/events.csv (kind,t,a,b,x,y,speed). x, y and the signs of spin are those
of the shot: a rolling ball has wx = -vy/R, wy = vx/R. q is the orientation of the ball relative to the start.

In every step of `dt`, friction changes the velocities and velocities change the positions; balls that overlap and
approach receive an impulse, whose time is moved back inside the step to the moment of contact. Cushion models:
`mirror`, `han_2005` (Han, "Dynamics in carom and three cushion billiards", J. Mech. Sci. Tech. 19, 2005), and
`mathavan_2010` (Mathavan, Jackson, Parkin, "A theoretical analysis of billiard ball dynamics under cushion impacts",
Proc. IMechE C, 224, 2010), integrated over the impulse at the height of the nose. That height is `cushion_height`
(1.27 radii above the cloth by default) for the latter two. Ball models: `inelastic` (Coulomb friction if
`ball_friction` is given), and `alciatore` (friction that falls with speed, technical proof A-14). Balls may differ in
radius and mass; their centres are assumed to lie in one plane. Effects that are in no library: `sticky_patch`
(additional rolling resistance mu within 0.3 m of x, y), `curl` (c: a rolling ball turns, c times its deceleration to
its left), `cushion_restitution_power` (restitution falls with that power of the speed, and is e at 1 m/s).
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Store compiled code on disk only for the script: it cannot load code that an import compiled under another name.
CACHE_COMPILED = __name__ == "__main__"
# m/s2.
GRAVITY = 9.81
# Step, s: at 5 m/s a ball moves 0.1 mm in one.
STEP = 2e-5
# Height of the nose above the cloth in ball radii (WPA equipment rules: 63.5 % of the diameter).
NOSE_HEIGHT_RADII = 1.27
# Radius of a sticky patch, m.
PATCH_RADIUS = 0.3
# Friction between ball and cloth while the nose presses the ball down (Mathavan 2010, section 4).
CLOTH_UNDER_CUSHION = 0.21
# Distance from the pocket's point on the nose rectangle within which a ball drops, m.
MOUTH_CORNER, MOUTH_SIDE = 0.045, 0.040
# Distance along the rail from a pocket within which there is no cushion, m.
JAW_CORNER, JAW_SIDE = 0.080, 0.062
# Distance behind the noses at which the leather of a pocket stops the centre of a falling ball, m.
POCKET_BACK = 0.012
# Indices in `KINDS`.
STRIKE, BALL, CUSHION, POCKET, REST = range(5)
MOST_EVENTS = 20_000
# Closing speed below which a contact of touching balls is no event, m/s.
RESTING_CLOSING = 1e-3

CUSHIONS = ("left", "right", "top", "bottom")
POCKETS = ("top-left", "top", "top-right", "bottom-left", "bottom", "bottom-right")
KINDS = ("strike", "ball", "cushion", "pocket", "rest")
MIRROR, MATHAVAN, HAN = 0, 1, 2
CUSHION_LAWS = {"mirror": MIRROR, "mathavan_2010": MATHAVAN, "han_2005": HAN}
INELASTIC, ALCIATORE = 0, 1
BALL_LAWS = {"inelastic": INELASTIC, "alciatore": ALCIATORE}
# In the order of the numbers `p` of the simulation.
PARAMETERS = (
    "sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate", "slope.slope_x", "slope.slope_y",
    "cushion_restitution.e", "cushion_restitution_speed.slope", "cushion_friction.mu", "ball_restitution.e",
    "ball_friction.mu", "air_drag.k", "viscous_drag.k", "nap.mu", "sticky_patch.mu", "sticky_patch.x",
    "sticky_patch.y", "curl.c", "cushion_restitution_power.power", "cushion_height.ratio",
)  # fmt: skip
NEUTRAL = {"cushion_restitution.e": 1.0, "ball_restitution.e": 1.0, "cushion_height.ratio": NOSE_HEIGHT_RADII}


@njit(cache=CACHE_COMPILED)
def apply_cloth_friction(v, w, radius, slide, roll, decay, pull_x, pull_y, drag, curl, dt):
    """Apply cloth friction to one ball during dt; changes v (2,) and w (3,), returns whether the ball still moves."""
    slip_x, slip_y = v[0] - radius * w[1], v[1] + radius * w[0]
    slip = math.hypot(slip_x, slip_y)
    w[2] -= math.copysign(min(abs(w[2]), decay * dt), w[2])
    if slide > 0 and slip > 3.5 * slide * GRAVITY * dt:
        push_x, push_y = -slide * GRAVITY * slip_x / slip, -slide * GRAVITY * slip_y / slip
        v[0] += (push_x + pull_x - drag * v[0]) * dt
        v[1] += (push_y + pull_y - drag * v[1]) * dt
        w[0] += 2.5 / radius * push_y * dt
        w[1] -= 2.5 / radius * push_x * dt
        return True
    if slide > 0:
        v[0] -= slip_x * 2 / 7
        v[1] -= slip_y * 2 / 7
    speed = math.hypot(v[0], v[1])
    # the drag acts fully; a slope accelerates a rolling ball by five sevenths
    left = max(speed - (roll * GRAVITY + drag * speed) * dt, 0.0)
    if speed > 0:
        v[0] *= left / speed
        v[1] *= left / speed
        aside = curl * roll * GRAVITY * dt / speed
        v[0], v[1] = v[0] - aside * v[1], v[1] + aside * v[0]
    if left > 0 or math.hypot(pull_x, pull_y) * 5 / 7 > roll * GRAVITY:
        v[0] += pull_x * 5 / 7 * dt
        v[1] += pull_y * 5 / 7 * dt
    if slide > 0:
        w[0], w[1] = -v[1] / radius, v[0] / radius
    return v[0] != 0.0 or v[1] != 0.0


@njit(cache=CACHE_COMPILED)
def apply_ball_contact(va, wa, vb, wb, nx, ny, ra, rb, ma, mb, e, mu, law):
    """Apply the impulse between two balls along the unit normal from a to b; changes their v and w."""
    closing = (va[0] - vb[0]) * nx + (va[1] - vb[1]) * ny
    reduced = ma * mb / (ma + mb)
    normal = reduced * (1 + e) * closing
    tx, ty = -ny, nx
    across = (va[0] - vb[0]) * tx + (va[1] - vb[1]) * ty + ra * wa[2] + rb * wb[2]
    upward = -((ra * wa[0] + rb * wb[0]) * tx + (ra * wa[1] + rb * wb[1]) * ty)
    rubbing = math.hypot(across, upward)
    if law == ALCIATORE:
        mu = 0.00995 + 0.108 * math.exp(-1.088 * rubbing)
    if rubbing > 1e-9:
        grip = min(mu * normal, rubbing * reduced * 2 / 7)
        j_across, j_up = grip * across / rubbing, grip * upward / rubbing
        va[0] -= j_across / ma * tx
        va[1] -= j_across / ma * ty
        vb[0] += j_across / mb * tx
        vb[1] += j_across / mb * ty
        for w, turn in ((wa, 2.5 / (ma * ra)), (wb, 2.5 / (mb * rb))):
            w[2] -= turn * j_across
            w[0] += turn * j_up * tx
            w[1] += turn * j_up * ty
    va[0] -= normal / ma * nx
    va[1] -= normal / ma * ny
    vb[0] += normal / mb * nx
    vb[1] += normal / mb * ny


@njit(cache=CACHE_COMPILED)
def rebound_by_mirror(along, into, spin, radius, e, mu):
    """Return along, into and spin after restitution and Coulomb friction at the height of the centre."""
    slip = along - radius * spin
    grip = min(mu * (1 + e) * into, abs(slip) * 2 / 7)
    push = -math.copysign(grip, slip)
    return along + push, -e * into, spin - 2.5 / radius * push


@njit(cache=CACHE_COMPILED)
def rebound_by_mathavan(vx, vy, wx, wy, wz, radius, e, mu, height):
    """Integrate Mathavan 2010, eqs 15 to 17, over the normal impulse (mass 1): x along the cushion, y into it."""
    sin, k = height - 1, 2.5 / radius
    cos = math.sqrt(1 - sin * sin)
    step, work, wanted, compressing = vy / 4000, 0.0, 0.0, True
    for _ in range(200000):
        nose_x, nose_y = vx + radius * (wy * sin - wz * cos), -vy * sin + radius * wx
        cloth_x, cloth_y = vx - radius * wy, vy + radius * wx
        nose, cloth = math.hypot(nose_x, nose_y) + 1e-12, math.hypot(cloth_x, cloth_y) + 1e-12
        fx, fy = mu * nose_x / nose, mu * nose_y / nose
        press = max(sin + fy * cos, 0.0) * CLOTH_UNDER_CUSHION
        gx, gy = press * cloth_x / cloth, press * cloth_y / cloth
        vx -= (fx + gx) * step
        before = vy
        vy -= (cos - fy * sin + gy) * step
        wx -= k * (fy + gy) * step
        wy -= k * (fx * sin - gx) * step
        wz += k * fx * cos * step
        work += abs(before + vy) / 2 * cos * step
        if compressing and vy <= 0:
            compressing, wanted, work = False, e * e * work, 0.0
        if not compressing and work >= wanted:
            break
    return vx, vy, wx, wy, wz


@njit(cache=CACHE_COMPILED)
def rebound_by_han(vx, vy, wx, wy, wz, radius, e, mu, height):
    """Apply the impulse of Han 2005 at the point of contact (mass 1): x along the cushion, y into it, z up.

    All vectors have three components. The ball keeps its height: what the impulse does to it vertically is dropped.
    """
    up = height - 1
    arm = radius * np.array([0.0, math.sqrt(1 - up * up), up])  # from the centre to the point of contact
    inward = -arm / radius
    v, w = np.array([vx, vy, 0.0]), np.array([wx, wy, wz])
    surface = v + np.cross(w, arm)
    closing = -np.dot(surface, inward)
    slip = surface + closing * inward
    size = math.sqrt(np.dot(slip, slip)) + 1e-300
    normal = (1 + e) * closing
    impulse = normal * inward - min(mu * normal, size * 2 / 7) / size * slip
    v += impulse
    w += 2.5 / radius**2 * np.cross(arm, impulse)
    return v[0], min(v[1], 0.0), w[0], w[1], w[2]


@njit(cache=CACHE_COMPILED)
def apply_cushion_contact(v, w, side, radius, e, mu, height, law):
    """Rebound one ball from cushion `side`; changes v and w."""
    # frame with y into the cushion and x along it, turned (not mirrored), so spins keep their formulas
    nx, ny = (-1.0, 0.0) if side == 0 else (1.0, 0.0) if side == 1 else (0.0, -1.0) if side == 2 else (0.0, 1.0)
    tx, ty = ny, -nx
    along, into = v[0] * tx + v[1] * ty, v[0] * nx + v[1] * ny
    wt, wn, wz = w[0] * tx + w[1] * ty, w[0] * nx + w[1] * ny, w[2]
    if law == MATHAVAN:
        along, into, wt, wn, wz = rebound_by_mathavan(along, into, wt, wn, wz, radius, e, mu, height)
    elif law == HAN:
        along, into, wt, wn, wz = rebound_by_han(along, into, wt, wn, wz, radius, e, mu, height)
    else:
        along, into, wz = rebound_by_mirror(along, into, wz, radius, e, mu)
    v[0], v[1] = along * tx + into * nx, along * ty + into * ny
    w[0], w[1], w[2] = wt * tx + wn * nx, wt * ty + wn * ny, wz


@njit(cache=CACHE_COMPILED)
def rotate_orientation(q, w, dt):
    """Rotate the orientation q (4,) by the spin w during dt."""
    a, b, c, d = q
    x, y, z = w[0] * dt / 2, w[1] * dt / 2, w[2] * dt / 2
    q[0] = a - x * b - y * c - z * d
    q[1] = b + x * a + y * d - z * c
    q[2] = c + y * a + z * b - x * d
    q[3] = d + z * a + x * c - y * b
    q /= math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)


@njit(cache=CACHE_COMPILED)
def find_nearest_pocket(x, y, length, width):
    """Return the index in `POCKETS` of the nearest pocket, and the distance to it."""
    column = 0 if x < length / 4 else 2 if x > 0.75 * length else 1
    row = 0 if y < width / 2 else 1
    return 3 * row + column, math.hypot(x - column * length / 2, y - row * width)


@njit(cache=CACHE_COMPILED)
def record_event(events, count, kind, t, a, b, x, y, speed):
    """Record one event; returns the number of events."""
    if count < MOST_EVENTS:
        events[count] = np.array([float(kind), t, float(a), float(b), x, y, speed])
    return min(count + 1, MOST_EVENTS)


@njit(cache=CACHE_COMPILED)
def stop_at_leather(xy, v, size):
    """Stop a falling ball at the back of the pocket."""
    for axis in range(2):
        beyond = -xy[axis] if v[axis] < 0 else xy[axis] - size[axis]
        if beyond > POCKET_BACK:
            v[axis] = 0.0


@njit(cache=CACHE_COMPILED)
def move_balls(xyz, v, w, q, moving, potted, fall, size, radius, p, t, dt, events, count):
    """Move every ball by dt under cloth friction, or down a pocket."""
    slope_x, slope_y = p[3] * 1e-3 * GRAVITY, p[4] * 1e-3 * GRAVITY
    for i in np.flatnonzero(moving):
        speed = math.hypot(v[i, 0], v[i, 1])
        drag = p[10] * speed + p[11]
        roll = p[1] - (p[12] * v[i, 0] / speed if speed > 0 else 0.0)
        if math.hypot(xyz[i, 0] - p[14], xyz[i, 1] - p[15]) < PATCH_RADIUS:
            roll += p[13]
        if potted[i]:
            fall[i] += GRAVITY * dt
            xyz[i, 2] -= fall[i] * dt
            stop_at_leather(xyz[i], v[i], size)
            moving[i] = xyz[i, 2] > -4 * radius[i]
        elif not apply_cloth_friction(v[i], w[i], radius[i], p[0], roll, p[2], slope_x, slope_y, drag, p[16], dt) and (
            w[i, 2] * p[2] == 0.0
        ):
            moving[i] = False
            w[i] = 0.0
            count = record_event(events, count, REST, t, i, -1, xyz[i, 0], xyz[i, 1], np.nan)
        if moving[i]:
            xyz[i, 0] += v[i, 0] * dt
            xyz[i, 1] += v[i, 1] * dt
            rotate_orientation(q[i], w[i], dt)
    return count


@njit(cache=CACHE_COMPILED)
def is_in_mouth(x, y, side, size):
    """Return whether a pocket interrupts the nose of `side` where a ball at x, y would meet it."""
    length, width = size
    if side < 2:
        return min(y, width - y) < JAW_CORNER
    return min(x, length - x) < JAW_CORNER or abs(x - length / 2) < JAW_SIDE


@njit(cache=CACHE_COMPILED)
def resolve_rails(xyz, v, w, moving, potted, size, radius, pockets, p, law, t, dt, events, count):
    """Resolve pockets and cushions in the step that ends at t."""
    for i in np.flatnonzero(moving & ~potted):
        x, y = xyz[i, 0], xyz[i, 1]
        if pockets:
            pocket, distance = find_nearest_pocket(x, y, size[0], size[1])
            if distance < (MOUTH_SIDE if pocket % 3 == 1 else MOUTH_CORNER):
                potted[i] = True
                count = record_event(events, count, POCKET, t, i, pocket, x, y, math.hypot(v[i, 0], v[i, 1]))
                continue
        gaps = (x, size[0] - x, y, size[1] - y)
        speeds = (-v[i, 0], v[i, 0], -v[i, 1], v[i, 1])
        for side in range(4):
            into = speeds[side]
            if gaps[side] >= radius[i] or into <= 0 or (pockets and is_in_mouth(x, y, side, size)):
                continue
            back = min((radius[i] - gaps[side]) / into, dt)
            count = record_event(
                events, count, CUSHION, t - back, i, side, x - v[i, 0] * back, y - v[i, 1] * back, into
            )
            e = p[5] * into ** -p[17] - p[6] * into
            apply_cushion_contact(v[i], w[i], side, radius[i], min(max(e, 0.0), 1.0), p[7], p[18], law)
    return count


@njit(cache=CACHE_COMPILED)
def resolve_ball_contacts(xyz, v, w, moving, potted, radius, mass, e, mu, law, t, dt, events, count):
    """Resolve contacts between balls in the step that ends at t."""
    for i in range(len(xyz)):
        for j in range(i + 1, len(xyz)):
            if potted[i] or potted[j] or not (moving[i] or moving[j]):
                continue
            dx, dy = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1]
            touch = radius[i] + radius[j]
            if dx * dx + dy * dy >= touch * touch:
                continue
            gap = math.hypot(dx, dy)
            closing = ((v[i, 0] - v[j, 0]) * dx + (v[i, 1] - v[j, 1]) * dy) / gap
            if closing <= 0:
                continue
            back = min((touch - gap) / closing, dt)
            a, b = (i, j) if math.hypot(v[i, 0], v[i, 1]) >= math.hypot(v[j, 0], v[j, 1]) else (j, i)
            x, y = xyz[a, 0] - v[a, 0] * back, xyz[a, 1] - v[a, 1] * back
            if closing > RESTING_CLOSING:
                count = record_event(events, count, BALL, t - back, a, b, x, y, closing)
            nx, ny = dx / gap, dy / gap
            apply_ball_contact(v[i], w[i], v[j], w[j], nx, ny, radius[i], radius[j], mass[i], mass[j], e, mu, law)
            moving[i] = moving[j] = True
    return count


@njit(cache=CACHE_COMPILED)
def march_shot(xyz, v, w, size, radius, mass, pockets, p, laws, dt, steps, every):
    """Simulate N balls with radii and masses (N,).

    Returns samples (T, N, 12) of x, y, z, v, w, q, and events (E, 7) of kind, t, a, b, x, y, speed.
    """
    n = len(xyz)
    q = np.zeros((n, 4))
    q[:, 0] = 1.0
    potted, moving, fall = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.zeros(n)
    events, count = np.empty((MOST_EVENTS, 7)), 0
    samples = np.empty((steps // every + 1, n, 12))
    for i in range(n):
        moving[i] = v[i, 0] != 0 or v[i, 1] != 0
        if moving[i]:
            count = record_event(events, count, STRIKE, 0.0, i, -1, xyz[i, 0], xyz[i, 1], math.hypot(v[i, 0], v[i, 1]))
    for step in range(steps + 1):
        if step % every == 0:
            row = samples[step // every]
            row[:, :3], row[:, 3:5], row[:, 5:8], row[:, 8:] = xyz, v, w, q
        t = (step + 1) * dt
        count = move_balls(xyz, v, w, q, moving, potted, fall, size, radius, p, t, dt, events, count)
        count = resolve_rails(xyz, v, w, moving, potted, size, radius, pockets, p, laws[0], t, dt, events, count)
        count = resolve_ball_contacts(
            xyz, v, w, moving, potted, radius, mass, p[8], p[9], laws[1], t, dt, events, count
        )
    return samples, events[:count]


def read_parameters(effects: dict[str, dict[str, float]]) -> Floats:
    """Return the parameters in the order of `PARAMETERS`; an effect that is not listed is neutral."""
    by_name = {f"{effect}.{name}": value for effect, values in effects.items() for name, value in values.items()}
    if unknown := set(by_name) - set(PARAMETERS):
        raise SystemExit(f"this simulator has the parameters {', '.join(PARAMETERS)}; got {', '.join(sorted(unknown))}")
    return np.array([by_name.get(name, NEUTRAL.get(name, 0.0)) for name in PARAMETERS])


def play(shot: dict, dt: float = STEP) -> tuple[Floats, Floats]:
    """Simulate a shot in steps of about `dt`; returns samples (T, N, 12) at its `hz`, and events (E, 7)."""
    balls, table = shot["balls"], shot["table"]
    radius = np.array([float(b["radius"]) for b in balls])
    mass = np.array([float(b.get("mass", 1.0)) for b in balls])
    xyz = np.array([[b["x"], b["y"], b["radius"]] for b in balls])
    v = np.array([[b.get("vx", 0.0), b.get("vy", 0.0)] for b in balls])
    w = np.array([[b.get("wx", 0.0), b.get("wy", 0.0), b.get("wz", 0.0)] for b in balls])
    laws = shot.get("laws", {})
    if laws.get("cushion", "mirror") == "mirror" and "cushion_height" in shot.get("effects", {}):
        raise SystemExit("the mirror of this simulator touches the centre; take han_2005 or mathavan_2010")
    chosen = (CUSHION_LAWS[laws.get("cushion", "mirror")], BALL_LAWS[laws.get("ball", "inelastic")])
    every = round(1 / (shot.get("hz", 1000) * dt))
    dt = 1 / (shot.get("hz", 1000) * every)  # so that samples are whole steps apart at any rate
    steps = round(shot["seconds"] / dt)
    size = (float(table["length"]), float(table["width"]))
    pockets = bool(table.get("pockets", False))
    return march_shot(
        xyz, v, w, size, radius, mass, pockets, read_parameters(shot.get("effects", {})), chosen, dt, steps, every
    )


def write(shot: dict, samples: Floats, events: Floats, out: Path) -> None:
    """Write trajectory.csv and events.csv into the folder `out`."""
    ids, hz = [ball["id"] for ball in shot["balls"]], shot.get("hz", 1000)
    out.mkdir(parents=True, exist_ok=True)
    with (out / "trajectory.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("t", "id", "x", "y", "z", "vx", "vy", "wx", "wy", "wz", "qw", "qx", "qy", "qz"))
        for step, balls in enumerate(samples):
            for name, row in zip(ids, balls, strict=True):
                rows.writerow([f"{step / hz:.6f}", name, *(f"{x:.7g}" for x in row)])
    with (out / "events.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("kind", "t", "a", "b", "x", "y", "speed"))
        for kind, t, a, b, x, y, speed in events:
            names = {BALL: ids, CUSHION: CUSHIONS, POCKET: POCKETS}.get(int(kind))
            other = names[int(b)] if names else ""
            rows.writerow([KINDS[int(kind)], f"{t:.6f}", ids[int(a)], other, f"{x:.6f}", f"{y:.6f}", f"{speed:.5f}"])


def main() -> None:
    if len(sys.argv) < 3 or len(sys.argv) % 2 == 0:
        raise SystemExit("usage: python worlds/billiards.py SHOT.json OUT [SHOT.json OUT ...]")
    for source, out in zip(sys.argv[1::2], sys.argv[2::2], strict=True):
        shot = json.loads(Path(source).read_text())
        samples, events = play(shot)
        write(shot, samples, events[np.argsort(events[:, 1], kind="stable")], Path(out))


if __name__ == "__main__":
    main()
