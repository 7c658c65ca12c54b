"""Badminton: BWF Statutes, section 4.1 (Laws of Badminton); lines of 40 mm belong to the area that they bound.

The drag is that of a terminal speed of 6.8 m/s (Chen, Pan and Chen 2009, J. Sports Sci. Med. 8, 643; 6.51 to 6.87 m/s);
the turn-over after a hit takes 20 to 30 ms at 50 m/s, changes the drag and pushes the shuttle aside by about a third of
the drag; its swinging dies down over two to three metres (Cohen et al. 2015, New J. Phys. 17, 063001). How much larger
the drag gets is known of two kinds of shuttles that disagree: filmed flights want 0.7 (`benchmarks.shuttle_flights`), a
nose that turns as stated there and has 1.8 times the drag across the path gives 2. `TURN_DRAG` is what they tell of a
third kind. While they turn over, simulated flights depart from the law by 1 to 2 cm, filmed ones by 1 cm: `turn_error`.
"""

from __future__ import annotations

from models.core.court import CourtLine, FlyingObject, Net, Range, Sport

LENGTH, WIDTH, PAINT = 13.40, 6.10, 0.04
HALF, MIDDLE = LENGTH / 2, WIDTH / 2
# m: from the net to the far edge of the short service line; from the ends to the inner long service lines, and from
# the sides to the singles lines, both to the outer edges of these.
SHORT_SERVICE, LONG_SERVICE, SINGLES = 1.98, 0.76, 0.46


def _across(name: str, x: float) -> CourtLine:
    return CourtLine(name, (x, 0.0), (x, WIDTH), PAINT)


def _along(name: str, y: float) -> CourtLine:
    return CourtLine(name, (0.0, y), (LENGTH, y), PAINT)


EDGE = PAINT / 2
LINES = (
    _across("near end line", EDGE),
    _across("far end line", LENGTH - EDGE),
    _along("left side line", EDGE),
    _along("right side line", WIDTH - EDGE),
    _along("left singles line", SINGLES + EDGE),
    _along("right singles line", WIDTH - SINGLES - EDGE),
    _across("near long service line", LONG_SERVICE + EDGE),
    _across("far long service line", LENGTH - LONG_SERVICE - EDGE),
    _across("near short service line", HALF - SHORT_SERVICE - EDGE),
    _across("far short service line", HALF + SHORT_SERVICE + EDGE),
    CourtLine("near centre line", (0.0, MIDDLE), (HALF - SHORT_SERVICE, MIDDLE), PAINT),
    CourtLine("far centre line", (HALF + SHORT_SERVICE, MIDDLE), (LENGTH, MIDDLE), PAINT),
)
# The turn-over drag of a third kind of shuttle, after two: 0.7 of filmed ones, 2 of a simulator. Its standard deviation
# is their difference over sqrt(2), times sqrt(1 + 1/2).
TURN_DRAG = Range(1.4, 1.1)
SPORT = Sport(
    "badminton",
    LENGTH,
    WIDTH,
    LINES,
    Net(0.0, 1.524, 1.55),
    FlyingObject(
        "shuttle", radius=0.033, mass=0.0052, drag=Range(0.208, 0.02), drag_exponent=Range(-0.05, 0.05), lift=0.06,
        turn_drag=TURN_DRAG, turn_length=2.5, restitution=None, retention=None, max_speed=120.0, turn_error=0.02,
        lag_lift=0.03,
    ),
    areas={
        "singles": ((0.0, SINGLES, HALF, WIDTH - SINGLES), (HALF, SINGLES, LENGTH, WIDTH - SINGLES)),
        "doubles": ((0.0, 0.0, HALF, WIDTH), (HALF, 0.0, LENGTH, WIDTH)),
        "service-box": (
            (0.0, SINGLES, HALF - SHORT_SERVICE, MIDDLE + EDGE),
            (0.0, MIDDLE - EDGE, HALF - SHORT_SERVICE, WIDTH - SINGLES),
            (HALF + SHORT_SERVICE, SINGLES, LENGTH, MIDDLE + EDGE),
            (HALF + SHORT_SERVICE, MIDDLE - EDGE, LENGTH, WIDTH - SINGLES),
        ),
    },
    default_area="singles",
    reach=3.3,
)  # fmt: skip
