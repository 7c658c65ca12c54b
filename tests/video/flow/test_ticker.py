"""Lines of text that shift farther than a letter are followed, and everything else is unchanged."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from video.flow.optical_flow import (
    apply_ticker_shifts,
    compute_flow,
    find_ticker_shifts,
    pixel_grid,
    prepare_flow,
)

HEIGHT, WIDTH, LINE = 96, 400, slice(56, 76)
TEXT = "SIDE POCKET LIVE FROM THE HALL THE FRAME STANDS AT FOUR ALL AND IT IS TABLE TWO NEXT"


def ground() -> np.ndarray:
    rng = np.random.default_rng(3)
    wood = cv2.GaussianBlur(rng.normal(0, 60, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 3)
    return np.clip(130 + wood, 0, 255).astype(np.uint8)


def ticker_frame(at: float, height: int = HEIGHT) -> np.ndarray:
    """A frame with a line of text whose first letter is at x px."""
    image = ground()[:height].copy()
    line = np.full((20, 1600), 15, np.uint8)
    cv2.putText(line, TEXT, (0, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 230, 1, cv2.LINE_AA)
    moved = cv2.warpAffine(line, np.array([[1.0, 0.0, at], [0.0, 1.0, 0.0]]), (WIDTH, 20), borderValue=15)
    image[LINE] = moved
    return np.clip(image + np.random.default_rng(int(at) + 500).normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def follow_ticker(flow: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return apply_ticker_shifts(flow, first, second, find_ticker_shifts(first, second), pixel_grid(*first.shape))


@pytest.mark.parametrize("way", [-27.0, 14.5, -41.0])
def test_a_line_of_text_has_one_shift(way: float) -> None:
    first, second = ticker_frame(-300.0), ticker_frame(-300.0 + way)
    flow = follow_ticker(compute_flow(first, second), first, second)
    inner = flow[60:72, 60:340]
    assert np.abs(inner[..., 0] - way).mean() < 0.5
    assert np.abs(inner[..., 1]).mean() < 0.3
    assert np.abs(flow[:40]).mean() < 0.3


def test_without_a_ticker_the_flow_is_unchanged() -> None:
    first = ground()
    second = np.clip(first + np.random.default_rng(0).normal(0, 2, first.shape), 0, 255).astype(np.uint8)
    flow = compute_flow(first, second)
    assert follow_ticker(flow, first, second) is flow


def test_a_rotating_object_keeps_its_flow() -> None:
    """A rotating hand has no single shift: no part of it is torn off."""
    first = ground()
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), 4.0, 1.0)
    second = np.asarray(cv2.warpAffine(first, turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT), dtype=np.uint8)
    flow = compute_flow(first, second)
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    truth = np.stack(
        [turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] - x, turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] - y], -1
    )
    inner = np.s_[16:-16, 16:-16]
    before, after = (
        np.linalg.norm((f - truth)[inner], axis=-1).mean() for f in (flow, follow_ticker(flow, first, second))
    )
    assert after < before + 0.05


def test_an_image_smaller_than_the_window_is_unchanged() -> None:
    small = np.zeros((6, 40), np.uint8)
    flow = np.zeros((6, 40, 2), np.float32)
    assert follow_ticker(flow, small, small + 50) is flow


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_ticker_is_legible_between_two_frames(share: float) -> None:
    way = -27.0
    first, second, real = (np.dstack([ticker_frame(-300.0 + k * way)] * 3) for k in (0.0, 1.0, share))
    interpolated = prepare_flow(first, second).interpolate(share)
    line = np.s_[58:74, 60:340]
    error = float(((interpolated[line].astype(float) - real[line]) ** 2).mean())
    blend = float((((1 - share) * first[line] + share * second[line] - real[line]) ** 2).mean())
    assert error < 0.15 * blend
