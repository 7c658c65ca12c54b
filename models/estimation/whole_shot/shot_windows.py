"""Whole shots, including all contacts, as windows of the multiple-shooting fit.

A window starts at a strike, or where the previous one had become too sensitive to its start. There the spin, which no
frame shows, continues from the previous window. The contact models determine everything else: one set of parameters for
cloth, cushions, balls and camera explains all balls at all times.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, SimulatedWindow, Window
from models.estimation.whole_shot.shot_segments import ShotSegment, build_window
from models.estimation.whole_shot.window_simulation import (
    ObservedStates,
    WindowRun,
    convert_ends,
    differentiate_observations,
    is_possible,
    observe_run,
    simulate_window_run,
)
from models.numerics.jit import compile_kernel
from models.physics.billiards.parameter_vector import PARAMETER_NAMES, SLIDING_MU
from models.physics.billiards.simulation.parametrised_shot import (
    CENTRE_SIZE,
    DROPPED_FRAMES,
    IMAGE_PARAMETERS,
    IMAGE_START,
    MOVING_BALL_SIZE,
    NEUTRAL_IMAGE_PARAMETERS,
    NEUTRAL_SHOT_PARAMETERS,
    SHOT_PARAMETERS,
    SHUTTER_READOUT,
    ContactModels,
    ImagePlacement,
    distort_places,
    pack_start,
    simulate_start,
)
from models.physics.billiards.simulation.simulated_shot import SimulatedShot
from models.physics.billiards.simulation.table_physics import find_model_codes
from models.physics.effect import Prior

# Indices of the view parameters among all parameters.
VIEW_PARAMETERS = slice(IMAGE_START, IMAGE_START + len(IMAGE_PARAMETERS))
# Sliding friction at which a secant replaces the derivative where friction is absent: without it, slip does not exist.
_SECANT_SLIDING_MU = 0.2


@dataclass(frozen=True)
class ShotWindows:
    """Segments of shots on one table; segments of one shot are neighbours, in the order of time."""

    segments: tuple[ShotSegment, ...]
    table: Table
    unknowns: tuple[Prior, ...]
    """Priors of the P fitted parameters, named as in `parametrised_shot`."""
    laws: ContactModels
    fixed: FloatArray = field(default_factory=NEUTRAL_SHOT_PARAMETERS.copy)
    """(Q,) values of all parameters; those of the unknowns are not used."""
    view: ImagePlacement | None = None
    """Camera view; None: observed positions are true positions."""
    jacobian_mask: BoolArray | None = None
    """(P,) unknowns whose Jacobian is needed; None: all."""
    guess_spins: bool = True
    """Whether the slips of the initial states are guesses, so that others are to be tried."""
    latest_runs: dict[int, tuple[bytes, WindowRun, ObservedStates]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """By window: inputs and result of its latest simulation. A step that is accepted is differentiated next."""

    def __post_init__(self) -> None:
        if unknown := {prior.name for prior in self.unknowns} - set(SHOT_PARAMETERS):
            raise ValueError(f"shots depend on {', '.join(SHOT_PARAMETERS)}; got {', '.join(sorted(unknown))}")

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """One window per segment."""
        return tuple(build_window(one, self.guess_spins) for one in self.segments)

    @cached_property
    def parameter_indices(self) -> IntArray:
        """(P,) index of each unknown among all parameters."""
        return np.array([SHOT_PARAMETERS.index(prior.name) for prior in self.unknowns], dtype=np.int64)

    @cached_property
    def is_differentiated(self) -> BoolArray:
        """(P,) unknowns whose Jacobian is needed."""
        return np.ones(len(self.unknowns), bool) if self.jacobian_mask is None else self.jacobian_mask

    @cached_property
    def affects_motion(self) -> BoolArray:
        """(P,) those of them that change the motion, not only its observation."""
        return self.is_differentiated & (self.parameter_indices < IMAGE_START)

    @cached_property
    def model_codes(self) -> tuple[int, int]:
        """Codes of the contact models in compiled functions."""
        return find_model_codes(self.laws.cushion, self.laws.ball)

    @cached_property
    def handover_times(self) -> tuple[float, ...]:
        """Per window: s from its start to that of the next one; infinite where none follows."""
        times = [two.begin - one.begin if two.continues_previous else np.inf for one, two in pairwise(self.segments)]
        return (*times, np.inf) if self.segments else ()

    @cached_property
    def simulated_seconds(self) -> tuple[float, ...]:
        """Per window: s that its simulation lasts, past its last frame, and up to the next window."""
        ends = np.array(self.handover_times)
        lasts = np.array([one.t[-1] + 1.0 / 60 - one.begin for one in self.segments])
        return tuple(np.where(ends == np.inf, lasts, np.maximum(lasts, ends)).tolist())

    @cached_property
    def handover_indices(self) -> tuple[IntArray, ...]:
        """Per window (S',): which of the 7 N state variables start the next window; empty where none follows."""
        return tuple(
            np.empty(0, np.int64) if end == np.inf else _index_start(self.segments[k + 1].moving)
            for k, end in enumerate(self.handover_times)
        )

    def fill_values(self, shared: FloatArray) -> FloatArray:
        """Insert the unknown parameters (P,) into all (Q,) parameters."""
        whole = self.fixed.copy()
        whole[self.parameter_indices] = shared
        return whole

    def truncate(self, t: float) -> ShotWindows:
        """Keep the observations up to a time of one shot, without segments that begin later."""
        return replace(self, segments=tuple(one.truncate(t) for one in self.segments if one.t[0] <= t))

    def without_shared_jacobian(self) -> ShotWindows:
        """Return the model without Jacobians by the unknown parameters; both share their latest runs."""
        narrow = replace(self, jacobian_mask=np.zeros(len(self.unknowns), bool))
        object.__setattr__(narrow, "latest_runs", self.latest_runs)
        return narrow

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Predict the observed positions and the start of the next window, with Jacobians."""
        segment, values = self.segments[window], self.fill_values(shared)
        simulated = self._simulate_observations(window, start, values)
        if simulated is None:
            return self._infinite_cost_window(window, len(start))
        run, observed = simulated
        numbers, end = self.parameter_indices[self.affects_motion], self.handover_times[window]
        derivatives, at_end = differentiate_observations(run, observed, segment, self.table, values, numbers, end)
        predicted, by_start, by_shared = self._observation_jacobians(
            segment, observed, _replace_nan(derivatives), values
        )
        residual = self._compute_residual(segment, predicted, observed)
        by_start, by_shared = (_apply_whitening(segment.observation_whitening, one) for one in (by_start, by_shared))
        if values[SLIDING_MU] == 0:
            self._fill_sliding_secant(window, start, shared, residual, by_shared)
        handed = self._linearize_handover(window, observed.end, at_end, run, values)
        return LinearizedWindow(residual, by_start, by_shared, *handed, run.contact_order)

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow:
        """Predict the observed positions and the start of the next window, without Jacobians."""
        segment, values = self.segments[window], self.fill_values(shared)
        simulated = self._simulate_observations(window, start, values)
        if simulated is None:
            failed = self._infinite_cost_window(window, len(start))
            return SimulatedWindow(failed.residual, failed.end)
        run, observed = simulated
        residual = self._compute_residual(segment, self._distort(observed.xy, values), observed)
        return SimulatedWindow(residual, self._next_window_start(window, observed.end, run), run.contact_order)

    def predict_observed_path(self, window: int, start: FloatArray, shared: FloatArray) -> FloatArray:
        """Predict where balls would be observed at all times of a window, also where they were not.

        Each image row is read at its own time, and later where frames were dropped.

        Args:
            window: Index of the window.
            start: (S,) start state.
            shared: (P,) unknown parameters.

        Returns:
            (T, N, 2) m; NaN where the start state or the parameters are impossible.
        """
        segment, values, view = self.segments[window], self.fill_values(shared), self._camera_view
        t = frame_times(segment, values)
        run = self._simulate_possible_start(window, start, values, max(float(t.max()), 0.0) + 1.0)
        if run is None:
            return np.full(segment.xy.shape, np.nan)
        positions = _hold_pocketed_balls(run.states_at(np.maximum(t, 0.0))[..., :2])
        if segment.image_row is not None and values[SHUTTER_READOUT] != 0:
            later = np.maximum(t[:, None] + values[SHUTTER_READOUT] * view.image_rows(positions), 0.0)
            balls = np.arange(positions.shape[1])
            positions = np.stack(
                [_hold_pocketed_balls(run.states_at(later[:, k])[..., :2])[:, k] for k in balls], axis=1
            )
        return self._distort(positions, values)

    def simulate_possible_run(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedShot | None:
        """Simulate the shot of a window; None where the parameters are unphysical or the balls touch endlessly."""
        return self._simulate_possible_start(window, start, self.fill_values(shared), self.simulated_seconds[window])

    def _simulate_possible_start(
        self, window: int, start: FloatArray, values: FloatArray, seconds: float
    ) -> SimulatedShot | None:
        if not is_possible(start, values):
            return None
        try:
            return simulate_start(start, self.segments[window].moving, self.table, values, self.laws, seconds)
        except ArithmeticError:
            return None

    @property
    def _camera_view(self) -> ImagePlacement:
        return ImagePlacement(np.zeros(2), 1.0) if self.view is None else self.view

    def _has_view_error(self, values: FloatArray) -> bool:
        """Return whether the camera parameters shift observed positions."""
        return self.view is not None and bool((values[VIEW_PARAMETERS] != NEUTRAL_IMAGE_PARAMETERS).any())

    def _distort(self, xy: FloatArray, values: FloatArray) -> FloatArray:
        """Return the places where true positions are observed."""
        return distort_places(self._camera_view, xy, values[VIEW_PARAMETERS])[0] if self._has_view_error(values) else xy

    def _simulate_observations(
        self, window: int, start: FloatArray, values: FloatArray
    ) -> tuple[WindowRun, ObservedStates] | None:
        """Simulate a window and evaluate it at all observations and at its end; None where it is not possible."""
        inputs = start.tobytes() + values.tobytes()
        latest = self.latest_runs.get(window)
        if latest is not None and latest[0] == inputs:
            return latest[1:]
        segment, end = self.segments[window], self.handover_times[window]
        seconds = self.simulated_seconds[window]
        run = simulate_window_run(start, segment.moving, self.table, values, self.model_codes, seconds)
        if run is None:
            return None
        at, place = _observation_times(segment, values)
        observed = observe_run(run, segment, at, place, end)
        self.latest_runs[window] = inputs, run, observed
        return run, observed

    def _compute_residual(self, segment: ShotSegment, predicted: FloatArray, observed: ObservedStates) -> FloatArray:
        """Compute the residual (K, 2) of the places where the balls are predicted to be observed."""
        if predicted is observed.xy:
            return observed.residual
        deviations = (predicted - segment.observations)[..., None]
        return np.asarray(_apply_whitening(segment.observation_whitening, deviations)[..., 0])

    def _observation_jacobians(
        self, segment: ShotSegment, observed: ObservedStates, derivatives: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the observed positions (K, 2) and their Jacobians by start (K, 2, S) and unknowns (K, 2, P).

        `derivatives` are those of the true positions by the start and by the unknowns that affect the motion.
        """
        size = derivatives.shape[2] - int(self.affects_motion.sum())
        by_start, by_shared = (
            derivatives[..., :size],
            self._parameter_jacobian(segment, observed, derivatives[..., size:]),
        )
        indices = self.parameter_indices
        on_view = self.is_differentiated & (indices >= IMAGE_START) & (indices < SHUTTER_READOUT)
        if self.view is None or not (self._has_view_error(values) or on_view.any()):
            return observed.xy, by_start, by_shared
        xy, by_place, by_picture = distort_places(self.view, observed.xy, values[VIEW_PARAMETERS])
        by_shared = by_place @ by_shared
        if self._jacobian_columns:
            by_shared[..., on_view] = by_picture[..., indices[on_view] - IMAGE_START]
        return xy, by_place @ by_start, by_shared

    def _parameter_jacobian(self, segment: ShotSegment, observed: ObservedStates, by_motion: FloatArray) -> FloatArray:
        """Compute the Jacobian (K, 2, P) of true positions by the unknowns: through the motion and the time."""
        by_shared = np.zeros((len(by_motion), 2, self._jacobian_columns))
        if not self._jacobian_columns:
            return by_shared
        by_shared[..., self.affects_motion] = by_motion
        rows, balls = segment.observation_indices
        for number, shift in ((SHUTTER_READOUT, segment.image_row), (DROPPED_FRAMES, segment.dropped_frame_delay)):
            if shift is not None and number in self.parameter_indices[self.is_differentiated]:
                late = shift[rows, balls] if shift.ndim == 2 else shift[rows]
                by_shared[..., list(self.parameter_indices).index(number)] = observed.v * late[:, None]
        return by_shared

    def _fill_sliding_secant(
        self, window: int, start: FloatArray, shared: FloatArray, residual: FloatArray, by_shared: FloatArray
    ) -> None:
        """Fill in the secant by sliding friction where friction is absent."""
        for number in np.flatnonzero(self.is_differentiated & (self.parameter_indices == SLIDING_MU)):
            reference = shared.copy()
            reference[number] = _SECANT_SLIDING_MU
            reference_residual = self.simulate(window, start, reference).residual
            by_shared[..., number] = np.nan_to_num((reference_residual - residual) / _SECANT_SLIDING_MU)

    @property
    def _jacobian_columns(self) -> int:
        """Number of columns of the Jacobians by shared parameters: all or none."""
        return len(self.unknowns) if self.is_differentiated.any() else 0

    def _next_window_start(self, window: int, end: FloatArray, run: WindowRun) -> FloatArray:
        """Compute the start (S',) of the next window from the states (1, N, 7) at the end of this one."""
        indices = self.handover_indices[window]
        if not len(indices):
            return np.empty(0)
        return _replace_nan(convert_ends(end[0, :, :, None], run.radius, indices)[:, 0])

    def _linearize_handover(
        self, window: int, end: FloatArray, by: FloatArray, run: WindowRun, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute the start of the next window (S',) and its Jacobians (S', S) and (S', P).

        `by` (N, 7, C) are the derivatives of the states (1, N, 7) at the end of this window.
        """
        size, indices = len(self.windows[window].start), self.handover_indices[window]
        if not len(indices):
            return np.empty(0), np.empty((0, size)), np.empty((0, self._jacobian_columns))
        converted = convert_ends(by, run.radius, indices)
        by_shared = np.zeros((len(indices), self._jacobian_columns))
        if self._jacobian_columns:
            numbers = self.parameter_indices[self.affects_motion]
            by_radius = np.zeros((len(run.radius), MOVING_BALL_SIZE, len(numbers)))
            by_radius[:, CENTRE_SIZE:] = _radius_derivatives(end[0], run.radius, values)[..., numbers]
            converted[:, size:] += by_radius.reshape(-1, by_radius.shape[2])[indices]
        converted = _replace_nan(converted)
        if self._jacobian_columns:
            by_shared[:, self.affects_motion] = converted[:, size:]
        return self._next_window_start(window, end, run), converted[:, :size], by_shared

    def _infinite_cost_window(self, window: int, size: int) -> LinearizedWindow:
        """Return a prediction with infinite cost."""
        count = len(self.segments[window].observations)
        end, shared = len(self.handover_indices[window]), self._jacobian_columns
        return LinearizedWindow(np.full((count, 2), np.inf), np.zeros((count, 2, size)), np.zeros((count, 2, shared)),
                    np.zeros(end), np.zeros((end, size)), np.zeros((end, shared)))  # fmt: skip


@compile_kernel
def _apply_whitening(whiten, values):  # type: ignore[no-untyped-def]
    """Convert values (K, 2, M), or their derivatives, into standard deviations by whitening (K, 2, 2)."""
    whitened = np.empty(values.shape)
    for k in range(len(values)):
        for m in range(values.shape[2]):
            x, y = values[k, 0, m], values[k, 1, m]
            whitened[k, 0, m] = whiten[k, 0, 0] * x + whiten[k, 0, 1] * y
            whitened[k, 1, m] = whiten[k, 1, 0] * x + whiten[k, 1, 1] * y
    return whitened


def _replace_nan(values: FloatArray) -> FloatArray:
    """Replace the NaN of pocketed balls by 0; usually there is none, which is tested first."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _index_start(moving: BoolArray) -> IntArray:
    """Return which of the 7 N state variables (S',) start a window."""
    numbers = np.arange(len(moving) * MOVING_BALL_SIZE, dtype=np.float64).reshape(-1, MOVING_BALL_SIZE)
    return pack_start(numbers, moving).astype(int)


def _radius_derivatives(states: FloatArray, radius: FloatArray, values: FloatArray) -> FloatArray:
    """Compute the derivatives (N, 3, Q) of slip and side spin that come from the radius in their definition."""
    derivatives = np.zeros((len(states), 3, len(SHOT_PARAMETERS)))
    by_radius = np.stack([-states[:, 5], states[:, 4], states[:, 6]], axis=1) * radius[:, None]
    derivatives[..., len(PARAMETER_NAMES) + 2] = by_radius / values[len(PARAMETER_NAMES) + 2]
    derivatives[1:, :, len(PARAMETER_NAMES) + 1] = by_radius[1:] / values[len(PARAMETER_NAMES) + 1]
    return derivatives


def frame_times(segment: ShotSegment, values: FloatArray) -> FloatArray:
    """Compute the times (T,) since the start of the segment at which the middle row of each frame was captured."""
    t = segment.t - segment.begin
    return t if segment.dropped_frame_delay is None else t + values[DROPPED_FRAMES] * segment.dropped_frame_delay


def _observation_times(segment: ShotSegment, values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Compute the distinct observation times (M,), and the index (K,) of each observation's time."""
    rows, balls = segment.observation_indices
    t = frame_times(segment, values)
    if segment.image_row is None or values[SHUTTER_READOUT] == 0:
        return t, rows
    at, place = np.unique(t[rows] + values[SHUTTER_READOUT] * segment.image_row[rows, balls], return_inverse=True)
    return at, place.astype(np.int64)


def _hold_pocketed_balls(xy: FloatArray) -> FloatArray:
    """Keep pocketed balls at their last position (T, N, 2)."""
    if not np.isnan(xy).any():
        return xy
    held_xy = xy.copy()
    for k in range(1, len(held_xy)):
        pocketed = np.isnan(held_xy[k])
        held_xy[k][pocketed] = held_xy[k - 1][pocketed]
    return held_xy
