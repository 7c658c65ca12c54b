"""What others make of the same visible pictures: a blend, optical flow both ways, ffmpeg's minterpolate."""

from __future__ import annotations

import subprocess

import cv2
import numpy as np

MINTERPOLATE = "mi_mode=mci:mc_mode=aobmc:me_mode=bidir:vsbmc=1:scd=none"


def blended(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """Both pictures, one over the other."""
    return np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0))


class FlowBothWays:
    """DIS (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29) forwards and backwards, put together at a share.

    The flows from the new picture are those of Jiang et al. 2018 (Super SloMo, doi:10.1109/CVPR.2018.00938, eq. 4);
    each side counts less where there and back do not meet.
    """

    def __init__(self, first: np.ndarray, second: np.ndarray) -> None:
        grey = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (first, second)]
        flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self.pictures = (first, second)
        self.there, self.back = flow.calc(grey[0], grey[1], None), flow.calc(grey[1], grey[0], None)
        height, width = grey[0].shape
        self.grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)

    def at(self, share: float) -> np.ndarray:
        to_first = -(1 - share) * share * self.there + share**2 * self.back
        to_second = (1 - share) ** 2 * self.there - share * (1 - share) * self.back
        total, weights = np.zeros(self.pictures[0].shape, np.float32), np.zeros(self.grid.shape[:2], np.float32)
        sides = ((0, to_first, self.there, self.back, 1 - share), (1, to_second, self.back, self.there, share))
        for side, to, own, other, weight in sides:
            where = self.grid + to
            seen = cv2.remap(self.pictures[side], where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            missed = np.linalg.norm(own + self._sampled(other, self.grid + own), axis=-1)
            weight = weight * np.exp(-self._sampled(missed, where) / 2) + 1e-3
            total += seen * weight[..., None]
            weights += weight
        return np.clip(np.rint(total / weights[..., None]), 0, 255).astype(np.uint8)

    @staticmethod
    def _sampled(field: np.ndarray, where: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.remap(field, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def minterpolated(visible: list[np.ndarray], step: int) -> list[np.ndarray]:
    """ffmpeg's motion-compensated pictures, (D - 1) step + 1; those that it does not make are blends."""
    height, width = visible[0].shape[:2]
    # the filter gives nothing for the last two pictures: repeat them
    padded = [*visible, visible[-1], visible[-1], visible[-1]]
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    filters = f"format=yuv444p,minterpolate=fps={step}:{MINTERPOLATE},format=rgb24"
    command = ["ffmpeg", "-v", "error", "-threads", "1", *raw, "-r", "1", "-i", "-", "-vf", filters, *raw[:4], "-"]
    done = subprocess.run(command, input=b"".join(p.tobytes() for p in padded), capture_output=True, check=True)
    out = np.frombuffer(done.stdout, np.uint8).reshape(-1, height, width, 3)
    count = (len(visible) - 1) * step + 1
    start = _aligned(out, visible, step)
    return list(out[start : start + count])


def _aligned(out: np.ndarray, visible: list[np.ndarray], step: int) -> int:
    """How many pictures the filter puts before the first visible one."""
    few = min(4, len(visible))

    def off(start: int) -> float:
        here = out[start : start + (few - 1) * step + 1 : step].astype(np.int16)
        return float(np.abs(here - np.stack(visible[:few])).mean()) if len(here) == few else np.inf

    return min(range(2 * step + 1), key=off)
