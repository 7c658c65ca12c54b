"""Tables of text as people have them: any delimiter, decimal commas, comments, units in the header, any line ends."""

from __future__ import annotations

import csv as rows_of_text
import io
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import csv

from models.core.errors import OptionError
from models.core.typing import FloatArray
from pipeline.reporting.text.text_formatting import escape_text

Columns = dict[str, NDArray[Any]]
TEXT_COLUMNS = ("id", "kind", "a", "b")
DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
_COMMENTS = ("#", "%", "//")
# Lines from which delimiter and decimal sign are recognised.
_SAMPLE_LINES = 50
_DECIMAL_COMMA = re.compile(r"\s*[-+]?\d*,\d+([eE][-+]?\d+)?\s*")
_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*")
# Cells of numbers that were not measured.
_MISSING = (*csv.ConvertOptions().null_values, "-", "--", "?", ".", "None", "none", "missing")
# Characters that no text has.
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
# Beginnings of JSON, XML and HTML, which would pass as tables with strange names.
_DOCUMENTS = ("{", "[{", "[[", "<")
# Spellings of units in headers.
UNITS = {
    "px": "px", "pixel": "px", "pixels": "px", "m": "m", "metres": "m", "meters": "m", "cm": "cm", "mm": "mm",
    "km": "km", "in": "in", "inch": "in", "inches": "in", "ft": "ft", "feet": "ft", "s": "s", "sec": "s",
    "seconds": "s", "ms": "ms", "us": "us", "µs": "us", "ns": "ns", "rad": "rad", "radians": "rad", "deg": "deg",
    "degrees": "deg", "°": "deg",
}  # fmt: skip
_WITH_UNIT = re.compile(r"(.+?)\s*(?:[\[(]\s*([^\[\]()]+?)\s*[\])]|[\s_/]\s*([^\s_/]+))")
# Names that other programs give to columns of tracks, by ours.
ALIASES = {
    "shot": ("trial", "take", "throw", "toss", "run", "episode"),
    "frame": ("frame_idx", "frame_index", "frame_number", "frame_id", "frame_no", "frames"),
    "t": ("time", "timestamp", "timestamps", "seconds", "elapsed"),
    "id": ("track_id", "track", "body", "ball", "object", "object_id", "particle", "marker", "name", "label"),
    "x": ("pos_x", "x_pos", "position_x", "x_position", "cx"),
    "y": ("pos_y", "y_pos", "position_y", "y_position", "cy"),
    "z": ("pos_z", "z_pos", "position_z", "z_position", "height", "altitude", "h"),
    "theta1": ("theta", "theta_1", "angle", "angle1", "angle_1", "phi", "phi1"),
    "theta2": ("theta_2", "angle2", "angle_2", "phi2"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of text, with what was assumed to read it."""

    path: Path
    columns: Columns
    """(K,) texts for `TEXT_COLUMNS`, otherwise numbers, NaN for empty cells."""
    units: dict[str, str] = field(default_factory=dict)
    """Units stated in the header, by column."""
    notes: tuple[str, ...] = ()
    """Sentences without a full stop."""
    texts: tuple[str, ...] = ()
    """Names of the columns of text that were left out."""

    def require(self, names: Sequence[str]) -> None:
        """Raise an OptionError where a column is missing."""
        if missing := [name for name in names if name not in self.columns]:
            have = ", ".join(self.columns) or "none"
            raise OptionError(f"{escape_text(self.path)} lacks the columns {', '.join(missing)}; it has {have}")


def require_tracks_file(source: Path) -> Path:
    """Return the tracks.csv of a source.

    Args:
        source: A folder or the file itself.

    Returns:
        Path of the file.

    Raises:
        OptionError: There is no such file.
    """
    path = source / "tracks.csv" if source.is_dir() else source
    if not path.is_file():
        raise OptionError(f"A tracks.csv or a folder with one was expected; there is no {path}")
    return path


def read_text_table(path: Path, purpose: str = "A table of text was expected") -> TextTable:
    """Read a table of text, whatever its delimiter, decimal sign, line ends, comments and spelling of the header.

    Args:
        path: The file.
        purpose: Beginning of the message where it cannot be read.

    Returns:
        Its columns; those of other programs get our names, and a column of text that we do not know is left out.

    Raises:
        OptionError: The file cannot be read, has no header, or has rows of another length.
    """
    place = escape_text(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise OptionError(f"{purpose}; {place} cannot be read: {error.strerror}") from error
    lines, comment = _split_lines(data, f"{purpose}; {place}")
    if not lines:
        raise OptionError(f"{purpose}; {place} is empty")
    delimiter = _find_delimiter(lines)
    notes = [f"{place} is separated by {DELIMITERS[delimiter]}"] if delimiter != "," else []
    if delimiter == " ":
        lines, delimiter, comment = [" ".join(line.split()) for line in lines], " ", " ".join(comment.split())
    header = _split_cells(lines[:1], delimiter)[0]
    if any(_NUMBER.fullmatch(cell) for cell in header):
        named = _split_cells([comment], delimiter)[0] if comment else []
        if len(named) != len(header):
            raise OptionError(f"{place} has no header; write the names of its columns into its first line")
        header, lines = named, [comment, *lines]
    sample = _split_cells(lines[1 : _SAMPLE_LINES + 1], delimiter)
    has_comma = any(_DECIMAL_COMMA.fullmatch(cell) for row in sample for cell in row)
    if has_comma:
        notes.append(f"{place} has decimal commas")
    names, units = _parse_header(header)
    body = lines[1:]
    if sample and (row_units := _parse_units_row(sample[0], names)):
        units, body = {**row_units, **units}, lines[2:]
    columns = _parse_body(body, names, delimiter, "," if has_comma else ".", place)
    return name_columns(path, columns, units, notes)


def name_columns(path: Path, columns: dict[str, Any], units: dict[str, str], notes: Sequence[str]) -> TextTable:
    """Build a table of columns that may have the names of other programs.

    Args:
        path: File of the table, for messages.
        columns: Arrow arrays by name.
        units: Units by column.
        notes: What was assumed so far.

    Returns:
        The table, with our names too.

    Raises:
        OptionError: A column of numbers holds other values.
    """
    place = escape_text(path)
    aliased = _find_aliases(columns)
    notes = [*notes, *(f"{place}: the column {other} is read as {name}" for name, other in aliased.items())]
    columns |= {name: columns[other] for name, other in aliased.items()}
    units |= {name: units[other] for name, other in aliased.items() if other in units}
    if "x_px" in aliased.values():
        units |= {axis: "px" for axis, other in aliased.items() if other == f"{axis}_px"}
    texts = tuple(name for name, column in columns.items() if not _is_usable(name, column))
    values = {name: _to_values(name, column, place) for name, column in columns.items() if name not in texts}
    return TextTable(path, values, units, tuple(notes), texts)


def read_text(path: Path) -> str:
    """Read a file of text in any encoding, packed by gzip or not.

    Raises:
        OptionError: It is no text.
    """
    return decode_text(path.read_bytes(), escape_text(path))


def decode_text(data: bytes, place: str, is_whole: bool = True) -> str:
    """Decode text.

    Args:
        data: The bytes of a file.
        place: Its name, for the message.
        is_whole: Whether they are all of them.

    Returns:
        The text.

    Raises:
        OptionError: They are no text.
    """
    if data.startswith(b"\x1f\x8b"):
        archive = zlib.decompressobj(wbits=31)  # with a header of gzip
        try:
            data = archive.decompress(data)
        except zlib.error:
            data = b""
        if is_whole and not archive.eof:
            raise OptionError(f"{place} is a gzip archive that breaks off or is damaged; copy it again")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return data.decode("utf-16", errors="replace")
    if len(data) > 1 and not data[1 : 2 * _SAMPLE_LINES : 2].strip(b"\0"):  # Latin letters of two bytes each
        return data.decode("utf-16-le", errors="replace")
    if _BINARY.search(data):
        raise OptionError(f"{place} is no text; save it as CSV or in a format that trueroll convert reads")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _split_lines(data: bytes, place: str) -> tuple[list[str], str]:
    """Decode text, and return its lines without comments and empty ones, and the last comment before them."""
    text = decode_text(data, place)
    if text.lstrip().startswith(_DOCUMENTS):
        raise OptionError(f"{place} is JSON, XML or HTML; save it as CSV or in a format that trueroll convert reads")
    lines = [line for line in text.splitlines() if line.strip()]
    comment = ""
    for line in lines:
        if not line.lstrip().startswith(_COMMENTS):
            break
        comment = line.lstrip().lstrip("#%/").strip()
    return [line for line in lines if not line.lstrip().startswith(_COMMENTS)], comment


def _split_cells(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    return [[cell.strip() for cell in row] for row in rows_of_text.reader(lines, delimiter=delimiter, strict=False)]


def _find_delimiter(lines: list[str]) -> str:
    """Find the delimiter that gives the most columns, of those that split header and rows alike."""
    sample = lines[: _SAMPLE_LINES + 1]

    def rate(delimiter: str) -> tuple[bool, int]:
        counts = [len(row) for row in _split_cells([" ".join(one.split()) for one in sample], " ")
                  ] if delimiter == " " else [len(row) for row in _split_cells(sample, delimiter)]  # fmt: skip
        return counts[0] > 1 and counts.count(counts[0]) > 0.9 * len(counts), counts[0]

    return max(DELIMITERS, key=rate)


def _parse_header(header: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return the names of columns in lower case without units, unless only the unit parts them, and the units."""
    plain = [re.sub(r"\s+", "_", cell.strip().strip("'\"").lower()) for cell in header]
    bare, units = list(plain), {}
    for k, cell in enumerate(header):
        match = _WITH_UNIT.fullmatch(cell.strip().lower())
        unit = UNITS.get((match[2] or match[3] or "").strip()) if match else None
        if match and unit:
            bare[k] = re.sub(r"\s+", "_", match[1].strip())
            units[k] = unit
    familiar = {name for names in ALIASES.values() for name in names} | set(ALIASES)
    names = [
        bare[k]
        if k in units
        and bare[k] in familiar
        and bare[k] not in plain
        and bare.count(bare[k]) == 1
        and plain[k] not in NUMERIC_COLUMNS
        else plain[k]
        for k in range(len(header))
    ]
    return names, {names[k]: unit for k, unit in units.items() if names[k] == bare[k]}


def _parse_units_row(cells: list[str], names: list[str]) -> dict[str, str]:
    """Return the units of a row below the header that holds nothing else; empty where it is data."""
    bare = [cell.strip("[]() ").lower() for cell in cells]
    if len(bare) != len(names) or not any(bare) or any(cell and cell not in UNITS for cell in bare):
        return {}
    return {name: UNITS[cell] for name, cell in zip(names, bare, strict=True) if cell}


def _parse_body(body: list[str], names: list[str], delimiter: str, decimal: str, place: str) -> dict[str, Any]:
    """Parse the rows below the header with pyarrow, which is fast."""
    if repeated := [name for k, name in enumerate(names) if name and name in names[:k]]:
        raise OptionError(f"{place} has the column {repeated[0]} twice; remove or rename one")
    if not body:
        return {name: pa.array([], pa.float64()) for name in names}
    widths = [len(row) for row in _split_cells(body[:_SAMPLE_LINES], delimiter)]
    if set(widths) == {len(names) + 1} and all(line.endswith(delimiter) for line in body[:_SAMPLE_LINES]):
        names = [*names, "empty_"]
    try:
        table = csv.read_csv(
            io.BytesIO("\n".join(body).encode()),
            csv.ReadOptions(column_names=[name or f"column_{k}" for k, name in enumerate(names)]),
            csv.ParseOptions(delimiter=delimiter),
            csv.ConvertOptions(
                column_types={name: pa.string() for name in names if name in (*TEXT_COLUMNS, *ALIASES["id"])},
                strings_can_be_null=False, decimal_point=decimal, null_values=_MISSING,
            ),
        )  # fmt: skip
    except pa.ArrowException as error:
        for number, row in enumerate(_split_cells(body, delimiter)):
            if len(row) != len(names):
                remedy = "separate columns by semicolons where numbers have decimal commas"
                raise OptionError(
                    f"{place}: row {number + 1} has {len(row)} values for {len(names)} columns;"
                    f" {remedy if len(row) > len(names) else 'complete or remove it'}"
                ) from error
        raise OptionError(f"{place} is no table of text; save it as CSV with one kind of value per column") from error
    return {name: table.column(name) for name in table.column_names}


def _find_aliases(columns: dict[str, Any]) -> dict[str, str]:
    """Return the columns of other programs by our names, where we have none of our own."""
    candidates = {name: [other for other in others if other in columns] for name, others in ALIASES.items()}
    suffixed = {axis: f"{axis}_px" for axis in "xyz" if f"{axis}_px" in columns}
    if not any(axis in columns for axis in "xyz"):
        candidates |= {axis: [other] for axis, other in suffixed.items()}
    return {name: others[0] for name, others in candidates.items() if others and name not in columns}


def _is_usable(name: str, column: Any) -> bool:
    """Return whether a column is numeric, or one that we know."""
    is_text = pa.types.is_string(column.type) or pa.types.is_boolean(column.type)
    return not is_text or name in TEXT_COLUMNS or name in ALIASES or name in NUMERIC_COLUMNS


def _to_values(name: str, column: Any, place: str) -> NDArray[Any]:
    if name in TEXT_COLUMNS:
        return np.array([str(value) for value in column.cast(pa.string()).to_pylist()])
    if pa.types.is_timestamp(column.type):
        column = pa.compute.divide(column.cast(pa.timestamp("ns")).cast(pa.int64()).cast(pa.float64(), safe=False), 1e9)
    try:
        return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), dtype=np.float64)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        cells = enumerate(map(str, column.to_pylist()))
        number, value = next(
            ((k, one) for k, one in cells if one not in _MISSING and not _NUMBER.fullmatch(one)), (0, "")
        )
        wanted = "write seconds" if name == "t" else "write a plain number, or leave the cell empty"
        raise OptionError(
            f"{place}: the column {name} has a value that is not a number, {escape_text(value)[:40]!r} in row"
            f" {number + 1}; {wanted}"
        ) from error


# Further columns in which a text is an error.
NUMERIC_COLUMNS = ("sigma", "observed", "x_px", "y_px", "radius_px", "force_x", "force_y", "torque", "platform_x",
                   "platform_y", "pivot_x", "pivot_y", "axis_x", "axis_y", "axis_z")  # fmt: skip


@dataclass(frozen=True, slots=True)
class RowGrid:
    """The places of K rows in a grid of T times and N bodies; of several rows in one place, the first counts."""

    first: NDArray[np.intp]
    """(T,) first row of each time, ascending in time."""
    bodies: tuple[str, ...]
    place: NDArray[np.intp]
    """(M,) filled places, counted along the bodies of one time, then in time."""
    row: NDArray[np.intp]
    """(M,) the row of each."""

    def scatter(self, values: FloatArray) -> FloatArray:
        """Arrange values (K, ...) of rows as (T, N, ...), NaN where there is no row."""
        grid = np.full((len(self.first) * len(self.bodies), *values.shape[1:]), np.nan)
        grid[self.place] = values[self.row]
        return grid.reshape(len(self.first), len(self.bodies), *values.shape[1:])


def build_row_grid(times: NDArray[np.generic], names: NDArray[np.str_], bodies: Sequence[str] = ()) -> RowGrid:
    """Build the grid of rows.

    Args:
        times: (K,) frame or time of each row.
        names: (K,) body of each row.
        bodies: All names in the order of the grid; empty for that of their first rows.

    Returns:
        The grid.
    """
    _, first, time = np.unique(times, return_index=True, return_inverse=True)
    words = names.tolist()
    order = tuple(bodies or dict.fromkeys(words))
    number = {name: k for k, name in enumerate(order)}
    place, row = np.unique(time * len(order) + [number[name] for name in words], return_index=True)
    return RowGrid(first, order, place, row)
