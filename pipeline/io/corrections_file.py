"""The corrections file of a clip: one small JSON file beside it, which every later run of the clip honours."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.errors import OptionError
from pipeline.engine.atomic_write import write_text
from pipeline.io.strict_json import UNKNOWN_KEY_ERRORS, format_first_error, read_json

SCHEMA = "trueroll.corrections/1"
SUFFIX = ".corrections.json"
# Size of the largest file that is read: ten thousand corrections.
MAX_BYTES = 2_000_000


@dataclass(frozen=True, slots=True)
class CorrectionsFile:
    """Content of a corrections file."""

    revision: int = 0
    """Number of changes so far: two editors of one file compare it before they write."""
    clip_sha256: str = ""
    """Digest of the clip that was corrected; empty in a file that a person wrote."""
    corrections: Corrections = NO_CORRECTIONS


_FORM = TypeAdapter(CorrectionsFile)


def corrections_path(clip: Path) -> Path:
    """Return the path of the corrections file of a clip.

    Args:
        clip: Path of the clip.

    Returns:
        `<clip>.corrections.json` beside it.
    """
    return clip.with_name(clip.name + SUFFIX)


def read_corrections(clip: Path, digest: str = "") -> CorrectionsFile:
    """Read the corrections of a clip.

    Args:
        clip: Path of the clip.
        digest: SHA-256 of the clip; empty to accept the corrections of another clip of this name.

    Returns:
        The content of the file beside the clip; no corrections if there is none.

    Raises:
        OptionError: The file cannot be read, is malformed, or belongs to another clip.
    """
    path = corrections_path(clip)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return CorrectionsFile()
    except OSError as error:
        raise OptionError(f"The corrections of the clip cannot be read; {path}: {error.strerror}") from error
    try:
        if len(content) > MAX_BYTES:
            raise ValueError(f"it has more than {MAX_BYTES // 1_000_000} MB")
        read = parse_corrections(json.loads(content.decode("utf-8")))
    except (ValueError, RecursionError, OverflowError) as error:
        what = "it is nested too deeply" if isinstance(error, RecursionError) else " ".join(str(error).split())
        raise OptionError(f"{path} is no corrections file: {what}; mend it, or move it away") from error
    if digest and read.clip_sha256 and read.clip_sha256 != digest:
        raise OptionError(f"{path} belongs to another clip than {clip.name}; move it away to run without it")
    return read


def read_noted_corrections(folder: Path) -> Corrections:
    """Read which corrections the run of a rally honoured, by the scene.json of its folder; none where it notes none.

    Raises:
        OptionError: The file is malformed.
    """
    if not (folder / "scene.json").exists():
        return NO_CORRECTIONS
    scene = read_json(folder / "scene.json", "A run folder has a scene.json")
    noted = scene.get("set_by_hand", {}) if isinstance(scene, dict) else {}
    try:
        return parse_corrections({"schema": SCHEMA, **noted}).corrections
    except (ValueError, TypeError) as error:
        raise OptionError(f"{folder / 'scene.json'} notes corrections that cannot be used: {error}") from error


def write_corrections(clip: Path, content: CorrectionsFile) -> None:
    """Write the corrections file of a clip atomically.

    Args:
        clip: Path of the clip.
        content: Revision and corrections.

    Raises:
        OptionError: The folder of the clip cannot be written.
    """
    path = corrections_path(clip)
    try:
        write_text(path, format_corrections_file(content))
    except OSError as error:
        raise OptionError(f"Corrections are saved beside the clip; {path}: {error.strerror}") from error


def parse_corrections(document: Any) -> CorrectionsFile:
    """Parse the document of a corrections file strictly.

    Args:
        document: The JSON value.

    Returns:
        Its content.

    Raises:
        ValueError: It is malformed; the message names the place.
    """
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ValueError(f'an object with "schema": "{SCHEMA}" was expected')
    head = {name: value for name, value in document.items() if name in ("revision", "clip_sha256")}
    rest = {name: value for name, value in document.items() if name not in ("schema", *head)}
    try:  # as JSON: there alone a list is a tuple in strict mode
        content = _FORM.validate_json(json.dumps({**head, "corrections": rest}), strict=True, extra="forbid")
    except ValidationError as error:
        words = format_first_error(error).removeprefix("corrections").lstrip(".: ")
        mistake = error.errors(include_url=False)[0]
        if mistake["type"] not in ("missing", "value_error", *UNKNOWN_KEY_ERRORS):  # else the value says nothing
            words += f"; got {json.dumps(mistake['input'], default=str)[:60]}"
        raise ValueError(words) from error
    if content.revision < 0:
        raise ValueError(f"revision is 0 or more; got {content.revision}")
    return content


def describe_corrections(corrections: Corrections) -> dict[str, Any]:
    """Describe corrections as JSON values; what is not set is left out.

    Returns:
        The keys of a corrections file, without its head.
    """
    described: dict[str, Any] = _drop_unset(dataclasses.asdict(corrections))
    return described


def format_corrections_file(content: CorrectionsFile) -> str:
    """Format a corrections file for people: one line per correction.

    Args:
        content: Revision and corrections.

    Returns:
        The text.
    """
    head = {"schema": SCHEMA, "revision": content.revision, "clip_sha256": content.clip_sha256}
    lines = []
    for name, value in {**head, **describe_corrections(content.corrections)}.items():
        if isinstance(value, list) and name != "corners":
            rows = ",\n".join(f"  {json.dumps(row)}" for row in value)
            lines.append(f" {json.dumps(name)}: [\n{rows}\n ]")
        elif value != "":
            lines.append(f" {json.dumps(name)}: {json.dumps(value)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _drop_unset(value: Any) -> Any:
    """Drop the fields of a description that are None or empty."""
    if isinstance(value, dict):
        return {name: _drop_unset(part) for name, part in value.items() if part is not None and part not in ("", ())}
    return [_drop_unset(part) for part in value] if isinstance(value, tuple) else value
