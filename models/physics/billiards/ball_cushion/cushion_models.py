"""Registry of the cushion models: it finds every file in this folder that defines `MODEL`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from models.core.module_discovery import discover_modules
from models.numerics.jit import compile_inline_closure
from models.physics.billiards.contact_model import collect_models, compose_dispatch, tabulate_parameters
from models.physics.billiards.parameter_vector import REBOUND_PARAMETERS
from models.physics.effect import ModelChoice

# All cushion models, by code.
REGISTERED_CUSHION_MODELS = collect_models(discover_modules("models.physics.billiards.ball_cushion"))
# Names of the cushion models; the position of a name is the code of the model in compiled functions.
CUSHION_MODELS = tuple(model.name for model in REGISTERED_CUSHION_MODELS)
# (models, P) whether a parameter acts in a contact by a cushion model.
CUSHION_MODEL_READS = tabulate_parameters(REGISTERED_CUSHION_MODELS, REBOUND_PARAMETERS)


def _prepend_model(own_code: int, resolve: Callable[..., Any], others: Any) -> Any:
    @compile_inline_closure
    def dispatch(code, vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
        if code == own_code:
            return resolve(vn, vt, wn, wt, wz, radius, mass, p)
        return others(code, vn, vt, wn, wt, wz, radius, mass, p)

    return dispatch


def _ignore_code(resolve: Callable[..., Any]) -> Any:
    @compile_inline_closure
    def dispatch(code, vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
        return resolve(vn, vt, wn, wt, wz, radius, mass, p)

    return dispatch


# (code, vn, vt, wn, wt, wz, radius, mass, p) to (vn, vt, wn, wt, wz): the model of that code.
dispatch_cushion_model = compose_dispatch(REGISTERED_CUSHION_MODELS, _prepend_model, _ignore_code)

# The models differ in the height of the nose, its compliance, and friction during the impact. Without friction a
# published model is hardly more than a mirror.
CUSHION_MODEL_CHOICE = ModelChoice(
    name="cushion_law",
    phases=("cushion_contact",),
    forms=tuple(model.name for model in REGISTERED_CUSHION_MODELS if model.is_candidate),
    partners=("cushion_restitution_speed", "cushion_friction"),
    companions=("cushion_friction", "cushion_cloth"),
    reference="docs/reference/contact-models.md",
    phrase="another cushion law",
)
