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
    LYING,
    MOVING,
    NUMBERS,
    PICTURE,
    READOUT,
    Laws,
    derivatives,
    packed,
    played,
    slips,
)
from models.billiards.run import Run
from models.billiards.stretches import Stretch, window_of
from models.billiards.view import ON_PICTURE, View, seen
from models.effects.effect import Prior
from models.scene import Table
from models.windows import Flow, Window

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

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

    def __post_init__(self) -> None:
        if unknown := {prior.name for prior in self.unknowns} - set(NUMBERS):
            raise ValueError(f"shots hang on {', '.join(NUMBERS)}; got {', '.join(sorted(unknown))}")
        object.__setattr__(self, "windows", tuple(window_of(one, self.guesses) for one in self.stretches))

    @property
    def places(self) -> Ints:
        """(P,) of the unknowns among all numbers."""
        return np.array([NUMBERS.index(prior.name) for prior in self.unknowns], dtype=np.int64)

    def values(self, shared: Floats) -> Floats:
        """(Q,) all numbers, from the unknown ones (P,)."""
        whole = self.fixed.copy()
        whole[self.places] = shared
        return whole

    def run(self, window: int, start: Floats, shared: Floats) -> Run:
        """The shot of a window as it is played; ArithmeticError where balls meet without end."""
        stretch = self.stretches[window]
        last = max(stretch.t[-1] + 1.0 / 60, self._end(window)) - stretch.begin
        return played(start, stretch.moving, self.table, self.values(shared), self.laws, last)

    def flow(self, window: int, start: Floats, shared: Floats) -> Flow:
        """Where every ball is seen, and with what spin the next window begins."""
        stretch, values = self.stretches[window], self.values(shared)
        if not possible(start, values):
            return self._failed(window, len(start))
        try:
            run = self.run(window, start, shared)
        except ArithmeticError:
            return self._failed(window, len(start))
        wanted = np.zeros(len(NUMBERS), bool)
        wanted[self.places if self.wanted is None else self.places[self.wanted]] = True
        shown, by_start, by_all = self._shown(stretch, run, values, wanted)
        rows, balls = stretch.observed
        whiten = stretch.whiten[rows, balls]
        misfit = np.einsum("kij,kj->ki", whiten, shown - stretch.xy[rows, balls])
        by_shared = (whiten @ by_all)[..., self.places]
        if wanted[SLIDING_MU] and values[SLIDING_MU] == 0:
            self._with_secant(window, start, shared, misfit, by_shared)
        end, end_by_start, end_by_shared = self._handed_over(window, run, values, wanted)
        kinds = tuple(map(tuple, run.contacts[:, [0, 2, 3]].astype(int)))
        return Flow(misfit, whiten @ by_start, by_shared, end, end_by_start, end_by_shared, kinds)

    def places_at(self, window: int, start: Floats, shared: Floats, t: Floats) -> Floats:
        """(T, N, 2) m, where balls would be seen at times t (T,) of the recording."""
        stretch, values = self.stretches[window], self.values(shared)
        last = max(float(t.max()) - stretch.begin, 0.0) + 1.0
        run = played(start, stretch.moving, self.table, values, self.laws, last)
        found = _held(run.at(t - stretch.begin)[..., :2])
        if self.view is None:
            return found
        return seen(self.view, found, values[PICTURE : PICTURE + len(ON_PICTURE)])[0]

    def _shown(self, stretch: Stretch, run: Run, values: Floats, wanted: Mask) -> tuple[Floats, Floats, Floats]:
        """Where the K observations should be (K, 2), by the start (K, 2, S) and by all numbers (K, 2, Q)."""
        rows, balls = stretch.observed
        at, place = _times(stretch, values)
        inside = np.maximum(at, 0.0)
        states = run.at(inside)
        by_start, by_all = derivatives(run, inside, stretch.moving, self.table, values, wanted)
        xy, v = _held(states[..., :2])[place, balls], np.nan_to_num(states[place, balls, 2:4])
        by_start = np.nan_to_num(by_start[place, balls, :2])
        by_all = np.nan_to_num(by_all[place, balls, :2])
        xy = xy + v * (at - inside)[place, None]
        for number, shift in ((READOUT, stretch.row), (FRAMES, stretch.late)):
            if shift is not None and wanted[number]:
                by_all[..., number] = v * (shift[rows, balls] if shift.ndim == 2 else shift[rows])[:, None]
        if self.view is None or not (wanted | (values != ABSENT))[PICTURE:READOUT].any():
            return xy, by_start, by_all
        picture = slice(PICTURE, PICTURE + len(ON_PICTURE))
        xy, by_place, by_picture = seen(self.view, xy, values[picture])
        by_all = by_place @ by_all
        by_all[..., picture] = by_picture * wanted[picture]
        return xy, by_place @ by_start, by_all

    def _with_secant(self, window: int, start: Floats, shared: Floats, misfit: Floats, by_shared: Floats) -> None:
        """Fill in the slope by sliding friction where it is absent."""
        number = list(self.places).index(SLIDING_MU)
        usual = shared.copy()
        usual[number] = _USUAL_SLIDING
        plain = replace(self, wanted=np.zeros(len(shared), bool))
        other = plain.flow(window, start, usual).misfit
        by_shared[..., number] = np.nan_to_num((other - misfit) / _USUAL_SLIDING)

    def _end(self, window: int) -> float:
        """s, where the window hands over to the next one."""
        follows = window + 1 < len(self.stretches) and self.stretches[window + 1].follows
        return self.stretches[window + 1].begin if follows else self.stretches[window].begin

    def _handed_over(self, window: int, run: Run, values: Floats, wanted: Mask) -> tuple[Floats, Floats, Floats]:
        stretch, size = self.stretches[window], self.windows[window].start.shape[0]
        if self._end(window) == stretch.begin:
            return np.empty(0), np.empty((0, size)), np.empty((0, len(self.unknowns)))
        t, following = np.array([self._end(window) - stretch.begin]), self.stretches[window + 1].moving
        by_start, by_all = derivatives(run, t, stretch.moving, self.table, values, wanted)
        radius = run.balls.radius
        states = run.at(t)
        by_all = slips(by_all[0].swapaxes(1, 2), radius[:, None]).swapaxes(1, 2)
        by_all[:, 4:] += _by_size(states[0], run, values)
        by_start = slips(by_start[0].swapaxes(1, 2), radius[:, None]).swapaxes(1, 2)
        kept = packed(np.arange(by_start.shape[0] * MOVING, dtype=np.float64).reshape(-1, MOVING), following).astype(
            int
        )
        end = np.nan_to_num(slips(states[0], radius).reshape(-1)[kept])
        by_all = by_all.reshape(-1, len(NUMBERS))[kept][:, self.places]
        return end, np.nan_to_num(by_start.reshape(-1, size)[kept]), np.nan_to_num(by_all)

    def _failed(self, window: int, size: int) -> Flow:
        """A flow that costs infinitely much."""
        count = len(self.stretches[window].observed[0])
        follows = self._end(window) != self.stretches[window].begin
        end = len(self.windows[window + 1].start) if follows else 0
        shared = len(self.unknowns)
        return Flow(np.full((count, 2), np.inf), np.zeros((count, 2, size)), np.zeros((count, 2, shared)),
                    np.zeros(end), np.zeros((end, size)), np.zeros((end, shared)))  # fmt: skip


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


def _present(moving: Mask) -> Mask:
    """(7 N,) the numbers of balls that a start holds."""
    return np.asarray((moving[:, None] | (np.arange(MOVING) < LYING)).reshape(-1))


def _times(stretch: Stretch, values: Floats) -> tuple[Floats, Ints]:
    """Times since the beginning at which to look (M,), and which of them each observation was made at (K,)."""
    rows, balls = stretch.observed
    t = stretch.t - stretch.begin
    if stretch.late is not None:
        t = t + values[FRAMES] * stretch.late
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
