"""Interpolation networks from ONNX files, with a time input and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from video.flow.onnx_interpolation import OnnxInterpolator

onnx = pytest.importorskip("onnx")
H, W = 50, 70
FIRST, SECOND = (np.full((H, W, 3), level, dtype=np.uint8) for level in (40, 200))


def save_network(path: Path, inputs: dict[str, list[object]], nodes: list[object]) -> Path:
    """Write a network of some nodes, from inputs to `out`."""
    helper, real = onnx.helper, onnx.TensorProto.FLOAT
    value_infos = [helper.make_tensor_value_info(name, real, shape) for name, shape in inputs.items()]
    out = helper.make_tensor_value_info("out", real, [1, 3, "h", "w"])
    half = helper.make_tensor("half", real, [1], [0.5])
    graph = helper.make_graph(nodes, "between", value_infos, [out], [half])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, path)
    return path


def save_network_with_time(path: Path, shape: list[object]) -> Path:
    """Write the network a + t (b - a)."""
    node = onnx.helper.make_node
    nodes = [node("Sub", ["b", "a"], ["d"]), node("Mul", ["d", "t"], ["s"]), node("Add", ["a", "s"], ["out"])]
    return save_network(path, {"a": [1, 3, "h", "w"], "b": [1, 3, "h", "w"], "t": shape}, nodes)


@pytest.mark.parametrize("shape", [[1], [1, 1], [1, 1, 1, 1], [1, 1, "h", "w"]])
def test_a_network_with_a_time_input_outputs_any_time(tmp_path: Path, shape: list[object]) -> None:
    interpolated = OnnxInterpolator.load(save_network_with_time(tmp_path / "t.onnx", shape)).prepare(FIRST, SECOND)(
        0.25
    )
    assert interpolated.shape == (H, W, 3)
    assert np.unique(interpolated).tolist() == [80]


@pytest.mark.parametrize(("share", "level"), [(0.5, 120), (0.25, 80), (0.8125, 170)])
def test_a_network_without_a_time_input_bisects_the_gap(tmp_path: Path, share: float, level: int) -> None:
    node = onnx.helper.make_node
    nodes = [node("Add", ["a", "b"], ["s"]), node("Mul", ["s", "half"], ["out"])]
    path = save_network(tmp_path / "m.onnx", {"a": [1, 3, "h", "w"], "b": [1, 3, "h", "w"]}, nodes)
    interpolated = OnnxInterpolator.load(path).prepare(FIRST, SECOND)(share)
    assert np.unique(interpolated).tolist() == [level]


def test_other_networks_and_other_files_are_refused_with_a_reason(tmp_path: Path) -> None:
    node = onnx.helper.make_node
    path = save_network(tmp_path / "one.onnx", {"a": [1, 3, "h", "w"]}, [node("Mul", ["a", "half"], ["out"])])
    with pytest.raises(OptionError, match="does not interpolate frames"):
        OnnxInterpolator.load(path)
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(OptionError, match="no ONNX network"):
        OnnxInterpolator.load(tmp_path / "text.onnx")
