"""How far a landing is from a line, in words: the same on the page, in answers and in images."""

from __future__ import annotations

from models.core.number_format import format_with_sigma
from models.estimation.rally.landing_judgement import LandingCall, LineDistance

# m up to which a distance is written in cm, if its error is not larger either.
LONG_DISTANCE = 1.0


def format_margin(call: LandingCall) -> str:
    """Format how far on which side of the nearest line a landing is; empty without a landing."""
    if call.landing is None:
        return ""
    return format_line_distance(LineDistance(call.line, call.distance, call.distance_sigma))


def format_line_distance(one: LineDistance) -> str:
    """Format how far on which side of a line a landing is."""
    distance = format_distance(one.distance, one.sigma)
    if one.line == "net":
        return f"{distance} {'beyond' if one.distance >= 0 else 'short of'} the net"
    side = "inside" if one.distance >= 0 else "beyond"
    return f"{distance} {side} the outer edge of {f'the {one.line}' if one.line else 'the line'}"


def format_distance(distance: float, sigma: float) -> str:
    """Format a distance, m, without its sign: in cm up to `LONG_DISTANCE`."""
    scale, unit = (100, "cm") if max(abs(distance), sigma) < LONG_DISTANCE else (1, "m")
    return f"{format_with_sigma(scale * abs(distance), scale * sigma)} {unit}"
