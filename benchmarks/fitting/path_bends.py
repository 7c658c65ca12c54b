"""Bends of sampled paths: where a trajectory says that a ball met something, whatever the list of events says."""

from __future__ import annotations

import numpy as np

from models.core.events import Events
from models.core.typing import FloatArray

# Samples on either side of a contact: 8 ms at 1 kHz, over which a quadratic is a path to a few micrometres.
SAMPLES = 8
# s between the samples and the contact: first of the event, whose time may differ, then of the bend so found.
GUARDS = 6e-3, 1e-3
# s around the contact within which the bend is looked for.
HORIZON = 12e-3
# m/s: coordinates with six decimals show no smaller bend to a twentieth of a millisecond.
MIN_VELOCITY_CHANGE = 0.05


def measure_bends(events: Events, t: FloatArray, xy: FloatArray, ids: tuple[str, ...]) -> FloatArray:
    """Measure when paths bend at contacts, with no other knowledge than the sampled paths.

    Args:
        events: E events.
        t: (T,) s, of the samples, ascending.
        xy: (T, N, 2) m, paths of the balls.
        ids: Their ids.

    Returns:
        (E, 2) s: time of the bend of balls a and b minus that of the event; NaN for other events, for a ball that has
        another event within the samples, and where no bend can be measured.
    """
    bends = np.full((len(events), 2), np.nan)
    reach = max(GUARDS) + SAMPLES * float(np.median(np.diff(t)))
    for k in range(len(events)):
        for side, name in enumerate((events.a[k], events.b[k])):
            is_own = [name in pair for pair in zip(events.a, events.b, strict=True)]
            is_alone = np.sum(is_own & (np.abs(events.t - events.t[k]) < reach)) == 1
            if events.kind[k] in ("ball", "cushion") and name in ids and is_alone:
                bends[k, side] = _measure_bend(t, xy[:, ids.index(name)], float(events.t[k]))
    return bends


def _measure_bend(t: FloatArray, xy: FloatArray, moment: float) -> float:
    """Return when a path (T, 2) bends near `moment`, minus that, s: where its continuations are nearest."""
    bend, change = moment, np.inf
    for guard in GUARDS:
        before, after = np.flatnonzero(t < bend - guard)[-SAMPLES:], np.flatnonzero(t > bend + guard)[:SAMPLES]
        rows = np.concatenate([before, after])
        if len(rows) < 2 * SAMPLES or not np.isfinite(xy[rows]).all():
            return float("nan")
        difference = np.polyfit(t[after] - bend, xy[after], 2) - np.polyfit(t[before] - bend, xy[before], 2)
        tau = np.linspace(-HORIZON, HORIZON, 24001)
        least = float(tau[np.argmin(np.hypot(*(np.vander(tau, 3) @ difference).T))])
        change = float(np.hypot(*(2 * least * difference[0] + difference[1])))
        bend += least
    return bend - moment if change > MIN_VELOCITY_CHANGE else float("nan")
