"""Simulation, diagnosis and detection in a notebook or a script, without files of results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from detectors.detect_options import DetectOptions
from detectors.still_images import StillDetections, detect_in_still
from diagnosis.diagnose import diagnose as diagnose_recordings
from diagnosis.verdicts.verdict import DiagnosisReport
from models.core.typing import ImageArray
from models.physics.billiards.simulation.simulate_shot import SimulatedShot
from pipeline.engine.helper_executor import open_executor
from pipeline.io.image_file import read_image
from pipeline.io.long_recordings import cut_pendulums
from pipeline.io.shot_setup import parse_shot, place_on_learned_table, read_shot_setup
from pipeline.io.simulators.pooltool_simulator import POOLTOOL_NAME
from pipeline.io.table_profile import read_profile_text
from pipeline.io.track_folder import read_track_folders
from pipeline.io.track_folder_scene import build_gap_scene
from pipeline.simulator_diagnosis import describe_coefficients, diagnose_mechanism, pair_with_pooltool
from pipeline.stages.read_stage import ReadOptions
from video.io.square_pixels import stretch_to_square_pixels
from video.io.video_options import CalibrateOptions


def simulate(shot: Mapping[str, Any] | str | Path, profile: str | Path | None = None) -> SimulatedShot:
    """Simulate a shot from its initial state.

    Args:
        shot: A dict with the keys of SHOT.json, or the path of such a file: table (m), balls (m, m/s, rad/s),
            effects, laws and seconds (s).
        profile: Table profile of `trueroll fit-table` or `diagnose`, which replaces the effects and laws of the shot.

    Returns:
        The shot: its contacts, and `.states_at(times)` for the state of every ball at any times (T,) in s.

    Raises:
        OptionError: The shot has a mistake, and the message names the first one; or the profile cannot be used.
    """
    parsed = parse_shot(dict(shot)) if isinstance(shot, Mapping) else read_shot_setup(Path(shot))
    if profile is not None:
        parsed = place_on_learned_table(parsed, read_profile_text(Path(profile)))
    return parsed.simulate()


def diagnose(*inputs: str | Path, simulator: str | None = None, seed: int = 0) -> DiagnosisReport:
    """Diagnose the sim-to-real gap of shots of one table or scene, or of recordings of a mechanism.

    Args:
        inputs: Run folders or track folders, all of one scene; with a simulator, tables with a column per joint, MCAP
            files or ROS 2 bags.
        simulator: Your own simulator: `FILE.xml` of MuJoCo, `MODULE:FUNCTION` of Python, (state, inputs, dt) -> state,
            a table of its predictions, or `pooltool`, which takes run folders and track folders.
        seed: Random seed of the bootstraps.

    Returns:
        Verdict, candidates with probabilities, localisation, and the gap on held-out shots before and after.

    Raises:
        TruerollError: A folder cannot be used; the message states what was expected.
    """
    paths = [Path(one) for one in inputs]
    if simulator is not None and simulator != POOLTOOL_NAME:
        with open_executor() as executor:
            return diagnose_mechanism(paths, simulator, seed, executor=executor)[0]
    folder = cut_pendulums(read_track_folders(paths))
    scene = build_gap_scene(folder)
    if simulator is not None:
        scene = pair_with_pooltool(scene)
    with open_executor() as executor:
        report = diagnose_recordings(scene, folder.recordings, seed, executor=executor)
    return replace(report, notes=(*describe_coefficients(report), *report.notes, *folder.notes))


def detect(
    image: ImageArray | str | Path,
    *,
    detector: Literal["auto", "hough", "onnx"] = "auto",
    model: str | Path | None = None,
    corners: str | None = None,
    table: str | None = None,
    ball_radius: float | None = None,
    pixel_aspect: str | None = None,
) -> StillDetections:
    """Detect the balls in one still image.

    Args:
        image: RGB, (height, width, 3), or the path of an image file.
        detector: auto, hough or onnx.
        model: An ONNX ball detector to use instead of the shipped one.
        corners: Corners of the playing surface, "x,y,x,y,x,y,x,y" in px; located in the image if not given.
        table: Playing surface, such as "2.54x1.27" (m) or "pool-9ft".
        ball_radius: Radius of the balls in m.
        pixel_aspect: Width of a pixel over its height, such as "64/45"; positions are in square pixels. None for 1.

    Returns:
        The K balls from left to right: centre (K, 2), radius (K,) and sigma (K,) in px, class and score.

    Raises:
        TableNotFound: There is no table in the image, and the detector needs one.
        OptionError: The image cannot be read, or an option cannot be used.
    """
    pixels, name = (image, "the image") if isinstance(image, np.ndarray) else (read_image(Path(image)), str(image))
    pixels = stretch_to_square_pixels(pixels, ReadOptions(None, pixel_aspect).aspect or Fraction(1))
    options = DetectOptions(detector, None if model is None else str(model))
    return detect_in_still(pixels, name, options, CalibrateOptions(corners, table, ball_radius))
