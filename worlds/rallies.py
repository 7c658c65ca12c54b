"""Simulate rallies of badminton, tennis and table tennis, independently of the program that is checked against them.

    python worlds/rallies.py EXPERIMENT.json OUT

EXPERIMENT.json holds `sport` (`badminton`, `tennis`, `table-tennis`), `seed`, `rallies` (their number), and optionally
`strokes` (least and largest number) and `ending` (`in`, `out`, `net`, `winner`). OUT gets, for rally i, `0000.npz` with
`t` (S,) s, `xyz` (S, 3) m, `v` (S, 3) m/s, `nose` (S, 3), the direction of a shuttle's cork, and `0000.json` with the
sport, surface, strokes, events (`hit`, `bounce`, `net`, `landing`; what follows the landing is `after`), players and
how it ended. x runs along the court from the end of player 0 to that of player 1, y across, z up from the surface.

A shuttle has an attitude: the flow turns its nose into the wind, and drag and side force depend on the angle between
nose and path (Cohen et al. 2015, New J. Phys. 17, 063001). After a hit the nose points back. A tennis ball has drag and
lift over the ratio of spin and speed as Stepanek 1988 (Am. J. Phys. 56, 138) measured them; a table tennis ball has a
lift that saturates. Bounces: restitution falls with speed, Coulomb friction turns sliding into spin (Cross 2002).
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CACHE_COMPILED = __name__ == "__main__"
GRAVITY, AIR = 9.81, 1.2
# s, step of the integration and of the stored path.
STEP = 1e-3
SHUTTLE, TENNIS, CELLULOID = range(3)
HIT, BOUNCE, NET, LANDING = range(4)
KINDS = ("hit", "bounce", "net", "landing")
# Turn of a shuttle's nose into the wind, 1/m2, and its damping, 1/m: half a turn takes 29 ms at 50 m/s.
TURN, DAMPING = 4.7, 1.1
# Drag and side force of a shuttle across the wind over its drag along it.
BROADSIDE, SIDE_FORCE = 0.8, 0.35
# Inertia of a ball in units of m r^2.
INERTIA = {SHUTTLE: 1.0, TENNIS: 0.55, CELLULOID: 2 / 3}


@dataclass(frozen=True)
class Court:
    """Measures of a sport, m, and its object."""

    kind: int
    length: float
    width: float
    side: float
    """From the outer line to the singles line."""
    service: float
    """From the net to the service line (badminton: the short one)."""
    net: tuple[float, float, float]
    """Height at the middle and at the posts, and overhang of the posts."""
    radius: float
    mass: float
    floor: float
    home: float
    """From the net to where a player waits."""
    stride: float
    """m/s of a running player."""
    surfaces: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Restitution at low speed, its fall per m/s, friction."""


COURTS = {
    "badminton": Court(
        SHUTTLE, 13.40, 6.10, 0.46, 1.98, (1.524, 1.55, 0.0), 0.033, 0.0052, 0.0, 3.9, 5.5, {"mat": (0.25, 0.0, 0.5)}
    ),
    "tennis": Court(
        TENNIS, 23.77, 10.97, 1.372, 6.40, (0.914, 1.07, 0.914), 0.0335, 0.0577, 0.0, 12.9, 6.5,
        {"hard": (0.82, 0.0110, 0.62), "clay": (0.86, 0.0105, 0.82), "grass": (0.76, 0.0120, 0.50)},
    ),
    "table-tennis": Court(
        CELLULOID, 2.74, 1.525, 0.0, 1.37, (0.1525, 0.1525, 0.1525), 0.020, 0.0027, -0.76, 2.0, 3.5,
        {"table": (0.945, 0.012, 0.25)},
    ),
}  # fmt: skip


@njit(cache=CACHE_COMPILED)
def change_rate(s, kind, air):
    """Return the derivative (12,) of place, velocity, and nose and its turn (shuttle), or spin (balls)."""
    rate = np.zeros(12)
    rate[:3] = s[3:6]
    v, a = s[3:6], s[6:9]
    speed = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2) + 1e-12
    if kind == SHUTTLE:
        along = (a[0] * v[0] + a[1] * v[1] + a[2] * v[2]) / speed
        # feathers give way at high speed
        k = air * (1 - 0.08 * speed**2 / (speed**2 + 1600.0)) * speed
        drag = k * (1 + BROADSIDE * (1 - along**2))
        side = 2 * SIDE_FORCE * k * along * speed
        for i in range(3):
            rate[3 + i] = -drag * v[i] + side * (a[i] - along * v[i] / speed)
        w = s[9:12]
        rate[6], rate[7], rate[8] = w[1] * a[2] - w[2] * a[1], w[2] * a[0] - w[0] * a[2], w[0] * a[1] - w[1] * a[0]
        pull = TURN * speed
        rate[9] = pull * (a[1] * v[2] - a[2] * v[1]) - DAMPING * speed * w[0]
        rate[10] = pull * (a[2] * v[0] - a[0] * v[2]) - DAMPING * speed * w[1]
        rate[11] = pull * (a[0] * v[1] - a[1] * v[0]) - DAMPING * speed * w[2]
    else:
        spin = math.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2) + 1e-9
        radius = 0.0335 if kind == TENNIS else 0.020
        ratio = speed / (spin * radius)
        if kind == TENNIS:
            drag = 0.508 + (1 / (22.503 + 4.196 * ratio**2.5)) ** 0.4 - 0.03 * speed**2 / (speed**2 + 1600.0)
            lift, decay = 1 / (2.022 + 0.981 * ratio), 0.0025 * speed
        else:
            drag = 0.41 + 0.12 / (1 + ratio) + 0.05 / (1 + (speed / 8.0) ** 2)
            lift, decay = 0.36 * (1 - math.exp(-1.5 / ratio)), 0.012 * speed
        # a ball that spins about its path has no lift
        cx, cy, cz = a[1] * v[2] - a[2] * v[1], a[2] * v[0] - a[0] * v[2], a[0] * v[1] - a[1] * v[0]
        push = air * lift * speed / spin
        rate[3], rate[4], rate[5] = push * cx, push * cy, push * cz
        for i in range(3):
            rate[3 + i] -= air * drag * speed * v[i]
            rate[6 + i] = -decay * a[i]
    rate[5] -= GRAVITY
    return rate


@njit(cache=CACHE_COMPILED)
def step_forward(s, kind, air, dt):
    """Return the state after dt by Runge and Kutta's fourth-order step."""
    a = change_rate(s, kind, air)
    b = change_rate(s + dt / 2 * a, kind, air)
    c = change_rate(s + dt / 2 * b, kind, air)
    new = s + dt / 6 * (a + 2 * b + 2 * c + change_rate(s + dt * c, kind, air))
    if kind == SHUTTLE:
        new[6:9] /= math.sqrt(new[6] ** 2 + new[7] ** 2 + new[8] ** 2)
    return new


@njit(cache=CACHE_COMPILED)
def bounce(s, kind, radius, restitution, fall, friction, inertia):
    """Change velocity and spin by the contact with a level surface."""
    into = -s[5]
    e = max(restitution - fall * into, 0.2)
    if kind == SHUTTLE:
        s[3] *= 1 - friction
        s[4] *= 1 - friction
        s[5] = e * into
        return
    slip_x, slip_y = s[3] - radius * s[7], s[4] + radius * s[6]
    slip = math.hypot(slip_x, slip_y) + 1e-12
    push = min(friction * (1 + e) * into, slip * inertia / (1 + inertia))
    s[3] -= push * slip_x / slip
    s[4] -= push * slip_y / slip
    s[7] += push * slip_x / slip / (inertia * radius)
    s[6] -= push * slip_y / slip / (inertia * radius)
    s[5] = e * into


@njit(cache=CACHE_COMPILED)
def touch_net(s, above):
    """Change the velocity at the net; `above` is the height of the lower edge over the upper edge of the net, m."""
    if above > -0.03:
        s[3] *= 0.65
        s[4] *= 0.85
        s[5] = 0.5 * s[5] + 0.06 * abs(s[3])
    else:
        s[3] *= -0.06
        s[4] *= 0.25
        s[5] *= 0.3


@njit(cache=CACHE_COMPILED)
def fly(start, kind, air, g, steps):
    """Let the object fly, bounce and touch the net.

    Args:
        start: (12,) state.
        g: (11,) length, width, net heights and overhang, radius, restitution, fall, friction, inertia, floor.

    Returns:
        States (steps + 1, 12), and events (E, 5): kind, t, x, y, z.
    """
    path, events, count = np.zeros((steps + 1, 12)), np.zeros((60, 5)), 0
    path[0] = start
    s, rest = start.copy(), False
    for i in range(steps):
        if rest:
            path[i + 1] = s
            continue
        new = step_forward(s, kind, air, STEP)
        middle, radius = g[0] / 2, g[5]
        if (s[0] - middle) * (new[0] - middle) < 0 and count < 60:
            f = (middle - s[0]) / (new[0] - s[0])
            y, z = s[1] + f * (new[1] - s[1]), s[2] + f * (new[2] - s[2])
            off = abs(y - g[1] / 2) / (g[1] / 2 + g[4])
            above = z - radius - (g[2] + (g[3] - g[2]) * off**2)
            is_low = kind == CELLULOID and z < 0.0
            if off < 1 and above < 0 and not is_low:
                events[count] = np.array([NET, (i + f) * STEP, middle, y, z])
                count += 1
                side = 1.0 if s[0] > middle else -1.0
                new = s + f * (new - s)
                touch_net(new, above)
                through = 1.0 if new[3] > 0 else -1.0
                new[0] = middle + 1e-4 * (through if above > -0.03 else side)
        is_table = g[10] < 0 and 0 <= new[0] <= g[0] and 0 <= new[1] <= g[1]
        for level in (0.0, g[10]):
            if level == 0.0 and g[10] < 0 and not is_table:
                continue
            if s[2] >= level + radius > new[2] and count < 60:
                f = (s[2] - level - radius) / (s[2] - new[2])
                new = s + f * (new - s)
                events[count] = np.array([BOUNCE, (i + f) * STEP, new[0], new[1], level])
                count += 1
                new[2] = level + radius
                soft = 1.0 if level == 0.0 else 0.85
                bounce(new, kind, radius, g[6] * soft, g[7], g[8], g[9])
                new[:3] += (1 - f) * STEP * new[3:6]
                new[2] = max(new[2], level + radius)
                if new[5] < 0.3:
                    new[3:6] = 0.0
                    new[9:12] = 0.0
                    rest = True
                break
        s = new
        path[i + 1] = s
    return path, events[:count]


@njit(cache=CACHE_COMPILED)
def find_crossing(start, kind, air, level, net_x):
    """Return x and y where the free path falls through a level, and its height where it passes the net (NaN: never)."""
    s, over = start, np.nan
    for _ in range(6000):
        new = step_forward(s, kind, air, STEP)
        if (s[0] - net_x) * (new[0] - net_x) <= 0:
            over = s[2] + (net_x - s[0]) / (new[0] - s[0] + 1e-15) * (new[2] - s[2])
        if s[2] >= level > new[2]:
            f = (s[2] - level) / (s[2] - new[2])
            return s[0] + f * (new[0] - s[0]), s[1] + f * (new[1] - s[1]), over
        if new[2] < level - 3.0:
            break
        s = new
    return s[0], s[1], np.nan


# Strokes: least and largest contact height over the floor (m), of what is fixed (speed m/s or elevation in degrees),
# depth of the target behind the net as shares of the half court, top spin (rad/s), weight.
Stroke = tuple[str, tuple[float, float], str, tuple[float, float], tuple[float, float], tuple[float, float], float]
STROKES: dict[str, tuple[Stroke, ...]] = {
    "badminton": (
        ("clear", (1.8, 3.2), "elevation", (12, 45), (0.80, 0.97), (0, 0), 3),
        ("drop", (1.6, 3.2), "speed", (13, 24), (0.12, 0.33), (0, 0), 2),
        ("smash", (2.2, 3.2), "speed", (45, 105), (0.35, 0.93), (0, 0), 3),
        ("drive", (0.9, 2.2), "speed", (20, 40), (0.45, 0.95), (0, 0), 2),
        ("lift", (0.0, 1.3), "elevation", (42, 72), (0.78, 0.97), (0, 0), 3),
        ("net shot", (0.0, 1.6), "elevation", (35, 75), (0.05, 0.22), (0, 0), 2),
        ("push", (0.3, 1.6), "elevation", (20, 40), (0.5, 0.9), (0, 0), 1),
    ),
    "tennis": (
        ("topspin", (0.2, 1.9), "speed", (22, 40), (0.45, 0.96), (120, 330), 6),
        ("flat", (0.5, 1.9), "speed", (25, 44), (0.5, 0.96), (10, 110), 2),
        ("slice", (0.15, 1.6), "speed", (15, 27), (0.5, 0.95), (-260, -60), 2),
        ("drop shot", (0.3, 1.6), "elevation", (15, 40), (0.1, 0.3), (-250, -80), 0.5),
        ("lob", (0.2, 1.6), "elevation", (38, 60), (0.7, 0.95), (-60, 150), 0.7),
    ),
    "table-tennis": (
        ("topspin", (0.5, 1.4), "speed", (9, 20), (0.35, 0.97), (250, 750), 5),
        ("push", (0.6, 1.2), "speed", (3.5, 7), (0.3, 0.95), (-400, -100), 2),
        ("block", (0.76, 1.3), "speed", (6, 13), (0.4, 0.97), (-80, 150), 3),
        ("chop", (0.3, 1.0), "elevation", (12, 35), (0.5, 0.95), (-600, -250), 0.7),
        ("lob", (0.4, 1.1), "elevation", (40, 60), (0.6, 0.95), (0, 250), 0.5),
    ),
}
# m/s that players do not exceed in strokes whose elevation is given.
FASTEST = {"net shot": 14.0, "push": 35.0, "clear": 75.0, "lift": 65.0, "high serve": 62.0, "low serve": 20.0}
SERVES: dict[str, tuple[Stroke, ...]] = {
    "badminton": (
        ("low serve", (0, 4), "elevation", (8, 24), (0.31, 0.42), (0, 0), 1),
        ("high serve", (0, 4), "elevation", (52, 70), (0.85, 0.98), (0, 0), 1),
    ),
    "tennis": (
        ("flat serve", (0, 4), "speed", (46, 62), (0.30, 0.53), (30, 120), 1),
        ("kick serve", (0, 4), "speed", (36, 48), (0.30, 0.53), (200, 380), 1),
    ),
    "table-tennis": (("serve", (0, 4), "speed", (3, 9), (0, 0), (-350, 350), 1),),
}


@dataclass
class Game:
    """A sport as it is played in one rally."""

    sport: str
    court: Court
    surface: str
    air: float
    """1/m: drag of a shuttle, and of a ball for a drag coefficient of 1."""
    chance: np.random.Generator

    @property
    def geometry(self) -> Floats:
        """Return what `fly` needs."""
        c = self.court
        return np.array([c.length, c.width, *c.net, c.radius, *c.surfaces[self.surface], INERTIA[c.kind], c.floor])

    def net_height(self, y: float) -> float:
        """Return the height of the upper edge of the net."""
        low, high, overhang = self.court.net
        return low + (high - low) * min(abs(y - self.court.width / 2) / (self.court.width / 2 + overhang), 1.0) ** 2


def draw_game(sport: str, chance: np.random.Generator) -> Game:
    """Draw the surface and the object."""
    court = COURTS[sport]
    terminal = chance.uniform(6.55, 6.95)
    own = AIR * math.pi * court.radius**2 / (2 * court.mass) * chance.uniform(0.94, 1.06)
    # at terminal speed the feathers give way by 0.2 %
    air = GRAVITY / terminal**2 / (1 - 0.08 * 46 / 1646) if court.kind == SHUTTLE else own
    return Game(sport, court, str(chance.choice(list(court.surfaces))), air, chance)


def launch(game: Game, place: Floats, speed: float, elevation: float, azimuth: float, spin: Floats) -> Floats:
    """Return the state (12,) after a hit; `spin` is top spin, side spin (rad/s), or the slant of a shuttle's nose."""
    flat = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    along = math.cos(elevation) * flat + np.array([0, 0, math.sin(elevation)])
    across = np.array([-flat[1], flat[0], 0.0])
    if game.court.kind == SHUTTLE:
        nose = -along + spin[0] * across + spin[1] * np.cross(along, across)
        return np.concatenate([place, speed * along, nose / np.linalg.norm(nose), np.zeros(3)])
    return np.concatenate([place, speed * along, spin[0] * across + np.array([0, 0, spin[1]]), np.zeros(3)])


def aim(game: Game, place: Floats, stroke: Stroke, target: Floats) -> tuple[Floats, float] | None:
    """Find the state after a hit that sends the object to a target (2,); also return its height over the net, m."""
    court, chance = game.court, game.chance
    _, _, fixed, (low, high), _, tops, _ = stroke
    value = chance.uniform(low, high)
    if court.kind == SHUTTLE:
        spin = chance.normal(0, 0.25, 2)
    else:
        spin = np.array([chance.uniform(*tops), chance.normal(0, 0.12 * max(abs(tops[0]), abs(tops[1])))])
    away = target - place[:2]
    azimuth, wanted = math.atan2(away[1], away[0]), float(np.hypot(*away))
    small, large = (-0.6, 0.85) if fixed == "speed" else (1.0, 110.0)
    level, net_x = court.radius, court.length / 2
    for _ in range(40):
        middle = (small + large) / 2 if fixed == "speed" else math.sqrt(small * large)
        speed, elevation = (value, middle) if fixed == "speed" else (middle, math.radians(value))
        state = launch(game, place, speed, elevation, azimuth, spin)
        x, y, over = find_crossing(state, court.kind, game.air, level, net_x)
        reached = np.array([x, y]) - place[:2]
        miss = float(np.hypot(*reached)) - wanted
        turn = math.atan2(reached[1], reached[0]) - math.atan2(away[1], away[0])
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        if abs(miss) < 1e-4 and abs(turn) * wanted < 1e-4:
            return state, over - court.radius - game.net_height((place[1] + target[1]) / 2)
        azimuth -= turn
        if miss > 0:
            large = middle
        else:
            small = middle
        if abs(large - small) < 1e-9:
            # the azimuth changes the distance a little; open the bracket again
            small, large = small - 1e-3 * abs(small) - 1e-4, large + 1e-3 * abs(large) + 1e-4
    return None


def draw_target(game: Game, stroke: Stroke, side: int, place: Floats, ending: str) -> tuple[Floats, float]:
    """Draw a target (2,) in the other half; also return its margin inside the lines, m (NaN where it is not aimed)."""
    court, chance, half = game.court, game.chance, game.court.length / 2
    depth, margin = chance.uniform(*stroke[4]) * half, math.nan
    low, high = court.side, court.width - court.side
    y = chance.uniform(low + 0.08 * court.width, high - 0.08 * court.width)
    if stroke[0].endswith("serve") and court.kind != CELLULOID:
        # diagonally, into the box
        inner = chance.uniform(0.2, 0.9) * (court.width / 2 - court.side)
        y = court.width / 2 + math.copysign(inner, court.width / 2 - place[1])
    if ending in ("in", "out"):
        scale = 0.5 if court.kind == CELLULOID else 1.0
        margin = scale * (chance.uniform(0.0, 0.2) if ending == "in" else -chance.uniform(0.005, 0.25))
        if ending == "out" and chance.random() < 0.25:
            margin = -scale * chance.uniform(0.25, 1.2)
        if chance.random() < 0.5 or stroke[4][1] < 0.7:
            y = low + margin if chance.random() < 0.5 else high - margin
        else:
            depth = half - margin
    return np.array([half + depth if side == 0 else half - depth, y]), margin


def draw_stroke(game: Game, side: int, place: Floats, serve: bool, ending: str) -> dict[str, Any] | None:
    """Draw a stroke from a place (3,) that goes over the net, or into it."""
    court, chance, height = game.court, game.chance, place[2] - game.court.floor
    table = SERVES if serve else STROKES
    strokes = [s for s in table[game.sport] if s[1][0] <= height <= s[1][1]]
    if not strokes:
        return None
    if ending in ("in", "out") and court.kind == SHUTTLE:
        strokes = [s for s in strokes if s[4][1] > 0.5] or strokes
    weights = np.array([s[-1] for s in strokes])
    stroke = strokes[int(chance.choice(len(strokes), p=weights / weights.sum()))]
    target, margin = draw_target(game, stroke, side, place, ending)
    found = aim(game, place, stroke, target)
    if found is None or not math.isfinite(found[1]):
        return None
    state, over = found
    if ending == "net":
        state = lower_stroke(game, state)
        return None if state is None else {"kind": stroke[0], "state": state, "margin": math.nan, "target": target}
    if over < 0.01 or float(np.linalg.norm(state[3:6])) > FASTEST.get(stroke[0], math.inf):
        return None
    return {"kind": stroke[0], "state": state, "margin": margin, "target": target}


def lower_stroke(game: Game, state: Floats) -> Floats | None:
    """Turn a stroke down until it goes into the net."""
    into = game.net_height(state[1]) - game.chance.uniform(0.02, 0.25) * game.net_height(state[1])
    for _ in range(60):
        *_, over = find_crossing(state, game.court.kind, game.air, game.court.floor + 0.02, game.court.length / 2)
        if not math.isfinite(over):
            return None
        if over < into:
            return state
        flat = math.hypot(state[3], state[4])
        speed, elevation = math.hypot(flat, state[5]), math.atan2(state[5], flat) - 0.01
        lower = math.cos(elevation) * speed / flat
        state = state.copy()
        state[3:6] = state[3] * lower, state[4] * lower, speed * math.sin(elevation)
    return None


def draw_table_serve(game: Game, side: int, place: Floats) -> dict[str, Any] | None:
    """Draw a serve that touches both halves of the table."""
    court, chance = game.court, game.chance
    for _ in range(300):
        away = np.array([chance.uniform(0.55, 0.98) * court.length, chance.uniform(0.1, 0.9) * court.width]) - place[:2]
        if side == 1:
            away[0] = chance.uniform(0.02, 0.45) * court.length - place[0]
        spin = np.array([chance.uniform(-250, 350), chance.uniform(-250, 250)])
        azimuth = math.atan2(away[1], away[0])
        state = launch(game, place, chance.uniform(3.0, 9.0), chance.uniform(-0.5, 0.1), azimuth, spin)
        _, events = fly(state, court.kind, game.air, game.geometry, 1200)
        halves = [(e[2] > court.length / 2) == (side == 0) for e in events[:2] if e[0] == BOUNCE and e[4] == 0.0]
        if halves == [False, True] and NET not in events[:2, 0]:
            return {"kind": "serve", "state": state, "margin": math.nan, "target": events[1, 2:4]}
    return None


def find_returns(game: Game, side: int, path: Floats, events: Floats, feet: Floats, serve: bool) -> NDArray[np.int64]:
    """Return the samples of a path at which the player of a side (feet (2,), m) can hit it."""
    court, half = game.court, game.court.length / 2
    t = np.arange(len(path)) * STEP
    own = path[:, 0] > half if side == 1 else path[:, 0] < half
    height = path[:, 2] - court.floor
    touches = [e[1] for e in events if e[0] == BOUNCE]
    needed = 0 if court.kind == SHUTTLE else (2 if serve and court.kind == CELLULOID else 1)
    begin = touches[needed - 1] if needed and len(touches) >= needed else (math.inf if needed else 0.0)
    end = touches[needed] if len(touches) > needed else math.inf
    low, high, reach = {SHUTTLE: (0.2, 2.85, 1.0), TENNIS: (0.3, 1.5, 1.1), CELLULOID: (0.6, 1.3, 0.75)}[court.kind]
    depth = np.abs(path[:, 0] - half)
    least = {SHUTTLE: 0.35, TENNIS: 2.0, CELLULOID: 1.25}[court.kind]
    most = half + {SHUTTLE: 0.5, TENNIS: 5.0, CELLULOID: 2.2}[court.kind]
    away = np.hypot(path[:, 0] - feet[0], path[:, 1] - feet[1])
    can = own & (t > begin + 0.04) & (t < end - 0.02) & (height > low) & (height < high)
    can &= (depth > least) & (depth < most) & (away < reach + court.stride * np.maximum(t - 0.12, 0)) & (t > 0.22)
    return np.flatnonzero(can)


def draw_return(game: Game, path: Floats, choices: NDArray[np.int64]) -> int:
    """Choose the sample of a path at which it is hit; most high ones are hit overhead."""
    height = path[choices, 2] - game.court.floor
    if game.court.kind == SHUTTLE and height.max() > 2.4 and game.chance.random() < 0.75:
        choices = choices[height > 2.2]
    return int(game.chance.choice(choices))


def home_of(court: Court, side: int, chance: np.random.Generator) -> Floats:
    """Return where a player waits (2,), m."""
    x = court.length / 2 + (court.home if side else -court.home) * chance.uniform(0.93, 1.07)
    return np.array([x, court.width / 2 + chance.normal(0, 0.05) * court.width])


def stand_for(court: Court, side: int, place: Floats, chance: np.random.Generator) -> Floats:
    """Return where the feet (2,) are when a player hits at a place (3,)."""
    reach = {SHUTTLE: 0.55, TENNIS: 0.75, CELLULOID: 0.45}[court.kind] * chance.uniform(0.6, 1.2)
    angle = chance.uniform(-0.9, 0.9) + (0 if chance.random() < 0.6 else math.pi)
    back = abs(reach * math.sin(angle)) + (0.25 if court.kind == CELLULOID else 0.05)
    x = place[0] + (back if side else -back)
    if court.kind == CELLULOID:
        x = max(x, court.length + 0.25) if side else min(x, -0.25)
    return np.array([x, place[1] + reach * math.cos(angle)])


def first_contact(game: Game, side: int) -> Floats:
    """Return the place (3,) of the serve."""
    court, chance, half = game.court, game.chance, game.court.length / 2
    if court.kind == SHUTTLE:
        depth, y, z = court.service + chance.uniform(0.1, 0.9), chance.uniform(0.3, 1.5), chance.uniform(0.75, 1.12)
    elif court.kind == TENNIS:
        depth, y, z = half - chance.uniform(-0.1, 0.4), chance.uniform(0.2, 1.8), chance.uniform(2.5, 2.95)
    else:
        depth, y, z = half + chance.uniform(0.1, 0.4), chance.uniform(-0.5, 0.6), chance.uniform(0.12, 0.3)
    across = court.width / 2 + y * chance.choice([-1, 1])
    return np.array([half + depth if side else half - depth, across, z])


def draw_toss(game: Game, place: Floats) -> Floats:
    """Return the states (S, 12) from the hand to the serve."""
    lead = round(game.chance.uniform(0.5, 0.9) / STEP)
    rows = np.zeros((lead, 12))
    rows[:, :3], rows[:, 8] = place, -1.0
    if game.court.kind == SHUTTLE:
        return rows
    rise = game.chance.uniform(0.5, 0.9) if game.court.kind == TENNIS else game.chance.uniform(0.2, 0.5)
    up = math.sqrt(2 * GRAVITY * (rise + 0.1))
    before = (np.arange(lead) - lead) * STEP
    # falls again by 10 cm before it is hit
    v = -math.sqrt(2 * GRAVITY * 0.1) - GRAVITY * before
    z = place[2] - math.sqrt(2 * GRAVITY * 0.1) * before - GRAVITY * before**2 / 2
    in_hand = v > up
    release = z[~in_hand].min() if np.any(~in_hand) else place[2]
    rows[:, 2], rows[:, 5] = np.where(in_hand, release, z), np.where(in_hand, 0.0, v)
    return rows


def play_rally(sport: str, chance: np.random.Generator, strokes: tuple[int, int], ending: str = "") -> dict[str, Any]:
    """Play a rally; returns its path, strokes, events and players, or nothing (empty) where no stroke was found."""
    game = draw_game(sport, chance)
    court, side = game.court, int(chance.integers(2))
    count = int(chance.integers(strokes[0], strokes[1] + 1))
    ending = ending or str(chance.choice(["in", "out", "net", "winner"], p=[0.45, 0.33, 0.10, 0.12]))
    place = first_contact(game, side)
    toss = draw_toss(game, place)
    now = len(toss) * STEP
    pieces, hits, events = [toss], [], []
    feet = [home_of(court, 0, chance), home_of(court, 1, chance)]
    feet[side] = stand_for(court, side, place, chance)
    tracks = [[(0.0, *feet[0])], [(0.0, *feet[1])]]
    while True:
        serve, last = not hits, len(hits) + 1 >= count
        tracks[side].append((now, *feet[side]))
        for _ in range(80):
            goal = ending if last else "rally"
            if serve and court.kind == CELLULOID:
                stroke = draw_table_serve(game, side, place)
            else:
                stroke = draw_stroke(game, side, place, serve, goal)
            if stroke is None:
                continue
            path, touched = fly(stroke["state"], court.kind, game.air, game.geometry, 6000)
            choices = find_returns(game, 1 - side, path, touched, feet[1 - side], serve)
            if last or len(choices):
                break
        else:
            return {}
        state = stroke["state"]
        hits.append({
            "t": now, "player": side, "kind": stroke["kind"], "place": place.tolist(), "v": state[3:6].tolist(),
            "speed": float(np.linalg.norm(state[3:6])), "spin": [] if court.kind == SHUTTLE else state[6:9].tolist(),
        })  # fmt: skip
        events.append({"kind": "hit", "t": now, "place": place.tolist(), "player": side})
        home = home_of(court, side, chance)
        pace = float(np.linalg.norm(home - feet[side])) / (0.55 * court.stride) + 0.35
        if last:
            break
        row = draw_return(game, path, choices)
        after = now + row * STEP
        tracks[side].append((min(now + pace, max(after, now + 0.35)), *home))
        feet[side] = home
        pieces.append(path[:row])
        events += [describe_event(e, now) for e in touched if e[1] < row * STEP]
        place, side, now = path[row, :3].copy(), 1 - side, after
        feet[side] = stand_for(court, side, place, chance)
    landing = next((e for e in touched if e[0] == BOUNCE), None)
    if landing is None:
        return {}
    stop = round((landing[1] + chance.uniform(0.6, 1.2)) / STEP)
    pieces.append(path[:stop])
    for e in touched:
        if e[1] < stop * STEP:
            events.append(describe_event(e, now) | ({"kind": "landing"} if e[1] == landing[1] else {}))
            if e[1] > landing[1]:
                events[-1]["after"] = True
    tracks[side].append((now + pace, *home))
    other, goal = 1 - side, stand_for(court, 1 - side, np.array([*landing[2:4], 0.0]), chance)
    within = court.stride * max(landing[1] - 0.3, 0.0)
    share = min(1.0, within / max(float(np.linalg.norm(goal - feet[other])), 1e-6)) * chance.uniform(0.3, 1.0)
    tracks[other].append((max(now, tracks[other][-1][0]) + 0.25, *feet[other]))
    tracks[other].append((tracks[other][-1][0] + landing[1], *(feet[other] + share * (goal - feet[other]))))
    states = np.concatenate(pieces)
    return {
        "path": states, "sport": sport, "surface": game.surface, "strokes": hits, "events": events,
        "players": tracks, "ending": judge_landing(game, side, landing, touched) | {"planned": ending},
    }  # fmt: skip


def describe_event(event: Floats, start: float) -> dict[str, Any]:
    """Return an event of a flight that begins at `start`, s."""
    return {"kind": KINDS[int(event[0])], "t": start + float(event[1]), "place": event[2:5].tolist()}


def judge_landing(game: Game, side: int, landing: Floats, touched: Floats) -> dict[str, Any]:
    """Return where the object landed, and its margin (m) inside the singles lines of the other half, below 0: out."""
    court, half = game.court, game.court.length / 2
    x, y = landing[2], landing[3]
    low, high = (half, court.length) if side == 0 else (0.0, half)
    off = min(x - low, high - x, y - court.side, court.width - court.side - y)
    if off < 0:
        outside = [max(low - x, x - high, 0.0), max(court.side - y, y - court.width + court.side, 0.0)]
        off = -float(np.hypot(*outside))
    is_in = bool(off >= 0 and (court.floor == 0.0 or landing[4] == 0.0))
    net = any(e[0] == NET and e[1] < landing[1] for e in touched)
    return {"place": landing[2:5].tolist(), "is_in": is_in, "margin": float(off), "net": bool(net)}


def run_experiment(experiment: dict[str, Any], out: Path) -> None:
    """Write the rallies of an experiment."""
    out.mkdir(parents=True, exist_ok=True)
    shortest, longest = experiment.get("strokes", (3, 12))
    for number in range(experiment["rallies"]):
        for attempt in range(100):
            chance = np.random.default_rng([experiment["seed"], number, attempt])
            rally = play_rally(experiment["sport"], chance, (shortest, longest), experiment.get("ending", ""))
            if rally:
                break
        path = rally.pop("path")
        t = np.arange(len(path)) * STEP
        np.savez_compressed(out / f"{number:04d}.npz", t=t, xyz=path[:, :3], v=path[:, 3:6], nose=path[:, 6:9])
        (out / f"{number:04d}.json").write_text(json.dumps(rally))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit("usage: python worlds/rallies.py EXPERIMENT.json OUT")
    run_experiment(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[2]))
