"""SHOT.json: a shot from its initial state, as a user writes it; every mistake is named in one sentence."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from models.core.errors import OptionError
from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.parameters import Physics
from models.physics.billiards.simulation.simulate_shot import Balls
from models.physics.billiards.tables import nearest_preset

Metres = Annotated[float, Field(allow_inf_nan=False)]
Size = Annotated[float, Field(gt=0, allow_inf_nan=False)]

MOST_ROWS = 20_000_000
"""Of trajectory.csv: about 2 GB."""
ALLOWED_OVERLAP = 1e-5
"""m: more than rounding in the file explains."""


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


class BallEntry(_Entry):
    """A ball where the shot begins: m, m/s, rad/s, kg."""

    id: Annotated[str, Field(min_length=1, pattern=r'^[^,"\r\n]+$')]
    x: Metres
    y: Metres
    vx: Metres = 0.0
    vy: Metres = 0.0
    wx: Metres = 0.0
    wy: Metres = 0.0
    wz: Metres = 0.0
    radius: Size | None = None
    mass: Size | None = None


class TableEntry(_Entry):
    """The surface between the noses, m."""

    length: Size
    width: Size
    pockets: bool = False


class LawsEntry(_Entry):
    """Published forms of the contacts."""

    cushion: str = "mirror"
    ball: str = "inelastic"


class ShotEntry(_Entry):
    """The whole file."""

    scene: Literal["billiards"] = "billiards"
    table: TableEntry
    seconds: Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)] = 5.0
    hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] = 1000.0
    balls: Annotated[list[BallEntry], Field(min_length=1, max_length=100)]
    effects: dict[str, dict[str, Annotated[float, Field(allow_inf_nan=False)]]] = {}
    laws: LawsEntry = LawsEntry()


@dataclass(frozen=True, slots=True)
class Shot:
    """A shot that can be simulated."""

    table: Table
    balls: Balls
    physics: Physics
    seconds: float
    hz: float

    @property
    def times(self) -> FloatArray:
        """(T,) s: from 0 to the end, `hz` a second."""
        return np.arange(int(np.floor(self.seconds * self.hz + 1e-9)) + 1) / self.hz


def read_shot(path: Path) -> Shot:
    """The shot of a file; OptionError, one sentence, where it cannot be simulated."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise OptionError(f"A shot was expected in {path}: {error.strerror}") from error
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise OptionError(f"A shot is a JSON file; {path} is none: {error}") from error
    try:
        entry = ShotEntry.model_validate(document)
    except ValidationError as error:
        raise OptionError(f"{path}: {_first(error)}") from error
    return _shot(entry, path)


def _shot(entry: ShotEntry, path: Path) -> Shot:
    table = _table(entry)
    radius = np.array([ball.radius or table.ball_radius for ball in entry.balls])
    mass = np.array([ball.mass or table.ball_mass * (r / table.ball_radius) ** 3
                     for ball, r in zip(entry.balls, radius, strict=True)])  # fmt: skip
    state = np.array([[b.x, b.y, b.vx, b.vy, b.wx, b.wy, b.wz] for b in entry.balls])
    ids = tuple(ball.id for ball in entry.balls)
    for wrong in (_twice(ids), _outside(ids, state, radius, table), _overlap(ids, state, radius), _too_long(entry)):
        if wrong:
            raise OptionError(f"{path}: {wrong}")
    try:
        physics = Physics.of(entry.effects, entry.laws.cushion, entry.laws.ball)
    except ValueError as error:
        raise OptionError(f"{path}: {error}") from error
    return Shot(table, Balls(ids, state, radius, mass), physics, entry.seconds, entry.hz)


def _table(entry: ShotEntry) -> Table:
    """The table with the balls of the nearest one that is sold, or of the first ball that has a size."""
    length, width = entry.table.length, entry.table.width
    if width > length:
        raise OptionError(f"A table's length is its longer side; got length {length:g} m, width {width:g} m")
    sold = nearest_preset(length)
    radius = next((ball.radius for ball in entry.balls if ball.radius), sold.ball_radius)
    if radius >= width / 4:
        raise OptionError(f"A ball of radius {radius:g} m does not fit a table {width:g} m wide")
    mass = sold.ball_mass * (radius / sold.ball_radius) ** 3
    return Table(f"{length:g}x{width:g}", sold.game, length, width, radius, mass, entry.table.pockets)


def _twice(ids: tuple[str, ...]) -> str:
    double = next((name for name in ids if ids.count(name) > 1), None)
    return f"every ball needs a name of its own; {double!r} is there twice" if double else ""


def _outside(ids: tuple[str, ...], state: FloatArray, radius: FloatArray, table: Table) -> str:
    for name, (x, y), r in zip(ids, state[:, :2], radius, strict=True):
        least = min(x - r, table.length - r - x, y - r, table.width - r - y)
        if least < -ALLOWED_OVERLAP:
            return f"ball {name!r} at ({x:g}, {y:g}) reaches {-1000 * least:.3g} mm into a cushion"
    return ""


def _overlap(ids: tuple[str, ...], state: FloatArray, radius: FloatArray) -> str:
    for a in range(len(ids)):
        for b in range(a):
            gap = float(np.hypot(*(state[a, :2] - state[b, :2])) - radius[a] - radius[b])
            if gap < -ALLOWED_OVERLAP:
                return f"balls {ids[b]!r} and {ids[a]!r} overlap by {-1000 * gap:.3g} mm"
    return ""


def _too_long(entry: ShotEntry) -> str:
    rows = entry.seconds * entry.hz * len(entry.balls)
    return f"{rows:.3g} rows of trajectory are wanted, at most {MOST_ROWS:g} are written; lower hz or seconds" * (
        rows > MOST_ROWS
    )


def _first(error: ValidationError) -> str:
    """The first mistake: where it is, and what is wrong."""
    found = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in found["loc"])
    return f"{place or 'the file'}: {found['msg'][:1].lower()}{found['msg'][1:]}"
