"""summary.html: all shots of a batch on one self-contained page that can be searched and filtered."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from PIL import Image

from models.core.errors import OptionError
from pipeline.batch.clip_job import ClipResult
from pipeline.io.strict_json import read_json
from pipeline.reporting.pages.page_template import build_jpeg_uri, render_template
from pipeline.reporting.pages.run_report import SUMMARY_FILE, THUMBNAIL_PX, THUMBNAIL_QUALITY
from pipeline.reporting.text.text_formatting import escape_text
from pipeline.stages.render_stage import SLOW_FILE

# A phone opens a page of 3 MB at once.
MAX_PAGE_BYTES = 2_900_000
# Longest side of an image that shows a table at all.
LEAST_THUMBNAIL_PX = 64


@dataclass(frozen=True, slots=True)
class ShotCard:
    """What the page shows of one shot."""

    name: str
    place: str
    """Its folder relative to the page, quoted."""
    trust: str
    facts: dict[str, Any]
    """Content of its summary.json; empty where it has none."""
    has_video: bool

    @property
    def seconds(self) -> float:
        """Length, s."""
        return float(self.facts.get("ends", 0.0)) - float(self.facts.get("begins", 0.0))

    @property
    def answers(self) -> list[str]:
        """Topics of its calls with their answers, such as `score: yes`."""
        return [f"{call['topic']}: {call['answer']}" for call in self.facts.get("calls", ())]


def render_index_page(rows: Sequence[ClipResult], out: Path) -> str:
    """Render a page with a card per shot.

    Where the page would take more than `MAX_PAGE_BYTES`, its images get smaller, and are left out in the end.

    Args:
        rows: Results of the clips.
        out: Folder of the page, to which its links are relative.

    Returns:
        The page.
    """
    cards = [card for row in rows if row.status == "done" for card in _list_cards(row, out)]
    images = [str(card.facts.get("thumbnail", "")) for card in cards]
    bare = _render(rows, out, cards, [""] * len(cards))
    room = MAX_PAGE_BYTES - len(bare.encode("utf-8"))
    return _render(rows, out, cards, fitted) if any(fitted := _fit_images(images, room)) else bare


def _render(rows: Sequence[ClipResult], out: Path, cards: Sequence[ShotCard], images: Sequence[str]) -> str:
    """Render the page with these images."""
    return render_template(
        "summary.html",
        name=escape_text(out.resolve().name),
        rows=[{**asdict(row), "clip": escape_text(row.clip), "sentence": escape_text(row.sentence)} for row in rows],
        cards=list(zip(cards, images, strict=True)),
        answers=sorted({answer for card in cards for answer in card.answers}),
        done=sum(row.status == "done" for row in rows),
        seconds=sum(row.seconds for row in rows),
    )


def _list_cards(row: ClipResult, out: Path) -> Iterator[ShotCard]:
    """Yield a card for each usable shot of a clip."""
    folder = Path(row.folder)
    for name in _list_shot_folders(folder) if row.in_shots else [""]:
        facts = _read_json(folder / name / SUMMARY_FILE)
        facts["balls"] = facts.get("balls", [])
        level = facts["trust"]["light"] if "trust" in facts else row.trust
        place = quote(os.fsencode(os.path.relpath(folder / name, out)))
        title = escape_text(f"{row.clip}, {name}" if name else row.clip)
        yield ShotCard(title, place, level, facts, (folder / name / SLOW_FILE).is_file())


def _list_shot_folders(folder: Path) -> list[str]:
    """List the shots of a recording, of which an earlier run may have left more."""
    return [str(shot["folder"]) for shot in _read_json(folder / "scene.json").get("shots", ())]


def _read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object; empty where the file cannot be read."""
    with suppress(OptionError):
        return dict(read_json(path, "a summary was expected"))
    return {}


def _fit_images(images: Sequence[str], room: int) -> list[str]:
    """Shrink images (data URIs) until they take no more than `room` bytes; leave all out where none could be seen."""
    fitted, longest = list(images), float(THUMBNAIL_PX)
    while (total := sum(map(len, fitted))) > room:
        longest *= min(0.95 * float(np.sqrt(max(room, 0) / total)), 0.9)
        if longest < LEAST_THUMBNAIL_PX:
            return [""] * len(images)
        fitted = [_shrink_image(image, round(longest)) if image else "" for image in images]
    return fitted


def _shrink_image(uri: str, longest: int) -> str:
    """Shrink an image (a data URI) to a longest side, px."""
    with Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))) as image:
        return build_jpeg_uri(np.asarray(image.convert("RGB")), longest, THUMBNAIL_QUALITY)
