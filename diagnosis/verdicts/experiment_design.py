"""Experiment design: the kind of shot, of those already filmed, that is most informative on an open question."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.fitting.display_names import format_cause, format_phase
from diagnosis.fitting.fit_residuals import FitResiduals
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, ShotInformation
from diagnosis.selection.signatures import compute_signatures
from diagnosis.verdicts.gap_localisation import excess_squares
from models.core.typing import BoolArray, FloatArray

# Numbers of further shots of one kind that are considered.
_REPETITIONS = (1, 2, 3, 5, 8, 12, 20, 30, 50)


def design_separating_experiment(
    problem: DiagnosisProblem,
    shot_information: ShotInformation,
    residuals: FitResiduals,
    free: np.ndarray,
    group: tuple[str, ...],
) -> str:
    """Describe in one sentence which kind of shot separates a group best, and how many more are needed."""
    if len(group) < 2:
        return ""
    one, other = problem.mask(group[:1]), problem.mask(group[1:2])
    whole = compute_signatures(problem, shot_information, free | other)
    step = compute_signatures(problem, shot_information, free).step(one)
    apart = [
        _separation_gain(problem, shot_information, free | other, one, step, k)
        for k in range(len(shot_information.shots))
    ]
    best = int(np.argmax(apart))
    now = float(step @ whole.information[np.ix_(one, one)] @ step)
    missing = max(16.0 - now, 0.0)
    more = int(np.ceil(missing / apart[best])) if apart[best] > 0 else 0
    names = " from ".join(format_cause(name) for name in group[:2])
    if apart[best] <= 0 or more > 50:
        return f"No shot like these separates {names}: film other speeds and directions, also at right angles to these."
    shot = _describe_shot(residuals, int(shot_information.shots[best]))
    return f"To separate {names}, film {max(more, 1)} more like {shot}."


def design_detecting_experiment(
    problem: DiagnosisProblem,
    shot_information: ShotInformation,
    residuals: FitResiduals,
    free: BoolArray,
    usual: FloatArray,
    names: tuple[str, ...],
    variance_factor: float,
) -> str:
    """Describe in one sentence how many more shots of which kind would show an effect that these shots would miss.

    The effect is the one nearest to detection at `usual` strength (P,). The sentence is empty where none would be
    missed; where no number of shots like these would show it, the sentence asks for other shots.
    """
    missed = {
        name: _detectable_over_typical(problem, shot_information, free, usual, name, variance_factor) for name in names
    }
    missed = {name: times for name, times in missed.items() if times > 1}
    if not missed:
        return ""
    name = min(missed, key=lambda one: missed[one])
    for more in _REPETITIONS:
        left = [
            _detectable_over_typical(
                problem, _add_repetitions(shot_information, k, more), free, usual, name, variance_factor
            )
            for k in range(len(shot_information.shots))
        ]
        if min(left) <= 1:
            like = _describe_shot(residuals, int(shot_information.shots[int(np.argmin(left))]))
            return (
                f"This answer needs no more film. These shots would not have shown {format_cause(name)} of usual"
                f" strength; {more} more like {like} would."
            )
    return (
        f"This answer needs no more film. To test {format_cause(name)} of usual strength, film much slower and much"
        " faster motion, and for longer; more shots like these would not reveal it."
    )


def design_unknown_experiment(problem: DiagnosisProblem, residuals: FitResiduals) -> str:
    """Describe in one sentence where most of the unexplained gap is, and which film would separate its causes."""
    left = excess_squares(residuals)
    sums = {
        (str(name), int(shot)): float(left[(residuals.phase == name) & (residuals.shot == shot)].sum())
        for name in np.unique(residuals.phase)
        for shot in np.unique(residuals.shot)
    }
    most, shot = max(sums, key=lambda one: sums[one])
    place = _describe_shot(residuals, shot)
    first = f"Most of the unexplained gap is {format_phase(most)}, in {place}: film that shot again at half the speed,"
    if residuals.reference.unit == "rad":
        return f"{first} and once with the camera in another place; what changes with the camera comes from it."
    surroundings = "table" if problem.scene.name == "billiards" else "surroundings"
    return f"{first} and once in another place; what stays with the place comes from the {surroundings} or the camera."


def _detectable_over_typical(
    problem: DiagnosisProblem,
    shot_information: ShotInformation,
    free: BoolArray,
    usual: FloatArray,
    name: str,
    variance_factor: float,
) -> float:
    """Return the smallest detectable strength of an effect over its typical one, in its worst direction."""
    mask = problem.mask((name,))
    seen_from = compute_signatures(problem, shot_information, free & ~mask, variance_factor).detectable_strengths(mask)
    return float(np.max(seen_from[mask] / usual[mask], initial=0.0))


def _add_repetitions(shot_information: ShotInformation, k: int, more: int) -> ShotInformation:
    """Return the information if shot number k had been repeated `more` times."""
    times = 1.0 + more * (shot_information.shots == shot_information.shots[k])
    return replace(shot_information, information=shot_information.information * times[:, None, None])


def _separation_gain(
    problem: DiagnosisProblem,
    shot_information: ShotInformation,
    free: np.ndarray,
    one: np.ndarray,
    step: np.ndarray,
    shot: int,
) -> float:
    """Return the chi2 that one more shot like this one adds between two effects."""
    more, now = (
        compute_signatures(problem, _add_repetitions(shot_information, shot, 1), free),
        compute_signatures(problem, shot_information, free),
    )
    return float(step @ (more.information - now.information)[np.ix_(one, one)] @ step)


def _describe_shot(residuals: FitResiduals, shot: int) -> str:
    """Describe a shot by its number and by the speed and direction of its fastest body."""
    here = np.flatnonzero(residuals.shot == shot)
    top = here[int(np.argmax(residuals.speed[here]))]
    fastest, velocity = f"up to {float(residuals.speed[top]):.1f} {residuals.reference.unit}/s", residuals.velocity[top]
    if len(velocity) < 2 or residuals.reference.unit != "m":
        return f"shot {shot} ({fastest})"
    angle = float(np.degrees(np.arctan2(velocity[1], velocity[0])))
    return f"shot {shot} ({fastest}, there at {round(angle)} degrees from x)"
