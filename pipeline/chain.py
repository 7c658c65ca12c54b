"""The chain of stages of a run, from a clip to the files of its folder."""

from __future__ import annotations

import filecmp
import hashlib
import json
import shutil
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from models.core.corrections import Corrections
from models.core.errors import ClipError, OptionError, TableNotFound
from models.core.fit_result import Fit, Trust
from models.core.naming import Naming
from models.core.rally import Rally
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.numerics.executor import SERIAL, Executor
from pipeline.engine.atomic_write import replace_file, require_writable_folder, write_text
from pipeline.engine.result_cache import CacheEntry, ResultCache
from pipeline.engine.source_fingerprint import SourceSnapshot
from pipeline.engine.stage_graph import RunWatcher, StageGraph, accept_result
from pipeline.io.corrections_file import corrections_path, read_corrections
from pipeline.io.run_folder import SOURCE_FILE, STAGE_FILES, TABLES, read_source
from pipeline.io.run_views import view_inputs
from pipeline.io.saved_shot import publish_shot
from pipeline.io.shot_laws import keep_laws
from pipeline.reporting.text.fit_sentences import format_corrections
from pipeline.reporting.text.rally_sentences import assess_rally_trust
from pipeline.reporting.text.text_formatting import escape_text
from pipeline.run_options import (
    RunOptions,
    apply_corrections,
    format_changed_settings,
    list_changed_values,
    list_overridden_flags,
)
from pipeline.stages.calibrate_stage import calibrate_stage
from pipeline.stages.candidates_stage import candidates_stage
from pipeline.stages.court_stage import court_stage
from pipeline.stages.detect_stage import detect_stage
from pipeline.stages.explain_stage import explain_stage
from pipeline.stages.export_stage import export_stage
from pipeline.stages.laws_stage import laws_stage
from pipeline.stages.place_stage import place_stages
from pipeline.stages.rally_output_stages import RallyPageOptions, rally_output_stages
from pipeline.stages.rally_stage import rally_stage
from pipeline.stages.read_stage import open_frame_memory, read_stage
from pipeline.stages.record_stage import RecordOptions, record_stage
from pipeline.stages.render_stage import background_stage, poster_stage, render_stage
from pipeline.stages.report_stage import ReportOptions, report_stage
from pipeline.stages.shot_stages import ClipShot, shot_stage
from pipeline.stages.track_stage import track_stage
from video.calibration.view_prior import MOTION_NOTE, PROFILE_NOTE
from video.io.clip import Clip
from video.io.clip_digest import compute_clip_digest, read_file_state
from video.io.frame_memory import FrameMemory
from video.io.refused_files import require_readable_file


@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A finished run of a shot of billiards."""

    folder: Path
    shot: Shot
    fit: Fit
    """Views of the shot."""
    notes: tuple[str, ...] = ()
    """Sentences about irregularities of the clip, and on corrections by hand."""

    @property
    def trust(self) -> Trust:
        """Trust level of the run."""
        return self.fit.trust


@dataclass(frozen=True, slots=True)
class FinishedRally:
    """A finished run of a rally over a net."""

    folder: Path
    clip: Clip
    rally: Rally
    notes: tuple[str, ...] = ()
    """Sentences about irregularities of the clip, and on corrections by hand."""

    @property
    def trust(self) -> Trust:
        """Trust level of the run."""
        return assess_rally_trust(self.rally)


def build_run_graph(
    clip: Path,
    options: RunOptions,
    shot: ClipShot | None = None,
    executor: Executor = SERIAL,
    memory: FrameMemory | None = None,
) -> StageGraph:
    """Build the graph of all stages of a run.

    Args:
        clip: Path of the clip.
        options: Options of all stages; without a sport, the graph is that of billiards.
        shot: The shot of the clip to run; None for the whole clip.
        executor: Where stages run parts of their work; it changes no result.
        memory: Keeps the decoded frames of the clip for the stages; None decodes it in each.

    Returns:
        The graph.

    Raises:
        ClipError: The clip is no video or cannot be read.
    """
    digest = hash_clip(clip) if shot is None else shot.whole.digest
    own = honour_corrections(clip, digest, options, shot)
    return _build_graph(clip, digest, own, own.court.has_court, shot, executor, memory)


def build_court_graph(
    clip: Path, options: RunOptions, shot: ClipShot | None = None, memory: FrameMemory | None = None
) -> StageGraph:
    """Build the graph of all stages of a run of a rally; see `build_run_graph`."""
    digest = hash_clip(clip) if shot is None else shot.whole.digest
    return _build_graph(clip, digest, honour_corrections(clip, digest, options, shot), True, shot, SERIAL, memory)


def build_shot_graph(clip: Path, options: RunOptions, memory: FrameMemory | None = None) -> StageGraph:
    """Build the graph of the stages up to the shot.

    Args:
        clip: Path of the clip.
        options: Options of all stages.
        memory: Keeps the decoded frames of the clip for the stages; None decodes it in each.

    Returns:
        The graph.

    Raises:
        ClipError: The clip is no video or cannot be read.
    """
    return build_run_graph(clip, options, memory=memory).select("explain")


def honour_corrections(clip: Path, digest: str, options: RunOptions, shot: ClipShot | None = None) -> RunOptions:
    """Apply the corrections file beside a clip: the command line beats it, and it beats the defaults.

    Args:
        clip: Path of the clip.
        digest: SHA-256 of the clip.
        options: Options of the command line.
        shot: The shot of the clip to run, for which its part counts; None for the whole clip.

    Returns:
        The options with the corrections.

    Raises:
        OptionError: The file cannot be used.
    """
    return apply_corrections(options, _read_own_corrections(clip, digest, shot))


def _read_own_corrections(clip: Path, digest: str, shot: ClipShot | None) -> Corrections:
    """Read the corrections of a clip, or of one of its shots."""
    corrections = read_corrections(clip, digest).corrections
    return corrections if shot is None else corrections.select_span(shot.first, shot.stop)


def _build_graph(
    clip: Path, digest: str, options: RunOptions, has_court: bool, shot: ClipShot | None, executor: Executor,
    memory: FrameMemory | None,
) -> StageGraph:  # fmt: skip
    """Build the graph of a run whose options hold the corrections of the clip: of a rally, or of billiards."""
    settings = format_changed_settings(replace(options, render=replace(options.render, no_video=False)))
    title = escape_text(clip.name if shot is None else f"{clip.name}, {shot.name}")
    placed = place_stages(options.corrections)
    detections = placed[0].name if placed else "detect"
    read = read_stage(clip, digest, options.read, memory)
    read = read if shot is None else shot_stage(shot, digest, options.read, memory)
    name = digest if shot is None else f"{shot.name}-{digest}"
    if has_court:
        page = RallyPageOptions(title, options.render.slow, settings)
        outputs = rally_output_stages(page, options.render, options.corrections)
        return StageGraph.from_stages(
            (read, court_stage(options.court), candidates_stage(), rally_stage(options.corrections), *outputs), name
        )
    stages = (
        read,
        calibrate_stage(options.calibrate),
        detect_stage(options.detect, executor),
        *placed,
        track_stage(options.track, options.corrections, detections),
        explain_stage(options.fit, options.corrections),
        *((laws_stage(options.fit),) if options.fit.laws else ()),
        export_stage(options.detect, options.fit),
        background_stage(),
        poster_stage(options.render),
        report_stage(ReportOptions(title, options.render.slow, settings, options.detect, options.fit)),
        record_stage(RecordOptions(title, options.fit, detections)),
        *(() if options.render.no_video else (render_stage(options.render),)),
    )
    return StageGraph.from_stages(stages, name)


def run_shot_graph(graph: StageGraph, cache: ResultCache, watcher: RunWatcher) -> tuple[Clip, Shot]:
    """Run a graph up to the shot and load what frame interpolation needs.

    Args:
        graph: A graph with the stages up to the shot.
        watcher: Follows the run.

    Returns:
        Clip and shot.
    """
    entries = graph.run(cache, watcher)
    return graph.load("read", entries), graph.load("explain", entries)


def explain_clip(
    clip: Path, options: RunOptions, cache: ResultCache, watcher: RunWatcher, memory: FrameMemory | None = None
) -> tuple[Clip, Shot | Rally]:
    """Explain a clip of a shot, or of a rally where it shows no table.

    Args:
        clip: Path of the clip.
        options: Options of all stages.
        watcher: Follows the run.
        memory: Keeps the decoded frames of the clip for the stages; None decodes it in each.

    Returns:
        The clip, and its shot or rally.

    Raises:
        TruerollError: The clip or an option cannot be used.
    """
    corrected = honour_corrections(clip, hash_clip(clip), options)
    court = build_court_graph(clip, options, memory=memory).select("rally")
    if not corrected.court.has_court:
        try:
            return run_shot_graph(build_shot_graph(clip, options, memory), cache, watcher)
        except TableNotFound as refusal:
            _require_court(court, corrected, refusal, cache, watcher)
    entries = court.run(cache, watcher)
    return court.load("read", entries), court.load("rally", entries)


def _require_court(
    graph: StageGraph, options: RunOptions, refusal: TableNotFound, cache: ResultCache, watcher: RunWatcher,
    check: Callable[[], None] = accept_result, snapshot: SourceSnapshot | None = None,
) -> None:  # fmt: skip
    """Raise why there is no table, unless the clip shows a court and the user did not say billiards."""
    if options.court.sport is not None:
        raise refusal
    try:
        graph.select("court").run(cache, watcher, check, snapshot)
    except ClipError:
        raise refusal from None


def _is_known_court(court: StageGraph, options: RunOptions, cache: ResultCache) -> bool:
    """Find out whether a run of these options saw no table and found a court: the search for a table takes seconds."""
    if options.court.sport is not None or options.calibrate != RunOptions().calibrate:
        return False
    return all(status.state == "cached" for status in court.select("court").list_statuses(cache))


def run_tables(
    clip: Path,
    folder: Path,
    options: RunOptions,
    cache: ResultCache,
    watcher: RunWatcher,
    shot: ClipShot | None = None,
    publishes: bool = True,
) -> tuple[Clip, Scene, Tracks, Fit, str] | tuple[Clip, Rally, str]:
    """Run the stages up to the tables, and publish these alone: video, recording and report take longer, and stay.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        options: Options of all stages.
        watcher: Follows the run.
        shot: The shot of the clip to run; None for the whole clip.
        publishes: Whether to write to the folder at all.

    Returns:
        Clip, scene, tracks, views of the shot, and the digest of the tables; of a rally: clip, rally and digest.

    Raises:
        TruerollError: The clip or an option cannot be used. No unfinished file remains.
    """
    corrected = honour_corrections(clip, hash_clip(clip) if shot is None else shot.whole.digest, options, shot)
    require_writable_folder(folder)
    require_clip_not_overwritten(clip, folder)
    with open_frame_memory() as memory:
        court = build_court_graph(clip, options, shot, memory).select("export")
        graph = court
        try:
            if not (corrected.court.has_court or _is_known_court(court, corrected, cache)):
                graph = build_run_graph(clip, options, shot, memory=memory).select("export")
            entries = graph.run(cache, watcher)
        except TableNotFound as refusal:
            _require_court(court, corrected, refusal, cache, watcher)
            graph, entries = court, court.run(cache, watcher)
    if publishes:
        report_tables = find_report_tables(folder)
        publish_files(entries, folder, keeps_older=True)
        write_source(clip, folder, options, shot, report_tables)
    tables = hash_tables(entries["export"].folder)
    if "rally" in entries:
        return graph.load("read", entries), graph.load("rally", entries), tables
    values: dict[str, Any] = {one: graph.load(one, entries) for one in ("read", "explain", "laws") if one in entries}
    explained: Shot = values["explain"]
    return values["read"], explained.scene, explained.tracks, view_inputs(values, options.fit), tables


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
    snapshot: SourceSnapshot | None = None,
    shot: ClipShot | None = None,
    answer_listener: Callable[[FinishedRun | FinishedRally], None] | None = None,
    executor: Executor = SERIAL,
    start_helpers: Callable[[Collection[str]], object] | None = None,
    memory: FrameMemory | None = None,
    notes: tuple[str, ...] = (),
    result_listener: Callable[[StageGraph, Mapping[str, CacheEntry]], object] | None = None,
) -> FinishedRun | FinishedRally:
    """Run the chain on one clip and publish its files in a folder.

    Tables, poster and report are published as soon as they exist, the recording and the slow motion at the end. A clip
    without a billiards table is searched for a court.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        options: Options of all stages.
        watcher: Follows the run.
        snapshot: The project's code when this process started; see `StageGraph.run`.
        shot: The shot of the clip to run; None for the whole clip.
        answer_listener: Called with the summary of the run when the report is published, unless everything was cached.
        executor: Where stages run parts of their work; it changes no result.
        start_helpers: Called before each stage that runs, with the names of the stages whose results exist.
        memory: Keeps the decoded frames of the clip until the run ends; None opens one.
        notes: Further notes of the run.
        result_listener: Called before each stage that runs, with the graph and the results of the stages before it.

    Returns:
        The run.

    Raises:
        TruerollError: The clip or an option cannot be used. No unfinished file remains.
    """
    require_unchanged = make_change_check(clip) if shot is None else shot.require_unchanged
    digest = hash_clip(clip) if shot is None else shot.whole.digest
    corrections = _read_own_corrections(clip, digest, shot)
    corrected = apply_corrections(options, corrections)
    memory = memory or open_frame_memory()
    has_court = corrected.court.has_court
    graph = _build_graph(clip, digest, corrected, has_court, shot, executor, memory)
    require_writable_folder(folder)
    require_clip_not_overwritten(clip, folder)
    by_hand = len(format_corrections(corrected.corrections, Naming()))
    notes += (f"corrections by hand: {by_hand}, from {corrections_path(clip)}",) if by_hand else ()
    if overridden := list_overridden_flags(options, corrections):
        notes += (f"{', '.join(overridden)} of this command was used instead of what {corrections_path(clip)} sets",)
    is_answered = False

    def publish_answer(before: Mapping[str, CacheEntry]) -> None:
        """Publish tables, poster and report before a later stage runs."""
        nonlocal is_answered
        if start_helpers is not None and not has_court:
            start_helpers(before)
        if result_listener is not None:
            result_listener(graph, before)
        if "report" not in before:
            return
        publish_files(before, folder)
        write_source(clip, folder, options, shot, hash_tables(folder))
        if answer_listener is not None and not is_answered:
            answer_listener(_summarize_run(folder, graph, before, corrected, notes, memory))
        is_answered = True

    check = partial(require_unchanged, digest)
    with memory:
        try:
            entries = graph.run(cache, watcher, check, snapshot, publish_answer)
        except TableNotFound as refusal:
            has_court, graph = True, _build_graph(clip, digest, corrected, True, shot, executor, memory)
            _require_court(graph, corrected, refusal, cache, watcher, check, snapshot)
            entries = graph.run(cache, watcher, check, snapshot, publish_answer)
    publish_files(entries, folder)
    write_source(clip, folder, options, shot, hash_tables(folder))
    if "laws" in entries and not corrected.fit.profile:  # a profile is a prior that other questions do not share
        keep_laws(folder, graph.load("explain", entries), graph.load("laws", entries), cache)
    return _summarize_run(folder, graph, entries, corrected, notes, memory)


def _summarize_run(
    folder: Path, graph: StageGraph, entries: Mapping[str, CacheEntry], options: RunOptions, notes: tuple[str, ...],
    memory: FrameMemory,
) -> FinishedRun | FinishedRally:  # fmt: skip
    """Summarize a run whose fit is done; `notes` are added to those of the clip."""
    clip: Clip = graph.load("read", entries)
    if "rally" in entries:
        return FinishedRally(folder, clip, graph.load("rally", entries), (*clip.notes, *memory.notes, *notes))
    values = {name: graph.load(name, entries) for name in ("explain", "laws") if name in entries}
    shot: Shot = values["explain"]
    fit = view_inputs(values, options.fit)
    of_view = (
        note for note in (*shot.scene.notes, *fit.profile_misfits) if note.startswith((PROFILE_NOTE, MOTION_NOTE))
    )
    return FinishedRun(folder, shot, fit, (*clip.notes, *memory.notes, *notes, *dict.fromkeys(of_view)))


def make_change_check(clip: Path) -> Callable[[str], None]:
    """Make a check that a clip has not changed since now.

    Args:
        clip: Path of the clip.

    Returns:
        A function of the clip's digest that raises ClipError if the clip no longer has this digest. It reads the clip
        only if the size or a time of the file differs.
    """
    before = read_file_state(clip)

    def check(digest: str) -> None:
        if read_file_state(clip) != before and hash_clip(clip) != digest:
            raise ClipError(f"{clip.name} was changed while it was read; run again once it is whole")

    return check


def require_clip_not_overwritten(clip: Path, folder: Path) -> None:
    """Require that no result would overwrite the clip itself.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.

    Raises:
        OptionError: A file of the run would take the place of the clip.
    """
    targets = (folder / name for names in STAGE_FILES.values() for name in names)
    if any(target.exists() and target.samefile(clip) for target in targets):
        raise OptionError(f"The results would overwrite the clip {clip} itself; name another folder with -o")


def publish_files(entries: Mapping[str, CacheEntry], folder: Path, keeps_older: bool = False) -> None:
    """Copy the files of a run from the cache to a folder, each atomically.

    Files of later stages that are not there yet are removed where they were made of other tables.

    Args:
        entries: Cache entries of the finished stages by name.
        folder: Folder of the results.
        keeps_older: Whether such files stay.
    """
    is_older = "export" in entries and find_report_tables(folder) != hash_tables(entries["export"].folder)
    folder.mkdir(parents=True, exist_ok=True)
    sources = {name: entries[stage].folder / name for stage, names in STAGE_FILES.items() if stage in entries
               for name in names if (entries[stage].folder / name).exists()}  # fmt: skip
    changed = [name for name, source in sources.items() if not _is_published(source, folder / name)]
    if is_older and not keeps_older:
        for name in {name for names in STAGE_FILES.values() for name in names} - sources.keys():
            (folder / name).unlink(missing_ok=True)
    if "export" in entries:
        publish_shot(entries["export"].folder, folder)
    for name in changed:
        with replace_file(folder / name) as path:
            shutil.copyfile(sources[name], path)


def _is_published(source: Path, target: Path) -> bool:
    """Whether an earlier run has published the same bytes."""
    try:
        return target.is_file() and not target.is_symlink() and filecmp.cmp(source, target, shallow=False)
    except OSError:
        return False


def hash_tables(folder: Path) -> str:
    """Hash the tables of a run.

    Args:
        folder: Folder with the tables.

    Returns:
        SHA-256 as hexadecimal digits; empty where a table is missing.
    """
    digest = hashlib.sha256()
    try:
        for name in TABLES:
            with (folder / name).open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
    except OSError:
        return ""
    return digest.hexdigest()


def find_report_tables(folder: Path) -> str:
    """Find the tables that video, report and recording of a run folder were made of.

    Args:
        folder: The run folder.

    Returns:
        Digest of these tables; of those in the folder where it notes none.
    """
    noted = read_source(folder)
    return str(noted["report_tables"]) if "report_tables" in noted else hash_tables(folder)


def write_source(
    clip: Path, folder: Path, options: RunOptions, shot: ClipShot | None = None, report_tables: str = ""
) -> None:
    """Write the path of the clip and the settings of the run into its folder.

    `trueroll call` needs the frames of the clip, and `trueroll edit` runs it again with the same settings.

    Args:
        clip: Path of the clip.
        folder: Folder of the results.
        options: Options of the run without its corrections. That the video was left out is not noted.
        shot: The shot of the clip; None for the whole clip.
        report_tables: Digest of the tables that video, report and recording in the folder were made of; empty for none.
    """
    settings = list_changed_values(replace(options, render=replace(options.render, no_video=False)))
    part: dict[str, Any] = {} if shot is None else {"first": shot.first, "stop": shot.stop}
    part |= {"settings": settings} if settings else {}
    part |= {"report_tables": report_tables} if report_tables else {}
    text = json.dumps({"path": str(clip.absolute()), **part})
    with suppress(OSError):
        if (folder / SOURCE_FILE).read_text(encoding="utf-8") == text:
            return
    write_text(folder / SOURCE_FILE, text)


def default_run_folder(clip: Path) -> Path:
    """Return the default folder of a run.

    Args:
        clip: Path of the clip.

    Returns:
        out/<stem of the clip>; out/clip for a file such as `...mp4`, whose stem is dots.
    """
    return Path("out") / (clip.stem if clip.stem.strip(".") else "clip")
