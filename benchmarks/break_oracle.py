"""What the pictures of a break hold at best: our own model told the true story, identities and states to begin from.

After the burst the oracle knows which ball meets what and in which order; it refines all states, times and coefficients
on the same noisy sightings and with the same soft laws as the fit. A ball's story begins with its last contact of the
burst. Contacts that close slower than 5 mm/s are left out. What it misses without noise is the difference between its
laws and the world's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from break_shots import BALLS, HZ, PX_PER_M, Break, Filmed, R, scene
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.reconstruction.fit_shot import fit_story
from models.estimation.segmentation.contact_graph import Contact, ContactKind, Span, Story

SLOWEST = 0.005
"""m/s of closing: slower contacts change nothing that a picture shows."""
APART, LATEST = 2e-4, 1e-3
"""s: contacts of a ball begin so far apart; one that would have to wait longer for that is left out."""
STILL = 1e-4
"""m/s."""


@dataclass(slots=True)
class _Telling:
    """A story as it grows, and the last span of each ball."""

    spans: list[Span]
    contacts: list[Contact]
    last: list[int]

    def meet(self, kind: str, t: float, balls: list[int], states: list[FloatArray], cushion: str) -> None:
        number, before, after = len(self.contacts), tuple(self.last[ball] for ball in balls), []
        for ball, state in zip(balls, states, strict=True):
            self.spans[self.last[ball]] = replace(self.spans[self.last[ball]], end=number)
            self.last[ball] = len(self.spans)
            after.append(self.last[ball])
            self.spans.append(Span(ball, False, number, None, t, state))
        told: ContactKind = "ball" if kind == "ball" else "cushion"
        self.contacts.append(Contact(told, t, before, tuple(after), cushion, gain=100.0))


def oracle(shown: Break, filmed: Filmed, burst: float) -> tuple[Fit, Tracks]:
    """The fit of the true story from `burst` s after the first contact of balls on, and the tracks that it saw."""
    first = float(shown.t[shown.kind == "ball"].min()) + burst
    begin = np.full(BALLS, -np.inf)
    for e in np.flatnonzero(shown.t <= first).tolist():
        for ball in _balls(shown, e):
            begin[ball] = max(begin[ball], shown.t[e])
    tracks = true_tracks(filmed, begin + filmed.strike)
    return fit_story(true_story(shown, filmed, begin, first), tracks, scene(False)), tracks


def true_tracks(filmed: Filmed, begin: FloatArray) -> Tracks:
    """Sightings under their true names, of each ball from `begin` (N,) s of the film on."""
    seen, many = filmed.detections, (len(filmed.t), BALLS)
    px, xy = np.full((*many, 2), np.nan), np.full((*many, 2), np.nan)
    px[seen.frame, filmed.ball] = seen.centre
    xy[seen.frame, filmed.ball] = scene(False).camera.to_table(seen.centre, R)
    xy[filmed.t[:, None] < begin] = np.nan
    known = np.isfinite(xy[..., 0])
    sigma, radius = np.where(known, 1 / PX_PER_M, np.nan), np.where(known, R * PX_PER_M, np.nan)
    return Tracks(
        filmed.frame, filmed.t, tuple(map(str, range(BALLS))), ("ball",) * BALLS, xy, px, sigma, sigma.copy(),
        np.zeros_like(xy), radius, np.zeros((BALLS, 3)),
    )  # fmt: skip


def owners(filmed: Filmed) -> NDArray[np.int64]:
    """Which true ball (T, N) each sighting of these tracks is; -1 where it has none."""
    owner = np.full((len(filmed.t), BALLS), -1)
    owner[filmed.detections.frame, filmed.ball] = filmed.ball
    return owner


def true_story(shown: Break, filmed: Filmed, begin: FloatArray, first: float) -> Story:
    """Spans and contacts later than `first`, in s of the world; balls start at `begin` (N,), or as the film does."""
    starts = np.where(np.isfinite(begin), begin, min(float(filmed.t[0]) - filmed.strike, 0.0))
    telling = _Telling([], [], list(range(BALLS)))
    for ball in range(BALLS):
        state = _state(shown, ball, max(starts[ball], 0.0))
        still = bool(np.hypot(*state[2:4]) < STILL)
        telling.spans.append(Span(ball, still, None, None, starts[ball] + filmed.strike, state))
    ends = float(filmed.t[-1]) - filmed.strike
    met = begin.copy()
    for e in np.argsort(shown.t).tolist():
        balls = _balls(shown, e)
        t = max(float(shown.t[e]), *(float(met[ball]) + APART for ball in balls))
        if shown.t[e] <= first or t > ends or shown.speed[e] < SLOWEST or t - shown.t[e] > LATEST:
            continue
        met[balls] = t
        cushion = "" if shown.kind[e] == "ball" else str(shown.b[e])
        states = [_state(shown, ball, t) for ball in balls]
        telling.meet(str(shown.kind[e]), t + filmed.strike, balls, states, cushion)
    return Story(tuple(telling.spans), tuple(telling.contacts))


def _balls(shown: Break, e: int) -> list[int]:
    return [int(shown.a[e]), int(shown.b[e])] if shown.kind[e] == "ball" else [int(shown.a[e])]


def _state(shown: Break, ball: int, t: float) -> FloatArray:
    """(8,) of a ball just after t, s of the world: as the next sample has it, moved back."""
    sample = min(int(np.ceil(t * HZ + 1e-6)), len(shown.xy) - 1)
    v = shown.v[sample, ball]
    x = shown.xy[sample, ball] - (sample / HZ - t) * v
    return np.concatenate([x, v, shown.slip[sample, ball], np.zeros(2)])
