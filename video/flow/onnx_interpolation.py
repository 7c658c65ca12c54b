"""A frame-interpolation network from an ONNX file, for all that is no ball."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.typing import Float32Array, ImageArray
from video.flow.optical_flow import Between
from video.io.onnx_session import onnxruntime

MULTIPLE = 32
"""px: networks halve the picture up to five times."""
HALVINGS = 4
"""How often the time is halved by a network that makes the middle alone: sixteenths of a gap."""


@dataclass(frozen=True, slots=True)
class OnnxNetwork:
    """A network that takes two pictures, and may take the share of the time.

    Pictures are RGB, float32, 0 to 1, (1, 3, H, W) with H and W multiples of 32: two inputs, or one that holds both, 6
    channels, or 7 with a plane of the share. A share of its own is an input of any shape with one element, or a plane
    (1, 1, H, W). Without any, the network makes the middle, and other times by halving. The first output is the
    picture.
    """

    session: Any
    pictures: tuple[str, ...]
    """Names of the inputs for pictures: two, or one."""
    channels: int
    """Of the first of them."""
    time: str | None
    plane: bool
    """Whether the share is wanted as a plane."""

    @classmethod
    def load(cls, path: Path) -> OnnxNetwork:
        """Read a network; OptionError, one sentence, where it is none that takes two pictures."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        try:
            session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises many kinds of its own
            raise OptionError(f"{path} is no ONNX network that can be read: {str(error).splitlines()[0]}") from error
        inputs = session.get_inputs()
        pictures = [i for i in inputs if len(i.shape) == 4 and i.shape[1] in (3, 6, 7)]
        others = [i for i in inputs if i not in pictures]
        fits = len(pictures) == 2 if pictures and pictures[0].shape[1] == 3 else len(pictures) == 1
        if not fits or len(others) > 1:
            told = ", ".join(f"{i.name} {i.shape}" for i in inputs)
            raise OptionError(
                f"{path} does not interpolate frames: two pictures (1, 3, H, W), or one input with 6 or 7 channels, "
                f"and at most a time are wanted; got {told}"
            )
        time = others[0] if others else None
        plane = time is not None and len(time.shape) == 4 and time.shape[2] != 1
        names = tuple(i.name for i in pictures)
        return cls(session, names, int(pictures[0].shape[1]), None if time is None else time.name, plane)

    @property
    def any_time(self) -> bool:
        """Whether it makes any share of the time, not the middle alone."""
        return self.time is not None or self.channels == 7

    def open(self, first: ImageArray, second: ImageArray) -> Between:
        """Prepare two pictures (h, w, 3)."""
        height, width = first.shape[:2]
        start, end = _planes(first), _planes(second)

        def at(share: float) -> ImageArray:
            made = self._made(start, end, share) if self.any_time else self._halved(start, end, share)
            seen = np.clip(np.rint(made[0].transpose(1, 2, 0) * 255), 0, 255).astype(np.uint8)
            return np.asarray(seen[:height, :width], dtype=np.uint8)

        return at

    def _made(self, first: Float32Array, second: Float32Array, share: float) -> Float32Array:
        level = np.full((1, 1, *first.shape[2:]), share, dtype=np.float32)
        if len(self.pictures) == 2:
            feed = {self.pictures[0]: first, self.pictures[1]: second}
        else:
            parts = [first, second, level] if self.channels == 7 else [first, second]
            feed = {self.pictures[0]: np.concatenate(parts, axis=1)}
        if self.time is not None:
            shape = next(i.shape for i in self.session.get_inputs() if i.name == self.time)
            feed[self.time] = level if self.plane else np.full([1] * len(shape), share, dtype=np.float32)
        return np.asarray(self.session.run(None, feed)[0], dtype=np.float32)

    def _halved(self, first: Float32Array, second: Float32Array, share: float) -> Float32Array:
        """The nearest sixteenth, by halving the time towards it."""
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = self._made(first, second, 0.5)
            half = (low + high) / 2
            if abs(share - half) < 0.5**HALVINGS / 2:
                return middle
            first, second, low, high = (middle, second, half, high) if share > half else (first, middle, low, half)
        return first if share - low < high - share else second


def _planes(picture: ImageArray) -> Float32Array:
    """(1, 3, H, W), the borders repeated up to the next multiple."""
    pad = [(0, -side % MULTIPLE) for side in picture.shape[:2]]
    wide = np.pad(picture, [*pad, (0, 0)], mode="edge")
    return np.ascontiguousarray(wide.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255)
