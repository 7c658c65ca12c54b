"""Embedding of files in a page: small ones as data URIs, large ones streamed while the page is written."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path

from PIL import Image

from models.core.typing import ImageArray

JPEG_QUALITY = 82
EMBED_LIMIT_BYTES = 48_000_000
"""Largest video that is embedded in a page; a larger one is linked."""
VIDEO_PLACEHOLDER = "slow-motion/carried-here"
"""Placeholder of the video in the page; no clip can have this name."""
CHUNK_BYTES = 3 << 20
"""Bytes read at a time; a multiple of three, so that the base64 of the parts equals the base64 of the whole file."""


def build_data_uri(path: Path, media_type: str) -> str:
    """Encode a small file as a data URI."""
    return f"{_data_uri_head(media_type)}{base64.b64encode(path.read_bytes()).decode('ascii')}"


def build_jpeg_uri(image: ImageArray) -> str:
    """Encode an image (H, W, 3) as the data URI of a JPEG."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="JPEG", quality=JPEG_QUALITY)
    return f"{_data_uri_head('image/jpeg')}{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def write_page(html: str, carried: Mapping[str, tuple[Path, str]], target: Path) -> None:
    """Write a page and replace placeholders by files, without loading the files into memory.

    Args:
        html: The page.
        carried: File and media type by placeholder.
        target: File to write.

    Raises:
        ValueError: A placeholder does not occur exactly once in the page.
    """
    places = sorted((html.find(mark), mark) for mark in carried)
    for at, mark in places:
        if at < 0 or html.count(mark) != 1:
            raise ValueError(f"the page must contain {mark!r} once; it contains it {html.count(mark)} times")
    with target.open("wb") as out:
        done = 0
        for at, mark in places:
            out.write(html[done:at].encode())
            path, media_type = carried[mark]
            out.write(_data_uri_head(media_type).encode("ascii"))
            with path.open("rb") as file:
                while part := file.read(CHUNK_BYTES):
                    out.write(base64.b64encode(part))
            done = at + len(mark)
        out.write(html[done:].encode())


def embed_video(page: Path, video: Path, target: Path) -> None:
    """Write a page that links to a video again, with the video inside.

    Args:
        page: A page that links to the name of the video, once.
        video: An mp4 file; if it is larger than `EMBED_LIMIT_BYTES`, the page keeps the link.
        target: File to write.
    """
    html = page.read_text(encoding="utf-8")
    if video.stat().st_size > EMBED_LIMIT_BYTES:
        write_page(html, {}, target)
        return
    html = html.replace(f'src="{video.name}"', f'src="{VIDEO_PLACEHOLDER}"')
    write_page(html, {VIDEO_PLACEHOLDER: (video, "video/mp4")}, target)


def _data_uri_head(media_type: str) -> str:
    """Return the part of a data URI before the data."""
    return f"data:{media_type};base64,"
