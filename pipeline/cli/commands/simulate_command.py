"""`trueroll simulate`: simulate a shot from its initial state."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from models.core.answer import Answer
from models.core.ball_look import describe_unseen_balls
from models.core.naming import Naming, join_names
from models.core.trajectory import State
from pipeline.engine.atomic_write import require_writable_folder
from pipeline.io.csv_tables import write_events, write_states
from pipeline.io.image_file import write_image
from pipeline.io.shot_setup import ShotSetup, place_on_learned_table, read_shot_setup
from pipeline.io.table_profile import read_profile_text
from pipeline.reporting.text.text_formatting import name_event, start_sentence
from pipeline.terminal import command_line as cli
from video.drawing.table_plan import draw_table_plan


@cli.command("simulate")
def simulate_shot(
    shot: Annotated[Path, typer.Argument(metavar="SHOT.json")],
    out: Annotated[Path | None, cli.OUT] = None,
    profile: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    as_json: cli.JsonOption = False,
) -> None:
    """Simulate a shot from its initial state: trajectory.csv (m, m/s, rad/s), events.csv and a plan of the table.

    Args:
        shot: Table, balls, effects and laws of the shot.
        out: Folder of the results. Default: out/<shot>.
        profile: Table profile of trueroll fit-table or diagnose: its cloth, cushions and noses replace effects and laws
            of the shot.
    """
    wanted = read_shot_setup(shot)
    if profile is not None:
        wanted = place_on_learned_table(wanted, read_profile_text(profile))
    folder = out if out is not None else Path("out") / shot.stem
    require_writable_folder(folder)
    simulation = wanted.simulate()
    events, state = simulation.list_events(wanted.hz), simulation.to_state(wanted.times)
    ids = wanted.balls.ids
    naming = Naming(dict(zip(ids, describe_unseen_balls(ids, [name.split("-")[0] for name in ids]), strict=True)))
    write_states(ids, wanted.times, state, folder / "trajectory.csv")
    write_events(events, folder / "events.csv")
    met = np.array([kind in ("ball", "cushion") for kind in events.kind], dtype=bool)
    title = f"{wanted.seconds:g} s, {met.sum()} contacts"
    plan = draw_table_plan(wanted.table, naming, ids, list(np.moveaxis(state.xy, 1, 0)), events.xy[met], title)
    write_image(plan, folder / "plan.png")
    rows = [(f"{events.t[k]:.6f} s", name_event(events, k, naming)) for k in range(len(events))]
    event_values = [
        {"kind": events.kind[k], "t": float(events.t[k]), "a": events.a[k], "b": events.b[k]}
        for k in range(len(events))
    ]
    answer = Answer(
        f"What happens in {shot.name}?",
        _describe_end(wanted, naming, state) if rows else ("Nothing moves in this shot.",),
        rows=(("time", "what"), *rows) if rows else (),
        document={"folder": str(folder), "events": event_values},
        figures=(str(folder / "plan.png"), str(folder / "trajectory.csv")),
    )
    cli.print_answer(answer, as_json)


def _describe_end(shot: ShotSetup, naming: Naming, state: State) -> tuple[str, ...]:
    """Say which balls still move when the simulation ends; nothing where all rest."""
    moving = [naming.say(ball) for k, ball in enumerate(shot.balls.ids) if np.hypot(*state.v[-1, k]) > 0]
    verb = f"still move{'s' * (len(moving) == 1)}"
    return tuple([start_sentence(f"{join_names(moving)} {verb} at the limit of {shot.seconds:g} s.")] * bool(moving))
