"""Where the gap is, and the kind of shot, of those already filmed, that is most informative on an open question.

The gap is located by phase, the ball or shot concerned, and the variable with which it grows.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr

from diagnosis.fitting.display_names import format_cause, format_direction, format_group, format_phase
from diagnosis.fitting.fit_residuals import FitResiduals, GroupFinding, ResidualStructure
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, ShotInformation
from diagnosis.selection.hypotheses import compute_signatures
from diagnosis.verdicts.verdict import GapLocation
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import BoolArray, FloatArray

# Share of a phase's gap from which one ball or shot is named.
_DOMINANT_SHARE = 0.7
# Rank correlation of the gap with a variable, over bins of it, from which it grows with the variable.
_MIN_RANK_CORRELATION = 0.7
# Number of bins of a variable.
_BINS = 8
# Phases of causes in the camera, which affect whatever moves.
CAMERA_PHASES = frozenset({"image_region", "time_jump"})


def localise_gap(
    residuals: FitResiduals, segments: tuple[Recording, ...], phases: frozenset[str]
) -> tuple[GapLocation, ...]:
    """Locate the gap by phase, largest share first, with shares that add to 1.

    Args:
        residuals: Residuals of the simulator's fit.
        segments: Segment of each window.
        phases: Phases in which the cause acts; empty where it is unknown.

    Returns:
        One location per phase.
    """
    left = excess_squares(residuals)
    # by name: bodies of several recordings differ and have another order
    bodies = np.array([segments[k].bodies[body] for k, body in zip(residuals.window, residuals.body, strict=True)])

    def localise(phase: str, share: float, here: BoolArray) -> GapLocation:
        ball, shot = (_find_dominant_value(left, values, here) for values in (bodies, residuals.shot))
        return GapLocation(
            phase, share, None if ball is None else str(ball), None if shot is None else int(shot),
            grows_with=_find_growth_variable(residuals, left, here),
        )  # fmt: skip

    if phases and phases <= CAMERA_PHASES:
        everything = np.ones(len(left), bool)
        return tuple(localise(name, 1 / len(phases), everything) for name in sorted(phases))
    present = np.unique(residuals.phase)
    names = [str(name) for name in present if name in phases] or [str(name) for name in present if name]
    totals = np.array([max(float(left[residuals.phase == name].sum()), 0.0) for name in names])
    if totals.sum() == 0:
        totals = np.array([float((residuals.phase == name).sum()) for name in names])
    order = np.argsort(-totals)
    return tuple(localise(names[k], float(totals[k] / totals.sum()), residuals.phase == names[k]) for k in order)


def excess_squares(residuals: FitResiduals) -> FloatArray:
    """Return the squared residuals (K,) beyond those of noise projected through the same fit."""
    return np.asarray(
        np.square(residuals.values * residuals.scale).sum(axis=1)
        - np.square(residuals.noise_draws).mean(axis=2).sum(axis=1)
    )


def _find_dominant_value(left: FloatArray, values: np.ndarray, here: np.ndarray) -> np.generic | None:
    """Find the one value, of at least three, that holds most of the gap in these observations."""
    candidates = np.unique(values[here])
    sums = np.array([max(float(left[here & (values == n)].sum()), 0.0) for n in candidates])
    if len(candidates) < 3 or sums.sum() <= 0 or sums.max() < _DOMINANT_SHARE * sums.sum():
        return None
    return np.asarray(candidates)[int(np.argmax(sums))]  # type: ignore[no-any-return]


def _find_growth_variable(residuals: FitResiduals, left: FloatArray, here: np.ndarray) -> str | None:
    """Find the variable with which the gap grows most monotonically."""
    numbers = {"time": residuals.t, "speed": residuals.speed, "time since contact": residuals.since_contact}
    if residuals.image is not None:
        numbers["radius"] = np.linalg.norm(residuals.image, axis=1)
    best, name = _MIN_RANK_CORRELATION, None
    for label, values in numbers.items():
        is_valid = here & np.isfinite(values)
        if is_valid.sum() < 10 * _BINS or np.ptp(values[is_valid]) == 0:
            continue
        order = np.flatnonzero(is_valid)[np.argsort(values[is_valid], kind="stable")]
        means = [float(left[part].mean()) for part in np.array_split(order, _BINS)]
        rank = float(spearmanr(np.arange(_BINS), means).statistic) if np.ptp(means) > 0 else 0.0
        if rank > best:
            best, name = rank, label
    return name


def describe_structure(structure: ResidualStructure, reference: ReferenceFrame) -> str:
    """Describe the largest findings in words."""
    return "; ".join([_describe_finding(one, reference) for one in structure.findings if one.z > 4][:3])


def _describe_finding(finding: GroupFinding, reference: ReferenceFrame) -> str:
    """Describe one finding in words."""
    group = finding.group
    place = group.label if group.family == "slow" else format_group(group.family, group.label, reference.unit)
    direction = format_direction(finding.direction, reference.coordinates)
    return f"{direction} {place} ({finding.z:.0f} standard deviations of noise)"


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
    more_like = (
        compute_signatures(problem, _add_repetitions(shot_information, k, 1), free | other)
        for k in range(len(shot_information.shots))
    )
    apart = [float(step @ (more.information - whole.information)[np.ix_(one, one)] @ step) for more in more_like]
    best = int(np.argmax(apart))
    now = float(step @ whole.information[np.ix_(one, one)] @ step)
    missing = max(16.0 - now, 0.0)
    more = int(np.ceil(missing / apart[best])) if apart[best] > 0 else 0
    names = " from ".join(format_cause(name) for name in group[:2])
    if apart[best] <= 0 or more > 50:
        return (
            f"No shot like these separates {names}: record other speeds and directions, also at right angles to these."
        )
    shot = _describe_shot(residuals, int(shot_information.shots[best]))
    return f"To separate {names}, record {max(more, 1)} more shot{'s' if more > 1 else ''} like {shot}."


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

    def over_typical(information: ShotInformation, name: str) -> float:
        """Return the smallest detectable strength of an effect over its typical one, in its worst direction."""
        mask = problem.mask((name,))
        signatures = compute_signatures(problem, information, free & ~mask, variance_factor)
        return float(np.max(signatures.detectable_strengths(mask)[mask] / usual[mask], initial=0.0))

    missed = {name: over_typical(shot_information, name) for name in names}
    missed = {name: times for name, times in missed.items() if times > 1}
    if not missed:
        return ""
    name = min(missed, key=lambda one: missed[one])
    if name == "saturation":  # of usual strength it ends just below the largest input
        return "This answer stands as it is. To look for saturation too, record larger inputs than these."
    for more in _REPETITIONS:
        shots = range(len(shot_information.shots))
        left = [over_typical(_add_repetitions(shot_information, k, more), name) for k in shots]
        if min(left) <= 1:
            like = _describe_shot(residuals, int(shot_information.shots[int(np.argmin(left))]))
            return (
                f"This answer stands as it is. To look for {format_cause(name)} too, which these shots would not have"
                f" shown at usual strength, record {more} more shot{'s' if more > 1 else ''} like {like}."
            )
    return (
        f"This answer stands as it is. To look for {format_cause(name)} of usual strength too, record much slower and"
        " much faster motion, and for longer; more shots like these would not reveal it."
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
    first = f"Most of the unexplained gap is {format_phase(most)}, in {place}: record that shot again at half the speed"
    if problem.scene.name == "mechanism":
        return f"{first}; what then stays the same does not depend on the speed."
    if residuals.reference.unit == "rad":
        return f"{first}, and once with the camera in another place; what changes with the camera comes from it."
    surroundings = "table" if problem.scene.name == "billiards" else "surroundings"
    return f"{first}, and once in another place; what stays with the place comes from the {surroundings} or the camera."


def _add_repetitions(shot_information: ShotInformation, k: int, more: int) -> ShotInformation:
    """Return the information if shot number k had been repeated `more` times."""
    times = 1.0 + more * (shot_information.shots == shot_information.shots[k])
    return replace(shot_information, information=shot_information.information * times[:, None, None])


def _describe_shot(residuals: FitResiduals, shot: int) -> str:
    """Describe a shot by its number and by the speed and direction of its fastest body."""
    here = np.flatnonzero(residuals.shot == shot)
    top = here[int(np.argmax(residuals.speed[here]))]
    fastest, velocity = f"up to {float(residuals.speed[top]):.1f} {residuals.reference.unit}/s", residuals.velocity[top]
    if len(velocity) < 2 or residuals.reference.unit != "m":
        return f"shot {shot} ({fastest})"
    angle = float(np.degrees(np.arctan2(velocity[1], velocity[0])))
    return f"shot {shot} ({fastest}, there at {round(angle)} degrees from x)"
