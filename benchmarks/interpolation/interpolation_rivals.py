"""Rival methods on the same visible frames: a cross-fade, bidirectional optical flow, and ffmpeg's minterpolate."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import av
import cv2
import numpy as np

MINTERPOLATE = "mi_mode=mci:mc_mode=aobmc:me_mode=bidir:vsbmc=1:scd=none"


def blend_frames(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """Cross-fade two frames."""
    return np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0))


class FlowBothWays:
    """Bidirectional DIS flow (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29), blended between two frames.

    The flows from the new frame are those of Jiang et al. 2018 (Super SloMo, doi:10.1109/CVPR.2018.00938, eq. 4); the
    weight of each side falls where forward and backward flow disagree.
    """

    def __init__(self, first: np.ndarray, second: np.ndarray) -> None:
        grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in (first, second)]
        flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        self.frames = (first, second)
        self.there, self.back = flow.calc(grey[0], grey[1], None), flow.calc(grey[1], grey[0], None)
        height, width = grey[0].shape
        self.grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)

    def synthesize(self, share: float) -> np.ndarray:
        to_first = -(1 - share) * share * self.there + share**2 * self.back
        to_second = (1 - share) ** 2 * self.there - share * (1 - share) * self.back
        total, weights = np.zeros(self.frames[0].shape, np.float32), np.zeros(self.grid.shape[:2], np.float32)
        sides = ((0, to_first, self.there, self.back, 1 - share), (1, to_second, self.back, self.there, share))
        for side, to, own, other, weight in sides:
            where = self.grid + to
            warped = cv2.remap(self.frames[side], where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            mismatch = np.linalg.norm(own + self._sample_field(other, self.grid + own), axis=-1)
            weight = weight * np.exp(-self._sample_field(mismatch, where) / 2) + 1e-3
            total += warped * weight[..., None]
            weights += weight
        return np.clip(np.rint(total / weights[..., None]), 0, 255).astype(np.uint8)

    @staticmethod
    def _sample_field(field: np.ndarray, where: np.ndarray) -> np.ndarray:
        return np.asarray(cv2.remap(field, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def run_minterpolate(visible: list[np.ndarray], step: int) -> list[np.ndarray]:
    """Run ffmpeg's motion compensation; returns (D - 1) step + 1 frames, some of which it fills by blending."""
    # the filter drops the last two frames: repeat them
    padded = [*visible, visible[-1], visible[-1], visible[-1]]
    out = np.stack(
        list(_filter_frames(padded, [("format", "yuv444p"), ("minterpolate", f"fps={step}:{MINTERPOLATE}")]))
    )
    count = (len(visible) - 1) * step + 1
    start = _find_first_frame(out, visible, step)
    return list(out[start : start + count])


def _filter_frames(frames: list[np.ndarray], filters: list[tuple[str, str]]) -> Iterator[np.ndarray]:
    """Run filters of ffmpeg, as PyAV has them, on frames one second apart."""
    height, width = frames[0].shape[:2]
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format="rgb24", time_base=Fraction(1, 1))
    nodes = [graph.add(name, options) for name, options in [*filters, ("format", "rgb24")]]
    graph.link_nodes(source, *nodes, graph.add("buffersink")).configure()
    for number, image in enumerate([*frames, None]):
        frame = None
        if image is not None:
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 1)
        graph.push(frame)
        while True:
            try:
                yield graph.pull().to_ndarray(format="rgb24")
            except (BlockingIOError, EOFError):  # needs the next frame; has no more
                break


def _find_first_frame(out: np.ndarray, visible: list[np.ndarray], step: int) -> int:
    """Return the number of frames that the filter outputs before the first visible one."""
    few = min(4, len(visible))

    def off(start: int) -> float:
        here = out[start : start + (few - 1) * step + 1 : step].astype(np.int16)
        return float(np.abs(here - np.stack(visible[:few])).mean()) if len(here) == few else np.inf

    return min(range(2 * step + 1), key=off)
