"""Whole shots, contacts and all, as windows of the fit by shooting.

A window starts at a strike, or where the one before had become too sensitive to its start. What a picture cannot show
there, the spin, is carried over from that window. Everything else follows from the laws: one set of numbers for cloth,
cushions, balls and camera explains all balls at all times.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from models.core.scene import Table
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Window
from models.estimation.whole_shot.shot_segments import Stretch, window_of
from models.numerics.jit import compiled
from models.physics.billiards.calibration_errors import FAITHFUL, ON_PICTURE, View, seen
from models.physics.billiards.parameters import NAMES, NAP, ROLLING_MU, SLIDING_MU
from models.physics.billiards.simulation.parametrised_shot import (
    ABSENT,
    FRAMES,
    MOVING,
    NUMBERS,
    PICTURE,
    READOUT,
    Laws,
    directions_of,
    packed,
    played,
    slips,
)
from models.physics.billiards.simulation.simulated_shot import Run
from models.physics.effect import Prior

ON_VIEW = slice(PICTURE, PICTURE + len(ON_PICTURE))
"""Where the numbers of a view stand among all numbers."""
_USUAL_SLIDING = 0.2
"""where the slope by sliding friction is taken from, a secant, when it is absent: without it, slip does not exist."""


@dataclass(frozen=True, slots=True)
class Shots:
    """Stretches of shots on one table; those of a shot stand next to each other, in the order of time."""

    stretches: tuple[Stretch, ...]
    table: Table
    unknowns: tuple[Prior, ...]
    """P of them, named as in `playing.NUMBERS`."""
    laws: Laws
    fixed: FloatArray = field(default_factory=ABSENT.copy)
    """(Q,) all numbers; those of the unknowns do not count."""
    view: View | None = None
    """None: what is seen is where it is."""
    wanted: BoolArray | None = None
    """(P,) unknowns that slopes are needed for; None: all."""
    guesses: bool = True
    """whether the slips of the first guesses are only guesses, and others are to be tried."""
    windows: tuple[Window, ...] = field(init=False)
    places: IntArray = field(init=False, repr=False)
    """(P,) of the unknowns among all numbers."""
    sloped: BoolArray = field(init=False, repr=False)
    """(P,) the unknowns that slopes are needed for."""
    of_motion: BoolArray = field(init=False, repr=False)
    """(P,) those of them that the motion hangs on, and not only what is seen of it."""
    kept: tuple[IntArray, ...] = field(init=False, repr=False)
    """Per window (S',), which of the 7 N numbers of all balls the next one begins with; none where none follows."""

    def __post_init__(self) -> None:
        if unknown := {prior.name for prior in self.unknowns} - set(NUMBERS):
            raise ValueError(f"shots hang on {', '.join(NUMBERS)}; got {', '.join(sorted(unknown))}")
        found = np.array([NUMBERS.index(prior.name) for prior in self.unknowns], dtype=np.int64)
        sloped = np.ones(len(found), bool) if self.wanted is None else self.wanted
        object.__setattr__(self, "places", found)
        object.__setattr__(self, "sloped", sloped)
        object.__setattr__(self, "of_motion", sloped & (found < PICTURE))
        object.__setattr__(self, "kept", tuple(self._kept(window) for window in range(len(self.stretches))))
        object.__setattr__(self, "windows", tuple(window_of(one, self.guesses) for one in self.stretches))

    def values(self, shared: FloatArray) -> FloatArray:
        """(Q,) all numbers, from the unknown ones (P,)."""
        whole = self.fixed.copy()
        whole[self.places] = shared
        return whole

    def until(self, t: float) -> Shots:
        """What was seen up to a time of one shot; stretches that begin later are left out."""
        return replace(self, stretches=tuple(one.until(t) for one in self.stretches if one.t[0] <= t))

    def narrowed(self) -> Shots:
        """The same, without slopes by unknowns."""
        return replace(self, wanted=np.zeros(len(self.unknowns), bool))

    def run(self, window: int, start: FloatArray, shared: FloatArray) -> Run:
        """The shot of a window as it is played; ArithmeticError where balls meet without end."""
        stretch = self.stretches[window]
        last, end = stretch.t[-1] + 1.0 / 60 - stretch.begin, self._end(window)
        last = last if end == np.inf else max(last, end)
        return played(start, stretch.moving, self.table, self.values(shared), self.laws, last)

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        """Where every ball is seen, and with what spin the next window begins."""
        stretch, values = self.stretches[window], self.values(shared)
        run = self.possible_run(window, start, shared)
        if run is None:
            return self._failed(window, len(start))
        look = self._look(window, run, values)
        directions = directions_of(run.balls, stretch.moving, self.table, values, self.places[self.of_motion])
        found, at_end = run.along_to(look.t, look.where(stretch), directions, 2, self._end(window))
        shown, by_start, by_shared = self._slopes(stretch, look, _finite(found), values)
        misfit = _whitened(stretch.whitened, (shown - stretch.seen)[..., None])[..., 0]
        by_start, by_shared = _whitened(stretch.whitened, by_start), _whitened(stretch.whitened, by_shared)
        if values[SLIDING_MU] == 0:
            self._with_secant(window, start, shared, misfit, by_shared)
        handed = self._handed_over(window, look.end, at_end, run, values)
        return Flow(misfit, by_start, by_shared, *handed, _order(run))

    def glance(self, window: int, start: FloatArray, shared: FloatArray) -> Glance:
        """The same without slopes."""
        stretch, values = self.stretches[window], self.values(shared)
        run = self.possible_run(window, start, shared)
        if run is None:
            failed = self._failed(window, len(start))
            return Glance(failed.misfit, failed.end)
        look = self._look(window, run, values)
        shown = seen(self._view, look.xy, values[ON_VIEW])[0] if self._views(values) else look.xy
        misfit = _whitened(stretch.whitened, (shown - stretch.seen)[..., None])[..., 0]
        return Glance(misfit, self._next_start(window, look.end, run), _order(run))

    def path_seen(self, window: int, start: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, N, 2) m, where balls would be seen at the times of a window, also where they were not seen: each row of
        the picture at its own time, later where pictures are missing."""
        stretch, values, view = self.stretches[window], self.values(shared), self._view
        t = _moments(stretch, values)
        run = played(start, stretch.moving, self.table, values, self.laws, max(float(t.max()), 0.0) + 1.0)
        found = _held(run.at(np.maximum(t, 0.0))[..., :2])
        if stretch.row is not None and values[READOUT] != 0:
            later = np.maximum(t[:, None] + values[READOUT] * view.rows(found), 0.0)
            balls = np.arange(found.shape[1])
            found = np.stack([_held(run.at(later[:, k])[..., :2])[:, k] for k in balls], axis=1)
        return seen(view, found, values[ON_VIEW])[0] if self._views(values) else found

    def possible_run(self, window: int, start: FloatArray, shared: FloatArray) -> Run | None:
        """None where nature does not allow the numbers, or balls meet without end."""
        if not possible(start, self.values(shared)):
            return None
        try:
            return self.run(window, start, shared)
        except ArithmeticError:
            return None

    @property
    def _view(self) -> View:
        return View(np.zeros(2), 1.0) if self.view is None else self.view

    def _views(self, values: FloatArray) -> bool:
        """Whether a picture may shift what is seen."""
        return self.view is not None and bool((values[ON_VIEW] != FAITHFUL).any())

    def _look(self, window: int, run: Run, values: FloatArray) -> _Look:
        """At all that is observed of a window and at its end."""
        stretch, end = self.stretches[window], self._end(window)
        at, place = _times(stretch, values)
        balls, inside = stretch.observed[1], np.maximum(at, 0.0)
        states = run.at(inside if end == np.inf else np.append(inside, end))
        seen_at = states[: len(inside)]
        xy, v = _held(seen_at[..., :2])[place, balls], _finite(seen_at[place, balls, 2:4])
        return _Look(xy + v * (at - inside)[place, None], v, inside, place, states[len(inside) :])

    def _slopes(
        self, stretch: Stretch, look: _Look, found: FloatArray, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Where the K observations should be (K, 2), by the start (K, 2, S) and by the unknowns (K, 2, P), if any are
        asked for; from the slopes `found` of their places by the start and by what moves the balls."""
        size = found.shape[2] - int(self.of_motion.sum())
        by_start, by_shared = found[..., :size], self._by_unknowns(stretch, look, found[..., size:])
        on_view = self.sloped & (self.places >= PICTURE) & (self.places < READOUT)
        if self.view is None or not (self._views(values) or on_view.any()):
            return look.xy, by_start, by_shared
        xy, by_place, by_picture = seen(self.view, look.xy, values[ON_VIEW])
        by_shared = by_place @ by_shared
        if self._columns:
            by_shared[..., on_view] = by_picture[..., self.places[on_view] - PICTURE]
        return xy, by_place @ by_start, by_shared

    def _by_unknowns(self, stretch: Stretch, look: _Look, moved: FloatArray) -> FloatArray:
        """(K, 2, P) slopes of places on the table: `moved` (K, 2, M) by the motion, and by when they are seen."""
        by_shared = np.zeros((len(moved), 2, self._columns))
        if not self._columns:
            return by_shared
        by_shared[..., self.of_motion] = moved
        rows, balls = stretch.observed
        for number, shift in ((READOUT, stretch.row), (FRAMES, stretch.late)):
            if shift is not None and number in self.places[self.sloped]:
                late = shift[rows, balls] if shift.ndim == 2 else shift[rows]
                by_shared[..., list(self.places).index(number)] = look.v * late[:, None]
        return by_shared

    def _with_secant(
        self, window: int, start: FloatArray, shared: FloatArray, misfit: FloatArray, by_shared: FloatArray
    ) -> None:
        """Fill in the slope by sliding friction where it is absent."""
        for number in np.flatnonzero(self.sloped & (self.places == SLIDING_MU)):
            usual = shared.copy()
            usual[number] = _USUAL_SLIDING
            other = self.glance(window, start, usual).misfit
            by_shared[..., number] = np.nan_to_num((other - misfit) / _USUAL_SLIDING)

    @property
    def _columns(self) -> int:
        """Shared numbers that slopes are given for: all or none."""
        return len(self.unknowns) if self.sloped.any() else 0

    def _end(self, window: int) -> float:
        """s since the beginning of a window, where it hands over to the next one; infinite where none follows."""
        follows = window + 1 < len(self.stretches) and self.stretches[window + 1].follows
        return self.stretches[window + 1].begin - self.stretches[window].begin if follows else np.inf

    def _kept(self, window: int) -> IntArray:
        """As `kept`."""
        if self._end(window) == np.inf:
            return np.empty(0, np.int64)
        following = self.stretches[window + 1].moving
        return packed(np.arange(len(following) * MOVING, dtype=np.float64).reshape(-1, MOVING), following).astype(int)

    def _next_start(self, window: int, end: FloatArray, run: Run) -> FloatArray:
        """(S',) with what the next window begins, from the states (1, N, 7) at the end of a window."""
        kept = self.kept[window]
        return _finite(slips(end[0], run.balls.radius).reshape(-1)[kept]) if len(kept) else np.empty(0)

    def _handed_over(
        self, window: int, end: FloatArray, by: FloatArray, run: Run, values: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """State where the next window begins (S',), by the start (S', S) and by the unknowns (S', P), if any are asked
        for; from the states there (1, N, 7) and their derivatives `by` (N, 7, C)."""
        size, kept = len(self.windows[window].start), self.kept[window]
        if not len(kept):
            return np.empty(0), np.empty((0, size)), np.empty((0, self._columns))
        by = slips(by.swapaxes(1, 2), run.balls.radius[:, None]).swapaxes(1, 2)
        by_shared = np.zeros((len(kept), self._columns))
        if self._columns:
            by[:, 4:, size:] += _by_size(end[0], run, values)[..., self.places[self.of_motion]]
        by = _finite(by.reshape(len(by) * MOVING, -1)[kept])
        if self._columns:
            by_shared[:, self.of_motion] = by[:, size:]
        return self._next_start(window, end, run), by[:, :size], by_shared

    def _failed(self, window: int, size: int) -> Flow:
        """A flow that costs infinitely much."""
        count, end, shared = len(self.stretches[window].observed[0]), len(self.kept[window]), self._columns
        return Flow(np.full((count, 2), np.inf), np.zeros((count, 2, size)), np.zeros((count, 2, shared)),
                    np.zeros(end), np.zeros((end, size)), np.zeros((end, shared)))  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Look:
    """At the K observations of a window."""

    xy: FloatArray
    """(K, 2) m, where they were made."""
    v: FloatArray
    """(K, 2) m/s, with what velocity."""
    t: FloatArray
    """(M,) s since the beginning, when."""
    place: IntArray
    """(K,) which of these times is that of each."""
    end: FloatArray
    """(1, N, 7) states where the window hands over, (0, N, 7) where none follows."""

    def where(self, stretch: Stretch) -> IntArray:
        """(M, N) number of the observation of each ball at each time, -1 where there is none."""
        found = np.full((len(self.t), len(stretch.moving)), -1, np.int64)
        found[self.place, stretch.observed[1]] = np.arange(len(self.place))
        return found


@compiled
def _whitened(whiten, values):  # type: ignore[no-untyped-def]
    """Values (K, 2, M), or slopes, in standard deviations; whiten (K, 2, 2)."""
    found = np.empty(values.shape)
    for k in range(len(values)):
        for m in range(values.shape[2]):
            x, y = values[k, 0, m], values[k, 1, m]
            found[k, 0, m] = whiten[k, 0, 0] * x + whiten[k, 0, 1] * y
            found[k, 1, m] = whiten[k, 1, 0] * x + whiten[k, 1, 1] * y
    return found


def _finite(values: FloatArray) -> FloatArray:
    """With 0 for the NaN of balls in pockets: nearly always there is none, which is soon seen."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _order(run: Run) -> tuple[tuple[int, ...], ...]:
    """What met what, in its order."""
    return tuple(map(tuple, run.contacts[:, [0, 2, 3]].astype(int).tolist()))


def possible(start: FloatArray, values: FloatArray) -> bool:
    """Whether nature allows these numbers."""
    finite = np.isfinite(start).all() and np.isfinite(values).all()
    return bool(finite and (abs(values[NAP]) < values[ROLLING_MU] or values[NAP] == 0))


def _by_size(states: FloatArray, run: Run, values: FloatArray) -> FloatArray:
    """(N, 3, Q): what slip and side spin change by because the radius enters them."""
    found = np.zeros((len(states), 3, len(NUMBERS)))
    by_radius = np.stack([-states[:, 5], states[:, 4], states[:, 6]], axis=1) * run.balls.radius[:, None]
    found[..., len(NAMES) + 2] = by_radius / values[len(NAMES) + 2]
    found[1:, :, len(NAMES) + 1] = by_radius[1:] / values[len(NAMES) + 1]
    return found


def _moments(stretch: Stretch, values: FloatArray) -> FloatArray:
    """(T,) s since the beginning, when the middle row of each picture was taken."""
    t = stretch.t - stretch.begin
    return t if stretch.late is None else t + values[FRAMES] * stretch.late


def _times(stretch: Stretch, values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Times since the beginning at which to look (M,), and which of them each observation was made at (K,)."""
    rows, balls = stretch.observed
    t = _moments(stretch, values)
    if stretch.row is None or values[READOUT] == 0:
        return t, rows
    at, place = np.unique(t[rows] + values[READOUT] * stretch.row[rows, balls], return_inverse=True)
    return at, place.astype(np.int64)


def _held(xy: FloatArray) -> FloatArray:
    """(T, N, 2) where balls in pockets stay where they were seen last."""
    if not np.isnan(xy).any():
        return xy
    found = xy.copy()
    for k in range(1, len(found)):
        gone = np.isnan(found[k])
        found[k][gone] = found[k - 1][gone]
    return found
