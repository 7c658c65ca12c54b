"""The scene of a track folder, as the diagnosis asks for it."""

from __future__ import annotations

from models.errors import OptionError
from models.gap_scene import GapScene
from pipeline.track_folder import TrackFolder


def open_scene(folder: TrackFolder) -> GapScene:
    """OptionError for a scene that cannot be diagnosed."""
    raise OptionError(f"{folder.entry.scene} cannot be diagnosed yet")
