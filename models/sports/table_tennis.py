"""Table tennis: ITTF Laws, section 2.1 and 2.2; the white lines belong to the surface.

Drag and lift: Inaba et al. 2017, Int. J. Sports Sci. Coaching 12; drag coefficient 0.4 to 0.5, lift up to 0.3. Bounces:
restitution 0.75 to 0.93, higher for slow balls; topspin may speed a ball up along the table.
"""

from __future__ import annotations

from models.core.court import CourtLine, FlyingObject, Net, Range, Sport

LENGTH, WIDTH, PAINT, CENTRE_PAINT, HEIGHT = 2.74, 1.525, 0.02, 0.003, 0.76
HALF, EDGE = LENGTH / 2, PAINT / 2

LINES = (
    CourtLine("left end line", (EDGE, 0.0), (EDGE, WIDTH), PAINT),
    CourtLine("right end line", (LENGTH - EDGE, 0.0), (LENGTH - EDGE, WIDTH), PAINT),
    CourtLine("near side line", (0.0, EDGE), (LENGTH, EDGE), PAINT),
    CourtLine("far side line", (0.0, WIDTH - EDGE), (LENGTH, WIDTH - EDGE), PAINT),
    CourtLine("centre line", (0.0, WIDTH / 2), (LENGTH, WIDTH / 2), CENTRE_PAINT),
)
HALVES = ((0.0, 0.0, HALF, WIDTH), (HALF, 0.0, LENGTH, WIDTH))
SPORT = Sport(
    "table-tennis",
    LENGTH,
    WIDTH,
    LINES,
    Net(0.1525, 0.1525, 0.1525),
    FlyingObject(
        "ball", radius=0.020, mass=0.0027, drag=Range(0.126, 0.02), drag_exponent=Range(0.0, 0.05), lift=0.06,
        turn_drag=Range(0.0, 0.0), turn_length=0.0, restitution=Range(0.86, 0.06), retention=Range(0.9, 0.25),
        max_speed=35.0,
    ),
    areas={
        "singles": HALVES,
        "doubles": HALVES,
        "service-box": (
            (0.0, 0.0, HALF, WIDTH / 2), (0.0, WIDTH / 2, HALF, WIDTH),
            (HALF, 0.0, LENGTH, WIDTH / 2), (HALF, WIDTH / 2, LENGTH, WIDTH),
        ),
    },
    default_area="singles",
    floor=-HEIGHT,
    reach=2.6,
    surroundings=(3.0, 2.0),
    bounce="required",
    serves_on_own_half=True,
    is_filmed_from_side=True,
)  # fmt: skip
