"""Values are read back from disk exactly as they were saved."""

from __future__ import annotations

import dataclasses
import json
import math
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray
from support import synthetic_run as shot

from models.core.scene import Scene
from pipeline.engine.value_files import load_value, save_value
from video.io.clip import Clip


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Inner:
    """One field of every type that values may have."""

    name: str
    number: float
    whole: int
    flag: bool
    rate: Fraction
    light: Literal["green", "red"]
    maybe: float | None


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Outer:
    """Nested values beside arrays."""

    inner: Inner
    many: tuple[Inner, ...]
    pair: tuple[int, str]
    floats: NDArray[np.float64]
    whole: NDArray[np.int64]
    flags: NDArray[np.bool_]
    perhaps: NDArray[np.float64] | None


inner = st.builds(
    Inner, name=st.text(), number=st.floats(), whole=st.integers(), flag=st.booleans(), rate=st.fractions(),
    light=st.sampled_from(["green", "red"]), maybe=st.none() | st.floats(),
)  # fmt: skip
shapes = arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
floats = arrays.arrays(np.float64, shapes)
outer = st.builds(
    Outer, inner=inner, many=st.lists(inner, max_size=3).map(tuple), pair=st.tuples(st.integers(), st.text()),
    floats=floats, whole=arrays.arrays(np.int64, shapes), flags=arrays.arrays(np.bool_, shapes),
    perhaps=st.none() | floats,
)  # fmt: skip


def is_identical(a: Any, b: Any) -> bool:
    """Equal in type, shape and every bit that counts; NaN equals NaN."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            is_identical(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
        )
    if isinstance(a, tuple):
        return type(b) is tuple and len(a) == len(b) and all(is_identical(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float) and math.isnan(a):
        return isinstance(b, float) and math.isnan(b)
    return type(a) is type(b) and a == b


@given(value=outer)
def test_any_value_comes_back_exactly(value: Outer) -> None:
    with TemporaryDirectory() as folder:
        save_value(value, Path(folder))
        assert is_identical(load_value(Outer, Path(folder)), value)


def test_the_values_of_a_run_come_back_exactly(tmp_path: Path) -> None:
    clip = shot.write_clip(tmp_path / "clip.mp4")
    scene = shot.make_scene()
    drifting = dataclasses.replace(scene.camera, motion=np.tile(np.eye(3), (clip.frame_count, 1, 1)))
    tracks = shot.make_tracks(clip, scene)
    values = (clip, scene, dataclasses.replace(scene, camera=drifting), tracks, shot.make_detections(tracks))
    for k, value in enumerate(values):
        folder = tmp_path / str(k)
        folder.mkdir()
        save_value(value, folder)
        assert is_identical(load_value(type(value), folder), value)


def test_equal_values_make_equal_bytes(tmp_path: Path) -> None:
    scene = shot.make_scene()
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        save_value(scene, tmp_path / name)
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert [(tmp_path / "a" / f).read_bytes() for f in files] == [(tmp_path / "b" / f).read_bytes() for f in files]


def test_a_value_of_another_format_is_refused(tmp_path: Path) -> None:
    save_value(shot.make_scene(), tmp_path)
    document = json.loads((tmp_path / "value.json").read_text())
    (tmp_path / "value.json").write_text(json.dumps(document | {"format": 0}))
    with pytest.raises(ValueError, match="format 0"):
        load_value(Scene, tmp_path)


def test_an_array_of_objects_is_refused(tmp_path: Path) -> None:
    clip = shot.write_clip(tmp_path / "clip.mp4")
    with pytest.raises(TypeError, match="objects"):
        save_value(dataclasses.replace(clip, t=clip.t.astype(object)), tmp_path)


def test_the_rate_of_a_clip_stays_a_fraction(tmp_path: Path) -> None:
    clip = dataclasses.replace(shot.write_clip(tmp_path / "clip.mp4"), fps=Fraction(24000, 1001))
    save_value(clip, tmp_path)
    assert load_value(Clip, tmp_path).fps == Fraction(24000, 1001)
