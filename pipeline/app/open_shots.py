"""The shots that pages look at: what is expensive to make of a run folder, made once, and its session of corrections.

Everything is read again as soon as the saved shot of a folder changes, and only a few shots are kept in memory.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from models.core.corrections import Corrections
from models.core.errors import OptionError, TruerollError
from models.core.fit_result import Fit, WholeShotFit
from models.core.rally import Rally
from models.core.shot import Shot
from models.estimation.contact_test.shot_record import ShotRecord
from models.estimation.forecast.ensemble_prediction import ENSEMBLE_SIZE
from pipeline.actions.play_otherwise import (
    PLAYS,
    PlayedShot,
    StrokePlan,
    StruckShot,
    draw_struck_shot,
    play_struck_shot,
)
from pipeline.actions.predict_shot import PredictedShot, forecast_from
from pipeline.app.shot_library import ShotLibrary
from pipeline.chain import hash_tables
from pipeline.editing.edit_session import EditSession
from pipeline.editing.edited_clip import FrameImages, continue_run_options, find_edited_clip, find_run_clip
from pipeline.editing.rally_view import CourtRun
from pipeline.editing.run_view import ClipRun
from pipeline.engine.result_cache import ResultCache, open_cache
from pipeline.engine.stage_graph import SilentWatcher
from pipeline.io.corrections_file import read_corrections, read_noted_corrections
from pipeline.io.run_folder import SOURCE_FILE, read_source
from pipeline.io.run_views import record_shot, view_run
from pipeline.io.saved_shot import SHOT_FILE, SHOT_FOLDER, read_saved, require_rally, require_shot
from pipeline.io.shot_laws import find_laws, load_laws
from pipeline.io.strict_json import read_json
from pipeline.recording_shots import read_whole_clip
from pipeline.run_options import RunOptions
from video.calibration.table_classifier import find_baulk_line
from video.io.clip import Clip, read_frames

# Shots and sessions in memory: a person compares two or three; each holds up to some 50 MB of frames and plays.
KEPT_SHOTS = 4
# s without a request after which a session of corrections is closed, and between two looks for such ones.
IDLE_S, LOOK_S = 600.0, 30.0
# Plays of a stroke while a slider moves: paths come in a quarter of a second, and all plays when it rests.
QUICK_PLAYS = 100
SEED = 0
# s that are predicted by default.
PREDICTED_S = 3.0
# Ensembles of strokes that are kept per shot: a few plays and all, of two strokes.
KEPT_ENSEMBLES = 4
# Contact models of one shot are searched at a time: that takes a core for up to a minute.
_LAWS_TURN = threading.Lock()


class OpenShot:
    """A saved shot or rally in memory; safe to use from several threads."""

    def __init__(self, folder: Path, digest: str, cache: ResultCache) -> None:
        """Read what the folder holds; raises OptionError where it holds nothing that can be shown."""
        self.folder, self.digest = folder, digest
        self.saved: Shot | Rally = read_saved(folder)
        self.motion: dict[str, Any] | None = None
        """What the page shows of the saved motion, once it was described."""
        self._cache = cache
        # playing takes seconds, and compiling it a minute; what else is asked does not wait for that
        self._lock, self._play_lock, self._clip_lock = threading.RLock(), threading.Lock(), threading.Lock()
        self._is_warm = False
        self._record: ShotRecord | None = None
        self._struck: OrderedDict[tuple[int, int], StruckShot] = OrderedDict()
        self._laws: WholeShotFit | None = None
        self._laws_fit: threading.Thread | None = None
        self._clip: Clip | None = None
        self._frames: FrameImages | None = None

    @property
    def shot(self) -> Shot:
        """The shot of billiards; raises OptionError for a rally."""
        return require_shot(self.saved, self.folder)

    @property
    def rally(self) -> Rally:
        """The rally; raises OptionError for a shot."""
        return require_rally(self.saved, self.folder)

    @property
    def fit(self) -> Fit:
        """All views of the shot."""
        with self._lock:
            return view_run(self.shot)

    @property
    def record(self) -> ShotRecord:
        """The record that questions are answered from; raises OptionError where nothing moves."""
        with self._lock:
            if self._record is None:
                self._record = record_shot(self.shot, self.folder)
            return self._record

    @property
    def corrections(self) -> Corrections:
        """What a person had corrected when the run was made; raises OptionError where its note is malformed."""
        if isinstance(self.saved, Shot):
            return self.saved.corrections
        return read_noted_corrections(self.folder)

    @property
    def run(self) -> ClipRun | CourtRun:
        """The values of the run that the page needs."""
        fps = 0.0
        with suppress(OptionError, KeyError, TypeError, ValueError):  # the saved shot is enough to be shown
            fps = float(read_json(self.folder / "scene.json", "A run folder has a scene.json")["fps"])
        if isinstance(self.saved, Rally):
            return CourtRun(fps, self.saved, hash_tables(self.folder))
        return ClipRun(fps, self.shot.scene, self.shot.tracks, self.fit, hash_tables(self.folder))

    @property
    def has_clip(self) -> bool:
        """Whether the clip of the run is still where it was."""
        path = str(read_source(self.folder).get("path", ""))
        return bool(path) and Path(path).exists()

    def warm_up(self) -> None:
        """Prepare in the background for what a page may ask next; only the first call acts."""
        with self._lock:
            is_first, self._is_warm = not self._is_warm, True
        if is_first and isinstance(self.saved, Shot):
            threading.Thread(target=self.prepare, daemon=True).start()

    def prepare(self) -> None:
        """Load the compiled code of a stroke that is played otherwise; what fails is refused when it is asked for."""
        from models.estimation.changed_shot import PlayerSpread, StrokeChange

        with suppress(TruerollError, ValueError):
            self.play(0, StrokePlan(StrokeChange(speed_factor=1.01), PlayerSpread(), "none"), QUICK_PLAYS)

    def prepare_prediction(self) -> None:
        """Load the compiled code of a prediction, by one from the middle of the shot."""
        with suppress(TruerollError, ValueError):
            self.predict(float(np.median(self.record.moments)), PREDICTED_S)

    def play(self, stroke: int, plan: StrokePlan, plays: int = PLAYS) -> PlayedShot:
        """Play a stroke otherwise.

        Args:
            stroke: Its number in the clip, from 0.
            plan: What is changed.
            plays: How often.

        Returns:
            The plays; by contact models of the whole shot as soon as these are known.

        Raises:
            OptionError: It is no shot of billiards.
            TrackError: It has no such stroke.
        """
        shot = self.shot
        with self._play_lock:
            if self._laws is None and (laws := find_laws(self.folder, shot, self._cache)) is not None:
                self._laws = laws
                self._struck.clear()
            key = stroke, plays
            if key not in self._struck:
                self._struck[key] = draw_struck_shot(shot, self._laws, stroke, None, plays, SEED)
                while len(self._struck) > KEPT_ENSEMBLES:
                    self._struck.popitem(last=False)
            self._struck.move_to_end(key)
            struck = self._struck[key]
        return play_struck_shot(struck, plan, SEED)

    def predict(self, at: float | None, seconds: float) -> PredictedShot:
        """Predict the rest of a shot as `trueroll predict` does; the errors are those of `forecast_from`."""
        return forecast_from(self.folder, seconds, at, None, None, SEED, ENSEMBLE_SIZE, self._cache)

    def fit_laws(self) -> bool:
        """Begin to find contact models of the whole shot unless they are known.

        Returns:
            Whether they are being searched.
        """
        with self._lock:
            if self._laws is None and self._laws_fit is None:
                self._laws_fit = threading.Thread(target=self._fit_laws, daemon=True)
                self._laws_fit.start()
            return self._laws is None and self.is_fitting_laws

    @property
    def is_fitting_laws(self) -> bool:
        """Whether contact models of the whole shot are being searched."""
        return self._laws_fit is not None and self._laws_fit.is_alive()

    def _fit_laws(self) -> None:
        """Find contact models of the whole shot; without them, side spin stays unknown."""
        with _LAWS_TURN, suppress(TruerollError, OSError, ValueError):
            load_laws(self.folder, self.shot, self._cache)

    @property
    def clip(self) -> Clip:
        """The part of the clip that the run was computed from; raises TruerollError where it cannot be read."""
        with self._clip_lock:
            if self._clip is None:
                self._clip = self._open_clip()
            return self._clip

    def _open_clip(self) -> Clip:
        """Open the clip by the result of the run that is in the cache; one that was moved or changed is refused."""
        noted = find_run_clip(self.folder)
        options = continue_run_options(noted, RunOptions())
        clip = read_whole_clip(noted.path, options, self._cache, SilentWatcher())
        return clip if noted.first is None or noted.stop is None else clip.extract_subclip(noted.first, noted.stop)

    @property
    def baulk_line(self) -> float | None:
        """Where the baulk line lies, m along the table; None where none is seen, or the clip cannot be read."""
        table, camera = self.shot.scene.table, self.shot.scene.camera
        if not (table.game == "snooker" or table.name.startswith("blackball")) or camera is None:
            return None
        with suppress(TruerollError, OSError, StopIteration):
            _, image = next(iter(read_frames(self.clip, indices=self.clip.frames[:1])))
            share = find_baulk_line(image, camera.corners_px)
            return None if share is None else share * table.length
        return None

    def read_frame(self, number: int) -> bytes | None:
        """Read a frame as JPEG; None if there is none, raises TruerollError where the clip cannot be read."""
        clip = self.clip
        with self._clip_lock:
            if self._frames is None:
                self._frames = FrameImages(clip)
        return self._frames.read(number)


@dataclass(slots=True)
class KeptSession:
    """A session of corrections, and when it was last used, s of the monotonic clock."""

    session: EditSession
    used: float


class ShotDesk:
    """The shots and the sessions of corrections that are open."""

    def __init__(self, library: ShotLibrary, cache: ResultCache | None = None) -> None:
        self._library = library
        self._cache = open_cache(None) if cache is None else cache
        self._lock = threading.RLock()
        self._shots: OrderedDict[str, OpenShot] = OrderedDict()
        self._sessions: OrderedDict[str, KeptSession] = OrderedDict()
        self._is_closed = threading.Event()
        threading.Thread(target=self._look_for_idle, daemon=True).start()

    def open(self, shot: str) -> OpenShot:
        """Open a shot of the library as it is on disk now.

        Args:
            shot: Id of its card.

        Returns:
            The shot.

        Raises:
            Refusal: There is none.
            OptionError: The folder holds nothing that can be shown.
        """
        folder = self._library.find_folder(shot)
        digest = _hash_state(folder)
        with self._lock:
            opened = self._shots.get(shot)
            if opened is None or opened.digest != digest or opened.folder != folder:
                opened = OpenShot(folder, digest, self._cache)
            self._shots[shot] = opened
            self._shots.move_to_end(shot)
            while len(self._shots) > KEPT_SHOTS:
                self._shots.popitem(last=False)
            return opened

    def name_shot(self, opened: OpenShot) -> str:
        """Return the name that the library shows of a shot."""
        return self._library.name_folder(opened.folder)

    def find_session(self, shot: str) -> EditSession | None:
        """Find the session of corrections of a shot; None where nothing was corrected lately."""
        with self._lock:
            entry = self._sessions.get(shot)
            if entry is None:
                return None
            entry.used = time.monotonic()
            self._sessions.move_to_end(shot)
            return entry.session

    def open_session(self, shot: str) -> EditSession:
        """Open the session of corrections of a shot, or return the one that is open.

        Raises:
            Refusal: There is no such shot.
            OptionError: It cannot be corrected, such as a shot whose clip was moved.
        """
        with self._lock:
            session = self.find_session(shot)
            if session is not None and session.edited.path.exists() and not session.is_outdated:
                return session
            self.close_session(shot)
            opened = self.open(shot)
            edited = find_edited_clip(opened.folder)
            marks = read_corrections(edited.path, edited.digest).corrections
            if edited.first is not None and edited.stop is not None:
                marks = marks.select_span(edited.first, edited.stop)
            is_current = False
            with suppress(OptionError):
                is_current = marks == opened.corrections
            session = EditSession(
                edited, continue_run_options(edited, RunOptions()), self._cache, opened.run if is_current else None,
                partial(self._library.announce, type="shot", id=shot),
                self._library.own / "undo" / f"{edited.digest[:32]}-{edited.first or 0}.json",
            )  # fmt: skip
            self._sessions[shot] = KeptSession(session, time.monotonic())
            quiet = [name for name, one in self._sessions.items() if name != shot and not one.session.status.stage]
            oldest = quiet[: max(0, len(self._sessions) - KEPT_SHOTS)]
        for name in oldest:
            self.close_session(name)
        return session

    def close_session(self, shot: str) -> None:
        """Close the session of a shot, if one is open; a run in progress is given up."""
        with self._lock:
            entry = self._sessions.pop(shot, None)
        if entry is not None:
            entry.session.close()

    def close(self) -> None:
        """Close all sessions."""
        self._is_closed.set()
        for shot in list(self._sessions):
            self.close_session(shot)

    def close_idle(self, now: float) -> None:
        """Close the sessions that nobody has used for `IDLE_S`, and that run nothing, at a time of the clock, s."""
        with self._lock:
            idle = [
                shot for shot, entry in self._sessions.items()
                if now - entry.used > IDLE_S and not entry.session.status.stage
            ]  # fmt: skip
        for shot in idle:
            self.close_session(shot)

    @property
    def can_be_closed(self) -> bool:
        """Whether nobody would miss what is open: nothing is computed. What can be undone is in files."""
        with self._lock:
            states = [entry.session.status for entry in self._sessions.values()]
            is_computing = any(shot.is_fitting_laws for shot in self._shots.values())
        return not (is_computing or any(one.stage or (one.result != one.revision and not one.error) for one in states))

    def _look_for_idle(self) -> None:
        while not self._is_closed.wait(LOOK_S):
            self.close_idle(time.monotonic())


def _hash_state(folder: Path) -> str:
    """Hash what a run folder holds: the saved shot names the hash of its arrays, and the source its clip."""
    digest = hashlib.sha256()
    for path in (folder / SHOT_FOLDER / SHOT_FILE, folder / SOURCE_FILE):
        with suppress(OSError):
            digest.update(path.read_bytes())
        digest.update(b"\0")
    return digest.hexdigest()
