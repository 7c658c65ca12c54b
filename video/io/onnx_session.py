"""onnxruntime, told to keep to itself: where the environment does not say so before its import, release 1.32 reports to
its maker over the network that it runs."""

from __future__ import annotations

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from pathlib import Path

import onnxruntime

from models.core.errors import ModelError

__all__ = ["onnxruntime", "opened", "opened_measuring"]


def opened(path: Path, expected: str = "") -> onnxruntime.InferenceSession:
    """The network in an ONNX file, run by one thread; ModelError, one sentence, where it cannot be read.

    `expected` ends that sentence: what the file should hold.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has a dozen exception types without a common one of its own
        told = f"; {expected}" if expected else ""
        raise ModelError(f"{path} cannot be read as an ONNX network{told}") from error


def opened_measuring(path: Path, schema: str, what: str) -> onnxruntime.InferenceSession:
    """The network in an ONNX file that measures `what` and follows a schema of the project's own; else ModelError."""
    session = opened(path)
    follows = session.get_modelmeta().custom_metadata_map.get("trueroll.schema", "another kind of network")
    if follows != schema:
        raise ModelError(f"{path} follows {follows}; a network that measures {what} follows {schema}")
    return session
