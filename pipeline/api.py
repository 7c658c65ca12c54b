"""trueroll in a notebook or a script: `run(clip)` gives what the command writes, as values and tables.

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
from typing import TYPE_CHECKING, Any, Literal, get_args

import pyarrow as pa
from pyarrow import csv

from models.core.errors import OptionError
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.progress import Progress, silent
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from pipeline.chain import default_folder, run_clip
from pipeline.engine.result_cache import Cache, default_root
from pipeline.io.run_folder import TEXT
from pipeline.options import collect, run_settings
from pipeline.reporting.recording.rerun_viewer import Viewer, has_display, recordings_of, start_viewer
from pipeline.reporting.text.run_trust import run_trust
from video.io.clip import Clip

if TYPE_CHECKING:
    import pandas as pd

Columns = Literal["tracks", "events", "trajectory"]


@dataclass(frozen=True, slots=True)
class Run:
    """One clip, run: the values behind its files, and the folder where these are."""

    folder: Path
    """With slow.mp4, report.html and the rest; docs/formats.md says what they hold."""
    clip: Clip
    scene: Scene
    """Table and camera."""
    tracks: Tracks
    """Where each ball was seen: arrays of pictures by balls, NaN where it was not."""
    fit: Fit
    """Events, motion and parameters, each with its error."""

    @property
    def events(self) -> Events:
        """What happened, in columns, in the order of time."""
        return self.fit.events

    @property
    def trajectory(self) -> Trajectory:
        """The fitted motion; `.at(t)` is the state of every ball (in the order of `.ids`) at any times t, s."""
        return self.fit.trajectory

    @property
    def trust(self) -> Trust:
        """green, amber or red, and why."""
        return run_trust(self.clip, self.fit)

    def to_arrow(self, what: Columns = "tracks") -> pa.Table:
        """The columns of tracks.csv, events.csv or trajectory.csv; SI units, null where a number is not known."""
        if what not in get_args(Columns):
            raise ValueError(f"a run has the tables {', '.join(get_args(Columns))}; got {what!r}")
        text = {name: pa.string() for name in TEXT}
        return csv.read_csv(self.folder / f"{what}.csv", convert_options=csv.ConvertOptions(column_types=text))

    def to_pandas(self, what: Columns = "tracks") -> pd.DataFrame:
        """The same as a data frame; it needs pandas, which trueroll does not install."""
        table = self.to_arrow(what)
        try:
            return table.to_pandas()
        except ImportError as error:
            raise OptionError("to_pandas needs pandas; install it with: pip install pandas") from error

    def show(self, *, web: bool | None = None) -> Viewer:
        """Open the recording in the rerun viewer (in the browser with `web`, or where there is no display).

        It stays open until it is closed, `.close()` is called, or Python ends.
        """
        viewer = start_viewer(recordings_of(self.folder), web=not has_display() if web is None else web)
        atexit.register(viewer.close)
        return viewer


def run(
    clip: str | Path,
    out: str | Path | None = None,
    *,
    cache: str | Path | None = None,
    progress: Callable[[str, float], None] | None = None,
    **settings: Any,
) -> Run:
    """Run the chain on a clip; `settings` are the options of `trueroll run`, such as slow=4 or table="pool-9ft".

    Files go to `out` (out/NAME where not given). `progress` hears the name of each stage and the share of it that is
    done. What was run before comes from the cache. TruerollError, one sentence, where the clip cannot be used;
    ValueError for a setting that does not exist.
    """
    known = run_settings()
    if unknown := sorted(settings.keys() - known.keys()):
        raise ValueError(f"run takes the settings {', '.join(known)}; got {', '.join(unknown)}")
    options = collect({name: settings.get(name, setting.default) for name, setting in known.items()})
    path = Path(clip)
    folder = Path(out) if out is not None else default_folder(path)
    made: dict[str, Any] = {}
    store = Cache(Path(cache) if cache is not None else default_root())
    run_clip(path, folder, options, store, _Told(progress), made.__setitem__)
    return Run(folder, made["read"], made["calibrate"], made["track"], made["fit"])


class _Told:
    """A watcher of a run that tells a function."""

    def __init__(self, tell: Callable[[str, float], None] | None) -> None:
        self._tell = tell

    def started(self, stage: str) -> Progress:
        tell = self._tell
        return silent if tell is None else lambda share: tell(stage, share)

    def finished(self, stage: str, seconds: float, cached: bool) -> None:
        if self._tell is not None:
            self._tell(stage, 1.0)
