"""Files inside pages."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from pipeline.reporting.pages import page_embedding
from pipeline.reporting.pages.page_embedding import build_data_uri, embed_video, write_page


def test_a_streamed_file_is_the_same_as_one_held_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_embedding, "CHUNK_BYTES", 3 * 7)
    film, still = tmp_path / "film", tmp_path / "still"
    film.write_bytes(np.random.default_rng(1).bytes(1000))
    still.write_bytes(b"still")
    page = tmp_path / "page.html"
    write_page("<ü @film@ between @still@>", {"@still@": (still, "image/png"), "@film@": (film, "video/mp4")}, page)
    expected = f"<ü {build_data_uri(film, 'video/mp4')} between {build_data_uri(still, 'image/png')}>"
    assert page.read_text(encoding="utf-8") == expected
    assert base64.b64decode(expected.partition("base64,")[2].partition(" ")[0]) == film.read_bytes()


@pytest.mark.parametrize("html", ["no mark", "@film@ and @film@"])
def test_a_placeholder_occurs_exactly_once(html: str, tmp_path: Path) -> None:
    (tmp_path / "film").write_bytes(b"film")
    with pytest.raises(ValueError, match="once"):
        write_page(html, {"@film@": (tmp_path / "film", "video/mp4")}, tmp_path / "page.html")


@pytest.mark.parametrize(("limit", "source"), [(4, "data:video/mp4;base64,ZmlsbQ=="), (3, "slow.mp4")])
def test_a_video_takes_the_place_of_its_link_unless_it_is_large(
    limit: int, source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page_embedding, "EMBED_LIMIT_BYTES", limit)
    (tmp_path / "slow.mp4").write_bytes(b"film")
    (tmp_path / "linked.html").write_text('<video src="slow.mp4"> slow.mp4', encoding="utf-8")
    embed_video(tmp_path / "linked.html", tmp_path / "slow.mp4", tmp_path / "page.html")
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == f'<video src="{source}"> slow.mp4'
