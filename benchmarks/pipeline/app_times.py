"""Measure how long the page of `trueroll app` lets one wait, in CPU seconds.

    python -m benchmarks.pipeline.app_times [--quick] [CLIP]

The server is started as a process. Measured are: the page and its library of 2,000 shots; the first answer of a clip
after its upload, in the process that runs it, against the answer of `trueroll run --quick`, both with an empty cache;
the slowest of some questions, and of some moves of a slider, in the process that answers, once it has loaded its code;
and the memory of 50 uploads at once. The clip is that of `run_cost`, 5 s long. CPU times depend less on the load of the
machine than wall-clock times; on idle cores both are alike, because nothing here waits.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

import psutil

from benchmarks.pipeline.run_cost import SECONDS, default_clip, write_repeated
from benchmarks.support.figures import Figure, add_quick_option, run_quick, state_cost

SHOTS = 2000
UPLOADS, UPLOAD_BYTES = 50, 20_000_000
# s for a process to load what it needs.
WARM_UP_S = 600.0
# Parts of the command lines of the process that runs clips, and of the one that answers questions.
RUNNER, ANSWERER = "clip_runner", "answer_process"
# Moves of a slider.
MOVES = 10
SCENE = {"scene": "billiards", "table": {"name": "pool-9ft"}, "clip": {"seconds": 3.0}}
SUMMARY = {"balls": ["cue ball", "red 3"], "sentences": ["The cue ball hit red 3 first."], "trust": {"light": "green"}}


def write_library(folder: Path) -> None:
    """Write what the library reads of its shots."""
    for number in range(SHOTS):
        place = folder / f"shot-{number:04d}"
        place.mkdir(parents=True)
        (place / "scene.json").write_text(json.dumps(SCENE))
        (place / "summary.json").write_text(json.dumps(SUMMARY))


def measure_cpu(process: psutil.Process) -> float:
    """Measure the CPU time of a process so far, s."""
    times = process.cpu_times()
    return float(times.user + times.system)


@contextmanager
def serve(library: Path, cache: Path) -> Iterator[tuple[psutil.Process, SplitResult]]:
    """Serve a library; yield the process and the address of the page."""
    command = [
        sys.executable,
        "-m",
        "trueroll",
        "app",
        "--library",
        str(library),
        "--cache",
        str(cache),
        "--no-browser",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    address = re.search(r"http\S+", process.stderr.readline())
    if address is None:
        raise SystemExit("trueroll app did not start")
    try:
        yield psutil.Process(process.pid), urlsplit(address[0])
    finally:
        process.terminate()
        process.wait()
        process.stderr.close()


def ask(place: SplitResult, method: str, path: str, body: bytes = b"") -> bytes:
    """Send a request to the server; return the content of its answer."""
    connection = http.client.HTTPConnection(str(place.hostname), place.port)
    connection.request(method, place.path + path, body)
    content = connection.getresponse().read()
    connection.close()
    return content


def measure_library(folder: Path) -> tuple[float, float, float]:
    """Measure the CPU time, s, until the page and its library are there at the second start, and of a further listing.

    Returns:
        Both times, and the memory of the server, MiB.
    """
    write_library(folder / "library")
    for _ in range(2):
        with serve(folder / "library", folder / "cache") as (server, place):
            ask(place, "GET", "")
            ask(place, "GET", "api/library")
            up = measure_cpu(server)
            wait_until_warm(server, RUNNER)
            before = measure_cpu(server)
            for _ in range(10):
                ask(place, "GET", "api/library")
            again = (measure_cpu(server) - before) / 10
            memory = server.memory_info().rss / 2**20
    return up, again, memory


def wait_until_warm(server: psutil.Process, name: str) -> psutil.Process:
    """Wait until a process of the server has loaded everything and does nothing more; return it."""
    deadline = threading.Event()
    for _ in range(int(WARM_UP_S)):
        workers = [one for one in server.children() if name in " ".join(one.cmdline())]
        if workers:
            before = measure_cpu(workers[0])
            deadline.wait(3.0)
            if before > 1 and measure_cpu(workers[0]) - before < 0.02:
                return workers[0]
        deadline.wait(1.0)
    raise SystemExit(f"the process {name} does not get ready")


def measure_first_answer(clip: Path, folder: Path) -> float:
    """Measure the CPU time, s, of the process that runs a clip, from the upload to the first contact on the page."""
    with serve(folder / "library", folder / "cache") as (server, place):
        worker = wait_until_warm(server, RUNNER)
        before = measure_cpu(worker)
        connection = http.client.HTTPConnection(str(place.hostname), place.port)
        connection.request("GET", f"{place.path}api/events")
        events = connection.getresponse()
        ask(place, "POST", "api/clips?name=clip.mp4", clip.read_bytes())
        for line in events:
            message = json.loads(line[5:]) if line.startswith(b"data:") else {}
            if message.get("state") == "failed":
                raise SystemExit(f"the clip failed: {message['error']}")
            if message.get("found"):
                return measure_cpu(worker) - before
    raise SystemExit("the server ended before the answer")


def measure_run_answer(clip: Path, folder: Path) -> float:
    """Measure the CPU time, s, of the main process of `trueroll run --quick` until it prints its answer."""
    places = ["-o", str(folder / "runs" / "shot"), "--cache", str(folder / "run cache")]
    command = [sys.executable, "-m", "trueroll", "run", str(clip), "--quick", *places]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    process.stdout.readline()
    spent = measure_cpu(psutil.Process(process.pid))
    process.terminate()
    process.wait()
    return spent


def measure_answers(folder: Path) -> tuple[float, float]:
    """Measure the CPU time, s, of the slowest question about a shot, and of the slowest path that a slider changes."""
    with serve(folder / "runs", folder / "run cache") as (server, place):
        (card,) = json.loads(ask(place, "GET", "api/library"))["shots"]
        shot = f"api/shots/{card['id']}"
        first, *others = (ball["id"] for ball in json.loads(ask(place, "GET", shot))["run"]["balls"])
        process = wait_until_warm(server, ANSWERER)
        questions = [{"question": "touch", "a": first, "b": other} for other in others]
        moves = [{"speed_percent": k + 1, "is_quick": True} for k in range(MOVES)]
        asked, moved = (
            measure_requests(process, place, f"{shot}/{name}", bodies, wanted)
            for name, bodies, wanted in (("ask", questions, "verdict"), ("what-if", moves, "paths"))
        )
    return max(asked), max(moved)


def measure_requests(
    process: psutil.Process, place: SplitResult, path: str, bodies: Sequence[object], wanted: str
) -> list[float]:
    """Measure the CPU time, s, that a process takes for each of some requests, whose answers have a key."""
    times = []
    for body in bodies:
        before = measure_cpu(process)
        answer = json.loads(ask(place, "POST", path, json.dumps(body).encode()))
        times.append(measure_cpu(process) - before)
        if wanted not in answer:
            raise SystemExit(f"{path} {body}: {answer}")
    return times


def measure_uploads(folder: Path) -> float:
    """Measure by how much the memory of the server grows with many uploads at once, MiB."""
    clip = bytes(4) + b"ftypisom" + os.urandom(UPLOAD_BYTES)
    with serve(folder / "uploads", folder / "cache") as (server, place):
        wait_until_warm(server, RUNNER)
        before = server.memory_info().rss
        peak, is_over = [before], threading.Event()

        def watch() -> None:
            while not is_over.wait(0.01):
                peak[0] = max(peak[0], server.memory_info().rss)

        threads = [threading.Thread(target=ask, args=(place, "POST", "api/clips?name=a.mp4", clip))
                   for _ in range(UPLOADS)]  # fmt: skip
        watcher = threading.Thread(target=watch)
        watcher.start()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        is_over.set()
        watcher.join()
    return (peak[0] - before) / 2**20


def measure_figures(source: Path) -> list[Figure]:
    """Measure the figures of the documentation."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = folder / "clip.mp4"
        write_repeated(source, clip, SECONDS)
        up, again, memory = measure_library(folder / "many")
        first = measure_first_answer(clip, folder)
        run = measure_run_answer(clip, folder)
        question, move = measure_answers(folder)
        growth = measure_uploads(folder)
    return [
        state_cost(f"page up, with {SHOTS:,} shots", up, "s", 1),
        state_cost(f"{SHOTS:,} shots listed again", 1000 * again, "ms", 10),
        state_cost("memory of the server", memory, "MiB", 1, 1.25),
        state_cost("first contact on the page, after the upload", first, "s", 1),
        state_cost("answer of `trueroll run --quick`", run, "s", 1),
        state_cost("slowest question", question, "s", 1),
        state_cost("slowest path after a move of a slider", move, "s", MOVES),
        state_cost(f"memory that {UPLOADS} uploads of 20 MB at once take", growth, "MiB", 1),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("clip", nargs="?", type=Path, help="a short clip; default: the largest 720p sample")
    arguments = parser.parse_args()
    source = arguments.clip or default_clip()
    inputs = f"{SECONDS:g} s of `{source.name}`, compiled code cached; CPU times, in the process that answers"
    if arguments.quick:
        run_quick("pipeline.app_times", lambda: measure_figures(source), inputs, alone=True)
        return 0
    print(inputs)
    for figure in measure_figures(source):
        print(f"{figure.name}: {figure.value:.3g} {figure.unit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
