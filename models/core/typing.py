"""Array types of the whole program; docstrings state the shapes with fixed letters (see the glossary)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Physics: positions, velocities, times, parameters.
FloatArray = NDArray[np.float64]
# Inputs and outputs of networks, flow fields, intermediate images.
Float32Array = NDArray[np.float32]
# Indices and counts.
IntArray = NDArray[np.int64]
# Flags, and masks of images.
BoolArray = NDArray[np.bool_]
# Channels of 8 bits that are not a whole RGB image: grey values, mattes, planes.
ByteArray = NDArray[np.uint8]
# An RGB image (height, width, 3), 0 to 255.
ImageArray = NDArray[np.uint8]
