"""Images inside pages."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.reporting.pages.page_template import MAX_IMAGE_PX, _keep_units, embed_image_file


@pytest.mark.parametrize(("size", "expected"), [((2560, 1440), (1280, 720)), ((320, 180), (320, 180))])
def test_an_embedded_image_is_no_larger_than_a_page_needs(
    size: tuple[int, int], expected: tuple[int, int], tmp_path: Path
) -> None:
    noise = np.random.default_rng(1).integers(90, 110, (*size[::-1], 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "poster.png")
    head, _, data = embed_image_file(tmp_path / "poster.png").partition(",")
    assert head == "data:image/jpeg;base64"
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        assert image.size == expected
        assert max(image.size) <= MAX_IMAGE_PX


def test_a_number_stays_with_its_unit_and_an_option_in_one_piece() -> None:
    kept = str(_keep_units("0.8 rad/s <b>: trueroll run --laws"))
    assert kept == "0.8\N{NO-BREAK SPACE}rad/s &lt;b&gt;: trueroll run <span class=option>--laws</span>"
