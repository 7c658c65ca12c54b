"""The mean of the weights of two ball networks, one trained on from the other: from such a one the shipped one went on.

    python -m benchmarks.averaged_network ONE.onnx TWO.onnx -o FILE.onnx [--work training]

Between two networks of one training the mean of their weights often finds as much and invents less than either
(Izmailov et al. 2018, arXiv:1803.05407). What the files hold is averaged: the normalisations are part of the weights
there. Then it is calibrated anew on held-out drawn pictures, kept in the folder `--work`, as after a training.
As a module, for `detectors` is the room here, not the script beside this one. It needs the package `onnx`, which comes
with the training.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

from detectors.network.network_file import CentreModel, open_model
from detectors.training.ball_export import Calibration
from detectors.training.evaluation import (
    CALIBRATION_FILE,
    FIGURES_FILE,
    as_facts,
    calibration_of,
    figures_of,
    held_out,
    matched_maps,
)

RECIPE = "trueroll.recipe"


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("networks", nargs=2, type=Path, metavar="FILE.onnx")
    asked.add_argument("-o", "--out", type=Path, required=True)
    asked.add_argument("--work", type=Path, default=Path("training"), help="folder of held-out pictures")
    given = asked.parse_args()
    models = [onnx.load(str(path)) for path in given.networks]
    made = averaged(*models)
    first, second = (json.loads(facts(model)[RECIPE]) for model in models)
    tell(made, RECIPE, second | {"mean_with": first})
    left = calibration_of(matched_maps(saved(made, given.out).maps, held_out(given.work, CALIBRATION_FILE)))
    calibration, shown = calibrate(made, left), held_out(given.work, FIGURES_FILE)
    figures = figures_of(matched_maps(saved(made, given.out).maps, shown), len(shown))
    for key, value in as_facts(calibration, figures).items():
        tell(made, key, value)
    onnx.save(made, str(given.out))
    print("calibrated by", {name: round(value, 3) for name, value in asdict(left).items()})
    print(json.dumps(asdict(figures)))


def saved(model: onnx.ModelProto, path: Path) -> CentreModel:
    onnx.save(model, str(path))
    network = open_model(path)
    if not isinstance(network, CentreModel):
        raise ValueError(f"{path} should be a network of trueroll's own")
    return network


def calibrate(model: onnx.ModelProto, left: Calibration) -> Calibration:
    """Put what is left to calibrate into the network, after its last convolution; what that makes in all."""
    made_by = {output: node for node in model.graph.node for output in node.output}
    sigmoid = next(node for node in model.graph.node if node.op_type == "Sigmoid")
    adds = made_by[sigmoid.input[0]]
    times = made_by[adds.input[0]]
    [widens] = [made_by[name] for name in made_by["maps"].input if made_by[name].op_type == "Add"]
    slope, offset, wider = (constant(model, node.input[1]) for node in (times, adds, widens))
    found = Calibration(
        left.slope * slope[1], left.slope * offset[1] + left.offset, left.sigma_factor * float(np.exp(wider[1]))
    )
    for (entry, _), value in zip(
        (slope, offset, wider), (found.slope, found.offset, float(np.log(found.sigma_factor))), strict=True
    ):
        entry.CopyFrom(numpy_helper.from_array(np.array(value, dtype=np.float32), entry.name))
    return found


def constant(model: onnx.ModelProto, name: str) -> tuple[onnx.TensorProto, float]:
    entry = next(entry for entry in model.graph.initializer if entry.name == name)
    return entry, float(numpy_helper.to_array(entry))


def averaged(one: onnx.ModelProto, two: onnx.ModelProto) -> onnx.ModelProto:
    """The second network with the mean of both one's weights; ValueError where they are not laid out alike."""
    weights = {entry.name: entry for entry in one.graph.initializer}
    if set(weights) != {entry.name for entry in two.graph.initializer}:
        raise ValueError("the networks should be laid out alike; their weights have different names")
    made = onnx.ModelProto()
    made.CopyFrom(two)
    for entry in made.graph.initializer:
        first, second = numpy_helper.to_array(weights[entry.name]), numpy_helper.to_array(entry)
        if first.shape != second.shape:
            raise ValueError(f"the networks should be laid out alike; {entry.name} is {first.shape} and {second.shape}")
        if second.dtype.kind == "f":
            mean = (first.astype(np.float64) + second) / 2
            entry.CopyFrom(numpy_helper.from_array(mean.astype(second.dtype), entry.name))
    return made


def facts(model: onnx.ModelProto) -> dict[str, str]:
    return {entry.key: entry.value for entry in model.metadata_props}


def tell(model: onnx.ModelProto, key: str, value: object) -> None:
    """Write an entry of the metadata anew."""
    next(entry for entry in model.metadata_props if entry.key == key).value = json.dumps(value)


if __name__ == "__main__":
    main()
