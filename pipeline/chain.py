"""The chain of a run: from a clip to the files of its folder."""

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

from models.core.errors import ClipError, OptionError
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.scene import Scene
from models.core.tracks import Tracks
from pipeline.engine.atomic_write import aside
from pipeline.engine.result_cache import Cache, Entry
from pipeline.engine.source_fingerprint import Look
from pipeline.engine.stage import Stage
from pipeline.engine.stage_graph import Graph, Watcher, stage_value
from pipeline.options import RunOptions, told_apart
from pipeline.reporting.text.run_trust import run_trust
from pipeline.reporting.text.sentences import told
from pipeline.stages.calibrate_stage import calibrate_stage
from pipeline.stages.detect_stage import detect_stage
from pipeline.stages.export_stage import export_stage
from pipeline.stages.fit_stage import fit_stage
from pipeline.stages.forecast_stage import forecast_stage
from pipeline.stages.read_stage import read_stage
from pipeline.stages.record_stage import RecordOptions, record_stage
from pipeline.stages.render_stage import render_stage
from pipeline.stages.report_stage import ReportOptions, report_stage
from pipeline.stages.shot_stage import Shot, shot_stage
from pipeline.stages.track_stage import track_stage
from video.io.clip import Clip, check_file, clip_digest

FILES: Mapping[str, tuple[str, ...]] = {
    "export": ("tracks.csv", "events.csv", "trajectory.csv", "scene.json"),
    "render": ("slow.mp4", "poster.png"),
    "record": ("recording.rrd",),
    "report": ("report.html",),
}
"""Which stage makes which files of a run's folder."""
SOURCE = "source.json"
"""Where a run notes which clip it was."""


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run."""

    folder: Path
    trust: Trust
    events: Events
    notes: tuple[str, ...] = ()
    """Sentences on what was not as it should be with the clip."""


def run_graph(clip: Path, options: RunOptions, shot: Shot | None = None) -> Graph:
    """The stages of a run of this clip, or of one shot of it; ClipError where there is no such file."""
    digest = digest_of(clip) if shot is None else shot.whole.digest
    settings, title = told_apart(options), told(clip.name if shot is None else f"{clip.name}, {shot.name}")
    stages = (
        *_stages_to_fit(clip, digest, options, shot),
        export_stage(options.detect),
        render_stage(options.render),
        forecast_stage(options.forecast),
        record_stage(RecordOptions(title)),
        report_stage(ReportOptions(title, options.render.slow, settings, options.detect)),
    )
    return Graph.of(stages, digest if shot is None else f"{shot.name}-{digest}")


def fit_graph(clip: Path, options: RunOptions) -> Graph:
    """The stages of a run of this clip up to the fit."""
    digest = digest_of(clip)
    return Graph.of(_stages_to_fit(clip, digest, options), digest)


def _stages_to_fit(clip: Path, digest: str, options: RunOptions, shot: Shot | None = None) -> tuple[Stage, ...]:
    return (
        read_stage(clip, digest, options.read) if shot is None else shot_stage(shot, digest, options.read.fps),
        calibrate_stage(options.calibrate),
        detect_stage(options.detect),
        track_stage(options.track),
        fit_stage(options.fit),
    )


def fitted(graph: Graph, clip: Path, cache: Cache, watcher: Watcher) -> tuple[Clip, Scene, Tracks, Fit]:
    """The values of a graph's stages that pictures between pictures are made from."""
    entries = graph.run(cache, watcher, {"read": partial(_at, clip)})
    stages = {stage.name: stage for stage in graph.stages}
    seen, scene, tracks, fit = (stage_value(stages[n], entries[n]) for n in ("read", "calibrate", "track", "fit"))
    return _at(clip, seen), scene, tracks, fit


def digest_of(path: Path) -> str:
    """SHA-256 of the clip's bytes; ClipError where it is none or cannot be read."""
    check_file(path)
    try:
        return clip_digest(path)
    except OSError as error:
        raise ClipError(f"{path} cannot be read: {error.strerror}") from error


def run_clip(
    clip: Path,
    folder: Path,
    options: RunOptions,
    cache: Cache,
    watcher: Watcher,
    onlooker: Callable[[str, Any], None] | None = None,
    look: Look | None = None,
    shot: Shot | None = None,
) -> Run:
    """Run the chain on one clip and publish its files in `folder`.

    An `onlooker` is shown what each stage made, by its name: as soon as the next one needs it, else at the end.
    For `look` see Graph.run. Raises a TruerollError, one sentence, where the clip cannot be used; nothing is left
    half-written then.
    """
    unchanged = unchanging(clip) if shot is None else shot.unchanged
    graph = run_graph(clip, options, shot)
    refuse_closed(folder)
    refuse_overwriting(clip, folder)
    stages = {stage.name: stage for stage in graph.stages}
    bound: dict[str, Callable[[Any], Any]] = {"read": partial(_at, clip)}
    digest = graph.clip if shot is None else shot.whole.digest
    shown: set[str] = set()
    if onlooker is not None:
        bound = {
            name: partial(_show, onlooker, shown, clip, name) for name in stages if stages[name].output is not None
        }
    entries = graph.run(cache, watcher, bound, partial(unchanged, digest), look)
    publish(entries, folder)
    note_source(clip, folder, shot)
    if onlooker is not None:
        for name in [name for name in stages if name in bound and name not in shown]:
            bound[name](stage_value(stages[name], entries[name]))
    seen: Clip = stage_value(stages["read"], entries["read"])
    fit: Fit = stage_value(stages["fit"], entries["fit"])
    return Run(folder, run_trust(seen, fit), fit.events, seen.notes)


def _at(path: Path, clip: Clip) -> Clip:
    """The clip where it lies today: the cache knows content, not places."""
    return replace(clip, path=path)


def _show(onlooker: Callable[[str, Any], None], shown: set[str], clip: Path, name: str, value: Any) -> Any:
    """Show the onlooker what a stage made, and hand it on."""
    value = _at(clip, value) if name == "read" else value
    onlooker(name, value)
    shown.add(name)
    return value


def unchanging(clip: Path) -> Callable[[str], None]:
    """A check to be made with the clip's digest once work on its pictures is done, before the result is kept.

    It raises ClipError where they are no longer those of the digest. Only a file that was touched is read again.
    """
    before = _state(clip)

    def check(digest: str) -> None:
        if _state(clip) != before and digest_of(clip) != digest:
            raise ClipError(f"{clip.name} was changed while it was read; run again once it is whole")

    return check


def _state(clip: Path) -> list[tuple[int, int, int, int]]:
    """Size, number and times of the file, or of every file of a folder of pictures; a write cannot leave them alone."""
    try:
        files = sorted(clip.iterdir()) if clip.is_dir() else [clip]
        facts = [path.stat() for path in files]
    except OSError:
        return []
    return [(one.st_size, one.st_ino, one.st_mtime_ns, one.st_ctime_ns) for one in facts]


def refuse_closed(folder: Path) -> None:
    """OptionError where no results can be written: known before the work, not after it."""
    place = folder.absolute()
    while not place.exists() and not place.is_symlink():
        place = place.parent
    if not place.is_dir():
        raise OptionError(f"The results need a folder; {place} is none, name another with -o")
    if not os.access(place, os.W_OK | os.X_OK):
        raise OptionError(f"The results need a folder that can be written; {place} cannot, name another with -o")


def refuse_overwriting(clip: Path, folder: Path) -> None:
    """OptionError where a result would take the place of the clip itself."""
    for names in FILES.values():
        for name in names:
            target = folder / name
            if target.exists() and target.samefile(clip):
                raise OptionError(f"The results would overwrite the clip {clip} itself; name another folder with -o")


def publish(entries: Mapping[str, Entry], folder: Path) -> None:
    """Copy the files of a run out of the cache, each aside first and then under its name in one step."""
    folder.mkdir(parents=True, exist_ok=True)
    for stage, names in FILES.items():
        for name in names:
            made, target = entries[stage].folder / name, folder / name
            if not _is_there(made, target):
                with aside(target) as path:
                    shutil.copyfile(made, path)


def _is_there(made: Path, target: Path) -> bool:
    """Whether an earlier run has published the same bytes."""
    try:
        return target.is_file() and not target.is_symlink() and filecmp.cmp(made, target, shallow=False)
    except OSError:
        return False


def note_source(clip: Path, folder: Path, shot: Shot | None = None) -> None:
    """Write where the clip of a run lies: the cache knows content, not places, and calls want its pictures again."""
    part = {} if shot is None else {"first": shot.first, "stop": shot.stop, "begins": shot.clip.begins}
    noted = json.dumps({"path": str(clip.absolute()), **part})
    with suppress(OSError):
        if (folder / SOURCE).read_text(encoding="utf-8") == noted:
            return
    with aside(folder / SOURCE) as path:
        path.write_text(noted, encoding="utf-8")


def default_folder(clip: Path) -> Path:
    """Where a run goes that was not told: out/<name of the clip>, also of one that is called `...mp4`."""
    return Path("out") / (clip.stem if clip.stem.strip(".") else "clip")
