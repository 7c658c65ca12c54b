"""A clip to share fits a phone, shows the moment of the call, and states the answer in its own words."""

from __future__ import annotations

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from support.carom_start import Home

import trueroll
from models.core.errors import OptionError
from pipeline.actions.answer_call import answer_question
from pipeline.io.run_views import read_shot_record
from video.drawing.label_layout import Rect
from video.drawing.masks import text_mask, wrap_text
from video.overlay import share_clip
from video.overlay.frame_overlay import FrameBalls
from video.overlay.share_clip import MARGIN, QUESTION_PX, SENTENCE_PX, VERDICT_PX, WIDTH

pytestmark = pytest.mark.slow


def read_images(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def shows(image: np.ndarray, text: str, size: int, bold: bool = False) -> bool:
    """Whether a line of text stands somewhere on an image."""
    lines = wrap_text(text, size, WIDTH - 2 * MARGIN, bold)
    grey = image.max(axis=2)
    return all(cv2.matchTemplate(grey, text_mask(line, size, bold), cv2.TM_CCOEFF_NORMED).max() > 0.9 for line in lines)


@pytest.fixture(scope="module")
def shared(home: Home, tmp_path_factory: pytest.TempPathFactory) -> tuple[trueroll.Answer, Path]:
    folder = tmp_path_factory.mktemp("share")
    path = folder / "first.mp4"
    return trueroll.call(home.out, "first", "white", out=folder, share=path), path


def test_the_clip_is_upright_short_small_and_plays_everywhere(shared: tuple[trueroll.Answer, Path]) -> None:
    answer, path = shared
    assert answer.figures[-1] == str(path)
    content = path.read_bytes()
    assert len(content) < 5e6
    assert content.index(b"moov") < content.index(b"mdat"), "a messenger plays it while it loads"
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.codec_context.pix_fmt) == (720, 1280, "yuv420p")
        assert stream.codec_context.name == "h264"
        assert float(stream.duration * stream.time_base) == pytest.approx(10, abs=0.05)
        assert not container.streams.audio


def test_the_words_are_those_of_the_answer(shared: tuple[trueroll.Answer, Path]) -> None:
    answer, path = shared
    images = read_images(path)
    for image in (images[0], images[len(images) // 3], images[-1]):
        assert shows(image, answer.question, QUESTION_PX, bold=True)
    assert shows(images[-1], answer.sentences[0], SENTENCE_PX)
    verdict = f"{answer.sentences[0].partition(':')[0]}"
    told = [shows(image, verdict, VERDICT_PX, bold=True) for image in images]
    assert any(told)
    assert not told[0], "the answer comes after the moment"
    assert not shows(images[-1], "Cannot be decided", SENTENCE_PX)


def test_the_same_question_gives_the_same_bytes(
    shared: tuple[trueroll.Answer, Path], home: Home, tmp_path: Path
) -> None:
    trueroll.call(home.out, "first", "white", out=tmp_path, share=tmp_path / "again.mp4")
    assert (tmp_path / "again.mp4").read_bytes() == shared[1].read_bytes()


def test_names_cover_no_ball_and_no_contact(home: Home, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every view is compared with the one before the names were drawn."""
    covered, drawn = [], []
    draw = share_clip._MomentView._draw_names

    def compare(self: object, view: np.ndarray, balls: FrameBalls, obstacles: list[Rect]) -> None:
        before = view.copy()
        draw(self, view, balls, obstacles)  # type: ignore[arg-type]
        changed = (view != before).any(axis=2)
        drawn.append(changed.sum())
        y, x = np.mgrid[: view.shape[0], : view.shape[1]]
        for ball in balls.present:
            is_ball = np.hypot(x - balls.centre[ball, 0], y - balls.centre[ball, 1]) < balls.radius[ball]
            covered.append((changed & is_ball).sum())

    monkeypatch.setattr(share_clip._MomentView, "_draw_names", compare)
    trueroll.call(home.out, "first", "white", out=tmp_path, share=tmp_path / "clip.mp4")
    assert max(covered) == 0
    assert np.median(drawn) > 1000


def test_where_nothing_touched_the_clip_shows_the_smallest_distance(home: Home, tmp_path: Path) -> None:
    record = read_shot_record(home.out)
    call = answer_question(record, ["first", "red"])
    t, balls = call.t, call.balls
    assert balls[0] == "red"
    red = record.ball_index("red")
    places = {
        name: np.linalg.norm(record.path[:, k] - record.path[:, red], axis=1) for k, name in enumerate(record.ids)
    }
    least = {name: np.nanmin(distance) for name, distance in places.items() if name != "red"}
    assert balls[1] == min(least, key=least.__getitem__)
    assert record.moments[np.nanargmin(places[balls[1]])] == t
    answer = trueroll.call(home.out, "first", "red", out=tmp_path, share=tmp_path / "none.mp4")
    assert shows(read_images(tmp_path / "none.mp4")[-1], answer.sentences[0], SENTENCE_PX)


def test_a_missing_clip_is_one_sentence_and_leaves_no_file(home: Home, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    for name in ("scene.json", "shot"):
        (folder / name).symlink_to(home.out / name)
    (folder / "source.json").write_text(json.dumps({"path": str(tmp_path / "gone.mp4")}))
    with pytest.raises(OptionError, match=r"--share needs the frames of the shot: .* --clip\.$"):
        trueroll.call(folder, "first", "white", out=tmp_path, share=tmp_path / "none.mp4")
    with pytest.raises(OptionError, match=r"writes an \.mp4 file; got"):
        trueroll.call(home.out, "first", "white", out=tmp_path, share=tmp_path / "none.gif")
    assert not list(tmp_path.glob("*.mp4"))
