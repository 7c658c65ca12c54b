"""Whether to believe a fit: span by span, and one light for the clip."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Light, Trust
from models.core.typing import FloatArray
from models.estimation.joint_fit.fit_solution import Data, Solution, owners, residuals

WORST_CHI2 = 4.0
"""per degree of freedom of a span, against the noise that the samples themselves show."""
BLUR, UNEVEN = 0.5, 0.02
"""px and ball radii, in quadrature: a misfit that a picture cannot tell from right is accepted whatever its chi2.
Random noise may be a twentieth of a pixel, yet texture, dark limbs, lens and homography shift balls by up to half a
pixel over longer ways, and no cloth is even to half a millimetre: slow balls curl, and settle back into their dent."""
TREMBLE = 0.25
"""ball radii: no ball goes to and fro by itself, so that one which is seen so near to one place rests there."""
WORST_MISS = 0.7
"""ball radii: a path that misses its samples by more explains nothing, however noisy they are."""
GREEN_SHARE, AMBER_SHARE = 0.9, 0.6
"""of the moving time that accepted fits explain."""


def span_chi2(solution: Solution, data: Data) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Robust chi2 per number of each span (S,), its RMS residual in m (S,), and its samples (S,)."""
    story = solution.story
    miss = residuals(solution, data)
    whitened = np.einsum("kij,kj->ki", data.whiten, miss)
    owner = owners(story, data)
    chi2, rms = np.full(len(story.spans), np.nan), np.full(len(story.spans), np.nan)
    count = np.bincount(owner, minlength=len(story.spans))
    for k in np.flatnonzero(count):
        size = (whitened[owner == k] ** 2).sum(axis=1)
        free = 2.0 if story.spans[k].static else 4.0
        trimmed = np.minimum(size, 25.0).sum()  # single outliers do not condemn a span
        chi2[k] = trimmed / max(2 * count[k] - free, count[k])
        rms[k] = np.sqrt((miss[owner == k] ** 2).sum(axis=1).mean() / 2)
    return chi2, rms, count


def accepted_spans(solution: Solution, data: Data, radius: float, pixel: float) -> NDArray[np.bool_]:
    """(S,) which spans the physics explains; `pixel` is what a pixel shows, m.

    A span that nobody saw is believed where both neighbours are.
    """
    chi2, rms, count = span_chi2(solution, data)
    static = np.array([span.static for span in solution.story.spans], dtype=bool)
    floor = np.where(static, TREMBLE * radius, np.hypot(BLUR * pixel, UNEVEN * radius))
    good = ((chi2 < WORST_CHI2) | (rms < floor)) & (rms < WORST_MISS * radius)
    story = solution.story
    for k in np.flatnonzero(count == 0):
        span = story.spans[k]
        near = [other for c in (span.start, span.end) if c is not None for other in _neighbours(solution, c, span.ball)]
        known = [other for other in near if other != k and count[other] > 0]
        good[k] = bool(known) and all(bool(good[other]) for other in known)
    accepted: NDArray[np.bool_] = good
    return accepted


def light(share: float, chi2: float, moving_seconds: float, notes: list[str]) -> Trust:
    """The light of a clip from the share of moving time explained, chi2 per degree of freedom, and other doubts."""
    if moving_seconds == 0:
        return Trust("green", ("No ball moves.",)) if not notes else Trust("amber", ("No ball moves.", *notes))
    reasons = [f"An accepted fit explains {share:.0%} of the time that balls move."]
    if np.isfinite(chi2) and chi2 > 2:
        reasons.append(f"Residuals exceed the stated errors: chi2 per degree of freedom is {chi2:.1f}.")
    colour: Light = "green"
    if share < AMBER_SHARE:
        colour = "red"
    elif share < GREEN_SHARE or (np.isfinite(chi2) and chi2 > 3) or notes:
        colour = "amber"
    return Trust(colour, (*reasons, *notes))


def with_doubts(trust: Trust, doubts: tuple[str, ...]) -> Trust:
    """The same light with what else may be wrong, such as the size of the table; green no longer."""
    if not doubts:
        return trust
    return Trust("amber" if trust.light == "green" else trust.light, (*trust.reasons, *doubts))


def _neighbours(solution: Solution, contact: int, ball: int) -> list[int]:
    c = solution.story.contacts[contact]
    return [k for k in (*c.before, *c.after) if solution.story.spans[k].ball == ball]
