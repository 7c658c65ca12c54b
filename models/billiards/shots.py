"""Whole shots, contacts and all, as windows of the fit by shooting.

A window starts at a strike, or where the one before had become too sensitive to its start. What a picture cannot show
there, the spin, is carried over from that window. Everything else follows from the laws: one set of numbers for cloth,
cushions, balls and camera explains all balls at all times.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.billiards.parameters import NAMES, NAP, ROLLING_MU, SLIDING_MU
from models.billiards.playing import (
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
from models.billiards.run import Run
from models.billiards.stretches import Stretch, window_of
from models.billiards.view import FAITHFUL, ON_PICTURE, View, seen
from models.effects.effect import Prior
from models.scene import Table
from models.shooting.windows import Flow, Glance, Window

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

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
    fixed: Floats = field(default_factory=ABSENT.copy)
    """(Q,) all numbers; those of the unknowns do not count."""
    view: View | None = None
    """None: what is seen is where it is."""
    wanted: Mask | None = None
    """(P,) unknowns that slopes are needed for; None: all."""
    guesses: bool = True
    """whether the slips of the first guesses are only guesses, and others are to be tried."""
    windows: tuple[Window, ...] = field(init=False)
    places: Ints = field(init=False, repr=False)
    """(P,) of the unknowns among all numbers."""

    def __post_init__(self) -> None:
        if unknown := {prior.name for prior in self.unknowns} - set(NUMBERS):
            raise ValueError(f"shots hang on {', '.join(NUMBERS)}; got {', '.join(sorted(unknown))}")
        found = np.array([NUMBERS.index(prior.name) for prior in self.unknowns], dtype=np.int64)
        object.__setattr__(self, "places", found)
        object.__setattr__(self, "windows", tuple(window_of(one, self.guesses) for one in self.stretches))

    def values(self, shared: Floats) -> Floats:
        """(Q,) all numbers, from the unknown ones (P,)."""
        whole = self.fixed.copy()
        whole[self.places] = shared
        return whole

    def until(self, t: float) -> Shots:
        """What was seen up to a time of one shot; stretches that begin later are left out."""
        return replace(self, stretches=tuple(one.until(t) for one in self.stretches if one.t[0] <= t))

    def narrowed(self) -> Shots:
        """The same, no slopes by unknowns."""
        return replace(self, wanted=np.zeros(len(self.unknowns), bool))

    def run(self, window: int, start: Floats, shared: Floats) -> Run:
        """The shot of a window as it is played; ArithmeticError where balls meet without end."""
        stretch = self.stretches[window]
        last = max(stretch.t[-1] + 1.0 / 60, self._end(window)) - stretch.begin
        return played(start, stretch.moving, self.table, self.values(shared), self.laws, last)

    def flow(self, window: int, start: Floats, shared: Floats) -> Flow:
        """Where every ball is seen, and with what spin the next window begins."""
        stretch, values = self.stretches[window], self.values(shared)
        run = self.possible_run(window, start, shared)
        if run is None:
            return self._failed(window, len(start))
        wanted = np.ones(len(self.unknowns), bool) if self.wanted is None else self.wanted
        asked = wanted & (self.places < PICTURE)
        directions = directions_of(run.balls, stretch.moving, self.table, values, self.places[asked])
        shown, by_start, by_shared = self._sloped(stretch, run, values, wanted, directions)
        whiten = stretch.whitened
        misfit = np.einsum("kij,kj->ki", whiten, shown - stretch.seen)
        by_shared = whiten @ by_shared
        if values[SLIDING_MU] == 0:
            self._with_secant(window, start, shared, misfit, by_shared, wanted)
        end, end_by_start, end_by_shared = self._handed_over(window, run, values, asked, directions)
        return Flow(misfit, whiten @ by_start, by_shared, end, end_by_start, end_by_shared, _order(run))

    def glance(self, window: int, start: Floats, shared: Floats) -> Glance:
        """The same without slopes."""
        stretch, values = self.stretches[window], self.values(shared)
        run = self.possible_run(window, start, shared)
        if run is None:
            failed = self._failed(window, len(start))
            return Glance(failed.misfit, failed.end)
        shown = self._shown(stretch, run, values)[0]
        if self._views(values):
            shown = seen(self._view, shown, values[ON_VIEW])[0]
        misfit = np.einsum("kij,kj->ki", stretch.whitened, shown - stretch.seen)
        kept = self._kept(window)
        end = self._state_at_end(window, run).reshape(-1)[kept] if len(kept) else np.empty(0)
        return Glance(misfit, _finite(end), _order(run))

    def path_seen(self, window: int, start: Floats, shared: Floats) -> Floats:
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

    def possible_run(self, window: int, start: Floats, shared: Floats) -> Run | None:
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

    def _views(self, values: Floats) -> bool:
        """Whether a picture may shift what is seen."""
        return self.view is not None and bool((values[ON_VIEW] != FAITHFUL).any())

    def _shown(self, stretch: Stretch, run: Run, values: Floats) -> tuple[Floats, Floats, Floats, Ints]:
        """Where the K observations were made (K, 2), with what velocity (K, 2), at which times (M,), and which of them
        each was made at (K,)."""
        at, place = _times(stretch, values)
        balls, inside = stretch.observed[1], np.maximum(at, 0.0)
        states = run.at(inside)
        xy, v = _held(states[..., :2])[place, balls], _finite(states[place, balls, 2:4])
        return xy + v * (at - inside)[place, None], v, inside, place

    def _sloped(
        self, stretch: Stretch, run: Run, values: Floats, wanted: Mask, directions: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Where the K observations should be (K, 2), by the start (K, 2, S) and by the unknowns (K, 2, P)."""
        xy, v, inside, place = self._shown(stretch, run, values)
        rows, balls = stretch.observed
        where = np.full((len(inside), len(stretch.moving)), -1, np.int64)
        where[place, balls] = np.arange(len(place))
        asked = wanted & (self.places < PICTURE)
        found = _finite(run.along(inside, where, directions, 2))
        size = directions.shape[1] - int(asked.sum())
        by_start, by_shared = found[..., :size], np.zeros((len(xy), 2, len(self.unknowns)))
        by_shared[..., asked] = found[..., size:]
        for number, shift in ((READOUT, stretch.row), (FRAMES, stretch.late)):
            if shift is not None and number in self.places[wanted]:
                late = shift[rows, balls] if shift.ndim == 2 else shift[rows]
                by_shared[..., list(self.places).index(number)] = v * late[:, None]
        on_view = wanted & (self.places >= PICTURE) & (self.places < READOUT)
        if self.view is None or not (self._views(values) or on_view.any()):
            return xy, by_start, by_shared
        xy, by_place, by_picture = seen(self.view, xy, values[ON_VIEW])
        by_shared = by_place @ by_shared
        by_shared[..., on_view] = by_picture[..., self.places[on_view] - PICTURE]
        return xy, by_place @ by_start, by_shared

    def _with_secant(
        self, window: int, start: Floats, shared: Floats, misfit: Floats, by_shared: Floats, wanted: Mask
    ) -> None:
        """Fill in the slope by sliding friction where it is absent."""
        for number in np.flatnonzero(wanted & (self.places == SLIDING_MU)):
            usual = shared.copy()
            usual[number] = _USUAL_SLIDING
            other = self.glance(window, start, usual).misfit
            by_shared[..., number] = np.nan_to_num((other - misfit) / _USUAL_SLIDING)

    def _end(self, window: int) -> float:
        """s, where the window hands over to the next one."""
        follows = window + 1 < len(self.stretches) and self.stretches[window + 1].follows
        return self.stretches[window + 1].begin if follows else self.stretches[window].begin

    def _kept(self, window: int) -> Ints:
        """(S',) which of the 7 N numbers of all balls the next window begins with; none where none follows."""
        if self._end(window) == self.stretches[window].begin:
            return np.empty(0, np.int64)
        following = self.stretches[window + 1].moving
        return packed(np.arange(len(following) * MOVING, dtype=np.float64).reshape(-1, MOVING), following).astype(int)

    def _state_at_end(self, window: int, run: Run) -> Floats:
        """(N, 7) as `playing` counts, where the window hands over."""
        state = run.at(np.array(self._end(window) - self.stretches[window].begin))
        return slips(state, run.balls.radius)

    def _handed_over(
        self, window: int, run: Run, values: Floats, asked: Mask, directions: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """State where the next window begins (S',), by the start (S', S) and by the unknowns (S', P)."""
        stretch, size, kept = self.stretches[window], len(self.windows[window].start), self._kept(window)
        if not len(kept):
            return np.empty(0), np.empty((0, size)), np.empty((0, len(self.unknowns)))
        numbers, count = self.places[asked], len(stretch.moving)
        t = np.array([self._end(window) - stretch.begin])
        by = run.along(t, np.arange(count)[None], directions, MOVING)  # (N, 7, S + M)
        by = slips(by.swapaxes(1, 2), run.balls.radius[:, None]).swapaxes(1, 2)
        by[:, 4:, size:] += _by_size(run.at(t)[0], run, values)[..., numbers]
        by = _finite(by.reshape(count * MOVING, -1)[kept])
        by_shared = np.zeros((len(kept), len(self.unknowns)))
        by_shared[:, asked] = by[:, size:]
        return _finite(self._state_at_end(window, run).reshape(-1)[kept]), by[:, :size], by_shared

    def _failed(self, window: int, size: int) -> Flow:
        """A flow that costs infinitely much."""
        count = len(self.stretches[window].observed[0])
        follows = self._end(window) != self.stretches[window].begin
        end = len(self.windows[window + 1].start) if follows else 0
        shared = len(self.unknowns)
        return Flow(np.full((count, 2), np.inf), np.zeros((count, 2, size)), np.zeros((count, 2, shared)),
                    np.zeros(end), np.zeros((end, size)), np.zeros((end, shared)))  # fmt: skip


def _finite(values: Floats) -> Floats:
    """With 0 for the NaN of balls in pockets: nearly always there is none, which is soon seen."""
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _order(run: Run) -> tuple[tuple[int, ...], ...]:
    """What met what, in its order."""
    return tuple(map(tuple, run.contacts[:, [0, 2, 3]].astype(int).tolist()))


def possible(start: Floats, values: Floats) -> bool:
    """Whether nature allows these numbers."""
    finite = np.all(np.isfinite(start)) and np.all(np.isfinite(values))
    return bool(finite and (abs(values[NAP]) < values[ROLLING_MU] or values[NAP] == 0))


def _by_size(states: Floats, run: Run, values: Floats) -> Floats:
    """(N, 3, Q): what slip and side spin change by because the radius enters them."""
    found = np.zeros((len(states), 3, len(NUMBERS)))
    by_radius = np.stack([-states[:, 5], states[:, 4], states[:, 6]], axis=1) * run.balls.radius[:, None]
    found[..., len(NAMES) + 2] = by_radius / values[len(NAMES) + 2]
    found[1:, :, len(NAMES) + 1] = by_radius[1:] / values[len(NAMES) + 1]
    return found


def _moments(stretch: Stretch, values: Floats) -> Floats:
    """(T,) s since the beginning, when the middle row of each picture was taken."""
    t = stretch.t - stretch.begin
    return t if stretch.late is None else t + values[FRAMES] * stretch.late


def _times(stretch: Stretch, values: Floats) -> tuple[Floats, Ints]:
    """Times since the beginning at which to look (M,), and which of them each observation was made at (K,)."""
    rows, balls = stretch.observed
    t = _moments(stretch, values)
    if stretch.row is None or values[READOUT] == 0:
        return t, rows
    at, place = np.unique(t[rows] + values[READOUT] * stretch.row[rows, balls], return_inverse=True)
    return at, place.astype(np.int64)


def _held(xy: Floats) -> Floats:
    """(T, N, 2) where balls in pockets stay where they were seen last."""
    if not np.isnan(xy).any():
        return xy
    found = xy.copy()
    for k in range(1, len(found)):
        gone = np.isnan(found[k])
        found[k][gone] = found[k - 1][gone]
    return found
