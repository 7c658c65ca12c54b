"""Average the weights of two ball networks, where the training of the second continued from the first.

    python -m benchmarks.detection.averaged_network ONE.onnx TWO.onnx -o FILE.onnx [--work training]

The shipped network was trained on from such a mean. Between two networks of one training, the mean of their weights
often has the recall of either and fewer false positives (Izmailov et al. 2018, arXiv:1803.05407). The weights in the
files are averaged, with the normalisations folded in. The mean is then calibrated on the rendered hold-out images in
the folder `--work`, as after a training. Needs the package `onnx` (extra `train`) and the folder `--work` of `trueroll
train`.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from detectors.network.ball_model import CentreModel, open_ball_model
from detectors.training.ball_evaluation import (
    CALIBRATION_FILE,
    FIGURES_FILE,
    fit_calibration,
    format_metadata,
    match_maps,
    read_hold_out_shard,
    summarize_matches,
)
from detectors.training.ball_export import NetworkCalibration

RECIPE = "trueroll.recipe"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", nargs=2, type=Path, metavar="FILE.onnx")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument(
        "--work", type=Path, default=Path("training"), help="folder of a training with its hold-out images"
    )
    arguments = parser.parse_args()
    models = [onnx.load(str(path)) for path in arguments.networks]
    mean_network = average_weights(*models)
    first, second = (json.loads(read_metadata(model)[RECIPE]) for model in models)
    replace_metadata(mean_network, RECIPE, second | {"mean_with": first})
    calibration_change = fit_calibration(
        match_maps(
            save_network(mean_network, arguments.out).compute_maps,
            read_hold_out_shard(arguments.work, CALIBRATION_FILE),
        )
    )
    calibration, shown = calibrate(mean_network, calibration_change), read_hold_out_shard(arguments.work, FIGURES_FILE)
    figures = summarize_matches(match_maps(save_network(mean_network, arguments.out).compute_maps, shown), len(shown))
    for key, value in format_metadata(calibration, figures).items():
        replace_metadata(mean_network, key, value)
    onnx.save(mean_network, str(arguments.out))
    print("calibrated by", {name: round(value, 3) for name, value in asdict(calibration_change).items()})
    print(json.dumps(asdict(figures)))


def save_network(model: onnx.ModelProto, path: Path) -> CentreModel:
    onnx.save(model, str(path))
    network = open_ball_model(path)
    if not isinstance(network, CentreModel):
        raise ValueError(f"{path} should be a network trained by trueroll")
    return network


def calibrate(model: onnx.ModelProto, change: NetworkCalibration) -> NetworkCalibration:
    """Apply a change of the calibration to the network, after its last convolution; returns the total calibration."""
    node_of_output = {output: node for node in model.graph.node for output in node.output}
    sigmoid = next(node for node in model.graph.node if node.op_type == "Sigmoid")
    adds = node_of_output[sigmoid.input[0]]
    times = node_of_output[adds.input[0]]
    [widens] = [node_of_output[name] for name in node_of_output["maps"].input if node_of_output[name].op_type == "Add"]
    slope, offset, wider = (find_constant(model, node.input[1]) for node in (times, adds, widens))
    calibration = NetworkCalibration(
        change.slope * slope[1], change.slope * offset[1] + change.offset, change.sigma_factor * float(np.exp(wider[1]))
    )
    for (entry, _), value in zip(
        (slope, offset, wider),
        (calibration.slope, calibration.offset, float(np.log(calibration.sigma_factor))),
        strict=True,
    ):
        entry.CopyFrom(numpy_helper.from_array(np.array(value, dtype=np.float32), entry.name))
    return calibration


def find_constant(model: onnx.ModelProto, name: str) -> tuple[onnx.TensorProto, float]:
    entry = next(entry for entry in model.graph.initializer if entry.name == name)
    return entry, float(numpy_helper.to_array(entry))


def average_weights(one: onnx.ModelProto, two: onnx.ModelProto) -> onnx.ModelProto:
    """Return the second network with the mean weights of both; ValueError if their layouts differ."""
    weights = {entry.name: entry for entry in one.graph.initializer}
    if set(weights) != {entry.name for entry in two.graph.initializer}:
        raise ValueError("the networks should have the same layout; their weights have different names")
    mean_network = onnx.ModelProto()
    mean_network.CopyFrom(two)
    for entry in mean_network.graph.initializer:
        first, second = numpy_helper.to_array(weights[entry.name]), numpy_helper.to_array(entry)
        if first.shape != second.shape:
            raise ValueError(
                f"the networks should have the same layout; {entry.name} is {first.shape} and {second.shape}"
            )
        if second.dtype.kind == "f":
            mean = (first.astype(np.float64) + second) / 2
            entry.CopyFrom(numpy_helper.from_array(mean.astype(second.dtype), entry.name))
    return mean_network


def read_metadata(model: onnx.ModelProto) -> dict[str, str]:
    return {entry.key: entry.value for entry in model.metadata_props}


def replace_metadata(model: onnx.ModelProto, key: str, value: object) -> None:
    """Replace an entry of the metadata."""
    next(entry for entry in model.metadata_props if entry.key == key).value = json.dumps(value)


if __name__ == "__main__":
    main()
