"""A shot to simulate, `ShotSetup`: read from SHOT.json, the input of `trueroll simulate`, with one-sentence errors.

It states initial states, table and physics. What a run saves of the shot in a clip is in `pipeline.io.saved_shot`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from models.core.errors import OptionError
from models.core.scene import Table
from models.core.typing import FloatArray
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.simulate_shot import BallSet, SimulatedShot, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import find_nearest_preset, scale_ball_mass
from pipeline.io.strict_json import format_first_error, read_json
from pipeline.io.table_profile import SIZE_TOLERANCE, ProfileEntry, parse_learned_table

FiniteNumber = Annotated[float, Field(allow_inf_nan=False)]
PositiveNumber = Annotated[float, Field(gt=0, allow_inf_nan=False)]

# Largest number of rows of trajectory.csv, about 2 GB.
MAX_ROWS = 20_000_000
# m, overlap that is attributed to rounding in the file.
ALLOWED_OVERLAP = 1e-5


class _StrictEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


class BallEntry(_StrictEntry):
    """Initial state of a ball: m, m/s, rad/s, kg."""

    id: Annotated[str, Field(min_length=1, pattern=r'^[^,"\r\n]+$')]
    x: FiniteNumber
    y: FiniteNumber
    vx: FiniteNumber = 0.0
    vy: FiniteNumber = 0.0
    wx: FiniteNumber = 0.0
    wy: FiniteNumber = 0.0
    wz: FiniteNumber = 0.0
    radius: PositiveNumber | None = None
    mass: PositiveNumber | None = None


class ShotTableEntry(_StrictEntry):
    """Playing surface between the cushion noses, m."""

    length: PositiveNumber
    width: PositiveNumber
    pockets: bool = False


class ContactLawsEntry(_StrictEntry):
    """Names of the contact models."""

    cushion: str = "mirror"
    ball: str = "inelastic"


class ShotEntry(_StrictEntry):
    """Content of a SHOT.json."""

    scene: Literal["billiards"] = "billiards"
    table: ShotTableEntry
    seconds: Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)] = 5.0
    hz: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] = 1000.0
    balls: Annotated[list[BallEntry], Field(min_length=1, max_length=100)]
    effects: dict[str, dict[str, Annotated[float, Field(allow_inf_nan=False)]]] = {}
    laws: ContactLawsEntry = ContactLawsEntry()


@dataclass(frozen=True, slots=True)
class ShotSetup:
    """A validated shot, ready for simulation."""

    table: Table
    balls: BallSet
    physics: Physics
    seconds: float
    hz: float
    nose_offsets: FloatArray | None = None
    """(4,) m, outward offsets of the noses in the order of `CUSHIONS`; None for none."""
    correction: FloatArray = field(default_factory=NO_CORRECTION.copy)
    """Weights of `rebound_correction`; empty where there is none."""

    @property
    def times(self) -> FloatArray:
        """Output times (T,) s, from 0 to the end, `hz` per second."""
        return np.arange(int(np.floor(self.seconds * self.hz + 1e-9)) + 1) / self.hz

    def simulate(self) -> SimulatedShot:
        """Simulate the shot."""
        return simulate(
            self.balls, self.table, self.physics, self.seconds, self.nose_offsets, correction=self.correction
        )


def read_shot_setup(path: Path) -> ShotSetup:
    """Read the shot of a SHOT.json.

    Args:
        path: The file.

    Returns:
        The shot, ready for simulation.

    Raises:
        OptionError: It is no valid shot; the message is one sentence on its first mistake.
    """
    return parse_shot(read_json(path, "A shot was expected"), str(path))


def parse_shot(document: Any, name: str = "the shot") -> ShotSetup:
    """Parse a shot that is a JSON document already, such as a dict of the same keys.

    Args:
        document: The content of a SHOT.json; docs/reference/file-formats.md lists its keys.
        name: What error messages call it.

    Returns:
        The shot, ready for simulation.

    Raises:
        OptionError: It is no valid shot; the message is one sentence on its first mistake.
    """
    try:
        entry = ShotEntry.model_validate(document)
    except ValidationError as error:
        raise OptionError(f"{name}: {format_first_error(error)}") from error
    return _build_setup(entry, name)


def _build_setup(entry: ShotEntry, name: str) -> ShotSetup:
    table = _build_table(entry)
    radius = np.array([ball.radius or table.ball_radius for ball in entry.balls])
    mass = np.array([ball.mass or scale_ball_mass(table, r)
                     for ball, r in zip(entry.balls, radius, strict=True)])  # fmt: skip
    state = np.array([[b.x, b.y, b.vx, b.vy, b.wx, b.wy, b.wz] for b in entry.balls])
    ids = tuple(ball.id for ball in entry.balls)
    for wrong in (
        _find_repeated_name(ids),
        _find_ball_in_cushion(ids, state, radius, table),
        _find_overlap(ids, state, radius),
        _find_excess_rows(entry),
    ):
        if wrong:
            raise OptionError(f"{name}: {wrong}")
    try:
        physics = Physics.from_effects(entry.effects, entry.laws.cushion, entry.laws.ball)
    except ValueError as error:
        raise OptionError(f"{name}: {error}") from error
    return ShotSetup(table, BallSet(ids, state, radius, mass), physics, entry.seconds, entry.hz)


def _build_table(entry: ShotEntry) -> Table:
    """Build the table with the radius of the first ball that has one, otherwise of the most similar preset."""
    length, width = entry.table.length, entry.table.width
    if width > length:
        raise OptionError(f"A table's length is its longer side; got length {length:g} m, width {width:g} m")
    preset = find_nearest_preset(length)
    radius = next((ball.radius for ball in entry.balls if ball.radius), preset.ball_radius)
    if radius >= width / 4:
        raise OptionError(f"A ball of radius {radius:g} m does not fit a table {width:g} m wide")
    mass = scale_ball_mass(preset, radius)
    return Table(f"{length:g}x{width:g}", preset.game, length, width, radius, mass, entry.table.pockets)


def _find_repeated_name(ids: tuple[str, ...]) -> str:
    double = next((name for name in ids if ids.count(name) > 1), None)
    return f"every ball needs a unique id; {double!r} occurs twice" if double else ""


def _find_ball_in_cushion(ids: tuple[str, ...], state: FloatArray, radius: FloatArray, table: Table) -> str:
    for name, (x, y), r in zip(ids, state[:, :2], radius, strict=True):
        least = min(x - r, table.length - r - x, y - r, table.width - r - y)
        if least < -ALLOWED_OVERLAP:
            return f"ball {name!r} at ({x:g}, {y:g}) reaches {-1000 * least:.3g} mm into a cushion"
    return ""


def _find_overlap(ids: tuple[str, ...], state: FloatArray, radius: FloatArray) -> str:
    for a in range(len(ids)):
        for b in range(a):
            gap = float(np.hypot(*(state[a, :2] - state[b, :2])) - radius[a] - radius[b])
            if gap < -ALLOWED_OVERLAP:
                return f"balls {ids[b]!r} and {ids[a]!r} overlap by {-1000 * gap:.3g} mm"
    return ""


def _find_excess_rows(entry: ShotEntry) -> str:
    rows = entry.seconds * entry.hz * len(entry.balls)
    return f"{rows:.3g} rows of trajectory are requested, at most {MAX_ROWS:g} are written; lower hz or seconds" * (
        rows > MAX_ROWS
    )


def place_on_learned_table(shot: ShotSetup, text: str) -> ShotSetup:
    """Replace the physics of a shot by that of a profile.

    Args:
        text: Content of the profile, JSON.

    Returns:
        The shot with the cloth, the contact models, the noses and the correction of the profile.

    Raises:
        OptionError: The profile is that of a table of another size.
    """
    entry, learned = ProfileEntry.model_validate(json.loads(text)), parse_learned_table(text)
    own = entry.table
    if (
        own is not None
        and max(abs(own.length / shot.table.length - 1), abs(own.width / shot.table.width - 1)) > SIZE_TOLERANCE
    ):
        raise OptionError(
            f"--profile is of a table of {own.length:g} x {own.width:g} m; that of the shot is {shot.table.length:g} x"
            f" {shot.table.width:g} m"
        )
    physics = Physics(learned.physics, PARAMETER_NAMES, learned.cushion_law, entry.laws.ball)
    return replace(shot, physics=physics, nose_offsets=-learned.noses, correction=learned.correction)
