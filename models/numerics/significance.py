"""Significance of the best of several choices."""

from __future__ import annotations

import numpy as np


def correct_for_choices(p_value: float, count: float) -> float:
    """Return the probability that the best of `count` independent choices is as improbable by chance.

    Args:
        p_value: p-value of the best choice alone.
        count: Number of choices, or of independent ones that they are worth.

    Returns:
        The corrected p-value (Sidak 1967, doi:10.1080/01621459.1967.10482935).
    """
    return -float(np.expm1(count * np.log1p(-min(p_value, 1 - 1e-16))))
