"""Registry of the contact models: it finds every file in `ball_ball` and `ball_cushion` that defines `MODEL`.

It chooses none of them. The cushion law of a table is the one of greatest evidence, in two places below
`models.estimation`:

- `table_learning.cushion_learning.learn_cushions` compares the laws by cushion contacts alone: of many shots for
  `trueroll fit-table` and `certify` (`table_learning.learn_table`), of a single shot for a prediction without a profile
  (`learn_own_cushions`, with three of the laws);
- `whole_shot.table_fit.search_laws` compares them by whole shots, from strike to rest, for `trueroll run --laws`
  (`pipeline.stages.laws_stage`) and `trueroll what-if`, both through `pipeline.io.shot_laws`; a profile of the table
  states the law instead.

`trueroll diagnose` tests the laws like effects, as forms of `CUSHION_MODEL_CHOICE`; the input of `trueroll simulate`
states one.
"""

from __future__ import annotations

from models.core.module_discovery import discover_modules
from models.physics.billiards.contact_model import collect_models, compose_dispatch, tabulate_parameters
from models.physics.billiards.parameter_vector import IMPULSE_PARAMETERS, REBOUND_PARAMETERS
from models.physics.effect import ModelChoice

# All models of two balls and of ball and cushion, by code.
REGISTERED_BALL_MODELS = collect_models(discover_modules("models.physics.billiards.ball_ball"))
REGISTERED_CUSHION_MODELS = collect_models(discover_modules("models.physics.billiards.ball_cushion"))
# Their names; the position of a name is the code of the model in compiled functions.
BALL_MODELS = tuple(model.name for model in REGISTERED_BALL_MODELS)
CUSHION_MODELS = tuple(model.name for model in REGISTERED_CUSHION_MODELS)
# (models, P) whether a parameter acts in a contact by a model.
BALL_MODEL_READS = tabulate_parameters(REGISTERED_BALL_MODELS, IMPULSE_PARAMETERS)
CUSHION_MODEL_READS = tabulate_parameters(REGISTERED_CUSHION_MODELS, REBOUND_PARAMETERS)
# Code of the model of gentle contacts, which lose no energy.
GENTLE_MODEL = BALL_MODELS.index("elastic")
# Code and arguments of a model, see `contact_model`, to its result.
dispatch_ball_model = compose_dispatch(REGISTERED_BALL_MODELS)
dispatch_cushion_model = compose_dispatch(REGISTERED_CUSHION_MODELS)

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
