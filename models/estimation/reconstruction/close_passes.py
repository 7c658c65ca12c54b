"""Passes of two balls that may have been grazes, tested at the capture times of a shot."""

from __future__ import annotations

from dataclasses import replace

from models.core.shot import ClosePass, Shot
from models.estimation.contact_test.candidate_contacts import find_close_passes
from models.estimation.contact_test.contact_moment import USUAL_CLOTH, ClothPriors
from models.estimation.contact_test.shot_record import make_shot_record
from models.estimation.reconstruction.shot_views import view_captured


def list_close_passes(shot: Shot, cloth: ClothPriors = USUAL_CLOTH) -> tuple[ClosePass, ...]:
    """List the passes of a shot that may have been contacts, with the results of their tests.

    Args:
        shot: The shot; its own passes do not count.
        cloth: What is known about the friction of the cloth.

    Returns:
        The passes.
    """
    if not len(shot.tracks.t):
        return ()
    view, scene = view_captured(replace(shot, passes=())), shot.scene
    record = make_shot_record(
        shot.capture_tracks, view.events, view.trajectory, scene.table, scene.camera, view.explanation
    )
    return find_close_passes(replace(record, cloth=cloth))
