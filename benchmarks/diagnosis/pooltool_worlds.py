"""Shots that pooltool plays, on tables that its user's pooltool is not; runs in the environment of the rival.

A slope is a push of all balls every `SLICE` s: pooltool has none. All else is pooltool's own.
"""

from __future__ import annotations

import numpy as np

SLICE = 0.01


def play_shots(
    states: np.ndarray, t: np.ndarray, size: np.ndarray, cushion: np.ndarray, friction: np.ndarray,
    params: np.ndarray, slope: np.ndarray,
) -> dict[str, np.ndarray]:  # fmt: skip
    """Play shots.

    Args:
        states: (S, N, 4) x, y, vx, vy of all balls.
        t: (T,) s.
        size: Length and width, m, and height of the nose over the radius.
        cushion: Name of the cushion model.
        friction: Name of the friction model of balls.
        params: u_s, u_r, u_sp_proportionality, u_b, e_b, e_c, f_c.
        slope: (2,) fall along x and y, m/m.

    Returns:
        `xy` (S, T, N, 2) m; NaN where pooltool fails.
    """
    from pooltool.evolution.event_based.simulate import simulate
    from pooltool.objects.ball.datatypes import Ball, BallState
    from pooltool.objects.ball.params import BallParams
    from pooltool.objects.cue.datatypes import Cue
    from pooltool.objects.table.datatypes import Table
    from pooltool.objects.table.specs import BilliardTableSpecs
    from pooltool.physics.engine import PhysicsEngine
    from pooltool.physics.evolve import evolve_ball_motion
    from pooltool.physics.resolve import Resolver
    from pooltool.physics.resolve.ball_ball.friction import ball_ball_friction_models
    from pooltool.physics.resolve.ball_ball.frictional_inelastic import FrictionalInelastic
    from pooltool.physics.resolve.ball_cushion import ball_lcushion_models
    from pooltool.system.datatypes import System

    ball_params = BallParams(0.17, 0.028575, *map(float, params))
    length, width, height = map(float, size)
    table = Table.from_table_specs(BilliardTableSpecs(l=length, w=width, cushion_height=height * ball_params.R))
    resolver = Resolver.default()
    resolver.ball_linear_cushion = ball_lcushion_models[str(cushion)]()
    resolver.ball_ball = FrictionalInelastic(friction=ball_ball_friction_models[str(friction)]())
    engine = PhysicsEngine(resolver=resolver)
    # a turn of our axes: x along pooltool's y
    push = 9.81 * np.array([-slope[1], slope[0], 0.0])
    step = SLICE if slope.any() else float(t[-1]) + SLICE

    def move(one, seconds):
        return evolve_ball_motion(one.s, one.rvw, ball_params.R, ball_params.m, ball_params.u_s, ball_params.u_sp,
                                  ball_params.u_r, ball_params.g, seconds)  # fmt: skip

    places = np.empty((len(states), len(t), states.shape[1], 2))
    for shot, path in zip(states, places, strict=True):
        now = []
        for x, y, vx, vy in shot:
            rvw = np.zeros((3, 3))
            rvw[0], rvw[1, :2] = (width - y, x, ball_params.R), (-vy, vx)
            now.append(rvw)
        for begin in np.arange(0.0, t[-1] + step, step):
            balls = {}
            for k, rvw in enumerate(now):
                ball = Ball(id=str(k), params=ball_params)
                moves = np.hypot(*rvw[1, :2]) > 1e-3
                rvw[1] += push * step * moves
                ball.state = BallState(rvw, 2 if moves else 0, 0.0)
                balls[ball.id] = ball
            system = System(cue=Cue(cue_ball_id="0"), table=table, balls=balls)
            try:
                simulate(system, engine=engine, inplace=True, t_final=step)
            except ValueError:
                path[:] = np.nan
                break
            rows = np.flatnonzero((t >= begin - 1e-12) & (t < begin + step - 1e-12))
            for k, ball in enumerate(balls.values()):
                history = list(ball.history)

                def at(seconds, history=history):
                    one = [state for state in history if state.t <= seconds + 1e-15][-1]
                    return move(one, seconds - one.t)[0]

                for row in rows:
                    rvw = at(max(t[row] - begin, 0.0))
                    path[row, k] = rvw[0, 1], width - rvw[0, 0]
                now[k] = at(step)
    return {"xy": places}
