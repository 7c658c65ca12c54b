"""`trueroll predict`: predict the rest of a shot from any moment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.core.corrections import NO_CORRECTIONS
from models.core.errors import OptionError
from models.estimation.forecast.ensemble_prediction import ENSEMBLE_SIZE
from pipeline.engine.atomic_write import parse_output_path
from pipeline.engine.result_cache import open_cache
from pipeline.io.corrections_file import read_noted_corrections
from pipeline.io.particle_files import is_particle_source
from pipeline.io.saved_shot import holds_rally, read_rally
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, read_learned_table


@answer_command("predict")
def predict(
    source: Annotated[cli.AnyPath, typer.Argument(metavar="DIR|tracks.csv")],
    *,
    seconds: float = 3.0,
    at: Annotated[float | None, typer.Option(metavar="T")] = None,
    out: cli.OutBesideOption = None,
    shot: int | None = None,
    fps: Annotated[float | None, typer.Option(metavar="F")] = None,
    draws: Annotated[int, typer.Option(min=ENSEMBLE_SIZE)] = ENSEMBLE_SIZE,
    profile: cli.ProfileOption = None,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    cache: cli.AnyCacheOption = None,
) -> Answer:
    """Predict the rest of a shot from any moment, with its uncertainty; later observations are not used.

    Of a rally, the flight is continued until the playing surface. A tracks.csv without a scene holds any particles:
    springs, colliding rigid bodies, or bodies in flight.

    Args:
        source: Folder of a run, a track folder, or a tracks.csv.
        seconds: How far to predict, in s.
        at: Time to predict from, in s. Default: the last observation.
        shot: Number of the shot in the folder. Default: the first.
        fps: Frame rate of a tracks.csv of particles without t, in frames per second.
        draws: Number of ensemble members.
        seed: Random seed of the ensemble.
    """
    if not 0 < seconds <= 60:
        raise OptionError(f"--seconds is above 0 and at most 60; got {seconds:g}")
    place = Path(source)
    folder = parse_output_path(out) if out is not None else place if place.is_dir() else place.parent
    if holds_rally(place):
        from pipeline.actions.predict_rally import predict_rally  # slow to import

        corrections = NO_CORRECTIONS if at is None else read_noted_corrections(place)
        return predict_rally(read_rally(place), seconds, at, folder, corrections)
    if is_particle_source(place):
        from pipeline.actions.particle_motion import predict_particles  # slow to import

        return predict_particles(place, seconds, at, folder, shot, fps)
    from pipeline.actions.predict_shot import predict_shot  # slow to import

    learned = read_learned_table(profile)
    return predict_shot(place, seconds, at, shot, learned, seed, draws, folder, open_cache(cache))
