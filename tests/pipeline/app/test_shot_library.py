"""The library of shots: plain run folders as cards, quickly, and a trash."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from support.app_requests import THUMBNAIL, list_tree, write_run

from models.core.errors import OptionError
from pipeline.app import shot_library
from pipeline.app.refusals import Refusal
from pipeline.app.shot_library import ShotLibrary
from pipeline.io.run_folder import list_folders_with

LONG_AGO_NS = 1_700_000_000_000_000_000


def age(folder: Path) -> None:
    """Let all folders be as they are for long."""
    for path in (folder, *folder.rglob("*")):
        if path.is_dir() and ".trueroll-app" not in path.parts:
            os.utime(path, ns=(LONG_AGO_NS, LONG_AGO_NS))


def test_run_folders_at_any_depth_are_cards(tmp_path: Path) -> None:
    write_run(tmp_path / "break")
    write_run(tmp_path / "league" / "shot-0001")
    (tmp_path / "no-run").mkdir()
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "session.json").write_text("{}")
    cards = {card.name: card for card in ShotLibrary(tmp_path).list_cards()}
    assert sorted(cards) == ["break", "league, shot-0001", "session"]
    card = cards["break"]
    assert (card.kind, card.table, card.balls, card.seconds, card.trust) == ("shot", "pool-9ft", 2, 2.0, "high")
    assert (card.outcome, card.state, card.page) == ("The cue ball hit red 3 first", "done", "report.html")
    assert card.bytes == sum(path.stat().st_size for path in (tmp_path / "break").iterdir())
    assert (cards["session"].kind, cards["session"].page) == ("session", "session.html")


def test_a_card_is_dated_by_its_clip_and_quick_before_its_slow_motion(tmp_path: Path) -> None:
    clip = tmp_path / "clips" / "break.mp4"
    clip.parent.mkdir()
    clip.write_bytes(b"clip")
    os.utime(clip, (0, 1_000_000_000))
    folder = write_run(tmp_path / "break")
    (folder / "source.json").write_text(json.dumps({"path": str(clip)}))
    (folder / "slow.mp4").unlink()
    (card,) = ShotLibrary(tmp_path).list_cards()
    assert (card.date, card.state) == ("2001-09-09T01:46:40+00:00", "quick")
    assert card.added == min(path.stat().st_mtime for path in folder.iterdir())
    earlier = write_run(tmp_path / "earlier")  # filmed later, but longer in the library
    os.utime(earlier / "scene.json", (0, 1_700_000_000))
    assert [one.name for one in ShotLibrary(tmp_path).list_cards()] == ["break", "earlier"], "newest first"


def test_what_others_write_is_seen_and_what_is_unchanged_is_not_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(4):
        write_run(tmp_path / f"shot-{number}")
    age(tmp_path)
    library = ShotLibrary(tmp_path)
    revision, read = library.revision, list[str]()
    plain = shot_library._read_folder

    def note(path: Path, place: str, changed_ns: int) -> Any:
        read.append(place)
        return plain(path, place, changed_ns)

    monkeypatch.setattr(shot_library, "_read_folder", note)
    assert not library.refresh()
    assert (library.revision, read) == (revision, [""])  # the index is in the library itself
    write_run(tmp_path / "shot-2", balls=["cue ball"])
    (tmp_path / "shot-2" / "new").touch()  # files of runs are renamed into place, which changes the folder
    assert library.refresh()
    assert library.revision > revision
    assert {card.balls for card in library.list_cards() if card.name == "shot-2"} == {1}
    assert "shot-1" not in read


def test_two_thousand_shots_are_listed_again_at_once(tmp_path: Path) -> None:
    for number in range(2000):
        folder = tmp_path / f"{number // 100}" / f"{number}"
        folder.mkdir(parents=True)
        (folder / "scene.json").write_text('{"scene": "billiards"}')
    age(tmp_path)
    assert len(ShotLibrary(tmp_path).list_cards()) == 2000
    library = ShotLibrary(tmp_path)  # from the index
    begins = time.process_time()
    assert len(library.list_cards()) == 2000
    assert time.process_time() - begins < 0.1


@pytest.mark.parametrize("index", [b"", b"{", b"[]", b'{"format": 1}', b'{"format": 1, "folders": {"": 3}}'])
def test_a_damaged_index_is_made_again(index: bytes, tmp_path: Path) -> None:
    write_run(tmp_path / "break")
    before = ShotLibrary(tmp_path).list_cards()
    (tmp_path / ".trueroll-app" / "index.json").write_bytes(index)
    assert ShotLibrary(tmp_path).list_cards() == before


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"scene": 3, "table": 4, "clip": [], "trust": 1}',
        '{"scene": "billiards", "clip": {"seconds": "2"}}',
        '{"clip": {"seconds": NaN}}',
    ],
)
def test_a_damaged_run_does_not_hide_the_others(text: str, tmp_path: Path) -> None:
    write_run(tmp_path / "whole")
    damaged = write_run(tmp_path / "damaged")
    for name in ("scene.json", "summary.json", "source.json"):
        (damaged / name).write_text(text)
    assert "whole" in [card.name for card in ShotLibrary(tmp_path).list_cards()]


def test_nothing_outside_the_library_is_listed(tmp_path: Path) -> None:
    write_run(tmp_path / "elsewhere")
    library = tmp_path / "library"
    write_run(library / "own")
    (library / "link").symlink_to(tmp_path / "elsewhere")
    (library / "own" / "events.csv").symlink_to(tmp_path / "elsewhere" / "scene.json")
    one = ShotLibrary(library)
    (card,) = one.list_cards()
    assert card.name == "own"
    assert one.find_file(card.id, "slow.mp4").is_file()
    for name in ("events.csv", "../elsewhere/scene.json", "source.json", "slow.mp4/", ""):
        with pytest.raises(Refusal):
            one.find_file(card.id, name)
    assert one.read_thumbnail(card.id) == THUMBNAIL


def test_deleting_takes_the_uploaded_clip_along_and_can_be_undone(tmp_path: Path) -> None:
    library = ShotLibrary(tmp_path)
    (tmp_path / "clips").mkdir()
    for name in ("mine.mp4", "other.mp4"):
        (tmp_path / "clips" / name).write_bytes(b"clip")
    folder = write_run(tmp_path / "mine")
    (folder / "source.json").write_text(json.dumps({"path": str(tmp_path / "clips" / "mine.mp4")}))
    before = list_tree(tmp_path)
    (card,) = library.list_cards()
    undo = library.delete(card.id)
    assert library.list_cards() == []
    with pytest.raises(OptionError, match="holds no"):
        list_folders_with("scene.json", [tmp_path])  # the command line does not see it either
    assert [path.name for path in (tmp_path / "clips").iterdir()] == ["other.mp4"]
    used = library.measure_disk()
    assert used["trash_bytes"] >= card.bytes
    assert used["used_bytes"] >= used["trash_bytes"]
    ShotLibrary(tmp_path).restore(undo)  # also by another server
    assert {name: data for name, data in list_tree(tmp_path).items() if "index" not in name} == before
    assert [one.id for one in library.list_cards()] == [card.id]
    with pytest.raises(Refusal, match="no longer in the trash"):
        library.restore(undo)


def test_a_clip_that_another_card_needs_stays_until_that_is_deleted_too(tmp_path: Path) -> None:
    clip = tmp_path / "clips" / "mine.mp4"
    clip.parent.mkdir()
    clip.write_bytes(b"clip")
    for name in ("first", "second"):
        (write_run(tmp_path / name) / "source.json").write_text(json.dumps({"path": str(clip)}))
    library = ShotLibrary(tmp_path)
    library.delete(library.identify(tmp_path / "first"))
    assert clip.read_bytes() == b"clip"
    undo = library.delete(library.identify(tmp_path / "second"))
    assert not clip.exists()
    library.restore(undo)
    assert clip.read_bytes() == b"clip"


def test_restoring_overwrites_nothing_and_an_empty_trash_is_empty(tmp_path: Path) -> None:
    library = ShotLibrary(tmp_path)
    write_run(tmp_path / "one")
    undo = library.delete(library.list_cards()[0].id)
    write_run(tmp_path / "one", balls=[])
    with pytest.raises(Refusal, match="new folder one"):
        library.restore(undo)
    messages: list[dict[str, Any]] = []
    library.listeners.append(messages.append)
    library.empty_trash()
    with pytest.raises(Refusal, match="no longer"):
        library.restore(undo)
    assert messages == [{"type": "library", "revision": None}]  # no card has changed, but what is in the trash
    assert library.measure_disk()["trash_bytes"] == 0
    assert [card.balls for card in library.list_cards()] == [0]


def test_a_clip_in_the_trash_outlives_another_of_its_name(tmp_path: Path) -> None:
    library, clip = ShotLibrary(tmp_path), tmp_path / "clips" / "mine.mp4"
    clip.parent.mkdir()
    clip.write_bytes(b"mine")
    folder = write_run(tmp_path / "mine")
    (folder / "source.json").write_text(json.dumps({"path": str(clip)}))
    undo = library.delete(library.list_cards()[0].id)
    clip.write_bytes(b"another")
    with pytest.raises(Refusal, match=r"new clip clips/mine\.mp4"):
        library.restore(undo)
    assert (clip.read_bytes(), folder.exists()) == (b"another", False)
    clip.unlink()
    library.restore(undo)
    assert (clip.read_bytes(), folder.exists()) == (b"mine", True)


def test_a_clip_that_is_only_named_by_its_path_is_not_deleted(tmp_path: Path) -> None:
    clip = tmp_path / "film.mp4"
    clip.write_bytes(b"clip")
    library = ShotLibrary(tmp_path / "library")
    folder = write_run(tmp_path / "library" / "film")
    (folder / "source.json").write_text(json.dumps({"path": str(clip)}))
    library.delete(library.list_cards()[0].id)
    library.empty_trash()
    assert clip.read_bytes() == b"clip"


def test_a_name_is_refused_for_what_is_wrong_with_it_and_an_old_one_is_taken_back(tmp_path: Path) -> None:
    write_run(tmp_path / "a: shot")
    library = ShotLibrary(tmp_path)
    shot, before = library.rename(library.identify(tmp_path / "a: shot"), "better")
    with pytest.raises(Refusal, match="too long"):
        library.rename(shot, "Ü" * 100)
    with pytest.raises(Refusal, match="none of"):
        library.rename(shot, "another: shot")
    library = ShotLibrary(tmp_path)  # also after a restart
    assert library.read_former_names() == {shot: before}
    assert library.rename(shot, before)[0] == library.identify(tmp_path / "a: shot")


def test_a_new_name_holds_although_the_former_one_cannot_be_noted(tmp_path: Path) -> None:
    write_run(tmp_path / "shot")
    library = ShotLibrary(tmp_path)
    (library.own / "former-names.json").mkdir()  # no file can take its place
    library.rename(library.identify(tmp_path / "shot"), "better")
    assert [card.name for card in library.list_cards()] == ["better"]
    assert library.read_former_names() == {}


def test_the_case_of_a_name_is_changed_where_the_file_system_ignores_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path / "shot")
    library = ShotLibrary(tmp_path)
    plain = Path.lstat
    monkeypatch.setattr(Path, "exists", lambda path: True)
    monkeypatch.setattr(Path, "lstat", lambda path: plain(path.with_name(path.name.lower())))
    library.rename(library.identify(tmp_path / "shot"), "Shot")
    assert [path.name for path in tmp_path.iterdir() if not path.name.startswith(".")] == ["Shot"]
