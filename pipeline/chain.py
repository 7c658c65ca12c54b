"""The chain of stages of a run, from a clip to the files of its folder."""

from __future__ import annotations

import filecmp
import json
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from models.core.coaching.shot_numbers import ShotNumbers
from models.core.errors import ClipError, OptionError
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.scene import Scene
from models.core.tracks import Tracks
from pipeline.engine.atomic_write import replace_file
from pipeline.engine.result_cache import CacheEntry, ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import RunWatcher, StageGraph, load_stage_output
from pipeline.reporting.text.run_trust import assess_run_trust
from pipeline.reporting.text.text_formatting import escape_text
from pipeline.reporting.text.whole_shot_sentences import format_whole_shot
from pipeline.run_options import RunOptions, format_changed_settings
from pipeline.stages.calibrate_stage import calibrate_stage
from pipeline.stages.detect_stage import detect_stage
from pipeline.stages.export_stage import export_stage
from pipeline.stages.fit_stage import fit_stage
from pipeline.stages.forecast_stage import forecast_stage
from pipeline.stages.read_stage import read_stage
from pipeline.stages.record_stage import RecordOptions, record_stage
from pipeline.stages.render_stage import render_stage
from pipeline.stages.report_stage import ReportOptions, report_stage
from pipeline.stages.shot_stages import ClipShot, shot_stage
from pipeline.stages.track_stage import track_stage
from video.io.clip import Clip, compute_clip_digest, require_readable_file

STAGE_FILES: Mapping[str, tuple[str, ...]] = {
    "export": ("tracks.csv", "events.csv", "trajectory.csv", "scene.json"),
    "render": ("slow.mp4", "poster.png"),
    "record": ("recording.rrd",),
    "report": ("report.html",),
}
"""Files of a run folder by the stage that writes them."""
SOURCE_FILE = "source.json"
"""File of a run folder that names the source clip."""


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """Summary of a finished run."""

    folder: Path
    trust: Trust
    events: Events
    whole_shot: str = ""
    """Sentences on what explains the whole shot."""
    notes: tuple[str, ...] = ()
    """Sentences about irregularities of the clip."""
    numbers: tuple[ShotNumbers, ...] = ()
    """Numbers of each shot."""


def build_run_graph(clip: Path, options: RunOptions, shot: ClipShot | None = None) -> StageGraph:
    """Build the graph of all stages of a run.

    Args:
        clip: Path of the clip.
        options: Options of all stages.
        shot: The shot of the clip to run; None for the whole clip.

    Returns:
        The graph.

    Raises:
        ClipError: The clip is no video or cannot be read.
    """
    digest = hash_clip(clip) if shot is None else shot.whole.digest
    settings, title = (
        format_changed_settings(options),
        escape_text(clip.name if shot is None else f"{clip.name}, {shot.name}"),
    )
    stages = (
        *_build_fit_stages(clip, digest, options, shot),
        export_stage(options.detect),
        render_stage(options.render),
        forecast_stage(options.forecast),
        record_stage(RecordOptions(title)),
        report_stage(ReportOptions(title, options.render.slow, settings, options.detect)),
    )
    return StageGraph.from_stages(stages, digest if shot is None else f"{shot.name}-{digest}")


def build_fit_graph(clip: Path, options: RunOptions) -> StageGraph:
    """Build the graph of the stages up to the fit.

    Args:
        clip: Path of the clip.
        options: Options of all stages.

    Returns:
        The graph.

    Raises:
        ClipError: The clip is no video or cannot be read.
    """
    digest = hash_clip(clip)
    return StageGraph.from_stages(_build_fit_stages(clip, digest, options), digest)


def _build_fit_stages(clip: Path, digest: str, options: RunOptions, shot: ClipShot | None = None) -> tuple[Stage, ...]:
    """Build the stages up to the fit, of a clip or of one shot."""
    return (
        read_stage(clip, digest, options.read) if shot is None else shot_stage(shot, digest, options.read.fps),
        calibrate_stage(options.calibrate),
        detect_stage(options.detect),
        track_stage(options.track),
        fit_stage(options.fit),
    )


def run_fit_graph(
    graph: StageGraph, clip: Path, cache: ResultCache, watcher: RunWatcher
) -> tuple[Clip, Scene, Tracks, Fit]:
    """Run a graph up to the fit and load what frame interpolation needs.

    Args:
        graph: A graph with the stages up to the fit.
        clip: Path of the clip.
        cache: The cache.
        watcher: Follows the run.

    Returns:
        Clip, scene, tracks and fit.
    """
    entries = graph.run(cache, watcher, {"read": partial(_relocate_clip, clip)})
    stages = {stage.name: stage for stage in graph.stages}
    cached_clip, scene, tracks, fit = (
        load_stage_output(stages[n], entries[n]) for n in ("read", "calibrate", "track", "fit")
    )
    return _relocate_clip(clip, cached_clip), scene, tracks, fit


def hash_clip(path: Path) -> str:
    """Hash the bytes of a clip.

    Args:
        path: A video, or a folder of numbered images.

    Returns:
        SHA-256 as hexadecimal digits.

    Raises:
        ClipError: It is no clip or cannot be read.
    """
    require_readable_file(path)
    try:
        return compute_clip_digest(path)
    except OSError as error:
        raise ClipError(f"{path} cannot be read: {error.strerror}") from error


def run_clip(
    clip: Path,
    folder: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    value_listener: Callable[[str, Any], None] | None = None,
    snapshot: SourceSnapshot | None = None,
    shot: ClipShot | None = None,
) -> FinishedRun:
    """Run the chain on one clip and publish its files in a folder.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        options: Options of all stages.
        cache: The cache.
        watcher: Follows the run.
        value_listener: Called with the name and the output value of each stage: as soon as another stage needs it,
            else at the end.
        snapshot: The project's code when this process started; see `StageGraph.run`.
        shot: The shot of the clip to run; None for the whole clip.

    Returns:
        Summary of the run.

    Raises:
        TruerollError: The clip or an option cannot be used. No unfinished file remains.
    """
    require_unchanged = make_change_check(clip) if shot is None else shot.require_unchanged
    graph = build_run_graph(clip, options, shot)
    require_writable_folder(folder)
    require_clip_not_overwritten(clip, folder)
    stages = {stage.name: stage for stage in graph.stages}
    adapters: dict[str, Callable[[Any], Any]] = {"read": partial(_relocate_clip, clip)}
    digest = graph.clip if shot is None else shot.whole.digest
    shown: set[str] = set()
    if value_listener is not None:
        adapters = {
            name: partial(_forward_value, value_listener, shown, clip, name)
            for name in stages
            if stages[name].output is not None
        }
    entries = graph.run(cache, watcher, adapters, partial(require_unchanged, digest), snapshot)
    publish_files(entries, folder)
    write_source(clip, folder, shot)
    if value_listener is not None:
        for name in [name for name in stages if name in adapters and name not in shown]:
            adapters[name](load_stage_output(stages[name], entries[name]))
    cached_clip: Clip = load_stage_output(stages["read"], entries["read"])
    fit: Fit = load_stage_output(stages["fit"], entries["fit"])
    return FinishedRun(
        folder,
        assess_run_trust(cached_clip, fit),
        fit.events,
        format_whole_shot(fit),
        cached_clip.notes,
        fit.shot_numbers,
    )


def _relocate_clip(path: Path, clip: Clip) -> Clip:
    """Set the path of a cached clip: cache entries depend on content, not on paths."""
    return replace(clip, path=path)


def _forward_value(listener: Callable[[str, Any], None], shown: set[str], clip: Path, name: str, value: Any) -> Any:
    """Call the listener with the output of a stage, and return it."""
    value = _relocate_clip(clip, value) if name == "read" else value
    listener(name, value)
    shown.add(name)
    return value


def make_change_check(clip: Path) -> Callable[[str], None]:
    """Make a check that a clip has not changed since now.

    Args:
        clip: Path of the clip.

    Returns:
        A function of the clip's digest that raises ClipError if the clip no longer has this digest. It reads the clip
        only if the size or a time of the file differs.
    """
    before = _read_file_state(clip)

    def check(digest: str) -> None:
        if _read_file_state(clip) != before and hash_clip(clip) != digest:
            raise ClipError(f"{clip.name} was changed while it was read; run again once it is whole")

    return check


def _read_file_state(clip: Path) -> list[tuple[int, int, int, int]]:
    """Read size, inode and times (ns) of a file or of all files of a folder of images; every write changes them."""
    try:
        files = sorted(clip.iterdir()) if clip.is_dir() else [clip]
        facts = [path.stat() for path in files]
    except OSError:
        return []
    return [(one.st_size, one.st_ino, one.st_mtime_ns, one.st_ctime_ns) for one in facts]


def require_writable_folder(folder: Path) -> None:
    """Require that results can be written, before any work starts.

    Args:
        folder: Folder of the results; it need not exist.

    Raises:
        OptionError: It is no folder, or cannot be written.
    """
    place = folder.absolute()
    while not place.exists() and not place.is_symlink():
        place = place.parent
    if not place.is_dir():
        raise OptionError(f"The results need a folder; {place} is none, name another with -o")
    if not os.access(place, os.W_OK | os.X_OK):
        raise OptionError(f"The results need a folder that can be written; {place} cannot, name another with -o")


def require_clip_not_overwritten(clip: Path, folder: Path) -> None:
    """Require that no result would overwrite the clip itself.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.

    Raises:
        OptionError: A file of the run would take the place of the clip.
    """
    for names in STAGE_FILES.values():
        for name in names:
            target = folder / name
            if target.exists() and target.samefile(clip):
                raise OptionError(f"The results would overwrite the clip {clip} itself; name another folder with -o")


def publish_files(entries: Mapping[str, CacheEntry], folder: Path) -> None:
    """Copy the files of a run from the cache to a folder, each atomically.

    Args:
        entries: Cache entries of the stages by name.
        folder: Folder of the results.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for stage, names in STAGE_FILES.items():
        for name in names:
            source, target = entries[stage].folder / name, folder / name
            if not _is_published(source, target):
                with replace_file(target) as path:
                    shutil.copyfile(source, path)


def _is_published(source: Path, target: Path) -> bool:
    """Whether an earlier run has published the same bytes."""
    try:
        return target.is_file() and not target.is_symlink() and filecmp.cmp(source, target, shallow=False)
    except OSError:
        return False


def write_source(clip: Path, folder: Path, shot: ClipShot | None = None) -> None:
    """Write the path of the clip into the run folder; `trueroll call` needs its frames.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        shot: The shot of the clip; None for the whole clip.
    """
    part = {} if shot is None else {"first": shot.first, "stop": shot.stop, "begins": shot.clip.start_time}
    text = json.dumps({"path": str(clip.absolute()), **part})
    with suppress(OSError):
        if (folder / SOURCE_FILE).read_text(encoding="utf-8") == text:
            return
    with replace_file(folder / SOURCE_FILE) as path:
        path.write_text(text, encoding="utf-8")


def default_run_folder(clip: Path) -> Path:
    """Return the default folder of a run.

    Args:
        clip: Path of the clip.

    Returns:
        out/<stem of the clip>; out/clip for a file such as `...mp4`, whose stem is dots.
    """
    return Path("out") / (clip.stem if clip.stem.strip(".") else "clip")
