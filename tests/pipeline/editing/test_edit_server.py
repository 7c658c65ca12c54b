"""The server of the editor: who may ask, what is saved, and who wins."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.edit_servers import ask, serve_synthetic_run, wait_for_result

from models.core.corrections import Corrections
from pipeline.editing.edit_server import EditServer
from pipeline.io.corrections_file import CorrectionsFile, corrections_path, read_corrections, write_corrections

RED = {"frame": 3, "x_px": 170.0, "y_px": 50.0, "id": "red"}
RENAME = {"tracks": [{"kind": "rename", "ball": RED, "name": "object"}]}


@pytest.fixture
def server(tmp_path: Path) -> Iterator[EditServer]:
    with serve_synthetic_run(tmp_path) as served:
        yield served


def test_only_who_has_the_address_gets_anything(server: EditServer) -> None:
    for path in ("/", "/status", "/state", "/edit.js", f"/{'x' * 24}/state"):
        assert ask(server, "GET", path)[0] == 404
    status, page, headers = ask(server, "GET", "")
    assert status == 200
    assert b"<title>Correct a run" in page
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["referrer-policy"] == "no-referrer"


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example"])
def test_a_name_that_was_bound_to_this_machine_is_refused(host: str, server: EditServer) -> None:
    assert ask(server, "GET", "state", Host=host)[0] == 400


def test_another_page_cannot_change_anything(server: EditServer, tmp_path: Path) -> None:
    for method, path in (("PUT", "corrections"), ("POST", "undo"), ("POST", "finish")):
        status, content, _ = ask(server, method, path, RENAME, If_Match='"0"', Origin="http://evil.example")
        assert (status, content["error"]) == (403, "Changes are accepted from the page of the editor only.")
    assert not corrections_path(tmp_path / "shot.mp4").exists()


@pytest.mark.parametrize(
    "path", ["../../../../etc/passwd", "frame/../../../etc/passwd", "frame/-1", "frame/1e9", "frame/999", "edit.py",
             "%2e%2e/%2e%2e/etc/passwd"],
)  # fmt: skip
def test_nothing_outside_the_run_can_be_read(path: str, server: EditServer) -> None:
    assert ask(server, "GET", path)[0] == 404


def test_the_server_listens_on_this_machine_only(server: EditServer) -> None:
    assert server.url.startswith("http://127.0.0.1:")
    assert len(server.token) == 24


def test_a_frame_is_a_jpeg(server: EditServer) -> None:
    status, content, headers = ask(server, "GET", "frame/5")
    assert (status, headers["content-type"], content[:3]) == (200, "image/jpeg", b"\xff\xd8\xff")


def test_a_correction_is_saved_beside_the_clip_under_the_next_revision(server: EditServer, tmp_path: Path) -> None:
    assert ask(server, "GET", "state")[2]["etag"] == '"0"'
    status, content, headers = ask(server, "PUT", "corrections", RENAME, If_Match='"0"')
    assert (status, content["revision"], headers["etag"]) == (200, 1, '"1"')
    saved = read_corrections(tmp_path / "shot.mp4")
    assert (saved.revision, saved.corrections.tracks[0].name) == (1, "object")
    state = wait_for_result(server)
    assert state["corrections"] == RENAME
    assert state["set_by_hand"] == ["the name object of red, at 170, 50 px in frame 3"]


def test_what_is_set_by_hand_names_balls_as_the_page_does(server: EditServer) -> None:
    mark = {"kind": "delete", "cause": "ball", "frame": 3, "ball": {**RED, "id": "yellow"},
            "other": {"frame": 3, "x_px": 50.0, "y_px": 70.0, "id": "cue"}}  # fmt: skip
    far = {"kind": "delete", "cause": "strike", "frame": 3, "ball": {"frame": 3, "x_px": 5.0, "y_px": 5.0, "id": "old"}}
    ask(server, "PUT", "corrections", {"contacts": [mark, far], **RENAME}, If_Match='"0"')
    assert wait_for_result(server)["set_by_hand"] == [
        "the name object of red, at 170, 50 px in frame 3",
        "no contact of red and white at frame 3.0",
        "no strike of old at frame 3.0",
    ]


def test_two_tabs_do_not_overwrite_each_other(server: EditServer, tmp_path: Path) -> None:
    assert ask(server, "PUT", "corrections", RENAME, If_Match='"0"')[0] == 200
    status, content, _ = ask(server, "PUT", "corrections", {"fps": "25"}, If_Match='"0"')
    assert status == 412
    assert content["error"] == (
        "The corrections were changed in another tab or program (revision 1, yours is 0); they are shown now, please"
        " make your change again."
    )
    assert read_corrections(tmp_path / "shot.mp4").corrections.fps is None


def test_a_file_that_another_program_wrote_is_not_overwritten(server: EditServer, tmp_path: Path) -> None:
    write_corrections(tmp_path / "shot.mp4", CorrectionsFile(5, "", Corrections(fps="25")))
    status, content, _ = ask(server, "PUT", "corrections", RENAME, If_Match='"0"')
    assert (status, "revision 5, yours is 0" in content["error"]) == (412, True)
    assert wait_for_result(server)["corrections"] == {"fps": "25"}
    assert ask(server, "PUT", "corrections", RENAME, If_Match='"5"')[0] == 200


def test_corrections_are_undone_and_redone(server: EditServer, tmp_path: Path) -> None:
    ask(server, "PUT", "corrections", RENAME, If_Match='"0"')
    ask(server, "PUT", "corrections", {}, If_Match='"1"')
    revisions = []
    for revision, path, expected in ((2, "undo", 1), (3, "undo", 0), (4, "redo", 1)):
        _, content, _ = ask(server, "POST", path, If_Match=f'"{revision}"')
        revisions.append(content["revision"])
        assert len(read_corrections(tmp_path / "shot.mp4").corrections.tracks) == expected
    assert revisions == [3, 4, 5]
    assert (content["can_undo"], content["can_redo"]) == (True, True)
    assert ask(server, "POST", "redo", If_Match='"5"')[0] == 200
    assert ask(server, "POST", "redo", If_Match='"6"')[1]["error"] == "There is nothing to redo."


BAD = {
    b"{": "The correction cannot be used: ",
    b'{"colour": 1}': 'The correction cannot be used: the file has no "colour".',
    b'{"fps": "fast"}': "The corrections of the clip set fps to fast: a number such as 29.97 or 30000/1001 was",
    b"[" * 100_000: "The correction cannot be used: ",
}


@pytest.mark.parametrize("body", BAD, ids=range(len(BAD)))
def test_a_malformed_correction_gets_one_sentence_and_changes_nothing(
    body: bytes, server: EditServer, tmp_path: Path
) -> None:
    status, content, _ = ask(server, "PUT", "corrections", body, If_Match='"0"')
    assert status == 422
    assert content["error"].startswith(BAD[body])
    assert "\n" not in content["error"]
    assert not corrections_path(tmp_path / "shot.mp4").exists()


def test_a_change_must_name_its_revision(server: EditServer) -> None:
    assert ask(server, "PUT", "corrections", RENAME)[0] == 428
    assert ask(server, "PUT", "corrections", RENAME, If_Match="*")[0] == 428
    assert ask(server, "PUT", "corrections", b" " * 2_100_000, If_Match='"0"')[0] == 413


def test_the_state_holds_what_the_page_shows(server: EditServer) -> None:
    run = wait_for_result(server)["run"]
    assert run["frames"]["distinct"] == list(range(24))
    assert [ball["id"] for ball in run["balls"]] == ["white", "red"]
    assert run["events"][0]["text"] == "White is struck and leaves at 1.00 m/s (3.6 km/h)"
    assert run["checks"][0]["balls"][0] == "white"
    json.dumps(run, allow_nan=False)
