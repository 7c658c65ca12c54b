"""The queue of the page: what a killed server leaves, what two servers see of each other, and how jobs end."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.app_requests import list_tree, write_run

from pipeline.app import job_queue
from pipeline.app.job_queue import JobQueue, run_trueroll
from pipeline.app.refusals import Refusal
from pipeline.app.shot_library import ShotLibrary
from pipeline.batch import supervision
from pipeline.batch.clip_job import ClipJob, ClipResult, build_failed_result

LONGEST_S = 60.0


class FakeProcess:
    """Stands in for the process that runs clips: it writes a run folder, or waits until it is closed."""

    jobs: list[ClipJob]
    hold: threading.Event

    def __init__(self) -> None:
        self.closed = threading.Event()

    def prepare(self) -> None:
        """Load nothing."""

    def request_exit(self) -> None:
        self.closed.set()

    close = request_exit

    def run(self, job: ClipJob, listener: Callable[[dict[str, Any]], None]) -> ClipResult:
        type(self).jobs.append(job)
        listener({"stage": "detect", "share": 0.5})
        Path(job.preview).write_bytes(b"jpeg")
        listener({"found": ["0.5 s: The cue ball hits red 3."], "size": [1280, 720]})
        while not (self.hold.is_set() or self.closed.is_set()):
            time.sleep(0.01)
        is_table = "corners" in job.settings and "sport" not in job.settings
        if self.closed.is_set() or ("bad" in job.clip and not is_table):
            return build_failed_result(job.name, "no table was found", remedy="corners")
        write_run(Path(job.folder))
        (Path(job.folder) / "source.json").write_text(json.dumps({"path": job.clip}))
        return replace(build_failed_result(job.name, ""), status="done", folder=job.folder)


@pytest.fixture(autouse=True)
def runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[type[FakeProcess]]:
    """Processes that compute nothing; without `hold` being set, a clip runs until it is cancelled."""
    FakeProcess.jobs, FakeProcess.hold = [], threading.Event()
    FakeProcess.hold.set()
    monkeypatch.setattr(supervision, "SupervisedProcess", FakeProcess)
    monkeypatch.setattr(job_queue, "run_trueroll", lambda *rest: (0, '{"verdict": "go", "sentences": ["Go."]}', []))
    monkeypatch.setattr(job_queue, "POLL_S", 0.02)
    monkeypatch.setenv("TRUEROLL_CACHE", str(tmp_path / "cache"))
    yield FakeProcess
    FakeProcess.hold.set()


@contextmanager
def open_queue(root: Path) -> Iterator[JobQueue]:
    queue = JobQueue(ShotLibrary(root))
    queue.start()
    try:
        yield queue
    finally:
        queue.close()


def wait_for(queue: JobQueue, job: str, **wanted: Any) -> dict[str, Any]:
    """Wait until a job has these values."""
    end = time.monotonic() + LONGEST_S
    while time.monotonic() < end:
        found = next((one for one in queue.describe() if one["id"] == job), {})
        if wanted.items() <= found.items():
            return found
        time.sleep(0.01)
    raise AssertionError(f"{job} has not become {wanted}: {queue.describe()}")


def write_clip(root: Path, name: str = "break.mp4") -> Path:
    path = root / "films" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"clip")
    return path


def test_a_clip_becomes_a_card_and_says_first_what_it_has_found(tmp_path: Path, runs: type[FakeProcess]) -> None:
    with open_queue(tmp_path / "library") as queue:
        runs.hold.clear()
        job = queue.add_clip(write_clip(tmp_path))
        early = wait_for(queue, job["id"], state="running", preview=True, check={"level": "good", "sentences": ["Go."]})
        assert (early["stage"], early["share"], early["shot"]) == ("detect", 0.5, None)
        assert early["found"] == ["0.5 s: The cue ball hits red 3."]
        assert queue.find_preview(job["id"]).read_bytes() == b"jpeg"
        runs.hold.set()
        done = wait_for(queue, job["id"], state="done")
    (card,) = ShotLibrary(tmp_path / "library").list_cards()
    assert (card.id, card.name) == (done["shot"], "break")
    assert runs.jobs[0].settings == {"quick": True}


def test_a_killed_server_leaves_its_jobs_to_the_next(tmp_path: Path, runs: type[FakeProcess]) -> None:
    root, clip = tmp_path / "library", write_clip(tmp_path)
    queue = JobQueue(ShotLibrary(root))
    running, waiting = (queue.add_clip(clip)["id"] for _ in range(2))
    for job, changes in ((running, {"state": "running", "stage": "detect", "check": {"level": "", "sentences": []}}),):
        path = root / ".trueroll-app" / "queue" / f"{job}.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    lost = queue.add_clip(root / "clips" / "lost.mp4")["id"]  # killed before the upload was in its place
    runs.hold.clear()
    with open_queue(root) as later:
        wait_for(later, running, state="running", check={"level": "good", "sentences": ["Go."]})
        runs.hold.set()
        wait_for(later, running, state="done")
        wait_for(later, waiting, state="done")
        assert lost not in [job["id"] for job in later.describe()]
    assert len(runs.jobs) == 2


def test_the_clip_of_a_cancelled_job_goes_when_nobody_can_retry_it(
    tmp_path: Path, runs: type[FakeProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    clips, upload, film = tmp_path / "library" / "clips", write_clip(tmp_path, "upload.mp4"), write_clip(tmp_path)
    with open_queue(tmp_path / "library") as queue:
        runs.hold.clear()
        jobs = queue.add_clip(clips / "upload.mp4", upload)["id"], queue.add_clip(film)["id"]
        for job in jobs:
            queue.cancel(job)
        assert (clips / "upload.mp4").exists()
        runs.hold.set()
        monkeypatch.setattr(job_queue, "KEEP_DONE_S", 0.0)
        end = time.monotonic() + LONGEST_S
        while list((tmp_path / "library" / ".trueroll-app" / "queue").glob("*.json")) and time.monotonic() < end:
            time.sleep(0.01)
        assert (list(clips.iterdir()), film.exists()) == ([], True), "a clip that was named by its path stays"


def test_two_servers_show_one_queue_and_one_of_them_works(tmp_path: Path, runs: type[FakeProcess]) -> None:
    root = tmp_path / "library"
    with open_queue(root) as first:
        runs.hold.clear()
        begun = first.add_clip(write_clip(tmp_path))["id"]
        wait_for(first, begun, state="running")
        with open_queue(root) as second:
            added = second.add_clip(write_clip(tmp_path, "other.mp4"))["id"]
            wait_for(first, added, state="waiting")
            second.cancel(begun)  # that the other one runs
            wait_for(first, begun, state="cancelled")
            wait_for(first, added, state="running")
            runs.hold.set()
            wait_for(second, added, state="done")
            first.close()
            last = second.add_clip(write_clip(tmp_path, "last.mp4"))["id"]
            wait_for(second, last, state="done")  # it has taken over
    assert [Path(job.clip).stem for job in runs.jobs] == ["break", "other", "last"]


def test_a_server_that_ends_leaves_what_runs_waiting(tmp_path: Path, runs: type[FakeProcess]) -> None:
    with open_queue(tmp_path / "library") as queue:
        runs.hold.clear()
        job = queue.add_clip(write_clip(tmp_path))["id"]
        wait_for(queue, job, state="running")
    with open_queue(tmp_path / "library") as queue:
        runs.hold.set()
        wait_for(queue, job, state="done")


def test_failed_clips_are_tried_again_or_dismissed(tmp_path: Path, runs: type[FakeProcess]) -> None:
    root = tmp_path / "library"
    upload = tmp_path / "part"
    with open_queue(root) as queue:
        upload.write_bytes(b"clip")
        job = queue.add_clip(root / "clips" / "bad.mp4", upload)["id"]
        failed = wait_for(queue, job, state="failed")
        assert (failed["error"], failed["shot"]) == ("no table was found", None)
        queue.retry(job)
        wait_for(queue, job, state="failed")
        assert len(runs.jobs) == 2
        queue.dismiss(job)
        assert queue.describe() == []
    assert list((root / "clips").iterdir()) == []


def test_a_clip_on_this_machine_is_never_deleted(tmp_path: Path) -> None:
    clip = write_clip(tmp_path, "bad.mp4")
    with open_queue(tmp_path / "library") as queue:
        job = queue.add_clip(clip)["id"]
        wait_for(queue, job, state="failed")
        queue.dismiss(job)
    assert clip.exists()


def test_what_cannot_be_done_to_a_job_is_refused(tmp_path: Path) -> None:
    queue = JobQueue(ShotLibrary(tmp_path))
    job = queue.add_clip(tmp_path / "a.mp4")["id"]
    with pytest.raises(Refusal):
        queue.retry(job)
    with pytest.raises(Refusal):
        queue.dismiss(job)
    queue.cancel(job)
    with pytest.raises(Refusal, match="ended already"):
        queue.cancel(job)
    for refused in (queue.cancel, queue.retry, queue.dismiss, queue.find_preview):
        with pytest.raises(Refusal, match="no such clip"):
            refused("../../x")
    before = list_tree(tmp_path)
    queue.dismiss(job)
    assert len(list_tree(tmp_path)) == len(before) - 1


def test_clips_with_one_name_get_folders_of_their_own_and_a_second_run_the_same(tmp_path: Path) -> None:
    root = tmp_path / "library"
    places = [tmp_path / "a" / "clips.mp4", tmp_path / "b" / "clips.mp4", tmp_path / ".mp4", tmp_path / "...mp4"]
    with open_queue(root) as queue:
        for clip in (*places, places[0]):
            wait_for(queue, queue.add_clip(clip)["id"], state="done")
    names = sorted(card.name for card in ShotLibrary(root).list_cards())
    assert names == ["clip", "clips-2", "clips-3", "mp4"]


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"id": "../x"}', '{"state": "running"}'])
def test_a_damaged_file_stops_nothing(text: str, tmp_path: Path) -> None:
    root = tmp_path / "library"
    home = root / ".trueroll-app" / "queue"
    home.mkdir(parents=True)
    (home / "damaged.json").write_text(text)
    with open_queue(root) as queue:
        wait_for(queue, queue.add_clip(write_clip(tmp_path))["id"], state="done")


def test_a_command_of_the_program_runs_without_a_shell_and_can_be_stopped() -> None:
    status, output, remarks = run_trueroll(("--version",), LONGEST_S, lambda: False)
    assert status == 0
    assert output.startswith("trueroll ")
    assert remarks == []
    status, _, remarks = run_trueroll(("call", "$(touch x); nowhere"), LONGEST_S, lambda: False)
    assert (status, remarks != []) == (2, True)
    begins = time.monotonic()
    assert run_trueroll(("--version",), LONGEST_S, lambda: True) == (None, "", ["It was stopped."])
    assert run_trueroll(("--version",), 0.0, lambda: False) == (None, "", ["It took more than 0 minutes."])
    assert time.monotonic() - begins < LONGEST_S
    assert not os.path.exists("x")


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


def test_a_clip_whose_table_is_not_found_runs_with_the_corners_that_a_person_marks(
    tmp_path: Path, runs: type[FakeProcess]
) -> None:
    clip = write_clip(tmp_path, "bad.mp4")
    with open_queue(tmp_path / "library") as queue:
        job = queue.add_clip(clip)["id"]
        wait_for(queue, job, state="failed", remedy="corners", preview=True)
        for corners in (
            None,
            3,
            [],
            SQUARE[:3],
            [["a", 0], *SQUARE[1:]],
            [[float("nan"), 0], *SQUARE[1:]],
            [[9, 0], *SQUARE[1:]],
            [[10**400, 0], *SQUARE[1:]],
        ):
            with pytest.raises(Refusal, match="corners"):
                queue.place_corners(job, corners, "")
        queue.place_corners(job, SQUARE, "tennis")
        wait_for(queue, job, state="failed", remedy="corners", preview=True)
        queue.place_corners(job, SQUARE, "")  # a table after all
        wait_for(queue, job, state="done", remedy="")
        with pytest.raises(Refusal, match="has not failed"):
            queue.place_corners(job, SQUARE, "")
    settings = {"quick": True, "corners": "-0.5,-0.5,1279.5,-0.5,1279.5,719.5,-0.5,719.5"}
    assert [one.settings for one in runs.jobs] == [{"quick": True}, settings | {"sport": "tennis"}, settings]


def test_a_full_disk_delays_the_queue_and_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plain, failed = job_queue.write_text, set[str]()

    def write(path: Path, text: str) -> None:
        document = json.loads(text)
        change = "check" if document["check"] and document["check"]["level"] else document["state"]
        if change not in ("waiting", *failed):
            failed.add(change)
            raise OSError(28, "No space left on device")
        plain(path, text)

    queue = JobQueue(ShotLibrary(tmp_path / "library"))
    job = queue.add_clip(write_clip(tmp_path))["id"]
    monkeypatch.setattr(job_queue, "write_text", write)
    monkeypatch.setattr(queue, "_take_up", _raise_once(queue._take_up))
    queue.start()
    try:
        wait_for(queue, job, state="done")
    finally:
        queue.close()
    assert {"running", "done"} <= failed
    assert "No space left on device" in capsys.readouterr().err


def _raise_once(function: Callable[[], None]) -> Callable[[], None]:
    """Let a function fail the first time."""
    errors = [OSError(28, "No space left on device")]

    def call() -> None:
        if errors:
            raise errors.pop()
        function()

    return call


@pytest.mark.parametrize("end", ["close", "cancel", "timeout"])
def test_a_check_that_was_not_finished_calls_no_clip_bad(
    end: str, tmp_path: Path, runs: type[FakeProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = threading.Event()

    def check(
        arguments: object, limit_s: float, is_stopped: Callable[[], bool], *_: object
    ) -> tuple[None, str, list[str]]:
        begun.set()
        while end != "timeout" and not is_stopped():
            time.sleep(0.01)
        return None, "", ["It was stopped." if end != "timeout" else "It took more than 5 minutes."]

    monkeypatch.setattr(job_queue, "run_trueroll", check)
    runs.hold.clear()
    with open_queue(tmp_path / "library") as queue:
        job = queue.add_clip(write_clip(tmp_path))["id"]
        assert begun.wait(LONGEST_S)
        if end == "timeout":
            wait_for(queue, job, state="running", check={"level": "", "sentences": []})
        if end == "cancel":
            queue.cancel(job)
            wait_for(queue, job, check=None)
    (found,) = JobQueue(ShotLibrary(tmp_path / "library")).describe()
    assert found["check"] == ({"level": "", "sentences": []} if end == "timeout" else None)


def test_a_cancelled_clip_keeps_nobody_waiting(
    tmp_path: Path, runs: type[FakeProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()

    def close(process: FakeProcess) -> None:
        released.wait(LONGEST_S)
        process.closed.set()

    monkeypatch.setattr(runs, "close", close)
    with open_queue(tmp_path / "library") as queue:
        runs.hold.clear()
        job = queue.add_clip(write_clip(tmp_path))["id"]
        wait_for(queue, job, state="running", stage="detect")
        queue.cancel(job)
        begins = time.monotonic()
        queue.describe()
        assert time.monotonic() - begins < LONGEST_S / 2
        released.set()


def test_dismissing_keeps_a_clip_that_something_else_needs(tmp_path: Path) -> None:
    root = tmp_path / "library"
    queue = JobQueue(library := ShotLibrary(root))
    messages: list[dict[str, Any]] = []
    library.listeners.append(messages.append)
    clip = root / "clips" / "one.mp4"
    clip.parent.mkdir(parents=True)
    clip.write_bytes(b"clip")
    first, second, third = (queue.add_clip(clip)["id"] for _ in range(3))
    for job in (first, second, third):
        queue.cancel(job)
    queue.dismiss(first)
    assert {"type": "library", "revision": None} in messages  # also other pages show it no longer
    queue.dismiss(second)
    assert clip.exists()  # the third is of the same clip
    write_run(root / "one")  # by another program
    queue.dismiss(third)
    assert clip.exists()


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_the_clip_of_a_renamed_card_stays(state: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root, clip = tmp_path / "library", tmp_path / "library" / "clips" / "one.mp4"
    queue = JobQueue(library := ShotLibrary(root))
    job = queue.add_clip(clip, write_clip(tmp_path))["id"]
    write_run(root / "one")  # the quick result
    (root / "one" / "source.json").write_text(json.dumps({"path": str(clip)}))
    queue._update(job, ("waiting",), state=state)
    library.rename(library.identify(root / "one"), "two")
    monkeypatch.setattr(job_queue, "KEEP_DONE_S", 0.0)
    queue._forget_past()
    if state == "failed":
        queue.dismiss(job)
    assert (queue.describe(), clip.exists()) == ([], True)


def test_past_jobs_are_looked_for_while_others_are_added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    queue = JobQueue(ShotLibrary(tmp_path / "library"))
    queue.add_clip(write_clip(tmp_path))
    adding = list[threading.Thread]()

    def add() -> None:
        with queue._change:
            queue._jobs |= {"new": next(iter(queue._jobs.values()))}

    def is_past(_: object) -> bool:
        if not adding:
            adding.append(threading.Thread(target=add))
            adding[0].start()
            adding[0].join(0.2)
        return False

    monkeypatch.setattr(job_queue, "_is_past", is_past)
    queue._forget_past()
    adding[0].join()


@pytest.mark.parametrize("status", [0, 1])
def test_a_command_that_fails_over_earlier_results_has_failed(
    status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "library"
    remarks = ["fitting a shot", f"Left out: {root}/a.", f"{root}/b failed."]
    monkeypatch.setattr(job_queue, "run_trueroll", lambda *rest: (status, "", remarks))
    for name in ("earlier", "empty"):
        (root / "sessions" / name).mkdir(parents=True)
    (root / "sessions" / "earlier" / "session.json").write_text("{}")
    with open_queue(root) as queue:
        earlier, empty = (queue.add_command("C", ["compare"], root / "sessions" / name)["id"]
                          for name in ("earlier", "empty"))  # fmt: skip
        wait_for(queue, earlier, state="failed" if status else "done", found=["Left out: a."])
        wait_for(queue, empty, state="failed", error="b failed.", found=["Left out: a."])
        for job in (earlier, empty):
            queue.dismiss(job)
    assert [path.name for path in (root / "sessions").iterdir()] == ["earlier"]


def test_no_folder_is_deleted_that_an_open_job_writes(tmp_path: Path) -> None:
    root, clip = tmp_path / "library", write_clip(tmp_path, "match.mp4")
    places = [root / "match", root / "match" / "shot-0001", root / "other"]
    for place in places:
        write_run(place)
    (root / "match" / "source.json").write_text(json.dumps({"path": str(clip)}))
    queue = JobQueue(library := ShotLibrary(root))
    job = queue.add_clip(clip)["id"]
    for place in places[:2]:
        with pytest.raises(Refusal, match="cancel that first"):
            queue.require_idle(library.identify(place))
    queue.require_idle(library.identify(places[2]))
    queue.cancel(job)
    queue.require_idle(library.identify(places[1]))
