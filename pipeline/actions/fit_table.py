"""Learn one table from all shots of run folders and track folders, and write its profile.

The fit of each shot is cached, so that a second call resumes.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from models.core.answer import Answer, Quantity
from models.core.contact_graph import JointSolution
from models.core.errors import OptionError, TrackError, TruerollError
from models.core.fit_result import Parameter
from models.core.number_format import format_measured
from models.core.scene import CUSHIONS, Table
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.estimation.forecast.solution_state import MIN_NOISE_SPEED
from models.estimation.table_learning.learn_table import TableLesson, learn_table
from models.estimation.table_learning.learned_table import fit_restitution_formula
from models.numerics.executor import Executor
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.effects.billiards_catalogue import find_prior
from models.tracking.track_noise import apply_noise, estimate_noise
from pipeline.engine.result_cache import ResultCache
from pipeline.io.kept_values import load_shot
from pipeline.io.observed_shot import list_shot_numbers, read_observed_shot
from pipeline.io.profile_export import build_pooltool_parameters, describe_physics
from pipeline.io.run_folder import drop_repeated_clips
from pipeline.io.saved_shot import has_shot
from pipeline.io.strict_json import write_json
from pipeline.io.table_profile import SIZE_TOLERANCE
from pipeline.io.view_profile import collect_views
from pipeline.reporting.pages.certificate_page import write_cushion_page

# Shots that are shared out between processes before the next message; one takes about a second.
_SHOTS_TOGETHER = 6


@dataclass(frozen=True, slots=True)
class FittedTable:
    """What was learned, the table's size, and the shots that could not be used."""

    lesson: TableLesson
    table: Table
    shot_count: int
    refusals: tuple[str, ...]
    """One sentence per shot that could not be used."""
    fits: tuple[tuple[JointSolution, Tracks], ...] = ()
    """Joint fit and tracks of every shot that was used."""
    names: tuple[str, ...] = ()
    """Folder and number of these shots."""
    sources: tuple[Path, ...] = ()
    """Their folders, each clip once."""


def fit_table_of_shots(
    sources: list[Path], cache: ResultCache, executor: Executor, on_activity: Callable[[str], None]
) -> FittedTable:
    """Fit every shot, and learn the table from all of them.

    Args:
        sources: Run folders, track folders, or their tracks.csv.
        cache: Holds the fits of shots.
        executor: Distributes fits and learning over processes.
        on_activity: Called with what is done next.

    Returns:
        The learned table.

    Raises:
        OptionError: No source can be read, or the tables differ.
        TrackError: The shots are too few.
    """
    shots, refusals = _list_shots(sources)
    table = _require_one_table(shots, refusals)
    sources, repetitions = drop_repeated_clips(sources)
    if repetitions:
        shots, refusals = _list_shots(sources)
    refusals = [*repetitions, *refusals]
    fits, names = [], []
    for begin in range(0, len(shots), _SHOTS_TOGETHER):
        together = shots[begin : begin + _SHOTS_TOGETHER]
        on_activity(f"fitting shots {begin + 1} to {begin + len(together)} of {len(shots)}")
        outcomes = executor.map_tasks(cache, _fit_shot, [(source, number) for _, source, number, _ in together])
        for (name, *_), fit in zip(together, outcomes, strict=True):
            if isinstance(fit, str):
                refusals.append(f"{name}: {fit}")
            else:
                fits.append(fit)
                names.append(name)
    on_activity("learning the table")
    if not fits:
        raise TrackError(f"physics could be fitted to none of the shots; {refusals[0]}")
    try:
        lesson = learn_table(fits, table, executor=executor)
    except TrackError as error:
        raise TrackError("; ".join([str(error), *repetitions])) from error
    return FittedTable(lesson, table, len(fits), tuple(refusals), tuple(fits), tuple(names), tuple(sources))


def learn_table_profile(
    sources: list[Path], path: Path, cache: ResultCache, executor: Executor, on_activity: Callable[[str], None]
) -> Answer:
    """Learn a table from its shots, and write its profile, its file for pooltool and the page of its cushions.

    Args:
        sources: Run folders, track folders, or their tracks.csv.
        path: The profile to write.
        cache: Holds the fits of shots.
        executor: Distributes fits and learning over processes.
        on_activity: Called with what is done next.

    Returns:
        What the table does.

    Raises:
        OptionError: No source can be read, or the tables differ.
        TrackError: The shots are too few.
    """
    fitted = fit_table_of_shots(sources, cache, executor, on_activity)
    lesson, page = fitted.lesson, path.with_suffix(".html")
    left_out = write_learned_profile(lesson, fitted.table, fitted.shot_count, path, collect_views(sources))
    write_cushion_page(lesson.table, fitted.table, page)
    (best, evidence), *others = lesson.candidates
    lead = f", {evidence - others[0][1]:.0f} ahead in log evidence" if others else ""
    rows = [
        (one.name, *format_measured(one.value, one.sigma), one.unit, "not identifiable: the prior" * one.prior_only)
        for one in lesson.parameters
    ]
    return Answer(
        "What does this table do?",
        (f"{fitted.shot_count} shots with {lesson.contact_count} cushion contacts: cushion model {best}{lead}.",),
        quantities=tuple(Quantity(one.name, one.value, one.sigma, one.unit) for one in lesson.parameters),
        rows=(("parameter", "value", "sigma", "unit", ""), *rows),
        notes=(
            *_format_lesson(fitted),
            *(f"Note: {refusal}." for refusal in fitted.refusals),
            f"{name_pooltool_file(path)} holds the table for pooltool, which has no {', no '.join(left_out)}.",
            f"The next prediction on this table can start from it: trueroll predict DIR --profile {path}",
        ),
        document={"profile": str(path), "refused": list(fitted.refusals), **json.loads(path.read_text())},
        figures=(str(page),),
    )


def _format_lesson(fitted: FittedTable) -> tuple[str, str, str]:
    """Format how contacts scatter, what a network corrects, and a short formula of the restitution."""
    lesson, learned, table = fitted.lesson, fitted.lesson.table, fitted.table
    scatter = learned.scatter
    if lesson.correction_gain is None:
        network = "Too few cushion contacts to train a correction of the cushion model."
    else:
        network = (
            f"On shots that it has not seen, a network removes {lesson.correction_gain:.0%} of the squared deviation"
            f" from the cushion model: switched {'on' if len(learned.correction) else 'off'}."
        )
    formula = fit_restitution_formula(learned, table.ball_radius, table.ball_mass)
    verdict = "does as well" if formula.misfit <= scatter.velocity else "does not do as well"
    return (
        f"Cushions scatter about the model by {scatter.velocity:.1%} of the speed (slip {scatter.slip:.1%},"
        f" side spin {scatter.side_spin:.1%}).",
        network,
        f"Restitution {formula.factor:.3f} v^{-formula.power:+.3f} (v into the cushion in m/s) {verdict}: it deviates"
        f" from the learned cushion by {formula.misfit:.1%} of the speed, contacts scatter by {scatter.velocity:.1%}.",
    )


# A shot of a session: name for messages, folder, number, table.
ListedShot = tuple[str, Path, int, Table]


def _list_shots(sources: list[Path]) -> tuple[list[ListedShot], list[str]]:
    """List all shots; also return one sentence per source or shot that cannot be read, and per assumption."""
    shots: list[ListedShot] = []
    refusals = []
    for source in sources:
        try:
            numbers = list_shot_numbers(source)
        except OptionError as error:
            refusals.append(str(error))
            continue
        for number in numbers:
            try:
                _, scene, _ = read_observed_shot(source, number)
            except OptionError as error:
                refusals.append(f"shot {number}: {error}")
            else:
                shots.append((f"{source}, shot {number}", source, number, scene.table))
                refusals += [note for note in scene.notes if not has_shot(source) and note not in refusals]
    return shots, refusals


def _require_one_table(shots: list[ListedShot], refusals: list[str]) -> Table:
    """Return the table of all shots."""
    if not shots:
        raise OptionError(refusals[0] if refusals else "no shot was given: the tracks have no rows")
    first = shots[0][3]
    for name, _, _, table in shots:
        sizes = np.array([table.length, table.width, table.ball_radius])
        if np.any(np.abs(sizes / [first.length, first.width, first.ball_radius] - 1) > SIZE_TOLERANCE):
            raise OptionError(
                f"one table is learned at a time; {name} is {sizes[0]:g} x {sizes[1]:g} m, the first one"
                f" {first.length:g} x {first.width:g} m"
            )
    return first


def _fit_shot(cache: ResultCache, source: Path, number: int) -> tuple[JointSolution, Tracks] | str:
    """Fit a shot or read its kept fit; return it as `prepare_shot` does, or why it could not be fitted."""
    try:
        return prepare_shot(load_shot(source, number, cache))
    except (TruerollError, ArithmeticError, ValueError) as error:
        return str(error)


def prepare_shot(shot: Shot) -> tuple[JointSolution, Tracks]:
    """Give the tracks of a shot capture times and realistic sigmas, as `learn_table` needs them.

    Returns:
        Joint solution and tracks, both at capture times.

    Raises:
        TrackError: Physics could not be fitted.
    """
    if shot.solution is None:
        raise TrackError("physics could not be fitted")
    captured = shot.capture_tracks
    noise = estimate_noise(captured, MIN_NOISE_SPEED, shot.scene.table.ball_radius)
    return shot.solution, apply_noise(captured, noise)


# Properties of a learned table that pooltool does not have.
_LEARNED_ONLY = ("offsets of the noses", "scatter of cushion contacts")
# Ball model of predictions on a learned table.
LEARNED_BALL_MODEL = "alciatore"


def write_learned_profile(
    lesson: TableLesson, table: Table, shot_count: int, path: Path, views: Mapping[str, Any] = MappingProxyType({})
) -> tuple[str, ...]:
    """Write the profile of a learned table and, beside it, what pooltool can hold of it, each in one step.

    Args:
        lesson: What was learned.
        shot_count: Number of shots that taught it.
        path: The file.
        views: View, cloth and balls of the shots, of `collect_views`.

    Returns:
        What pooltool cannot hold.
    """
    learned = lesson.table
    content = describe_physics(lesson.parameters, learned.cushion_law, LEARNED_BALL_MODEL, table) | {
        "scatter": asdict(learned.scatter),
        "noses": {
            side: {"value": float(value), "sigma": float(sigma), "unit": "m"}
            for side, value, sigma in zip(CUSHIONS, learned.noses, learned.nose_sigma, strict=True)
        },
        "covariance": {
            "parameters": [PARAMETER_NAMES[k] for k in learned.uncertain],
            "matrix": learned.covariance.tolist(),
            "noses": learned.nose_covariance.tolist(),
        },
        "learned_from": {"shots": shot_count, "cushion_contacts": lesson.contact_count},
        "correction": {"gain": lesson.correction_gain, "weights": learned.correction.tolist()},
        "cushion_models": [{"name": name, "log_evidence": value} for name, value in lesson.candidates],
        **views,
    }
    e = find_prior("ball_restitution", "e")  # as in predictions on a learned table
    usual = Parameter("ball_restitution.e", e.value, e.sigma, e.unit, True)
    exported = build_pooltool_parameters((*lesson.parameters, usual), learned.cushion_law, LEARNED_BALL_MODEL, table)
    corrected = ("correction of the cushion model",) if len(learned.correction) else ()
    exported["not_held"] = sorted({*exported["not_held"], *_LEARNED_ONLY, *corrected})
    write_json(content, path)
    write_json(exported, name_pooltool_file(path))
    return tuple(exported["not_held"])


def name_pooltool_file(path: Path) -> Path:
    """Name the file of pooltool's parameters beside a profile, such as club.pooltool.json beside club.json."""
    return path.with_name(f"{path.stem}.pooltool.json")
