"""Localisation of the gap: shares by phase, the ball or shot concerned, and the variable with which it grows."""

from __future__ import annotations

import numpy as np
from scipy.stats import spearmanr

from diagnosis.fitting.display_names import format_direction, format_group
from diagnosis.fitting.fit_residuals import FitResiduals
from diagnosis.fitting.residual_structure import GroupFinding, ResidualStructure
from diagnosis.verdicts.verdict import GapLocation
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import BoolArray, FloatArray

# Share of a phase's gap from which one ball or shot is named.
_DOMINANT_SHARE = 0.7
# Rank correlation of the gap with a variable, over bins of it, from which it grows with the variable.
_MIN_RANK_CORRELATION = 0.7
# Number of bins of a variable.
_BINS = 8
# Phases of causes in the camera, which affect whatever moves.
CAMERA_PHASES = frozenset({"image_region", "time_jump"})


def localise_gap(
    residuals: FitResiduals, segments: tuple[Recording, ...], phases: frozenset[str]
) -> tuple[GapLocation, ...]:
    """Locate the gap by phase, largest share first, with shares that add to 1.

    Args:
        residuals: Residuals of the simulator's fit.
        segments: Segment of each window.
        phases: Phases in which the cause acts; empty where it is unknown.

    Returns:
        One location per phase.
    """
    left = excess_squares(residuals)
    if phases and phases <= CAMERA_PHASES:
        everything = np.ones(len(left), bool)
        return tuple(
            _localise_phase(residuals, left, segments, name, 1 / len(phases), everything) for name in sorted(phases)
        )
    allowed = (
        np.isin(residuals.phase, sorted(phases & set(residuals.phase)))
        if phases & set(residuals.phase)
        else residuals.phase != ""
    )
    names = np.unique(residuals.phase[allowed])
    totals = np.array([max(float(left[allowed & (residuals.phase == name)].sum()), 0.0) for name in names])
    if not len(names):
        return ()
    if totals.sum() == 0:
        totals = np.array([float((residuals.phase == name).sum()) for name in names])
    order = np.argsort(-totals)
    shares = totals / totals.sum()
    return tuple(
        _localise_phase(residuals, left, segments, str(names[k]), float(shares[k]), residuals.phase == names[k])
        for k in order
    )


def excess_squares(residuals: FitResiduals) -> FloatArray:
    """Return the squared residuals (K,) beyond those of noise projected through the same fit."""
    return np.asarray(
        np.square(residuals.values * residuals.scale).sum(axis=1)
        - np.square(residuals.noise_draws).mean(axis=2).sum(axis=1)
    )


def _localise_phase(
    residuals: FitResiduals,
    left: FloatArray,
    segments: tuple[Recording, ...],
    phase: str,
    share: float,
    here: BoolArray,
) -> GapLocation:
    # by name: bodies of several recordings differ and have another order
    """Describe the part of the gap in one phase."""
    bodies = np.array([segments[k].bodies[body] for k, body in zip(residuals.window, residuals.body, strict=True)])
    ball, shot = _find_dominant_value(left, bodies, here), _find_dominant_value(left, residuals.shot, here)
    return GapLocation(
        phase=phase,
        share=share,
        ball=None if ball is None else str(ball),
        shot=None if shot is None else int(shot),
        span=None,
        region=None,
        grows_with=_find_growth_variable(residuals, left, here),
    )


def _find_dominant_value(left: FloatArray, values: np.ndarray, here: np.ndarray) -> np.generic | None:
    """Find the one value, of at least three, that holds most of the gap in these observations."""
    candidates = np.unique(values[here])
    sums = np.array([max(float(left[here & (values == n)].sum()), 0.0) for n in candidates])
    if len(candidates) < 3 or sums.sum() <= 0 or sums.max() < _DOMINANT_SHARE * sums.sum():
        return None
    return np.asarray(candidates)[int(np.argmax(sums))]  # type: ignore[no-any-return]


def _find_growth_variable(residuals: FitResiduals, left: FloatArray, here: np.ndarray) -> str | None:
    """Find the variable with which the gap grows most monotonically."""
    numbers = {"time": residuals.t, "speed": residuals.speed, "time since contact": residuals.since_contact}
    if residuals.image is not None:
        numbers["radius"] = np.linalg.norm(residuals.image, axis=1)
    best, name = _MIN_RANK_CORRELATION, None
    for label, values in numbers.items():
        is_valid = here & np.isfinite(values)
        if is_valid.sum() < 10 * _BINS or np.ptp(values[is_valid]) == 0:
            continue
        order = np.flatnonzero(is_valid)[np.argsort(values[is_valid], kind="stable")]
        means = [float(left[part].mean()) for part in np.array_split(order, _BINS)]
        rank = float(spearmanr(np.arange(_BINS), means).statistic) if np.ptp(means) > 0 else 0.0
        if rank > best:
            best, name = rank, label
    return name


def describe_structure(structure: ResidualStructure, reference: ReferenceFrame) -> str:
    """Describe the largest findings in words."""
    return "; ".join([_describe_finding(one, reference) for one in structure.findings if one.z > 4][:3])


def _describe_finding(finding: GroupFinding, reference: ReferenceFrame) -> str:
    """Describe one finding in words."""
    group = finding.group
    place = group.label if group.family == "slow" else format_group(group.family, group.label, reference.unit)
    direction = format_direction(finding.direction, reference.coordinates)
    return f"{direction} {place} ({finding.z:.0f} standard deviations of noise)"
