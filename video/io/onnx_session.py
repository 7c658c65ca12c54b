"""ONNX inference sessions with telemetry switched off.

onnxruntime 1.32 sends usage reports over the network unless the environment forbids it before the import. All modules
therefore import onnxruntime from here.
"""

from __future__ import annotations

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from pathlib import Path

import onnxruntime

from models.core.errors import ModelError

__all__ = ["onnxruntime", "open_measurement_session", "open_session"]


def open_session(path: Path, expectation: str = "") -> onnxruntime.InferenceSession:
    """Open a network in an ONNX file for inference on one CPU thread.

    Args:
        path: the ONNX file.
        expectation: end of the error message: the content that the file should have.

    Returns:
        The inference session.

    Raises:
        ModelError: the file cannot be read as an ONNX network; the message is one sentence for the user.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has a dozen exception types without a common base class
        ending = f"; {expectation}" if expectation else ""
        raise ModelError(f"{path} cannot be read as an ONNX network{ending}") from error


def open_measurement_session(path: Path, schema: str, quantity: str) -> onnxruntime.InferenceSession:
    """Open a network that follows one of this project's own schemas, stored in its metadata.

    Args:
        path: the ONNX file.
        schema: value that the metadata key `trueroll.schema` must have.
        quantity: name of the measured quantity, for the error message.

    Returns:
        The inference session.

    Raises:
        ModelError: the file cannot be read, or it follows another schema.
    """
    session = open_session(path)
    follows = session.get_modelmeta().custom_metadata_map.get("trueroll.schema", "another kind of network")
    if follows != schema:
        raise ModelError(f"{path} follows {follows}; a network that measures {quantity} follows {schema}")
    return session
