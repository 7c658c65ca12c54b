"""The chain of a run: from a clip to the files of its folder."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from models.errors import ClipError, OptionError
from models.events import Events
from models.fit import Fit, Trust
from models.scene import Scene
from models.tracks import Tracks
from pipeline.cache import Cache, Entry
from pipeline.graph import Graph, Watcher, stage_value
from pipeline.options import RunOptions, told_apart
from pipeline.publish import aside
from pipeline.stage import Stage
from pipeline.stages.calibrate import calibrate_stage
from pipeline.stages.detect import detect_stage
from pipeline.stages.export import export_stage
from pipeline.stages.fit import fit_stage
from pipeline.stages.read import read_stage
from pipeline.stages.record import RecordOptions, record_stage
from pipeline.stages.render import render_stage
from pipeline.stages.report import ReportOptions, report_stage
from pipeline.stages.track import track_stage
from pipeline.verdict import run_trust
from video.clip import Clip, open_clip

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


def run_graph(clip: Path, options: RunOptions) -> Graph:
    """The stages of a run of this clip; ClipError where there is no such file."""
    digest = clip_digest(clip)
    settings = told_apart(options)
    stages = (
        *_stages_to_fit(clip, digest, options),
        export_stage(options.detect),
        render_stage(options.render),
        record_stage(RecordOptions(clip.name)),
        report_stage(ReportOptions(clip.name, options.render.slow, settings, options.detect)),
    )
    return Graph.of(stages, digest)


def fit_graph(clip: Path, options: RunOptions) -> Graph:
    """The stages of a run of this clip up to the fit."""
    digest = clip_digest(clip)
    return Graph.of(_stages_to_fit(clip, digest, options), digest)


def _stages_to_fit(clip: Path, digest: str, options: RunOptions) -> tuple[Stage, ...]:
    return (
        read_stage(clip, digest, options.read),
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


def clip_digest(path: Path) -> str:
    """SHA-256 of the file's bytes."""
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        open_clip(path)  # knows the sentence for a file that cannot be opened
        raise ClipError(f"{path} cannot be read: {error.strerror}") from error


def run_clip(clip: Path, folder: Path, options: RunOptions, cache: Cache, watcher: Watcher) -> Run:
    """Run the chain on one clip and publish its files in `folder`.

    Raises a TruerollError, one sentence, where the clip cannot be used; nothing is left half-written then.
    """
    graph = run_graph(clip, options)
    refuse_closed(folder)
    refuse_overwriting(clip, folder)
    entries = graph.run(cache, watcher, {"read": partial(_at, clip)})
    publish(entries, folder)
    note_source(clip, folder)
    stages = {stage.name: stage for stage in graph.stages}
    seen: Clip = stage_value(stages["read"], entries["read"])
    fit: Fit = stage_value(stages["fit"], entries["fit"])
    return Run(folder, run_trust(seen, fit), fit.events, seen.notes)


def _at(path: Path, clip: Clip) -> Clip:
    """The clip where it lies today: the cache knows content, not places."""
    return replace(clip, path=path)


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
            with aside(folder / name) as path:
                shutil.copyfile(entries[stage].folder / name, path)


def note_source(clip: Path, folder: Path) -> None:
    """Write where the clip of a run lies: the cache knows content, not places, and calls want its pictures again."""
    with aside(folder / SOURCE) as path:
        path.write_text(json.dumps({"path": str(clip.absolute())}), encoding="utf-8")


def default_folder(clip: Path) -> Path:
    """Where a run goes that was not told: out/<name of the clip>."""
    return Path("out") / clip.stem
