"""Trust level of a run: that of its fit, reduced if the clip is incomplete or the explanation leaves events open."""

from __future__ import annotations

from collections.abc import Sequence

from models.core.fit_result import Fit, Trust
from models.core.shot import Note
from models.core.shot_explanation import CauseHypothesis, Moment, ShotExplanation
from pipeline.reporting.text.correction_sentences import format_outcomes
from pipeline.reporting.text.text_formatting import is_undecided

DECIDING_CAUSES = ("strike", "ball", "pocket")
"""Causes that the course of a shot depends on: a run with such an undecided one is not green."""
MAX_NAMED = 3
"""Undecided events that the trust level names."""
SAME_TIME = 0.05
"""s between two moments of the same event: a contact may be a moment of either ball."""


def assess_run_trust(notes: Sequence[Note], fit: Fit) -> Trust:
    """Assess the trust level of a run.

    Args:
        notes: Notes of the shot.
        fit: Its views, with the trust level of the fit.

    Returns:
        The trust level of the fit; at most amber if the clip is incomplete, because its later part is missing, or if
        strikes, contacts of balls or pocketed balls are undecided, or if the motion contradicts what was set by hand.
    """
    before = tuple(f"The clip is incomplete: {note.detail}." for note in notes if note.code == "incomplete_clip")
    after = (*format_outcomes(fit.mark_outcomes), *_format_undecided(fit.explanation))
    if not before and not after:
        return fit.trust
    level = "amber" if fit.trust.level == "green" else fit.trust.level
    return Trust(level, (*before, *fit.trust.reasons, *after))


def _format_undecided(explanation: ShotExplanation) -> tuple[str, ...]:
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
    return (f"Undecided: {', '.join(_format_possible_event(*entry) for entry in entries[:MAX_NAMED])}{more}.",)


def _is_same_event(one: tuple[Moment, CauseHypothesis], two: tuple[Moment, CauseHypothesis]) -> bool:
    """Return whether two moments stand for the same event."""
    bodies = [{moment.ball, hypothesis.other, hypothesis.cause} for moment, hypothesis in (one, two)]
    return bodies[0] == bodies[1] and abs(one[0].t - two[0].t) < SAME_TIME


def _format_possible_event(moment: Moment, hypothesis: CauseHypothesis) -> str:
    """Format an event that may have happened, with its probability."""
    what = {
        "strike": f"{moment.ball} was struck",
        "ball": f"{moment.ball} touched {hypothesis.other}",
        "pocket": f"{moment.ball} fell into the {hypothesis.other} pocket",
    }[hypothesis.cause]
    return f"{what} at {moment.t:.2f} s ({100 * hypothesis.probability:.0f} %)"
