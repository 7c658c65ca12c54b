"""Corrections of a shot on the page: who wins, what is undone, and when a session ends."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from typing import Any

import pytest
from support.app_requests import Visitor
from support.carom_start import Home

import pipeline.app.open_shots as open_shots
from pipeline.app.open_shots import IDLE_S, ShotDesk
from pipeline.app.shot_library import ShotLibrary
from pipeline.io.corrections_file import (
    SCHEMA,
    CorrectionsFile,
    parse_corrections,
    read_corrections,
    write_corrections,
)
from pipeline.io.saved_shot import read_shot

RENAME = {"tracks": [{"kind": "rename", "ball": {"frame": 5, "x_px": 0.0, "y_px": 0.0, "id": "yellow"},
                      "name": "object"}]}  # fmt: skip
WAIT_S = 300.0


class CorrectedShot:
    """A run with its own clip and cache in a library, and two pages that show it."""

    def __init__(self, home: Home) -> None:
        self.clip = home.clip
        self.folder = home.out
        self.visitor = Visitor(home.out.parent)
        self.messages: list[dict[str, Any]] = []
        self.visitor.library.listeners.append(self.messages.append)
        shot = read_shot(self.folder)
        x, y = shot.tracks.px[shot.tracks.frame.tolist().index(5), shot.tracks.ids.index("yellow")]
        ball = RENAME["tracks"][0]["ball"]
        assert isinstance(ball, dict)
        ball |= {"x_px": round(float(x), 1), "y_px": round(float(y), 1)}

    def ask(self, method: str, path: str = "", body: object = b"", **headers: str) -> tuple[int, dict[str, Any]]:
        shot = self.visitor.library.identify(self.folder)
        reply = self.visitor.ask(method, f"api/shots/{shot}{path}", body, **headers)
        return reply.status, reply.document

    def wait(self) -> dict[str, Any]:
        """Wait until the run of the present corrections is shown."""
        end = time.monotonic() + WAIT_S
        while time.monotonic() < end:
            status = self.ask("GET", "/status")[1]
            assert not status["error"], status
            if status["result"] == status["revision"] and not status["stage"]:
                return self.ask("GET")[1]
            time.sleep(0.05)
        raise AssertionError(f"no result after {WAIT_S} s")

    def close(self) -> None:
        for close in self.visitor.library.closers:
            close()


@pytest.fixture
def corrected(home: Home, own_home: Home, monkeypatch: pytest.MonkeyPatch) -> Iterator[CorrectedShot]:
    monkeypatch.setattr(open_shots.OpenShot, "warm_up", lambda self: None)
    monkeypatch.setenv("TRUEROLL_CACHE", str(own_home.cache))
    shutil.copytree(home.out, own_home.out)
    source = json.loads((own_home.out / "source.json").read_text())
    (own_home.out / "source.json").write_text(json.dumps(source | {"path": str(own_home.clip)}))
    opened = CorrectedShot(own_home)
    yield opened
    opened.close()


def test_a_correction_is_run_shown_to_all_pages_undone_and_redone(corrected: CorrectedShot) -> None:
    document = corrected.ask("GET")[1]
    assert (document["revision"], document["result"], document["can_undo"], document["corrections"]) == (
        0,
        0,
        False,
        {},
    )
    status, content = corrected.ask("PUT", "/corrections", RENAME, if_match='"0"')
    assert (status, content["revision"], content["can_undo"]) == (200, 1, True)
    assert read_corrections(corrected.clip).corrections.tracks[0].name == "object"
    document = corrected.wait()
    assert "object" in [one["id"] for one in document["run"]["balls"]]
    assert "object" in [one["id"] for one in document["plan"]["paths"]], "the plan is of the same run"
    assert {"kind": "changed", "text": "yellow is now called object"} in document["run"]["changes"]
    assert document["set_by_hand"][0].startswith("the name object of ")
    assert "object" in (corrected.folder / "events.csv").read_text()
    shot = corrected.visitor.library.identify(corrected.folder)
    assert {"type": "shot", "id": shot} in corrected.messages
    late, refusal = corrected.ask("PUT", "/corrections", {"fps": "25"}, if_match='"0"')
    assert (late, "revision 1, yours is 0" in refusal["error"]) == (412, True)
    assert corrected.ask("POST", "/undo", if_match='"1"')[1]["revision"] == 2
    assert "yellow" in [one["id"] for one in corrected.wait()["run"]["balls"]]
    assert corrected.ask("POST", "/redo", if_match='"2"')[1]["can_redo"] is False
    assert corrected.ask("POST", "/redo", if_match='"3"') == (412, {"error": "There is nothing to redo."})


def test_a_change_must_name_its_revision_and_be_well_formed(corrected: CorrectedShot) -> None:
    assert corrected.ask("PUT", "/corrections", RENAME)[0] == 428
    for body in ({"colour": 1}, {"fps": "fast"}):
        status, refusal = corrected.ask("PUT", "/corrections", body, if_match='"0"')
        assert (status, "\n" in refusal["error"]) == (422, False)
    assert corrected.ask("PUT", "/corrections", b" " * 2_100_000, if_match='"0"')[0] == 413
    impossible: dict[str, tuple[object, str]] = {
        "table": ("banana", "LENGTHxWIDTH in metres, such as 2.54x1.27"),
        "ball_radius": (499999.5, "balls are 20 to 120 mm in diameter"),
        "fps": ("abc", "a number such as 29.97 or 30000/1001"),
    }
    for name, (value, possible) in [*impossible.items(), ("table", ("9999999x1", "0.5 to 5 m long"))]:
        status, refusal = corrected.ask("PUT", "/corrections", {name: value}, if_match='"0"')
        assert (status, possible in refusal["error"]) == (422, True), refusal
    assert not read_corrections(corrected.clip).revision


def test_a_session_ends_when_idle_and_follows_a_run_of_another_program(corrected: CorrectedShot) -> None:
    library = ShotLibrary(corrected.folder.parent)
    desk, shot = ShotDesk(library), library.identify(corrected.folder)
    session = desk.open_session(shot)
    assert desk.open_session(shot) is session
    desk.close_idle(time.monotonic() + IDLE_S - 60)
    assert desk.find_session(shot) is session
    with (corrected.folder / "events.csv").open("a") as file:
        file.write("\n")
    other = desk.open_session(shot)
    assert other is not session
    desk.close_idle(time.monotonic() + IDLE_S + 1)
    assert desk.find_session(shot) is None
    desk.close()


def test_marks_that_no_run_has_yet_are_run_but_not_written_when_the_shot_is_opened(corrected: CorrectedShot) -> None:
    before = (corrected.folder / "events.csv").read_bytes()
    corrections = parse_corrections({"schema": SCHEMA, **RENAME}).corrections
    write_corrections(corrected.clip, CorrectionsFile(3, "", corrections))
    document = corrected.ask("GET")[1]
    assert (document["revision"], "yellow" in [one["id"] for one in document["run"]["balls"]]) == (3, True)
    document = corrected.wait()
    assert "object" in [one["id"] for one in document["run"]["balls"]]
    assert document["notice"].startswith("These events differ from those in ")
    assert (corrected.folder / "events.csv").read_bytes() == before
