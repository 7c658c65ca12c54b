"""A table profile, as `trueroll diagnose` writes it: what the next run starts from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from models.core.errors import OptionError
from models.estimation.whole_shot.table_prior import KnownTable, known_table
from models.physics.billiards.parameters import NAMES


class NumberEntry(BaseModel):
    """A parameter of an effect."""

    model_config = ConfigDict(extra="allow")
    value: FiniteFloat
    sigma: FiniteFloat | None = Field(default=None, gt=0)


class LawsEntry(BaseModel):
    cushion: Literal["mirror", "han_2005", "mathavan_2010", "stronge"] = "mirror"
    ball: Literal["elastic", "inelastic", "alciatore"] = "inelastic"


class ProfileEntry(BaseModel):
    """The file."""

    model_config = ConfigDict(extra="allow")
    scene: Literal["billiards"] = "billiards"
    effects: dict[str, dict[str, NumberEntry]]
    laws: LawsEntry = LawsEntry()


def profile_text(path: Path) -> str:
    """The content of a profile, one that can be used; OptionError with a sentence where it cannot.

    Options hold the content, not the name of the file: what was made from another content is then out of date.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise OptionError(f"--profile wants a file that trueroll diagnose wrote; {path}: {error}") from error
    try:
        entry = json.loads(text)
        table_of(text)
    except (json.JSONDecodeError, ValidationError, ValueError) as error:
        words = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise OptionError(f"--profile wants a file that trueroll diagnose wrote; {path}: {words}") from error
    return json.dumps(entry, sort_keys=True)


def table_of(text: str) -> KnownTable:
    """The table that a profile stands for; what is seen of it, such as a lens, belongs to a camera and is left out."""
    entry = ProfileEntry.model_validate(json.loads(text))
    effects = {
        f"{effect}.{name}": (one.value, one.sigma)
        for effect, numbers in entry.effects.items()
        for name, one in numbers.items()
    }
    unseen = {name: told for name, told in effects.items() if not name.startswith(_OF_CAMERA)}
    if unknown := set(unseen) - set(NAMES):
        raise ValueError(f"a table has {', '.join(NAMES)}; it has no {', '.join(sorted(unknown))}")
    return known_table(entry.laws.cushion, entry.laws.ball, unseen)


_OF_CAMERA = (
    "lens_distortion", "lens_second_term", "perspective", "scale", "rolling_shutter", "dropped_frames", "unequal_mass",
    "unequal_radius",
)  # fmt: skip
"""Effects of the film and of the balls, which the next clip need not share."""
