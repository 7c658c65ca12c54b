"""Uploads of clips: streamed to disk, limited in size, number and kind, and whole or not there at all."""

from __future__ import annotations

import os
import secrets
import shutil
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request

from pipeline.app.job_queue import JobQueue
from pipeline.app.refusals import Refusal
from pipeline.app.shot_library import ShotLibrary, clean_name
from pipeline.engine.atomic_write import part_suffix, remove_leftovers

# Largest upload, bytes: an hour of a phone's video. A larger file on this machine is named by its path.
MAX_UPLOAD_BYTES = 8_000_000_000
# Bytes that stay free on the disk.
RESERVED_BYTES = 1_000_000_000
# Uploads at a time: more would only be slower. Uploads per hour of all devices in the network together.
MAX_AT_ONCE, MAX_PER_HOUR = 64, 200
# Bytes at the start of a file that decide whether it is a video: two packets of an MPEG transport stream.
HEADER_BYTES = 400


class UploadDesk:
    """Takes uploads for a library."""

    def __init__(self, library: ShotLibrary, queue: JobQueue) -> None:
        self._library, self._queue = library, queue
        self._home = library.own / "uploads"
        self._count = 0
        self._recent: deque[float] = deque()
        remove_leftovers(self._home)

    async def take(self, request: Request) -> dict[str, Any]:
        """Take the clip that is the body of a request; return its job. Raises Refusal."""
        name = check_name(request.query_params.get("name", ""))
        stated = request.headers.get("content-length", "")
        self._require_room(int(stated) if stated.isdecimal() else 0)
        with self._count_upload(is_local=request.state.is_local):
            path = await run_in_threadpool(self._open_part)
            try:
                await self._receive(request, path)
                _set_date(path, request.query_params.get("modified", ""))
                return await run_in_threadpool(self._queue.add_clip, self._library.clips / name, path)
            except ClientDisconnect as error:
                raise Refusal(400, "The upload was broken off.") from error
            finally:
                path.unlink(missing_ok=True)

    async def _receive(self, request: Request, path: Path) -> None:
        """Write the body of a request to a file; raises Refusal."""
        size, header = 0, b""
        with path.open("wb") as file:
            async for part in request.stream():
                if size < HEADER_BYTES and part:
                    header += part[:HEADER_BYTES]
                    if len(header) >= HEADER_BYTES:
                        require_video_header(header)
                size += len(part)
                if size > MAX_UPLOAD_BYTES:
                    raise Refusal(413, TOO_LARGE)
                if size // RESERVED_BYTES != (size - len(part)) // RESERVED_BYTES:
                    self._require_room(0)
                await run_in_threadpool(file.write, part)
        require_video_header(header)

    def _require_room(self, size: int) -> None:
        """Require that an upload of this size, bytes, may come and fits on the disk; raises Refusal."""
        if size > MAX_UPLOAD_BYTES:
            raise Refusal(413, TOO_LARGE)
        place = self._library.root if self._library.root.exists() else self._library.root.parent
        if shutil.disk_usage(place).free < size + RESERVED_BYTES:
            raise Refusal(507, "The disk is too full for this clip; delete some shots or empty the trash.")

    @contextmanager
    def _count_upload(self, *, is_local: bool) -> Iterator[None]:
        """Count an upload while it lasts; raises Refusal where there are too many."""
        now = time.monotonic()
        while self._recent and now - self._recent[0] > 3600:
            self._recent.popleft()
        if self._count >= MAX_AT_ONCE or (not is_local and len(self._recent) >= MAX_PER_HOUR):
            raise Refusal(429, "There are too many uploads now; try again later.")
        self._count += 1
        if not is_local:
            self._recent.append(now)
        try:
            yield
        finally:
            self._count -= 1

    def _open_part(self) -> Path:
        """Choose a hidden file that the next start removes if this process is killed."""
        self._home.mkdir(parents=True, exist_ok=True)
        return self._home / f".{secrets.token_hex(8)}{part_suffix()}"


TOO_LARGE = f"An upload has at most {MAX_UPLOAD_BYTES / 1e9:.0f} GB; give the path of a larger file on this machine."


def check_name(name: str) -> str:
    """Return the last part of a file name without what a file system or a terminal could misread; raises Refusal."""
    last = PurePosixPath(name.replace("\\", "/")).name
    stem, _, suffix = last.rpartition(".")
    if not (clean := clean_name(stem)) or not suffix.isalnum() or len(suffix) > 8:
        raise Refusal(422, "The name of a video file was expected, such as shot.mp4.")
    return f"{clean}.{suffix}"


def require_video_header(header: bytes) -> None:
    """Require that a file begins as a video does; the reader of clips opens it later, in a process of its own.

    Args:
        header: The first `HEADER_BYTES`, or all of a smaller file.

    Raises:
        Refusal: It is no mp4, mov, mkv, webm, avi or MPEG stream.
    """
    from pipeline.batch.clip_discovery import STILL_BRANDS  # a second, and only uploads need it

    box = header[4:8]
    is_mp4 = box in (b"moov", b"mdat", b"wide", b"free", b"skip") or (
        box == b"ftyp" and header[4:12] not in [b"ftyp" + brand for brand in STILL_BRANDS]
    )
    is_stream = any(header[k : k + 1] == b"G" == header[k + n : k + n + 1] for k, n in ((0, 188), (4, 192)))
    is_other = header.startswith((b"\x1aE\xdf\xa3", b"\0\0\1\xba")) or (
        header.startswith(b"RIFF") and header[8:12] == b"AVI "
    )
    if not (is_mp4 or is_stream or is_other):
        raise Refusal(415, "This is no video; mp4, mov, mkv, webm, avi and MPEG files are clips.")


def _set_date(path: Path, modified: str) -> None:
    """Give a file the date that its original has, ms since 1970, where the page tells it."""
    if modified.isdecimal() and len(modified) < 15:
        os.utime(path, (time.time(), int(modified) / 1000))
