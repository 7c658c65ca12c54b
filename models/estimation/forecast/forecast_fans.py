"""Fans of predicted paths from a few moments of a shot, each from the frames until then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.errors import TrackError
from models.core.events import Events
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.current_state import estimate_state
from models.estimation.forecast.ensemble_prediction import sample_trajectories
from models.estimation.forecast.forecast_values import ForecastFan, ForecastFans
from models.estimation.table_learning.learned_table import LearnedTable

FAN_TIME = 1.5
"""s of a fan."""
TIME_STEP = 0.03
"""s between the points of its members."""
FAN_MEMBERS = 48
"""Members of a fan: enough for a drawing."""
DELAY_AFTER_CONTACT = 0.2
"""s after a strike or contact at which a fan starts: its balls have shown where they go."""
MAX_DELAY_SHARE = 0.7
"""Upper limit of the delay, over the time to the next contact."""
MIN_FRAMES = 3
"""Frames that must show a ball after its contact."""
MIN_FAN_SPACING = 0.3
"""s between fans."""
MAX_FANS = 3
HISTORY_TIME = 0.6
"""s before a fan whose samples are used: balls show where they go in less, and a long history takes long to fit."""
MAX_HISTORY_CONTACTS = 4
"""Contacts in that history: within a break there is no fan."""
MIN_PROBABILITY = 0.5


def predict_fans(tracks: Tracks, scene: Scene, events: Events, learned: LearnedTable | None = None) -> ForecastFans:
    """Predict a fan a little after each of the first strikes and ball contacts of a shot.

    Args:
        tracks: Tracks of N balls over T frames.
        scene: Table and camera.
        events: Events of the shot.
        learned: What other shots taught about the table.

    Returns:
        The fans; none where nothing can be fitted.
    """
    fans = (_predict_fan(tracks, scene, t, learned) for t in select_fan_times(events, tracks.t))
    return ForecastFans(tuple(fan for fan in fans if fan is not None))


def select_fan_times(events: Events, frame_times: FloatArray) -> list[float]:
    """Select the presentation times (s) of frames at which fans start."""
    probable = events.t[events.probability >= MIN_PROBABILITY]
    contacts = [
        k
        for k in range(len(events))
        if events.kind[k] in ("strike", "ball") and events.probability[k] >= MIN_PROBABILITY
    ]
    times: list[float] = []
    for k in contacts:
        contact_time = float(events.t[k])
        later = probable[probable > contact_time]
        wait = (
            min(DELAY_AFTER_CONTACT, MAX_DELAY_SHARE * float(later[0] - contact_time))
            if len(later)
            else DELAY_AFTER_CONTACT
        )
        row = int(np.searchsorted(frame_times, contact_time + wait + 1e-9, side="right")) - 1
        frames = row - int(np.searchsorted(frame_times, contact_time, side="right")) + 1
        recent_contacts = int(np.sum((probable <= contact_time) & (probable > contact_time - HISTORY_TIME)))
        if (
            frames < MIN_FRAMES
            or recent_contacts > MAX_HISTORY_CONTACTS
            or (times and frame_times[row] - times[-1] < MIN_FAN_SPACING)
        ):
            continue
        times.append(float(frame_times[row]))
    return times[:MAX_FANS]


def _predict_fan(tracks: Tracks, scene: Scene, t: float, learned: LearnedTable | None) -> ForecastFan | None:
    """Predict one fan; None where too little was observed, or too much happens, since a fan is optional."""
    times = np.asarray(t + TIME_STEP * np.arange(round(FAN_TIME / TIME_STEP) + 1), np.float64)
    try:
        state = estimate_state(_select_tracks_since(tracks, t - HISTORY_TIME), scene, t, learned)
        members = sample_trajectories(state, times, 0, FAN_MEMBERS) if state.ids else None
    except (TrackError, ArithmeticError, ValueError):
        return None
    return None if members is None else ForecastFan(t, state.ids, times, members)


def _select_tracks_since(tracks: Tracks, t: float) -> Tracks:
    """Select the tracks from t (s) on."""
    rows = tracks.t >= t
    return replace(
        tracks, frame=tracks.frame[rows], t=tracks.t[rows], xy=tracks.xy[rows], px=tracks.px[rows],
        sigma=tracks.sigma[rows], sigma_along=tracks.sigma_along[rows], streak=tracks.streak[rows],
        radius_px=tracks.radius_px[rows],
        image_jacobian=None if tracks.image_jacobian is None else tracks.image_jacobian[rows],
    )  # fmt: skip
