"""What the page shows of a rally, and its answers: those of the commands."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.app_requests import Visitor
from support.filmed_rally import film_rally
from support.simple_rallies import usual_view
from support.staged_rally import stage_rally

import trueroll
from models.core.corrections import BallMark, BallPlace, Corrections, RallyCorrection
from models.core.rally import Rally
from models.estimation.rally.rally_marks import resolve_marks, settle_marks
from models.sports.sport_catalogue import find_sports
from pipeline.app.open_shots import ShotDesk
from pipeline.app.shot_library import ShotLibrary
from pipeline.editing.rally_view import CourtRun, describe_rally_run
from pipeline.io.corrections_file import SCHEMA, corrections_path
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
             {"kind": "move", "event": "net", "frame": 15.0, "to_frame": 30.0},
             {"kind": "move", "event": "bounce", "frame": 30.0, "to_frame": 15.0},
             {"kind": "move", "event": "hit", "frame": 12.0, "to_frame": 14.0}]  # fmt: skip
    scene = {"scene": "rally", "sport": "badminton", "fps": 25.0, "set_by_hand": {"events": marks}}
    (folder / "scene.json").write_text(json.dumps(scene))
    given = []

    def explain_rally(*values: Any) -> Rally:
        given.append(values[-1].events)
        return read_rally(folder)

    monkeypatch.setattr("models.estimation.rally.explain_rally.explain_rally", explain_rally)
    assert ask(rally_page, "POST", "/predict", {"at": 0.8, "seconds": 2})[0] == 200
    trueroll.predict(folder, at=0.8, out=tmp_path / "out")
    assert given[0] == (
        RallyCorrection("mark", "hit", 10.0), RallyCorrection("delete", "net", 15.0),
        RallyCorrection("mark", "bounce", 15.0), RallyCorrection("delete", "hit", 12.0),
        RallyCorrection("mark", "hit", 14.0),
    )  # fmt: skip
    assert given[1] == given[0]
    (folder / "scene.json").write_text(json.dumps(scene | {"set_by_hand": {"events": 7}}))
    status, refusal = ask(rally_page, "POST", "/predict", {"at": 0.8, "seconds": 2})
    assert (status, "notes corrections that cannot be used" in refusal["error"]) == (422, True)


@pytest.mark.parametrize("scene", [None, "{", "[]", "{}", '{"fps": [], "set_by_hand": {"events": 7}}'])
def test_a_rally_without_a_usable_scene_file_is_shown_and_predicted(
    scene: str | None, rally_page: tuple[Visitor, Path], tmp_path: Path
) -> None:
    file = rally_page[1] / "scene.json"
    file.unlink()
    if scene is not None:
        file.write_text(scene)
    status, document = ask(rally_page, "GET")
    assert (status, len(document["run"]["events"]), document["run"]["fps"]) == (200, 2, 0)
    assert ask(rally_page, "POST", "/predict", {"seconds": 2})[0] == 200
    assert trueroll.predict(rally_page[1], out=tmp_path / "out").sentences


def test_places_that_no_flight_has_were_detected_too() -> None:
    rally = stage_rally(find_sports()["badminton"], TARGET)
    used = np.zeros(len(rally.t), bool)
    view = describe_rally_run(CourtRun(25.0, replace(rally, is_used=used)), None)
    assert {point[3] for point in view["balls"][0]["path"]} == {1}


def test_every_contradiction_names_its_own_correction() -> None:
    """Two marks of one hundredth of a second are two; a mark after the clip has its own time; a place has none."""
    rally = stage_rally(find_sports()["badminton"], TARGET)
    hit = RallyCorrection("mark", "hit", 25 * rally.events[0].t)
    events = (hit, *(RallyCorrection("mark", "net", frame) for frame in (20.0, 20.01, 900.0)))
    marks = resolve_marks(events, rally.frame, rally.t)
    place = BallMark("placed", BallPlace(int(rally.frame[-1]) + 5, 3.0, 4.0))
    settled = settle_marks(rally, (place,), marks)
    rows = describe_rally_run(CourtRun(25.0, settled), None, Corrections(events=events))["contradictions"]
    assert [row["contact"] for row in rows] == [1, 2, 3, None]
    assert rows[2]["text"] == "Net set by hand at 36.00 s fits no flight."


@pytest.mark.parametrize(
    "change", [{}, {"sport": "tennis"}, {"corners": [[412, 310], [868, 310], [1190, 655], [90, 650]]}, {"fps": "50"}]
)
def test_a_rally_is_up_to_date_only_with_all_corrections_of_the_file(
    change: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip, rally = film_rally(tmp_path / "rally.mp4")
    folder = tmp_path / "library" / "rally"
    (folder / "fresh").mkdir(parents=True)
    write_shot(rally, {}, "1", folder / "fresh")
    publish_shot(folder / "fresh", folder)
    noted = {"sport": "badminton", "corners": [[412, 310], [868, 310], [1190, 655], [90, 655]]}
    (folder / "scene.json").write_text(json.dumps({"scene": "rally", "fps": 25.0, "set_by_hand": noted}))
    (folder / "source.json").write_text(json.dumps({"path": str(clip.path)}))
    corrections_path(clip.path).write_text(json.dumps({"schema": SCHEMA, **noted, **change}))
    shown = []

    class StillSession:
        def __init__(self, *given: Any) -> None:
            shown.append(given[3])

    monkeypatch.setattr("pipeline.app.open_shots.EditSession", StillSession)
    library = ShotLibrary(folder.parent)
    ShotDesk(library).open_session(library.identify(folder))
    assert (shown[0] is not None) == (not change)
