"""The transfer curve of sRGB between coded values and linear light (IEC 61966-2-1), and weights of brightness."""

from __future__ import annotations

import numpy as np

from models.core.typing import FloatArray

# Weights of red, green and blue in the brightness of standard definition (ITU-R BT.601), by which images are compared,
# and of high definition (ITU-R BT.709), by which they are encoded.
LUMA_601 = np.array([0.299, 0.587, 0.114])
LUMA_709 = np.array([0.2126, 0.7152, 0.0722])


def decode_srgb(values: FloatArray) -> FloatArray:
    """Convert sRGB values, 0 to 1, to linear light, 0 to 1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encode_srgb(light: FloatArray) -> FloatArray:
    """Convert linear light, 0 to 1, to sRGB values, 0 to 1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
