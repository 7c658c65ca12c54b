"""The clip that a run folder was computed from, and its frames as images for the page."""

from __future__ import annotations

import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2

from models.core.errors import OptionError, TruerollError
from models.core.typing import ImageArray
from pipeline.chain import default_run_folder, hash_clip
from pipeline.io.run_folder import SOURCE_FILE
from pipeline.io.strict_json import read_json
from pipeline.run_options import RunOptions, build_options, list_changed_values
from video.io.clip import Clip, read_frames

# Of the frames of the page: no visible block at four times magnification.
JPEG_QUALITY = 88
# Frames that are decoded at once, about one second, and parts of which the images are kept: some 20 MB.
PART_FRAMES, KEPT_PARTS = 30, 6


@dataclass(frozen=True, slots=True)
class EditedClip:
    """A clip, or one shot of a recording, and the folder of its run."""

    path: Path
    folder: Path
    digest: str
    """SHA-256 of the clip."""
    first: int | None = None
    """First frame of the shot in the recording; None for a whole clip."""
    stop: int | None = None
    """Frame after its last."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the run that differ from their defaults, by name; empty for a folder that does not note them."""

    @property
    def name(self) -> str:
        """Name that the page shows."""
        return self.path.name if self.first is None else f"{self.path.name}, {self.folder.name}"


def find_edited_clip(target: Path) -> EditedClip:
    """Find the clip and the run folder to edit.

    Args:
        target: A run folder, or a clip.

    Returns:
        Clip and folder.

    Raises:
        OptionError: There is no run folder with a clip, or the clip has been moved or changed.
    """
    if not target.is_dir() or not (target / SOURCE_FILE).exists():
        if target.is_dir() and not any(target.glob("*.png")):
            raise OptionError(f"A run folder or a clip was expected; {target} is neither: first do trueroll run CLIP")
        return EditedClip(target, default_run_folder(target), hash_clip(target))
    return find_run_clip(target)


def find_run_clip(folder: Path) -> EditedClip:
    """Find the clip of a run folder.

    Args:
        folder: The run folder, of a shot or a rally.

    Returns:
        Clip and folder.

    Raises:
        OptionError: The folder names no clip, or the clip has been moved or changed.
    """
    try:
        noted = json.loads((folder / SOURCE_FILE).read_text(encoding="utf-8"))
        path = Path(noted["path"])
        first, stop = (int(noted["first"]), int(noted["stop"])) if "first" in noted else (None, None)
        settings = dict(noted.get("settings", {}))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OptionError(f"{folder / SOURCE_FILE} does not name the clip of the run; run it again") from error
    if not path.exists():
        raise OptionError(f"The clip of this run is no longer at {path}; move it back, or run it where it is now")
    digest = hash_clip(path)
    scene = read_json(folder / "scene.json", "A run folder has a scene.json")
    expected = (scene.get("clip") or {}).get("sha256", digest)
    if expected != digest:
        raise OptionError(f"{path} has changed since {folder} was computed; run it again")
    return EditedClip(path, folder, digest, first, stop, settings)


def continue_run_options(edited: EditedClip, options: RunOptions) -> RunOptions:
    """Continue with the settings of a run, except those that the editor was started with.

    Args:
        edited: The clip and the settings of its run.
        options: Options of the editor.

    Returns:
        The options to run with.

    Raises:
        OptionError: The run folder notes settings that cannot be used.
    """
    try:
        return build_options({**edited.settings, **list_changed_values(options)})
    except (OptionError, TypeError, AttributeError) as error:
        raise OptionError(f"{edited.folder / SOURCE_FILE} notes settings that cannot be used: {error}") from error


class FrameImages:
    """Frames of a clip as JPEG, decoded some at a time where they are asked for; safe to use from several threads."""

    def __init__(self, clip: Clip) -> None:
        self._clip, self._lock = clip, threading.Lock()
        self._parts: OrderedDict[int, dict[int, bytes]] = OrderedDict()

    def read(self, frame: int) -> bytes | None:
        """Read a frame.

        Args:
            frame: Its index in the file.

        Returns:
            JPEG; None if there is no such frame, or it cannot be decoded.
        """
        row = frame - self._clip.first_frame
        if not 0 <= row < self._clip.frame_count:
            return None
        part = row // PART_FRAMES
        with self._lock:
            if part not in self._parts:
                self._parts[part] = self._decode(part)
            self._parts.move_to_end(part)
            while len(self._parts) > KEPT_PARTS:
                self._parts.popitem(last=False)
            return self._parts[part].get(frame)

    def _decode(self, part: int) -> dict[int, bytes]:
        """Decode a part of the clip; what cannot be decoded is left out."""
        images: dict[int, bytes] = {}
        first, end = self._clip.first_frame + part * PART_FRAMES, self._clip.first_frame + self._clip.frame_count
        own = self._clip.extract_subclip(first, min(first + PART_FRAMES, end))
        with suppress(TruerollError, OSError):  # the page shows which frame is missing
            for frame, rgb in read_frames(own, indices=own.frames):
                images[frame] = encode_jpeg(rgb)
        return images


def encode_jpeg(rgb: ImageArray) -> bytes:
    """Encode an image (H, W, 3) for a page."""
    _, code = cv2.imencode(".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    return code.tobytes()
