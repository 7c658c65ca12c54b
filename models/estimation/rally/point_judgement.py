"""Who won the last point of a rally, and how sure that is."""

from __future__ import annotations

import math

from scipy.special import ndtr

from models.core.rally import LandingHypothesis, Rally
from models.estimation.rally.landing_judgement import INDIFFERENT, LEAST_SIGMA, LandingCall, find_last_hit


def name_half(rally: Rally, landing: LandingHypothesis) -> str:
    """Name the half of the court in which a landing lies."""
    return rally.scene.sport.halves[int(landing.place[0] > rally.scene.sport.length / 2)]


def judge_point(rally: Rally, call: LandingCall) -> tuple[str, float]:
    """Judge who won the point that a landing ends.

    The probability contains those of the landing and of the hit before it. A ball that rolls on one half of a table
    was not returned from there, or did not cross the net from there: whoever hit it last, that player has lost.

    Returns:
        The half of the more probable winner, empty where that is not known, and the probability of this winner. It is
        decided from `SURE_PROBABILITY` on, and nothing is where the law of flight explains too little.
    """
    sport, landing = rally.scene.sport, call.landing
    if landing is not None and landing.is_rolling:
        sigma = max(math.sqrt(float(landing.covariance[0, 0])), LEAST_SIGMA)
        far = float(ndtr((landing.place[0] - sport.length / 2) / sigma))
        return sport.halves[int(far < INDIFFERENT)], landing.weight * max(far, 1 - far)
    hit = find_last_hit(rally, math.inf if landing is None else landing.t)
    if hit is None or not hit.player:
        return "", 0.0
    other = sport.halves[1 - sport.halves.index(hit.player)]
    if call.probability >= call.out_probability:
        return hit.player, call.probability
    return other, call.out_probability
