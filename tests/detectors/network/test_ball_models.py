"""Networks that users supply: every layout as a small ONNX file with a known output."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from support.rendered_balls import Ball, build_test_scene, render_balls

from detectors.network.ball_model import (
    letterbox_image,
    open_ball_model,
    recognize_layout,
    select_ball_classes,
    split_into_tiles,
)
from detectors.network.network_detector import build_network_detector
from detectors.network.peak_decoding import CandidateDetections, select_non_echoes
from models.core.errors import ModelError

onnx = pytest.importorskip("onnx", reason="needs the extra train")
SIDE = 64
CELLS = 8 * 8 + 4 * 4 + 2 * 2
BALL = (20.0, 40.0, 10.0, 10.0)
"""x, y, w, h in px of the input."""


def write_network(
    path: Path, output: np.ndarray, names: str | None = None, inputs: tuple[int, ...] = (1, 3, SIDE, SIDE)
) -> Path:
    """Write a network that gives `output` for every image."""
    image = onnx.helper.make_tensor_value_info("images", onnx.TensorProto.FLOAT, inputs)
    answer = onnx.helper.make_tensor_value_info("output0", onnx.TensorProto.FLOAT, output.shape)
    constant = onnx.helper.make_node(
        "Constant", [], ["known"], value=onnx.numpy_helper.from_array(output.astype(np.float32))
    )
    zero = onnx.helper.make_node("Constant", [], ["zero"], value=onnx.numpy_helper.from_array(np.zeros((), np.float32)))
    nodes = [
        constant, zero,
        onnx.helper.make_node("ReduceMean", ["images"], ["level"], keepdims=0),
        onnx.helper.make_node("Mul", ["level", "zero"], ["nothing"]),
        onnx.helper.make_node("Add", ["known", "nothing"], ["output0"]),
    ]  # fmt: skip
    graph = onnx.helper.make_graph(nodes, "known", [image], [answer])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)], ir_version=8)
    if names is not None:
        entry = model.metadata_props.add()
        entry.key, entry.value = "names", names
    onnx.save(model, path)
    return path


def rows_of_v5(classes: int, ball: int) -> np.ndarray:
    output = np.zeros((1, 3 * CELLS, 5 + classes))
    output[0, 7, :4], output[0, 7, 4], output[0, 7, 5 + ball] = BALL, 0.9, 1.0
    # The same ball from a neighbouring cell, a little off: to be suppressed.
    output[0, 8, :4], output[0, 8, 4], output[0, 8, 5 + ball] = (21.0, 40.0, 10.0, 10.0), 0.8, 1.0
    return output


def columns_of_v8(classes: int, ball: int) -> np.ndarray:
    rows = rows_of_v5(classes, ball)[:, :CELLS]
    scores = rows[..., 4:5] * rows[..., 5:]
    return np.concatenate([rows[..., :4], scores], axis=2).transpose(0, 2, 1)


def rows_of_v10(ball: int) -> np.ndarray:
    output = np.zeros((1, 50, 6))
    x, y, w, h = BALL
    output[0, 0] = (x - w / 2, y - h / 2, x + w / 2, y + h / 2, 0.9, ball)
    return output


LAYOUTS = {
    "v5, one class": (rows_of_v5(1, 0), None),
    "v5, COCO": (rows_of_v5(80, 32), None),
    "v8, one class": (columns_of_v8(1, 0), "{0: 'ball'}"),
    "v8, COCO": (columns_of_v8(80, 32), None),
    "v8, rows": (columns_of_v8(2, 1).transpose(0, 2, 1), "{0: 'table', 1: 'pool ball'}"),
    "v10": (rows_of_v10(0), None),
    "v11, colours": (columns_of_v8(3, 2), "['cue', 'eight', 'stripes']"),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_gives_the_position_of_the_ball_in_the_image(tmp_path: Path, name: str) -> None:
    output, names = LAYOUTS[name]
    model = open_ball_model(write_network(tmp_path / "m.onnx", output, names))
    detections = model.find_candidates(np.zeros((2 * SIDE, 4 * SIDE, 3), np.uint8), 40.0)
    # 256 x 128 px shrink by 4 into 64 x 32, with 16 rows of border above: y = (40 - 16) * 4, less half a pixel.
    assert len(detections) == 1
    assert detections.centre[0] == pytest.approx([79.5, 95.5])
    assert detections.radius[0] == pytest.approx(20.0)
    assert detections.score[0] == pytest.approx(0.9)
    assert np.isfinite(detections.sigma_across).all()


@pytest.mark.parametrize("name", ["v5, COCO", "v8, COCO"])
def test_other_things_of_coco_are_no_balls(tmp_path: Path, name: str) -> None:
    output = {"v5, COCO": rows_of_v5, "v8, COCO": columns_of_v8}[name](80, 0)
    model = open_ball_model(write_network(tmp_path / "m.onnx", output))
    assert len(model.find_candidates(np.zeros((SIDE, SIDE, 3), np.uint8), 10.0)) == 0


def test_names_of_classes_determine_the_appearance() -> None:
    classes = select_ball_classes({0: "person", 1: "cue-ball", 2: "8 ball", 3: "striped ball"}, 4)
    assert classes.balls == (1, 2, 3)
    assert [int(np.argmax(row)) for row in classes.appearances[1:]] == [0, 1, 3]


@pytest.mark.parametrize("side", [(640, 640), (384, 672), (1280, 1280)])
@pytest.mark.parametrize("classes", [1, 4, 80])
def test_layouts_are_recognized_for_every_size(side: tuple[int, int], classes: int) -> None:
    cells = sum(side[0] // s * (side[1] // s) for s in (8, 16, 32))
    assert recognize_layout((1, 3 * cells, 5 + classes), side) == "rows with objectness"
    assert recognize_layout((1, 4 + classes, cells), side) == "columns of classes"
    assert recognize_layout((1, cells, 4 + classes), side) == "rows of classes"
    assert recognize_layout((1, 300, 6), side) == "suppressed"
    assert recognize_layout((1, 1000), side) is None
    assert recognize_layout((1, 7, 13), side) is None


def test_letterboxing_keeps_every_place() -> None:
    rgb = np.zeros((90, 300, 3), np.uint8)
    rgb[40:50, 200:210] = 255
    network_input, letterbox = letterbox_image(rgb, (128, 160))
    assert network_input.shape == (1, 3, 128, 160)
    rows, columns = np.nonzero(network_input[0, 0] > 0.9)
    middle = (np.array([columns.mean(), rows.mean()]) + 0.5 - letterbox.margin) / letterbox.scale - 0.5
    assert middle == pytest.approx([204.5, 44.5], abs=1.0)


def test_tiles_of_a_large_image_cover_it_and_hold_every_ball_whole() -> None:
    rgb = np.zeros((1080, 1920, 3), np.uint8)
    parts = split_into_tiles(rgb, 8.0, (640, 640))
    assert len(parts) > 1
    for x, y in np.random.default_rng(0).uniform((8, 8), (1911, 1071), (200, 2)):
        whole = [
            x - 8 >= left and y - 8 >= top and x + 8 < left + part.shape[1] and y + 8 < top + part.shape[0]
            for left, top, part in parts
        ]
        assert any(whole)
    assert len(split_into_tiles(rgb, 40.0, (640, 640))) == 1


def test_a_ball_on_the_border_of_two_tiles_is_one_ball() -> None:
    one = CandidateDetections(
        np.array([[50.0, 50.0], [51.0, 50.0]]), np.full(2, 8.0), np.zeros((2, 2)), np.array([0.9, 0.8]),
        np.ones(2), np.ones(2), np.full((2, 4), np.nan),
    )  # fmt: skip
    assert select_non_echoes(one).tolist() == [True, False]


@pytest.mark.parametrize(
    ("way", "score", "is_kept"),
    [((0.0, 0.0), 0.8, True), ((1.0, 29.0), 0.8, True), ((-33.0, 1.0), 0.8, False), ((0.0, 0.0), 0.3, False)],
)
def test_what_stands_before_a_streak_is_no_echo_of_it(way: tuple[float, float], score: float, is_kept: bool) -> None:
    """An echo has the displacement of the streak, with either sign, or a low score."""
    one = CandidateDetections(
        np.array([[50.0, 50.0], [64.0, 51.0]]), np.full(2, 8.0), np.array([(36.0, 0.0), way]), np.array([0.9, score]),
        np.ones(2), np.ones(2), np.full((2, 4), np.nan),
    )  # fmt: skip
    assert select_non_echoes(one).tolist() == [True, is_kept]


def test_a_half_precision_network_runs(tmp_path: Path) -> None:
    path = write_network(tmp_path / "m.onnx", columns_of_v8(1, 0))
    model = onnx.load(path)
    half = onnx.TensorProto.FLOAT16
    model.graph.input[0].type.tensor_type.elem_type = half
    for node in model.graph.node:
        if node.op_type == "ReduceMean":
            node.input[0] = "wide"
    cast = onnx.helper.make_node("Cast", ["images"], ["wide"], to=onnx.TensorProto.FLOAT)
    model.graph.node.insert(0, cast)
    onnx.save(model, path)
    assert len(open_ball_model(path).find_candidates(np.zeros((SIDE, SIDE, 3), np.uint8), 10.0)) == 1


def wrong(tmp_path: Path, name: str) -> Path:
    path = tmp_path / "wrong.onnx"
    if name == "text":
        path.write_text("weights\n" * 100)
    elif name == "classifier":
        write_network(path, np.zeros((1, 1000)))
    elif name == "flat input":
        write_network(path, np.zeros((1, 5, CELLS)), inputs=(1, 3))
    elif name == "segmentation":
        write_network(path, np.zeros((1, 21, SIDE, SIDE)))
    elif name == "another contract":
        model = onnx.load(write_network(path, np.zeros((1, 12, 16, 16))))
        entry = model.metadata_props.add()
        entry.key, entry.value = "trueroll.schema", "trueroll.balls/99"
        onnx.save(model, path)
    return path


@pytest.mark.parametrize("name", ["missing", "text", "classifier", "flat input", "segmentation", "another contract"])
def test_a_wrong_model_is_refused_in_one_sentence_with_the_expectation(tmp_path: Path, name: str) -> None:
    with pytest.raises(ModelError) as refused:
        open_ball_model(wrong(tmp_path, name))
    sentence = str(refused.value)
    assert "wrong.onnx" in sentence
    assert "\n" not in sentence
    assert "YOLO" in sentence or "train-detector" in sentence


@dataclass(frozen=True)
class Pointer:
    """A network that always finds the same ball, a quarter from the left and half down."""

    radius: float

    def find_candidates(self, rgb: np.ndarray, radius: float) -> CandidateDetections:
        h, w = rgb.shape[:2]
        one, place = np.ones(1), np.array([[w / 4 - 0.5, h / 2 - 0.5]])
        return CandidateDetections(
            place, self.radius * one, np.zeros((1, 2)), 0.9 * one, one, one, np.full((1, 4), np.nan)
        )


def test_another_network_receives_the_table_and_its_balls_are_measured_in_the_image() -> None:
    detector = build_network_detector(
        build_test_scene(), [(0, render_balls([], np.random.default_rng(0)))], Pointer(8.0)
    )
    x0, y0, x1, y1 = detector.view.box
    place = np.array([x0 + (x1 - x0) / 4, y0 + (y1 - y0) / 2]) - 0.5
    # The network is off by a pixel and a half; the ball's outline is more precise.
    truth = place + np.array([0.9, -1.2])
    detections = detector.detect(render_balls([Ball(float(truth[0]), float(truth[1]))], np.random.default_rng(1)))
    assert len(detections) == 1
    assert np.linalg.norm(detections.centre[0] - truth) < 0.6


def test_what_is_too_large_for_a_ball_of_the_table_is_none() -> None:
    detector = build_network_detector(
        build_test_scene(), [(0, render_balls([], np.random.default_rng(0)))], Pointer(20.0)
    )
    assert len(detector.detect(render_balls([], np.random.default_rng(1)))) == 0


@pytest.mark.parametrize(
    ("times", "count"),
    [(2, 4), (4, 12), (5, 12), (40, 12)],  # four rows of three are as many as a frame may cost
)
def test_an_image_of_tiny_balls_costs_a_dozen_runs_at_most(times: int, count: int) -> None:
    """A ball of 14 px in the input of the network is large enough; here it has 1 / `times` of that."""
    tiles = split_into_tiles(np.zeros((300, 400, 3), np.uint8), 0.999 * 7.0 * 400 / 640 / (times - 0.5), (640, 640))
    assert len(tiles) == count
