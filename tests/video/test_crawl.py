"""Lines of text that crawl farther than a letter are followed, and nothing else is changed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from video.flow.optical_flow import OpticalFlow, flow_between, grid
from video.flow.ticker import crawling_ways, with_crawls

HEIGHT, WIDTH, LINE = 96, 400, slice(56, 76)
TEXT = "SIDE POCKET LIVE FROM THE HALL THE FRAME STANDS AT FOUR ALL AND IT IS TABLE TWO NEXT"


def ground() -> np.ndarray:
    rng = np.random.default_rng(3)
    wood = cv2.GaussianBlur(rng.normal(0, 60, (HEIGHT, WIDTH)).astype(np.float32), (0, 0), 3)
    return np.clip(130 + wood, 0, 255).astype(np.uint8)


def crawling(at: float, height: int = HEIGHT) -> np.ndarray:
    """A picture with a line of text whose first letter stands at x px."""
    picture = ground()[:height].copy()
    line = np.full((20, 1600), 15, np.uint8)
    cv2.putText(line, TEXT, (0, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 230, 1, cv2.LINE_AA)
    moved = cv2.warpAffine(line, np.array([[1.0, 0.0, at], [0.0, 1.0, 0.0]]), (WIDTH, 20), borderValue=15)
    picture[LINE] = moved
    return np.clip(picture + np.random.default_rng(int(at) + 500).normal(0, 2, picture.shape), 0, 255).astype(np.uint8)


def followed(flow: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return with_crawls(flow, first, second, crawling_ways(first, second), grid(*first.shape))


@pytest.mark.parametrize("way", [-27.0, 14.5, -41.0])
def test_a_line_of_text_goes_one_way(way: float) -> None:
    first, second = crawling(-300.0), crawling(-300.0 + way)
    flow = followed(flow_between(first, second), first, second)
    inner = flow[60:72, 60:340]
    assert np.abs(inner[..., 0] - way).mean() < 0.5
    assert np.abs(inner[..., 1]).mean() < 0.3
    assert np.abs(flow[:40]).mean() < 0.3


def test_where_nothing_crawls_the_flow_is_as_it_was() -> None:
    first = ground()
    second = np.clip(first + np.random.default_rng(0).normal(0, 2, first.shape), 0, 255).astype(np.uint8)
    flow = flow_between(first, second)
    assert followed(flow, first, second) is flow


def test_what_turns_is_left_to_the_flow() -> None:
    """A hand that turns has no one way: no part of it is torn off."""
    first = ground()
    turn = cv2.getRotationMatrix2D((WIDTH / 2, HEIGHT / 2), 4.0, 1.0)
    second = np.asarray(cv2.warpAffine(first, turn, (WIDTH, HEIGHT), borderMode=cv2.BORDER_REFLECT), dtype=np.uint8)
    flow = flow_between(first, second)
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    truth = np.stack(
        [turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] - x, turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] - y], -1
    )
    inner = np.s_[16:-16, 16:-16]
    before, after = (np.linalg.norm((f - truth)[inner], axis=-1).mean() for f in (flow, followed(flow, first, second)))
    assert after < before + 0.05


def test_a_picture_smaller_than_the_window_is_left_alone() -> None:
    small = np.zeros((6, 40), np.uint8)
    flow = np.zeros((6, 40, 2), np.float32)
    assert followed(flow, small, small + 50) is flow


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_crawling_line_is_legible_between_two_pictures(share: float) -> None:
    way = -27.0
    first, second, real = (np.dstack([crawling(-300.0 + k * way)] * 3) for k in (0.0, 1.0, share))
    made = OpticalFlow().open(first, second)(share)
    line = np.s_[58:74, 60:340]
    miss = float(((made[line].astype(float) - real[line]) ** 2).mean())
    blend = float((((1 - share) * first[line] + share * second[line] - real[line]) ** 2).mean())
    assert miss < 0.15 * blend
