"""`trueroll what-if`: the same shot, played otherwise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.estimation.changed_shot import Game
from pipeline.actions.play_otherwise import PLAYS, StrokePlan, play_otherwise
from pipeline.actions.stroke_options import choose_spread, parse_change
from pipeline.engine.atomic_write import parse_output_path
from pipeline.engine.result_cache import open_cache
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore, read_learned_table


@answer_command("what-if", context_settings={"ignore_unknown_options": True})
def what_if(
    source: Annotated[cli.AnyPath, typer.Argument(metavar="DIR")],
    *,
    speed: Annotated[str | float | None, typer.Option(metavar="±P%|V")] = None,
    angle: Annotated[str | float | None, typer.Option(metavar="±Adeg")] = None,
    side: Annotated[str | float | None, typer.Option(metavar="±P%|S")] = None,
    top: Annotated[str | float | None, typer.Option(metavar="±P%|S")] = None,
    spread: Annotated[str | None, typer.Option(metavar="P%,A")] = None,
    session: Annotated[Sequence[cli.AnyPath] | None, typer.Option(metavar="DIR")] = None,
    game: Game | None = None,
    ball: str = "",
    pocket: str = "",
    stroke: Annotated[int, typer.Option(min=1)] = 1,
    profile: cli.ProfileOption = None,
    draws: Annotated[int, typer.Option(min=50, max=20_000)] = PLAYS,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    out: cli.OutBesideOption = None,
    cache: cli.AnyCacheOption = None,
    on_activity: Callable[[str], None] = ignore,
) -> Answer:
    """Play a shot otherwise: where the balls would go, and how probably it scores.

    Args:
        source: Folder of a run, a track folder, or a tracks.csv.
        speed: Change of the speed in %, such as -5%, or the speed in m/s.
        angle: Turn of the direction in degrees, > 0 to the right of the player.
        side: Side spin R ω / v: points to add, such as +10% (> 0 to the right), or the whole, such as 0.3.
        top: Top spin over rolling spin: points to add, such as -20%, or the whole: 1 rolls, 0 stun, -0.5 draws.
        spread: The player's own spread: of the speed in %, of the direction in degrees.
        session: Take the spread from runs that repeat one shot; repeatable.
        game: What scores: pot, carom or three-cushion. Default: pot with pockets, else carom.
        ball: The only ball that counts when potted. Default: any.
        pocket: The only pocket that counts. Default: any.
        stroke: Number of the stroke in the clip.
        draws: Number of plays.
        seed: Random seed of the plays.
    """
    change = parse_change(speed, angle, side, top)
    place = Path(source)
    folder = parse_output_path(out) if out is not None else place if place.is_dir() else place.parent
    plan = StrokePlan(change, *choose_spread(spread, session), game, ball, pocket)
    learned = read_learned_table(profile)
    return play_otherwise(place, stroke - 1, plan, learned, draws, seed, folder, open_cache(cache), on_activity)
