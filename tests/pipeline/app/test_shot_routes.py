"""Answers of the page about one shot: those of the commands, from plain run folders."""

from __future__ import annotations

import gc
import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch
from weakref import ref

import numpy as np
import pytest
from PIL import Image
from support import synthetic_run
from support.app_requests import Reply, Visitor
from support.carom_start import SLOW, Home

import pipeline.app.open_shots as open_shots
import trueroll
from models.core.errors import OptionError
from models.core.number_format import format_measured
from models.core.shot import Shot
from pipeline.actions.play_otherwise import PLAYS
from pipeline.actions.share_call import write_share_clip
from pipeline.app.open_shots import ShotDesk
from pipeline.app.shot_document import describe_shot
from pipeline.app.shot_library import ShotLibrary
from pipeline.editing.edited_clip import EditedClip
from pipeline.io.saved_shot import read_shot

NAME = "start"


class ShotPage:
    """A page that shows one shot of a library."""

    def __init__(self, library: Path) -> None:
        self.visitor = Visitor(library)
        self.folder = library / NAME
        self.messages: list[dict[str, Any]] = []
        self.visitor.library.listeners.append(self.messages.append)

    @property
    def id(self) -> str:
        return self.visitor.library.identify(self.folder)

    def ask(self, method: str, path: str = "", body: bytes | object = b"", **headers: str) -> Reply:
        """Send a request below the address of the shot."""
        return self.visitor.ask(method, f"api/shots/{self.id}{path}", body, **headers)

    def get(self, path: str = "") -> dict[str, Any]:
        reply = self.ask("GET", path)
        assert reply.status == 200, reply.body
        return reply.document

    def post(self, path: str, **body: object) -> dict[str, Any]:
        reply = self.ask("POST", path, body)
        assert reply.status == 200, reply.body
        return reply.document

    def close(self) -> None:
        for close in self.visitor.library.closers:
            close()


@pytest.fixture(autouse=True)
def no_models(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pages warm nothing up, and find no contact models of whole shots, which takes up to a minute."""
    monkeypatch.setattr(open_shots.OpenShot, "warm_up", lambda self: None)
    monkeypatch.setattr(open_shots, "load_laws", lambda *_: None)


@pytest.fixture(scope="module")
def library(home: Home, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A library with a run, which tests only read; its clip is where it was."""
    root = tmp_path_factory.mktemp("library")
    shutil.copytree(home.out, root / NAME)
    return root


@pytest.fixture
def page(library: Path, home: Home, monkeypatch: pytest.MonkeyPatch) -> Iterator[ShotPage]:
    monkeypatch.setenv("TRUEROLL_CACHE", str(home.cache))
    opened = ShotPage(library)
    yield opened
    opened.close()


def test_the_document_holds_what_the_files_of_the_run_hold(page: ShotPage, home: Home) -> None:
    document = page.get()
    run, plan = document["run"], document["plan"]
    assert (document["game"], document["balls_on"]) == ("carom", []), "fouls are not judged in carom"
    assert (document["kind"], document["revision"], document["result"], document["outputs"]) == (
        "shot",
        0,
        0,
        "current",
    )
    assert [one["t"] for one in run["events"]] == pytest.approx(home.column("events.csv", "t"), abs=1e-5)
    assert [one["xy"][0] for one in run["events"]] == pytest.approx(home.column("events.csv", "x"), abs=1e-5)
    assert run["trust"]["level"] == home.scene["trust"]["light"]
    assert run["frames"]["distinct"] == sorted({int(row["frame"]) for row in home.rows("tracks.csv")})
    summary = json.loads((page.folder / "summary.json").read_text())
    assert run["calls"] == {one["question"]: one["answer"] for one in summary["calls"]}
    assert document["summary"][0] in summary["sentences"][0]
    assert document["numbers"][0]["rows"][0][0] == "Speed after the strike, white"
    end = home.scene["clip"]["begins"] + home.scene["clip"]["seconds"]
    assert document["video"]["file"] == "slow.mp4"
    np.testing.assert_allclose(document["video"]["map"], [[0, 0], [SLOW * end, end]], atol=0.05)
    assert (plan["length"], plan["pockets"]) == (home.scene["table"]["length"], [])
    motion = trueroll.load(page.folder).trajectory
    for path in plan["paths"]:
        own = motion.at(np.array(path["t"])).xy[:, motion.ids.index(path["id"])]
        np.testing.assert_allclose(np.array([path["x"], path["y"]], float).T, own, atol=3e-4)
    hit = next(one for one in run["events"] if one["kind"] == "cushion")
    assert min(abs(t - hit["t"]) for t in plan["paths"][0]["t"]) < 1e-4, "a path has its corner at the contact"


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ({"question": "touch", "a": "white", "b": "yellow"}, ("contact", "white", "yellow")),
        ({"question": "first"}, ("first", "white")),
        ({"question": "rail", "a": "white", "b": "top"}, ("rail", "white", "top")),
        ({"question": "score"}, ("score",)),
    ],
    ids=lambda value: value.get("question", "") if isinstance(value, dict) else "",
)
def test_a_question_has_the_answer_of_the_command(
    question: dict[str, str], words: tuple[str, ...], page: ShotPage, tmp_path: Path
) -> None:
    expected = trueroll.call(page.folder, *words, out=tmp_path)
    answer = page.post("/ask", **question)
    assert answer["sentences"] == list(expected.sentences)
    assert (answer["question"], answer["verdict"]) == (expected.question, expected.verdict)
    assert answer["probability"] == pytest.approx(expected.probability, abs=1e-12)
    assert answer["t"] == pytest.approx(expected["time"].value, abs=1e-12)
    assert answer["reasons"] == [*expected.sentences[1:], *expected.notes]
    picture = page.visitor.ask("GET", answer["picture"])
    assert picture.headers["content-type"] == "image/png"
    with Image.open(io.BytesIO(picture.body)) as shown, Image.open(expected.figures[0]) as written:
        assert np.array_equal(np.asarray(shown), np.asarray(written))


@pytest.mark.parametrize(
    ("body", "status", "sentence"),
    [
        ({"question": "touch", "a": "white", "b": "blue"}, 422, "no ball of this clip is 'blue'"),
        ({"question": "touch", "a": "white"}, 422, "contact needs two balls"),
        ({"question": "touch", "a": ["white"], "b": "red"}, 422, "a is a text of at most 64 characters."),
        ({"question": "pocket", "a": "white", "b": "top-left"}, 422, "this table has no pockets"),
        ({"question": "landing"}, 422, "ask contact A B"),
        ({}, 422, "ask contact A B"),
        ([], 422, "A JSON object was expected"),
    ],
)
def test_a_question_that_makes_no_sense_gets_one_sentence(
    body: object, status: int, sentence: str, page: ShotPage
) -> None:
    reply = page.ask("POST", "/ask", json.dumps(body).encode())
    assert (reply.status, "\n" in reply.sentence) == (status, False)
    assert sentence in reply.sentence


def test_the_balls_are_put_back_where_the_command_says(page: ShotPage, tmp_path: Path) -> None:
    shot = read_shot(page.folder)
    expected = trueroll.put_back(page.folder, out=tmp_path).document
    before = page.get("/put-back")
    assert [one["id"] for one in before["balls"]] == [one["id"] for one in expected["balls"]]
    assert (before["t"], before["frame"]) == pytest.approx((expected["t"], expected["frame"]), abs=1e-6)
    for ball, row in zip(before["balls"], expected["balls"], strict=True):
        assert ball["xy"] == pytest.approx([row["x"], row["y"]], abs=1e-5)
        radius = shot.scene.table.ball_radius
        assert ball["px"] == pytest.approx(shot.scene.camera.to_pixels(np.array(ball["xy"]), radius).tolist(), abs=2.0)
        side = min(("top", "bottom"), key=lambda name: row[f"{name}_mm"])
        value, sigma = format_measured(row[f"{side}_mm"], row["y_sigma_mm"], 1)
        assert f"{value} ± {sigma} mm from the {'far' if side == 'top' else 'near'} long cushion" in ball["text"]
    later = page.get("/put-back?frame=40")
    assert later["frame"] == 40
    reply = page.ask("GET", "/put-back?frame=x")
    assert (reply.status, reply.sentence) == (422, "frame is the number of a frame.")


def test_a_stroke_that_is_not_changed_follows_the_film_and_one_that_is_turned_does_not(page: ShotPage) -> None:
    shot = read_shot(page.folder)
    same = page.post("/what-if")
    assert same["sentences"][0].startswith("Nothing is changed. In the film: the white ")
    assert (same["is_final"], same["model"], same["draws"]) == (True, "segments", PLAYS)
    strike = same["t"]
    k = shot.tracks.ids.index("white")
    real = shot.tracks.xy[:, k]

    def place(answer: dict[str, Any], t: float) -> np.ndarray:
        path = next(one for one in answer["paths"] if one["id"] == "white")
        return np.array([np.interp(t, path["t"], path[axis]) for axis in "xy"])

    row = int(np.argmin(np.abs(shot.tracks.t - strike - 0.2)))
    t = float(shot.tracks.t[row])
    assert place(same, t) == pytest.approx(real[row], abs=0.01)
    quick = page.post("/what-if", is_quick=True)
    assert (quick["is_final"], quick["draws"]) == (False, open_shots.QUICK_PLAYS), "all plays are asked for next"
    turned = page.post("/what-if", angle_deg=90.0)
    start, before, after = place(same, strike), real[row] - place(same, strike), place(turned, t) - place(same, strike)
    assert np.hypot(*after) == pytest.approx(np.hypot(*before), rel=0.05)
    assert abs(before @ after) < 0.03 * (before @ before), f"not square, from {start}"
    faster = page.post("/what-if", speed_percent=10.0, top_percent=-20)
    assert "% more speed" in faster["sentences"][0]
    assert faster["stroke"]["changed"]["speed"] == pytest.approx(1.1 * faster["stroke"]["real"]["speed"], rel=1e-6)


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ({"speed_percent": -100}, "The speed is a change of -99%"), ({"speed_percent": "fast"}, "is a number."),
        ({"stroke": 7}, "shot 6 is not among them"), ({"stroke": 1.5}, "stroke is the number of a stroke"),
        ({"game": "pot"}, "The game pot needs a table"), ({"spread": "wide"}, "The player's spread is a share"),
        ({"top_percent": True}, "top_percent is a number."), ({"game": "darts"}, "The game is one of pot, carom"),
        ({"angle_deg": float("nan")}, "angle_deg is a number."),
    ],
)  # fmt: skip
def test_a_change_that_cannot_be_played_gets_one_sentence(body: object, sentence: str, page: ShotPage) -> None:
    reply = page.ask("POST", "/what-if", body)
    assert (reply.status, sentence in reply.sentence) == (422, True), reply.sentence


def test_the_chances_are_those_of_the_command(page: ShotPage, home: Home, tmp_path: Path) -> None:
    expected = trueroll.what_if(page.folder, speed="+10%", out=tmp_path)
    answer = page.post("/what-if", speed_percent=10.0)
    assert [one["probability"] for one in answer["chance"].values()] == [one.value for one in expected.quantities]


def test_frames_are_those_of_the_clip(page: ShotPage, home: Home) -> None:
    frame = page.ask("GET", "/frame/35")
    assert (frame.status, frame.headers["content-type"]) == (200, "image/jpeg")
    from video.io.clip import open_clip, read_frames

    ((_, expected),) = read_frames(open_clip(home.clip), indices=[35])
    with Image.open(io.BytesIO(frame.body)) as shown:
        assert np.abs(np.asarray(shown).astype(float) - expected).mean() < 3.0
    assert page.ask("GET", "/frame/9999").sentence == "There is no such frame."
    for path in ("/frame/-1", "/frame/1e9", "/frame/../../scene.json"):
        assert page.ask("GET", path).status == 404


def test_a_prediction_is_that_of_the_command(page: ShotPage, tmp_path: Path) -> None:
    expected = trueroll.predict(page.folder, out=tmp_path)
    answer = page.post("/predict")
    assert answer["sentences"] == list(expected.sentences)
    ends = {one["id"]: one["end"] for one in expected.document["balls"]}
    for one in answer["spread"]:
        assert [one["x"], one["y"]] == pytest.approx([ends[one["id"]]["x"], ends[one["id"]]["y"]])
    assert answer["paths"][0]["t"][-1] == pytest.approx(answer["at"] + 3.0, abs=1e-3)
    refused = {"The moment must lie within what was seen": {"at": 99.0}, "seconds is above 0": {"seconds": 1e6},
               "Nothing moves at this moment; choose one after the stroke.": {"at": 0.1}}  # fmt: skip
    for sentence, body in refused.items():
        reply = page.ask("POST", "/predict", body)
        assert (reply.status, reply.sentence.startswith(sentence)) == (422, True)


def test_what_is_shared_lies_in_the_run_folder(page: ShotPage, monkeypatch: pytest.MonkeyPatch) -> None:
    import pipeline.app.shot_routes as shot_routes

    monkeypatch.setattr(shot_routes, "write_share_clip", lambda *given: given[-1].write_bytes(b"a clip"))
    files = page.post("/share", question="touch", a="white", b="yellow")["files"]
    assert [one["name"] for one in files] == [
        "call_contact_white_yellow.mp4", "call_contact_white_yellow.png", "call_contact_white_yellow_strip.png",
        "slow.mp4", "poster.png", "report.html",
    ]  # fmt: skip
    for one in files:
        reply = page.visitor.ask("GET", one["address"])
        assert (reply.status, len(reply.body)) == (200, one["bytes"])
    for name in ("..%2f..%2fscene.json", "scene.json", "call.txt", ".hidden.png"):
        assert page.ask("GET", f"/shared/{name}").status == 404
    shutil.rmtree(page.folder / "share")
    assert [one["name"] for one in page.post("/share")["files"]] == ["slow.mp4", "poster.png", "report.html"]
    assert page.ask("POST", "/share", {"question": "touch", "a": "white", "b": "blue"}).status == 422
    assert not (page.folder / "share").exists()


def save_still(folder: Path) -> Shot:
    """Save a shot in which nothing moves, with the files that the library reads."""
    clip, scene = synthetic_run.write_clip(folder / "clip.mp4"), synthetic_run.make_scene()
    tracks = synthetic_run.make_tracks(clip, scene)
    shot = synthetic_run.make_unexplained_shot(replace(tracks, xy=np.full_like(tracks.xy, 0.3)), scene)
    synthetic_run.save_shot(shot, folder)
    (folder / "scene.json").write_text(json.dumps({"scene": "billiards", "fps": 30.0, "table": {"name": "carom"}}))
    (folder / "source.json").write_text(json.dumps({"path": str(folder / "clip.mp4")}))
    return shot


def test_an_empty_run_a_failed_one_and_a_moved_clip_get_a_sentence_each(tmp_path: Path, own_home: Home) -> None:
    folder = tmp_path / "library" / NAME
    folder.mkdir(parents=True)
    save_still(folder)
    page = ShotPage(folder.parent)
    document = page.get()
    assert (document["run"]["events"], document["run"]["calls"], document["video"]) == ([], {}, None)
    first = page.ask("POST", "/ask", {"question": "first"})
    assert first.sentence == "The clip does not show which ball was struck; name one."
    assert page.ask("POST", "/what-if", {}).sentence.startswith("physics could not be fitted")
    sentence = OptionError("the table is unknown", option="corners", remedy="radius")
    with patch.object(ShotDesk, "open_session", side_effect=sentence):
        notice = page.get()["notice"]
    assert notice == "This shot cannot be corrected: The corners of the table the table is unknown"
    (folder / "clip.mp4").unlink()
    document = page.get()
    assert document["clip"] is False
    assert document["notice"].startswith("This shot cannot be corrected: The clip of this run is no longer at ")
    for reply in (page.ask("GET", "/frame/1"), page.ask("PUT", "/corrections", {}, if_match='"0"')):
        assert (reply.status, "no longer at" in reply.sentence) == (422, True)
    shutil.rmtree(folder / "shot")
    assert "holds no saved shot" in page.ask("GET").sentence
    page.close()


def test_a_shot_that_was_run_again_is_read_again_and_few_are_kept(tmp_path: Path) -> None:
    folders = [tmp_path / "library" / name for name in (NAME, *"abcdef")]
    for folder in folders:
        folder.mkdir(parents=True)
        save_still(folder)
    page = ShotPage(tmp_path / "library")
    desk = open_shots.ShotDesk(page.visitor.library)
    first = desk.open(page.id)
    assert desk.open(page.id) is first
    moved = replace(first.shot, tracks=replace(first.shot.tracks, ids=("white", "yellow"), looks=()))
    synthetic_run.save_shot(moved, page.folder)
    assert desk.open(page.id).shot.tracks.ids == ("white", "yellow")
    for folder in folders:
        desk.open(page.visitor.library.identify(folder))
    assert len(desk._shots) == open_shots.KEPT_SHOTS
    watched = ref(desk.open(page.id))
    describe_shot(desk.open(page.id), None)
    for folder in folders[1:]:
        desk.open(page.visitor.library.identify(folder))
    del first
    gc.collect()
    assert watched() is None
    desk.close()
    page.close()


class IdleSession:
    """Stands in for a session of corrections."""

    is_outdated = False

    def __init__(self, edited: EditedClip, *_: object) -> None:
        self.edited = edited
        self.status = SimpleNamespace(stage="")
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


def test_the_sessions_that_were_not_used_for_longest_are_closed_unless_they_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(open_shots, "EditSession", IdleSession)
    for name in "abcdef":
        (tmp_path / "library" / name).mkdir(parents=True)
        save_still(tmp_path / "library" / name)
    library = ShotLibrary(tmp_path / "library")
    desk = open_shots.ShotDesk(library)
    shots = [library.identify(tmp_path / "library" / name) for name in "abcdef"]
    sessions: list[Any] = [desk.open_session(shot) for shot in shots[: open_shots.KEPT_SHOTS]]
    assert not any(one.is_closed for one in sessions)
    desk.open_session(shots[0])
    sessions[1].status.stage = "explain"
    for shot in shots[open_shots.KEPT_SHOTS :]:
        desk.open_session(shot)
    assert [one.is_closed for one in sessions] == [False, False, True, True]
    desk.close()


def test_images_that_a_browser_keeps_have_other_addresses_after_a_change(page: ShotPage, tmp_path: Path) -> None:
    before = page.get()["version"]
    assert f"version={before}" in page.post("/ask", question="first")["picture"]
    shutil.copytree(page.folder, tmp_path / "library" / NAME)
    other = ShotPage(tmp_path / "library")
    source = other.folder / "source.json"
    assert other.get()["version"] == before
    source.write_text(source.read_text() + "\n")
    assert other.get()["version"] != before
    other.close()


def test_a_clip_to_share_without_a_moment_is_refused_in_words_of_the_page() -> None:
    anything: Any = None
    call: Any = SimpleNamespace(t=float("nan"))
    with pytest.raises(OptionError) as caught:
        write_share_clip(anything, call, anything, anything, anything, anything, Path("a.mp4"))
    assert "moment" in str(caught.value)
    assert "--" not in str(caught.value)
