"""Paths of one ball tied together at cushions by a law, as windows of the fit by shooting.

Every path between two contacts is a window. Where it meets the cushion on its fitted way, the law says with what
velocity and spin it leaves, and so where the next window begins; real cushions scatter a little about every law. Spin
that no picture shows is told by the next path, and the next cushion. So laws compare by what they predict: a path from
the paths before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.core.events import Events
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Window
from models.estimation.segmentation.contact_classification import INWARD
from models.estimation.whole_shot.free_paths import FASTEST, SLIP
from models.physics.billiards.cloth.closed_form_motion import STATE, Friction, kinematics_jacobian
from models.physics.billiards.parameters import CUSHION_E, CUSHION_MU, SLIDING_MU, neutral
from models.physics.effect import Prior
from models.physics.effects.catalogue import prior_of

Rebound = Callable[..., tuple[complex, complex, complex, complex, complex]]
"""A cushion law: vn, vt, wn, wt, wz, radius, mass, p to the first five."""

NOSE_SIGMA = 0.004
"""m: one offset per cushion, for what the calibration misses and the rubber gives."""
SCATTER = 0.05
"""of the speed: what real cushions add to every law, per component of velocity, slip and surface speed of side spin."""
PLACE_SCATTER = 0.001
"""m"""
_STEP = 1e-30
_NEWTON = 12
_TOLD = (2, 3, 4, 5, 6, 7, 9, 10)
"""What a law looks at, of state and shared numbers: velocity, slip, side spin; sliding mu, restitution, friction."""


@dataclass(frozen=True, slots=True)
class Bounce:
    """The cushion at which a path ends."""

    cushion: str
    t: float
    """s, about when."""


@dataclass(frozen=True, slots=True)
class Leg:
    """One path: from `begin` to the next contact."""

    chain: int
    """legs that cushions tie have one number."""
    ball: str
    begin: float
    """s, about when the contact was after which it begins."""
    tied: bool
    """whether a cushion ties it to the leg before."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""
    bounce: Bounce | None
    """None where it ends otherwise."""


@dataclass(frozen=True, slots=True)
class CushionChains:
    """Legs that share a cloth and a cushion law; state: x, y, vx, vy, slip ux, uy, surface speed R wz (m, m/s)."""

    legs: tuple[Leg, ...]
    table: Table
    law: Rebound
    known: tuple[Prior, ...] = ()
    """of the shared numbers, where other clips have told them."""
    scatter: float = SCATTER
    """of the speed."""
    windows: tuple[Window, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(_window(leg, self.scatter) for leg in self.legs))

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Sliding mu, rolling mu, cushion e, cushion mu, and one nose offset per cushion."""
        return self.known or chain_priors()

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        """Positions of a leg, and where the law puts the next one."""
        leg = self.legs[window]
        value, by_state, by_shared = glide(start, leg.t - leg.begin, shared)
        end, end_by_start, end_by_shared = start, np.eye(7), np.zeros((7, len(shared)))
        if leg.bounce is not None and window + 1 < len(self.legs) and self.legs[window + 1].tied:
            end, end_by_start, end_by_shared = self.hop(leg, start, self.legs[window + 1].begin, shared)
        return Flow(
            np.einsum("kij,kj->ki", leg.whiten, value[:, :2] - leg.xy),
            np.einsum("kij,kjp->kip", leg.whiten, by_state[:, :2]),
            np.einsum("kij,kjp->kip", leg.whiten, by_shared[:, :2]),
            end, end_by_start, end_by_shared,
        )  # fmt: skip

    def hop(
        self, leg: Leg, start: FloatArray, until: float, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """State (7,) at `until` s beyond the cushion that ends a leg, with slopes (7, 7) and (7, P)."""
        bounce = leg.bounce
        if bounce is None:
            raise ValueError("a leg that ends at no cushion does not go on")
        number = CUSHIONS.index(bounce.cushion)
        inward, wall = INWARD[number], _wall(self.table, bounce.cushion)
        tau = self._meeting(start, bounce.t - leg.begin, inward, wall - shared[4 + number], shared)
        value, by_state, by_shared, rate = _glide_with_rate(start, tau, shared)
        speed = float(inward @ value[2:4])
        tau_by_state = -(inward @ by_state[:2]) / speed
        tau_by_shared = -(inward @ by_shared[:2]) / speed
        tau_by_shared[4 + number] += 1 / speed
        by_state = by_state + np.outer(rate, tau_by_state)
        by_shared = by_shared + np.outer(rate, tau_by_shared)
        after, law_state, law_shared = self._rebounded(value, inward, shared)
        by_state, by_shared = law_state @ by_state, law_state @ by_shared + law_shared
        last, after_state, after_shared, last_rate = _glide_with_rate(after, until - leg.begin - tau, shared)
        return (
            last,
            after_state @ by_state - np.outer(last_rate, tau_by_state),
            after_state @ by_shared + after_shared - np.outer(last_rate, tau_by_shared),
        )

    def _meeting(self, start: FloatArray, guess: float, inward: FloatArray, wall: float, shared: FloatArray) -> float:
        """s after the start at which the ball's centre is one radius from the nose, nearest to a guess (Newton)."""
        tau = max(guess, 1e-4)
        for _ in range(_NEWTON):
            value, _, _ = glide(start, np.array([tau]), shared)
            gap = float(inward @ value[0, :2]) + wall - self.table.ball_radius
            speed = float(inward @ value[0, 2:4])
            if speed > -0.01:  # it turned or stopped before: the law sees it arrive as slowly as may be
                return tau
            step = float(np.clip(gap / -speed, -0.1, 0.1))
            tau = max(tau + step, 1e-6)
            if abs(step) < 1e-12:
                break
        return tau

    def _rebounded(
        self, state: FloatArray, inward: FloatArray, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """State (7,) after the law, and its derivatives by the state before (7, 7) and the shared numbers (7, P)."""
        inputs = np.concatenate([state, shared]).astype(np.complex128)
        columns = np.zeros((7, len(inputs)))
        columns[0, 0] = columns[1, 1] = 1.0
        for k in _TOLD:
            stepped = inputs.copy()
            stepped[k] += 1j * _STEP
            after = _through(self.law, stepped[:7], stepped[7:], inward, self.table)
            columns[:, k] = after.imag / _STEP
        return np.asarray(after.real), columns[:, :7], columns[:, 7:]


def chain_priors() -> tuple[Prior, ...]:
    """What is known of cloth and cushions before anything is seen."""
    sliding, rolling = prior_of("sliding_friction", "mu"), prior_of("rolling_resistance", "mu")
    return (
        Prior("sliding_friction.mu", "1", sliding.value, sliding.sigma, True, sliding.bounds),
        Prior("rolling_resistance.mu", "1", rolling.value, rolling.sigma, True, rolling.bounds),
        Prior("cushion_restitution.e", "1", 0.85, 0.1, False, (0.3, 1.0)),
        Prior("cushion_friction.mu", "1", 0.18, 0.4, True, (0.01, 1.0)),
        *(Prior(f"nose.{cushion}", "m", 0.0, NOSE_SIGMA, False, (-0.03, 0.03)) for cushion in CUSHIONS),
    )


def legs_of(tracks: Tracks, events: Events, chain: int) -> tuple[Leg, ...]:
    """All legs of a clip that follow a contact; `chain` numbers the first chain, each ball and fresh start another."""
    found: list[Leg] = []
    whiten = tracks.whitening
    number = chain - 1
    for ball, name in enumerate(tracks.ids):
        rows = [k for k in range(len(events)) if name in (events.a[k], events.b[k]) and events.kind[k] != "rest"]
        for place, k in enumerate(rows):
            begin = float(events.t[k])
            follows = rows[place + 1] if place + 1 < len(rows) else None
            end = np.inf if follows is None else float(events.t[follows])
            bounce = None
            if follows is not None and events.kind[follows] == "cushion":
                bounce = Bounce(events.b[follows], end)
            before = found[-1] if found and found[-1].ball == name else None
            tied = events.kind[k] == "cushion" and before is not None and before.bounce is not None
            number += 0 if tied else 1
            seen = np.flatnonzero(tracks.observed[:, ball] & (tracks.t > begin) & (tracks.t < end))
            t, xy, weights = tracks.t[seen], tracks.xy[seen, ball], whiten[seen, ball]
            found.append(Leg(number, name, begin, tied, t, xy, weights, bounce))
    return tuple(leg for leg in found if leg.tied or len(leg.t) >= 3 or leg.bounce is not None)


def glide(start: FloatArray, tau: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """States (K, 7) of a ball at tau (K,) s after its start (7,), with slopes (K, 7, 7) and (K, 7, P)."""
    value, slope, _ = _glide(start, tau, shared)
    return value, slope[:, :, :7], slope[:, :, 7:]


def _glide_with_rate(
    start: FloatArray, tau: float, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """One state (7,), its slopes (7, 7) and (7, P), and its rate (7,)."""
    value, slope, rate = _glide(start, np.array([tau]), shared)
    return value[0], slope[0, :, :7], slope[0, :, 7:], rate[0]


def _glide(start: FloatArray, tau: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    state = np.concatenate([start[:6], np.zeros(2)])
    friction = Friction(float(shared[0]), float(shared[1]))
    moved, slopes = kinematics_jacobian(np.broadcast_to(state, (len(tau), STATE)), tau, friction)
    value = np.column_stack([moved, np.full(len(tau), start[6])])
    slope = np.zeros((len(tau), 7, 7 + len(shared)))
    slope[:, :6, :6] = slopes[:, :, :6]
    slope[:, 6, 6] = 1.0
    slope[:, :6, 7] = slopes[:, :, 9] / shared[0]
    slope[:, :6, 8] = slopes[:, :, 10] / shared[1]
    return value, slope, np.column_stack([slopes[:, :, 8], np.zeros(len(tau))])


def _through(
    law: Rebound, state: NDArray[np.complex128], shared: NDArray[np.complex128], inward: FloatArray, table: Table
) -> NDArray[np.complex128]:
    """State (7,) after a cushion, in the axes of the law: n into the cushion, t = z x n."""
    radius, n = table.ball_radius, -inward
    t = np.array([-n[1], n[0]])
    v, u = state[2:4], state[4:6]
    w = np.array([u[1] - v[1], v[0] - u[0]]) / radius
    p = neutral().astype(np.complex128)
    p[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = shared[[0, 2, 3]]
    out = law(v @ n, v @ t, w @ n, w @ t, state[6] / radius, complex(radius), complex(table.ball_mass), p)
    left, turned = out[0] * n + out[1] * t, out[2] * n + out[3] * t
    slip = np.array([left[0] - radius * turned[1], left[1] + radius * turned[0]])
    return np.concatenate([state[:2], left, slip, [radius * out[4]]])


def _wall(table: Table, cushion: str) -> float:
    """-(inward . nose), so that inward . x + wall is the distance of x from the nose."""
    return {"left": 0.0, "right": table.length, "top": 0.0, "bottom": table.width}[cushion]


def _window(leg: Leg, scatter: float) -> Window:
    """Starts where the first samples say; from a contact of an unknown kind, spin may be anything a cue can give."""
    few = min(len(leg.t), 5)
    line: FloatArray = np.zeros((2, 2))
    if few >= 2:
        line = np.asarray(np.linalg.lstsq(np.vander(leg.t[:few] - leg.begin, 2), leg.xy[:few], rcond=None)[0])
    elif few == 1:
        line[1] = leg.xy[0]
    start = np.concatenate([line[1], line[0], np.zeros(3)])
    speed = float(np.hypot(*line[0]))
    body, sigma = np.zeros(len(leg.t), np.int64), np.full(7, np.inf)
    if not leg.tied:
        spin = SLIP * speed + 0.2
        sigma[2:] = [FASTEST, FASTEST, spin, spin, spin]
        others = tuple(np.concatenate([start[:4], share * start[2:4], [side * speed]])
                       for share in (-0.7, 0.3) for side in (-0.5, 0.5))  # fmt: skip
        return Window(leg.chain, leg.t, body, start, sigma, None, others)
    wander = scatter * max(speed, 0.1)
    return Window(leg.chain, leg.t, body, start, sigma, np.array([PLACE_SCATTER] * 2 + [wander] * 5))
