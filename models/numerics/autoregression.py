"""First-order autoregression of noise: what remains of values beyond what their predecessors predict."""

from __future__ import annotations

import numpy as np

from models.numerics.jit import compile_kernel


@compile_kernel
def whiten_series(values, previous, correlation, scale):  # type: ignore[no-untyped-def]
    """Subtract from values what the previous ones predict, and scale the rest.

    Args:
        values: (K, M) values.
        previous: (K,) index of the previous value.
        correlation: (K,) correlation with it.
        scale: (K,) factor on the rest.

    Returns:
        (K, M) whitened values.
    """
    whitened = np.empty(values.shape)
    for k in range(len(values)):
        before = previous[k]
        for m in range(values.shape[1]):
            whitened[k, m] = (values[k, m] - correlation[k] * values[before, m]) * scale[k]
    return whitened
