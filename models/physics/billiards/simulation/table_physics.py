"""Physics of a table: which effects act, how strongly, and by which models balls and cushions touch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.physics.billiards.contact_model import ContactModel, find_model
from models.physics.billiards.contact_models import (
    BALL_MODEL_CHOICE,
    BALL_MODELS,
    CUSHION_MODEL_CHOICE,
    CUSHION_MODELS,
    REGISTERED_BALL_MODELS,
    REGISTERED_CUSHION_MODELS,
)
from models.physics.billiards.parameter_vector import (
    ENGINE_EFFECTS,
    IS_CLOTH_PARAMETER,
    NAP_MU,
    PARAMETER_NAMES,
    ROLLING_MU,
    neutral_parameters,
    parameter_index,
)
from models.physics.effect import BilliardsEffect

# Choices between published contact models, which a diagnosis treats like effects.
BILLIARDS_MODEL_CHOICES = (CUSHION_MODEL_CHOICE, BALL_MODEL_CHOICE)


@dataclass(frozen=True, slots=True)
class Physics:
    """Strengths of the effects that act on a table, and the contact models."""

    values: FloatArray
    """(P,) in the order of `PARAMETER_NAMES`; SI, but slope in mm/m."""
    present: tuple[str, ...]
    """Names among `PARAMETER_NAMES` that were given a value; the others are neutral."""
    cushion: str = "mirror"
    """One of `CUSHION_MODELS`."""
    ball: str = "inelastic"
    """One of `BALL_MODELS`."""

    def __post_init__(self) -> None:
        find_model_codes(self.cushion, self.ball)
        if self.values.shape != (len(PARAMETER_NAMES),) or not np.isfinite(self.values).all():
            raise ValueError(
                f"{len(PARAMETER_NAMES)} finite numbers are wanted, in the order of PARAMETER_NAMES; got {self.values}"
            )

    @property
    def model_codes(self) -> tuple[int, int]:
        """Codes of the cushion model and the ball model in compiled functions."""
        return find_model_codes(self.cushion, self.ball)

    @classmethod
    def from_effects(
        cls, effects: Mapping[str, Mapping[str, float]], cushion: str = "mirror", ball: str = "inelastic"
    ) -> Physics:
        """Build the physics of a list of effects.

        Args:
            effects: Values by effect and parameter, such as `{"sliding_friction": {"mu": 0.2}}`, in the units of the
                effects. An effect that is not listed is absent.
            cushion: One of `CUSHION_MODELS`.
            ball: One of `BALL_MODELS`.

        Returns:
            The physics.

        Raises:
            ValueError: An effect, parameter or model is unknown, a contact model does not read a parameter, or a value
                is impossible.
        """
        values, present = neutral_parameters(), []
        for effect_name, strengths in effects.items():
            effect = _find_effect(effect_name)
            for parameter, value in strengths.items():
                own_names = [prior.name for prior in effect.parameters]
                if parameter not in own_names:
                    raise ValueError(f"{effect_name} has {', '.join(own_names)}; it has no {parameter!r}")
                low, high = effect.limits
                if not low <= value <= high:
                    wanted = f"at least {low:g}" if np.isinf(high) else f"between {low:g} and {high:g}"
                    raise ValueError(f"{effect_name}.{parameter} is {wanted}; got {value:g}")
                present.append(f"{effect_name}.{parameter}")
                values[parameter_index(present[-1])] = value
        physics = cls(values, tuple(present), cushion, ball)
        _require_used(physics)
        _require_nap_below_resistance(physics)
        return physics


def find_model_codes(cushion: str, ball: str) -> tuple[int, int]:
    """Find the codes of a cushion model and a ball model in compiled functions.

    Args:
        cushion: One of `CUSHION_MODELS`.
        ball: One of `BALL_MODELS`.

    Returns:
        The codes.

    Raises:
        ValueError: A model is unknown.
    """
    find_model(REGISTERED_CUSHION_MODELS, cushion)
    find_model(REGISTERED_BALL_MODELS, ball)
    return CUSHION_MODELS.index(cushion), BALL_MODELS.index(ball)


def contact_parameters(cushion: str, ball: str) -> tuple[str, ...]:
    """List the parameters that two contact models read.

    Args:
        cushion: One of `CUSHION_MODELS`.
        ball: One of `BALL_MODELS`.

    Returns:
        Names among `PARAMETER_NAMES`, those of the cushion model first.

    Raises:
        ValueError: A model is unknown.
    """
    return (
        *find_model(REGISTERED_CUSHION_MODELS, cushion).parameters,
        *find_model(REGISTERED_BALL_MODELS, ball).parameters,
    )


def _find_effect(name: str) -> BilliardsEffect:
    by_name = {effect.name: effect for effect in ENGINE_EFFECTS if effect.kind != "probe"}
    if name not in by_name:
        raise ValueError(f"effects are {', '.join(sorted(by_name))}; got {name!r}")
    return by_name[name]


def _require_used(physics: Physics) -> None:
    """Raise ValueError for a parameter of a contact that its model does not read."""
    used = {*contact_parameters(physics.cushion, physics.ball)}
    for name in physics.present:
        if IS_CLOTH_PARAMETER[parameter_index(name)] or name in used:
            continue
        site = _find_effect(name.partition(".")[0]).site
        model, models = physics.cushion, REGISTERED_CUSHION_MODELS
        if site == "ball":
            model, models = physics.ball, REGISTERED_BALL_MODELS
        raise ValueError(
            f"{name} is not used by the {site} law {model}; leave it out, or take {_list_readers(models, name)}"
        )


def _list_readers(models: tuple[ContactModel, ...], parameter: str) -> str:
    return " or ".join(model.name for model in models if parameter in model.parameters)


def _require_nap_below_resistance(physics: Physics) -> None:
    nap, rolling = abs(float(physics.values[NAP_MU])), float(physics.values[ROLLING_MU])
    if nap > rolling:
        raise ValueError(f"nap.mu may be as large as rolling_resistance.mu, or it would drive balls; got {nap:g}")
