"""The saved shot of a run folder: what every answer reads, and of which the tables of the folder are exports.

What is saved is one value with all its fields: a `models.core.shot.Shot`, or a `models.core.rally.Rally`. Events,
trajectory and trust level are views, computed from it when they are needed. The file SHOT.json that `trueroll simulate`
reads is something else: `pipeline.io.shot_setup`.

shot/shot.json      format, kind unless it is a shot, version of the program, options of the run, and the value without
                    its arrays
shot/HASH.npz       the arrays, under the hash that shot.json names
shot/kept/          what answers computed later from the shot, see `kept_values`
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from models.core.errors import OptionError
from models.core.rally import Rally
from models.core.shot import Shot
from pipeline.engine.atomic_write import replace_file
from pipeline.engine.value_files import AnyArray, decode_value, encode_value

SHOT_FOLDER, SHOT_FILE, LOCK_FILE = "shot", "shot.json", "lock"
# Version of the layout; a later program reads every earlier one. Format 2 holds kinds of values besides shots.
FORMAT, SHOT_FORMAT = 2, 1
RALLY = "rally"
HASH_DIGITS = 16
# What files raise that were cut off or altered.
_UNREADABLE = (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, zlib.error)


def write_shot(shot: Shot | Rally, options: Mapping[str, Any], version: str, folder: Path) -> None:
    """Write a shot into a folder that holds none.

    Args:
        options: Options that explained it, as JSON values.
        version: Version of the program.
        folder: The folder, which exists.
    """
    arrays: dict[str, AnyArray] = {}
    tree = encode_value(shot, "", arrays)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    name = f"{hashlib.sha256(buffer.getvalue()).hexdigest()[:HASH_DIGITS]}.npz"
    kind = {"format": FORMAT, "kind": RALLY} if isinstance(shot, Rally) else {"format": SHOT_FORMAT}
    document = {**kind, "program": version, "options": dict(options), "arrays": name, "value": tree}
    (folder / SHOT_FOLDER).mkdir()
    _write_files(folder / SHOT_FOLDER, buffer.getvalue(), document)


def publish_shot(source: Path, folder: Path) -> None:
    """Copy a saved shot that `write_shot` wrote elsewhere into a run folder; what was kept there stays.

    Args:
        source: Folder that holds the saved shot.
        folder: The run folder, which exists.
    """
    path, target = source / SHOT_FOLDER / SHOT_FILE, folder / SHOT_FOLDER
    document = json.loads(path.read_text(encoding="utf-8"))
    target.mkdir(exist_ok=True)
    with FileLock(target / LOCK_FILE):  # two runs may write one folder
        _write_files(target, (path.parent / document["arrays"]).read_bytes(), document)
        for other in target.glob("*.npz"):
            if other.name != document["arrays"]:
                other.unlink(missing_ok=True)


def _write_files(target: Path, arrays: bytes, document: dict[str, Any]) -> None:
    """Write the arrays, then the document that names them, so that a reader finds the old shot or the new one."""
    text = json.dumps(document, indent=1, allow_nan=False).encode()
    for name, content in ((document["arrays"], arrays), (SHOT_FILE, text)):
        with suppress(OSError):
            if (target / name).read_bytes() == content:
                continue
        with replace_file(target / name) as path:
            path.write_bytes(content)


def has_shot(source: Path) -> bool:
    """Find out whether a folder holds a saved shot.

    Args:
        source: A run folder, a track folder, or a tracks.csv.

    Returns:
        Whether it does.
    """
    return (source / SHOT_FOLDER / SHOT_FILE).is_file()


def read_shot(folder: Path) -> Shot:
    """Read the saved shot of a run folder.

    Args:
        folder: The run folder.

    Returns:
        The shot.

    Raises:
        OptionError: There is none, it is a rally, or it cannot be read.
    """
    return require_shot(read_saved(folder), folder)


def require_shot(saved: Shot | Rally, folder: Path) -> Shot:
    """Return a shot of billiards; raises OptionError for a rally."""
    if isinstance(saved, Rally):
        raise OptionError(
            f"{folder} holds a rally of {saved.scene.sport.name}, and a shot of billiards was expected; of a rally, ask"
            " trueroll call DIR landing, trueroll call DIR net, or trueroll predict DIR --at T"
        )
    return saved


def read_rally(folder: Path) -> Rally:
    """Read the saved rally of a run folder.

    Args:
        folder: The run folder.

    Returns:
        The rally.

    Raises:
        OptionError: There is none, it is a shot of billiards, or it cannot be read.
    """
    return require_rally(read_saved(folder), folder)


def require_rally(saved: Shot | Rally, folder: Path) -> Rally:
    """Return a rally; raises OptionError for a shot of billiards."""
    if isinstance(saved, Shot):
        raise OptionError(
            f"{folder} holds a shot of billiards, and a rally over a net was expected; landing and net are asked of"
            " rallies"
        )
    return saved


def holds_rally(folder: Path) -> bool:
    """Find out whether the saved value of a folder is a rally."""
    with suppress(OSError, ValueError, TypeError, AttributeError):
        document = json.loads((folder / SHOT_FOLDER / SHOT_FILE).read_text(encoding="utf-8"))
        return bool(document.get("kind") == RALLY)
    return False


def read_saved(folder: Path) -> Shot | Rally:
    """Read the saved value of a run folder.

    Args:
        folder: The run folder.

    Returns:
        A shot or a rally.

    Raises:
        OptionError: There is none, or it cannot be read.
    """
    for _ in range(2):  # a run that replaces the shot removes the arrays of the one before
        path = folder / SHOT_FOLDER / SHOT_FILE
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if document["format"] > FORMAT:
                raise OptionError(
                    f"{path} was saved by trueroll {document['program']}, whose format {document['format']} this"
                    f" version does not know; update trueroll, or run the clip again"
                )
            packed = io.BytesIO((path.parent / document["arrays"]).read_bytes())
            with np.load(packed, allow_pickle=False) as arrays:
                kind = Rally if document.get("kind") == RALLY else Shot
                saved: Shot | Rally = decode_value(kind, document["value"], dict(arrays))
            return saved
        except _UNREADABLE as error:
            failure: BaseException = error
    if not folder.exists():
        raise OptionError(f"{folder} does not exist; trueroll run CLIP -o {folder} writes it")
    if not path.is_file():
        raise OptionError(
            f"{folder} holds no saved shot, which every run writes since this version; run the clip again:"
            f" trueroll run CLIP -o {folder}"
        )
    raise OptionError(f"{path} cannot be read ({failure}); run the clip again: trueroll run CLIP -o {folder}")
