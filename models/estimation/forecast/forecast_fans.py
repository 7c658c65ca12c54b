"""Look ahead from a few moments of a shot, each time from what was seen until then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.errors import TrackError
from models.core.events import Events
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.current_state import outlook_at
from models.estimation.forecast.ensemble_prediction import drawn_courses
from models.estimation.forecast.forecast_values import Foresight, Foresights

AHEAD = 1.5
"""s that a fan reaches."""
STEP = 0.03
"""s between the points of its courses."""
COURSES = 48
"""of a fan: enough for an eye."""
AFTER = 0.2
"""s after a strike or contact at which one looks ahead: its balls have shown where they go."""
SHARE = 0.7
"""of the time to the next one, where that is sooner."""
PICTURES = 3
"""that must show a ball after it was touched."""
APART = 0.3
"""s between fans."""
MOST_FANS = 3
PAST = 0.6
"""s before a fan from which places are taken: balls show where they go in less, and a long past is long to fit."""
MOST_CONTACTS = 4
"""in that past: in a burst no fan is promised."""
LIKELY = 0.5


def foresee(tracks: Tracks, scene: Scene, events: Events) -> Foresights:
    """A fan a little after each of the first strikes and contacts of balls; none where nothing can be fitted so far."""
    fans = (_fan(tracks, scene, t) for t in viewpoints(events, tracks.t))
    return Foresights(tuple(fan for fan in fans if fan is not None))


def viewpoints(events: Events, shown: FloatArray) -> list[float]:
    """Moments (s), each that of a picture, from which to look ahead."""
    sure = events.t[events.probability >= LIKELY]
    touched = [
        k for k in range(len(events)) if events.kind[k] in ("strike", "ball") and events.probability[k] >= LIKELY
    ]
    found: list[float] = []
    for k in touched:
        start = float(events.t[k])
        later = sure[sure > start]
        wait = min(AFTER, SHARE * float(later[0] - start)) if len(later) else AFTER
        row = int(np.searchsorted(shown, start + wait + 1e-9, side="right")) - 1
        seen = row - int(np.searchsorted(shown, start, side="right")) + 1
        contacts = int(np.sum((sure <= start) & (sure > start - PAST)))
        if seen < PICTURES or contacts > MOST_CONTACTS or (found and shown[row] - found[-1] < APART):
            continue
        found.append(float(shown[row]))
    return found[:MOST_FANS]


def _fan(tracks: Tracks, scene: Scene, t: float) -> Foresight | None:
    """None where so little was seen, or so much would happen, that nothing can be played on: a fan is an extra."""
    times = np.asarray(t + STEP * np.arange(round(AHEAD / STEP) + 1), np.float64)
    try:
        look = outlook_at(_since(tracks, t - PAST), scene, t)
        courses = drawn_courses(look, times, 0, COURSES) if look.ids else None
    except (TrackError, ArithmeticError, ValueError):
        return None
    return None if courses is None else Foresight(t, look.ids, times, courses)


def _since(tracks: Tracks, t: float) -> Tracks:
    """What was seen from t (s) on."""
    rows = tracks.t >= t
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], xy=tracks.xy[rows], px=tracks.px[rows],
        sigma=tracks.sigma[rows], sigma_along=tracks.sigma_along[rows], streak=tracks.streak[rows],
        radius_px=tracks.radius_px[rows], lay=None if tracks.lay is None else tracks.lay[rows],
    )  # fmt: skip
