"""Pictures as H.264 holds them: a plane of brightness, and two of colour half as wide and high (Y'CbCr 4:2:0)."""

from __future__ import annotations

from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from models.core.typing import ByteArray, ImageArray
from video.io.pixel_kernels import fill_planes

BRIGHTNESS = (0.2126, 0.7152, 0.0722)
"""What red, green and blue add to the brightness (ITU-R BT.709-6, item 3.2)."""
FORMAT = "yuv420p"


def _to_planes() -> NDArray[np.float32]:
    """(3, 4): red, green, blue and 1 to Y', Cb and Cr of 8 bits in limited range (BT.709-6, items 3.2 to 3.4).

    Of the colours, which are those of four pixels, it takes the sums of the four.
    """
    bright = np.array(BRIGHTNESS)
    blue, red = (np.eye(3)[k] - bright for k in (2, 0))
    of_four = 112 / 4
    shares = np.stack([219 * bright, of_four * blue / (1 - bright[2]), of_four * red / (1 - bright[0])]) / 255
    return np.column_stack([shares, [16.5, 128.5, 128.5]]).astype(np.float32)  # cut off: the halves round


TO_PLANES = _to_planes()


def planes_of(rgb: ImageArray) -> Any:
    """The picture (H, W, 3), both sides even, as a frame for the encoder; the colours of 2 x 2 pixels are their mean.

    To half a level. The general converter takes longer, and blurs colours over four lines.
    """
    height, width = rgb.shape[:2]
    frame = av.VideoFrame(width, height, FORMAT)
    fill_planes(rgb, *(_plane(plane) for plane in frame.planes), TO_PLANES)  # straight into the frame
    return frame


def _plane(plane: Any) -> ByteArray:
    """(h, w) of a frame, to be written into."""
    return np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)[:, : plane.width]
