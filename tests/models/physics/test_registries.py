"""A new effect and a new cushion model are one file each: catalogue, checks and compiled contacts follow."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from models.core.module_discovery import find_discovered_packages
from models.physics.billiards.contact_model import collect_models, find_model
from models.physics.billiards.contact_models import REGISTERED_CUSHION_MODELS
from models.physics.effects.billiards_catalogue import collect_effects

ROOT = Path(__file__).resolve().parents[3]

EFFECT = '''"""Glue: the part of the motion along a cushion that a contact takes away."""

from models.physics.effect import BilliardsEffect, Prior

EFFECT = BilliardsEffect(
    name="glue",
    site="cushion",
    phases=("cushion_contact",),
    parameters=(Prior("share", "1", 0.0, 0.1, False, (0.0, 1.0)),),
    neutral=(0.0,),
    limits=(0.0, 1.0),
    reference="this test",
)
'''
CUSHION_MODEL = '''"""A cushion that returns a ball at half its normal speed and glues it."""

from models.numerics.jit import compile_kernel
from models.physics.billiards.contact_model import ContactModel
from models.physics.billiards.parameter_vector import parameter_index

_GLUE = parameter_index("glue.share")


@compile_kernel
def rebound(vn, vt, wn, wt, wz, radius, mass, p):  # type: ignore[no-untyped-def]
    return -0.5 * vn, (1.0 - p[_GLUE]) * vt, wn, wt, wz


MODEL = ContactModel("sticky", ("glue.share",), "Half the speed comes back", "this test", rebound)
'''
QUESTIONS = """
import json
import numpy as np
from models.physics.billiards.contact_models import CUSHION_MODEL_CHOICE, CUSHION_MODELS
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.contact_resolution import resolve_cushion_contact
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.effects.billiards_catalogue import BILLIARDS_EFFECTS, find_prior

def error(**arguments):
    try:
        Physics.from_effects({"glue": {"share": arguments.pop("share", 0.25)}}, **arguments)
    except ValueError as problem:
        return str(problem)

before, after = np.array([0.03, 0.5, -1.0, 0.8, 0.0, 0.0, 0.0]), np.zeros(7)
physics = Physics.from_effects({"glue": {"share": 0.25}}, cushion="sticky")
resolve_cushion_contact(before, -1.0, 0.0, 0.03, 0.2, physics.values, physics.model_codes[0], False, after)
print(json.dumps({
    "effects": [effect.name for effect in BILLIARDS_EFFECTS],
    "sigma": find_prior("glue", "share").sigma,
    "parameters": PARAMETER_NAMES,
    "models": CUSHION_MODELS,
    "forms": CUSHION_MODEL_CHOICE.forms,
    "not used": error(cushion="han_2005"),
    "too much": error(cushion="sticky", share=1.5),
    "velocity": after[2:4].tolist(),
}))
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Ask a copy of the program with one file more for the effect, and one for the cushion model."""
    folder = tmp_path_factory.mktemp("program")
    shutil.copytree(ROOT / "models", folder / "models", ignore=shutil.ignore_patterns("__pycache__"))
    physics = folder / "models" / "physics"
    (physics / "effects" / "contacts" / "glue.py").write_text(EFFECT)
    (physics / "billiards" / "ball_cushion" / "sticky.py").write_text(CUSHION_MODEL)
    environment = {
        **os.environ,
        "PYTHONPATH": str(folder),
        "NUMBA_CACHE_DIR": str(folder / "compiled"),
        "NUMBA_OPT": "0",
    }
    run = subprocess.run(
        [sys.executable, "-P", "-c", QUESTIONS],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    answers: dict[str, Any] = json.loads(run.stdout)
    return answers


def test_an_effect_in_one_file_is_in_the_catalogue_and_in_the_vector_of_the_engine(answers: dict[str, Any]) -> None:
    assert answers["effects"][-1] == "glue"
    assert answers["parameters"][-1] == "glue.share"
    assert answers["sigma"] == 0.1


def test_a_cushion_model_in_one_file_is_a_choice_of_simulation_and_diagnosis(answers: dict[str, Any]) -> None:
    assert answers["models"][-1] == "sticky"
    assert answers["forms"][-1] == "sticky"


def test_parameters_of_a_new_effect_are_checked(answers: dict[str, Any]) -> None:
    assert answers["not used"] == "glue.share is not used by the cushion law han_2005; leave it out, or take sticky"
    assert answers["too much"] == "glue.share is between 0 and 1; got 1.5"


def test_a_compiled_contact_uses_a_new_effect_in_a_new_model(answers: dict[str, Any]) -> None:
    assert answers["velocity"] == pytest.approx([0.5, 0.6], abs=1e-12)


def test_two_entries_of_one_name_are_refused() -> None:
    modules = [sys.modules["models.physics.billiards.ball_cushion.mirror"]] * 2
    with pytest.raises(ValueError, match="unique; got mirror, mirror"):
        collect_models(modules)
    modules = [sys.modules["models.physics.effects.cloth.nap"]] * 2
    with pytest.raises(ValueError, match="unique; got nap, nap"):
        collect_effects(modules)


def test_an_unknown_model_is_named_with_the_others() -> None:
    with pytest.raises(ValueError, match="mirror, han_2005, mathavan_2010, stronge; got 'bouncy'"):
        find_model(REGISTERED_CUSHION_MODELS, "bouncy")


def test_caches_see_the_packages_that_registries_discover() -> None:
    registries = ("effects/billiards_catalogue", "billiards/contact_models")
    sources = [(ROOT / "models" / "physics" / f"{name}.py").read_bytes() for name in registries]
    assert [find_discovered_packages(source) for source in sources] == [
        ("models.physics.effects",),
        ("models.physics.billiards.ball_ball", "models.physics.billiards.ball_cushion"),
    ]
