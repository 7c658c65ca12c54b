"""All views of the shot of a run, as its outputs show them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from models.core.errors import OptionError
from models.core.fit_result import CauseHypothesis, Fit, Moment, ShotExplanation, Trust, WholeShotFit, is_undecided
from models.core.naming import Naming
from models.core.number_format import format_probability, format_time
from models.core.options import FitOptions
from models.core.shot import Note, Shot
from models.estimation.contact_test.contact_motion import ClothPriors
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.joint_fit.trust_level import add_warnings
from models.estimation.reconstruction.explain_shot import list_close_passes
from models.estimation.reconstruction.plausibility import DECELERATION_RANGE, USUAL_DECELERATION
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.shot_numbers.measure_shots import add_shot_numbers
from pipeline.engine.stage import Inputs
from pipeline.io.saved_shot import read_shot
from pipeline.io.view_profile import list_profile_misfits
from pipeline.reporting.text.fit_sentences import format_outcomes
from pipeline.reporting.text.text_formatting import format_meeting

# Shots whose views are kept in memory: a command reads one, and compares it with few.
_KEPT_VIEWS = 4


@lru_cache(_KEPT_VIEWS)
def view_run(shot: Shot, laws: WholeShotFit | None = None, profile: str = "") -> Fit:
    """Evaluate the views of a shot with everything that a run adds.

    Args:
        laws: What published contact models make of it, where somebody asked for them.
        profile: Content of the table profile, JSON; empty for none.

    Returns:
        The views, with numbers for players and the trust level of the run.
    """
    fit = replace(view_shot(shot), laws=laws)
    fit = replace(fit, profile_misfits=list_profile_misfits(profile, shot.scene.cloth_lab, fit.parameters))
    fit = add_shot_numbers(fit, shot.solution, shot.tracks, shot.scene.table)
    return replace(fit, trust=assess_run_trust(shot.notes, fit))


# Causes that the course of a shot depends on: a run with such an undecided one is not green.
DECIDING_CAUSES = ("strike", "ball", "pocket")
# Undecided events that the trust level names.
MAX_NAMED = 3
# s between two moments of the same event: a contact may be a moment of either ball.
SAME_TIME = 0.05


def assess_run_trust(notes: Sequence[Note], fit: Fit) -> Trust:
    """Assess the trust level of a run.

    Args:
        notes: Notes of the shot.
        fit: Its views, with the trust level of the fit.

    Returns:
        The trust level of the fit; at most amber if the clip is incomplete, because its later part is missing, or if
        strikes, contacts of balls or pocketed balls are undecided, or if the motion contradicts what was set by hand.
    """
    before = (
        *(f"The clip is incomplete: {note.detail}." for note in notes if note.code == "incomplete_clip"),
        *(_format_deceleration(float(note.detail)) for note in notes if note.code == "implausible_deceleration"),
    )
    after = (*format_outcomes(fit.mark_outcomes, fit.naming), *_format_undecided(fit.explanation, fit.naming))
    return add_warnings(fit.trust, (*before, *after))


def _format_deceleration(value: float) -> str:
    """Format the doubt in the frame rate that an impossible deceleration (m/s^2) of rolling balls gives."""
    low, high = DECELERATION_RANGE
    factor = math.sqrt(USUAL_DECELERATION / value) if value > 0 else math.inf
    agreeing = f" ({factor:.1f} times the stated one would agree)" if math.isfinite(factor) else ""
    return (
        f"Rolling balls slow down by {value:.2g} m/s², where {low:g} to {high:g} are usual on every table that fits:"
        f" the frame rate or the size of the table is wrong. If you know the rate{agreeing}, run it again with that."
    )


def _format_undecided(explanation: ShotExplanation, naming: Naming) -> tuple[str, ...]:
    """Format the undecided strikes, contacts of balls and pocketed balls as a sentence, the least certain first."""
    entries: list[tuple[Moment, CauseHypothesis]] = []
    for moment in explanation.moments:
        for one in moment.hypotheses:
            if one.cause in DECIDING_CAUSES and is_undecided(one.probability):
                is_listed = any(_is_same_event(entry, (moment, one)) for entry in entries)
                entries += [] if is_listed else [(moment, one)]
    entries.sort(key=lambda entry: (abs(entry[1].probability - 0.5), entry[0].t))
    if not entries:
        return ()
    more = f" and {len(entries) - MAX_NAMED} more" if len(entries) > MAX_NAMED else ""
    return (f"Undecided: {', '.join(_format_possible_event(*entry, naming) for entry in entries[:MAX_NAMED])}{more}.",)


def _is_same_event(one: tuple[Moment, CauseHypothesis], two: tuple[Moment, CauseHypothesis]) -> bool:
    """Return whether two moments stand for the same event."""
    bodies = [{moment.ball, hypothesis.other, hypothesis.cause} for moment, hypothesis in (one, two)]
    return bodies[0] == bodies[1] and abs(one[0].t - two[0].t) < SAME_TIME


def _format_possible_event(moment: Moment, hypothesis: CauseHypothesis, naming: Naming) -> str:
    """Format an event that may have happened, with its probability."""
    what = format_meeting(hypothesis.cause, hypothesis.other, naming)
    when = format_time(moment.t, moment.t_sigma)
    return f"{naming.say(moment.ball)} {what} at {when} ({format_probability(hypothesis.probability)})"


def read_shot_record(folder: Path, cloth: ClothPriors | None = None) -> ShotRecord:
    """Record the saved shot of a run folder.

    Args:
        folder: Run folder.
        cloth: What is known about the friction of the cloth, with which close passes are tested again; None for what
            the shot was explained with.

    Returns:
        Observations and fitted motion of the N balls.

    Raises:
        OptionError: The folder is missing, or nothing in it moves.
    """
    if not folder.is_dir():
        raise OptionError(f"A run folder was expected; {folder} is none. Run the clip first: trueroll run CLIP")
    shot = read_shot(folder)
    return record_shot(shot if cloth is None else replace(shot, passes=list_close_passes(shot, cloth)), folder)


def record_shot(shot: Shot, folder: Path) -> ShotRecord:
    """Record a saved shot; raises OptionError, which names its run folder, where nothing moves."""
    fit, scene = view_run(shot), shot.scene
    if not len(fit.trajectory.start):
        raise OptionError(f"{folder} holds no motion of a ball; run a clip in which balls move")
    return make_shot_record(shot.tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)


def list_view_inputs(options: FitOptions) -> tuple[str, ...]:
    """List the stages that `view_inputs` needs.

    Args:
        options: Options of the explanation.

    Returns:
        Names of stages.
    """
    return ("explain", "laws") if options.laws else ("explain",)


def view_inputs(inputs: Inputs, options: FitOptions) -> Fit:
    """Evaluate the views of a shot.

    Args:
        inputs: Inputs of a stage, with those of `list_view_inputs`.
        options: Options of the explanation.

    Returns:
        The views.
    """
    return view_run(inputs["explain"], inputs.get("laws"), options.profile)
