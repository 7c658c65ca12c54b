"""Reading of what answers about contacts need of a run folder: observations, events and fitted motion of its shot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from models.core.errors import OptionError
from models.estimation.contact_test.contact_moment import ClothPriors
from models.estimation.contact_test.shot_record import ShotRecord, make_shot_record
from models.estimation.reconstruction.close_passes import list_close_passes
from models.estimation.reconstruction.shot_views import view_shot
from pipeline.io.shot_folder import read_shot


def read_shot_record(folder: Path, number: int = 0, cloth: ClothPriors | None = None) -> ShotRecord:
    """Record the saved shot of a run folder.

    Args:
        folder: Run folder.
        number: Number of the shot; a run has shot 0 alone.
        cloth: What is known about the friction of the cloth, with which close passes are tested again; None for what
            the shot was explained with.

    Returns:
        Observations and fitted motion of the N balls.

    Raises:
        OptionError: The folder is missing, or holds no such shot.
    """
    if not folder.is_dir():
        raise OptionError(f"A run folder was expected; {folder} is none. Run the clip first: trueroll run CLIP")
    shot = read_shot(folder)
    if cloth is not None:
        shot = replace(shot, passes=list_close_passes(shot, cloth))
    fit = view_shot(shot)
    if number or not len(fit.trajectory.start):
        raise OptionError(f"{folder} has no motion of shot {number}")
    scene = shot.scene
    return make_shot_record(shot.tracks, fit.events, fit.trajectory, scene.table, scene.camera, fit.explanation)
