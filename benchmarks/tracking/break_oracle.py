"""Best possible fit of a break: our model, given the true contact graph, true identities and true initial states.

The oracle starts after the first 50 ms, with the true order and the true balls of all contacts; it refines all states,
times and coefficients on the same noisy detections and with the same soft constraints as the fit. The graph of a ball
begins with its last contact in the first 50 ms. Contacts that close slower than 5 mm/s are left out. The errors without
noise are the difference between the contact models of the fit and of the simulator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.tracking.break_shots import BALLS, HZ, PX_PER_M, Break, FilmedBreak, R, overhead_scene
from models.core.contact_graph import Contact, ContactGraph, ContactKind, Segment
from models.core.fit_result import Fit
from models.core.options import FitOptions
from models.core.scene import Scene
from models.core.shot import Shot
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import collect_observations
from models.estimation.joint_fit.joint_refinement import add_covariance, condition_on_contact_times, refine_graph
from models.estimation.reconstruction.contact_times import list_gaps, refine_contact_times
from models.estimation.reconstruction.explain_shot import list_close_passes, whiten_observed
from models.estimation.reconstruction.shot_views import view_shot
from models.estimation.structure_search.contact_partners import collect_hypotheses
from models.estimation.structure_search.structure_trials import StructureSearch

# Slower contacts change nothing visible, m/s of closing speed.
SLOWEST_CLOSING = 0.005
# Least time between contacts of a ball, and the largest delay of a contact for it, s.
APART, LATEST = 2e-4, 1e-3
# Speed below which a ball rests, m/s.
STILL_SPEED = 1e-4


@dataclass(slots=True)
class _GraphBuilder:
    """A growing contact graph, with the last segment of each ball."""

    segments: list[Segment]
    contacts: list[Contact]
    last: list[int]

    def add_contact(self, kind: str, t: float, balls: list[int], states: list[FloatArray], cushion: str) -> None:
        number, before, after = len(self.contacts), tuple(self.last[ball] for ball in balls), []
        for ball, state in zip(balls, states, strict=True):
            self.segments[self.last[ball]] = replace(self.segments[self.last[ball]], end=number)
            self.last[ball] = len(self.segments)
            after.append(self.last[ball])
            self.segments.append(Segment(ball, False, number, None, t, state))
        contact_kind: ContactKind = "ball" if kind == "ball" else "cushion"
        self.contacts.append(Contact(contact_kind, t, before, tuple(after), cushion, gain=100.0))


def fit_oracle(shown: Break, filmed: FilmedBreak, delay: float) -> tuple[Fit, Tracks]:
    """Fit the true contact graph from `delay` s after the first ball contact; returns the fit and its tracks."""
    first = float(shown.t[shown.kind == "ball"].min()) + delay
    begin = np.full(BALLS, -np.inf)
    for e in np.flatnonzero(shown.t <= first).tolist():
        for ball in _balls_of(shown, e):
            begin[ball] = max(begin[ball], shown.t[e])
    tracks = build_true_tracks(filmed, begin + filmed.strike)
    return view_shot(
        explain_graph(build_true_graph(shown, filmed, begin, first), tracks, overhead_scene(False))
    ), tracks


def explain_graph(graph: ContactGraph, tracks: Tracks, scene: Scene) -> Shot:
    """Explain a recording by a known contact graph: states, times and coefficients are fitted, its contacts stay.

    The tracks' sigmas are used as they are; samples before the first segment of a ball must be left out.

    Args:
        graph: The contact graph.
        tracks: Tracks of N balls over T frames, at capture times.
        scene: Table and camera.

    Returns:
        The shot.
    """
    observations = collect_observations(tracks)
    solution = add_covariance(refine_graph(graph, observations, scene.table, iterations=60), observations, scene.table)
    tests = refine_contact_times(solution, observations, scene)
    times = {number: (one.t, one.t_sigma) for number, one in tests.items()}
    solution = condition_on_contact_times(solution, times, observations, scene.table)
    clock = CaptureClock(tracks.t, tracks.t, np.zeros(len(tracks.t)))
    hypotheses = collect_hypotheses(solution, StructureSearch(observations, scene.table, (0.0, 0.0)))
    shot = Shot(
        scene,
        tracks,
        clock,
        whiten_observed(tracks),
        solution,
        hypotheses=hypotheses,
        gaps=list_gaps(solution, tests),
        moving_speed=FitOptions().moving_speed,
    )
    return replace(shot, passes=list_close_passes(shot))


def build_true_tracks(filmed: FilmedBreak, begin: FloatArray) -> Tracks:
    """Build tracks from the detections with true identities, of each ball from `begin` (N,) s on."""
    detections, many = filmed.detections, (len(filmed.t), BALLS)
    px, xy = np.full((*many, 2), np.nan), np.full((*many, 2), np.nan)
    px[detections.frame, filmed.ball] = detections.centre
    xy[detections.frame, filmed.ball] = overhead_scene(False).camera.to_table(detections.centre, R)
    xy[filmed.t[:, None] < begin] = np.nan
    is_observed = np.isfinite(xy[..., 0])
    sigma, radius = np.where(is_observed, 1 / PX_PER_M, np.nan), np.where(is_observed, R * PX_PER_M, np.nan)
    return Tracks(
        filmed.frame, filmed.t, tuple(map(str, range(BALLS))), ("ball",) * BALLS, xy, px, sigma, sigma.copy(),
        np.zeros_like(xy), radius, np.zeros((BALLS, 3)),
    )  # fmt: skip


def true_owners(filmed: FilmedBreak) -> NDArray[np.int64]:
    """Return the true ball (T, N) of every detection in these tracks; -1 where there is none."""
    owner = np.full((len(filmed.t), BALLS), -1)
    owner[filmed.detections.frame, filmed.ball] = filmed.ball
    return owner


def build_true_graph(shown: Break, filmed: FilmedBreak, begin: FloatArray, first: float) -> ContactGraph:
    """Build segments and contacts after `first` s of the simulation; balls start at `begin` (N,), or with the clip."""
    starts = np.where(np.isfinite(begin), begin, min(float(filmed.t[0]) - filmed.strike, 0.0))
    builder = _GraphBuilder([], [], list(range(BALLS)))
    for ball in range(BALLS):
        state = _state_after(shown, ball, max(starts[ball], 0.0))
        still = bool(np.hypot(*state[2:4]) < STILL_SPEED)
        builder.segments.append(Segment(ball, still, None, None, starts[ball] + filmed.strike, state))
    ends = float(filmed.t[-1]) - filmed.strike
    met = begin.copy()
    for e in np.argsort(shown.t).tolist():
        balls = _balls_of(shown, e)
        t = max(float(shown.t[e]), *(float(met[ball]) + APART for ball in balls))
        if shown.t[e] <= first or t > ends or shown.speed[e] < SLOWEST_CLOSING or t - shown.t[e] > LATEST:
            continue
        met[balls] = t
        cushion = "" if shown.kind[e] == "ball" else str(shown.b[e])
        states = [_state_after(shown, ball, t) for ball in balls]
        builder.add_contact(str(shown.kind[e]), t + filmed.strike, balls, states, cushion)
    return ContactGraph(tuple(builder.segments), tuple(builder.contacts))


def _balls_of(shown: Break, e: int) -> list[int]:
    return [int(shown.a[e]), int(shown.b[e])] if shown.kind[e] == "ball" else [int(shown.a[e])]


def _state_after(shown: Break, ball: int, t: float) -> FloatArray:
    """Return the state (8,) of a ball just after t, extrapolated back from the next sample."""
    sample = min(int(np.ceil(t * HZ + 1e-6)), len(shown.xy) - 1)
    v = shown.v[sample, ball]
    x = shown.xy[sample, ball] - (sample / HZ - t) * v
    return np.concatenate([x, v, shown.slip[sample, ball], np.zeros(2)])
