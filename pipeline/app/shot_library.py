"""The library of shots: plain run folders below one folder, listed as cards.

The folders are the only state. What is expensive to read is kept in an index that may be deleted at any time.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pipeline.app.refusals import Refusal
from pipeline.engine.atomic_write import write_text

# Folder within the library for queue, trash and index, and that of uploaded clips.
APP_FOLDER, CLIP_FOLDER = ".trueroll-app", "clips"
# What commands on several shots write, by command; each has a folder of its own, numbered within a day.
SESSION_FOLDER, SESSION_NAMES = "sessions", {"compare": "Comparison", "certify": "Certificate", "diagnose": "Diagnosis"}
SESSION_PLACE = re.compile(rf"{SESSION_FOLDER}/({'|'.join(SESSION_NAMES)})-(\d{{4}}-\d\d-\d\d)-(\d+)")
# Of a name of a folder or a clip: a file system takes 255, and files beside a clip have longer names. Letters that it
# must not have.
MAX_NAME_BYTES, NO_LETTERS = 180, '<>:"|?*/\\'
# Of the index; cards of another version are read again.
INDEX_FORMAT = 3
# Deepest folder that is searched, as a batch mirrors the tree of its clips; most folders, so that a home folder that is
# taken as a library is no endless search.
MAX_DEPTH, MAX_FOLDERS = 8, 20_000
# ns: a folder that changed less long ago may change again within the resolution of its time of change.
SETTLE_NS = 2_000_000_000
TRUST_WORDS = {"green": "high", "amber": "medium", "red": "low"}
# Documents that make a folder a card, with its kind and page: runs, then what commands write on several runs.
RUN_FILE, SOURCE_FILE = "scene.json", "source.json"
PAGES = {"session.json": ("session", "session.html"), "certificate.json": ("session", "certificate.html"),
         "gap.json": ("diagnosis", "gap.html")}  # fmt: skip
# Files of a folder that the page may ask for, with their types.
FILE_TYPES = {
    "slow.mp4": "video/mp4", "poster.png": "image/png", "report.html": "text/html", "recording.rrd":
    "application/octet-stream", "tracks.csv": "text/csv", "events.csv": "text/csv", "trajectory.csv": "text/csv",
    "scene.json": "application/json", "session.html": "text/html", "session.csv": "text/csv", "session.json":
    "application/json", "certificate.html": "text/html", "certificate.json": "application/json", "gap.html":
    "text/html", "gap.json": "application/json", "gap_predictions.csv": "text/csv",
}  # fmt: skip
# Folder of a run for the files that were written to be shared, and their names.
SHARE_FOLDER, SHARED_NAME = "share", re.compile(r"[A-Za-z0-9][A-Za-z0-9_.=-]{0,120}\.(png|mp4)")


@dataclass(frozen=True, slots=True)
class Card:
    """What the library shows of a folder."""

    id: str
    name: str
    folder: str
    """Last part of its path, which can be changed."""
    kind: str
    """shot, rally, recording, session or diagnosis."""
    date: str
    """Of the clip, ISO 8601."""
    added: float
    """s since 1970 when it came into the library: of its oldest file."""
    table: str
    balls: int | None
    seconds: float
    trust: str
    """high, medium, low, or empty."""
    outcome: str
    thumbnail: bool
    state: str
    """done; quick, before the slow motion is made; running or failed."""
    error: str
    page: str
    """Name of its page of HTML; empty for none."""
    bytes: int

    def describe(self) -> dict[str, Any]:
        """Return the card as JSON values; `asdict` takes ten times as long, which thousands of cards show."""
        return {name: getattr(self, name) for name in CARD_FIELDS}


# Message that lets all pages read the library again, also where no card has changed.
RELOAD: dict[str, Any] = {"type": "library", "revision": None}
CARD_FIELDS = tuple(one.name for one in fields(Card))


@dataclass(frozen=True, slots=True)
class _Folder:
    """What was read of a folder when it had this time of change."""

    changed_ns: int
    """0 where it may have changed since."""
    children: tuple[str, ...]
    card: Card | None


class ShotLibrary:
    """The library in one folder; safe to use from several threads."""

    def __init__(self, root: Path, depth: int = MAX_DEPTH) -> None:
        """Read the library.

        Args:
            root: Its folder; it need not exist.
            depth: Deepest folder that is searched, counted from `root`.
        """
        self.root, self._depth = root.absolute(), depth
        self.own = self.root / APP_FOLDER
        """Folder of queue, trash and index."""
        self.clips = self.root / CLIP_FOLDER
        """Folder of uploaded clips."""
        self.closers: list[Callable[[], None]] = []
        """Called when the server stops."""
        self.closing_listeners: list[Callable[[str], None]] = []
        """Called with the id of a card before its folder is moved: renamed, or to the trash."""
        self.listeners: list[Callable[[dict[str, Any]], None]] = []
        """Called with every message to the pages."""
        self._lock = threading.RLock()
        self._folders = self._read_index()
        self._paths: dict[str, str] = {}
        self._names_file = self.own / "former-names.json"
        self._revision = int(time.time() * 10)  # grows also from one start to the next
        self.refresh()

    def announce(self, **message: Any) -> None:
        """Send a message to all pages, such as `type="shot", id=...`."""
        for listener in list(self.listeners):
            listener(message)

    def find_folder(self, shot: str) -> Path:
        """Find the folder of a card.

        Args:
            shot: Its id.

        Returns:
            An existing folder within the library.

        Raises:
            Refusal: There is none.
        """
        with self._lock:
            if shot not in self._paths:
                self.refresh()
            place = self._paths.get(shot)
        folder = None if place is None else self.root / place
        if folder is None or not folder.is_dir() or self.root.resolve() not in folder.resolve().parents:
            raise Refusal(404, "There is no such shot in the library.")
        return folder

    def has_card(self, shot: str) -> bool:
        """Whether there is a card of this id, as of the last `refresh`."""
        return shot in self._paths

    def read_clip(self, folder: Path) -> Path:
        """Read which clip a run folder was made from; an empty path where that is not known."""
        return Path(str(_read_object(folder / SOURCE_FILE).get("path", "")))

    def is_clip_used(self, clip: Path, besides: Path | None = None) -> bool:
        """Whether a card, as of the last `refresh`, was made from this clip, whatever its folder is called now.

        Args:
            clip: Path of the clip.
            besides: Folder of a card that does not count, nor do those within it.
        """
        folders = [self.root / place for place in list(self._paths.values())]
        others = [one for one in folders if besides is None or not one.is_relative_to(besides)]
        return any(self.read_clip(one) == clip for one in others)

    def identify(self, folder: Path) -> str:
        """Return the id of a folder within the library."""
        return _identify(folder.absolute().relative_to(self.root).as_posix())

    def name_folder(self, folder: Path) -> str:
        """Return the name of the card of a folder within the library."""
        return _name_card(folder.relative_to(self.root).as_posix())

    def find_file(self, shot: str, name: str) -> Path:
        """Find a file of a card by one of the fixed names; raises Refusal."""
        return _require_file(self.find_folder(shot) / name, name in FILE_TYPES)

    def find_shared(self, shot: str, name: str) -> Path:
        """Find a file that was written to be shared; raises Refusal."""
        return _require_file(self.find_folder(shot) / SHARE_FOLDER / name, SHARED_NAME.fullmatch(name) is not None)

    def read_thumbnail(self, shot: str) -> bytes:
        """Read the small JPEG of a card; raises Refusal."""
        uri = str(_read_object(self.find_folder(shot) / "summary.json").get("thumbnail", ""))
        try:
            content = base64.b64decode(uri.partition(",")[2], validate=True)
        except ValueError:
            content = b""
        if not content:
            raise Refusal(404, "This shot has no small image.")
        return content

    @property
    def revision(self) -> int:
        """Number that grows with every change that `refresh` finds."""
        return self._revision

    def list_cards(self) -> list[Card]:
        """List all cards as they are now, newest first."""
        self.refresh()
        with self._lock:
            cards = [one.card for one in self._folders.values() if one.card is not None]
        return sorted(cards, key=lambda card: card.added, reverse=True)

    def refresh(self) -> bool:
        """Read again what has changed on disk.

        Returns:
            Whether anything has.
        """
        with self._lock:
            before, folders = self._folders, dict[str, _Folder]()
            for place, folder in self._walk():
                folders[place] = folder
            changed = {p: f.card for p, f in before.items() if f.card} != {
                p: f.card for p, f in folders.items() if f.card
            }
            self._folders = folders
            if changed or not self._paths:
                self._paths = {one.card.id: place for place, one in folders.items() if one.card is not None}
            if changed:
                self._revision += 1
                self._write_index()
        return changed

    def _walk(self) -> Iterator[tuple[str, _Folder]]:
        """Yield all folders by their path within the library; unchanged ones are not read again."""
        waiting, number = [("", 0)], 0
        while number < min(len(waiting), MAX_FOLDERS):
            place, depth = waiting[number]
            number += 1
            path = self.root / place if place else self.root
            try:
                changed = os.stat(path).st_mtime_ns
                folder = self._folders.get(place)
                if folder is None or folder.changed_ns != changed:
                    folder = _read_folder(path, place, changed)
            except OSError:
                continue
            yield place, folder
            if depth < self._depth and len(waiting) < MAX_FOLDERS:
                waiting += [(f"{place}/{name}" if place else name, depth + 1) for name in folder.children]

    def measure_disk(self) -> dict[str, int]:
        """Measure the bytes that the library takes, those of them in the trash, and those that are free."""
        with self._lock:
            results = sum(one.card.bytes for one in self._folders.values() if one.card)
        trash = sum(int(entry.get("bytes", 0)) for _, entry in self._list_trash())
        clips = 0
        with suppress(OSError), os.scandir(self.clips) as entries:
            clips = sum(entry.stat(follow_symlinks=False).st_size for entry in entries)
        place = self.root if self.root.exists() else self.root.parent
        free = shutil.disk_usage(place).free
        return {"used_bytes": results + clips + trash, "trash_bytes": trash, "free_bytes": free}

    def rename(self, shot: str, name: str) -> tuple[str, str]:
        """Rename the folder of a card.

        Args:
            shot: Id of the card.
            name: New name of the folder, within the folder that it is in.

        Returns:
            The new id of the card, and the old name of the folder.

        Raises:
            Refusal: There is no such card, or the name cannot be used.
        """
        folder = self.find_folder(shot)
        former = self.read_former_names()
        if name != former.get(shot):  # which may be one that only a command line gives
            if len(name.encode(errors="replace")) > MAX_NAME_BYTES:
                raise Refusal(422, "This name is too long; choose a shorter one.")
            if not name or clean_name(name) != name:
                allowed = f"none of {NO_LETTERS} , no dot at its start, and no space at its ends"
                raise Refusal(422, f"A name has at least one letter, {allowed}.")
            if folder.parent == self.root and name in (CLIP_FOLDER, SESSION_FOLDER):
                raise Refusal(422, f"The library itself has a folder {name}; choose another name.")
        place = folder.with_name(name)
        # Where the case of letters is ignored, the new name may be that of the folder itself.
        is_other = name == folder.name or (place.exists() and not os.path.samestat(place.lstat(), folder.lstat()))
        if is_other:
            raise Refusal(409, f"There is something with the name {name} already; choose another name.")
        for close in self.closing_listeners:
            close(shot)
        folder.rename(place)
        new = self.identify(place)
        former = {card: one for card, one in former.items() if card in self._paths and card != shot}
        with suppress(OSError):  # the new name holds all the same
            write_text(self._names_file, json.dumps(former | {new: folder.name}))
        self.announce_changes()
        return new, folder.name

    def read_former_names(self) -> dict[str, str]:
        """Read which name the folder of each card had before its last renaming, by the id of the card."""
        return {card: name for card, name in _read_object(self._names_file).items() if isinstance(name, str)}

    # The trash: a folder per deletion, with the run folder, the uploaded clip, and where both belong.

    def delete(self, shot: str) -> str:
        """Move a folder of the library to the trash, with its clip if that was uploaded and no other card needs it.

        Args:
            shot: Id of its card.

        Returns:
            The token to restore it with.

        Raises:
            Refusal: There is none.
        """
        folder, token = self.find_folder(shot), secrets.token_hex(8)
        place = folder.relative_to(self.root).as_posix()
        clip = self.read_clip(folder)
        entry: dict[str, Any] = {"folder": place, "bytes": _measure_tree(folder)}
        is_part = "first" in _read_object(folder / SOURCE_FILE)
        if clip.parent == self.clips and clip.is_file() and not is_part and not self.is_clip_used(clip, folder):
            entry |= {"clip": clip.name, "bytes": entry["bytes"] + clip.stat().st_size}
        for close in self.closing_listeners:
            close(shot)
        home = self.own / "trash" / token
        write_text(home / "entry.json", json.dumps(entry))  # first, so that a killed server can put everything back
        folder.rename(home / "folder")
        if "clip" in entry:
            clip.rename(home / "clip")
        self.announce_changes()
        return token

    def restore(self, token: str) -> None:
        """Restore what `delete` moved to the trash; raises Refusal."""
        with self._lock:
            home, entry = next(((home, entry) for home, entry in self._list_trash() if home.name == token), (None, {}))
            if home is None:
                raise Refusal(404, "This is no longer in the trash.")
            moves = {home / "folder": self.root / entry["folder"]}
            if (home / "clip").exists():  # else a server was killed after it had moved it
                moves = {home / "clip": self.clips / entry["clip"]} | moves
            for place in moves.values():
                if place.exists():
                    what = "folder" if place.is_dir() else "clip"
                    raise Refusal(409, f"There is a new {what} {place.relative_to(self.root)}; rename it first.")
            for source, place in moves.items():
                place.parent.mkdir(parents=True, exist_ok=True)
                source.rename(place)
            shutil.rmtree(home, ignore_errors=True)
        self.announce_changes()

    def list_trash(self) -> list[dict[str, Any]]:
        """List what `delete` moved to the trash by token (`undo`), name and bytes, in the order of the names."""
        entries = [
            {"undo": home.name, "name": _name_card(str(entry["folder"])), "bytes": int(entry.get("bytes", 0))}
            for home, entry in self._list_trash()
        ]
        return sorted(entries, key=lambda entry: str(entry["name"]))

    def empty_trash(self) -> None:
        """Delete what is in the trash for good."""
        shutil.rmtree(self.own / "trash", ignore_errors=True)
        self.announce(**RELOAD)

    def announce_changes(self) -> None:
        """Tell the pages of changes on disk, if there are any."""
        if self.refresh():
            self.announce(type="library", revision=self.revision)

    def _list_trash(self) -> list[tuple[Path, dict[str, Any]]]:
        """List the folders of the trash with their entries."""
        return [(path.parent, entry) for path in (self.own / "trash").glob("*/entry.json")
                if "folder" in (entry := _read_object(path)) and path.with_name("folder").exists()]  # fmt: skip

    def _read_index(self) -> dict[str, _Folder]:
        """Read the index; empty where it is missing, damaged or of another version."""
        document = _read_object(self.own / "index.json")
        with suppress(TypeError, KeyError, ValueError):
            if document["format"] == INDEX_FORMAT:
                return {
                    place: _Folder(one[0], tuple(one[1]), None if one[2] is None else Card(**one[2]))
                    for place, one in document["folders"].items()
                }
        return {}

    def _write_index(self) -> None:
        """Write the index; a library that cannot be written is listed all the same."""
        folders = {
            place: (one.changed_ns, one.children, None if one.card is None else one.card.describe())
            for place, one in self._folders.items()
        }
        with suppress(OSError):
            write_text(self.own / "index.json", json.dumps({"format": INDEX_FORMAT, "folders": folders}))


def clean_name(name: str) -> str:
    """Return a name without what a file system or a terminal could misread."""
    clean = "".join(letter for letter in name if letter.isprintable() and letter not in NO_LETTERS).lstrip(". ")
    return clean.encode()[:MAX_NAME_BYTES].decode(errors="ignore").strip()


def _require_file(path: Path, is_allowed: bool) -> Path:
    """Return the path of a file that may be sent; raises Refusal."""
    if not is_allowed or path.is_symlink() or not path.is_file():
        raise Refusal(404, "There is no such file in this shot.")
    return path


def _identify(place: str) -> str:
    """Return the id of a folder by its path within the library."""
    return hashlib.sha256(os.fsencode(place)).hexdigest()[:16]


def _name_card(place: str) -> str:
    """Name a folder by its path within the library, and that of a command on several shots by what it holds."""
    if match := SESSION_PLACE.fullmatch(place):
        return f"{SESSION_NAMES[match[1]]} {match[3]} ({match[2]})"
    return place.replace("/", ", ")


def _read_object(path: Path) -> dict[str, Any]:
    """Read a JSON object; empty where the file cannot be read."""
    with suppress(OSError, ValueError, RecursionError):
        document = json.loads(path.read_bytes())
        return document if isinstance(document, dict) else {}
    return {}


def _read_folder(path: Path, place: str, changed_ns: int) -> _Folder:
    """Read one folder of the library; raises OSError."""
    with os.scandir(path) as entries:
        entry_of = {entry.name: entry for entry in entries if not entry.name.startswith(".") and not entry.is_symlink()}
    is_run = RUN_FILE in entry_of
    hidden = ("shot",) if is_run else (CLIP_FOLDER,) if not place else ()
    children = sorted(name for name, entry in entry_of.items() if entry.is_dir() and name not in hidden)
    card = _make_card(path, place, set(entry_of)) if place else None
    if card is not None:
        own = [entry.stat() for entry in entry_of.values() if entry.is_file()]
        size = sum(one.st_size for one in own) + (_measure_tree(path / "shot") if is_run else 0)
        card = replace(card, bytes=size, added=min((one.st_mtime for one in own), default=0.0))
    is_settled = time.time_ns() - changed_ns > SETTLE_NS
    return _Folder(changed_ns if is_settled else 0, tuple(children), card)


def _make_card(path: Path, place: str, names: set[str]) -> Card | None:
    """Make the card of a folder; None if it is no result."""
    kind, page = next((value for name, value in PAGES.items() if name in names), ("", ""))
    scene: dict[str, Any] = {}
    if RUN_FILE in names:
        scene, page = _read_object(path / RUN_FILE), "report.html" if "report.html" in names else ""
        kind = (
            "recording"
            if "shots" in scene
            else {"billiards": "shot", "rally": "rally"}.get(str(scene.get("scene")), "")
        )
    if not kind:
        return None
    facts = _read_object(path / "summary.json") if kind in ("shot", "rally") else {}
    clip = scene.get("clip")
    stated = clip.get("seconds") if isinstance(clip, dict) else None
    seconds = float(stated) if isinstance(stated, float | int) and math.isfinite(stated) else 0.0
    is_whole = kind not in ("shot", "rally") or "slow.mp4" in names
    return Card(
        _identify(place), _name_card(place), path.name, kind, _read_date(path), 0.0, _name_table(scene),
        len(facts["balls"]) if isinstance(facts.get("balls"), list) else None, seconds,
        TRUST_WORDS.get(_get_text(facts.get("trust", scene.get("trust")), "light"), ""),
        _first_sentence(facts.get("sentences")), bool(facts.get("thumbnail")), "done" if is_whole else "quick", "",
        page, 0,
    )  # fmt: skip


def _get_text(value: object, key: str) -> str:
    """Return a text of a JSON object; empty where there is none."""
    return str(value.get(key, "")) if isinstance(value, dict) else ""


def _name_table(scene: dict[str, Any]) -> str:
    """Name the table of a scene, or its sport."""
    return _get_text(scene.get("table"), "name") or str(scene.get("sport", ""))


def _first_sentence(sentences: object) -> str:
    """Return the first of some sentences."""
    return str(sentences[0]).split(". ")[0] if isinstance(sentences, list) and sentences else ""


def _read_date(path: Path) -> str:
    """Read when the clip of a run was filmed, as far as its file tells; else when the folder was written."""
    clip = Path(str(_read_object(path / SOURCE_FILE).get("path", "")))
    place = clip if clip.name and clip.exists() else path
    return datetime.fromtimestamp(place.stat().st_mtime, UTC).isoformat(timespec="seconds")


def _measure_tree(folder: Path) -> int:
    """Measure all files below a folder, bytes."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file())
