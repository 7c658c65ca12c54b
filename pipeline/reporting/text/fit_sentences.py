"""Sentences on a fit: which contact model explains the whole shot, and what a person set by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from models.core.corrections import BallPlace, ContactCorrection, Corrections, RallyCorrection, TrackEdit
from models.core.fit_result import Fit, MarkOutcome, WholeShotMisfit, WholeShotSolution
from models.core.naming import Naming, build_naming, join_names
from models.core.number_format import format_moment, format_time
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.hand_marks.resolved_marks import update_ball_names
from pipeline.reporting.text.text_formatting import format_law, start_sentence
from video.io.video_options import BILLIARDS

# Reason of a run without a fit of contact models.
NOT_ASKED = "Contact models for the whole shot were not compared, so that side spin is not known."
# Beginning of a note on what a person corrected.
HAND_PREFIX = "set by hand: "
RALLY_EVENTS = {"hit": "hit", "bounce": "bounce", "net": "touch of the net", "landing": "landing"}


def note_corrections(scene: Scene, corrections: Corrections, tracks: Tracks) -> Scene:
    """Add notes on what was set by hand to a scene, with the present names of the balls.

    Args:
        scene: Table and camera.
        corrections: What a person corrected.
        tracks: Tracks of the balls.

    Returns:
        The scene with one more note per correction.
    """
    naming = build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)
    notes = (HAND_PREFIX + phrase for phrase in format_corrections(update_ball_names(corrections, tracks), naming))
    return replace(scene, notes=(*scene.notes, *notes))


def format_corrections(corrections: Corrections, naming: Naming) -> tuple[str, ...]:
    """Format all corrections, each as a phrase; empty where nothing was set by hand."""
    surface = "table" if corrections.sport in (None, BILLIARDS) else "court"
    settings = {
        f"the corners of the {surface}": corrections.corners,
        f"the sport, {corrections.sport}": corrections.sport,
        f"the table, {corrections.table}": corrections.table,
        f"the ball radius, {1000 * (corrections.ball_radius or 0):g} mm": corrections.ball_radius,
        f"the frame rate, {corrections.fps} frames per second": corrections.fps,
    }
    marks = [
        f"{'a missed ball' if mark.kind == 'placed' else 'what is no ball'}, {_format_place(mark.ball)}"
        for mark in corrections.balls
    ]
    edits = [_format_track_edit(edit, naming) for edit in corrections.tracks]
    contacts = [_format_contact_mark(mark, naming) for mark in corrections.contacts]
    contacts += [_format_mark(mark, RALLY_EVENTS[mark.event]) for mark in corrections.events]
    return (*(what for what, value in settings.items() if value is not None), *marks, *edits, *contacts)


def format_outcomes(outcomes: Sequence[MarkOutcome], naming: Naming) -> tuple[str, ...]:
    """Format where the motion contradicts what was set by hand, with one sentence per contradiction."""
    return tuple(sentence for one in outcomes if (sentence := _format_outcome(one, naming)))


def format_recomputed(folder: str, stages: Sequence[str]) -> str:
    """Format that the editor of a run starts with other events than its folder holds.

    Args:
        folder: The run folder.
        stages: Stages that were not cached.

    Returns:
        Sentences.
    """
    how = f"Ran again: {', '.join(stages)}" if stages else "They come from the cache"
    return (
        f"These events differ from those in {folder}: its options, its corrections or the program have changed. {how}."
        " The folder stays as it is until you correct something; video and report stay until you update them."
    )


def _format_track_edit(edit: TrackEdit, naming: Naming) -> str:
    """Format an edit of tracks as a phrase."""
    ball, place = naming.say(edit.ball.id) or "a ball", _format_place(edit.ball)
    other = (edit.other and naming.say(edit.other.id)) or "another ball"
    span = f"frames {edit.first or 0} to {'the last' if edit.last is None else edit.last}"
    return {
        "rename": f"the name {edit.name} of {ball}, {place}",
        "class": f"the ball class {edit.name} of {ball}, {place}",
        "merge": f"{ball} and {other} are one ball",
        "split": f"{ball} is another ball from frame {edit.first} on",
        "swap": f"{ball} and {other} are exchanged in {span}",
    }[edit.kind]


def _format_contact_mark(mark: ContactCorrection, naming: Naming) -> str:
    """Format a mark of a contact as a phrase."""
    other = "" if mark.other is None else naming.say(mark.other.id) or "another ball"
    return _format_mark(mark, _name_contact(naming.say(mark.ball.id) or "a ball", other or naming.say(mark.cushion)))


def _format_mark(mark: ContactCorrection | RallyCorrection, what: str) -> str:
    """Format a mark of an event, whose name is given, as a phrase."""
    return {
        "mark": f"{what} at frame {mark.frame:.1f}",
        "move": f"{what} at frame {mark.to_frame or 0:.1f}, not {mark.frame:.1f}",
        "delete": f"no {what} at frame {mark.frame:.1f}",
    }[mark.kind]


def _format_outcome(outcome: MarkOutcome, naming: Naming) -> str:
    """Format the outcome of a mark as a sentence; empty where the motion agrees."""
    names = (*map(naming.say, (*outcome.balls, outcome.cushion)), "", "")
    what = f"{_name_contact(names[0] or 'a ball', names[1])} at {format_time(outcome.t)}"
    what = f"The {what} {'was deleted' if outcome.kind == 'delete' else 'was set'} by hand"
    return {
        "confirmed": "",
        "no_change": f"{what}, but the fitted motion shows no change there.",
        "change_remains": f"{what}, but the motion changes there nevertheless, without a known cause.",
        "other_time": f"{what}, but the motion puts it {1000 * abs(outcome.value):.0f} ms"
        f" {'later' if outcome.value > 0 else 'earlier'}.",
        "too_far": f"{what}, but the surfaces are {1000 * outcome.value:.0f} mm apart there.",
        "ball_missing": f"{what}, but a ball of it is not tracked there.",
    }[outcome.code]


def _name_contact(ball: str, other: str) -> str:
    """Name a contact."""
    return f"contact of {ball} and {other}" if other else f"strike of {ball}"


def _format_place(place: BallPlace) -> str:
    return f"at {place.x_px:.0f}, {place.y_px:.0f} px in frame {place.frame}"


def format_whole_shot(fit: Fit) -> str:
    """Format what explains the whole shot.

    Args:
        fit: Fit of a shot.

    Returns:
        Sentences with the contact model, and the deviation from it over the measurement noise; or the reason why no
        model was fitted.
    """
    if fit.laws is None:
        return NOT_ASKED
    if fit.whole_shot is not None:
        return _format_solution(fit.whole_shot)
    return fit.laws.refusal if fit.laws.misfit is None else _format_misfit(fit.laws.misfit, fit.naming)


def _format_solution(solution: WholeShotSolution) -> str:
    """Format which contact models explain a shot."""
    noise = f"to {math.sqrt(solution.chi2_per_dof):.1f} times the measurement noise."
    sentences = [f"{format_law(solution.cushion_model)} explains the shot {noise}"]
    if solution.equal_models:
        one = len(solution.equal_models) == 1
        names = join_names(map(format_law, solution.equal_models))
        sentences.append(f"{names} explain{'s' if one else ''} it equally well: the shot does not decide between them.")
    return " ".join(sentences)


def _format_misfit(misfit: WholeShotMisfit, naming: Naming) -> str:
    """Format how far the best contact model explains a shot, and the first contact that it does not explain."""
    amount = f"{1000 * misfit.deviation:.1f} mm (RMS), {misfit.times_noise:.1f} times the measurement noise"
    ball, other = naming.say(misfit.ball), naming.say(misfit.other)
    pair = f"that of {ball} and {other}"
    contact = {"strike": f"the strike of {ball}", "ball": pair, "cushion": pair}.get(misfit.contact)
    where = (
        f"{ball} then deviates from it by {amount}"
        if contact is None
        else f"The first contact whose outcome it does not explain is {contact} at {format_moment(misfit.t)}:"
        f" {ball} deviates by {amount}"
    )
    sentences = [
        "No published contact model explains the whole shot.",
        f"{format_law(misfit.cushion_model)} explains all positions until {format_moment(misfit.explained_until)}.",
        f"{start_sentence(where)}.",
        f"Over the whole shot, the best model leaves {misfit.whole_times_noise:.1f} times the noise.",
    ]
    return " ".join(sentences)
