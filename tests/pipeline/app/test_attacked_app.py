"""The program `trueroll app` under attack: every request gets one sentence, nothing else happens, memory stays."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from http.client import HTTPResponse
from pathlib import Path
from random import Random
from urllib.parse import quote, unquote

import psutil
import pytest
from support.app_processes import LONGEST_S, RunningApp, run_app
from support.app_requests import MP4_HEADER, PATH_TRICKS, list_tree, write_run

UPLOADS, PART = 50, bytes(65536)
PARTS = 60
"""Of each upload; all uploads together have 197 MB."""
GROWTH_BYTES, UPLOAD_GROWTH_BYTES = 15e6, 110e6
"""By how much the resident memory of the server may grow when all attacks are repeated, and during all uploads."""
HUGE = 10_000_000_000
"""Size of a sparse file, bytes."""


@dataclass(frozen=True)
class Attack:
    """A request, and which statuses refuse it."""

    name: str
    content: bytes
    statuses: frozenset[int]


@dataclass(frozen=True)
class Target:
    """A running server with one shot, beside a file that is none of its business."""

    app: RunningApp
    home: Path
    shot: str

    def write(self, method: str, path: str, body: bytes = b"", **headers: str) -> bytes:
        """Write a request; a path without a slash at its start is below the secret address."""
        place = path if path.startswith("/") else self.app.place.path + path
        named = {"Host": self.app.place.netloc, "Connection": "close", "Content-Length": str(len(body))}
        named |= {name.replace("_", "-"): value for name, value in headers.items()}
        lines = [f"{method} {place} HTTP/1.1", *(f"{name}: {value}" for name, value in named.items()), "", ""]
        return "\r\n".join(lines).encode("latin-1") + body

    def send(self, content: bytes) -> tuple[int, bytes]:
        """Send bytes and end; return status and content of the answer."""
        with socket.create_connection((str(self.app.place.hostname), self.app.place.port or 80), LONGEST_S) as line:
            line.sendall(content)
            answer = HTTPResponse(line)
            answer.begin()
            return answer.status, answer.read()


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    home = tmp_path_factory.mktemp("attacked")
    (home / "secret.txt").write_text("secret")
    write_run(home / "library" / "break")
    with run_app(home / "library", home / "cache") as app:
        (card,) = app.ask("GET", "api/library")[1]["shots"]
        yield Target(app, home, card["id"])


def list_attacks(target: Target) -> Iterator[Attack]:
    """List the attacks of all kinds."""
    yield from list_foreign_pages(target)
    yield from list_path_tricks(target)
    yield from list_ranges(target)
    yield from list_bodies(target)
    yield from list_protocol_faults(target)
    yield from list_random_requests(target, Random(0), 100)


def list_foreign_pages(target: Target) -> Iterator[Attack]:
    """List what pages of other servers and who has seen an old address can send."""
    port, token = target.app.place.port, target.app.place.path.strip("/")
    for host in ("evil.example", f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", "127.0.0.1", "127.0.0.1:80",
                 f"[::1]:{port}", f"192.168.1.5:{port}", "", f"127.0.0.1:{port}@evil.example"):  # fmt: skip
        yield Attack(f"host {host}", target.write("GET", "api/library", Host=host), frozenset({400}))
    changes = ("POST api/clips?name=a.mp4", "POST api/paths", f"DELETE api/shots/{target.shot}", "DELETE api/trash",
               "POST api/lan/code", "POST api/jobs/1/cancel", f"POST api/shots/{target.shot}/finish")  # fmt: skip
    for origin in ("http://evil.example", "null", "http://127.0.0.1:9", f"https://127.0.0.1:{port}",
                   f"http://localhost:{port}", "", "file://"):  # fmt: skip
        for change in changes:
            method, path = change.split(" ")
            content = target.write(method, path, MP4_HEADER, Origin=origin)
            yield Attack(f"origin {origin} {change}", content, frozenset({403}))
    for other in ("", "x" * 24, token[:-1], token + "x", token.swapcase(), f"%2e/{token}", token[::-1], f"{token}%00"):
        for path in ("", "api/library", f"api/shots/{target.shot}/file/scene.json"):
            yield Attack(f"token {other}", target.write("GET", f"/{other}/{path}"), frozenset({404}))


def list_path_tricks(target: Target) -> Iterator[Attack]:
    """List paths out of the library."""
    refused = frozenset({404, 405})
    for trick in (quote(one, safe="/%~") for one in PATH_TRICKS):
        for path in (f"api/shots/{trick}/thumbnail", f"api/shots/{target.shot}/file/{trick}", trick,
                     f"api/jobs/{trick}/preview", f"api/shots/{target.shot}/shared/{trick}"):  # fmt: skip
            yield Attack(f"path {path[:60]}", target.write("GET", path), refused)
        yield Attack(f"delete {trick[:60]}", target.write("DELETE", f"api/shots/{trick}"), refused)
        body = json.dumps({"name": unquote(trick)}).encode()
        if trick != "~":  # a good name
            content = target.write("PUT", f"api/shots/{target.shot}/name", body)
            yield Attack(f"rename {trick[:60]}", content, frozenset({409, 422}))
        yield Attack(f"restore {trick[:60]}", target.write("POST", f"api/trash/{trick}/restore"), refused)


def list_ranges(target: Target) -> Iterator[Attack]:
    """List parts of a file that are none."""
    for part in ("bytes", "bytes=", "bytes=-", "bytes=--1", "bytes=9-1", "bytes=a-b", "bytes=1-2-3", "items=0-1",
                 "=0-1", "bytes=5000-", "bytes=5000-6000", "bytes=0x1-2", "bytes=\xb2-\xb3", "bytes=1e1-20",
                 "bytes=99999999999999999999-"):  # fmt: skip
        content = target.write("GET", f"api/shots/{target.shot}/file/slow.mp4", Range=part)
        yield Attack(f"range {part}", content, frozenset({200, 400, 416}))


def list_bodies(target: Target) -> Iterator[Attack]:
    """List bodies that are no answer to what was asked for."""
    values = (b"null", b"[]", b"3", b"{", b"[" * 5000, b"\xff\xfe", b'{"a": NaN', b'"\\ud800"', bytes(2_100_000))
    own = f"api/shots/{target.shot}"
    for path in ("api/paths", "api/sessions", f"{own}/ask", f"{own}/what-if", f"{own}/predict", f"{own}/share"):
        for value in values:
            statuses = frozenset({413, 422})
            yield Attack(f"body {path} {value[:9]!r}", target.write("POST", path, value), statuses)
    for name in ("", ".mp4", "a", "a.m p4", "\0.mp4", "a." + "x" * 20):
        content = target.write("POST", f"api/clips?name={quote(name)}", MP4_HEADER)
        yield Attack(f"upload {name}", content, frozenset({422}))
    for value in (b"", b"MZ" * 300, b"<html>" * 100, b"\x89PNG\r\n\x1a\n" + bytes(500), bytes(500)):
        content = target.write("POST", "api/clips?name=a.mp4", value)
        yield Attack(f"no video {value[:5]!r}", content, frozenset({415}))
    content = target.write("POST", "api/clips?name=a.mp4", Content_Length=str(HUGE))
    yield Attack("a sparse file", content, frozenset({413}))


def list_protocol_faults(target: Target) -> Iterator[Attack]:
    """List what is no HTTP."""
    good = target.write("GET", "api/library")
    for name, content in {
        "garbage": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n",
        "one word": b"GET\r\n\r\n",
        "another version": good.replace(b"HTTP/1.1", b"HTTP/x.y"),
        "no version": good.replace(b" HTTP/1.1", b""),
        "spaces": good.replace(b"GET ", b"GET   "),
        "no host": good.replace(b"Host", b"Ghost"),
        "two hosts": good.replace(b"Host", b"Host: evil.example\r\nHost"),
        "a header without a name": good.replace(b"Connection", b": x\r\nConnection"),
        "a header without a colon": good.replace(b"Connection", b"no colon\r\nConnection"),
        "a folded header": good.replace(b"Connection", b"X: 1\r\n\x00 2\r\nConnection"),
        "a control character": good.replace(b"api/library", b"api/\x01"),
        "a huge header": good.replace(b"Connection", b"X: " + b"x" * 200_000 + b"\r\nConnection"),
        "a negative length": good.replace(b"Content-Length: 0", b"Content-Length: -1"),
        "a length in words": good.replace(b"Content-Length: 0", b"Content-Length: ten"),
        "two lengths": good.replace(b"Content-Length: 0", b"Content-Length: 0\r\nContent-Length: 9"),
        "an unknown coding": good.replace(b"Content-Length: 0", b"Transfer-Encoding: gzip, x"),
    }.items():
        yield Attack(name, content, frozenset({400, 431, 501}))
    chunked = target.write("POST", "api/paths").replace(b"Content-Length: 0", b"Transfer-Encoding: chunked")
    yield Attack("a chunk that is none", chunked + b"zz\r\n{}\r\n", frozenset({400}))
    for method in ("HEAD", "PUT", "PATCH", "OPTIONS", "TRACE", "FOO"):
        if method != "HEAD":  # which has no content
            yield Attack(method, target.write(method, "api/library"), frozenset({405}))


PIECES = ("api", "shots", "library", "clips", "paths", "jobs", "trash", "restore", "file", "slow.mp4", "lan", "code",
          "cancel", "thumbnail", "preview", "..", "", "%00", "index.html", "sessions", "ask", "status")  # fmt: skip
JSON_VALUES = (None, 0, -1, 1e400, "", "\0", "/", [], {}, [[[]]], True, "x" * 3000, "\ud800")


def list_random_requests(target: Target, rng: Random, count: int) -> Iterator[Attack]:
    """List requests of known words and any others in any order."""

    def make_text() -> str:
        return "".join(chr(rng.choice((rng.randrange(128), rng.randrange(0xD800)))) for _ in range(rng.randrange(12)))

    for number in range(count):
        parts = [rng.choice((*PIECES, target.shot, quote(make_text()))) for _ in range(rng.randrange(1, 5))]
        path = rng.choice(("", "api/", f"api/shots/{target.shot}/")) + "/".join(parts)
        keys = rng.sample(["path", "question", "a", "b", "action", "shots", "frame", "at"], 3)
        values = {key: rng.choice((*JSON_VALUES, make_text())) for key in keys}
        body = rng.choice((rng.randbytes(rng.randrange(300)), json.dumps(values).encode()))
        method = rng.choice(("POST", "PUT", "PATCH", "DELETE"))
        words = "&".join(f"{key}={quote(make_text())}" for key in ("name", "modified"))
        if not path.rstrip("/").endswith((target.shot, "trash", "code")):  # those requests are in order
            content = target.write(method, f"{path}?{words}", body)
            yield Attack(f"random {number}", content, frozenset({307, *range(400, 500)}))


def is_refusal(content: bytes) -> bool:
    """Whether an answer is one sentence without a trace of the program, and nothing else."""
    with suppress(ValueError):
        sentence = json.loads(content).get("error", "")
        is_plain = "\n" not in sentence and "Traceback" not in sentence
        return json.loads(content).keys() == {"error"} and sentence.endswith(".") and is_plain
    return False


def list_results(target: Target) -> dict[str, bytes]:
    """List what the library holds, without the index and the trash of the program."""
    files = list_tree(target.home / "library")
    return {name: content for name, content in files.items() if ".trueroll-app" not in name}


def test_every_attack_gets_one_sentence_and_changes_nothing(target: Target) -> None:
    attacks = list(list_attacks(target))
    assert len(attacks) >= 300
    server = psutil.Process(target.app.process.pid)
    before = list_results(target)
    replies = [(attack, *target.send(attack.content)) for attack in attacks]
    assert not [(one.name, status, content[:100]) for one, status, content in replies if status not in one.statuses]
    assert not [
        (one.name, content[:100]) for one, status, content in replies if status >= 400 and not is_refusal(content)
    ]
    assert not [one.name for one, _, content in replies if b"secret" in content]
    memory = server.memory_info().rss  # with all modules that refusals need
    for attack in attacks:
        target.send(attack.content)
    assert server.memory_info().rss < memory + GROWTH_BYTES
    assert list_results(target) == before
    assert (target.home / "secret.txt").read_text() == "secret"
    assert {path.name for path in target.home.iterdir()} <= {"secret.txt", "library", "cache"}
    assert target.app.ask("GET", "api/library")[0] == 200


def test_fifty_uploads_at_once_arrive_whole_and_take_little_memory(target: Target) -> None:
    server, statuses, peak = psutil.Process(target.app.process.pid), list[int](), 0
    before = server.memory_info().rss
    whole = MP4_HEADER + PART * PARTS

    def upload(number: int) -> None:
        statuses.append(target.send(target.write("POST", f"api/clips?name=upload{number}.mp4", whole))[0])

    threads = [threading.Thread(target=upload, args=(number,)) for number in range(UPLOADS)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        peak = max(peak, server.memory_info().rss)
        threads[0].join(0.02)
    assert statuses == [201] * UPLOADS
    assert peak < before + UPLOAD_GROWTH_BYTES
    clips = list((target.home / "library" / "clips").iterdir())
    assert [clip.stat().st_size for clip in clips] == [len(whole)] * UPLOADS
