"""Every plan and picture draws a ball in the colour that the clip shows."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from skimage.color import rgb2lab
from support.sample_clips import read_sample_truth

from benchmarks.detection.ball_looks import UNPAINTED, collect_pixels, compare_colours, measure_colour
from detectors.measurement.ball_paint import look_at_balls
from models.core.ball_look import BallLook, parse_colour
from models.core.events import Events
from models.core.fit_result import Fit, Trust
from models.core.naming import Naming, build_naming
from models.core.scene import Camera, Scene
from models.core.srgb import decode_srgb
from models.core.tracks import Tracks
from models.core.trajectory import Trajectory
from models.core.typing import ByteArray, FloatArray
from pipeline.reporting.figures.run_figures import build_plan_figure, style_line
from video.drawing.prediction_fan import PredictionFan, draw_prediction_fans
from video.drawing.table_plan import SHIFT, SUPERSAMPLE, build_empty_inset, build_table_inset, draw_table_plan
from video.io.clip import open_clip, read_frames
from video.overlay.placement_overlay import CLOTH_COLOUR, draw_placement_plan

NO_EVENTS = Events((), *(np.empty(0),) * 3, (), (), np.empty((0, 2)), *(np.empty(0),) * 4)
PAPER = np.array([252.0, 250.0, 236.0])
"""sRGB of white in the clip."""
MAX_DIFFERENCE = 5.0
"""CIEDE2000."""
REST_FRAMES = 10
"""Frames of the sample before the strike, in which all balls rest."""


@cache
def make_shot() -> tuple[Scene, Tracks, FloatArray]:
    """Scene and tracks of a sample before its strike, from its truth, and the sRGB (N, 3) of its balls in the clip."""
    truth = read_sample_truth("overhead_pool")
    clip = open_clip(truth.path)
    _, frame = next(iter(read_frames(clip, indices=np.arange(1))))
    matrix = np.array(truth.scene["camera"]["matrix"])
    table = truth.table
    camera = Camera(matrix, 1280, 720, np.zeros((4, 2)), np.eye(8), "cloth", 3.7, 0.1)
    cloth = np.median(rgb2lab(frame[200:520, 300:1000]).reshape(-1, 3), axis=0)
    rows, shape = slice(0, REST_FRAMES), (REST_FRAMES, len(truth.ids))
    ids, kinds = truth.ids, tuple(re.sub(r"-\d+", "", name) for name in truth.ids)
    sigma = np.full(shape, 1e-3)
    tracks = Tracks(
        np.arange(REST_FRAMES), truth.t[rows], ids, kinds, truth.xy[rows], truth.px[rows], sigma, sigma,
        np.zeros((*shape, 2)), truth.radius_px[rows], np.zeros((len(ids), 3)),
    )  # fmt: skip
    scene = Scene(table, camera, cloth, ())
    shown = [
        measure_colour(collect_pixels({0: frame}, tracks, np.array([0]), k), None if kind in UNPAINTED else PAPER)
        for k, kind in enumerate(kinds)
    ]
    return scene, replace(tracks, looks=look_at_balls(clip, scene, tracks)), np.array(shown)


def draw_plan(scene: Scene, tracks: Tracks) -> ByteArray:
    """The plan of a shot."""
    paths = [tracks.xy[:, k] for k in range(len(tracks.ids))]
    return draw_table_plan(scene.table, name_all(scene, tracks), tracks.ids, paths, np.empty((0, 2)), "")


def draw_fans(scene: Scene, tracks: Tracks, is_played_otherwise: bool = False) -> ByteArray:
    """The plan of predicted paths."""
    fans = [
        PredictionFan(name, tracks.xy[:, k], np.repeat(tracks.xy[None, :, k], 3, axis=0), np.empty((0, 2)))
        for k, name in enumerate(tracks.ids)
    ]
    return draw_prediction_fans(scene.table, name_all(scene, tracks), fans, "", is_played_otherwise)


def draw_what_if(scene: Scene, tracks: Tracks) -> ByteArray:
    """The plan of a shot that is played otherwise."""
    return draw_fans(scene, tracks, is_played_otherwise=True)


def draw_placement(scene: Scene, tracks: Tracks) -> ByteArray:
    """The plan by which balls are put back."""
    distances = np.ones((len(tracks.ids), 4))
    return draw_placement_plan(scene.table, name_all(scene, tracks), tracks.ids, tracks.xy[0], distances, "")


def draw_inset(scene: Scene, tracks: Tracks) -> ByteArray:
    """The plan within the video."""
    inset = build_table_inset(scene, 640)
    image = np.zeros((*inset.size[::-1], 3), np.uint8)
    colours = [look.colour for look in tracks.looks]
    inset.draw_with_balls(image, 0, 0, inset.reduce_canvas(inset.canvas), tracks.xy[0], colours)
    return image


def name_all(scene: Scene, tracks: Tracks) -> Naming:
    """The naming of the shot."""
    return build_naming(scene.table, scene.camera, tracks.ids, tracks.looks)


@pytest.mark.parametrize("draw", [draw_plan, draw_fans, draw_what_if, draw_placement, draw_inset])
def test_a_plan_draws_each_ball_in_its_colour_in_the_clip(draw: Callable[[Scene, Tracks], ByteArray]) -> None:
    scene, tracks, shown = make_shot()
    image = draw(scene, tracks)
    naming = name_all(scene, tracks)
    inset = build_empty_inset(scene.table, CLOTH_COLOUR, naming.view, max(image.shape[1], image.shape[0]))
    column, row = (inset.to_fixed_point(tracks.xy[0]) // (SUPERSAMPLE << SHIFT)).T
    differences = compare_colours(image[row, column], shown)
    assert differences.max() < MAX_DIFFERENCE, dict(zip(tracks.ids, differences.round(1), strict=True))


def test_the_plan_of_the_report_draws_each_ball_in_its_colour_in_the_clip() -> None:
    scene, tracks, shown = make_shot()
    count = len(tracks.ids)
    position = np.zeros((count, 4, 2))
    position[:, 0] = tracks.xy[0]
    trajectory = Trajectory(
        tracks.ids, np.arange(count), np.zeros(count), np.full(count, tracks.t[-1]), position, np.zeros((count, 2, 3)),
        ("rest",) * count, np.tile(np.eye(4) * 1e-8, (count, 1, 1)),
    )  # fmt: skip
    shape = (REST_FRAMES, count)
    fit = Fit(
        NO_EVENTS, trajectory, (), 1e-4, 1.0, np.zeros((*shape, 2)), np.zeros(shape, bool), np.ones(shape, bool),
        Trust("green", ()),
    )  # fmt: skip
    markers = [trace for trace in build_plan_figure(scene, fit, tracks.looks).data[:-1] if trace.mode == "markers"]
    drawn = np.array([parse_colour(trace.marker.color) for trace in markers], float)
    differences = compare_colours(drawn, shown)
    assert [trace.name for trace in markers] == list(tracks.ids)
    assert differences.max() < MAX_DIFFERENCE, dict(zip(tracks.ids, differences.round(1), strict=True))


@pytest.mark.parametrize("colour", [(255, 255, 0), (252, 250, 236), (255, 193, 7), (44, 44, 50)])
def test_a_line_of_every_colour_is_visible_on_a_white_page(colour: tuple[int, int, int]) -> None:
    shown = parse_colour(style_line(BallLook("ball", colour))["color"])
    light = np.array([0.2126, 0.7152, 0.0722]) @ decode_srgb(np.array(shown) / 255)
    assert 1.05 / (light + 0.05) > 2.5, "3 to 1 for grey (WCAG 2.1, 1.4.11); pure yellow has 1.1"
    assert colour != (44, 44, 50) or shown == colour, "a dark one stays"
