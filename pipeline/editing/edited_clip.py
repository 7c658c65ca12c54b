"""The clip that a run folder was computed from, and its frames as images for the page."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2

from models.core.errors import OptionError, TruerollError
from pipeline.chain import default_run_folder, hash_clip
from pipeline.io.run_folder import SOURCE_FILE, read_scene_document
from pipeline.io.saved_shot import holds_rally
from pipeline.run_options import RunOptions, build_options, list_changed_values
from video.io.clip import Clip, read_frames

# Of the frames of the page: no visible block at four times magnification.
JPEG_QUALITY = 88
# Longest wait of a request for a frame that is not decoded yet, s.
FRAME_WAIT_S = 20.0


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


def find_edited_clip(target: Path, out: Path | None) -> EditedClip:
    """Find the clip and the run folder to edit.

    Args:
        target: A run folder, or a clip.
        out: Folder of the run of a clip; None for the default.

    Returns:
        Clip and folder.

    Raises:
        OptionError: There is no run folder with a clip, or the clip has been moved or changed.
    """
    if not target.is_dir() or not (target / SOURCE_FILE).exists():
        if target.is_dir() and not any(target.glob("*.png")):
            raise OptionError(f"A run folder or a clip was expected; {target} is neither: first do trueroll run CLIP")
        return EditedClip(target, out if out is not None else default_run_folder(target), hash_clip(target))
    try:
        noted = json.loads((target / SOURCE_FILE).read_text(encoding="utf-8"))
        path = Path(noted["path"])
        first, stop = (int(noted["first"]), int(noted["stop"])) if "first" in noted else (None, None)
        settings = dict(noted.get("settings", {}))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise OptionError(f"{target / SOURCE_FILE} does not name the clip of the run; run it again") from error
    if not path.exists():
        raise OptionError(f"The clip of this run is no longer at {path}; move it back, or run it where it is now")
    if holds_rally(target):
        raise OptionError(f"{target} holds a rally; corrections by hand are for shots of billiards so far")
    digest = hash_clip(path)
    expected = (read_scene_document(target / "scene.json").get("clip") or {}).get("sha256", digest)
    if expected != digest:
        raise OptionError(f"{path} has changed since {target} was computed; run it again")
    return EditedClip(path, target, digest, first, stop, settings)


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
    """Frames of a clip as JPEG files in a temporary folder, decoded once in the background."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self._folder = TemporaryDirectory(prefix="trueroll-edit-")
        self._ready = {int(frame): threading.Event() for frame in clip.frames}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._decode, daemon=True)
        self._thread.start()

    def read(self, frame: int) -> bytes | None:
        """Read a frame.

        Args:
            frame: Its index in the file.

        Returns:
            JPEG; None if there is no such frame, or it cannot be decoded.
        """
        ready = self._ready.get(frame)
        if ready is None or not ready.wait(FRAME_WAIT_S):
            return None
        try:
            return self._path(frame).read_bytes()
        except OSError:
            return None

    def close(self) -> None:
        """End the decoding and remove the files."""
        self._stop.set()
        self._thread.join()
        self._folder.cleanup()

    def _path(self, frame: int) -> Path:
        return Path(self._folder.name) / f"{frame:06d}.jpg"

    def _decode(self) -> None:
        """Decode all frames in order."""
        try:
            for frame, rgb in read_frames(self._clip, indices=self._clip.frames):
                if self._stop.is_set():
                    return
                _, code = cv2.imencode(
                    ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY)
                )
                self._path(frame).write_bytes(code.tobytes())
                self._ready[frame].set()
        except (TruerollError, OSError):  # the page shows which frame is missing
            pass
        finally:
            for event in self._ready.values():
                event.set()
