"""Sentences on what explains a whole shot: a published contact model, or how far the best one reaches."""

from __future__ import annotations

import math

from models.core.fit_result import Fit, WholeShotMisfit, WholeShotSolution
from models.core.naming import Naming, join_names
from models.core.number_format import format_moment
from pipeline.reporting.text.text_formatting import start_sentence

# Reason of a run without them.
NOT_ASKED = "Whether one published contact model explains the whole shot was not tested; trueroll run --laws tests it."


def format_law(name: str) -> str:
    """Format the name of a contact model for readers, such as "Han 2005" for `han_2005`."""
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


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
