"""The server of the page: who may ask, what is reachable, and what malformed requests do: nothing."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import quote

import pytest
from starlette.applications import Starlette
from support import app_requests
from support.app_requests import MP4_HEADER, PATH_TRICKS, THUMBNAIL, Reply, Visitor, list_tree, write_run
from support.carom_start import run_program

from pipeline.app import access_guard, app_server, uploads
from pipeline.app.app_server import LibraryHandlers
from pipeline.app.job_queue import JobQueue
from pipeline.app.shot_library import ShotLibrary

PHONE, OTHER_PHONE = "192.168.1.20", "192.168.1.21"


@pytest.fixture
def visitor(tmp_path: Path) -> Visitor:
    """A library of one shot within a folder that holds something else too."""
    (tmp_path / "secret.txt").write_text("secret")
    write_run(tmp_path / "library" / "break")
    return Visitor(tmp_path / "library")


def find_shot(visitor: Visitor) -> str:
    (card,) = visitor.library.list_cards()
    return card.id


def pair(visitor: Visitor, device: str = PHONE) -> str:
    """Pair a device and return the start of its paths."""
    reply = visitor.ask("GET", f"/pair?code={visitor.keys.start_pairing().code}", device=device)
    assert reply.status == 303
    return reply.headers["location"]


def test_the_page_and_its_library_are_served(visitor: Visitor) -> None:
    page = visitor.ask("GET", "")
    assert (page.status, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    listing = visitor.ask("GET", "api/library").document
    assert [card["name"] for card in listing["shots"]] == ["break"]
    assert listing["local"]
    shot = find_shot(visitor)
    image = visitor.ask("GET", f"api/shots/{shot}/thumbnail")
    assert image.body == THUMBNAIL
    again = visitor.ask("GET", f"api/shots/{shot}/thumbnail", if_none_match=image.headers["etag"])
    assert (again.status, again.body) == (304, b"")
    part = visitor.ask("GET", f"api/shots/{shot}/file/slow.mp4", range="bytes=3-5")
    assert (part.status, part.body) == (206, bytes([3, 4, 5]))
    report = visitor.ask("GET", f"api/shots/{shot}/file/report.html")
    assert report.headers["content-security-policy"].startswith("sandbox allow-scripts; default-src 'none'")
    assert part.headers["cross-origin-resource-policy"] == "cross-origin", "the sandboxed report shows the video"
    assert page.headers["cross-origin-resource-policy"] == "same-origin"


def test_deleting_and_undoing_are_two_requests(visitor: Visitor) -> None:
    bytes_in_all = visitor.ask("GET", "api/library").document["shots"][0]["bytes"]
    undo = visitor.ask("DELETE", f"api/shots/{find_shot(visitor)}").document["undo"]
    assert visitor.ask("GET", "api/library").document["shots"] == []
    trash = [{"undo": undo, "name": "break", "bytes": bytes_in_all}]
    assert visitor.ask("GET", "api/trash").document == {"entries": trash}
    assert visitor.ask("POST", f"api/trash/{undo}/restore").status == 200
    assert len(visitor.ask("GET", "api/library").document["shots"]) == 1
    assert visitor.ask("GET", "api/trash").document == {"entries": []}
    visitor.queue.add_command("Comparison", ["compare"], visitor.library.root / "break" / "again")
    refusal = visitor.ask("DELETE", f"api/shots/{find_shot(visitor)}")
    assert (refusal.status, refusal.sentence) == (409, "This shot is being computed, or will be; cancel that first.")


def test_a_shot_is_renamed_and_named_back(visitor: Visitor) -> None:
    shot, root = find_shot(visitor), visitor.library.root
    write_run(root / "other")
    closed: list[str] = []
    visitor.library.closing_listeners.append(closed.append)
    renamed = visitor.ask("PUT", f"api/shots/{shot}/name", {"name": "Fine break, 2nd"}).document
    assert (renamed["before"], closed) == ("break", [shot])
    cards = visitor.ask("GET", "api/library").document["shots"]
    assert {card["id"]: card["folder"] for card in cards}[renamed["shot"]] == "Fine break, 2nd"
    assert visitor.ask("PUT", f"api/shots/{shot}/name", {"name": "x"}).status == 404, "the id is that of the folder"
    taken = visitor.ask("PUT", f"api/shots/{renamed['shot']}/name", {"name": "other"})
    assert (taken.status, taken.sentence) == (
        409, "There is something with the name other already; choose another name.",
    )  # fmt: skip
    for name in ("", " ", ".hidden", "a/b", "clips", "sessions", "x" * 181, "tab\t", None, 3, "end "):
        reply = visitor.ask("PUT", f"api/shots/{renamed['shot']}/name", {"name": name})
        own = name in ("clips", "sessions")
        start = "The library itself" if own else "This name is too l" if name == "x" * 181 else "A name has at least"
        assert (reply.status, reply.sentence.startswith(start)) == (422, True), name
    back = visitor.ask("PUT", f"api/shots/{renamed['shot']}/name", {"name": renamed["before"]}).document
    assert (back["shot"], (root / "break" / "scene.json").exists()) == (shot, True)
    visitor.queue.add_command("Comparison", ["compare"], root / "break" / "again")
    assert visitor.ask("PUT", f"api/shots/{shot}/name", {"name": "x"}).status == 409, "it is being computed"


def test_only_who_has_the_address_gets_anything(visitor: Visitor, tmp_path: Path) -> None:
    earlier = Visitor(tmp_path / "library").keys.token
    for path in ("/", "/api/library", f"/{'x' * 24}/api/library", f"/{earlier}/api/library", "/pair?code=", "//",
                 f"/{visitor.keys.token}x/", f"/%2e/{visitor.keys.token}/"):  # fmt: skip
        reply = visitor.ask("GET", path)
        assert (reply.status, reply.sentence) == (404, "There is nothing at this address.")


def test_another_page_cannot_change_anything_but_this_one_can(visitor: Visitor) -> None:
    shot = find_shot(visitor)
    assert visitor.ask("DELETE", f"api/shots/{shot}", origin="http://127.0.0.1:9000").status == 403
    assert visitor.ask("DELETE", f"api/shots/{shot}", origin="http://127.0.0.1:8000").status == 200


@pytest.mark.parametrize("trick", [*PATH_TRICKS[:9], "a/../../b", "sub/folder/name"])
def test_an_upload_lands_among_the_clips_whatever_it_is_called(trick: str, visitor: Visitor, tmp_path: Path) -> None:
    before = set(list_tree(tmp_path))
    assert visitor.ask("POST", f"api/clips?name={quote(trick)}.mp4", MP4_HEADER).status in (201, 422)
    new = [name for name in set(list_tree(tmp_path)) - before if "/.trueroll-app/" not in name]
    assert all(re.fullmatch(r"library/clips/[^/]+\.mp4", name) for name in new)


def test_a_long_name_is_cut_to_what_a_file_system_takes(visitor: Visitor, tmp_path: Path) -> None:
    assert visitor.ask("POST", f"api/clips?name={quote('台' * 120)}.mp4", MP4_HEADER).status == 201
    assert [path.name for path in (tmp_path / "library" / "clips").iterdir()] == ["台" * 60 + ".mp4"]


def test_a_clip_is_uploaded_and_queued(visitor: Visitor) -> None:
    reply = visitor.ask("POST", "api/clips?name=Final%20shot.mov&modified=1000000000000", MP4_HEADER)
    job = reply.document["job"]
    assert (reply.status, job["name"], job["state"]) == (201, "Final shot.mov", "waiting")
    clip = visitor.library.clips / "Final shot.mov"
    assert clip.read_bytes() == MP4_HEADER
    assert clip.stat().st_mtime == 1e9
    second = visitor.ask("POST", "api/clips?name=Final%20shot.mov", MP4_HEADER).document["job"]
    assert second["name"] == "Final shot-2.mov"
    assert [one["id"] for one in visitor.ask("GET", "api/library").document["jobs"]] == [job["id"], second["id"]]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"MZ\x90\x00" * 200,
        b"<html>" * 100,
        b"\x89PNG\r\n\x1a\n" + bytes(500),
        b"\x00\x00\x00\x18ftypheic" + bytes(500),
        b"\x00" * 500,
        b"RIFF\0\0\0\0WAVE" * 50,
    ],
)
def test_what_is_no_video_is_not_kept(content: bytes, visitor: Visitor, tmp_path: Path) -> None:
    before = set(list_tree(tmp_path))
    reply = visitor.ask("POST", "api/clips?name=a.mp4", content)
    assert (reply.status, reply.sentence[:20]) == (415, "This is no video; mp")
    assert set(list_tree(tmp_path)) == before


@pytest.mark.parametrize(
    "content", [MP4_HEADER, b"\x1aE\xdf\xa3" + bytes(500), b"RIFF\0\0\0\0AVI LIST" + bytes(500),
                (b"G" + bytes(187)) * 3, (bytes(4) + b"G" + bytes(187)) * 3],
)  # fmt: skip
def test_containers_of_cameras_and_phones_are_taken(content: bytes, visitor: Visitor) -> None:
    assert visitor.ask("POST", "api/clips?name=a.mp4", content).status == 201


def test_an_upload_that_is_too_large_is_refused_before_and_while_it_comes(
    visitor: Visitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def send(read: list[int]) -> Iterator[bytes]:
        yield MP4_HEADER
        while True:
            read.append(1)
            yield bytes(1000)

    before, read = set(list_tree(tmp_path)), list[int]()
    stated = visitor.ask("POST", "api/clips?name=a.mp4", send(read), content_length="10000000000")
    assert (stated.status, read) == (413, [])
    monkeypatch.setattr(uploads, "MAX_UPLOAD_BYTES", 50_000)
    unstated = visitor.ask("POST", "api/clips?name=a.mp4", send(read), transfer_encoding="chunked")
    assert (unstated.status, len(read)) == (413, 50)
    monkeypatch.setattr(uploads, "RESERVED_BYTES", 10**18)
    assert visitor.ask("POST", "api/clips?name=a.mp4", MP4_HEADER).status == 507
    assert set(list_tree(tmp_path)) == before


def test_an_upload_that_breaks_off_leaves_nothing(visitor: Visitor, tmp_path: Path) -> None:
    before = set(list_tree(tmp_path))
    assert visitor.ask("POST", "api/clips?name=a.mp4", [MP4_HEADER, None]).status == 400
    assert set(list_tree(tmp_path)) == before


def test_fifty_uploads_at_once_need_no_memory(visitor: Visitor) -> None:
    part = bytes(65536)

    async def upload_all() -> list[Reply]:
        bodies = ([MP4_HEADER, *[part] * 30] for _ in range(50))
        return await asyncio.gather(*(visitor.ask_within("POST", "api/clips?name=a.mp4", one) for one in bodies))

    tracemalloc.start()
    replies = asyncio.run(upload_all())
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [reply.status for reply in replies] == [201] * 50
    assert peak < 8e6  # all together are 98 MB
    assert len(list(visitor.library.clips.iterdir())) == 50


def test_more_uploads_than_the_limit_are_refused(visitor: Visitor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MAX_PER_HOUR", 2)
    start = pair(visitor)
    replies = [visitor.ask("POST", f"{start}api/clips?name=a.mp4", MP4_HEADER, PHONE).status for _ in range(3)]
    assert replies == [201, 201, 429]
    assert visitor.ask("POST", "api/clips?name=a.mp4", MP4_HEADER).status == 201  # the computer itself is not limited


def test_a_path_on_this_machine_is_queued_without_a_copy(visitor: Visitor, tmp_path: Path) -> None:
    clip = tmp_path / "film.mp4"
    clip.write_bytes(MP4_HEADER)
    job = visitor.ask("POST", "api/paths", {"path": f' "{clip}" '}).document["job"]
    again = visitor.ask("POST", "api/paths", {"path": str(tmp_path)}).document["jobs"]
    assert [job["name"], *(one["name"] for one in again)] == ["film.mp4", "film.mp4"]
    assert not visitor.library.clips.exists()
    for path in ("", " ", 3, None, "film.mp4", "/nowhere", "a\0b"):
        assert visitor.ask("POST", "api/paths", {"path": path}).status in (404, 422)


def test_a_phone_is_paired_by_a_code_that_works_once(visitor: Visitor) -> None:
    reply = visitor.ask("POST", "api/lan/code").document
    assert reply["address"] == f"http://192.168.1.5:8000/pair?code={reply['code']}"
    assert reply["svg"].startswith("<svg")
    paired = visitor.ask("GET", f"/pair?code={reply['code']}", device=PHONE)
    start = paired.headers["location"]
    assert not visitor.ask("GET", f"{start}api/library", device=PHONE).document["local"]
    assert visitor.ask("GET", f"/pair?code={reply['code']}", device=OTHER_PHONE).status == 403
    for path, device in ((f"{start}api/library", OTHER_PHONE), (f"{start}api/library", ""), ("api/library", PHONE)):
        assert visitor.ask("GET", path, device=device).status == 404  # a token that was seen by others


def test_wrong_codes_end_the_pairing(visitor: Visitor) -> None:
    code = visitor.keys.start_pairing().code
    for _ in range(access_guard.MAX_WRONG_CODES):
        assert visitor.ask("GET", "/pair?code=wrong", device=PHONE).status == 403
    assert visitor.ask("GET", f"/pair?code={code}", device=PHONE).status == 403


def test_codes_and_sessions_end(visitor: Visitor, monkeypatch: pytest.MonkeyPatch) -> None:
    start, code = pair(visitor), visitor.keys.start_pairing().code
    now = time.monotonic()
    monkeypatch.setattr(access_guard.time, "monotonic", lambda: now + access_guard.SESSION_S + 1)
    assert visitor.ask("GET", f"/pair?code={code}", device=PHONE).status == 403
    assert visitor.ask("GET", f"{start}api/library", device=PHONE).status == 404


def test_a_phone_uploads_and_corrects_but_names_no_paths(visitor: Visitor, tmp_path: Path) -> None:
    start = pair(visitor)
    assert visitor.ask("POST", f"{start}api/clips?name=a.mp4", MP4_HEADER, PHONE).status == 201
    for path in ("api/paths", "api/lan/code"):
        reply = visitor.ask("POST", f"{start}{path}", {"path": str(tmp_path)}, PHONE)
        assert (reply.status, reply.sentence) == (403, "This is possible on the computer itself only.")
    assert visitor.ask("GET", f"{start}api/library", device=PHONE, host="evil.example:8000").status == 400


def test_a_device_that_asks_too_often_waits_and_others_do_not(
    visitor: Visitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.monotonic()
    clock = SimpleNamespace(monotonic=lambda: now)
    monkeypatch.setattr(access_guard, "BURST", 5.0)
    monkeypatch.setattr(access_guard, "time", clock)
    replies = []
    for _ in range(200):  # 5 s
        now += 1 / 40
        replies.append(visitor.ask("GET", "/x/", device=PHONE).status)
    assert set(replies) == {404, 429}
    assert replies[80:].count(404) == pytest.approx(3 * access_guard.RATE_HZ, abs=2)
    assert visitor.ask("GET", "/x/", device=OTHER_PHONE).status == 404
    assert visitor.ask("GET", "api/library").status == 200


def test_a_request_about_the_whole_server_is_answered(visitor: Visitor) -> None:
    reply = visitor.ask("OPTIONS", "*")
    assert (reply.status, "content-security-policy" in reply.headers) == (404, True)


def test_the_standard_port_need_not_be_named(visitor: Visitor, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app_requests, "PORT", 80)
    for host, status in (("127.0.0.1", 200), ("localhost:80", 200), ("127.0.0.1:8000", 400), ("evil.example", 400)):
        assert visitor.ask("GET", "api/library", host=host).status == status


def test_nothing_is_paired_without_the_option(visitor: Visitor, tmp_path: Path) -> None:
    from pipeline.app.app_server import build_app

    visitor.app = build_app(visitor.library, visitor.queue, visitor.keys, Starlette())
    assert visitor.ask("POST", "api/lan/code").status == 409


def test_pages_are_told_what_happens_also_while_much_happens(
    visitor: Visitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_server, "WATCH_S", 0.05)
    monkeypatch.setattr(app_server, "MAX_WAITING", 3)
    handlers = LibraryHandlers(visitor.library, visitor.queue, visitor.keys, "", lambda: False)

    async def listen() -> list[dict[str, object]]:
        stream = handlers.stream_events()
        assert await anext(stream) == "retry: 1000\n\n"
        for number in range(5):  # more than may wait
            visitor.library.announce(type="job", id=number)
        await asyncio.sleep(0)
        messages = [json.loads((await anext(stream))[5:])]
        write_run(tmp_path / "library" / "by another program")
        while messages[-1] == messages[0] or messages[-1]["type"] != "library":
            visitor.library.announce(type="job", id="busy")
            text = await anext(stream)
            messages += [json.loads(text[5:])] if text.startswith("data:") else []
        await stream.aclose()
        return messages

    messages = asyncio.run(asyncio.wait_for(listen(), 60.0))
    assert messages[0] == {"type": "library", "revision": None}  # the page reads it, whatever it has
    assert {"type": "job", "id": "busy"} in messages
    assert visitor.library.listeners == []


def test_the_server_starts_without_what_computes() -> None:
    heavy = {"torch", "numba", "scipy", "cv2", "onnxruntime", "av"}
    script = f"import pipeline.app.app_server, sys; print(sorted({heavy} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("is_new", [True, False])
def test_edit_opens_the_page_at_a_run_and_queues_a_clip_without_one(
    is_new: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pages: list[tuple[ShotLibrary, Path | None]] = []
    monkeypatch.setattr(app_server, "open_page", lambda library, port, browser, shot: pages.append((library, shot)))
    monkeypatch.chdir(tmp_path)
    clip = tmp_path / "film.mp4"
    clip.write_bytes(MP4_HEADER)
    if not is_new:
        folder = write_run(tmp_path / "out" / "film")
        (folder / "source.json").write_text(json.dumps({"path": str(clip)}))
    done = run_program("edit", "film.mp4" if is_new else "out/film")
    assert done.status == 0, done.err
    ((library, shot),) = pages
    assert shot == (None if is_new else Path("out/film"))
    assert [job["name"] for job in JobQueue(library).describe()] == (["film.mp4"] if is_new else [])
