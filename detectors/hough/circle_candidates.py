"""Candidate discs of the expected size: every edge pixel votes for the centre one radius away from it.

Hough transform with a known radius (Duda and Hart 1972, doi:10.1145/361237.361242; the gradient gives the direction,
Kimme et al. 1975, doi:10.1145/360666.360677).
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.working_view import WorkingView
from models.core.typing import BoolArray, Float32Array, FloatArray

MIN_VOTE_SHARE = 0.22
"""Least share of a full circle's votes of a candidate."""
MAX_CANDIDATES = 50
"""Most candidates of one image."""
MIN_EDGE_GRADIENT = 10.0
"""Gradient, grey levels per working px, above half of which a pixel is an edge; three times it has full weight."""
EDGE_THICKNESS_PX = 2.5
"""Number of pixels across a sharp edge that vote for one centre."""


def find_circle_candidates(
    contrast: Float32Array, foreground: BoolArray, view: WorkingView
) -> tuple[FloatArray, FloatArray]:
    """Find peaks of the votes: working px (n, 2) and share of a full circle's votes (n,), strongest first."""
    votes = _accumulate_votes(contrast, foreground, view)
    window = 2 * int(max(1, round(0.45 * float(view.radius.min())))) + 1
    highest = cv2.dilate(votes, np.ones((window, window), np.uint8))
    peaks = (votes >= highest) & (votes > MIN_VOTE_SHARE) & view.centre_area
    y, x = np.nonzero(peaks)
    order = np.argsort(-votes[y, x], kind="stable")[:MAX_CANDIDATES]
    y, x = y[order], x[order]
    return np.column_stack([x, y]).astype(np.float64), votes[y, x].astype(np.float64)


def _accumulate_votes(contrast: Float32Array, foreground: BoolArray, view: WorkingView) -> Float32Array:
    h, w = foreground.shape
    rows, gradient = _find_edges(contrast, foreground)
    strength = np.linalg.norm(gradient, axis=1)
    direction = gradient / strength[:, None]
    weight = np.minimum(strength / (3 * MIN_EDGE_GRADIENT), 1.0)
    y, x = np.divmod(rows, w)
    radius = view.radius.ravel()[rows]
    votes = np.zeros(h * w)
    for side in (-1.0, 1.0):
        u = np.rint(x + side * radius * direction[:, 0]).astype(np.int64)
        v = np.rint(y + side * radius * direction[:, 1]).astype(np.int64)
        inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
        votes += np.bincount(v[inside] * w + u[inside], weight[inside], minlength=h * w)
    return _normalize_votes(votes.reshape(h, w).astype(np.float32), view)


def _normalize_votes(votes: Float32Array, view: WorkingView) -> Float32Array:
    """Sum votes (h, w) over their scatter, as a share of those of a full circle."""
    sigma = 0.9 + 0.06 * view.median_radius
    blurred = cv2.GaussianBlur(votes, (0, 0), sigma)
    full = 2 * np.pi * view.radius * EDGE_THICKNESS_PX / (2 * np.pi * (sigma**2 + 0.6))
    return np.asarray(blurred / full, dtype=np.float32)


def _find_edges(contrast: Float32Array, foreground: BoolArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Find edge pixels near the foreground: flat indices (n,), and gradients (n, 2) of the strongest channel."""
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
    strong = np.take_along_axis(strength, best, 1)[:, 0] > MIN_EDGE_GRADIENT**2 / 4
    return rows[strong], gradient[strong]
