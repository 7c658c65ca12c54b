"""Networks from ONNX files in the place of the flow: those with a time, and those that know the middle alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from models.core.errors import OptionError
from video.flow.onnx_interpolation import OnnxNetwork

onnx = pytest.importorskip("onnx")
H, W = 50, 70
FIRST, SECOND = (np.full((H, W, 3), level, dtype=np.uint8) for level in (40, 200))


def saved(path: Path, inputs: dict[str, list[object]], nodes: list[object]) -> Path:
    """A network of some nodes, from inputs to `out`."""
    helper, real = onnx.helper, onnx.TensorProto.FLOAT
    given = [helper.make_tensor_value_info(name, real, shape) for name, shape in inputs.items()]
    out = helper.make_tensor_value_info("out", real, [1, 3, "h", "w"])
    half = helper.make_tensor("half", real, [1], [0.5])
    graph = helper.make_graph(nodes, "between", given, [out], [half])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.save(model, path)
    return path


def with_time(path: Path, shape: list[object]) -> Path:
    """a + t (b - a)."""
    node = onnx.helper.make_node
    nodes = [node("Sub", ["b", "a"], ["d"]), node("Mul", ["d", "t"], ["s"]), node("Add", ["a", "s"], ["out"])]
    return saved(path, {"a": [1, 3, "h", "w"], "b": [1, 3, "h", "w"], "t": shape}, nodes)


@pytest.mark.parametrize("shape", [[1], [1, 1], [1, 1, 1, 1], [1, 1, "h", "w"]])
def test_a_network_is_asked_for_any_time(tmp_path: Path, shape: list[object]) -> None:
    made = OnnxNetwork.load(with_time(tmp_path / "t.onnx", shape)).open(FIRST, SECOND)(0.25)
    assert made.shape == (H, W, 3)
    assert np.unique(made).tolist() == [80]


@pytest.mark.parametrize(("share", "level"), [(0.5, 120), (0.25, 80), (0.8125, 170)])
def test_a_network_that_knows_the_middle_alone_halves_its_way_to_a_time(
    tmp_path: Path, share: float, level: int
) -> None:
    node = onnx.helper.make_node
    nodes = [node("Add", ["a", "b"], ["s"]), node("Mul", ["s", "half"], ["out"])]
    path = saved(tmp_path / "m.onnx", {"a": [1, 3, "h", "w"], "b": [1, 3, "h", "w"]}, nodes)
    made = OnnxNetwork.load(path).open(FIRST, SECOND)(share)
    assert np.unique(made).tolist() == [level]


def test_other_networks_and_other_files_are_refused_in_a_sentence(tmp_path: Path) -> None:
    node = onnx.helper.make_node
    path = saved(tmp_path / "one.onnx", {"a": [1, 3, "h", "w"]}, [node("Mul", ["a", "half"], ["out"])])
    with pytest.raises(OptionError, match="does not interpolate frames"):
        OnnxNetwork.load(path)
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(OptionError, match="no ONNX network"):
        OnnxNetwork.load(tmp_path / "text.onnx")
