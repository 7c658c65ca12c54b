"""The side of pooltool: a script that simulates shots in the Python that has pooltool, for another process.

It prints what its models are, and then answers each line with one line, both JSON. Our x is along the table, pooltool's
y; a quarter turn keeps the signs of all spins. It imports nothing of trueroll, whose packages that Python may lack.
"""

import json
import os
import sys
from typing import Any

import numpy as np

# m/s: slip above which a ball slides, and speed below which it rests.
_SLIP, _REST = 1e-9, 1e-12
# Events of a shot at most: balls that touch may meet without end.
_MOST_EVENTS = 1000


def describe_models() -> dict[str, Any]:
    """Describe pooltool as its user has set it up: version, contact models, ball and table."""
    from importlib.metadata import version

    from pooltool.objects.ball.params import BallParams
    from pooltool.objects.table.specs import BilliardTableSpecs
    from pooltool.physics.resolve import Resolver

    resolver, ball = Resolver.default(), BallParams()
    names = ("u_s", "u_r", "u_sp_proportionality", "u_b", "e_b", "e_c", "f_c")
    return {
        "version": version("pooltool-billiards"),
        "cushion": str(resolver.ball_linear_cushion.model),
        "ball": str(resolver.ball_ball.model),
        "friction": str(getattr(getattr(resolver.ball_ball, "friction", None), "model", "")),
        "params": {name: float(getattr(ball, name)) for name in names},
        "cushion_height": float(BilliardTableSpecs().cushion_height) / ball.R,
    }


def simulate_shot(request: dict[str, Any]) -> list[list[list[float]]]:
    """Simulate a shot.

    Args:
        request: `states` (N, 7) x, y, vx, vy, wx, wy, wz of our frame, `t` (T,) s in order, `params` of a ball, `table`
            with l, w and cushion_height, and `resolver`: changed models, each with its options.

    Returns:
        Places (T, N, 2) in our frame.
    """
    from pooltool.evolution.event_based.simulate import simulate
    from pooltool.objects.ball.datatypes import Ball, BallState
    from pooltool.objects.ball.params import BallParams
    from pooltool.objects.cue.datatypes import Cue
    from pooltool.objects.table.datatypes import Table
    from pooltool.objects.table.specs import BilliardTableSpecs
    from pooltool.physics.evolve import evolve_ball_motion
    from pooltool.system.datatypes import System

    params, width = BallParams(**request["params"]), request["table"]["w"]
    balls = {}
    for k, (x, y, vx, vy, wx, wy, wz) in enumerate(request["states"]):
        ball = Ball(id=str(k), params=params)
        rvw = np.array([[width - y, x, params.R], [-vy, vx, 0.0], [-wy, wx, wz]])
        ball.state = BallState(rvw, _find_motion(rvw, params.R), 0.0)
        balls[ball.id] = ball
    table = Table.from_table_specs(BilliardTableSpecs(**request["table"]))
    system = System(cue=Cue(cue_ball_id="0"), table=table, balls=balls)
    engine, t = _build_engine(json.dumps(request["resolver"])), request["t"]
    end = max(t[-1], 1e-3)
    simulate(system, engine=engine, inplace=True, t_final=end, max_events=_MOST_EVENTS)
    if system.t < end and len(system.events) > _MOST_EVENTS:
        raise RuntimeError("the balls touch without end")
    places = np.empty((len(t), len(balls), 2))
    for k, ball in enumerate(balls.values()):
        states = list(ball.history)
        rows = np.maximum(np.searchsorted([one.t for one in states], t, "right") - 1, 0)
        for row, at, place in zip(rows, t, places[:, k], strict=True):
            one = states[row]
            rvw, _ = evolve_ball_motion(
                one.s, one.rvw, params.R, params.m, params.u_s, params.u_sp, params.u_r, params.g, max(at - one.t, 0.0)
            )
            place[:] = rvw[0, 1], width - rvw[0, 0]
    return places.tolist()


def _find_motion(rvw: np.ndarray, radius: float) -> int:
    """Find the number of pooltool for what a ball does: 0 rests, 1 spins, 2 slides, 3 rolls."""
    v, w = rvw[1], rvw[2]
    if np.hypot(v[0] - radius * w[1], v[1] + radius * w[0]) > _SLIP:
        return 2
    if np.hypot(v[0], v[1]) > _REST:
        return 3
    return 1 if abs(w[2]) * radius > _REST else 0


_ENGINES: dict[str, Any] = {}


def _build_engine(changes: str) -> Any:
    """Build the engine of the user with other models where a request names them, once each."""
    from pooltool.physics.engine import PhysicsEngine
    from pooltool.physics.resolve import Resolver
    from pooltool.physics.resolve.ball_ball import ball_ball_models
    from pooltool.physics.resolve.ball_ball.friction import ball_ball_friction_models
    from pooltool.physics.resolve.ball_cushion import ball_lcushion_models

    if changes not in _ENGINES:
        resolver, wanted = Resolver.default(), json.loads(changes)
        if "cushion" in wanted:
            resolver.ball_linear_cushion = ball_lcushion_models[wanted["cushion"]](**wanted["cushion_options"])
        if "ball" in wanted:
            friction = wanted["friction"]
            own = {"friction": ball_ball_friction_models[friction]()} if friction else {}
            resolver.ball_ball = ball_ball_models[wanted["ball"]](**own)
        _ENGINES[changes] = PhysicsEngine(resolver=resolver)
    return _ENGINES[changes]


def main() -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what pooltool prints is no answer
    print(json.dumps(describe_models()), file=answers, flush=True)
    for line in sys.stdin:
        try:
            answer: dict[str, Any] = {"xy": simulate_shot(json.loads(line))}
        except Exception as error:  # whatever pooltool cannot simulate
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
