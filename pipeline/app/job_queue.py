"""The queue of clips and commands: a file per job, worked on by one server at a time in processes of its own.

The files are the only state. Several servers may show one queue and add to it; the one that holds the lock works on it.
A server that is killed loses the lock, and what it had begun is taken up again.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from filelock import FileLock, Timeout

from pipeline.app.refusals import Refusal
from pipeline.app.shot_library import CLIP_FOLDER, RELOAD, ShotLibrary
from pipeline.engine.atomic_write import remove_leftovers, write_text
from pipeline.terminal.command_line import print_note

if TYPE_CHECKING:
    from pipeline.batch.supervision import SupervisedProcess

# s between two looks for changes by other servers.
POLL_S = 0.5
# s after which a job that is done or was cancelled leaves the list: its card shows the result.
KEEP_DONE_S = 600.0
# Longest time of a command, s, and time for one to end, s.
COMMAND_LIMIT_S, EXIT_S = 3600.0, 3.0
# Longest time of the check of a clip, s; a long recording takes half a minute.
CHECK_LIMIT_S = 300.0
# Settings of every run: the answers come first, and the slow motion after them is encoded faster.
RUN_SETTINGS = {"quick": True}
OPEN_STATES, ENDED_STATES = ("waiting", "checking", "running"), ("done", "failed", "cancelled")
# How sentences begin that a command says beside its result; others on standard error are its progress.
REMARKS = ("Left out: ", "Note: ")
UNKNOWN_CHECK: dict[str, Any] = {"level": "", "sentences": []}
CHECK_LEVELS = {"go": "good", "doubts": "usable", "no-go": "bad"}

V = TypeVar("V")


@dataclass(frozen=True, slots=True)
class Job:
    """A clip to run, or a command on several shots."""

    id: str
    name: str
    folder: str
    """Of the results, as a path within the library."""
    clip: str = ""
    """Absolute path; empty for a command."""
    arguments: tuple[str, ...] = ()
    """Of a command."""
    state: str = "waiting"
    """waiting, checking, running, done, failed or cancelled."""
    stage: str = ""
    share: float = 0.0
    """Finished share of the stage."""
    check: dict[str, Any] | None = None
    """How the clip is filmed: `level` (good, usable, bad) and `sentences`."""
    findings: tuple[str, ...] = ()
    """First results in sentences; of a command, what it said beside its result."""
    preview_revision: int = 0
    """Counts the images of first results."""
    frame_size: tuple[int, int] = (0, 0)
    """Width and height of a frame of the clip, px; 0 before it was read."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings of the run by their names, which a person gave after it had failed."""
    error: str = ""
    remedy: str = ""
    """What a person could do about the error; see `ClipResult`."""
    ended: float = 0.0
    """s since 1970; 0 before the end."""


class JobQueue:
    """The queue of one library; safe to use from several threads."""

    def __init__(self, library: ShotLibrary) -> None:
        self._library = library
        self._home = library.own / "queue"
        self._change = threading.Condition(threading.RLock())
        self._jobs: dict[str, Job] = {}
        self._states: dict[str, tuple[int, int]] = {}
        self._writer_lock = FileLock(self._home / ".change.lock")
        self._worker_lock = FileLock(self._home / ".work.lock", thread_local=False)
        self._is_closed = False
        self._running = ""
        self._process: SupervisedProcess | None = None
        self._closing: threading.Thread | None = None
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Start to work on the queue, or to wait until the server that does so ends."""
        self._home.mkdir(parents=True, exist_ok=True)
        remove_leftovers(self._home)
        self._start_thread(self._watch)

    def close(self) -> None:
        """Stop the work; what is not done is taken up again at the next start."""
        with self._change:
            self._is_closed = True
            self._change.notify_all()
            if self._process is not None:
                self._process.request_exit()
        for thread in self._threads:
            thread.join(EXIT_S)
        self._worker_lock.release()

    def describe(self) -> list[dict[str, Any]]:
        """Describe all jobs for the page, in their order."""
        with self._change:
            self._poll()
            return [self._describe_job(job) for _, job in sorted(self._jobs.items()) if not _is_past(job)]

    def list_running(self) -> set[str]:
        """List the ids of the cards whose folders are being written."""
        with self._change:
            return {self._identify(job) for job in self._jobs.values() if job.state == "running"}

    def require_idle(self, shot: str) -> None:
        """Require that no job that is open writes to the folder of a card, or around or within it; raises Refusal."""
        folder = self._library.find_folder(shot)
        with self._change:
            self._poll()
            busy = [self._library.root / job.folder for job in self._jobs.values() if job.state in OPEN_STATES]
        if any(one.is_relative_to(folder) or folder.is_relative_to(one) for one in busy):
            raise Refusal(409, "This shot is being computed, or will be; cancel that first.")

    def _describe_job(self, job: Job) -> dict[str, Any]:
        """Describe a job for the page."""
        shot = self._identify(job) if self._library.has_card(self._identify(job)) else None
        own = {
            key: value
            for key, value in asdict(job).items()
            if key not in ("clip", "arguments", "folder", "ended", "findings", "frame_size", "settings")
        }
        action = job.arguments[0] if job.arguments else ""
        return {**own, "action": action, "found": list(job.findings), "preview": job.preview_revision > 0, "shot": shot}

    def _identify(self, job: Job) -> str:
        return self._library.identify(self._library.root / job.folder)

    def find_preview(self, job: str) -> Path:
        """Find the image of the first results of a job; raises Refusal."""
        path = self._home / f"{self._find(job).id}.jpg"
        if not path.is_file():
            raise Refusal(404, "This clip has no image yet.")
        return path

    # Changes, each of which is one file that is replaced.

    def add_clip(self, clip: Path, upload: Path | None = None) -> dict[str, Any]:
        """Add a clip.

        Args:
            clip: Its absolute path.
            upload: A file that is moved there; where there is another clip already, beside it.

        Returns:
            The job as the page knows it.
        """
        with self._exclude_others():
            wanted, number = clip, 1
            while upload is not None and clip.exists():
                number += 1
                clip = wanted.with_name(f"{wanted.stem}-{number}{wanted.suffix}")
            job = Job(_make_id(), clip.name, self._choose_folder(clip), str(clip))
            self._write(job)  # first: a job without its clip is dropped at the next start
            if upload is not None:
                clip.parent.mkdir(parents=True, exist_ok=True)
                os.replace(upload, clip)
        return self._describe_job(job)

    def add_command(self, name: str, arguments: Sequence[str], folder: Path) -> dict[str, Any]:
        """Add a command of trueroll.

        Args:
            name: What the page calls it.
            arguments: The words after `trueroll`.
            folder: Folder of the library in which it writes its results.

        Returns:
            The job as the page knows it.
        """
        with self._exclude_others():
            place = folder.absolute().relative_to(self._library.root).as_posix()
            job = Job(_make_id(), name, place, arguments=tuple(arguments))
            self._write(job)
        return self._describe_job(job)

    def cancel(self, job: str) -> dict[str, Any]:
        """Cancel a job that has not ended; raises Refusal."""
        return self._end(job, OPEN_STATES, "This has ended already.", state="cancelled", ended=time.time())

    def retry(self, job: str, settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Put a job that failed or was cancelled into the queue again; raises Refusal.

        Args:
            job: Its id.
            settings: New settings of its run, by their names; None for those of the last try.
        """
        changes = {} if settings is None else {"settings": settings}
        return self._end(job, ("failed", "cancelled"), "This has not failed.", state="waiting", error="", remedy="",
                         ended=0.0, stage="", share=0.0, findings=(), **changes)  # fmt: skip

    def place_corners(self, job: str, corners: object, sport: object) -> dict[str, Any]:
        """Run a clip again with the corners of its table or court.

        Args:
            job: Its id.
            corners: Four pairs of numbers, shares of the width and the height of the frame.
            sport: Name of the sport; None where the program may decide.

        Returns:
            The job as the page knows it.

        Raises:
            Refusal: The corners are no such numbers, or the job has not failed after its clip was read.
        """
        width, height = self._find(job).frame_size
        try:
            places = [(float(x) * width - 0.5, float(y) * height - 0.5) for x, y in corners]  # type: ignore[attr-defined]
        except (TypeError, ValueError, OverflowError) as error:
            raise Refusal(422, "corners are four pairs of numbers.") from error
        if (
            len(places) != 4
            or not width
            or not all(-width < x < 2 * width and -height < y < 2 * height for x, y in places)
        ):
            raise Refusal(422, "The four corners of the playing surface in the frame were expected.")
        settings = {"corners": ",".join(f"{value:.1f}" for place in places for value in place)}
        if isinstance(sport, str) and sport:
            settings["sport"] = sport[:64]
        return self.retry(job, settings)

    def dismiss(self, job: str) -> None:
        """Remove a job that has ended, with the uploaded clip if nothing came of it; raises Refusal."""
        with self._exclude_others():
            old = self._find(job)
            if old.state in OPEN_STATES:
                raise Refusal(409, "This is not finished; cancel it first.")
            self._forget(old)

    def _forget(self, job: Job) -> None:
        """Remove a job that has ended, with the uploaded clip if nothing came of it. The caller excludes others."""
        self._library.refresh()
        clip, others = Path(job.clip), [one for one in self._jobs.values() if one.id != job.id]
        if job.state != "done" and clip.parent == self._library.clips and not (
            self._has_card(job) or any(one.clip == job.clip for one in others) or self._library.is_clip_used(clip)
        ):  # fmt: skip
            clip.unlink(missing_ok=True)
        self._remove(job)

    def _forget_past(self) -> None:
        """Remove the jobs that the page shows no more: nobody can retry them, so their clips would stay for ever."""
        with self._change:
            has_past = any(map(_is_past, self._jobs.values()))
        if has_past:
            with self._exclude_others():
                for job in list(self._jobs.values()):
                    if _is_past(job):
                        self._forget(job)

    def _end(self, job: str, states: Sequence[str], refusal: str, **changes: Any) -> dict[str, Any]:
        """Change a job that is in one of some states; raises Refusal."""
        changed = self._update(self._find(job).id, states, **changes)
        if changed is None:
            raise Refusal(409, refusal)
        return self._describe_job(changed)

    def _find(self, job: str) -> Job:
        """Find a job; raises Refusal."""
        with self._change:
            self._poll()
            if job not in self._jobs:
                raise Refusal(404, "There is no such clip in the queue.")
            return self._jobs[job]

    def _update(self, job: str, states: Sequence[str], **changes: Any) -> Job | None:
        """Change a job if it is in one of some states; return it, or None if it is not."""
        with self._exclude_others():
            old = self._jobs.get(job)
            if old is None or old.state not in states:
                return None
            new = replace(old, **changes)
            if new != old:
                self._write(new)
        return new

    @contextmanager
    def _exclude_others(self) -> Iterator[None]:
        """Exclude other threads and servers while jobs are read and changed."""
        self._home.mkdir(parents=True, exist_ok=True)
        with self._change, self._writer_lock:
            self._poll()
            yield
            self._poll()

    def _write(self, job: Job) -> None:
        write_text(self._home / f"{job.id}.json", json.dumps(asdict(job)))

    def _remove(self, job: Job) -> None:
        for suffix in (".jpg", ".json"):
            (self._home / f"{job.id}{suffix}").unlink(missing_ok=True)
        if job.arguments:
            with suppress(OSError):  # it holds results
                (self._library.root / job.folder).rmdir()

    def _has_card(self, job: Job) -> bool:
        return self._library.has_card(self._identify(job))

    def _choose_folder(self, clip: Path) -> str:
        """Choose the folder of a clip: that of its earlier run, or a new one that is named after it."""
        stem = clip.stem.strip(". ") or "clip"  # folders with hidden names are not listed
        taken = {CLIP_FOLDER, *(job.folder for job in self._jobs.values() if job.clip != str(clip))}
        for number in range(1, 1_000_000):
            name = stem if number == 1 else f"{stem}-{number}"
            folder = self._library.root / name
            if name not in taken and (not folder.exists() or self._library.read_clip(folder) == clip):
                return name
        raise Refusal(409, f"There are too many clips with the name {stem}.")

    def _poll(self) -> None:
        """Read the files that have changed, and tell pages and workers of them. The caller holds the lock."""
        states: dict[str, tuple[int, int]] = {}
        with suppress(OSError), os.scandir(self._home) as entries:
            for entry in entries:
                if entry.name.endswith(".json") and not entry.name.startswith("."):
                    facts = entry.stat(follow_symlinks=False)
                    states[entry.name[:-5]] = (facts.st_mtime_ns, facts.st_ino)
        before, self._states = self._states, states
        for gone in self._jobs.keys() - states.keys():
            del self._jobs[gone]
        for job, state in states.items():
            if before.get(job) != state and (read := _read_job(self._home / f"{job}.json")) is not None:
                self._jobs[job] = read
                self._library.announce(type="job", **self._describe_job(read))
        if before.keys() - states.keys():
            self._library.announce(**RELOAD)
        is_closing = self._closing is not None and self._closing.is_alive()
        if self._running and self._is_stopped(self._running) and self._process is not None and not is_closing:
            self._closing = threading.Thread(target=self._process.close, daemon=True)  # it takes s, under a lock
            self._closing.start()
        if before != states:
            self._change.notify_all()

    def _is_stopped(self, job: str) -> bool:
        """Whether a job that this server began is not wanted any more."""
        return self._is_closed or job not in self._jobs or self._jobs[job].state != "running"

    # Work.

    def _start_thread(self, target: Callable[[], None]) -> None:
        thread = threading.Thread(target=target, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _insist(self, action: Callable[[], V]) -> V | None:
        """Take an action again until no error, such as that of a full disk, prevents it; None at the end."""
        shown = ""
        while True:
            try:
                return action()
            except Exception as fault:  # no error may stop the queue
                sentence = f"The queue of clips waits: {type(fault).__name__}: {fault}"
                if sentence != shown:
                    print_note(sentence)
                shown = sentence
            with self._change:
                if self._change.wait_for(lambda: self._is_closed, POLL_S):
                    return None

    def _watch(self) -> None:
        """Follow what other servers do, and work on the queue as soon as none of them does."""
        while not self._is_closed:
            self._insist(self.describe)
            if not self._worker_lock.is_locked:
                with suppress(Timeout):
                    self._worker_lock.acquire(timeout=0)
                    self._insist(self._take_up)
                    self._start_thread(self._work)
                    self._start_thread(self._check_clips)
            else:
                self._insist(self._forget_past)
            with self._change:
                self._change.wait(POLL_S)

    def _take_up(self) -> None:
        """Take up what a server has left: what had begun begins again, and what never became whole goes."""
        with self._exclude_others():
            for job in list(self._jobs.values()):
                is_open, is_upload = job.state in OPEN_STATES, Path(job.clip).parent == self._library.clips
                if is_open and is_upload and not Path(job.clip).exists():
                    self._remove(job)
                elif is_open:
                    check = job.check if job.check != UNKNOWN_CHECK else None
                    self._write(replace(job, state="waiting", stage="", share=0.0, check=check))

    def _take_next(self, fits: Callable[[Job], bool], **changes: Any) -> Job | None:
        """Wait for the next job that fits and change it; None at the end."""
        with self._change:
            while not self._is_closed:
                job = next((job for _, job in sorted(self._jobs.items()) if fits(job)), None)
                if job is not None and (taken := self._update(job.id, (job.state,), **changes)) is not None:
                    return taken
                self._change.wait(POLL_S)
        return None

    def _work(self) -> None:
        """Run one job after another."""
        from pipeline.batch.supervision import SupervisedProcess  # slow to import

        self._process = SupervisedProcess()
        self._process.prepare()
        while (job := self._insist(partial(self._take_next, _is_runnable, state="running"))) is not None:
            self._running = job.id
            try:
                error = self._run_clip(job) if job.clip else self._run_command(job)
            except Exception as fault:  # no job may stop the queue
                error = f"{job.name} failed by a fault of the program ({type(fault).__name__}: {fault})"
            self._running = ""
            if self._insist(partial(self._conclude, job, error)) is False and not self._is_closed:
                self._process.close()  # it was cancelled
                self._process = SupervisedProcess()
                self._process.prepare()
        self._process.close()

    def _conclude(self, job: Job, error: str) -> bool:
        """Note how a job has ended; return whether it was still wanted."""
        self._library.announce_changes()
        changes: dict[str, Any] = {"state": "failed" if error else "done", "error": error, "ended": time.time()}
        if self._is_closed:
            changes = {"state": "waiting", "share": 0.0}
        return self._update(job.id, ("running",), stage="", **changes) is not None

    def _run_clip(self, job: Job) -> str:
        """Run a clip; return why it failed, or nothing."""
        from pipeline.batch.clip_job import ClipJob
        from pipeline.engine.result_cache import open_cache

        cache, image = open_cache(None), self._home / f"{job.id}.jpg"
        folder = self._library.root / job.folder

        def listen(message: dict[str, Any]) -> None:
            changes: dict[str, Any] = {}
            if "found" in message:
                changes = {"findings": tuple(message["found"]), "preview_revision": _measure_change(image),
                           "frame_size": tuple(message["size"])}  # fmt: skip
            elif "shot" in message:
                changes = {"stage": "shot {} of {}".format(*message["shot"]), "share": message["done"]}
            elif "stage" in message:
                share = message["share"]  # NaN where a stage cannot tell
                changes = {"stage": message["stage"], "share": share if math.isfinite(share) else 0.0}
            with suppress(OSError):  # progress that cannot be noted, as on a full disk, does not fail the clip
                if changes and self._update(job.id, ("running",), **changes) is not None and "share" not in changes:
                    self._library.announce_changes()

        assert self._process is not None
        row = self._process.run(
            ClipJob(job.clip, job.name, str(folder), str(cache.root.absolute()), cache.mark,
                    {**RUN_SETTINGS, **job.settings}, preview=str(image), for_page=True), listen,
        )  # fmt: skip
        if row.status == "failed":
            self._update(job.id, ("running",), remedy=row.remedy)
            return row.sentence or "It failed."
        return ""

    def _run_command(self, job: Job) -> str:
        """Run a command; return why it failed, or nothing."""
        status, _, remarks = run_trueroll(job.arguments, COMMAND_LIMIT_S, lambda: self._is_stopped(job.id))
        remarks = [
            sentence.replace(f"{self._library.root}/", "") for sentence in remarks
        ]  # folders as the cards name them
        self._library.announce_changes()
        self._update(job.id, ("running",), findings=tuple(one for one in remarks if one.startswith(REMARKS)))
        return "" if status == 0 and self._has_card(job) else remarks[-1] if remarks else "The command wrote no result."

    def _check_clips(self) -> None:
        """Check how clips are filmed, one after another, beside what runs."""
        while (job := self._insist(partial(self._take_next, _is_unchecked, check=UNKNOWN_CHECK))) is not None:
            self._insist(partial(self._check_clip, job))

    def _check_clip(self, job: Job) -> None:
        """Check how a clip is filmed; a check that was stopped begins again when the clip is wanted again."""

        def is_stopped() -> bool:
            return self._is_closed or job.id not in self._jobs or self._jobs[job.id].state not in OPEN_STATES

        self._update(job.id, ("waiting",), state="checking")
        result = run_trueroll(("check", "--json", job.clip), CHECK_LIMIT_S, is_stopped, 10)
        was_stopped = result[0] is None and is_stopped()
        self._update(job.id, OPEN_STATES + ENDED_STATES, check=None if was_stopped else _parse_check(*result))
        self._update(job.id, ("checking",), state="waiting")


def _make_id() -> str:
    """Make an id; ids are in the order of time."""
    return f"{time.time_ns():016x}{secrets.token_hex(4)}"


def _is_past(job: Job) -> bool:
    """Whether a job has ended so long ago that its card alone is shown; a failure stays until it is dismissed."""
    return job.state in ("done", "cancelled") and time.time() - job.ended > KEEP_DONE_S


def _is_runnable(job: Job) -> bool:
    return job.state in ("waiting", "checking")


def _is_unchecked(job: Job) -> bool:
    return bool(job.clip) and job.check is None and job.state in OPEN_STATES


def _read_job(path: Path) -> Job | None:
    """Read a job; None where the file is damaged or has just gone."""
    with suppress(OSError, ValueError, TypeError, KeyError, RecursionError):
        document = json.loads(path.read_bytes())
        lists = {name: tuple(document[name]) for name in ("arguments", "findings", "frame_size") if name in document}
        job = Job(**{**document, **lists})
        return job if job.id == path.stem and job.state in OPEN_STATES + ENDED_STATES else None
    return None


def _measure_change(image: Path) -> int:
    """Return when an image was written, as a whole number that grows; 0 for none."""
    with suppress(OSError):
        return image.stat().st_mtime_ns // 1_000_000
    return 0


def _parse_check(status: int | None, output: str, remarks: Sequence[str]) -> dict[str, Any]:
    """Parse what `trueroll check --json` printed; a clip that it refuses is bad, and one that takes long unknown."""
    if status is None:
        return UNKNOWN_CHECK
    with suppress(ValueError, KeyError, TypeError):
        document = json.loads(output)
        return {"level": CHECK_LEVELS[document["verdict"]], "sentences": list(document["sentences"])}
    return {"level": "bad", "sentences": [*remarks[-1:]] or ["This clip could not be checked."]}


def run_trueroll(
    arguments: Sequence[str], limit_s: float, is_stopped: Callable[[], bool], niceness: int = 0
) -> tuple[int | None, str, list[str]]:
    """Run a command of trueroll in a process of its own, which ends with this function.

    Args:
        arguments: The words after `trueroll`; no shell reads them.
        limit_s: Longest time, s.
        is_stopped: Whether it is no longer wanted; asked again and again.
        niceness: How much the process gives way to others.

    Returns:
        Its exit status, its output, and its sentences on standard error, of which the last says why it failed; the
        status is None if it was stopped.
    """
    root = str(Path(__file__).resolve().parents[2])
    start = f"import sys; sys.path.insert(0, {root!r}); from pipeline.cli.main import main; main()"
    began, sentence = time.monotonic(), ""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        process = subprocess.Popen([sys.executable, "-c", start, *arguments], stdin=subprocess.DEVNULL,
                                   stdout=output, stderr=errors)  # fmt: skip
        if niceness and hasattr(os, "setpriority"):
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, process.pid, niceness)
        try:
            while process.poll() is None and not sentence:
                if is_stopped():
                    sentence = "It was stopped."
                elif time.monotonic() - began > limit_s:
                    sentence = f"It took more than {limit_s / 60:.0f} minutes."
                time.sleep(0.05)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(EXIT_S)
            process.kill()
            process.wait()
        output.seek(0)
        errors.seek(0)
        lines = errors.read().decode("utf-8", "replace").splitlines()
        remarks = [line.strip().removeprefix("trueroll: ") for line in lines if line.strip()]
        status = None if sentence else process.returncode
        return status, output.read().decode("utf-8", "replace"), [*remarks, sentence] if sentence else remarks
