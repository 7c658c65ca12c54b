"""Reading of a table profile, which `trueroll diagnose` writes, as the prior of the next run."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, field_validator

from models.core.errors import OptionError
from models.estimation.whole_shot.known_table import TablePrior, build_table_prior
from models.physics.billiards.ball_ball.ball_models import BALL_MODEL_CHOICE
from models.physics.billiards.ball_cushion.cushion_models import CUSHION_MODEL_CHOICE
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.effect import ModelChoice
from models.physics.effects.catalogue import BILLIARDS_EFFECTS


class ProfileNumberEntry(BaseModel):
    """A parameter of an effect with its standard deviation."""

    model_config = ConfigDict(extra="allow")
    value: FiniteFloat
    sigma: FiniteFloat | None = Field(default=None, gt=0)


class ProfileLawsEntry(BaseModel):
    """Contact models of the table."""

    cushion: str = "mirror"
    ball: str = "inelastic"

    @field_validator("cushion")
    @classmethod
    def _require_cushion_model(cls, name: str) -> str:
        return _require_form(name, CUSHION_MODEL_CHOICE)

    @field_validator("ball")
    @classmethod
    def _require_ball_model(cls, name: str) -> str:
        return _require_form(name, BALL_MODEL_CHOICE)


class ProfileEntry(BaseModel):
    """Content of a profile.json."""

    model_config = ConfigDict(extra="allow")
    scene: Literal["billiards"] = "billiards"
    effects: dict[str, dict[str, ProfileNumberEntry]]
    laws: ProfileLawsEntry = ProfileLawsEntry()


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
        raise OptionError(f"--profile wants a file that trueroll diagnose wrote; {path}: {error}") from error
    try:
        entry = json.loads(text)
        parse_table_prior(text)
    except (json.JSONDecodeError, ValidationError, ValueError) as error:
        words = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise OptionError(f"--profile wants a file that trueroll diagnose wrote; {path}: {words}") from error
    return json.dumps(entry, sort_keys=True)


def parse_table_prior(text: str) -> TablePrior:
    """Build the prior of a table from a profile.

    Args:
        text: Content of the profile, JSON.

    Returns:
        Priors of the table parameters; effects of camera and balls are left out.

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
    if unknown := set(table_effects) - set(PARAMETER_NAMES):
        raise ValueError(f"a table has {', '.join(PARAMETER_NAMES)}; it has no {', '.join(sorted(unknown))}")
    return build_table_prior(entry.laws.cushion, entry.laws.ball, table_effects)


def _require_form(name: str, choice: ModelChoice) -> str:
    if name not in choice.forms:
        raise ValueError(f"{choice.name} is one of {', '.join(choice.forms)}; got {name!r}")
    return name


_CAMERA_EFFECTS = tuple(effect.name for effect in BILLIARDS_EFFECTS if not effect.is_in_engine)
"""Effects of the camera and of the balls, which may differ in the next clip."""
