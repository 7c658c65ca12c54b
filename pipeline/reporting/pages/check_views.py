"""Close-ups of the places of a run that a person should check, for its page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.core.fit_result import Fit
from models.core.naming import join_names
from models.core.number_format import format_probability
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from pipeline.reporting.pages.page_embedding import build_jpeg_uri
from pipeline.reporting.text.check_list import CheckPlace
from pipeline.reporting.text.check_sentences import format_check_place
from video.io.clip import Clip, read_frames
from video.overlay.close_up import CloseUpFrame, NamedOutline, draw_place

MAX_OUTLINES = 3
"""Balls of a place that are outlined."""
DEFAULT_RADIUS_PX = 10.0
"""Radius of a ball without any."""
DATED_CODES = ("undecided", "unexplained")
"""Reasons whose moment lies between frames, so that the balls are also outlined there."""


@dataclass(frozen=True, slots=True)
class CheckView:
    """One place on the page."""

    frame: int
    t: float
    """s."""
    uncertainty: str
    sentence: str
    image: str
    """Data URI of the close-up; empty where the place is unknown."""
    alt: str
    """Text for readers who do not see the image."""


def build_check_views(
    clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, places: Sequence[CheckPlace]
) -> list[CheckView]:
    """Build the close-ups of places.

    Args:
        clip: The clip.
        scene: Table and camera.
        tracks: Tracks of T frames and N balls.
        fit: The fit of the shot.
        places: The places.

    Returns:
        One view per place.
    """
    frames = sorted({place.frame for place in places})
    images = dict(read_frames(clip, indices=frames)) if frames else {}
    return [
        CheckView(
            place.frame, place.t, format_probability(place.uncertainty), format_check_place(place, fit.naming),
            _embed_close_up(scene, tracks, fit, place, images[place.frame]),
            f"close-up of {join_names(map(fit.naming.say, place.balls[:MAX_OUTLINES]))} in frame {place.frame}",
        )
        for place in places
    ]  # fmt: skip


def _embed_close_up(scene: Scene, tracks: Tracks, fit: Fit, place: CheckPlace, image: ImageArray) -> str:
    """Draw the close-up of a place and embed it; empty if the place is unknown."""
    if not np.isfinite(place.xy).all():
        return ""
    t = float(tracks.t[np.searchsorted(tracks.frame, place.frame)])
    is_dated = place.reasons[0].code in DATED_CODES
    view = CloseUpFrame(
        image, place.frame, t, _outline_balls(scene, tracks, fit, place, t),
        _outline_balls(scene, tracks, fit, place, place.t) if is_dated else (),
    )  # fmt: skip
    centre: FloatArray = scene.camera.to_pixels(place.xy, scene.table.ball_radius, place.frame)
    return build_jpeg_uri(draw_place(view, centre, _find_radius(tracks, place.balls[0], place.t)))


def _outline_balls(scene: Scene, tracks: Tracks, fit: Fit, place: CheckPlace, t: float) -> tuple[NamedOutline, ...]:
    """Outline the balls of a place at their fitted positions at t (s); balls without one are left out."""
    xy = fit.trajectory.at(t).xy
    outlines = []
    for name in place.balls[:MAX_OUTLINES]:
        at = xy[fit.trajectory.ids.index(name)]
        if np.isfinite(at).all():
            centre = scene.camera.to_pixels(at, scene.table.ball_radius, place.frame)
            outlines.append(NamedOutline(fit.naming.name_ball(name), centre, _find_radius(tracks, name, t)))
    return tuple(outlines)


def _find_radius(tracks: Tracks, ball: str, t: float) -> float:
    """Return the radius of a ball, px, in the nearest frame to t (s) in which it was detected."""
    radii = tracks.radius_px[:, tracks.ids.index(ball)]
    rows = np.flatnonzero(np.isfinite(radii))
    return float(radii[rows[np.argmin(np.abs(tracks.t[rows] - t))]]) if len(rows) else DEFAULT_RADIUS_PX
