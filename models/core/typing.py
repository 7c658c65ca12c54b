"""Array types of the whole program; docstrings state the shapes with fixed letters (see the glossary)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
"""Physics: positions, velocities, times, parameters."""
Float32Array = NDArray[np.float32]
"""Inputs and outputs of networks, flow fields, intermediate images."""
IntArray = NDArray[np.int64]
"""Indices and counts."""
BoolArray = NDArray[np.bool_]
"""Flags, and masks of images."""
ByteArray = NDArray[np.uint8]
"""Channels of 8 bits that are not a whole RGB image: grey values, mattes, planes."""
ImageArray = NDArray[np.uint8]
"""An RGB image (height, width, 3), 0 to 255."""
