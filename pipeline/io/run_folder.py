"""Reading of run folders: tables, scene, and the clip that they were made from."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from models.core.ball_look import BallLook
from models.core.errors import OptionError
from models.core.naming import Naming, build_naming
from models.core.scene import Camera, Table
from models.physics.billiards.tables import find_nearest_preset, scale_ball_mass
from pipeline.io.strict_json import read_json
from pipeline.io.text_table import Columns, read_text_table

# File of a run folder that names the source clip.
SOURCE_FILE = "source.json"
# Tables of every run.
TABLES = ("tracks.csv", "events.csv", "trajectory.csv", "scene.json")
# Files of a run folder by the stage that writes them; only a rally has strokes.csv.
STAGE_FILES: Mapping[str, tuple[str, ...]] = {
    "export": (*TABLES, "strokes.csv"),
    "poster": ("poster.png",),
    "report": ("report.html", "summary.json"),
    "record": ("recording.rrd",),
    "render": ("slow.mp4",),
}
# m, standard deviation of positions without a sigma.
DEFAULT_SIGMA = 1e-3


def read_scene_document(path: Path) -> dict[str, Any]:
    """Read the scene.json of a billiards scene.

    Args:
        path: The file.

    Returns:
        Its content.

    Raises:
        OptionError: The file is missing, is not JSON, or describes another scene.
    """
    scene = read_json(path, f"A run folder has a {path.name}")
    if not isinstance(scene, dict) or scene.get("scene") != "billiards":
        rally = f" but a rally of {scene.get('sport')}" * (isinstance(scene, dict) and scene.get("scene") == "rally")
        raise OptionError(f"{path} describes no billiards scene{rally}")
    return scene


def read_looks_text(path: Path) -> str:
    """Read the names, numbers and colours of balls from a scene.json.

    Args:
        path: The file.

    Returns:
        JSON object: by id of the ball, an object with these of `name`, `number` (0 for `null`) and `colour` that
        the file has.

    Raises:
        OptionError: The file is no scene.json, or a value cannot be used.
    """
    looks = {}
    for ball in read_scene_document(path).get("balls", []):
        if not (isinstance(ball.get("id"), str) and str(ball.get("name", "x")).strip()):
            raise OptionError(f"A ball has an id and a name; {path} has {ball}")
        looks[ball["id"]] = look = {key: ball[key] for key in ("name", "number", "colour") if ball.get(key) is not None}
        if look.get("number", 1) not in range(1, 16):
            raise OptionError(f"A pool ball has a number from 1 to 15; {path} has {look['number']} for {ball['id']}")
        if "number" in ball:
            look.setdefault("number", 0)
        if not re.fullmatch("#[0-9a-fA-F]{6}", str(look.get("colour", "#000000"))):
            raise OptionError(f"A colour is like #d63b3b; {path} has {look['colour']} for {ball['id']}")
    return json.dumps(looks)


def read_csv_columns(path: Path, wanted: tuple[str, ...]) -> Columns:
    """Read a table of text as columns.

    Args:
        path: The file.
        wanted: Names of required columns.

    Returns:
        Columns (K,): strings for `TEXT_COLUMNS`, otherwise numbers, NaN for empty cells.

    Raises:
        OptionError: The file cannot be read, or a column is missing or not numeric.
    """
    table = read_text_table(path, f"A run folder has a {path.name}")
    table.require(wanted)
    return table.columns


def read_source(folder: Path) -> dict[str, Any]:
    """Read what a run folder notes of its clip, see `chain.write_source`; empty where it notes nothing."""
    with suppress(OSError, ValueError, TypeError):
        return dict(json.loads((folder / SOURCE_FILE).read_text(encoding="utf-8")))
    return {}


def identify_clip(source: Path) -> str:
    """Identify what a run folder or a track folder was made from.

    Args:
        source: Run folder, track folder, or its tracks.csv.

    Returns:
        Hash of the clip, with the first frame of a part of it; without a clip, hash of the tracks. Empty if neither can
        be read.
    """
    folder = source if source.is_dir() else source.parent
    with suppress(OSError, ValueError, KeyError, TypeError):
        digest = json.loads((folder / "scene.json").read_text(encoding="utf-8"))["clip"]["sha256"]
        return f"{digest} {read_source(folder).get('first', 0)}"
    with suppress(OSError), (source / "tracks.csv" if source.is_dir() else source).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def find_repeated_clips(sources: Iterable[Path]) -> dict[Path, Path]:
    """Find the folders that are runs of a clip of which an earlier folder is a run too.

    Args:
        sources: Run folders, track folders, or their tracks.csv.

    Returns:
        The earlier folder by the repeated one.
    """
    first: dict[str, Path] = {}
    repeated: dict[Path, Path] = {}
    for source in dict.fromkeys(sources):
        clip = identify_clip(source)
        if clip and first.setdefault(clip, source) != source:
            repeated[source] = first[clip]
    return repeated


def drop_repeated_clips(sources: Sequence[Path]) -> tuple[list[Path], list[str]]:
    """Drop all but the first of several runs of one clip, which would count its shots as independent.

    Args:
        sources: Run folders, track folders, or their tracks.csv.

    Returns:
        The others, and one sentence per dropped one.
    """
    repeated = find_repeated_clips(sources)
    sentences = [
        f"{source} has the same clip or tracks as {first}: its shots are counted once"
        for source, first in repeated.items()
    ]
    return [source for source in sources if source not in repeated], sentences


def list_files_beside(sources: Iterable[Path], name: str) -> list[Path]:
    """List the files of one name beside the tracks of shots.

    Args:
        sources: Run folders, track folders, or their tracks.csv.
        name: Such as scene.json.

    Returns:
        The files that exist, in the order of the sources.
    """
    files = ((source if source.is_dir() else source.parent) / name for source in sources)
    return [file for file in files if file.is_file()]


def parse_table(scene: dict[str, Any]) -> Table:
    """Build the table of a scene.json.

    Args:
        scene: Content of the scene.json.

    Returns:
        The table; missing values are those of the preset of the most similar length.

    Raises:
        OptionError: The size is missing or not numeric.
    """
    try:
        entry = scene["table"]
        length, width = float(entry["length"]), float(entry["width"])
        preset = find_nearest_preset(length)
        radius = float(scene.get("ball_radius", preset.ball_radius))
        mass = float(scene.get("ball_mass", scale_ball_mass(preset, radius)))
        pockets = bool(entry.get("pockets", preset.pockets))
        return Table(entry.get("name", f"{length:g}x{width:g}"), entry.get("game", preset.game), length, width, radius,
                     mass, pockets)  # fmt: skip
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"scene.json has no table with length and width in metres: {error}") from error


def parse_camera(scene: dict[str, Any]) -> Camera | None:
    """Build the camera of a scene.json; None if it has no calibration, or one with a singular matrix."""
    entry, image = scene.get("calibration"), scene.get("image")
    if not isinstance(entry, dict) or not isinstance(image, dict):
        return None
    try:
        camera = Camera(
            np.array(entry["matrix"], float), int(image["width_px"]), int(image["height_px"]),
            np.array(entry["corners_px"], float), np.array(entry["corner_covariance_px2"], float),
            entry["plane"], float(entry["camera_height"]), float(entry["camera_height_sigma"]),
            scale_sigma=float(entry.get("scale_sigma", 0.0)),
        )  # fmt: skip
        return camera if np.linalg.matrix_rank(camera.matrix[:, :3]) == 3 else None
    except (KeyError, TypeError, ValueError) as error:
        raise OptionError(f"scene.json has a calibration that cannot be used: {error}") from error


def parse_naming(scene: dict[str, Any]) -> Naming:
    """Build the naming of a scene.json; balls of an earlier version are called by their ids.

    Args:
        scene: Content of the scene.json.

    Returns:
        What balls, rails and pockets are called.

    Raises:
        OptionError: The table or the calibration cannot be used.
    """
    looks = {one["id"]: BallLook(one.get("name", one["id"]), number=one.get("number") or 0)
             for one in scene.get("balls", [])}  # fmt: skip
    return build_naming(parse_table(scene), parse_camera(scene), list(looks), list(looks.values()))


def find_files_below(folder: Path, name: str) -> list[Path]:
    """Find the files of a name below a folder, in order; hidden folders are left out, such as the trash of the page."""
    paths = sorted(folder.rglob(name)) if folder.is_dir() else []
    return [path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts)]


def list_folders_with(name: str, sources: Iterable[Path]) -> list[Path]:
    """List the folders that hold a file, such as run folders with their scene.json.

    Args:
        name: Name of the file.
        sources: Such folders, files of their own, or folders with such folders, as a batch writes them.

    Returns:
        The folders and files, in the order given, each once.

    Raises:
        OptionError: A source holds none.
    """
    folders: dict[Path, None] = {}
    for source in sources:
        if source.is_file() or (source / name).is_file():
            folders[source] = None
            continue
        below = [path.parent for path in find_files_below(source, name)]
        if not below:
            raise OptionError(f"Run folders or folders with such folders were expected; {source} holds no {name}")
        folders |= dict.fromkeys(below)
    return list(folders)
