"""Reading of a table profile, which `trueroll diagnose` and `fit-table` write, for the next run or prediction."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from models.core.errors import OptionError
from models.core.scene import CUSHIONS
from models.estimation.table_learning.learned_table import (
    CLOTH_SPREAD,
    DEFAULT_SCATTER,
    ROLLING_MODEL_SIGMA,
    ContactScatter,
    LearnedTable,
)
from models.estimation.whole_shot.known_table import TablePrior, build_table_prior
from models.physics.billiards.ball_cushion.rebound_correction import WEIGHT_COUNT
from models.physics.billiards.contact_models import BALL_MODEL_CHOICE, CUSHION_MODEL_CHOICE
from models.physics.billiards.parameter_vector import (
    PARAMETER_NAMES,
    ROLLING_MU,
    SLIDING_MU,
    TABLE_PARAMETERS,
    neutral_parameters,
)
from models.physics.billiards.simulation.table_physics import contact_parameters
from models.physics.billiards.tables import NOSE_SIGMA
from models.physics.effect import ModelChoice, Prior
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS, find_prior


class ProfileNumberEntry(BaseModel):
    """A parameter of an effect with its standard deviation."""

    model_config = ConfigDict(extra="allow")
    value: FiniteFloat
    sigma: FiniteFloat | None = Field(default=None, gt=0)


def _require_form(choice: ModelChoice, name: str) -> str:
    if name not in choice.forms:
        raise ValueError(f"{choice.name} is one of {', '.join(choice.forms)}; got {name!r}")
    return name


class ProfileLawsEntry(BaseModel):
    """Contact models of the table."""

    cushion: Annotated[str, AfterValidator(partial(_require_form, CUSHION_MODEL_CHOICE))] = "mirror"
    ball: Annotated[str, AfterValidator(partial(_require_form, BALL_MODEL_CHOICE))] = "inelastic"


class ScatterEntry(BaseModel):
    """Scatter of cushion contacts about their model, as shares of the speed."""

    velocity: PositiveFloat
    slip: PositiveFloat
    side_spin: PositiveFloat


def _require_weight_count(weights: list[float]) -> list[float]:
    if weights and len(weights) != WEIGHT_COUNT:
        raise ValueError(f"a correction has {WEIGHT_COUNT} weights; got {len(weights)}")
    return weights


class CorrectionEntry(BaseModel):
    """Network that corrects the cushion model; without weights there is none."""

    gain: FiniteFloat | None = None
    weights: Annotated[list[FiniteFloat], AfterValidator(_require_weight_count)] = []


class CovarianceEntry(BaseModel):
    """Covariance of cushion parameters, and of the noses in the order of `CUSHIONS`, m^2."""

    parameters: list[str]
    matrix: list[list[FiniteFloat]]
    noses: list[list[FiniteFloat]]

    @model_validator(mode="after")
    def _require_covariances(self) -> CovarianceEntry:
        if unknown := set(self.parameters) - set(PARAMETER_NAMES):
            raise ValueError(f"a table has no {', '.join(sorted(unknown))}, of which `covariance` has a row")
        for name, rows, size in (("matrix", self.matrix, len(self.parameters)), ("noses", self.noses, len(CUSHIONS))):
            if len(rows) != size or any(len(row) != size for row in rows):
                raise ValueError(f"{name} of `covariance` has {size} rows and columns")
            values = np.reshape(rows, (size, size))
            scale = np.abs(values).max(initial=0.0)
            if np.abs(values - values.T).max(initial=0.0) > _ROUNDING * scale:
                raise ValueError(f"{name} of `covariance` must be symmetric")
            if size and np.linalg.eigvalsh(values)[0] < -_ROUNDING * scale:
                raise ValueError(f"{name} of `covariance` must have no negative eigenvalue")
        return self


class ProfileTableEntry(BaseModel):
    """Size of the table, m."""

    length: PositiveFloat
    width: PositiveFloat


class ProfileEntry(BaseModel):
    """Content of a profile.json."""

    model_config = ConfigDict(extra="allow")
    scene: Literal["billiards"] = "billiards"
    table: ProfileTableEntry | None = None
    effects: dict[str, dict[str, ProfileNumberEntry]]
    laws: ProfileLawsEntry = ProfileLawsEntry()
    scatter: ScatterEntry | None = None
    correction: CorrectionEntry = CorrectionEntry()
    noses: dict[Literal["left", "right", "top", "bottom"], ProfileNumberEntry] = {}
    """m, offsets of the contact lines towards the table."""
    covariance: CovarianceEntry | None = None


def read_profile_text(path: Path) -> str:
    """Read and validate a table profile.

    Options hold the content instead of the file name, so that cached results of another content are out of date.

    Args:
        path: The file.

    Returns:
        Its content as canonical JSON.

    Raises:
        OptionError: The file cannot be used.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"--profile wants a file of trueroll diagnose or fit-table; {path}: {error}") from error
    try:
        entry = json.loads(text)
        parse_table_prior(text)
    except (json.JSONDecodeError, ValidationError, ValueError) as error:
        words = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise OptionError(f"--profile wants a file of trueroll diagnose or fit-table; {path}: {words}") from error
    return json.dumps(entry, sort_keys=True)


def parse_table_prior(text: str) -> TablePrior:
    """Build the prior of a table from a profile.

    Args:
        text: Content of the profile, JSON.

    Returns:
        Priors of the table parameters and of its noses; effects of camera and balls are left out.

    Raises:
        ValueError: A parameter is unknown or out of range.
    """
    entry = ProfileEntry.model_validate(json.loads(text))
    effects = {
        f"{effect}.{name}": (one.value, one.sigma)
        for effect, numbers in entry.effects.items()
        for name, one in numbers.items()
    }
    table_effects = {name: value for name, value in effects.items() if not name.startswith(_CAMERA_EFFECTS)}
    if unknown := set(table_effects) - set(TABLE_PARAMETERS):
        raise ValueError(f"a table has {', '.join(TABLE_PARAMETERS)}; it has no {', '.join(sorted(unknown))}")
    prior = build_table_prior(entry.laws.cushion, entry.laws.ball, table_effects)
    noses = [  # outwards, as in the simulation of whole shots
        Prior(f"nose.{side}", "m", -one.value, one.sigma or NOSE_SIGMA, False, (-_MAX_NOSE_OFFSET, _MAX_NOSE_OFFSET))
        for side, one in entry.noses.items()
    ]
    return replace(prior, priors=(*prior.priors, *noses))


def parse_learned_table(text: str) -> LearnedTable:
    """Build the table that predictions use from a profile.

    Args:
        text: Content of the profile, JSON.

    Returns:
        The table; what the profile does not hold is that of a usual table.

    Raises:
        ValueError: A parameter is unknown or out of range.
    """
    entry, prior = ProfileEntry.model_validate(json.loads(text)), parse_table_prior(text)
    physics = neutral_parameters()
    for name in (*contact_parameters(entry.laws.cushion, entry.laws.ball), *USUAL_PARAMETERS):
        if name not in NEUTRAL_BY_DEFAULT:
            physics[PARAMETER_NAMES.index(name)] = find_prior(*name.split(".")).value
    table_priors = [one for one in prior.priors if one.name in PARAMETER_NAMES]
    for one in table_priors:
        physics[PARAMETER_NAMES.index(one.name)] = one.value
    noses_by_side = {str(side): one for side, one in entry.noses.items()}
    noses = [noses_by_side.get(side, ProfileNumberEntry(value=0.0)) for side in CUSHIONS]
    scatter = DEFAULT_SCATTER if entry.scatter is None else ContactScatter(**entry.scatter.model_dump())
    if entry.covariance is not None:
        names, covariance = entry.covariance.parameters, np.array(entry.covariance.matrix)
        nose_covariance = np.array(entry.covariance.noses)
    else:
        cushions = [one for one in table_priors if one.name.startswith(("cushion", "spin_decay"))]
        names, covariance = [one.name for one in cushions], np.diag([one.sigma**2 for one in cushions])
        nose_covariance = np.diag([(NOSE_SIGMA if one.sigma is None else one.sigma) ** 2 for one in noses])
    return LearnedTable(
        entry.laws.cushion,
        physics,
        scatter,
        np.array([one.value for one in noses]),
        nose_covariance,
        np.array([PARAMETER_NAMES.index(name) for name in names], np.int64),
        covariance.reshape(len(names), len(names)),
        np.array(entry.correction.weights),
    )


def parse_cloth_priors(text: str) -> tuple[Prior, Prior]:
    """Build the priors of sliding and rolling friction from a profile, for the contact test of `trueroll call`.

    Args:
        text: Content of the profile, JSON.

    Returns:
        Their values, and standard deviations of their logarithms from one shot to the next.

    Raises:
        ValueError: A parameter is unknown or out of range.
    """
    physics = parse_learned_table(text).physics
    sliding, rolling = (
        replace(find_prior(*PARAMETER_NAMES[k].split(".")), value=float(physics[k])) for k in (SLIDING_MU, ROLLING_MU)
    )
    return (
        replace(sliding, sigma=CLOTH_SPREAD),
        replace(rolling, sigma=float(np.hypot(CLOTH_SPREAD, ROLLING_MODEL_SIGMA))),
    )


# Parameters without which no ball behaves as on a table.
USUAL_PARAMETERS = (
    "sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate", "ball_restitution.e", "ball_friction.mu",
)  # fmt: skip
# Details that a profile without them leaves out.
NEUTRAL_BY_DEFAULT = ("cushion_restitution_speed.slope", "cushion_restitution_power.power", "cushion_height.ratio")
# Relative error of a covariance that numbers in a file may cause.
_ROUNDING = 1e-9
# Largest relative difference of two measured sizes of one table.
SIZE_TOLERANCE = 0.02
# m, bound of the offset of a nose, as in the fit of whole shots.
_MAX_NOSE_OFFSET = 0.03
# Effects of the camera and of the balls, which may differ in the next clip.
_CAMERA_EFFECTS = tuple(effect.name for effect in BILLIARDS_EFFECTS if not effect.is_in_engine)
