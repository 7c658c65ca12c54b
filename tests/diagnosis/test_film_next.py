"""What to film next: the sentence is computed, and what it promises comes true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Filming, Pucks, film

from diagnosis.fitting.fit_residuals import Residuals, residuals
from diagnosis.fitting.hypothesis_fits import Fitted, Question, Seen, fit, look, question_of
from diagnosis.selection.signatures import signatures
from diagnosis.verdicts.experiment_design import film_to_see, film_what_is_left
from diagnosis.verdicts.localisation import places
from models.estimation.gap_scenes.gap_scene import Recording

FRICTION = {"friction.mu": 0.02}


@pytest.fixture(scope="module")
def shots() -> tuple[Recording, ...]:
    return film(np.random.default_rng(3), FRICTION, Filming(shots=4, fps=30))


@pytest.fixture(scope="module")
def asked() -> Question:
    return question_of(Pucks(), 0.0)


@pytest.fixture(scope="module")
def fitted(asked: Question, shots: tuple[Recording, ...]) -> tuple[Fitted, Seen, Residuals]:
    found = fit(asked, shots)
    seen = look(asked, found)
    return found, seen, residuals(asked, found, seen, np.random.default_rng(0))


def test_what_would_be_seen_needs_no_more_film(asked: Question, fitted: tuple[Fitted, Seen, Residuals]) -> None:
    found, seen, left = fitted
    plenty = np.full(len(asked.priors), 1e6)
    assert film_to_see(asked, seen.told, left, found.free, plenty, ("slope", "air_drag"), 1.0) == ""


def test_the_shots_that_are_asked_for_show_the_effect(asked: Question, fitted: tuple[Fitted, Seen, Residuals]) -> None:
    found, seen, left = fitted
    usual = 0.7 * _seen_from(asked, found, seen)
    said = film_to_see(asked, seen.told, left, found.free, usual, ("air_drag",), 1.0)
    assert said.startswith("This answer needs no more film."), "what was not asked for is said as such"
    words = said.split()
    more, shot = int(words[words.index("more", words.index("strength;")) - 1]), int(words[words.index("shot") + 1])
    number = [piece.shot for piece in found.pieces].index(shot)
    copies = tuple(replace(found.pieces[number], shot=100 + k) for k in range(more))
    with_them = fit(asked, (*found.pieces, *copies), guess=found.shared)
    mask = asked.mask(("air_drag",))
    assert np.all(_seen_from(asked, with_them, look(asked, with_them))[mask] <= 1.01 * usual[mask])


def test_nothing_is_asked_for_that_no_number_of_shots_can_show(
    asked: Question, fitted: tuple[Fitted, Seen, Residuals]
) -> None:
    found, seen, left = fitted
    assert film_to_see(asked, seen.told, left, found.free, np.full(len(asked.priors), 1e-9), ("air_drag",), 1.0) == ""


def test_what_is_left_is_sought_in_the_shot_that_has_it(asked: Question, shots: tuple[Recording, ...]) -> None:
    bent = shots[2].places.copy()
    bent[:, 0] += 0.02 * np.sin(6 * shots[2].t)[:, None]
    found = fit(asked, (*shots[:2], replace(shots[2], places=bent), shots[3]))
    left = residuals(asked, found, look(asked, found), np.random.default_rng(0))
    assert f"in shot {shots[2].shot} " in film_what_is_left(asked, left)


def test_a_ball_is_named_as_its_own_film_names_it(asked: Question, shots: tuple[Recording, ...]) -> None:
    many = tuple(replace(one, bodies=tuple(f"{one.shot}.{k}" for k in range(len(one.bodies)))) for one in shots)
    found = fit(asked, many)
    left = residuals(asked, found, look(asked, found), np.random.default_rng(0))
    its_own = (left.shot == many[2].shot) & (left.body == 0)
    odd = replace(left, left=np.where(its_own[:, None], 5.0 / left.size, left.left))
    assert {place.ball for place in places(odd, many, frozenset())} == {many[2].bodies[0]}


def _seen_from(question: Question, found: Fitted, seen: Seen) -> np.ndarray:
    """(P,) smallest strengths that show."""
    mask = question.mask(("air_drag",))
    strengths = signatures(question, seen.told, found.free & ~mask, 1.0).detectable(mask)
    return np.where(np.isfinite(strengths), strengths, 1.0)
