"""Measure how exactly `trueroll put-back` finds where balls lay, and how exactly it brings them back.

    python -m benchmarks.detection.put_back_accuracy [--quick] [--halls 40] [--seed 7] [--sets halls,stills]

Each rendered hall is a table with a camera 25 to 90 degrees above it, 1280 or 1920 px wide; every second one has cloth,
lamps and balls that no training used. A first image gives the wanted places, with the calibration that the image itself
gives (the model of the table is named, as with --table). In a second image of the same camera every ball lies
elsewhere, up to 30 mm away. The table states the error of the places relative to the noses, its predicted standard
deviation, and the error of the move that would bring a ball back: that one hardly depends on the calibration.

`stills` are those of ../shared/data, marked by hand to about half a pixel (0.8 mm); skipped where they are absent.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.detection.detector_cases import DATA, MARK_OFFSET, place_camera
from benchmarks.support.figures import Figure, add_quick_option, estimate_median, estimate_share, run_quick
from detectors.detect import detect_in_image
from detectors.still_images import classify_detections
from models.core.errors import TableNotFound
from models.core.naming import Naming
from models.core.scene import Camera, Scene
from models.estimation.ball_places import BallPlaces
from models.physics.billiards.tables import TABLE_PRESETS
from models.tracking.ball_classes import assign_ids
from pipeline.actions.placement_views import draw_live_image
from pipeline.actions.put_back import PlacementGuide, WantedPlaces
from pipeline.io.image_file import read_image
from video.calibration.camera_model import estimate_place_sigma
from video.calibration.table_finder import calibrate_image
from video.io.video_options import CalibrateOptions
from video.rendering.random_scene import BallArrangement, RandomScene, arrange_balls, generate_scene
from video.rendering.scene_renderer import build_view, render_image

# Degrees.
ELEVATIONS = (25.0, 90.0)
WIDTHS_PX = (1280, 1920)
# m, largest distance of a ball from its wanted place in the second image.
MAX_MOVE_M = 0.03
# Least number of balls of a hall.
MIN_BALLS = 3
# Degrees, ranges of elevations that are summarised.
BANDS = ((25.0, 45.0), (45.0, 90.0))
STILL_TABLE = "1.881x0.943"
# mm, from the origin of the marks, the middle of the table, to the noses.
STILL_HALF_SIZE = np.array([940.5, 471.5])


@dataclass
class PlacementErrors:
    """Errors of many balls."""

    ball_count: int = 0
    place_mm: list[float] = field(default_factory=list)
    predicted_mm: list[float] = field(default_factory=list)
    exact_mm: list[float] = field(default_factory=list)
    """Errors of the places with the true camera."""
    move_mm: list[float] = field(default_factory=list)
    matched_count: int = 0
    seconds: list[float] = field(default_factory=list)
    """CPU seconds from a present image to the drawing, first image."""
    failed: list[str] = field(default_factory=list)


QUICK_HALLS = 6


def measure_figures(seed: int) -> list[Figure]:
    """Measure the figures of the documentation in few halls, all elevations together."""
    errors = PlacementErrors()
    for elevation, random_scene, rng in generate_halls(QUICK_HALLS, seed):
        measure_hall(random_scene, rng, errors, f"hall at {elevation:.0f} degrees")
    return [
        estimate_share("halls calibrated", QUICK_HALLS - len(errors.failed), QUICK_HALLS),
        estimate_median("place relative to the cushions, median error", errors.place_mm, "mm"),
        estimate_median("the same with the exact camera", errors.exact_mm, "mm"),
        estimate_median("stated sigma of a place, median", errors.predicted_mm, "mm"),
        estimate_median("move that brings a ball back, median error", errors.move_mm, "mm"),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_quick_option(parser)
    parser.add_argument("--halls", type=int, default=40, help="rendered halls (default 40)")
    parser.add_argument("--seed", type=int, default=7, help="random seed (default 7)")
    parser.add_argument("--sets", default="halls,stills", help="names of the sets, separated by commas")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    if arguments.quick:
        inputs = (
            f"{QUICK_HALLS} halls, camera 25 to 90 degrees above the table, seed {arguments.seed}; balls are the cases"
        )
        run_quick("detection.put_back_accuracy", lambda: measure_figures(arguments.seed), inputs)
        return
    print(
        f"{'set':22s}{'balls':>6s}{'found':>7s} | place, mm: median  95 %  sigma | exact camera: median  95 %"
        " | move, mm: median  95 %  right ball | s"
    )
    if "halls" in arguments.sets.split(","):
        bands = {band: PlacementErrors() for band in BANDS}
        for elevation, random_scene, rng in generate_halls(arguments.halls, arguments.seed):
            band = next(b for b in BANDS if b[0] <= elevation < b[1] or elevation >= BANDS[-1][0] == b[0])
            measure_hall(random_scene, rng, bands[band], f"hall at {elevation:.0f} degrees")
        for (low, high), errors in bands.items():
            print_errors(f"halls, {low:.0f} to {high:.0f} degrees", errors)
    if "stills" in arguments.sets.split(","):
        if DATA.is_dir():
            print_errors("stills", measure_stills(DATA / "images"))
        else:
            print(f"stills: skipped, {DATA} does not exist")


def generate_halls(count: int, seed: int) -> Iterator[tuple[float, RandomScene, np.random.Generator]]:
    """Generate halls with evenly spread camera elevations, and the source of randomness for their balls."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        elevation = ELEVATIONS[0] + (ELEVATIONS[1] - ELEVATIONS[0]) * (number + 0.5) / count
        width = WIDTHS_PX[number % 2]
        random_scene = generate_scene(rng, 160, hold_out=number % 4 < 2)
        random_scene = replace(random_scene, table=TABLE_PRESETS[random_scene.table.name])
        yield elevation, place_camera(rng, random_scene, width, width * 9 // 16, (elevation, elevation)), rng


def measure_hall(random_scene: RandomScene, rng: np.random.Generator, errors: PlacementErrors, name: str) -> None:
    """Measure the places in one image of a hall, and the moves in a second one."""
    table, camera = random_scene.table, random_scene.camera
    arrangement = arrange_balls(rng, random_scene)
    while len(arrangement.position) < MIN_BALLS:
        arrangement = arrange_balls(rng, random_scene)
    arrangement = replace(arrangement, displacement=np.zeros_like(arrangement.displacement))
    looks = tuple(random_scene.balls[k] for k in arrangement.look_index)
    view = build_view(table, camera, random_scene.appearance, looks, samples=2)
    first = render_image(view, arrangement.poses_at, 0.0, rng)
    errors.ball_count += len(arrangement.position)
    lab = cv2.cvtColor(np.array([[random_scene.appearance.cloth]], np.float32), cv2.COLOR_RGB2LAB)[0, 0]
    exact = Scene(table, camera, lab.astype(np.float64), ())
    balls = detect_in_image(first, exact)
    found, true = match_points(
        camera.to_table(balls.centre, table.ball_radius), arrangement.position, table.ball_radius
    )
    errors.exact_mm += list(1e3 * np.linalg.norm(found - true, axis=1))
    try:
        scene = calibrate_image(first, CalibrateOptions(table=table.name), name)
    except TableNotFound as error:
        errors.failed.append(str(error))
        return
    balls = detect_in_image(first, scene)
    xy = scene.camera.to_table(balls.centre, scene.table.ball_radius)
    turned = turn_table(arrangement.position, scene, camera)
    found, true = match_points(xy, turned, 2 * table.ball_radius)
    sigma = estimate_place_sigma(scene.camera, scene.table, xy)
    errors.place_mm += list(1e3 * np.linalg.norm(found - true, axis=1))
    errors.predicted_mm += list(1e3 * np.hypot(*sigma.T))
    kinds = classify_detections(balls, scene.table.game)
    count = len(xy)
    places = BallPlaces(0.0, assign_ids(kinds, xy), kinds, xy, np.full(count, 5e-4), np.zeros(count))
    wanted = WantedPlaces(places, sigma, scene.table, Naming(), scene.camera, 0.0, first, "")
    guide = PlacementGuide.prepare(wanted, scene.cloth_lab)
    moved = move_balls(rng, arrangement, table.ball_radius)
    second = render_image(view, moved.poses_at, 0.0, rng)
    draw_live_image(wanted, guide.compare_image(first))  # compile
    guide.detector = None
    begin = time.process_time()
    state = guide.compare_image(second)
    draw_live_image(wanted, state)
    errors.seconds.append(time.process_time() - begin)
    owner = assign_true_points(xy, turned, 2 * table.ball_radius)
    turned_after = turn_table(moved.position, scene, camera)
    for ball, at in enumerate(owner):
        if at < 0 or np.isnan(state.present[ball, 0]):
            continue
        true_move = turned[at] - turned_after[at]
        gap = float(np.linalg.norm(state.list_missing_moves(places)[ball] - true_move))
        is_right = gap < table.ball_radius
        errors.matched_count += is_right
        errors.move_mm += [1e3 * gap] * is_right


def move_balls(rng: np.random.Generator, arrangement: BallArrangement, radius: float) -> BallArrangement:
    """Move every ball by up to `MAX_MOVE_M` to where it touches no other; one that has no room stays."""
    xy = arrangement.position.copy()
    for ball in range(len(xy)):
        others = np.delete(xy, ball, axis=0)
        for _ in range(20):
            angle, size = rng.uniform(0, 2 * np.pi), rng.uniform(0, MAX_MOVE_M)
            place = arrangement.position[ball] + size * np.array([np.cos(angle), np.sin(angle)])
            if np.linalg.norm(others - place, axis=1).min(initial=1.0) > 2 * radius:
                xy[ball] = place
                break
    return replace(arrangement, position=xy)


def turn_table(xy: NDArray[np.float64], scene: Scene, camera: Camera) -> NDArray[np.float64]:
    """Return true places in the calibrated coordinates, which may be turned by half a turn."""
    table = scene.table
    px = camera.to_pixels(xy, table.ball_radius)
    calibrated = scene.camera.to_table(px, table.ball_radius)
    turned = np.array([table.length, table.width]) - xy
    return turned if np.abs(calibrated - turned).sum() < np.abs(calibrated - xy).sum() else xy


def match_points(
    found: NDArray[np.float64], true: NDArray[np.float64], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Match points one to one within a reach; return the pairs."""
    owner = assign_true_points(found, true, reach)
    return found[owner >= 0], true[owner[owner >= 0]]


def assign_true_points(found: NDArray[np.float64], true: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
    """Return the index of the true point of each found one, -1 where none is within reach."""
    owner = np.full(len(found), -1, np.int64)
    distance = np.linalg.norm(found[:, None] - true[None], axis=2)
    rows, columns = linear_sum_assignment(np.minimum(distance, reach))
    near = distance[rows, columns] < reach
    owner[rows[near]] = columns[near]
    return owner


def measure_stills(folder: Path) -> PlacementErrors:
    """Measure the places in the marked stills."""
    errors = PlacementErrors()
    labels = json.loads((folder / "labels.json").read_text())
    for entry in labels["images"]:
        rgb = read_image(folder / entry["image"])
        marks = np.array([[ball["x_mm"], -ball["y_mm"]] for ball in entry["balls"]])
        true = 1e-3 * (marks + STILL_HALF_SIZE)
        marks_px = np.array([[ball["x_px"], ball["y_px"]] for ball in entry["balls"]]) - MARK_OFFSET
        errors.ball_count += len(true)
        options = CalibrateOptions(table=STILL_TABLE, ball_radius=1e-3 * labels["ball_radius_mm"])
        scene = calibrate_image(rgb, options, entry["image"])
        balls = detect_in_image(rgb, scene)
        xy = scene.camera.to_table(balls.centre, scene.table.ball_radius)
        owner = assign_true_points(balls.centre, marks_px, 8.0)
        found, seen = owner >= 0, owner[owner >= 0]
        errors.place_mm += list(1e3 * np.linalg.norm(xy[found] - true[seen], axis=1))
        errors.predicted_mm += list(1e3 * np.hypot(*estimate_place_sigma(scene.camera, scene.table, xy).T))
        scale = np.sqrt(np.abs(np.linalg.det(scene.camera.metres_per_pixel(xy, scene.table.ball_radius))))
        errors.exact_mm += list(1e3 * (scale * np.linalg.norm(balls.centre - marks_px[owner], axis=1))[found])
    return errors


def print_errors(name: str, errors: PlacementErrors) -> None:
    """Print one row of the table, and the failures."""

    def format_quantiles(values: list[float]) -> str:
        return f"{np.median(values):7.2f}{np.quantile(values, 0.95):7.2f}" if values else "      -      -"

    place, exact, move = (format_quantiles(one) for one in (errors.place_mm, errors.exact_mm, errors.move_mm))
    sigma = f"{np.median(errors.predicted_mm):7.2f}" if errors.predicted_mm else "      -"
    share = f"{errors.matched_count}/{len(errors.place_mm)}" if errors.move_mm else "-"
    seconds = f"{np.median(errors.seconds):.2f}" if errors.seconds else "-"
    print(
        f"{name:22s}{errors.ball_count:6d}{len(errors.place_mm):7d} |            {place}{sigma} |"
        f"              {exact} |          {move}  {share:>10s} | {seconds}",
        flush=True,
    )
    for text in errors.failed:
        print(f"  not calibrated: {text}")


if __name__ == "__main__":
    main()
