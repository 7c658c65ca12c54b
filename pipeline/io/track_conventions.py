"""One reading of the rows of tracks for all commands: units, clocks, axes, wrapped angles and repeated samples.

What nobody stated is recognised and said; what was stated and contradicts the motion is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from models.core.constants import GRAVITY
from models.core.errors import OptionError
from models.core.typing import BoolArray, FloatArray
from models.estimation.track_evidence import (
    SURE_SIGMAS,
    BodyPath,
    Fall,
    find_held_samples,
    fit_even_times,
    fit_swing,
    measure_fall,
    measure_rate_ratio,
    measure_speed,
    unwrap_angles,
)
from pipeline.io.saved_shot import has_shot
from pipeline.io.text_table import ALIASES, NUMERIC_COLUMNS, TEXT_COLUMNS, UNITS, TextTable
from pipeline.reporting.text.text_formatting import escape_text

# Coordinates, frames and durations (s) from here on, like NaN, count as missing: no recording has them, and their
# squares would overflow.
MAX_NUMBER = 1e12
# m.
LENGTH_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "km": 1000.0}
# rad.
ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180}
UNIT_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches", "ft": "feet", "km": "kilometres",
              "rad": "radians", "deg": "degrees"}  # fmt: skip
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# s, four months: a time from here on counts from an epoch, not from the start of a recording.
_MIN_EPOCH = 1e7
# s between samples from which times are no seconds: nothing that is diagnosed can be followed at two samples per
# second. A thousandth of it, and so on, separates milli-, micro- and nanoseconds.
_LONGEST_STEP = 0.5
# Difference of the times of one frame, in steps, up to which they are one time: it shifts a body by a hundredth of its
# path per frame.
_SAME_TIME = 0.01
# Accelerations, in gravity, that drag, lift and noise of short drops explain.
_FALL_RANGE = (0.4, 2.5)
# Acceleration along the height, in that along another coordinate, below which bodies fall along the other one; a wind
# accelerates less than half as much as gravity.
_LEVEL = 0.5
# Acceleration, in gravity, from which drag does not explain the fall of bodies that are never slow: the fastest smash
# of a shuttlecock, twenty times its terminal speed, has 400.
_MOST_DRAG = 500.0
# Factor by which the ratio of a coordinate's rate and a column may differ from that of two units: a filtered rate is a
# few per cent too small, and the nearest two units, centimetres and inches, differ by 2.54.
_RATE_TOLERANCE = 1.05
# Factor by which a fall in another unit may differ from gravity: half the way from feet to twice gravity.
_UNIT_TOLERANCE = 1.25
# Misfit of the equation of motion of a pendulum, relative to no equation, from which it describes the angles, and the
# ratio of two misfits from which one reading of the angles is the better one. Real pendulums have 0.006 to 0.39.
_GOOD_SWING = 0.5
# Misfit from which the angles contradict a reading: a swing of 1.7 rad to both sides that moves as a spring does.
_BAD_SWING = 0.1
# rad, difference of the angle at rest from a quarter or half turn: a tilted camera explains more.
_REST_TOLERANCE = 0.3
# m/s, twice the fastest shot of ice hockey: nothing slides or rolls faster on a table.
_MAX_SPEED = 50.0
# Tolerated distance beyond a cushion, in table lengths: a badly calibrated camera shifts positions by as much.
MAX_OVERSHOOT = 0.1
# Largest tolerated share of positions off the table: lost and flying balls are fewer, wrong units give more.
MAX_SHARE_OFF_TABLE = 0.25
# Share of the table, from its corner, that a shot reaches at least: positions that fit on less in another unit may as
# well have exchanged columns.
_MIN_SHARE_USED = 0.1
# m, three times the length of the largest table: a larger value is not in metres.
MAX_TABLE_LENGTH = 10.0


@dataclass(frozen=True, slots=True)
class TrackScene:
    """What is stated about tracks beside their table."""

    name: str = ""
    """Scene; empty for particles."""
    coordinates: tuple[str, ...] = ("x", "y", "z")
    """Names that positions may have."""
    units: str | None = None
    px_per_m: float | None = None
    fps: float | None = None
    table: tuple[float, float] | None = None
    """Length and width, m."""
    gravity: float = GRAVITY
    has_inputs: bool = False
    """Whether known inputs act too."""


@dataclass(frozen=True, slots=True)
class TrackRows:
    """K rows of tracks in s, m and rad."""

    coordinates: tuple[str, ...]
    shot: NDArray[np.int64]
    frame: NDArray[np.int64]
    t: FloatArray
    """(K,) s from the first one where times count from an epoch."""
    ids: NDArray[np.str_]
    positions: FloatArray
    """(K, D); NaN where nothing was observed."""
    is_usable: BoolArray
    """(K,) whether a row is an observation."""
    unit: float
    """m or rad per unit of the file."""
    notes: tuple[str, ...]


def interpret_tracks(table: TextTable, scene: TrackScene) -> TrackRows:
    """Interpret the rows of a table of tracks.

    Args:
        scene: What is stated about it.

    Returns:
        The rows, and in `notes` what was assumed.

    Raises:
        OptionError: A column is missing, or what is stated contradicts the motion.
    """
    return _Interpretation(table, scene).run()


class _Interpretation:
    """Rows of one table while they are interpreted; each step may change them and add a note."""

    def __init__(self, table: TextTable, scene: TrackScene) -> None:
        self.table, self.scene, self.columns, self.place = table, scene, table.columns, escape_text(table.path)
        self.notes = list(table.notes)
        self.names = tuple(name for name in scene.coordinates if name in self.columns)
        count = len(next(iter(self.columns.values()))) if self.columns else 0
        self.shot = np.nan_to_num(self.columns.get("shot", np.zeros(count)), posinf=0, neginf=0)
        self.shot = np.where(np.abs(self.shot) < MAX_NUMBER, self.shot, 0).astype(np.int64)
        self.ids = self.columns.get("id", np.full(count, "body"))
        self.body = np.unique(self.ids, return_inverse=True)[1] if "id" in self.columns else np.zeros(count, np.int64)
        self.t = self._read_times(count)
        with np.errstate(over="ignore", invalid="ignore"):
            self.t = np.where(np.abs(self.t) < MAX_NUMBER, self.t, np.nan)
        self.positions = np.stack([self.columns[name] for name in self.names], axis=1)
        self.positions = np.where(np.abs(self.positions) < MAX_NUMBER, self.positions, np.nan)
        self.is_usable = np.isfinite(self.positions).all(axis=1) & np.isfinite(self.t)
        self.is_usable &= self.columns.get("observed", np.ones(count)) > 0
        if "frame" in self.columns:
            self.is_usable &= np.abs(self.columns["frame"]) < MAX_NUMBER
        self.unit = 1.0

    def run(self) -> TrackRows:
        if "id" not in self.columns:
            self.notes.append(f"{self.place} has no column id, so all its rows are one body")
        self._even_out_times()
        frame = self._number_frames()
        self._drop_held_samples()
        self._convert_stated_units()
        check = {"flight": self._check_fall, "pendulum": self._check_swing, "slide": self._check_speed,
                 "billiards": self._check_table}.get(self.scene.name)  # fmt: skip
        if check is not None and self.is_usable.any():
            check()
        return TrackRows(self.names, self.shot, frame, self.t, self.ids, self.positions, self.is_usable, self.unit,
                         tuple(dict.fromkeys(self.notes)))  # fmt: skip

    def _refuse(self, sentence: str) -> OptionError:
        return OptionError(f"{self.place}: {sentence}")

    def _note(self, sentence: str) -> None:
        self.notes.append(f"{self.place}: {sentence}")

    def _read_times(self, count: int) -> FloatArray:
        """Return times in s: by the unit of the header, by fps, or by the step between samples."""
        if "t" not in self.columns:
            if "frame" not in self.columns or self.scene.fps is None:
                raise OptionError(
                    f"{self.place} has no times: it needs the column t, or frame and the frame rate (--fps, or fps in"
                    " scene.json)"
                )
            return np.asarray(self.columns["frame"] / self.scene.fps)
        t = np.where(np.isfinite(self.columns["t"]), self.columns["t"], np.nan)
        finite = t[np.isfinite(t)]
        stated = self.table.units.get("t")
        unit = stated if stated in TIME_UNITS else self._find_time_unit(t)
        if unit != "s" and not stated:
            self._note(f"t is in {unit}, as the step between samples shows")
        t = t * TIME_UNITS[unit]
        if finite.size and finite.min() * TIME_UNITS[unit] > _MIN_EPOCH:
            self._note("times count from an epoch; the first one is 0 here")
            t = (self.columns["t"] - finite.min()) * TIME_UNITS[unit]
        return np.asarray(t)

    def _find_time_unit(self, t: FloatArray) -> str:
        """Find the unit of times that nobody stated, by the step that most samples have."""
        step = _measure_step(self.shot, self.ids, t)
        if not self.scene.name or not np.isfinite(step):
            finite = np.abs(t[np.isfinite(t)])
            earliest = float(finite.min()) if finite.size else 0.0
            return next((unit for unit, size in (("ns", 1e9), ("us", 1e6), ("ms", 1e3)) if earliest > 1e8 * size), "s")
        if self.scene.fps is not None and "frame" in self.columns:
            step *= self.scene.fps / max(_measure_step(self.shot, self.ids, self.columns["frame"]), 1.0)
            return min(TIME_UNITS, key=lambda unit: abs(np.log(step * TIME_UNITS[unit])))
        return next((unit for unit, size in TIME_UNITS.items() if step * size < _LONGEST_STEP), "ns")

    def _number_frames(self) -> NDArray[np.int64]:
        """Return frame numbers that go forward with time: those of the file, else the rank of the time in its shot."""
        count, numbers = len(self.t), np.zeros(len(self.t), np.int64)
        has_frames = "frame" in self.columns
        frame = np.where(self.is_usable, self.columns["frame"] if has_frames else np.zeros(count), 0).astype(np.int64)
        for shot in np.unique(self.shot[self.is_usable]):
            here = np.flatnonzero(self.is_usable & (self.shot == shot))
            numbers[here] = frame[here]
            if has_frames and self._align_frame_times(here, frame):
                continue
            for name in np.unique(self.ids[here]):
                own = here[self.ids[here] == name]
                order = np.argsort(frame[own], kind="stable")
                is_numbered = has_frames and len(np.unique(frame[own])) == len(own)
                if is_numbered and np.any(np.diff(self.t[own][order]) <= 0):
                    self._leave_out(
                        here, f"t must increase with frame, but in shot {shot} does not: correct or drop frame"
                    )
                    break
            numbers[here] = np.unique(self.t[here], return_inverse=True)[1]
            if has_frames and self.is_usable[here].all():
                self._note("a frame number has several times, as of cameras with own numbers; the times count")
        return numbers

    def _even_out_times(self) -> None:
        """Replace times that were rounded to a coarse clock by the even ones that round to them."""
        coarsest = 0.0
        for shot in np.unique(self.shot[self.is_usable]):
            here = np.flatnonzero(self.is_usable & (self.shot == shot))
            here = here[np.lexsort((self.t[here], self.body[here]))]
            if "frame" in self.columns:
                number = self.columns["frame"][here]
            else:
                starts = np.append(0, np.flatnonzero(np.diff(self.body[here])) + 1)
                number = np.arange(len(here)) - np.repeat(starts, np.diff(np.append(starts, len(here))))
                first, second = (np.diff(self.positions[here], n, axis=0) for n in (1, 2))
                if np.square(second).sum() > np.square(first).sum():
                    continue  # several bodies without names
            if even := fit_even_times(number, self.t[here]):
                self.t[here], coarsest = even[0], max(coarsest, even[1])
        if coarsest:
            self._note(f"times are rounded to {coarsest:.3g} s; the even times that round to them are used")

    def _leave_out(self, rows: NDArray[np.intp], sentence: str) -> None:
        """Leave out a shot that cannot be used; a table of which nothing remains is refused."""
        self.is_usable[rows] = False
        if not self.is_usable.any():
            raise self._refuse(sentence)
        self._note(f"{sentence}; it is left out")

    def _align_frame_times(self, here: NDArray[np.intp], frame: NDArray[np.int64]) -> bool:
        """Give all rows of a frame the time of its first one; return False where they differ, or do not go forward."""
        frames, first, row = np.unique(frame[here], return_index=True, return_inverse=True)
        times = self.t[here][first]
        steps = np.diff(times)
        if np.any(steps <= 0):
            return False
        if np.any(np.abs(self.t[here] - times[row]) > _SAME_TIME * np.median(steps) if len(frames) > 1 else [False]):
            return False
        self.t[here] = times[row]
        return True

    def _list_bodies(self) -> Iterable[NDArray[np.intp]]:
        """List the usable rows of each body of each shot, in the order of time; of rows at one time, the first."""
        rows = np.flatnonzero(self.is_usable)
        order = rows[np.lexsort((self.t[rows], self.body[rows], self.shot[rows]))]
        other = (np.diff(self.body[order]) != 0) | (np.diff(self.shot[order]) != 0)
        for part in np.split(order, np.flatnonzero(other) + 1):
            if len(part):
                yield part[np.append(True, np.diff(self.t[part]) > 0)]

    def _list_paths(self) -> list[BodyPath]:
        return [(self.t[rows], self.positions[rows]) for rows in self._list_bodies()]

    def _drop_held_samples(self) -> None:
        if has_shot(self.table.path.parent):
            return  # a run wrote the table, no recorder
        count, bodies, usable = 0, list(self._list_bodies()), int(self.is_usable.sum())
        if several := usable - sum(map(len, bodies)):
            self._note(f"{several} of {usable} rows repeat the time of a row of their body and are left out")
        for rows in bodies:
            repetitions = rows[find_held_samples(self.positions[rows])]
            self.is_usable[repetitions] = False
            count += len(repetitions)
        if count:
            self._note(
                f"{count} of {len(self.t)} positions repeat the one before, as a recorder holds them; they are left out"
            )

    def _convert_stated_units(self) -> None:
        """Scale positions by the unit that the header or scene.json states."""
        headed = {self.table.units[name] for name in self.names if name in self.table.units}
        if len(headed) > 1:
            raise self._refuse(f"the header states {' and '.join(sorted(headed))}; write all coordinates in one unit")
        stated = headed.pop() if headed else None
        if stated and self.scene.units not in (None, stated):
            raise self._refuse(f"the header states {stated}, and scene.json {self.scene.units}; correct one of them")
        self.stated = stated or self.scene.units
        is_angle = self.scene.name == "pendulum"
        if is_angle and self.stated not in ("rad", "deg"):
            self.stated = None  # scenes state m where they have no length
        self.stated = self.stated or self._find_unit_by_rate()
        if self.stated == "px" and not self.scene.px_per_m and self.scene.name:
            raise self._refuse("positions in px need px_per_m in scene.json, or --px-per-m")
        if self.stated in ("rad", "deg") and not is_angle and self.scene.name:
            raise self._refuse(f"positions are lengths, and {self.stated} is stated; correct the unit")
        if self.scene.name:
            px = 1 / self.scene.px_per_m if self.scene.px_per_m else 1.0
            self._scale({"px": px, **ANGLE_UNITS, **LENGTH_UNITS}.get(self.stated or "", 1.0))

    def _find_unit_by_rate(self) -> str | None:
        """Find the unit of positions by a further column that is their rate, in the unit of its name, else in SI."""
        ours = {*ALIASES, *chain.from_iterable(ALIASES.values()), *TEXT_COLUMNS, *NUMERIC_COLUMNS}
        others = [name for name in self.columns if name not in ours and self.scene.name]
        paths = [(rows, self.t[rows], self.positions[rows]) for rows in self._list_bodies()] if others else []
        units = ANGLE_UNITS if self.scene.name == "pendulum" else LENGTH_UNITS
        for name in others:
            spelled = re.search(r"([a-z°]+)/s", name)
            own = UNITS.get(spelled[1]) if spelled else None
            for k, axis in enumerate(self.names):
                ratio = measure_rate_ratio([(t, x[:, k], self.columns[name][rows]) for rows, t, x in paths])
                size = units.get(own or "", 1.0) / ratio if ratio and ratio > 0 else np.nan
                for unit, one in units.items():
                    # a rate without a unit in its name that changes as its coordinate does shares its unit, whichever
                    if abs(np.log(size / one)) < np.log(_RATE_TOLERANCE) and (own in units or one != 1):
                        self._note(f"{axis} is in {UNIT_NAMES[unit]}, as its rate {name} shows")
                        return unit
        return None

    def _scale(self, unit: float) -> None:
        self.positions, self.unit = self.positions * unit, self.unit * unit

    def _note_assumed_unit(self, unit: str, doubt: str = "nothing shows it") -> None:
        """Say that a unit was assumed where nobody stated it."""
        if not self.stated:
            self._note(
                f"no unit of {', '.join(self.names)} is stated, and {doubt}; {UNIT_NAMES[unit]} are"
                ' assumed: state "units" in scene.json'
            )

    def _check_fall(self) -> None:
        """Require that bodies fall with gravity along the last coordinate, in metres, upwards positive."""
        paths = self._list_paths()
        falls = [measure_fall(paths, column) for column in range(len(self.names))]
        is_sure = [fall is not None and abs(fall.acceleration) > SURE_SIGMAS * fall.sigma for fall in falls]
        downward = [-fall.acceleration if fall and sure else 0.0 for fall, sure in zip(falls, is_sure, strict=True)]
        ratios = np.array(downward) / self.scene.gravity
        low, high = _FALL_RANGE
        other = int(np.argmax(np.abs(ratios)))
        if self._is_level(falls[-1], falls[other]) and abs(ratios[other]) > low:
            name, height = self.names[other], self.names[-1]
            self.positions[:, [other, -1]] = self.positions[:, [-1, other]]
            self._note(f"bodies fall along {name}, not {height}; {name} is taken as the height")
            ratios[-1], falls[-1] = ratios[other], falls[other]
        ratio, last = float(ratios[-1]), falls[-1]
        has_drag = last is not None and last.has_drag
        if ratio < -low and (not has_drag or ratio > -high):  # drag slows a falling smash by more
            if self.scene.has_inputs:
                raise self._refuse(
                    f"bodies fall towards larger {self.names[-1]}; turn it, and the axes of spin, upwards"
                )
            self.positions[:, -1] *= -1
            self._note(f"bodies fall towards larger {self.names[-1]}; that axis points down and is turned")
        size = abs(ratio)
        if low <= size <= high:
            if abs(np.log(size)) > np.log(_UNIT_TOLERANCE):
                self._note_assumed_unit("m", f"a fall at {size * self.scene.gravity:.3g} m/s2 does not show it")
            return
        is_tiny = not has_drag and abs(np.log(max(size, 1e-9) * LENGTH_UNITS["km"])) < np.log(_UNIT_TOLERANCE)
        if not is_tiny and (size <= high or (has_drag and size <= _MOST_DRAG)):
            self._note_assumed_unit("m", "no fall without drag shows it")
            return
        metres = size * self.scene.gravity
        evidence = f"bodies fall at {metres:,.4g} m/s2 for a gravity of {self.scene.gravity:g}"
        for unit, length in LENGTH_UNITS.items():
            if unit != "m" and self.stated != "px" and abs(np.log(size * length)) < np.log(_UNIT_TOLERANCE):
                sentence = f"{evidence}, so that lengths are in {UNIT_NAMES[unit]}"
                if self.stated:
                    raise self._refuse(
                        f'{sentence}, but {self.stated} is stated; write "units": "{unit}" in scene.json or correct the'
                        " scale"
                    )
                self._scale(length)
                self._note(sentence)
                return
        remedy = "correct px_per_m" if self.stated == "px" else "state the units in scene.json, or correct the times"
        raise self._refuse(f"{evidence}; {remedy}")

    def _is_level(self, fall: Fall | None, other: Fall | None) -> bool:
        """Return whether bodies surely do not fall along one coordinate, as far as they fall along another."""
        if fall is None or other is None or fall is other or other.has_drag:
            return False
        return abs(fall.acceleration) + SURE_SIGMAS * fall.sigma < _LEVEL * abs(other.acceleration)

    def _check_swing(self) -> None:
        """Require that angles move as a pendulum does, in rad, 0 where it hangs."""
        stated = self.stated or "rad"
        readings = {}
        for unit in ("rad", "deg"):
            scale = 1.0 if unit == "rad" else np.pi / 180
            if self.stated == "deg":  # converted already
                scale = 180 / np.pi if unit == "rad" else 1.0
            plain = [(rows, self.positions[rows] * scale) for rows in self._list_bodies()]
            readings[unit] = [(rows, angles, unwrap_angles(angles, 2 * np.pi)) for rows, angles in plain]
        fits = {
            unit: fit_swing([(self.t[rows], angles if turned is None else turned) for rows, angles, turned in parts])
            for unit, parts in readings.items()
        }
        other = "deg" if stated == "rad" else "rad"
        chosen = stated
        if fits[stated].misfit > _BAD_SWING and fits[other].misfit < _GOOD_SWING * fits[stated].misfit:
            if self.stated:
                widest = float(np.abs(self.positions[self.is_usable]).max()) / self.unit
                raise self._refuse(
                    f'angles up to {widest:.3g} move as a pendulum in {other} does, not in {stated}; write "units":'
                    f' "{other}" in scene.json or convert them'
                )
            chosen = other
            self._scale(np.pi / 180)
            self._note("angles are in degrees, as their motion shows")
        elif fits["rad"].misfit > _GOOD_SWING * fits["deg"].misfit:
            widest = float(np.abs(self.positions[self.is_usable]).max())
            self._note_assumed_unit("rad", f"the motion of angles up to {widest:.2g} does not show it")
        for rows, _, turned in readings[chosen]:
            if turned is not None:
                self.positions[rows] = turned
                self._note("angles are kept within one turn; their jumps are taken out")
        fit = fits[chosen]
        quarter = np.round(fit.rest / (np.pi / 2))
        quarter[quarter == -2] = 2
        if (
            fit.misfit < _GOOD_SWING
            and np.all(quarter == quarter[0])
            and quarter[0] != 0
            and np.abs(np.sin(fit.rest - quarter * np.pi / 2)).max() < _REST_TOLERANCE
        ):
            self.positions -= quarter[0] * np.pi / 2
            self._note(f"the pendulum hangs at {quarter[0] * 90:g} degrees; angles count from there")

    def _check_speed(self) -> None:
        speed = measure_speed(self._list_paths())
        if speed > _MAX_SPEED:
            raise self._refuse(
                f"bodies move at {speed:,.3g} m/s, which nothing on a table does; state the units of positions in"
                " scene.json (cm, mm, or px with px_per_m), or correct the times"
            )
        self._note_assumed_unit("m")

    def _check_table(self) -> None:
        """Require positions on the table, in metres from a corner, y clockwise from x."""
        if self.scene.table is None:
            return
        size = np.array(self.scene.table)
        same, swapped = (0, 1), (1, 0)
        for unit in ("m", "cm", "mm"):  # a table in feet or inches is within a factor of four of one in metres
            length = LENGTH_UNITS[unit]
            if (unit != "m" and self.stated) or np.max(size) > MAX_TABLE_LENGTH:
                break
            for axes, shift, turn, words in (
                (same, 0.0, (1, 1), ""),
                (same, 0.0, (1, -1), "y is negative, so that it points away from the table, and is turned"),
                (same, size / 2, (1, 1), "positions count from the middle of the table"),
                (swapped, 0.0, (1, 1), "x runs along the shorter side; x and y are exchanged"),
            ):
                placed = self.positions[:, axes] * length * turn + shift
                usable = placed[self.is_usable]
                is_small = length != 1 and np.abs(usable - shift).max() < _MIN_SHARE_USED * size.max()
                if is_small or find_off_table(usable, self.scene.table).mean(axis=0).max() > MAX_SHARE_OFF_TABLE:
                    continue
                self.positions[:, :2], self.unit = placed, self.unit * length
                if words:
                    self._note(f"{words}")
                if unit != "m":
                    inches = usable * LENGTH_UNITS["in"] / length
                    other = ", and in inches too" if not find_off_table(inches, self.scene.table).any() else ""
                    self._note(f"positions fit on the table in {UNIT_NAMES[unit]}{other}")
                return


def _measure_step(shot: NDArray[np.int64], ids: NDArray[np.str_], values: FloatArray) -> float:
    """Return the usual step of a value from row to row of a body; NaN where there is none."""
    order = np.lexsort((values, ids, shot))
    steps = np.diff(values[order])
    same = (np.diff(shot[order]) == 0) & (ids[order][1:] == ids[order][:-1])
    steps = steps[same & np.isfinite(steps) & (steps > 0)]
    return float(np.median(steps)) if len(steps) else np.nan


def find_off_table(places: FloatArray, size: Sequence[float]) -> BoolArray:
    """Find the positions (K, 2) off a table, along x and along y: (K, 2)."""
    margin = MAX_OVERSHOOT * max(size)
    return np.asarray((places < -margin) | (places > np.array(size) + margin))
