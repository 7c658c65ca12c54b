"""Interpolation of everything except balls by a frame-interpolation network in an ONNX file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.core.errors import OptionError
from models.core.typing import Float32Array, ImageArray
from video.flow.optical_flow import FrameAtTime
from video.io.onnx_session import onnxruntime

SIDE_MULTIPLE = 32
"""px; networks halve the image up to five times."""
MAX_HALVINGS = 4
"""Bisections of the time for a network that only outputs the middle frame: sixteenths of a gap."""


@dataclass(frozen=True, slots=True)
class OnnxInterpolator:
    """A network that takes two images and optionally the time between them.

    Images are RGB, float32, 0 to 1, (1, 3, H, W) with H and W multiples of 32: two inputs, or one input with both
    images (6 channels), or with a plane of the time as well (7 channels). A separate time input has one element, or is
    a
    plane (1, 1, H, W). A network without a time input outputs the middle frame; other times follow by bisection. The
    first output is the image.
    """

    session: Any
    image_inputs: tuple[str, ...]
    """Names of the image inputs: two, or one."""
    channels: int
    """Channels of the first image input."""
    time_input: str | None
    """Name of the time input; None if there is none."""
    time_is_plane: bool
    """Whether the time input is a plane (1, 1, H, W)."""

    @classmethod
    def load(cls, path: Path) -> OnnxInterpolator:
        """Read a network from a file.

        Args:
            path: ONNX file.

        Returns:
            The network, ready to run on the CPU.

        Raises:
            OptionError: The file is no ONNX network, or its inputs are not two images and at most a time.
        """
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        try:
            session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises many exception types of its own
            raise OptionError(f"{path} is no ONNX network that can be read: {str(error).splitlines()[0]}") from error
        inputs = session.get_inputs()
        images = [i for i in inputs if len(i.shape) == 4 and i.shape[1] in (3, 6, 7)]
        others = [i for i in inputs if i not in images]
        fits = len(images) == 2 if images and images[0].shape[1] == 3 else len(images) == 1
        if not fits or len(others) > 1:
            input_shapes = ", ".join(f"{i.name} {i.shape}" for i in inputs)
            raise OptionError(
                f"{path} does not interpolate frames: two images (1, 3, H, W), or one input with 6 or 7 channels, "
                f"and at most a time are wanted; got {input_shapes}"
            )
        time = others[0] if others else None
        plane = time is not None and len(time.shape) == 4 and time.shape[2] != 1
        names = tuple(i.name for i in images)
        return cls(session, names, int(images[0].shape[1]), None if time is None else time.name, plane)

    @property
    def accepts_time(self) -> bool:
        """Whether the network accepts any time, rather than only outputting the middle frame."""
        return self.time_input is not None or self.channels == 7

    def prepare(self, first: ImageArray, second: ImageArray) -> FrameAtTime:
        """Prepare two images (h, w, 3)."""
        height, width = first.shape[:2]
        start, end = _to_input_tensor(first), _to_input_tensor(second)

        def at(share: float) -> ImageArray:
            output = self._run_network(start, end, share) if self.accepts_time else self._bisect_time(start, end, share)
            levels = np.clip(np.rint(output[0].transpose(1, 2, 0) * 255), 0, 255).astype(np.uint8)
            return np.asarray(levels[:height, :width], dtype=np.uint8)

        return at

    def _run_network(self, first: Float32Array, second: Float32Array, share: float) -> Float32Array:
        """Run the network on two input tensors at a share of the time."""
        level = np.full((1, 1, *first.shape[2:]), share, dtype=np.float32)
        if len(self.image_inputs) == 2:
            feed = {self.image_inputs[0]: first, self.image_inputs[1]: second}
        else:
            parts = [first, second, level] if self.channels == 7 else [first, second]
            feed = {self.image_inputs[0]: np.concatenate(parts, axis=1)}
        if self.time_input is not None:
            shape = next(i.shape for i in self.session.get_inputs() if i.name == self.time_input)
            feed[self.time_input] = level if self.time_is_plane else np.full([1] * len(shape), share, dtype=np.float32)
        return np.asarray(self.session.run(None, feed)[0], dtype=np.float32)

    def _bisect_time(self, first: Float32Array, second: Float32Array, share: float) -> Float32Array:
        """Return the image at the nearest sixteenth of the gap by bisecting the time."""
        low, high = 0.0, 1.0
        for _ in range(MAX_HALVINGS):
            middle = self._run_network(first, second, 0.5)
            half = (low + high) / 2
            if abs(share - half) < 0.5**MAX_HALVINGS / 2:
                return middle
            first, second, low, high = (middle, second, half, high) if share > half else (first, middle, low, half)
        return first if share - low < high - share else second


def _to_input_tensor(image: ImageArray) -> Float32Array:
    """Convert an image to a tensor (1, 3, H, W), padded with its border pixels to the next multiple."""
    pad = [(0, -side % SIDE_MULTIPLE) for side in image.shape[:2]]
    wide = np.pad(image, [*pad, (0, 0)], mode="edge")
    return np.ascontiguousarray(wide.transpose(2, 0, 1)[None], dtype=np.float32) / np.float32(255)
