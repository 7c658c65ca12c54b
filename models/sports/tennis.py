"""Tennis: ITF Rules of Tennis, rule 1 and appendices; lines belong to the area that they bound.

Drag and lift: Mehta and Pallis 2001, "The aerodynamics of a tennis ball": drag coefficients 0.5 to 0.65, lift to 0.3.
Bounces: Cross 2002, Am. J. Phys. 70, 1093, and the court pace rating of the ITF; topspin keeps more of the speed.
"""

from __future__ import annotations

from models.core.court import CourtLine, FlyingObject, Net, Range, Sport

LENGTH, WIDTH, PAINT, BASELINE_PAINT = 23.77, 10.97, 0.05, 0.10
HALF, MIDDLE, EDGE = LENGTH / 2, WIDTH / 2, PAINT / 2
# m: from the sides to the singles lines (outer edges), and from the net to the far edge of the service lines.
SINGLES, SERVICE = 1.372, 6.40
# m, length of the mark at the middle of a baseline.
CENTRE_MARK = 0.10

LINES = (
    CourtLine("near baseline", (BASELINE_PAINT / 2, 0.0), (BASELINE_PAINT / 2, WIDTH), BASELINE_PAINT),
    CourtLine("far baseline", (LENGTH - BASELINE_PAINT / 2, 0.0), (LENGTH - BASELINE_PAINT / 2, WIDTH), BASELINE_PAINT),
    CourtLine("left side line", (0.0, EDGE), (LENGTH, EDGE), PAINT),
    CourtLine("right side line", (0.0, WIDTH - EDGE), (LENGTH, WIDTH - EDGE), PAINT),
    CourtLine("left singles line", (0.0, SINGLES + EDGE), (LENGTH, SINGLES + EDGE), PAINT),
    CourtLine("right singles line", (0.0, WIDTH - SINGLES - EDGE), (LENGTH, WIDTH - SINGLES - EDGE), PAINT),
    CourtLine("near service line", (HALF - SERVICE + EDGE, SINGLES), (HALF - SERVICE + EDGE, WIDTH - SINGLES), PAINT),
    CourtLine("far service line", (HALF + SERVICE - EDGE, SINGLES), (HALF + SERVICE - EDGE, WIDTH - SINGLES), PAINT),
    CourtLine("centre service line", (HALF - SERVICE, MIDDLE), (HALF + SERVICE, MIDDLE), PAINT),
    CourtLine("near centre mark", (0.0, MIDDLE), (BASELINE_PAINT + CENTRE_MARK, MIDDLE), PAINT),
    CourtLine("far centre mark", (LENGTH - BASELINE_PAINT - CENTRE_MARK, MIDDLE), (LENGTH, MIDDLE), PAINT),
)
SPORT = Sport(
    "tennis",
    LENGTH,
    WIDTH,
    LINES,
    Net(0.914, 0.914, 1.07),
    FlyingObject(
        "ball", radius=0.0335, mass=0.0577, drag=Range(0.0205, 0.003), drag_exponent=Range(0.0, 0.05), lift=0.006,
        turn_drag=Range(0.0, 0.0), turn_length=0.0, restitution=Range(0.74, 0.07), retention=Range(0.75, 0.18),
        max_speed=75.0,
    ),
    areas={
        "singles": ((0.0, SINGLES, HALF, WIDTH - SINGLES), (HALF, SINGLES, LENGTH, WIDTH - SINGLES)),
        "doubles": ((0.0, 0.0, HALF, WIDTH), (HALF, 0.0, LENGTH, WIDTH)),
        "service-box": (
            (HALF - SERVICE, SINGLES, HALF, MIDDLE + EDGE),
            (HALF - SERVICE, MIDDLE - EDGE, HALF, WIDTH - SINGLES),
            (HALF, SINGLES, HALF + SERVICE, MIDDLE + EDGE),
            (HALF, MIDDLE - EDGE, HALF + SERVICE, WIDTH - SINGLES),
        ),
    },
    default_area="singles",
    reach=3.3,
    surroundings=(7.0, 4.5),
    bounce="optional",
)  # fmt: skip
