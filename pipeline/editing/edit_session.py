"""One session of the editor: the corrections with undo and redo, and the runs that follow them."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from models.core.corrections import Corrections
from models.core.naming import Naming
from models.core.progress import Progress
from models.core.rally import Rally
from models.estimation.hand_marks.resolved_marks import update_ball_names
from pipeline.chain import find_report_tables, hash_tables, run_clip, run_tables
from pipeline.editing.edited_clip import EditedClip
from pipeline.editing.rally_view import CourtRun, describe_rally_run
from pipeline.editing.run_view import ClipRun, describe_run
from pipeline.engine.atomic_write import write_text
from pipeline.engine.result_cache import ResultCache
from pipeline.io.corrections_file import (
    SCHEMA,
    CorrectionsFile,
    describe_corrections,
    parse_corrections,
    read_corrections,
    write_corrections,
)
from pipeline.io.run_folder import STAGE_FILES
from pipeline.recording_shots import read_recording_shot
from pipeline.reporting.text.fit_sentences import format_corrections, format_recomputed
from pipeline.reporting.text.text_formatting import format_error
from pipeline.run_options import (
    CORRECTED_SETTINGS,
    RunOptions,
    require_possible_settings,
    reset_settings,
    start_corrections,
)
from pipeline.stages.shot_stages import ClipShot

# Longest wait for a run in progress at the end of the session, s: a search that reports no progress cannot be given up,
# and ends with the process.
CLOSE_WAIT_S = 3.0
# Corrections that can be taken back.
MAX_UNDO = 200


class ConflictError(Exception):
    """Another editor has changed the corrections in the meantime."""


class SupersededError(Exception):
    """A newer correction makes the present run useless."""


@dataclass(frozen=True, slots=True)
class EditStatus:
    """What the page asks for again and again."""

    revision: int
    """Of the corrections."""
    result: int
    """Revision of the corrections that the shown run has; -1 before the first one."""
    stage: str
    """Stage that runs; empty for none."""
    share: float
    """Finished share of it, 0 to 1."""
    error: str
    """Why the run of the present corrections failed; empty if it did not."""
    outputs: str
    """Whether video, report and recording in the folder are of the shown events: current, older or missing."""
    can_undo: bool
    can_redo: bool


class EditSession:
    """The corrections of one clip and its runs; safe to use from several threads."""

    def __init__(
        self, edited: EditedClip, options: RunOptions, cache: ResultCache, shown: ClipRun | CourtRun | None = None,
        on_change: Callable[[], None] = lambda: None, history: Path | None = None,
    ) -> None:  # fmt: skip
        """Start the session, and its first run unless there is one to begin with.

        Args:
            edited: Clip and run folder.
            options: Options of the run; those that a person can correct are what the corrections start from.
            shown: The saved run of the folder; None to run the clip.
            on_change: Called after each change of the corrections or of the shown run.
            history: File that keeps what can be undone and redone from one session to the next; None for one session.
        """
        self.edited = edited
        self._options, self._cache, self._on_change = options, cache, on_change
        self._lock = threading.Condition()
        self._file = self._start_from(read_corrections(edited.path, edited.digest))
        self._history = history
        self._undo, self._redo = ([], []) if history is None else _read_history(history, self._file)
        self._run: ClipRun | CourtRun | None = None
        self._view: dict[str, Any] | None = None
        self._result, self._stage, self._share, self._error = -1, "", 0.0, ""
        self._outputs, self._notice = "missing", ""
        self._first_revision, self._tables = self._file.revision, hash_tables(edited.folder)
        self._wanted: Literal["", "tables", "all"] = "tables"
        if shown is not None:
            self._wanted = ""
            self._show((shown, _describe(shown, None, self._file.corrections)), self._file.revision)
        self._is_closed = False
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    @property
    def status(self) -> EditStatus:
        """What the page asks for again and again."""
        with self._lock:
            return EditStatus(
                self._file.revision, self._result, self._stage, self._share, self._error, self._outputs,
                bool(self._undo), bool(self._redo),
            )  # fmt: skip

    @property
    def is_outdated(self) -> bool:
        """Whether another program has written the run folder since this session did, or began."""
        with self._lock:
            is_idle = not self._stage and not self._wanted and self._result == self._file.revision
            return is_idle and hash_tables(self.edited.folder) != self._tables

    def describe(self) -> dict[str, Any]:
        """Describe corrections and run for the page."""
        with self._lock:
            corrections, run = self._file.corrections, self._run
            present, naming = corrections, Naming()
            if isinstance(run, ClipRun):
                present, naming = update_ball_names(corrections, run.tracks), run.fit.naming
            return {
                "name": self.edited.name,
                "revision": self._file.revision,
                "result": self._result,
                "corrections": describe_corrections(corrections),
                "set_by_hand": format_corrections(present, naming),
                "notice": self._notice,
                "run": self._view,
            }

    def change(self, corrections: Corrections, revision: int) -> None:
        """Replace the corrections, write them and run the clip again.

        Args:
            corrections: The new corrections.
            revision: Revision of those that they were made from.

        Raises:
            ConflictError: Somebody else has changed them since.
            OptionError: They cannot be used or written.
        """
        require_possible_settings(corrections)
        with self._lock:
            before = self._file.corrections
            self._write(corrections, revision)
            self._undo = [*self._undo[-MAX_UNDO + 1 :], before]
            self._redo.clear()
            self._save_history()

    def step(self, revision: int, *, forward: bool) -> None:
        """Undo the last correction, or with `forward` redo it.

        Args:
            revision: Revision of the present corrections.
            forward: Whether to redo.

        Raises:
            ConflictError: Somebody else has changed the corrections since, or there is nothing to undo or redo.
            OptionError: They cannot be written.
        """
        with self._lock:
            source, target = (self._redo, self._undo) if forward else (self._undo, self._redo)
            if not source:
                raise ConflictError(f"There is nothing to {'redo' if forward else 'undo'}.")
            before = self._file.corrections
            self._write(source[-1], revision)
            source.pop()
            target.append(before)
            self._save_history()

    def finish(self) -> None:
        """Write all files of the run, with video and report."""
        with self._lock:
            self._wanted = "all"
            self._lock.notify_all()

    def close(self) -> None:
        """End the session; a run in progress is given up."""
        with self._lock:
            self._is_closed = True
            self._lock.notify_all()
        self._worker.join(CLOSE_WAIT_S)

    def _write(self, corrections: Corrections, revision: int) -> None:
        """Write corrections if `revision` is still that of the file; the caller holds the lock."""
        saved = read_corrections(self.edited.path, self.edited.digest)
        if saved.revision != self._file.revision:
            self._file = self._start_from(saved)
            self._undo.clear()
            self._redo.clear()
            self._request()
        if revision != self._file.revision:
            raise ConflictError(
                f"The corrections were changed in another tab or program (revision {self._file.revision}, yours is"
                f" {revision}); they are shown now, please make your change again."
            )
        content = CorrectionsFile(revision + 1, self.edited.digest, corrections)
        write_corrections(self.edited.path, content)
        self._file = content
        self._options = reset_settings(self._options)
        self._request()
        self._on_change()

    def _save_history(self) -> None:
        """Save what can be undone and redone; where that fails, it lasts as long as the session."""
        if self._history is not None:
            steps = [self._file.corrections], self._undo, self._redo
            lists = ([describe_corrections(one) for one in corrections] for corrections in steps)
            with suppress(OSError):
                write_text(self._history, json.dumps([self._file.revision, *lists]))

    def _start_from(self, saved: CorrectionsFile) -> CorrectionsFile:
        """Return the content of the corrections file, with the options of the run where it does not set them.

        The file beats these options; the first correction writes them to it, so that every correction can change them.
        """
        corrections = start_corrections(self._options, saved.corrections)
        corrected = [name for name in CORRECTED_SETTINGS if getattr(saved.corrections, name) is not None]
        self._options = reset_settings(self._options, corrected)
        return replace(saved, corrections=corrections)

    def _request(self) -> None:
        """Ask the worker for a run of the present corrections."""
        self._wanted, self._error = "tables", ""
        self._lock.notify_all()

    def _work(self) -> None:
        """Run the clip whenever that is asked for."""
        while True:
            with self._lock:
                while not self._wanted and not self._is_closed:
                    self._lock.wait()
                if self._is_closed:
                    return
                wanted, self._wanted = self._wanted, ""
                revision, before, options = self._file.revision, self._run, self._options
                corrections = self._file.corrections
            watcher = _SessionWatcher(partial(self._note_progress, revision))
            try:
                if wanted == "tables" or self._result != revision:
                    run = self._run_tables(watcher, options, revision)
                    view = _describe(run, before, corrections)
                    self._show((run, view), revision)
                if wanted == "all":
                    shot = self._read_shot(watcher)
                    run_clip(self.edited.path, self.edited.folder, options, self._cache, watcher, shot=shot)
                    self._notice = ""
                    self._show(None, revision)
            except SupersededError:
                continue
            except Exception as error:  # no error of a run may end the session
                self._fail(format_error(error, for_page=True), revision)

    def _run_tables(self, watcher: _SessionWatcher, options: RunOptions, revision: int) -> ClipRun | CourtRun:
        """Run the stages up to the tables; before the first correction the folder stays as it is."""
        path, folder, shot = self.edited.path, self.edited.folder, self._read_shot(watcher)
        tables = hash_tables(folder)
        publishes = not tables or revision != self._first_revision
        values = run_tables(path, folder, options, self._cache, watcher, shot, publishes)
        kind = CourtRun if isinstance(values[1], Rally) else ClipRun
        run: ClipRun | CourtRun = kind(float(values[0].fps), *values[1:])
        differs = not publishes and run.tables != tables
        self._notice = format_recomputed(str(folder), watcher.ran) if differs else ""
        return run

    def _assess_outputs(self, run: ClipRun | CourtRun) -> str:
        """Assess whether video, report and recording in the folder are of a run: current, older or missing."""
        if not all((self.edited.folder / name).exists() for name in (*STAGE_FILES["report"], *STAGE_FILES["record"])):
            return "missing"
        return "current" if find_report_tables(self.edited.folder) == run.tables else "older"

    def _read_shot(self, watcher: _SessionWatcher) -> ClipShot | None:
        """Read the shot of a recording; None for a whole clip."""
        first, stop = self.edited.first, self.edited.stop
        if first is None or stop is None:
            return None
        number = int("".join(filter(str.isdigit, self.edited.folder.name)) or 1) - 1
        return read_recording_shot(self.edited.path, self._options, (first, stop), number, self._cache, watcher)

    def _show(self, result: tuple[ClipRun | CourtRun, dict[str, Any]] | None, revision: int) -> None:
        run = self._run if result is None else result[0]
        outputs = "missing" if run is None else self._assess_outputs(run)
        tables = hash_tables(self.edited.folder)
        with self._lock:
            self._stage, self._share, self._outputs, self._tables = "", 0.0, outputs, tables
            if result is not None:
                (self._run, self._view), self._result = result, revision
        self._on_change()

    def _fail(self, sentence: str, revision: int) -> None:
        with self._lock:
            self._stage, self._share = "", 0.0
            if revision == self._file.revision:
                self._error = sentence
        self._on_change()

    def _note_progress(self, revision: int, stage: str, share: float) -> None:
        """Note the progress of the run of a revision; stop it if it is out of date."""
        with self._lock:
            if self._is_closed or self._file.revision != revision:
                self._stage = ""
                raise SupersededError
            self._stage, self._share = stage, share


def _describe(run: ClipRun | CourtRun, before: ClipRun | CourtRun | None, corrections: Corrections) -> dict[str, Any]:
    """Describe a run for the page; one of another kind, after a sport was set, is not compared with it."""
    if isinstance(run, CourtRun):
        return describe_rally_run(run, before if isinstance(before, CourtRun) else None, corrections)
    return describe_run(run, before if isinstance(before, ClipRun) else None, corrections)


def _read_history(path: Path, present: CorrectionsFile) -> tuple[list[Corrections], list[Corrections]]:
    """Read what can be undone and redone; nothing where the file is missing, damaged or of other corrections."""
    with suppress(OSError, ValueError, TypeError, RecursionError):
        revision, *lists = json.loads(path.read_bytes())
        (noted,), undo, redo = (
            [parse_corrections({"schema": SCHEMA, **one}).corrections for one in steps] for steps in lists
        )
        # a copy of the clip elsewhere has as many changes, perhaps, but others
        if revision == present.revision and noted == present.corrections:
            return undo, redo
    return [], []


class _SessionWatcher:
    """Follows a run for the page."""

    def __init__(self, note: Callable[[str, float], None]) -> None:
        self._note = note
        self.ran: list[str] = []
        """Names of the stages whose result was not cached."""

    def start_stage(self, stage: str) -> Progress:
        """Note that a stage begins."""
        self._note(stage, 0.0)
        return lambda share: self._note(stage, share)

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Note that a stage is done."""
        self._note(stage, 1.0)
        self.ran += [] if cached else [stage]
