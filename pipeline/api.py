"""trueroll in a notebook or a script: `run(clip)` returns the results of `trueroll run` as values and tables.

from pipeline.api import run

shot = run("shot.mp4")
shot.events                    # strikes, contacts, pockets, rests
shot.trajectory.at(1.25).xy    # where every ball was at 1.25 s, m
shot.to_pandas("tracks")
shot.show()
"""

from __future__ import annotations

import atexit
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack, get_args

import pyarrow as pa
from pyarrow import csv

from models.core.answer import format_html
from models.core.court_camera import CourtScene
from models.core.errors import OptionError
from models.core.events import Events
from models.core.fit_result import Fit, Trust, WholeShotFit
from models.core.number_format import format_probability
from models.core.progress import Progress
from models.core.rally import Rally, RallyEvent
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.estimation.rally.rally_columns import RallyTracks, RallyTrajectory, tabulate_tracks
from pipeline.chain import FinishedRally, default_run_folder
from pipeline.engine.atomic_write import parse_output_path
from pipeline.engine.result_cache import open_cache
from pipeline.engine.stage_graph import SilentWatcher
from pipeline.io.run_views import view_run
from pipeline.io.saved_shot import read_saved, require_rally, require_shot
from pipeline.io.shot_laws import find_laws
from pipeline.io.text_table import TEXT_COLUMNS
from pipeline.recording_shots import ShotChoice, run_chosen_shot
from pipeline.reporting.recording.rerun_viewer import Viewer, find_recordings, has_display, start_viewer
from pipeline.reporting.text.rally_sentences import assess_rally_trust, list_event_rows
from pipeline.reporting.text.text_formatting import format_event_time, name_event
from pipeline.run_options import RunSettings, build_options, list_settings

if TYPE_CHECKING:
    import pandas as pd

Columns = Literal["tracks", "events", "trajectory"]


@dataclass(frozen=True, slots=True, repr=False)
class Run:
    """A finished run of a clip: its values, and the folder of its files."""

    folder: Path
    """Folder with slow.mp4, report.html and the other files, which docs/reference/file-formats.md describes."""
    saved: Shot | Rally
    """The saved shot or rally, of which everything else is a view or an export."""
    laws: WholeShotFit | None = None
    """What published contact models make of it; None if neither `laws=True` nor `trueroll what-if` asked for them."""

    def __fspath__(self) -> str:
        """Return the folder, so that `trueroll.call` and the other questions take a run instead."""
        return str(self.folder)

    def __repr__(self) -> str:
        return f"Run({str(self.folder)!r}: trust {self.trust.level}, {self.events!r}, {self.tracks!r})"

    def _repr_html_(self) -> str:
        """Show the trust level and the events in a notebook."""
        events, naming = self.events, self.shot.naming
        rows = [
            (format_event_time(events, k),
             name_event(events, k, naming),
             format_probability(float(events.probability[k])))
            for k in range(len(events))
        ]  # fmt: skip
        lines = (f"{self.folder}: trust {self.trust.level}. {' '.join(self.trust.reasons)}", repr(self.tracks))
        return format_html(lines, [("time", "what", "probability"), *rows])

    @property
    def shot(self) -> Shot:
        """The saved shot of billiards; raises OptionError where the clip shows a rally."""
        return require_shot(self.saved, self.folder)

    @property
    def rally(self) -> Rally:
        """The saved rally; raises OptionError where the clip shows billiards."""
        return require_rally(self.saved, self.folder)

    @property
    def scene(self) -> Scene:
        """Table and camera."""
        return self.shot.scene

    @property
    def tracks(self) -> Tracks:
        """Observed positions of the balls: arrays of T frames by N balls, NaN where a ball was not detected."""
        return self.shot.tracks

    @property
    def fit(self) -> Fit:
        """Events, motion and parameters, each with its standard deviation."""
        return view_run(self.shot, self.laws)

    @property
    def events(self) -> Events:
        """Strikes, contacts, pockets and rests as columns, in order of time."""
        return self.fit.events

    @property
    def trajectory(self) -> Trajectory:
        """The fitted motion; `.at(t)` is the state of every ball (in the order of `.ids`) at any times t, s."""
        return self.fit.trajectory

    @property
    def trust(self) -> Trust:
        """Trust level of the run (green, amber or red) and its reasons."""
        return self.fit.trust

    def to_arrow(self, what: Columns = "tracks") -> pa.Table:
        """Read a table of the run.

        Args:
            what: Name of the table: "tracks", "events" or "trajectory".

        Returns:
            The columns of the csv file; SI units, null for missing numbers.

        Raises:
            ValueError: There is no such table.
        """
        if what not in get_args(Columns):
            raise ValueError(f"a run has the tables {', '.join(get_args(Columns))}; got {what!r}")
        text = {name: pa.string() for name in TEXT_COLUMNS}
        return csv.read_csv(self.folder / f"{what}.csv", convert_options=csv.ConvertOptions(column_types=text))

    def to_pandas(self, what: Columns = "tracks") -> pd.DataFrame:
        """Read a table of the run as a data frame; this needs pandas, which trueroll does not install.

        Args:
            what: Name of the table: "tracks", "events" or "trajectory".

        Returns:
            The columns of the csv file; SI units, NaN for missing numbers.

        Raises:
            ValueError: There is no such table.
            OptionError: pandas is not installed.
        """
        table = self.to_arrow(what)
        try:
            return table.to_pandas()
        except ImportError as error:
            raise OptionError("to_pandas needs pandas; install it with: pip install pandas") from error

    def show(self, *, web: bool | None = None) -> Viewer:
        """Open the recording in the rerun viewer.

        Args:
            web: Whether to use the browser instead of the native viewer; by default only where there is no display.

        Returns:
            The viewer. It stays open until the user closes it, `.close()` is called or Python ends.
        """
        viewer = start_viewer(find_recordings(self.folder), web=not has_display() if web is None else web)
        atexit.register(viewer.close)
        return viewer


@dataclass(frozen=True, slots=True, repr=False)
class RallyRun(Run):
    """A finished run of a rally over a net, whose values have a height too."""

    def __repr__(self) -> str:
        return f"RallyRun({str(self.folder)!r}: trust {self.trust.level}, {self.rally!r})"

    def _repr_html_(self) -> str:
        """Show the trust level and the events in a notebook."""
        lines = (f"{self.folder}: trust {self.trust.level}. {' '.join(self.trust.reasons)}", repr(self.tracks))
        return format_html(lines, [("time", "what", "probability"), *list_event_rows(self.rally)])

    @property
    def scene(self) -> CourtScene:  # type: ignore[override]
        """Court and camera."""
        return self.rally.scene

    @property
    def tracks(self) -> RallyTracks:  # type: ignore[override]
        """Places of the ball or shuttle, frame by frame."""
        return tabulate_tracks(self.rally)

    @property
    def events(self) -> tuple[RallyEvent, ...]:  # type: ignore[override]
        """Hits, bounces, touches of the net and the landing, in order of time."""
        return self.rally.events

    @property
    def trajectory(self) -> RallyTrajectory:  # type: ignore[override]
        """The flights; `.at(t)` is place, velocity and covariance at any times t, s."""
        return RallyTrajectory(self.rally)

    @property
    def trust(self) -> Trust:
        """Trust level of the run (green, amber or red) and its reasons."""
        return assess_rally_trust(self.rally)


def run(
    clip: str | Path,
    out: str | Path | None = None,
    *,
    shot: int | None = None,
    at: float | None = None,
    cache: str | Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    **settings: Unpack[RunSettings],
) -> Run:
    """Run the chain on a clip. Results of earlier runs come from the cache.

    Args:
        clip: Path of a video, or of a folder of numbered images.
        out: Folder of the results; out/<stem of the clip> by default.
        shot: Number, from 1, of the shot in a recording of several; the longest by default.
        at: A time in the shot, s of the recording, instead of its number.
        cache: Folder of the cache; $TRUEROLL_CACHE or ~/.cache/trueroll by default.
        progress: Called with the name of the running stage and its finished share, 0 to 1.
        settings: Options of `trueroll run`, such as slow=4 or table="pool-9ft".

    Returns:
        The run with its values; of a rally over a net, a `RallyRun`.

    Raises:
        TruerollError: The clip or a value cannot be used.
        ValueError: There is no such setting.
    """
    defaults = list_settings()
    if unknown := sorted(settings.keys() - defaults.keys()):
        raise ValueError(f"run takes the settings {', '.join(defaults)}; got {', '.join(unknown)}")
    options = build_options({name: settings.get(name, setting.default) for name, setting in defaults.items()})
    path = Path(clip)
    folder = parse_output_path(out) if out is not None else default_run_folder(path)
    watcher = SilentWatcher() if progress is None else _CallbackWatcher(progress)
    finished = run_chosen_shot(path, folder, options, open_cache(cache), watcher, ShotChoice(shot, at))
    if isinstance(finished, FinishedRally):
        return RallyRun(folder, finished.rally)
    return Run(folder, finished.shot, finished.fit.laws)


def load(folder: str | Path) -> Run:
    """Load a finished run from its folder.

    Args:
        folder: The run folder.

    Returns:
        The run with its values; of a rally over a net, a `RallyRun`.

    Raises:
        OptionError: It holds no saved shot.
    """
    place = Path(folder)
    saved = read_saved(place)
    if isinstance(saved, Rally):
        return RallyRun(place, saved)
    return Run(place, saved, find_laws(place, saved, open_cache(None)))


class _CallbackWatcher:
    """A watcher that calls a function with the progress."""

    def __init__(self, callback: Callable[[str, float], None]) -> None:
        self._callback = callback

    def start_stage(self, stage: str) -> Progress:
        """Return a function that forwards the progress of a stage."""
        return lambda share: self._callback(stage, share)

    def finish_stage(self, stage: str, seconds: float, cached: bool) -> None:
        """Report the stage as done."""
        self._callback(stage, 1.0)
