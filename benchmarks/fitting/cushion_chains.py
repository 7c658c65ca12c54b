"""Paths of one ball linked at cushions by a contact model, as windows of the multiple-shooting fit.

Every path between two contacts is a window. Where its fitted path meets the cushion, the contact model gives velocity
and spin after it, and so the start of the next window; real cushions scatter a little about every model. The next path,
and the next cushion, constrain the spin that no frame shows. Contact models are compared by their predictions: of a
path from the paths before it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import SEGMENT_STATE_SIZE, ClothFriction
from models.core.events import Events
from models.core.scene import CUSHIONS, Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, Window
from models.estimation.segmentation.contact_classification import INWARD_NORMALS
from models.estimation.whole_shot.shot_segments import SLIP_SIGMA, VELOCITY_SIGMA
from models.physics.billiards.cloth.closed_form_motion import differentiate_kinematics
from models.physics.billiards.parameter_vector import CUSHION_E, CUSHION_MU, SLIDING_MU, neutral_parameters
from models.physics.billiards.tables import NOSE_SIGMA
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# A cushion contact model: vn, vt, wn, wt, wz, radius, mass and p to the first five after the contact.
CushionLaw = Callable[..., tuple[complex, complex, complex, complex, complex]]

# Scatter of real cushions about every model, as a share of the speed, per component of velocity, slip and surface speed
# of side spin.
REBOUND_SCATTER = 0.05
# m, scatter of the position after a cushion.
POSITION_SCATTER = 0.001
_COMPLEX_STEP = 1e-30
_NEWTON_ITERATIONS = 12
# Inputs of a contact model among state and shared parameters: velocity, slip, side spin, sliding friction, restitution,
# cushion friction.
_LAW_INPUTS = (2, 3, 4, 5, 6, 7, 9, 10)


@dataclass(frozen=True, slots=True)
class CushionBounce:
    """The cushion at which a path ends."""

    cushion: str
    t: float
    """s, approximate time."""


@dataclass(frozen=True, slots=True)
class ChainSegment:
    """One path: from `begin` to the next contact."""

    chain: int
    """Segments that cushions link have one number."""
    ball: str
    begin: float
    """s, approximate time of the contact at which it begins."""
    continues_previous: bool
    """Whether a cushion links it to the previous segment."""
    t: FloatArray
    """(K,) s."""
    xy: FloatArray
    """(K, 2) m."""
    whitening: FloatArray
    """(K, 2, 2): converts a residual in m into standard deviations."""
    bounce: CushionBounce | None
    """None where it ends otherwise."""


@dataclass(frozen=True, slots=True)
class CushionChains:
    """Segments that share a cloth and a cushion model.

    State: x, y (m), vx, vy, slip ux, uy, surface speed R wz (m/s).
    """

    segments: tuple[ChainSegment, ...]
    table: Table
    law: CushionLaw
    priors: tuple[Prior, ...] = ()
    """Priors of the shared parameters from other clips; default priors where empty."""
    scatter: float = REBOUND_SCATTER
    """Scatter of the rebound, as a share of the speed."""
    windows: tuple[Window, ...] = field(init=False)
    """One window per segment."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(_build_window(segment, self.scatter) for segment in self.segments))

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of sliding and rolling friction, restitution, cushion friction, and one nose offset per cushion."""
        return self.priors or chain_priors()

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Predict the positions of a segment and the start of the next one, with Jacobians."""
        segment = self.segments[window]
        value, by_state, by_shared = predict_motion(start, segment.t - segment.begin, shared)
        end, end_by_start, end_by_shared = start, np.eye(7), np.zeros((7, len(shared)))
        if (
            segment.bounce is not None
            and window + 1 < len(self.segments)
            and self.segments[window + 1].continues_previous
        ):
            end, end_by_start, end_by_shared = self.predict_past_cushion(
                segment, start, self.segments[window + 1].begin, shared
            )
        return LinearizedWindow(
            np.einsum("kij,kj->ki", segment.whitening, value[:, :2] - segment.xy),
            np.einsum("kij,kjp->kip", segment.whitening, by_state[:, :2]),
            np.einsum("kij,kjp->kip", segment.whitening, by_shared[:, :2]),
            end, end_by_start, end_by_shared,
        )  # fmt: skip

    def predict_past_cushion(
        self, segment: ChainSegment, start: FloatArray, until: float, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Predict the state beyond the cushion that ends a segment.

        Args:
            segment: Segment that ends at a cushion.
            start: (7,) its start state.
            until: s, time of the predicted state.
            shared: (P,) shared parameters.

        Returns:
            State (7,), its Jacobians (7, 7) by the start and (7, P) by the shared parameters.

        Raises:
            ValueError: The segment does not end at a cushion.
        """
        bounce = segment.bounce
        if bounce is None:
            raise ValueError("a segment that does not end at a cushion has no continuation")
        number = CUSHIONS.index(bounce.cushion)
        inward, wall = INWARD_NORMALS[number], _wall_offset(self.table, bounce.cushion)
        tau = self._find_cushion_time(start, bounce.t - segment.begin, inward, wall - shared[4 + number], shared)
        value, by_state, by_shared, rate = _predict_with_rate(start, tau, shared)
        speed = float(inward @ value[2:4])
        tau_by_state = -(inward @ by_state[:2]) / speed
        tau_by_shared = -(inward @ by_shared[:2]) / speed
        tau_by_shared[4 + number] += 1 / speed
        by_state = by_state + np.outer(rate, tau_by_state)
        by_shared = by_shared + np.outer(rate, tau_by_shared)
        after, law_state, law_shared = self._apply_cushion_law(value, inward, shared)
        by_state, by_shared = law_state @ by_state, law_state @ by_shared + law_shared
        last, after_state, after_shared, last_rate = _predict_with_rate(after, until - segment.begin - tau, shared)
        return (
            last,
            after_state @ by_state - np.outer(last_rate, tau_by_state),
            after_state @ by_shared + after_shared - np.outer(last_rate, tau_by_shared),
        )

    def _find_cushion_time(
        self, start: FloatArray, guess: float, inward: FloatArray, wall: float, shared: FloatArray
    ) -> float:
        """Find the time after the start, in s, at which the ball touches the nose, nearest to a guess (Newton)."""
        tau = max(guess, 1e-4)
        for _ in range(_NEWTON_ITERATIONS):
            value, _, _ = predict_motion(start, np.array([tau]), shared)
            gap = float(inward @ value[0, :2]) + wall - self.table.ball_radius
            speed = float(inward @ value[0, 2:4])
            if speed > -0.01:  # it turned or stopped before: the contact model receives the least possible speed
                return tau
            step = float(np.clip(gap / -speed, -0.1, 0.1))
            tau = max(tau + step, 1e-6)
            if abs(step) < 1e-12:
                break
        return tau

    def _apply_cushion_law(
        self, state: FloatArray, inward: FloatArray, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the state (7,) after the contact, and its derivatives by the state before (7, 7) and by (P,)."""
        inputs = np.concatenate([state, shared]).astype(np.complex128)
        columns = np.zeros((7, len(inputs)))
        columns[0, 0] = columns[1, 1] = 1.0
        for k in _LAW_INPUTS:
            stepped = inputs.copy()
            stepped[k] += 1j * _COMPLEX_STEP
            after = _evaluate_rebound(self.law, stepped[:7], stepped[7:], inward, self.table)
            columns[:, k] = after.imag / _COMPLEX_STEP
        return np.asarray(after.real), columns[:, :7], columns[:, 7:]


def chain_priors() -> tuple[Prior, ...]:
    """Build the default priors of cloth and cushions.

    Returns:
        Priors of sliding friction, rolling friction, restitution, cushion friction, and one nose offset per cushion.
    """
    sliding, rolling = find_prior("sliding_friction", "mu"), find_prior("rolling_resistance", "mu")
    return (
        Prior("sliding_friction.mu", "1", sliding.value, sliding.sigma, True, sliding.bounds),
        Prior("rolling_resistance.mu", "1", rolling.value, rolling.sigma, True, rolling.bounds),
        Prior("cushion_restitution.e", "1", 0.85, 0.1, False, (0.3, 1.0)),
        Prior("cushion_friction.mu", "1", 0.18, 0.4, True, (0.01, 1.0)),
        *(Prior(f"nose.{cushion}", "m", 0.0, NOSE_SIGMA, False, (-0.03, 0.03)) for cushion in CUSHIONS),
    )


def extract_chain_segments(tracks: Tracks, events: Events, chain: int) -> tuple[ChainSegment, ...]:
    """Extract all segments of a clip that follow a contact.

    Args:
        tracks: Tracks of the clip.
        events: Contacts of the clip.
        chain: Number of the first chain; each ball and each start without a cushion begins another chain.

    Returns:
        Segments, ball by ball, in the order of time.
    """
    segments: list[ChainSegment] = []
    whiten = tracks.whitening
    number = chain - 1
    for ball, name in enumerate(tracks.ids):
        rows = [k for k in range(len(events)) if name in (events.a[k], events.b[k]) and events.kind[k] != "rest"]
        for place, k in enumerate(rows):
            begin = float(events.t[k])
            following = rows[place + 1] if place + 1 < len(rows) else None
            end = np.inf if following is None else float(events.t[following])
            bounce = None
            if following is not None and events.kind[following] == "cushion":
                bounce = CushionBounce(events.b[following], end)
            before = segments[-1] if segments and segments[-1].ball == name else None
            continues = events.kind[k] == "cushion" and before is not None and before.bounce is not None
            number += 0 if continues else 1
            rows_between = np.flatnonzero(tracks.is_observed[:, ball] & (tracks.t > begin) & (tracks.t < end))
            t, xy, weights = tracks.t[rows_between], tracks.xy[rows_between, ball], whiten[rows_between, ball]
            segments.append(ChainSegment(number, name, begin, continues, t, xy, weights, bounce))
    return tuple(
        segment
        for segment in segments
        if segment.continues_previous or len(segment.t) >= 3 or segment.bounce is not None
    )


def predict_motion(start: FloatArray, tau: FloatArray, shared: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predict the states of a ball that touches nothing.

    Args:
        start: (7,) start state.
        tau: (K,) s after the start.
        shared: (P,) shared parameters.

    Returns:
        States (K, 7), their Jacobians (K, 7, 7) by the start and (K, 7, P) by the shared parameters.
    """
    value, slope, _ = _predict_with_derivatives(start, tau, shared)
    return value, slope[:, :, :7], slope[:, :, 7:]


def _predict_with_rate(
    start: FloatArray, tau: float, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Predict one state (7,), its Jacobians (7, 7) and (7, P), and its time derivative (7,)."""
    value, slope, rate = _predict_with_derivatives(start, np.array([tau]), shared)
    return value[0], slope[0, :, :7], slope[0, :, 7:], rate[0]


def _predict_with_derivatives(
    start: FloatArray, tau: FloatArray, shared: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Predict states (K, 7), their Jacobian (K, 7, 7 + P) and their time derivative (K, 7)."""
    state = np.concatenate([start[:6], np.zeros(2)])
    friction = ClothFriction(float(shared[0]), float(shared[1]))
    states, slopes = differentiate_kinematics(np.broadcast_to(state, (len(tau), SEGMENT_STATE_SIZE)), tau, friction)
    value = np.column_stack([states, np.full(len(tau), start[6])])
    slope = np.zeros((len(tau), 7, 7 + len(shared)))
    slope[:, :6, :6] = slopes[:, :, :6]
    slope[:, 6, 6] = 1.0
    slope[:, :6, 7] = slopes[:, :, 9] / shared[0]
    slope[:, :6, 8] = slopes[:, :, 10] / shared[1]
    return value, slope, np.column_stack([slopes[:, :, 8], np.zeros(len(tau))])


def _evaluate_rebound(
    law: CushionLaw, state: NDArray[np.complex128], shared: NDArray[np.complex128], inward: FloatArray, table: Table
) -> NDArray[np.complex128]:
    """Compute the state (7,) after a cushion, through the axes of the contact model: n into the cushion, t = z x n."""
    radius, n = table.ball_radius, -inward
    t = np.array([-n[1], n[0]])
    v, u = state[2:4], state[4:6]
    w = np.array([u[1] - v[1], v[0] - u[0]]) / radius
    p = neutral_parameters().astype(np.complex128)
    p[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = shared[[0, 2, 3]]
    out = law(v @ n, v @ t, w @ n, w @ t, state[6] / radius, complex(radius), complex(table.ball_mass), p)
    left, turned = out[0] * n + out[1] * t, out[2] * n + out[3] * t
    slip = np.array([left[0] - radius * turned[1], left[1] + radius * turned[0]])
    return np.concatenate([state[:2], left, slip, [radius * out[4]]])


def _wall_offset(table: Table, cushion: str) -> float:
    """Return -(inward . nose), so that inward . x + offset is the distance of x from the nose."""
    return {"left": 0.0, "right": table.length, "top": 0.0, "bottom": table.width}[cushion]


def _build_window(segment: ChainSegment, scatter: float) -> Window:
    """Build a window that starts at the line through the first samples.

    After a contact of unknown kind, the prior of the spin allows anything that a cue can cause.
    """
    few = min(len(segment.t), 5)
    line: FloatArray = np.zeros((2, 2))
    if few >= 2:
        line = np.asarray(
            np.linalg.lstsq(np.vander(segment.t[:few] - segment.begin, 2), segment.xy[:few], rcond=None)[0]
        )
    elif few == 1:
        line[1] = segment.xy[0]
    start = np.concatenate([line[1], line[0], np.zeros(3)])
    speed = float(np.hypot(*line[0]))
    body, sigma = np.zeros(len(segment.t), np.int64), np.full(7, np.inf)
    if not segment.continues_previous:
        spin = SLIP_SIGMA * speed + 0.2
        sigma[2:] = [VELOCITY_SIGMA, VELOCITY_SIGMA, spin, spin, spin]
        others = tuple(np.concatenate([start[:4], share * start[2:4], [side * speed]])
                       for share in (-0.7, 0.3) for side in (-0.5, 0.5))  # fmt: skip
        return Window(segment.chain, segment.t, body, start, sigma, None, others)
    wander = scatter * max(speed, 0.1)
    return Window(segment.chain, segment.t, body, start, sigma, np.array([POSITION_SCATTER] * 2 + [wander] * 5))
