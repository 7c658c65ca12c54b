"""Registry of the models of two balls that meet: it finds every file in this folder that defines `MODEL`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from models.core.module_discovery import discover_modules
from models.numerics.jit import compile_inline_closure
from models.physics.billiards.contact_model import collect_models, compose_dispatch, tabulate_parameters
from models.physics.billiards.parameter_vector import IMPULSE_PARAMETERS
from models.physics.effect import ModelChoice

# All ball models, by code.
REGISTERED_BALL_MODELS = collect_models(discover_modules("models.physics.billiards.ball_ball"))
# Names of the ball models; the position of a name is the code of the model in compiled functions.
BALL_MODELS = tuple(model.name for model in REGISTERED_BALL_MODELS)
# (models, P) whether a parameter acts in a contact by a ball model.
BALL_MODEL_READS = tabulate_parameters(REGISTERED_BALL_MODELS, IMPULSE_PARAMETERS)
# Code of the model of gentle contacts, which lose no energy.
GENTLE_MODEL = BALL_MODELS.index("elastic")


def _prepend_model(own_code: int, resolve: Callable[..., Any], others: Any) -> Any:
    @compile_inline_closure
    def dispatch(code, van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p):  # type: ignore[no-untyped-def]
        if code == own_code:
            return resolve(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)
        return others(code, van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)

    return dispatch


def _ignore_code(resolve: Callable[..., Any]) -> Any:
    @compile_inline_closure
    def dispatch(code, van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p):  # type: ignore[no-untyped-def]
        return resolve(van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p)

    return dispatch


# (code, van, vat, wan, wat, waz, vbn, vbt, wbn, wbt, wbz, ra, rb, ma, mb, p) to the first ten of these after the
# contact: the model of that code.
dispatch_ball_model = compose_dispatch(REGISTERED_BALL_MODELS, _prepend_model, _ignore_code)

# The models differ in friction between the balls and in its dependence on the slip.
BALL_MODEL_CHOICE = ModelChoice(
    name="ball_law",
    phases=("ball_contact",),
    forms=tuple(model.name for model in REGISTERED_BALL_MODELS if model.is_candidate),
    partners=("ball_friction",),
    companions=(),
    reference="docs/reference/contact-models.md",
    phrase="another law of ball contacts",
)
