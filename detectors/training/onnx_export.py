"""A trained network to an ONNX file, and the proof that both compute the same."""

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

OPSET = 18
PARITY = 2e-3
"""Largest difference that the exported network may show from the trained one: float32 in another order."""


def write_onnx(
    network: nn.Module,
    shapes: dict[int, Any],
    names: tuple[str, str],
    facts: dict[str, str],
    tried: list[ByteArray],
    path: Path,
) -> None:
    """Write a network of one input and one output, of those names, with metadata `facts`.

    `shapes` are the open sides of the input (`torch.export.Dim`); `tried` are inputs for which both must agree, the
    first of them shows the exporter what an input is. RuntimeError if they do not.
    """
    with _quiet():
        program = torch.onnx.export(
            network, (torch.from_numpy(tried[0]),), dynamo=True, opset_version=OPSET, dynamic_shapes=(shapes,),
            input_names=[names[0]], output_names=[names[1]],
        )  # fmt: skip
    if program is None:
        raise RuntimeError("torch could not export the network to ONNX")
    model = program.model_proto
    for name, value in facts.items():
        entry = model.metadata_props.add()
        entry.key, entry.value = name, value
    aside = path.with_suffix(".part")
    aside.write_bytes(model.SerializeToString())
    worst = disagreement(network, aside, tried)
    if worst > PARITY:
        aside.unlink()
        raise RuntimeError(
            f"the exported network should agree with the trained one to {PARITY}; it differs by {worst:.2g}"
        )
    aside.replace(path)


def as_json(facts: dict[str, object]) -> dict[str, str]:
    """Facts as the metadata of a file holds them."""
    return {key: json.dumps(value) for key, value in facts.items()}


def disagreement(network: nn.Module, path: Path, tried: list[ByteArray]) -> float:
    """Largest difference of the outputs of a network and of a file for some inputs."""
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    name, worst = session.get_inputs()[0].name, 0.0
    for given in tried:
        with torch.no_grad():
            mine = network(torch.from_numpy(given)).numpy()
        theirs = np.asarray(session.run(None, {name: given})[0])
        worst = max(worst, float(np.abs(mine - theirs).max()))
    return worst


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The exporter talks about its steps and about packages that are not needed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logger.setLevel(level)
