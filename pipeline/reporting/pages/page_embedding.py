"""Files carried inside a page: small ones as a string, large ones streamed into their place while it is written."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path

CHUNK = 3 << 20
"""Bytes read at a time; a multiple of three, so that base64 of the parts is that of the whole."""


def data_uri(path: Path, media_type: str) -> str:
    """A small file as a URI."""
    return f"{_head(media_type)}{base64.b64encode(path.read_bytes()).decode('ascii')}"


def write_page(html: str, carried: Mapping[str, tuple[Path, str]], target: Path) -> None:
    """Write a page in which every mark of `carried` gives way to its (file, media type), without holding the files.

    ValueError where a mark does not stand in the page exactly once.
    """
    places = sorted((html.find(mark), mark) for mark in carried)
    for at, mark in places:
        if at < 0 or html.count(mark) != 1:
            raise ValueError(f"the page should hold {mark!r} once; it holds it {html.count(mark)} times")
    with target.open("wb") as out:
        done = 0
        for at, mark in places:
            out.write(html[done:at].encode())
            path, media_type = carried[mark]
            out.write(_head(media_type).encode("ascii"))
            with path.open("rb") as file:
                while part := file.read(CHUNK):
                    out.write(base64.b64encode(part))
            done = at + len(mark)
        out.write(html[done:].encode())


def _head(media_type: str) -> str:
    return f"data:{media_type};base64,"
