"""`trueroll what-if`: the same shot, played otherwise."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from models.core.answer import Answer
from models.core.errors import OptionError
from models.estimation.changed_shot import GAMES, Game, PlayerSpread, StrokeChange
from pipeline.actions.play_otherwise import StrokePlan, estimate_session_spread, play_otherwise
from pipeline.engine.atomic_write import parse_output_path
from pipeline.engine.result_cache import open_cache
from pipeline.terminal import command_line as cli
from pipeline.terminal.answer_command import answer_command, ignore, read_learned_table

# m/s: no stroke is faster; breaks reach 12.
MAX_SPEED = 15.0
# R omega / v: a tip that is off the centre by more than R/2 slips, and gives 5/4 there.
MAX_SPIN = 1.5
_AMOUNT = re.compile(r"(?P<number>[+-]?(\d+(\.\d*)?|\.\d+))(?P<unit>%|deg|m/s)?")


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
    draws: Annotated[int, typer.Option(min=50, max=20_000)] = 400,
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
    change = _parse_change(speed, angle, side, top)
    if game not in (None, *GAMES):
        raise OptionError(f"--game is one of {', '.join(GAMES)}; got {game}")
    place = Path(source)
    folder = parse_output_path(out) if out is not None else place if place.is_dir() else place.parent
    plan = StrokePlan(change, *_choose_spread(spread, session), game, ball, pocket)
    learned = read_learned_table(profile)
    return play_otherwise(place, stroke - 1, plan, learned, draws, seed, folder, open_cache(cache), on_activity)


def _choose_spread(spread: str | None, session: Sequence[cli.AnyPath] | None) -> tuple[PlayerSpread, str]:
    """Return the player's spread, and where it comes from."""
    if spread is not None and session:
        raise OptionError("--spread and --session both state the player's spread; give one of them")
    if session:
        return estimate_session_spread([Path(one) for one in session]), "session"
    if spread is None:
        return PlayerSpread(), "none"
    parts = re.fullmatch(r"(\d+(?:\.\d*)?)%,(\d+(?:\.\d*)?)(?:deg)?", spread.replace(" ", ""))
    if parts is None or float(parts[1]) > 50 or float(parts[2]) > 20:
        raise OptionError(f"--spread is a share of the speed and degrees, such as 3%,0.4; got {spread}")
    return PlayerSpread(float(parts[1]) / 100, float(parts[2])), "user"


# A number, or its text with a sign and a unit.
Amount = str | float | None


def _parse_change(speed: Amount, angle: Amount, side: Amount, top: Amount) -> StrokeChange:
    values: dict[str, float] = {}
    if speed is not None:
        number, unit = _parse_amount("--speed", speed, ("%", "m/s", ""))
        if unit != "%" and str(speed).strip()[0] in "+-":
            raise OptionError(
                f"--speed is a change with %, or a speed in m/s without sign; got {speed}: write {number:+g}% to change"
                f" it by {abs(number):g} %, or {abs(number):g} to play at {abs(number):g} m/s"
            )
        values |= {"speed_factor": 1 + number / 100} if unit == "%" else {"speed": number}
        if not 0 < values.get("speed_factor", 1.0) <= 3 or not 0 < values.get("speed", 1.0) <= MAX_SPEED:
            raise OptionError(f"--speed is a change of -99% to +200%, or up to {MAX_SPEED:g} m/s; got {speed}")
    if angle is not None:
        number, _ = _parse_amount("--angle", angle, ("deg", ""))
        if abs(number) > 180:
            raise OptionError(f"--angle is a turn of at most 180 degrees; got {angle}")
        values["angle"] = number
    for name, text in (("side", side), ("top", top)):
        if text is not None:
            number, unit = _parse_amount(f"--{name}", text, ("%", ""))
            share = number / 100 if unit == "%" else number
            if abs(share) > MAX_SPIN:
                raise OptionError(f"--{name} is at most {MAX_SPIN:g}, or {MAX_SPIN:.0%}; got {text}")
            values[f"{name}_added" if unit == "%" else name] = share
    return StrokeChange(**values)


def _parse_amount(option: str, text: str | float, units: tuple[str, ...]) -> tuple[float, str]:
    """Return number and unit; the unit is empty where none was given."""
    parts = _AMOUNT.fullmatch(str(text).strip())
    if parts is None or (parts["unit"] or "") not in units:
        raise OptionError(f"{option} is a number{' with ' if any(units) else ''}{' or '.join(filter(None, units))};"
                          f" got {text}")  # fmt: skip
    return float(parts["number"]), parts["unit"] or ""
