from __future__ import annotations

import numpy as np
import pytest
from support import staged_shot as shot

from models.core.ball_look import CLASS_COLOURS
from models.core.scene import Camera, Scene
from models.core.srgb import LUMA_601
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import LabelPosition, overlap_share, place_label, place_panel
from video.drawing.masks import draw_ring, draw_text, text_mask
from video.drawing.palette import (
    BRIGHT_LUMA,
    INK,
    WHITE,
    adapt_to_any_background,
    ensure_contrast,
    lab_to_rgb,
    lighten_for_text,
)
from video.drawing.table_plan import build_table_inset
from video.io.yuv_frame import YuvFrame
from video.overlay.frame_overlay import (
    ClockPanel,
    FrameBalls,
    Label,
    draw_flash,
    draw_measured_rings,
    draw_trail,
    keep_balls_on_top,
)


def black(height: int = 120, width: int = 200) -> ImageArray:
    return np.zeros((height, width, 3), dtype=np.uint8)


def balls(*centres: tuple[float, float], measured: bool = False) -> FrameBalls:
    count = len(centres)
    yes, no = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    centre = np.array(centres, dtype=np.float64).reshape(-1, 2)
    return FrameBalls(
        centre, np.full(count, 8.0), np.ones(count), np.zeros((count, 2)), yes, yes if measured else no, yes
    )


def test_text_is_antialiased_and_its_height_does_not_depend_on_the_letters() -> None:
    masks = [text_mask(text, 14) for text in ("cue", "0.62 m/s", "± 0.6 ms", "pqy")]
    assert len({mask.shape[0] for mask in masks}) == 1
    assert all(len(np.unique(mask)) > 10 for mask in masks)


def test_digits_are_equally_wide_so_that_a_running_clock_does_not_jitter() -> None:
    assert len({text_mask(digit * 5, 27, True).shape[1] for digit in "0123456789"}) == 1


def test_every_character_that_is_drawn_is_in_the_font() -> None:
    missing = text_mask("\uffff", 20)
    for sign in "±–×0123456789.()%/abcdefghijklmnopqrstuvwxyz-":
        mask = text_mask(sign, 20)
        assert mask.any()
        assert mask.shape != missing.shape or not np.array_equal(mask, missing)


@pytest.mark.parametrize("corner", [(-30, -8), (190, 110), (500, 500), (-500, 20), (60, -500)])
def test_drawings_beyond_the_border_are_cut(corner: tuple[int, int]) -> None:
    image = black()
    draw_text(image, "over the border", *corner, 16, (255, 255, 255))
    draw_ring(image, np.array(corner, dtype=float), 30, 2, (255, 0, 0), 1.0)
    draw_flash(image, np.array(corner, dtype=float), 8, 0.3, 1.0, 1.0)
    assert image.shape == black().shape


def test_an_encoder_frame_is_drawn_upon_as_an_image() -> None:
    image = np.full((120, 200, 3), (40, 90, 60), np.uint8)
    frame = YuvFrame.from_rgb(image)
    way = np.column_stack([np.linspace(20, 180, 50), np.full(50, 61.0)])
    for canvas in (image, frame):
        with keep_balls_on_top(canvas, balls((100.0, 60.0), (-3.0, 118.0), (-40.0, 60.0))):
            draw_trail(canvas, way, np.linspace(0, 1, 50), (255, 0, 0), 4.0)
            Label("cue", "1.20 m/s", (200, 180, 90)).draw(canvas, np.array([31.0, 15.0]), 1.0, 0.8)
        draw_flash(canvas, np.array([150.0, 90.0]), 8, 0.3, 1.0, 1.0)
    for drawn, wanted in zip(frame.planes, YuvFrame.from_rgb(image).planes, strict=True):
        assert np.abs(drawn.astype(int) - wanted).max() <= 3  # both round after each element


def test_a_trail_goes_under_the_balls_and_fades() -> None:
    image = black()
    way = np.column_stack([np.linspace(20, 180, 50), np.full(50, 60.0)])
    with keep_balls_on_top(image, balls((100.0, 60.0), (-3.0, 118.0))):
        draw_trail(image, way, np.linspace(0, 1, 50), (255, 0, 0), 4.0)
    assert not image[54:67, 94:107].any()
    assert 0 < image[60, 50].max() < image[60, 85].max() < image[60, 170].max()


def test_a_flash_goes_around_both_balls_of_a_contact() -> None:
    row, column = np.mgrid[:120, :200]
    touching = np.minimum(np.hypot(column - 92, row - 60), np.hypot(column - 108, row - 60)) <= 8
    for age in (0.0, 0.2, 0.6):
        image = black()
        draw_flash(image, np.array([100.0, 60.0]), 8, age, 1.0, 1.0)
        assert not image[touching].any()
        assert image.any()


def test_only_measured_balls_have_a_dashed_ring() -> None:
    fitted, measured = black(), black()
    draw_measured_rings(fitted, balls((100.0, 60.0)), [(255, 255, 255)], 1.0)
    draw_measured_rings(measured, balls((100.0, 60.0), measured=True), [(255, 255, 255)], 1.0)
    assert not fitted.any()
    angles = np.linspace(0, 2 * np.pi, 200)
    ring = np.rint(np.column_stack([60 + 11.5 * np.sin(angles), 100 + 11.5 * np.cos(angles)])).astype(int)
    lit = measured[ring[:, 0], ring[:, 1]].max(axis=1) > 128
    assert 0.3 < lit.mean() < 0.85
    assert not measured[56:65, 96:105].any()


def test_a_label_keeps_off_balls_other_labels_and_the_border() -> None:
    rng = np.random.default_rng(4)
    blocked = 0
    for _ in range(50):
        centres = rng.uniform(0, 1, (4, 2)) * [400, 300]
        taken = [(float(x) - 10, float(y) - 10, 20.0, 20.0) for x, y in centres] + [(150.0, 100.0, 100.0, 30.0)]
        size, radius = (80, 22), 10.0
        side = place_label(size, centres[0], radius, np.zeros(2), taken, (400, 300), None)
        left, top = centres[0] + side.top_left_corner(size, radius)
        rect = (float(left), float(top), 80.0, 22.0)
        assert overlap_share(rect, [(0.0, 0.0, 400.0, 300.0)]) > 0.9
        blocked += overlap_share(rect, taken) > 0
    assert blocked <= 1  # nothing is free around a ball in a corner of the image between others


def test_a_label_moves_the_short_way_round_without_crossing_its_ball() -> None:
    start, aim = LabelPosition(np.deg2rad(170), 0.7), LabelPosition(np.deg2rad(-170), 0.7)
    half = start.move_towards(aim, 0.5)
    assert np.cos(half.angle) == pytest.approx(-1)
    for angle in np.linspace(-np.pi, np.pi, 73):
        left, top = LabelPosition(float(angle), 0.7).top_left_corner((80, 22), 10.0)
        nearest = np.hypot(max(left, -(left + 80), 0.0), max(top, -(top + 22), 0.0))
        assert nearest > 10.0


def test_a_panel_takes_the_corner_that_hides_least() -> None:
    cost = np.ones((45, 80))
    cost[:15, 55:] = 0
    left, top, width, height = place_panel((100, 60), (640, 360), cost, [])
    assert left > 500
    assert top < 20
    other = place_panel((100, 60), (640, 360), cost, [(left, top, width, height)])
    assert overlap_share((left, top, width, height), [other]) == 0


def test_lines_in_the_colour_of_the_cloth_are_drawn_lighter_or_darker() -> None:
    for colour, ground in (((232, 48, 48), (170, 40, 70)), ((246, 244, 232), (190, 190, 180))):
        drawn = ensure_contrast(colour, ground)
        assert np.abs(np.array(drawn) - ground).max() > 1.4 * np.abs(np.array(colour) - ground).max()
    assert ensure_contrast((255, 206, 40), (40, 100, 230)) == (255, 206, 40)
    assert lab_to_rgb(np.array([100.0, 0.0, 0.0])) == (255, 255, 255)


def test_letters_in_the_colour_of_a_ball_can_be_read() -> None:
    for colour in CLASS_COLOURS.values():
        light = lighten_for_text(colour)
        assert np.array(light) @ LUMA_601 > BRIGHT_LUMA - 2
        assert int(np.argmax(light)) == int(np.argmax(colour))
    assert lighten_for_text(CLASS_COLOURS["cue"]) == CLASS_COLOURS["cue"]


def contrast(one: tuple[int, int, int], other: tuple[int, int, int]) -> float:
    """Contrast of two sRGB colours, WCAG 2.1."""
    levels = np.array([one, other]) / 255
    linear = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    dark, light = np.sort(linear @ (0.2126, 0.7152, 0.0722))
    return float((light + 0.05) / (dark + 0.05))


@pytest.mark.parametrize("kind", sorted(CLASS_COLOURS))
def test_a_line_for_any_background_is_visible_on_dark_and_on_white_and_keeps_its_hue(kind: str) -> None:
    line = adapt_to_any_background(CLASS_COLOURS[kind])
    assert contrast(line, INK) >= 2.5
    assert contrast(line, WHITE) >= 2.5
    assert int(np.argmax(line)) == int(np.argmax(CLASS_COLOURS[kind]))


def test_the_bar_of_a_black_balls_label_is_visible() -> None:
    image = black()
    Label("", "", CLASS_COLOURS["eight"]).draw(image, np.array([20.0, 30.0]), 1.0)
    assert image[:, :40].max() > 100


def upright_scene() -> Scene:
    """A camera with x down and y to the left: the longer side is vertical."""
    matrix = np.array([[0, -100.0, 0, 200.0], [100.0, 0, 0, 20.0], [0, 0, 1e-9, 1.0]])
    camera = Camera(matrix, 240, 320, np.zeros((4, 2)), np.eye(8), "cloth", 100.0, 1.0)
    return Scene(shot.TABLE, camera, np.array([45.0, -30.0, 10.0]), ())


@pytest.mark.parametrize("scene", [shot.scene(), upright_scene()])
def test_the_plan_has_the_orientation_of_the_table_in_the_frame(scene: Scene) -> None:
    plan = build_table_inset(scene, 180)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.5]])
    on_plan = plan.to_fixed_point(corners).astype(float)
    in_picture = scene.camera.to_pixels(corners, 0.0)
    for k in (1, 2):
        a, b = on_plan[k] - on_plan[0], in_picture[k] - in_picture[0]
        assert a @ b / np.linalg.norm(a) / np.linalg.norm(b) == pytest.approx(1, abs=1e-3)
    width, height = plan.size
    assert max(width, height) == pytest.approx(180, abs=2)
    assert (height > width) == (abs(in_picture[1, 1] - in_picture[0, 1]) > 50)


def test_the_plan_shows_balls_in_their_colour_and_leaves_out_absent_ones() -> None:
    plan = build_table_inset(shot.scene(), 180)
    image = black(200, 300)
    xy: FloatArray = np.array([[0.45, 0.475], [np.nan, np.nan]])
    plan.draw_with_balls(image, 10, 20, plan.reduce_canvas(plan.canvas), xy, [(255, 255, 0), (0, 255, 255)])
    x, y = plan.to_fixed_point(xy[0]) / 16 / 2
    assert image[20 + round(y), 10 + round(x), :2].min() > 200
    assert not ((image[..., 0] < 60) & (image[..., 1] > 220)).any()


def test_labels_and_clock_fit_into_their_stated_sizes() -> None:
    for scale in (0.78, 1.0, 2.0):
        label = Label("solid-2", "1.23 m/s", (250, 200, 0))
        image = black(300, 600)
        label.draw(image, np.array([20.0, 30.0]), scale)
        rows, columns = np.nonzero(image.max(axis=2))
        width, height = label.size(scale)
        assert 20 <= columns.min() <= columns.max() < 20 + width
        assert 30 <= rows.min() <= rows.max() < 30 + height
        clock = ClockPanel("8× slower", "green", "fit not trusted")
        image = black(300, 600)
        size = clock.size(scale)
        clock.draw(image, (20.0, 30.0, float(size[0]), float(size[1])), 12.345, scale)
        rows, columns = np.nonzero(image.max(axis=2))
        assert columns.max() < 20 + size[0]
        assert rows.max() < 30 + size[1]
