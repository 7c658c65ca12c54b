"""Conversion of tracks between the formats of other programs and ours."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
import pyarrow as pa

from models.core.errors import OptionError
from pipeline.engine.atomic_write import replace_file, require_writable_folder
from pipeline.io.formats.track_format import MalformedTracks, PointTracks, Provenance, TrackFormat, list_formats
from pipeline.io.particle_files import NAMED_SCENES
from pipeline.io.strict_json import read_json, write_json
from pipeline.io.text_table import decode_text
from pipeline.io.track_conventions import MAX_NUMBER
from pipeline.io.track_folder import SCENE_FILE, TRACKS_FILE
from pipeline.reporting.text.text_formatting import escape_text

# Bytes of a file by which formats are recognised.
_HEAD_BYTES = 1 << 16
# Errors of parsers on files that do not hold what they begin with.
_MALFORMED = (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError, StopIteration,
              struct.error, zlib.error, ParseError, pa.ArrowException, EOFError, RuntimeError)  # fmt: skip
# Packages that raise errors of their own.
_PARSERS = ("mcap", "msgpack", "zst", "lz4")


@dataclass(frozen=True, slots=True)
class ConvertOptions:
    """What files may lack."""

    fps: float | None = None
    """Frames per second."""
    px_per_m: float | None = None
    """Scale of the image."""
    size_px: float | None = None
    """Diameter of bodies whose boxes are not known, px."""
    scene: str | None = None
    """Scene of a track folder."""


NOTHING_STATED = ConvertOptions()


def read_tracks(path: Path, name: str | None = None) -> tuple[PointTracks, TrackFormat]:
    """Read tracks in any format.

    Args:
        path: A file or folder.
        name: Name of the format; None to recognise it.

    Returns:
        The tracks and their format.

    Raises:
        OptionError: There is no such file, no format fits, or it is malformed.
    """
    place = escape_text(path)
    if not path.exists():
        raise OptionError(f"Tracks were expected; there is no {place}")
    chosen = _find_named(name) if name else _recognise(path)
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused below
            tracks = chosen.read(path)
        _require_rows(tracks)
        beside = _name_sidecar(path)
        if not chosen.holds_provenance and beside.is_file():
            stated = read_json(beside, "The source of the tracks was expected")
            tracks = _fill(tracks, ConvertOptions(stated.get("fps"), stated.get("px_per_m")))
    except OptionError:
        raise
    except Exception as error:
        if not isinstance(error, (*_MALFORMED, OSError)) and not type(error).__module__.startswith(_PARSERS):
            raise
        raise OptionError(f"{place} is no whole {chosen.title}: {_describe_fault(error)}; export it again") from error
    return tracks, chosen


def _describe_fault(error: Exception) -> str:
    """Describe what is wrong with a file, without the words of its parser."""
    if isinstance(error, MalformedTracks | UnicodeError):
        return str(error) if isinstance(error, MalformedTracks) else "it is no text"
    if isinstance(error, KeyError):
        return f"it lacks {escape_text(str(error))[:60]}"
    if isinstance(error, IndexError | StopIteration):
        return "a row or list is too short"
    if type(error).__module__ == "builtins" and not isinstance(error, OSError):
        return "it breaks off, or a value is no number or has another type than is usual there"
    return "it breaks off, is damaged, or is another kind of file"


def _require_rows(tracks: PointTracks) -> None:
    """Raise a MalformedTracks error where tracks have no rows, or columns that are no numbers or differ in length."""
    counts = {len(values) for values in tracks.columns.values()}
    if counts == {0} or not counts:
        raise MalformedTracks("it has no positions")
    if len(counts) > 1:
        raise MalformedTracks("its columns differ in length")
    for name, values in tracks.columns.items():
        if values.dtype.kind in "if" and np.nanmax(np.abs(values.astype(np.float64)), initial=0) > MAX_NUMBER:
            raise MalformedTracks(f"{name} goes up to {np.nanmax(np.abs(values)):.3g}, which no recording has")


def _recognise(path: Path) -> TrackFormat:
    head = b""
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        with suppress(OptionError):  # of a format that is no text
            head = decode_text(head, path.name, is_whole=False).encode()
    formats = list_formats()
    general = formats["track-folder"]  # any table of text: the last one
    for one in (*(other for other in formats.values() if other is not general), general):
        if one.recognises(path, head):
            return one
    titles = ", ".join(one.title for one in formats.values())
    raise OptionError(
        f"{escape_text(path)} is none of these: {titles}; export it as one of them; a clip needs trueroll run first"
    )


def _find_named(name: str) -> TrackFormat:
    formats = list_formats()
    if name not in formats:
        raise OptionError(f"Formats are {', '.join(formats)}; got {name}")
    return formats[name]


def find_output_format(path: Path, name: str | None = None) -> TrackFormat:
    """Find the format of an output by the end of its name.

    Args:
        path: File or folder to write.
        name: Name of the format; None to take that of the ending.

    Returns:
        The format.

    Raises:
        OptionError: No format has this ending.
    """
    if name:
        return _find_named(name)
    formats = list_formats()
    lower = path.name.lower()
    fits = [
        (len(ending), one) for one in formats.values() for ending in one.endings if ending and lower.endswith(ending)
    ]
    if fits:
        return max(fits, key=lambda fit: fit[0])[1]
    if not path.suffix or path.is_dir():
        return formats["track-folder"]
    endings = ", ".join(ending for one in formats.values() for ending in one.endings[:1] if ending)
    raise OptionError(
        f"{escape_text(path)} has the ending of no format; end its name in {endings}, in nothing for a track folder, or"
        " give --to"
    )


def convert_tracks(
    source: Path, target: Path, options: ConvertOptions, read_as: str | None, write_as: str | None
) -> tuple[PointTracks, TrackFormat, TrackFormat]:
    """Convert tracks.

    Args:
        source: File or folder to read.
        target: File or folder to write.
        options: What the source may lack.
        read_as: Name of the format of the source; None to recognise it.
        write_as: Name of the format of the target; None for that of its ending.

    Returns:
        The tracks, and both formats.

    Raises:
        OptionError: The source cannot be read, or the target's format needs what it does not have.
    """
    output = find_output_format(target, write_as)
    if target.exists() and source.exists() and target.resolve() == source.resolve():
        raise OptionError("-o names the source; name another file")
    tracks, origin = read_tracks(source, read_as)
    tracks = _fill(tracks, options)
    stated = {key: value for key, value in asdict(options).items() if value is not None}
    provenance: Provenance = {"program": "trueroll", "version": version("trueroll"), "source": source.name,
                              "source_format": origin.name, "options": stated, "names": tracks.ids}  # fmt: skip
    require_writable_folder(target.parent)
    if "" in output.endings:
        output.write(tracks, target, provenance)
    else:
        with replace_file(target) as fresh:
            output.write(tracks, fresh, provenance)
    if not output.holds_provenance:
        write_json({**provenance, "fps": tracks.fps, "px_per_m": tracks.px_per_m}, _name_sidecar(target))
    return tracks, origin, output


def import_tracks(
    inputs: Sequence[Path], into: Path, options: ConvertOptions
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Give every input that is a file of tracks a track folder.

    A table of text keeps all its columns, so that what they show of its units is not lost.

    Args:
        inputs: Folders, and files in any format.
        into: Folder of the new track folders.
        options: What the files may lack.

    Returns:
        The folders in the order of the inputs, and a sentence on each file.

    Raises:
        OptionError: A file cannot be read, or nothing states its scene.
    """
    folders: list[Path] = []
    notes = []
    for number, source in enumerate(inputs):
        beside = source.with_name(SCENE_FILE)
        if not source.is_file() or (source.name == TRACKS_FILE and beside.is_file()):
            folders.append(source.parent if source.is_file() else source)
            continue
        origin = _recognise(source)
        is_table = "" in origin.endings
        scene = options.scene or ("" if is_table else read_tracks(source, origin.name)[0].scene.get("scene"))
        if scene not in NAMED_SCENES:
            names = ", ".join(NAMED_SCENES)
            raise OptionError(
                f"{escape_text(source)} does not state what moves in it; state --scene ({names}), or for joints of a"
                " mechanism your own --simulator"
            )
        target = into / f"{number + 1:02d}-{source.name.split('.')[0]}"
        if is_table:
            target.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target / TRACKS_FILE)
            write_json({key: value for key, value in asdict(options).items() if value}, target / SCENE_FILE)
        else:
            convert_tracks(source, target, options, origin.name, "track-folder")
        title = "a table of text" if is_table else origin.title
        notes.append(f"{escape_text(source)} was read as {title}, of the scene {scene}")
        folders.append(target)
    return tuple(folders), tuple(notes)


def _fill(tracks: PointTracks, options: ConvertOptions) -> PointTracks:
    """Add what the file of the tracks lacks: frame rate, scale, size of bodies and scene."""
    columns = dict(tracks.columns)
    if options.size_px and "width_px" not in columns:
        columns["width_px"] = columns["height_px"] = np.full(len(columns["id"]), options.size_px)
    fps = options.fps or tracks.fps
    if fps and "t" not in columns:
        columns["t"] = columns["frame"] / fps
    scene = {**tracks.scene, **({"scene": options.scene} if options.scene else {})}
    return replace(tracks, columns=columns, fps=fps, px_per_m=options.px_per_m or tracks.px_per_m, scene=scene)


def _name_sidecar(path: Path) -> Path:
    """Name the file beside an export whose format has no place for its provenance."""
    return path.with_name(f"{path.name}.source.json")
