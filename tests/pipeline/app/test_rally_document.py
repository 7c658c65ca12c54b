"""What the page shows of a rally, and its answers: those of the commands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.app_requests import Visitor
from support.simple_rallies import usual_view
from support.staged_rally import stage_rally

import trueroll
from models.core.corrections import RallyCorrection
from models.core.rally import Rally
from models.sports.sport_catalogue import find_sports
from pipeline.io.saved_shot import publish_shot, read_rally, write_shot

TARGET = (12.2, 1.0)
"""m, where the shuttle lands."""


@pytest.fixture
def rally_page(tmp_path: Path) -> Iterator[tuple[Visitor, Path]]:
    folder = tmp_path / "library" / "rally"
    (folder / "fresh").mkdir(parents=True)
    rally = stage_rally(find_sports()["badminton"], TARGET)
    write_shot(rally, {}, "1", folder / "fresh")
    publish_shot(folder / "fresh", folder)
    (folder / "scene.json").write_text(json.dumps({"scene": "rally", "sport": "badminton", "fps": 25.0}))
    visitor = Visitor(folder.parent)
    yield visitor, folder
    for close in visitor.library.closers:
        close()


def ask(page: tuple[Visitor, Path], method: str, path: str = "", body: object = b"") -> tuple[int, dict[str, Any]]:
    visitor, folder = page
    reply = visitor.ask(method, f"api/shots/{visitor.library.identify(folder)}{path}", body)
    return reply.status, reply.document


def test_the_plan_shows_court_flights_and_landing(rally_page: tuple[Visitor, Path]) -> None:
    status, document = ask(rally_page, "GET")
    court = find_sports()["badminton"]
    assert (status, document["kind"], document["clip"]) == (200, "rally", False)
    plan = document["plan"]
    assert (plan["length"], plan["net"][0]) == (court.length, court.length / 2)
    assert len(plan["lines"]) == len(court.lines)
    (landing,) = document["landings"]
    assert [landing["x"], landing["y"]] == pytest.approx(TARGET, abs=0.01)
    assert landing["sxx"] == pytest.approx(0.03**2, rel=0.01)
    assert [one["player"] for one in document["strokes"]] == ["near"]
    path = plan["paths"][0]
    assert [path["x"][-1], path["y"][-1]] == pytest.approx(TARGET, abs=0.02)
    assert path["z"][0] == pytest.approx(1.0, abs=1e-3)
    camera = usual_view(court).camera
    frame, x, y, _ = document["run"]["balls"][0]["path"][0]
    frames = document["run"]["frames"]
    t = frames["t"][frame - frames["first"]]
    place = [np.interp(t, path["t"], path[axis]) for axis in "xyz"]
    assert camera.to_pixels(np.array([place]))[0] == pytest.approx([x, y], abs=2.0)
    assert document["numbers"][0]["title"].startswith("Stroke 1, 0.4")


@pytest.mark.parametrize(
    ("body", "words"),
    [({"question": "landing"}, ("landing",)), ({"question": "landing", "a": "doubles"}, ("landing", "doubles")),
     ({"question": "net"}, ("net",))],
    ids=("landing", "area", "net"),
)  # fmt: skip
def test_an_answer_is_that_of_the_command(
    body: dict[str, str], words: tuple[str, ...], rally_page: tuple[Visitor, Path], tmp_path: Path
) -> None:
    expected = trueroll.call(rally_page[1], *words, out=tmp_path)
    status, answer = ask(rally_page, "POST", "/ask", body)
    assert (status, answer["sentence"], answer["verdict"]) == (200, expected.sentences[0], expected.verdict)
    assert (answer["probability"], answer["picture"]) == (pytest.approx(expected.probability), None)


def test_a_flight_is_predicted_and_questions_of_billiards_are_refused(rally_page: tuple[Visitor, Path]) -> None:
    status, answer = ask(rally_page, "POST", "/predict", {"seconds": 2})
    assert (status, answer["question"].startswith("Where does the shuttle fly from")) == (200, True)
    assert [answer["paths"][0][axis][-1] for axis in "xy"] == pytest.approx(TARGET, abs=0.1)
    for method, path, body in (("POST", "/ask", {"question": "first"}), ("POST", "/what-if", {}),
                               ("GET", "/put-back", b"")):  # fmt: skip
        status, refusal = ask(rally_page, method, path, body)
        assert (status, "rally" in refusal["error"]) == (422, True), path


def test_a_prediction_honours_what_was_corrected_until_then(
    rally_page: tuple[Visitor, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The page and the command; what was marked later was not known at that moment."""
    folder = rally_page[1]
    marks = [{"kind": "mark", "event": "hit", "frame": 10.0}, {"kind": "mark", "event": "landing", "frame": 33.0},
             {"kind": "move", "event": "net", "frame": 15.0, "to_frame": 30.0}]  # fmt: skip
    scene = {"scene": "rally", "sport": "badminton", "fps": 25.0, "set_by_hand": {"events": marks}}
    (folder / "scene.json").write_text(json.dumps(scene))
    given = []

    def explain_rally(*values: Any) -> Rally:
        given.append(values[-1].events)
        return read_rally(folder)

    monkeypatch.setattr("models.estimation.rally.explain_rally.explain_rally", explain_rally)
    assert ask(rally_page, "POST", "/predict", {"at": 0.8, "seconds": 2})[0] == 200
    trueroll.predict(folder, at=0.8, out=tmp_path / "out")
    assert given == [(RallyCorrection("mark", "hit", 10.0),)] * 2
    (folder / "scene.json").write_text(json.dumps(scene | {"set_by_hand": {"events": 7}}))
    status, refusal = ask(rally_page, "POST", "/predict", {"at": 0.8, "seconds": 2})
    assert (status, "notes corrections that cannot be used" in refusal["error"]) == (422, True)
