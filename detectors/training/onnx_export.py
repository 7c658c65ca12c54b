"""Export of a trained network to an ONNX file, with a check that both compute the same."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from models.core.typing import ByteArray
from video.io.onnx_session import onnxruntime

# Version of the ONNX operators.
OPSET = 18
# Largest accepted difference of the outputs of the exported and the trained network: float32 in another order.
MAX_DISAGREEMENT = 2e-3


def write_onnx_network(
    network: nn.Module,
    dynamic_sides: dict[int, Any],
    names: tuple[str, str],
    metadata: dict[str, str],
    parity_inputs: list[ByteArray],
    path: Path,
) -> None:
    """Write a network with one input and one output as an ONNX file.

    Args:
        network: The trained network with its pre- and post-processing.
        dynamic_sides: Sides of the input that are open (`torch.export.Dim`), by axis.
        names: Names of the input and the output.
        metadata: Values by name.
        parity_inputs: Inputs for which both must agree; the first is also the exporter's example.
        path: The file.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    with _silence_exporter():
        program = torch.onnx.export(
            network, (torch.from_numpy(parity_inputs[0]),), dynamo=True, opset_version=OPSET,
            dynamic_shapes=(dynamic_sides,), input_names=[names[0]], output_names=[names[1]],
        )  # fmt: skip
    if program is None:
        raise RuntimeError("torch could not export the network to ONNX")
    model = program.model_proto
    for name, value in metadata.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = name, value
    aside = path.with_suffix(".part")
    aside.write_bytes(model.SerializeToString())
    worst = max_disagreement(network, aside, parity_inputs)
    if worst > MAX_DISAGREEMENT:
        aside.unlink()
        raise RuntimeError(
            f"the exported network should agree with the trained one to {MAX_DISAGREEMENT}; it differs by {worst:.2g}"
        )
    aside.replace(path)


def encode_json_values(facts: dict[str, object]) -> dict[str, str]:
    """Encode values as JSON, for the metadata of a file."""
    return {key: json.dumps(value) for key, value in facts.items()}


def max_disagreement(network: nn.Module, path: Path, parity_inputs: list[ByteArray]) -> float:
    """Largest difference of the outputs of a network and of an ONNX file for some inputs."""
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    name, worst = session.get_inputs()[0].name, 0.0
    for network_input in parity_inputs:
        with torch.no_grad():
            trained = network(torch.from_numpy(network_input)).numpy()
        exported = np.asarray(session.run(None, {name: network_input})[0])
        worst = max(worst, float(np.abs(trained - exported).max()))
    return worst


@contextlib.contextmanager
def _silence_exporter() -> Iterator[None]:
    """Suppress the exporter's messages about its steps and about packages that are not needed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logger.setLevel(level)
