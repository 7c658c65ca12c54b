"""Where the gap shows: shares of what is systematic by phase, whom it concerns, and with what it grows."""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from diagnosis.fitting.fit_residuals import Residuals
from diagnosis.fitting.names import direction, group
from diagnosis.fitting.residual_blocks import Structure
from diagnosis.verdicts.verdict import Place
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Recording

_MOSTLY = 0.7
"""share of a phase's gap from which one ball or shot is named."""
_GROWS = 0.7
"""rank correlation of the gap with a number, over bins of it."""
_BINS = 8
OF_CAMERA = frozenset({"image_region", "time_jump"})
"""where causes act that are no motion's: whatever moves shows them."""


def places(found: Residuals, pieces: tuple[Recording, ...], phases: frozenset[str]) -> tuple[Place, ...]:
    """By phase, largest first, shares adding to 1; only `phases` where it is known in which the cause acts."""
    left = excess(found)
    if phases and phases <= OF_CAMERA:
        everything = np.ones(len(left), bool)
        return tuple(_place(found, left, pieces, name, 1 / len(phases), everything) for name in sorted(phases))
    allowed = (
        np.isin(found.phase, sorted(phases & set(found.phase))) if phases & set(found.phase) else found.phase != ""
    )
    names = np.unique(found.phase[allowed])
    totals = np.array([max(float(left[allowed & (found.phase == name)].sum()), 0.0) for name in names])
    if not len(names):
        return ()
    if totals.sum() == 0:
        totals = np.array([float((found.phase == name).sum()) for name in names])
    order = np.argsort(-totals)
    shares = totals / totals.sum()
    return tuple(_place(found, left, pieces, str(names[k]), float(shares[k]), found.phase == names[k]) for k in order)


def excess(found: Residuals) -> FloatArray:
    """(K,) squares beyond what noise leaves after the same fit."""
    return np.asarray(np.square(found.left * found.size).sum(axis=1) - np.square(found.drawn).mean(axis=2).sum(axis=1))


def _place(
    found: Residuals, left: FloatArray, pieces: tuple[Recording, ...], phase: str, share: float, here: BoolArray
) -> Place:
    # by name: recordings of several films do not hold the same bodies in the same order
    bodies = np.array([pieces[k].bodies[body] for k, body in zip(found.window, found.body, strict=True)])
    ball, shot = _mostly(left, bodies, here), _mostly(left, found.shot, here)
    return Place(
        phase=phase,
        share=share,
        ball=None if ball is None else str(ball),
        shot=None if shot is None else int(shot),
        span=None,
        region=None,
        grows_with=_grows_with(found, left, here),
    )


def _mostly(left: FloatArray, values: np.ndarray, here: np.ndarray) -> np.generic | None:
    """The one value, of at least three, that holds most of the gap in these observations."""
    known = np.unique(values[here])
    sums = np.array([max(float(left[here & (values == n)].sum()), 0.0) for n in known])
    if len(known) < 3 or sums.sum() <= 0 or sums.max() < _MOSTLY * sums.sum():
        return None
    return np.asarray(known)[int(np.argmax(sums))]  # type: ignore[no-any-return]


def _grows_with(found: Residuals, left: FloatArray, here: np.ndarray) -> str | None:
    """The number with which the gap grows most evenly."""
    numbers = {"time": found.t, "speed": found.speed, "time since contact": found.since_contact}
    if found.image is not None:
        numbers["radius"] = np.linalg.norm(found.image, axis=1)
    best, name = _GROWS, None
    for label, values in numbers.items():
        known = here & np.isfinite(values)
        if known.sum() < 10 * _BINS or np.ptp(values[known]) == 0:
            continue
        order = np.flatnonzero(known)[np.argsort(values[known], kind="stable")]
        means = [float(left[part].mean()) for part in np.array_split(order, _BINS)]
        rank = float(spearmanr(np.arange(_BINS), means).statistic) if np.ptp(means) > 0 else 0.0
        if rank > best:
            best, name = rank, label
    return name


def shape(found: Structure) -> str:
    """What stands out, in words."""
    told = [_told(one.block.family, one.block.label, one.direction, one.z) for one in found.findings if one.z > 4]
    return "; ".join(told[:3])


def _told(family: str, label: str, way: str, z: float) -> str:
    place = label if family == "slow" else group(family, label)
    return f"{direction(way)} {place} ({z:.0f} times what chance does)"
