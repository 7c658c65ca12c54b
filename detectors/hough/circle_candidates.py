"""Where discs of the expected size may be: every edge pixel votes for the centre one radius away from it.

Hough transform with a known radius (Duda and Hart 1972, doi:10.1145/361237.361242; the gradient gives the direction,
Kimme et al. 1975, doi:10.1145/360666.360677).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.working_view import View
from models.core.typing import BoolArray, Float32Array, FloatArray

LEAST_VOTES = 0.22
"""Share of a full circle's votes below which a peak is not looked at."""
MOST = 50
"""Candidates looked at per picture."""
EDGE_LEVELS = 10.0
"""Grey levels per working px above which a pixel is an edge."""
EDGE_THICKNESS_PX = 2.5
"""Pixels that vote for one centre across a sharp edge."""


def candidate_centres(contrast: Float32Array, foreground: BoolArray, view: View) -> tuple[FloatArray, FloatArray]:
    """Peaks of the votes: working px (n, 2) and share of a full circle's votes (n,), strongest first."""
    votes = _votes(contrast, foreground, view)
    window = 2 * int(max(1, round(0.45 * float(view.radius.min())))) + 1
    highest = cv2.dilate(votes, np.ones((window, window), np.uint8))
    peaks = (votes >= highest) & (votes > LEAST_VOTES) & view.centres
    y, x = np.nonzero(peaks)
    order = np.argsort(-votes[y, x], kind="stable")[:MOST]
    y, x = y[order], x[order]
    return np.column_stack([x, y]).astype(np.float64), votes[y, x].astype(np.float64)


def _votes(contrast: Float32Array, foreground: BoolArray, view: View) -> Float32Array:
    h, w = foreground.shape
    rows, gradient = _edges(contrast, foreground)
    strength = np.linalg.norm(gradient, axis=1)
    direction = gradient / strength[:, None]
    weight = np.minimum(strength / (3 * EDGE_LEVELS), 1.0)
    y, x = np.divmod(rows, w)
    radius = view.radius.ravel()[rows]
    votes = np.zeros(h * w)
    for side in (-1.0, 1.0):
        u = np.rint(x + side * radius * direction[:, 0]).astype(np.int64)
        v = np.rint(y + side * radius * direction[:, 1]).astype(np.int64)
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        votes += np.bincount(v[inside] * w + u[inside], weight[inside], minlength=h * w)
    return _spread(votes.reshape(h, w).astype(np.float32), view)


def _spread(votes: Float32Array, view: View) -> Float32Array:
    """Votes summed over their scatter, as a share of what a full circle gives."""
    sigma = 0.9 + 0.06 * view.typical
    blurred = cv2.GaussianBlur(votes, (0, 0), sigma)
    full = 2 * np.pi * view.radius * EDGE_THICKNESS_PX / (2 * np.pi * (sigma**2 + 0.6))
    return np.asarray(blurred / full, dtype=np.float32)


def _edges(contrast: Float32Array, foreground: BoolArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Edge pixels near the foreground: index (n,) into the flat picture, gradient (n, 2) of the strongest channel."""
    h, w = foreground.shape
    near = cv2.dilate(foreground.astype(np.uint8), np.ones((5, 5), np.uint8))
    near[[0, -1], :] = 0
    near[:, [0, -1]] = 0
    smooth = cv2.GaussianBlur(contrast, (0, 0), 0.8).reshape(h * w, 3)
    rows = np.flatnonzero(near.ravel())
    gx = 0.5 * (smooth[rows + 1] - smooth[rows - 1])
    gy = 0.5 * (smooth[rows + w] - smooth[rows - w])
    strength = gx**2 + gy**2
    best = np.argmax(strength, axis=1)[:, None]
    gradient = np.column_stack([np.take_along_axis(gx, best, 1), np.take_along_axis(gy, best, 1)]).astype(np.float64)
    strong = np.take_along_axis(strength, best, 1)[:, 0] > EDGE_LEVELS**2 / 4
    return rows[strong], gradient[strong]
